"""The variational equations that carry derivatives along with the motion.

For directions ε and η in the space of parameters the state s is extended by ∂s/∂ε, ∂s/∂η and
∂²s/∂ε∂η. Only the vector field is differentiated (nested `jvp`), never the integration; the time
of the event follows by the implicit function theorem.
"""

import abc
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.motion import Augmented, Motion, OfMotion, event_function, events_of, of_event
from erosion.ode.signature import Signature
from erosion.ode.step_control import ARRIVED

_FLAT = 1e9  # times as much as the state errs the time of an event: its second derivatives have lost their digits
_FIXED = 1e-9  # of its terms: a first derivative that is smaller is zero by definition
ALIKE = 1e-9, 1e-7, 1e-6  # of their sizes: two states, their first derivatives and second ones are the same

Direction = int | Scalar
"""The place of an element among the elements of all numbers, see `Signature`; traced, or part of the program."""


class Derivatives(NamedTuple):
    """A quantity with its first and mixed second derivative along two directions."""

    value: PyTree
    by_first: PyTree
    by_second: PyTree
    mixed: PyTree


class Variational:
    """The state with its derivatives: at the start, its rate, and functions of it, for `order` 0, 1 or 2.

    The extended state is a tuple. Along one direction it has `order` + 1 parts. For two different
    directions at order 2 it has four: value, first, other, second.

    Args:
        signature: of the numbers.
        parameters: of one lane.
        order: number of derivatives, 0 to 2.
        directions: one direction, or two for a mixed second derivative.
        motion: from numbers to what is integrated; see `erosion.ode.reduction`.
    """

    def __init__(
        self,
        signature: Signature,
        parameters: Sequence[Number],
        order: int,
        directions: tuple[Direction, ...],
        motion: Callable[[Sequence[Number]], Motion],
    ) -> None:
        self.signature, self.parameters, self.order, self.directions = signature, list(parameters), order, directions
        self.at = motion
        self.along_two = order == 2 and len(directions) == 2
        # Once for a lane: to trace them takes as long as to trace a rate.
        self.units = [self._unit(direction) for direction in directions if order]
        self.changes = list(map(self._changes, directions, self.units))

    def initial(self) -> tuple[Augmented, ...]:
        """State and integrals at the start."""

        def start(_: object, motion: Motion) -> Augmented:
            state, integrals = motion.initial()
            return Augmented(state, tuple(jnp.asarray(begin, float) for begin in integrals))

        return self.pack(self.of(start, ()))

    @property
    def shares(self) -> list[float]:
        """Of their sizes: by so much a value and its tangents may differ from equal ones."""
        firsts = [ALIKE[1]] * (2 if self.along_two else min(self.order, 1))
        return [ALIKE[0], *firsts, *[ALIKE[2]] * (self.order == 2)]

    def rate(self, value_and_tangents: tuple[Augmented, ...]) -> tuple[Augmented, ...]:
        """The time derivative of a state."""
        return self.pack(self.of(lambda at, motion: motion.rate(at), value_and_tangents))

    def unscale(self, scaled: Derivatives) -> Derivatives:
        """Derivatives by the directions' units turned into derivatives by the parameters."""
        if self.order == 0:
            return scaled
        unit, other_unit = self.units[0], self.units[-1]
        first, other, second = (
            jax.tree.map(lambda part, size=size: part / size, parts)
            for parts, size in (
                (scaled.by_first, unit),
                (scaled.by_second, other_unit),
                (scaled.mixed, unit * other_unit),
            )
        )
        return Derivatives(scaled.value, first, other, second)

    def pack(self, derivatives: Derivatives) -> tuple[PyTree, ...]:
        """A value and its tangents, from these derivatives."""
        if self.along_two:
            return (derivatives.value, derivatives.by_first, derivatives.by_second, derivatives.mixed)
        return (derivatives.value, derivatives.by_first, derivatives.mixed)[: self.order + 1]

    def unpack(self, value_and_tangents: tuple[Any, ...]) -> Derivatives:
        """The derivatives of a value with its tangents."""
        if len(value_and_tangents) == 4:
            return Derivatives(*value_and_tangents)
        value, first, second = (*value_and_tangents, None, None)[:3] if value_and_tangents else ((), (), ())
        return Derivatives(value, first, first, second)

    def of(self, function: OfMotion, value_and_tangents: tuple[Augmented, ...]) -> Derivatives:
        """A function of a state and its motion, with its derivatives along the directions."""
        at = self.unpack(value_and_tangents)

        def value_at(parameters: Sequence[Number], state: PyTree) -> PyTree:
            return function(state, self.at(parameters))

        def value_and_first(parameters: Sequence[Number], state: PyTree, state_first: PyTree) -> tuple[PyTree, PyTree]:
            return self._along(0, value_at, parameters, (state,), (state_first,))

        if self.order == 0:
            return Derivatives(value_at(self.parameters, at.value), None, None, None)
        if self.order == 1:
            value, first = value_and_first(self.parameters, at.value, at.by_first)
            return Derivatives(value, first, first, None)
        (value, first), (other, second) = self._along(
            -1, value_and_first, self.parameters, (at.value, at.by_first), (at.by_second, at.mixed)
        )
        return Derivatives(value, first, other, second)

    def _along(
        self,
        which: int,
        function: Callable[..., PyTree],
        parameters: Sequence[Number],
        primals: tuple[PyTree, ...],
        tangents: tuple[PyTree, ...],
    ) -> tuple[PyTree, PyTree]:
        """`function(numbers, *primals)`, and its derivative where the numbers move along a direction."""
        changes = self.changes[which]

        def moved(some: dict[int, Number], *primals: PyTree) -> PyTree:
            return function([some.get(i, number) for i, number in enumerate(parameters)], *primals)

        return jax.jvp(moved, ({i: parameters[i] for i in changes}, *primals), (changes, *tangents))

    def _changes(self, direction: Direction, unit: Scalar) -> dict[int, Number]:
        """The changes of the numbers that move along a direction, by its unit."""
        changes: dict[int, Number] = {}
        signature = self.signature
        for i, (shape, dtype, offset) in enumerate(
            zip(signature.shapes, signature.dtypes, signature.offsets, strict=False)
        ):
            count = math.prod(shape)
            if dtype == "float64" and not (isinstance(direction, int) and not offset <= direction < offset + count):
                places = offset + np.arange(count, dtype=float).reshape(shape)
                is_scalar = isinstance(direction, int) and shape == ()
                changes[i] = unit if is_scalar else jnp.where(direction == places, unit, 0.0)
        return changes

    def _unit(self, direction: Direction) -> Scalar:
        """A significant change of a number: its size; 1 where that is zero.

        Derivatives by such units compare with the value itself, so that one tolerance fits all.
        """
        sizes = self.signature.parameter_scale(self.parameters)
        size: Scalar = 0.0
        for number, shape, offset in zip(sizes, self.signature.shapes, self.signature.offsets, strict=False):
            if isinstance(direction, int) and shape == ():
                size = number if direction == offset else size
            else:
                places = offset + np.arange(math.prod(shape), dtype=float).reshape(shape)
                size = size + jnp.sum(jnp.where(direction == places, number, 0.0))
        return lax.stop_gradient(jnp.where(size == 0, 1.0, size))


