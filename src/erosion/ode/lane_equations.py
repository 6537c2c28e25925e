"""A lane's equations with those of its derivatives, as functions of plain numbers."""

import functools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Number, Scalar
from erosion.lanes.flatten import NotForLanesError, dependencies
from erosion.ode.cubics import Ends
from erosion.ode.events import Armed, EventSet, Falling
from erosion.ode.kinks import OfOperation, is_nonsmooth, may_have_kinks, operands_of
from erosion.ode.methods import method_of
from erosion.ode.motion import Augmented
from erosion.ode.reduction import FlatState, are_affine
from erosion.ode.signature import Signature
from erosion.ode.step_control import TINY, Limits
from erosion.ode.switches import motion_of, switches_of
from erosion.ode.variational import Derivatives, Direction, Variational

_SPAN = 0.03  # of the time from t0 to t1: the time scale of a problem that names none
_LONGER = 1e3  # times as long as a number of the state takes to change by its own size
_LEAST = 1e-9  # of the time scale: a number of the state that changes sooner by its own size is almost zero


class LaneEquations:
    """A lane's equations with those of its derivatives, as functions of plain numbers.

    Args:
        signature, parameters: of problem and arguments.
        order, directions: see `Variational`.
    """

    def __init__(
        self, signature: Signature, parameters: Sequence[Number], order: int, directions: tuple[Direction, ...]
    ) -> None:
        self.signature, self.parameters, self.options = signature, list(parameters), signature.options
        motion = motion_of(signature)
        self.order, self.nonsmooth = order, may_have_kinks(signature)
        fixed = all(isinstance(direction, int) for direction in directions)
        places = () if fixed else directions

        def equations(parameters: Sequence[Number], places: tuple[Direction, ...]) -> Variational:
            return Variational(signature, parameters, order, directions if fixed else places, motion)

        self.equations_at, self.places = equations, places
        self.equations = equations(self.parameters, places)
        here = self.equations.at(self.parameters)
        self.clock, self.switches = here.clock, switches_of(signature)
        own, resets = signature.problem.directions(signature.args(self.parameters)), signature.problem.resets()
        self.own_events, bounds = len(own), 0 if self.switches is None else self.switches.bounds
        self.directions = (*own, *[-1] * bounds)
        self.chains = [i for i, reset in enumerate(resets) if reset is not None]
        self.chains += range(self.own_events, len(self.directions))
        self.initial: FlatState = jax.tree.leaves(self.equations.initial())
        state, integrals = jax.eval_shape(here.initial)
        self._member = jax.tree.structure(Augmented(state, integrals))
        self.width, self.integrals = self._member.num_leaves, len(integrals)
        given = self.options.state_scale or ()
        first = int(signature.equations.timed)
        self.sizes = [TINY] * self.width
        self.sizes[first : first + len(given)] = given

        # Each is traced once for all the places where it is called.
        @jax.jit
        def rate(parameters: Sequence[Number], places: tuple[Direction, ...], flat_state: FlatState) -> FlatState:
            return jax.tree.leaves(equations(parameters, places).rate(self.value_and_tangents(flat_state)))

        @jax.jit
        def rate_and_events(
            parameters: Sequence[Number], places: tuple[Direction, ...], flat_state: FlatState
        ) -> tuple[FlatState, list[Ends]]:
            extended, state = equations(parameters, places), self.value_and_tangents(flat_state)
            flow = extended.rate(state)
            motion_here = extended.at(parameters)
            values, rates = jax.jvp(motion_here.events, (state[0],), (flow[0],))
            return jax.tree.leaves(flow), [Ends(*pair) for pair in zip(values, rates, strict=True)]

        @jax.jit
        def events(parameters: Sequence[Number], flat_state: FlatState) -> list[Scalar]:
            return motion(parameters).events(self.value_and_tangents(flat_state)[0])

        @jax.jit
        def motion_rate(parameters: Sequence[Number], flat_state: FlatState) -> FlatState:
            return jax.tree.leaves(motion(parameters).rate(self.value_and_tangents(flat_state)[0]))

        self.motion_rate = functools.partial(motion_rate, self.parameters)
        self.events = functools.partial(events, self.parameters)
        self.rate = functools.partial(rate, self.parameters, places)
        self.rate_and_events = functools.partial(rate_and_events, self.parameters, places)
        self.method = method_of(self)
        by_scale = signature.problem.time_scale is not None and self.clock.t1 == math.inf
        foresees = self.event_set.foresee and self.method.foresees
        self.limits = Limits(self.options.max_steps, by_scale, foresees=foresees)
        self.detects_stiffness = self.options.method == "auto" and not self.nonsmooth

    @functools.cached_property
    def event_set(self) -> EventSet:
        """The events."""
        if not self.options.arm_on_return:
            return Falling(self.directions)
        jaxpr = jax.make_jaxpr(self.events)(self.initial[: self.width]).jaxpr
        # A function that is affine in the rows moves no faster than they.
        affine, smooth = are_affine(jaxpr, self._moves), not is_nonsmooth(jaxpr, self._moves)
        one_sided = self.options.one_sided
        return Armed(self.directions, own=self.own_events, affine=affine, smooth=smooth, one_sided=one_sided)

    @property
    def _moves(self) -> list[bool]:
        """Of each row of the motion itself whether it may move between two events."""
        if self.switches is None:
            return [True] * self.width
        return [*self.switches.moves, *[False] * self.switches.count, *[True] * self.integrals]

    @functools.cached_property
    def pattern(self) -> np.ndarray:
        """Which rates of the motion itself may depend on which rows, by their arithmetic."""
        rows = [jax.ShapeDtypeStruct((), np.float64)] * self.width

        def rate(rows: FlatState, parameters: Sequence[Number]) -> FlatState:
            return jax.tree.leaves(self.equations.at(parameters).rate(self.value_and_tangents(rows)[0]))

        try:
            return dependencies(jax.make_jaxpr(rate)(rows, self.signature.structs()))[:, : self.width]
        except NotForLanesError:
            return np.ones((self.width, self.width), bool)  # XLA may compute it all the same

    def without_rest(self, slope: FlatState) -> FlatState:
        """Slopes, which are the number 0 for rows that do not move: what is computed with it needs no operation."""
        return [k if self._moves[i % self.width] else np.zeros(()) for i, k in enumerate(slope)]

    def operands(self, which: OfOperation) -> Callable[[FlatState], list[Scalar]]:
        """The values of some operands in the rates of the motion itself, such as divisors; see `kinks`."""

        def values(flat_state: FlatState) -> list[Scalar]:
            jaxpr = jax.make_jaxpr(self.motion_rate)(flat_state)
            return operands_of(which, jaxpr, flat_state, [True] * len(flat_state))

        return values

    def value_and_tangents(self, flat_state: FlatState) -> tuple[Augmented, ...]:
        """Value and derivatives of a state."""
        parts = [flat_state[i : i + self.width] for i in range(0, len(flat_state), self.width)]
        return tuple(jax.tree.unflatten(self._member, part) for part in parts)

    def sizes_of_state(self, flat_state: FlatState) -> list[Scalar]:
        """The sizes of the elements of the state, from those of the rows of the motion itself; nothing from none."""
        if not flat_state:
            return []
        # Each element is a known number plus known multiples of rows.
        high, low = (
            self.equations.at(self.parameters).outputs(
                jax.tree.unflatten(self._member, [sign * row for row in flat_state])
            )
            for sign in (1.0, -1.0)
        )
        both = zip(high[: len(high) - self.integrals], low, strict=False)
        return [(jnp.abs(one) + jnp.abs(other)) / 2 for one, other in both]

    @property
    def time_scale(self) -> Scalar:
        """A typical time of the motion."""
        given, args = self.signature.problem.time_scale, self.signature.args(self.parameters)
        if given is not None:
            return given(args)
        span = self.clock.t1 - self.clock.t0
        # A lane that has no time ends where it starts, in any scale.
        return jnp.where(span == 0, 1.0, _SPAN * span)

    def scale_at_start(self, initial: FlatState, slope: FlatState) -> Scalar:
        """The time scale where a motion begins, for its first step: the span says little where it is far too long."""
        scale = self.time_scale
        if self.signature.problem.time_scale is not None:
            return scale
        motion = zip(initial[: self.width], slope[: self.width], strict=True)
        times = (jnp.abs(u) / jnp.maximum(jnp.abs(k), TINY) for u, k in motion)
        # A number that is almost zero says nothing.
        known = (jnp.where(time < _LEAST * scale, jnp.inf, time) for time in times)
        return functools.reduce(jnp.minimum, (_LONGER * time for time in known), scale)

    def scale_near(self, step: Scalar, first: float) -> Scalar:
        """The time scale at a step: where the problem names none, no longer than such that `first` of it is the step.

        Args:
            step: the length that the error control would like.
            first: the first step, of the time scale.
        """
        scale = self.time_scale
        return scale if self.signature.problem.time_scale is not None else jnp.minimum(scale, step * (1 / first))

    @property
    def time_to_end(self) -> Derivatives:
        """How long a lane without an event goes on, with derivatives; the value is None where it does."""
        if not self.signature.has_clock:
            return Derivatives(None, None, None, None)
        return self.equations.of(lambda _, motion: motion.clock.t1 - motion.clock.t0, ())
