"""A lane's equations with those of its derivatives, as functions of plain numbers."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr

from erosion.arguments import Number, Scalar
from erosion.ode.crossings import Ends
from erosion.ode.kinks import divisors, is_nonsmooth, may_have_kinks, operands_of, radicands, square_roots
from erosion.ode.methods import method_of
from erosion.ode.reduction import Rows, are_affine
from erosion.ode.step_control import Limits
from erosion.ode.switches import motion_of, switches_of
from erosion.ode.variational import Augmented, Derivatives, Direction, Layout, Variational

_SPAN = 0.03  # of the time from t0 to t1: the time scale of a problem that names none
_TINY = 1e-300  # keeps 0/0 away
_LONGER = 1e3  # times as long as a number of the state takes to change by its own size
_LEAST = 1e-9  # of the time scale: a number of the state that changes sooner by its own size is almost zero


class LaneEquations:
    """A lane's equations with those of its derivatives, as functions of plain numbers.

    Args:
        layout, numbers: of problem and arguments.
        order, directions: see `Variational`.
    """

    def __init__(
        self, layout: Layout, numbers: Sequence[Number], order: int, directions: tuple[Direction, ...]
    ) -> None:
        self.layout, self.numbers, self.options = layout, list(numbers), layout.options
        motion = motion_of(layout)
        self.order, self.nonsmooth = order, may_have_kinks(layout)
        fixed = all(isinstance(direction, int) for direction in directions)
        places = () if fixed else directions

        def equations(numbers: Sequence[Number], places: tuple[Direction, ...]) -> Variational:
            return Variational(layout, numbers, order, directions if fixed else places, motion)

        self.equations_at, self.places = equations, places
        self.equations = equations(self.numbers, places)
        here = self.equations.at(self.numbers)
        self.clock, self.switches = here.clock, switches_of(layout)
        own, resets = layout.problem.directions(layout.args(self.numbers)), layout.problem.resets()
        self.own_events, bounds = len(own), 0 if self.switches is None else self.switches.bounds
        self.directions = (*own, *[-1] * bounds)
        self.chains = [i for i, reset in enumerate(resets) if reset is not None]
        self.chains += range(self.own_events, len(self.directions))
        self.initial: Rows = jax.tree.leaves(self.equations.initial())
        state, integrals = jax.eval_shape(here.initial)
        self._member = jax.tree.structure(Augmented(state, integrals))
        self.width, self.integrals = self._member.num_leaves, len(integrals)
        given = self.options.sizes or ()
        self.sizes = [_TINY] * (len(state) - len(given)) + list(given) + [_TINY] * self.integrals

        # Each is traced once for all the places where it is called.
        @jax.jit
        def rate(numbers: Sequence[Number], places: tuple[Direction, ...], rows: Rows) -> Rows:
            return jax.tree.leaves(equations(numbers, places).rate(self.members(rows)))

        @jax.jit
        def rate_and_events(
            numbers: Sequence[Number], places: tuple[Direction, ...], rows: Rows
        ) -> tuple[Rows, list[Ends]]:
            extended, state = equations(numbers, places), self.members(rows)
            flow = extended.rate(state)
            motion_here = extended.at(numbers)
            values, rates = jax.jvp(motion_here.events, (state[0],), (flow[0],))
            return jax.tree.leaves(flow), [Ends(*pair) for pair in zip(values, rates, strict=True)]

        @jax.jit
        def events(numbers: Sequence[Number], rows: Rows) -> list[Scalar]:
            return motion(numbers).events(self.members(rows)[0])

        @jax.jit
        def motion_rate(numbers: Sequence[Number], rows: Rows) -> Rows:
            return jax.tree.leaves(motion(numbers).rate(self.members(rows)[0]))

        self.motion_rate = functools.partial(motion_rate, self.numbers)
        self.events = functools.partial(events, self.numbers)
        self.rate = functools.partial(rate, self.numbers, places)
        self.rate_and_events = functools.partial(rate_and_events, self.numbers, places)
        self.method = method_of(self)
        scaled, clocked = layout.problem.time_scale is not None, self.options.clock
        by_scale = scaled and (not clocked or jnp.isinf(self.clock.t1))
        foresees = self.options.arm_on_return and self.method.foresees
        self.limits = Limits(self.options.max_steps, by_scale, foresees=foresees)
        self.detects_stiffness = self.options.method == "auto" and not self.nonsmooth

    @functools.cached_property
    def affine_events(self) -> list[bool]:
        """Of each event whether its function is affine in the rows: then it moves no faster than they."""
        return are_affine(self._events_jaxpr, self._moves)

    @functools.cached_property
    def events_are_smooth(self) -> bool:
        """Whether all event functions are smooth by their arithmetic."""
        return not is_nonsmooth(self._events_jaxpr, self._moves)

    @property
    def _moves(self) -> list[bool]:
        """Of each row of the motion itself whether it may move between two events."""
        if self.switches is None:
            return [True] * self.width
        return [*self.switches.moves, *[False] * self.switches.count, *[True] * self.integrals]

    @functools.cached_property
    def _events_jaxpr(self) -> Jaxpr:
        return jax.make_jaxpr(self.events)(self.initial[: self.width]).jaxpr

    @property
    def events_are_slow(self) -> bool:
        """Whether no event function may move faster than the state."""
        return not self.options.arm_on_return or all(self.affine_events)

    def dividing(self, rows: Rows) -> list[Scalar]:
        """What the rates of the motion itself divide by."""
        return operands_of(divisors, jax.make_jaxpr(self.motion_rate)(rows), rows, [True] * len(rows))

    def under_roots(self, rows: Rows) -> list[Scalar]:
        """Of what the rates of the motion itself take roots."""
        return operands_of(radicands, jax.make_jaxpr(self.motion_rate)(rows), rows, [True] * len(rows))

    def under_square_roots(self, rows: Rows) -> list[Scalar]:
        """Of what they take square roots."""
        return operands_of(square_roots, jax.make_jaxpr(self.motion_rate)(rows), rows, [True] * len(rows))

    @functools.cached_property
    def has_square_roots(self) -> bool:
        """Whether they take any."""
        return bool(jax.eval_shape(self.under_square_roots, self.initial[: self.width]))

    def members(self, rows: Rows) -> tuple[Augmented, ...]:
        """Value and derivatives of a state."""
        parts = [rows[i : i + self.width] for i in range(0, len(rows), self.width)]
        return tuple(jax.tree.unflatten(self._member, part) for part in parts)

    def sizes_of_state(self, rows: Rows) -> list[Scalar]:
        """The sizes of the elements of the state, where it is wanted, from those of the rows of the motion itself."""
        if not self.options.whole:
            return []
        # Each element is a known number plus known multiples of rows.
        high, low = (
            self.equations.at(self.numbers).outputs(jax.tree.unflatten(self._member, [sign * row for row in rows]))
            for sign in (1.0, -1.0)
        )
        both = zip(high[: len(high) - self.integrals], low, strict=False)
        return [(jnp.abs(one) + jnp.abs(other)) / 2 for one, other in both]

    @property
    def time_scale(self) -> Scalar:
        """A typical time of the motion."""
        given, args = self.layout.problem.time_scale, self.layout.args(self.numbers)
        if given is not None:
            return given(args)
        span = self.clock.t1 - self.clock.t0
        # A lane that has no time ends where it starts, in any scale.
        return jnp.where(span == 0, 1.0, _SPAN * span)

    def scale_at_start(self, initial: Rows, slope: Rows) -> Scalar:
        """The time scale where a motion begins, for its first step: the span says little where it is far too long."""
        scale = self.time_scale
        if self.layout.problem.time_scale is not None:
            return scale
        motion = zip(initial[: self.width], slope[: self.width], strict=True)
        times = (jnp.abs(u) / jnp.maximum(jnp.abs(k), _TINY) for u, k in motion)
        # A number that is almost zero says nothing.
        told = (jnp.where(time < _LEAST * scale, jnp.inf, time) for time in times)
        return functools.reduce(jnp.minimum, (_LONGER * time for time in told), scale)

    def scale_near(self, step: Scalar, first: float) -> Scalar:
        """The time scale at a step: where the problem names none, no longer than such that `first` of it is the step.

        Args:
            step: the length that the error control would like.
            first: the first step, of the time scale.
        """
        scale = self.time_scale
        return scale if self.layout.problem.time_scale is not None else jnp.minimum(scale, step * (1 / first))

    @property
    def until(self) -> Derivatives:
        """How long a lane without an event goes on, with derivatives; the value is None where it does."""
        if not self.options.clock:
            return Derivatives(None, None, None, None)
        return self.equations.of(lambda _, motion: motion.clock.t1 - motion.clock.t0, ())