class AtEvent(NamedTuple):
    """Derivatives of the event's time and of the outputs there, and how much larger their errors may be."""

    time: Derivatives
    outputs: Derivatives
    amplification: Scalar


class EndTimeDependence(abc.ABC):
    """How functions of the end depend on the end's time.

    Args:
        equations: of the lane.
    """

    def __init__(self, equations: Variational) -> None:
        self.equations = equations

    @abc.abstractmethod
    def here(self, function: OfMotion) -> Derivatives:
        """A function of state and motion, with its derivatives at a fixed time."""

    @abc.abstractmethod
    def rate(self, function: OfMotion) -> Derivatives:
        """The same of its time derivative."""

    @abc.abstractmethod
    def lacking(self, lost: tuple[Augmented, ...]) -> "EndTimeDependence":
        """The same without the tangents that are lost, see `LostTangents`."""

    @abc.abstractmethod
    def amplification(self, event: OfMotion, rate: Scalar, time: Scalar) -> Scalar:
        """How many times larger the relative errors of the event's time may be than those of the state."""


class AlongFlow(EndTimeDependence):
    """Along the flow.

    Args:
        equations: of the lane.
        value_and_tangents: the state at the event, or shortly before it.
        time_to_event: from that state, where the rates are known only before the event; so short that derivatives are
            the same. None where it is always zero.
    """

    def __init__(
        self, equations: Variational, value_and_tangents: tuple[Augmented, ...], time_to_event: Scalar | None = None
    ) -> None:
        super().__init__(equations)
        self.value_and_tangents, self.time_to_event = value_and_tangents, time_to_event

    def here(self, function: OfMotion) -> Derivatives:
        """See `EndTimeDependence`."""
        here = self.equations.of(function, self.value_and_tangents)
        if self.time_to_event is None:
            return here
        flow = _along_flow(function)(self.value_and_tangents[0], self.equations.at(self.equations.parameters))
        return here._replace(
            value=jax.tree.map(
                lambda v, k: jnp.where(self.time_to_event == 0, v, v + self.time_to_event * k), here.value, flow
            )
        )

    def rate(self, function: OfMotion) -> Derivatives:
        """See `EndTimeDependence`."""
        return self.equations.of(_along_flow(function), self.value_and_tangents)

    def lacking(self, lost: tuple[Augmented, ...]) -> "AlongFlow":
        """See `EndTimeDependence`."""
        state = jax.tree.map(jnp.add, self.value_and_tangents, lost)
        return AlongFlow(self.equations, state, self.time_to_event)

    def curve(self, function: OfMotion) -> Any:
        """The second time derivative of a function's value."""
        here = self.equations.at(self.equations.parameters)
        return _along_flow(_along_flow(function))(self.value_and_tangents[0], here)

    def amplification(self, event: OfMotion, rate: Scalar, time: Scalar) -> Scalar:
        """The ratio g̈ t/ġ, large where the event function falls slowly."""
        return jnp.maximum(1.0, jnp.abs(self.curve(event) * time / rate))


def at_event(
    along: EndTimeDependence,
    event: Scalar,
    time: Scalar,
    outputs: OfMotion,
    time_to_end: Derivatives,
    happening: Sequence[Flag] = (),
) -> AtEvent:
    """Derivatives at the event, whose time depends on the parameters as well.

    With g the event function and R the rate of an output V along the flow, all at the event:
    t_ε = -g_ε/ġ;  V_ε = v_ε + R t_ε;  and for the second derivatives the chain rule once more.

    `amplification` is the ratio of the results' errors to the state's, times the ratio of the second derivative's
    terms to their sum.

    Args:
        along: how functions of the state there depend on time.
        event: index of the event; below 0 if none ended the motion.
        time: since the start.
        outputs: what is wanted there, numbers.
        time_to_end: the time at which a lane without an event ends, with its derivatives.
        happening: of each event whether it happens there, and last whether that time has come. Any of these may come
            first by a small change of a number: derivatives in which they differ are NaN.
    """
    each, equations = jax.tree.map, along.equations
    order, function = equations.order, event_function(event)
    wanted, g_rate = along.here(outputs), along.rate(events_of)
    # Where no event ended the motion its time is given.
    amplification = along.amplification(function, of_event(event, g_rate.value, 1.0), time)
    if order == 0:
        return AtEvent(Derivatives(time, None, None, None), wanted, amplification)
    g, r = along.here(events_of), along.rate(outputs)
    g_curve: Any = None
    r_curve: Any = None
    if order == 2:
        assert isinstance(along, AlongFlow)
        g_curve, r_curve = along.curve(events_of), along.curve(outputs)

    def sizes(*terms: PyTree) -> PyTree:
        """The greatest sizes of terms, and of the outputs."""
        return each(lambda *parts: functools.reduce(jnp.maximum, map(jnp.abs, parts)), wanted.value, *terms)

    def ending(pick: _Pick) -> tuple[Derivatives, Derivatives, Derivatives, Scalar]:
        """Derivatives of the time that is picked, and of the outputs there.

        Also the sizes of the terms of the latter, and how much the second ones cancel.
        """

        def time_of(by_events: Sequence[Scalar], given: Any) -> Scalar:
            return pick([-by / rate for by, rate in zip(by_events, g_rate.value, strict=True)], given)

        t_first, t_other = time_of(g.by_first, time_to_end.by_first), time_of(g.by_second, time_to_end.by_second)
        v_first = each(lambda v, flow: v + _in_time(flow, t_first), wanted.by_first, r.value)
        v_other = each(lambda v, flow: v + _in_time(flow, t_other), wanted.by_second, r.value)
        of_firsts = sizes(wanted.by_first), sizes(wanted.by_second)
        if order == 1:
            times = Derivatives(time, t_first, t_other, None)
            return times, Derivatives(wanted.value, v_first, v_other, None), Derivatives(None, *of_firsts, None), 1.0

        def chain(mixed: Scalar, first: Scalar, other: Scalar, curve: Scalar) -> list[Scalar]:
            both = _in_time(_in_time(curve, t_first), t_other)
            return [mixed, _in_time(first, t_other), _in_time(other, t_first), both]

        bends = [sum(chain(*parts)) for parts in zip(g.mixed, g_rate.by_first, g_rate.by_second, g_curve, strict=True)]
        t_second = time_of(bends, time_to_end.mixed)
        # So flat a function leaves no digits of them.
        t_second = jnp.where(amplification < _FLAT, t_second, jnp.nan)
        parts = wanted.value, v_first, v_other, wanted.mixed, r.value, r.by_first, r.by_second, r_curve
        v_second, of_second, worst = [], [], 1.0
        for value, first, other, second, flow, flow_first, flow_other, curve in zip(
            *map(jax.tree.leaves, parts), strict=True
        ):
            terms = [*chain(second, flow_first, flow_other, curve), _in_time(flow, t_second)]
            v_second.append(sum(terms[1:], terms[0]))
            # An output that is zero at its event by definition has the size of what it moves by until then.
            least = functools.reduce(jnp.maximum, map(jnp.abs, (value, first, other, v_second[-1], flow * time)))
            of_second.append(sum(map(jnp.abs, terms)))
            cancelled = of_second[-1] / least
            # What the event function fixes has no derivatives: all terms cancel, whatever the tolerance.
            fixed = (jnp.abs(first) < _FIXED * jnp.abs(flow * t_first)) & (
                jnp.abs(other) < _FIXED * jnp.abs(flow * t_other)
            )
            worst = jnp.maximum(worst, jnp.where(fixed, 1.0, cancelled))
        structure = jax.tree.structure(wanted.value)
        v_second, of_second = (jax.tree.unflatten(structure, leaves) for leaves in (v_second, of_second))
        outputs_there = Derivatives(wanted.value, v_first, v_other, v_second)
        terms = Derivatives(None, *of_firsts, sizes(of_second))
        return Derivatives(time, t_first, t_other, t_second), outputs_there, terms, worst

    def that_ends(times: Sequence[Scalar], given: Any) -> Scalar:
        found = of_event(event, times, 0.0)
        return found if given is None else jnp.where(event == ARRIVED, given, found)

    of_time, of_outputs, terms, cancelled = ending(that_ends)
    amplification = amplification * cancelled if order == 2 else amplification
    if not happening:
        return AtEvent(of_time, of_outputs, amplification)
    packed = [equations.pack(of_time), equations.pack(of_outputs)]
    sizes_of = [[time] * (len(packed[0]) - 1), equations.pack(terms)[1:]]
    lost = [[each(lambda _: jnp.asarray(False), member) for member in part[1:]] for part in packed]
    for i, happens in enumerate(happening):
        if i == len(g_rate.value) and time_to_end.value is None:
            break
        rivals = ending(functools.partial(_one_of, i))[:2]
        happens = happens & (event != (i if i < len(g_rate.value) else ARRIVED))
        for k, (one, other) in enumerate(zip(packed, map(equations.pack, rivals), strict=True)):
            differing = unlike(one[1:], other[1:], sizes_of[k], equations.shares[1:])
            lost[k] = each(lambda flag, differs, happens=happens: flag | (happens & differs), lost[k], differing)
    times, results = (
        equations.unpack((part[0], *without(part[1:], flags, order))) for part, flags in zip(packed, lost, strict=True)
    )
    return AtEvent(times, results, amplification)


_Pick = Callable[[Sequence[Scalar], Any], Scalar]
"""One of the times of all events, or a given one at which a motion ends."""


def _one_of(place: int, times: Sequence[Scalar], given: Any) -> Scalar:
    return [*times, given][place]


def _in_time(rate: Scalar, time: Scalar) -> Scalar:
    """What a rate adds in a time; nothing where it is zero, even if the time is not known."""
    return rate * jnp.where(rate == 0, 0.0, time)


def unlike(
    ones: Sequence[PyTree], others: Sequence[PyTree], sizes: Sequence[PyTree], shares: Sequence[float]
) -> list[PyTree]:
    """Of the tangents of a number whether two are unlike, relative to their sizes and others; or one is not known."""

    def each(one: Scalar, other: Scalar, value: Scalar, share: float) -> Flag:
        return differ(one, other, share, value) | jnp.isnan(one) | jnp.isnan(other)

    return [
        jax.tree.map(functools.partial(each, share=share), one, other, size)
        for one, other, size, share in zip(ones, others, sizes, shares, strict=True)
    ]


def without(tangents: Sequence[PyTree], lost: Sequence[PyTree], order: int) -> list[PyTree]:
    """Tangents without those that are lost: a second one is, where a first one is."""
    if order == 2:
        lost = [*lost[:-1], jax.tree.map(lambda *flags: functools.reduce(jnp.logical_or, flags), *lost)]
    pairs = zip(tangents, lost, strict=True)
    return [jax.tree.map(lambda u, gone: jnp.where(gone, jnp.nan, u), part, flags) for part, flags in pairs]


def differ(one: Scalar, other: Scalar, share: float, size: Scalar) -> Flag:
    """Whether two numbers are unlike, relative to their sizes and a part of another."""
    return jnp.abs(one - other) > share * (jnp.abs(one) + jnp.abs(other)) + ALIKE[0] * jnp.abs(size)


def _along_flow(function: OfMotion) -> OfMotion:
    """The time derivative of a function of the state."""
    return lambda at, motion: jax.jvp(lambda a: function(a, motion), (at,), (motion.rate(at),))[1]
