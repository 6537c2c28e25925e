"""A hybrid trajectory: segments of a motion, and the events between them.

At each event the state gets its total derivatives, those of the event's time included; the reset is pushed forward over
them, and the next segment starts on its own clock. So there are no saltation matrices.

Several events may happen at one time. Those whose functions come to zero together happen in their order, each at its
own time, which is that of the first in its value alone: between two resets is a motion that takes no time. Where
another order gives another state, derivatives by what moves one of these times against the other are NaN. Then the
event functions are asked again, in their order, until no reset has taken another one through zero.
"""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from erosion.arguments import Flag, Scalar
from erosion.ode import step_control
from erosion.ode.event_location import Segment, how_many
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.motion import Augmented, Motion, event_function, of_event, outputs_of
from erosion.ode.segments import SegmentLoop, Written
from erosion.ode.step_control import ADVANCING, ARRIVED, ENDED, FAILED, FIRST_STEP, MOMENT, SLIDES, ULPS, UNFINISHED
from erosion.ode.switches import SwitchedMotion
from erosion.ode.variational import (
    ALIKE,
    AlongFlow,
    AtEvent,
    Derivatives,
    EndTimeDependence,
    at_event,
    differ,
    unlike,
    without,
)

_ACCUMULATED = (
    1e-11  # of the time scale, and of the time so far: where an event follows itself sooner, events accumulate
)
_ROUNDING = 1e-14  # of the time so far: where any event follows sooner, they do
_RESIDUAL = 4.0  # times what an event function is at its event: if it is no more after the resets, it is zero
_RESTS = 1e-6  # of the time scale, and of the time so far: where an event follows sooner, and its function rises
_ENDLESS = 100  # rounds of events that resets make happen
_SLIDES = 20  # switches at one time: the rates point to one from both sides
_ORDERED = 6  # events and switches at one time, whose 720 orders are compared; more have no derivatives by their times
_RESTING = 1e-9  # of its rate before a switch: a bound that falls as slowly after it rests there

_NO_TIME = Derivatives(None, None, None, None)


class Instant(NamedTuple):
    """A state, and what has happened to it at one time.

    Args:
        value_and_tangents: the state after the events so far, with its total derivatives.
        met: the same before the last of them.
        elapsed: the time since the lane began, with its tangents.
        soonest, latest: the least and greatest of each of these numbers, of all events at this time.
        last: the last event.
        count: events of the lane so far.
        happened: whether an event or a switch happened at this time.
        slides: whether the rates point to a switch from both sides.
        survives: whether the motion goes on after the last event.
        at_once: of each event whether it happens at this time.
        written: by the recorders.
    """

    value_and_tangents: tuple[Augmented, ...]
    met: tuple[Augmented, ...]
    elapsed: tuple[Scalar, ...]
    soonest: tuple[Scalar, ...]
    latest: tuple[Scalar, ...]
    last: Scalar
    count: Scalar  # pyrefly: ignore
    happened: Flag
    slides: Flag
    survives: Flag
    at_once: Sequence[Flag]
    written: Written

    def at_own_time(
        self, later: Flag, value_and_tangents: tuple[Augmented, ...], since: tuple[Scalar, ...]
    ) -> "Instant":
        """With the state at an event, if it has its own time, later by as much."""
        elapsed = chosen(later, tuple(map(jnp.add, self.elapsed, since)), self.elapsed)
        return self._replace(
            value_and_tangents=chosen(later, value_and_tangents, self.value_and_tangents),
            elapsed=elapsed,
            soonest=tuple(map(jnp.minimum, self.soonest, elapsed)),
            latest=tuple(map(jnp.maximum, self.latest, elapsed)),
        )


class _Trajectory(NamedTuple):
    """A hybrid trajectory under way.

    Args:
        goes_on: whether there is another segment.
        segment: the last one; its state is that from which the next begins, or at the end.
        elapsed: time since the start, with its tangents.
        amplification: the greatest so far.
        hops: whether the state is about to return to an event that it has just left, so soon that rounding may hide it.
        written: by the recorders so far.
    """

    goes_on: Flag
    segment: Segment
    elapsed: tuple[Scalar, ...]
    amplification: Scalar
    hops: Flag
    written: Written


class Transitions:
    """What events do to a state.

    Args:
        problem: the equations.
        loop: with the recorders.
    """

    def __init__(self, problem: LaneEquations, loop: SegmentLoop) -> None:
        self.problem, self.loop, self.here = problem, loop, problem.equations.at(problem.parameters)
        self.most = problem.clock.max_events
        self.own, self.scheduled = range(problem.own_events), problem.signature.problem.scheduled()
        self.bounds = range(problem.own_events, len(problem.directions))
        # Whether derivatives are compared with those of another order of events.
        self.compares = problem.order > 0 and not problem.options.one_sided

    def moment(self, instant: Instant) -> Scalar:
        """How long before its time an event at times happens: a later one does not accumulate."""
        return jnp.maximum(_ACCUMULATED * self.problem.time_scale, _ROUNDING * instant.elapsed[0])

    def due(self, event: int, value: Scalar, instant: Instant) -> Flag:
        """Whether an event at times happens now, from the value of its function."""
        return value <= self.moment(instant) if event in self.scheduled else jnp.asarray(False)

    def passed(self, values: Sequence[Scalar], instant: Instant) -> Flag:
        """Whether a lane has passed the time of an event, from the values of their functions."""
        flags = [values[i] < -self.moment(instant) for i in self.scheduled]
        return functools.reduce(jnp.logical_or, flags, jnp.asarray(False))

    def rates(self, at: Augmented) -> list[Scalar]:
        """The rates of the event functions."""
        return jax.jvp(self.here.events, (at,), (self.here.rate(at),))[1]

    def ends(self, instant: Instant) -> Flag:
        """Whether a lane ends with the events so far."""
        return jnp.logical_not(instant.survives & (instant.count < self.most))

    def at_event(self, instant: Instant, event: Scalar, later: Flag) -> Instant:
        """At an event's own time, if that may be `later` in its derivatives than the time of the event before it.

        Where both times move alike nothing changes: there the rates of the mode before need not be defined.
        """
        equations = self.problem.equations
        if not self.problem.order:
            return instant
        along = AlongFlow(equations, instant.value_and_tangents)
        at_it = at_event(along, event, 0.0 * instant.elapsed[0], _itself, _NO_TIME)
        _, *moved = equations.pack(along.here(event_function(event)))
        size = jnp.abs(along.rate(event_function(event)).value * instant.elapsed[0])
        both = zip(moved, self.problem.equations.shares[1:], strict=True)
        alike = functools.reduce(jnp.logical_and, [jnp.abs(part) <= share * size for part, share in both])
        return instant.at_own_time(later & ~alike, equations.pack(at_it.outputs), equations.pack(at_it.time))

    def fired(self, instant: Instant, event: Scalar, fires: Flag) -> Instant:
        """With an event of the problem, if it `fires`."""
        equations, value_and_tangents = self.problem.equations, instant.value_and_tangents
        at_once = [flag | (fires & (event == i)) for i, flag in enumerate(instant.at_once)]
        written = self.loop.after_event(instant.written, event, fires, at_once, value_and_tangents, instant.elapsed)
        chains = [i for i in self.own if i in self.problem.chains]

        def after(at: Augmented, motion: Motion) -> Augmented:
            results = at
            for i in chains:
                results = chosen(event == i, motion.after(i, at), results)
            return results

        ends = [self.here.ends(i, value_and_tangents[0]) if i in chains else jnp.asarray(True) for i in self.own]
        survives = jnp.logical_not(_flag_of(event, ends))
        return instant._replace(
            value_and_tangents=chosen(
                fires, equations.pack(equations.of(after, value_and_tangents)), value_and_tangents
            ),
            met=chosen(fires, value_and_tangents, instant.met),
            last=jnp.where(fires, event, instant.last),
            count=instant.count + jnp.where(fires, 1, 0),
            happened=instant.happened | fires,
            survives=jnp.where(fires, survives, instant.survives),
            at_once=at_once,
            written=written,
        )

    def next_of(self, at_once: Sequence[Flag], place: Scalar) -> Scalar:
        """The event at a place among those that are at once, switches before the others; -1 beyond the last."""
        event = 0 * place - 1
        for i in (*self.bounds, *self.own):
            event = jnp.where(at_once[i] & (place == 0), i, event)
            place = place - jnp.where(at_once[i], 1, 0)
        return event

    def in_turn(self, instant: Instant, segment: Segment, first: Scalar, order: Scalar) -> Instant:
        """With the events that come to zero together, in one of their orders.

        The state is that at the first one's time. Each after the first happens where its function falls still after
        the resets before it.

        Args:
            instant: before them.
            segment: to the first of them.
            first: it happens in any case.
            order: below n! for n of them; in the mixed base of n, n - 1, … 1 its digits are places among those left.
                0 is the order of the problem, switches before the others.
        """
        falling, before = self.rates(instant.value_and_tangents[0]), instant

        def turn(at: tuple[Instant, list[Flag], Scalar]) -> tuple[Instant, list[Flag], Scalar]:
            instant, left, order = at
            count = how_many(left)
            event = self.next_of(left, lax.rem(order, count))
            rates = self.rates(instant.value_and_tangents[0])
            still = (event == first) | (of_event(event, rates, 0.0) * of_event(event, falling, 0.0) > 0)
            fires = still & instant.survives & (instant.count < self.most)
            instant = self.at_event(instant, event, fires & ((event != first) | instant.happened))
            if self.bounds:
                instant = self.switched(instant, event, fires & (event >= self.problem.own_events))
            instant = self.fired(instant, event, fires & (event < self.problem.own_events))
            return instant, [flag & (event != i) for i, flag in enumerate(left)], lax.div(order, count)

        start = instant, list(segment.at_once), order
        instant, *_ = lax.while_loop(lambda at: functools.reduce(jnp.logical_or, at[1]), turn, start)
        if not self.bounds:
            return instant
        same = instant.count == before.count
        assert self.problem.switches is not None
        # Beyond a bound of two sides is the same bound, but the next whole number has others.
        both = zip(self.bounds, self.problem.switches.two_sided, strict=True)
        located = [same & segment.at_once[i] if two_sided else jnp.asarray(False) for i, two_sided in both]
        return self.in_modes(instant, located, [falling[i] for i in self.bounds])

    def switched(self, instant: Instant, bound: Scalar, fires: Flag, *, jumps: Flag = False) -> Instant:
        """With a switch, if it `fires`.

        Args:
            instant: before it.
            bound: the index of its event.
            fires: whether it happens.
            jumps: whether its function jumped, and did not fall.
        """
        equations, value_and_tangents = self.problem.equations, instant.value_and_tangents
        place = bound - self.problem.own_events

        def beyond(at: Augmented, motion: Motion) -> Augmented:
            assert isinstance(motion, SwitchedMotion)
            return motion.switched(place, jumps, at)

        after = equations.pack(equations.of(beyond, value_and_tangents))
        at_once = [
            flag | (fires & (bound == i)) if i in self.bounds else flag for i, flag in enumerate(instant.at_once)
        ]
        return instant._replace(
            value_and_tangents=chosen(fires, after, value_and_tangents),
            met=chosen(fires, value_and_tangents, instant.met),
            happened=instant.happened | fires,
            at_once=at_once,
        )

    def in_modes(self, instant: Instant, located: Sequence[Flag], before: Sequence[Scalar]) -> Instant:
        """With the switches after which the state is in its modes: no bound is below zero, or at zero and falls.

        A bound without a rate falls by its second derivative.

        Where there is no end of them, the rates point to a switch from both sides.

        Args:
            instant: after events.
            located: of each bound whether it has just come to zero, whatever its rounding.
            before: the rates of the bounds before the events.
        """
        scale, here = self.problem.time_scale, self.here
        assert isinstance(here, SwitchedMotion)

        def due(instant: Instant) -> tuple[Scalar, Flag]:
            """The first bound that the state is beyond, or -1, and whether it is far beyond it."""
            at = instant.value_and_tangents[0]
            values = here.events(at)
            rates, bends = jax.jvp(self.rates, (at,), (here.rate(at),))
            index, jumps = 0 * instant.last - 1, jnp.asarray(False)
            sizes = here.sizes_of_bounds(at)
            for j, i in reversed(list(enumerate(self.bounds))):
                is_located, least = located[j], _RESTING * jnp.abs(before[j])
                near = MOMENT * scale * jnp.abs(rates[i]) + ULPS * sizes[j]
                far = jnp.logical_and(values[i] < -near, jnp.logical_not(is_located))
                falls = (rates[i] < -least) | ((rates[i] <= least) & (scale * bends[i] < -least))
                leaves = (is_located | (values[i] <= near)) & falls
                index, jumps = jnp.where(far | leaves, i, index), jnp.where(far | leaves, far, jumps)
            return index, jumps

        def goes_on(at: tuple[Instant, tuple[Scalar, Flag], Scalar]) -> Flag:
            instant, (index, _), rounds = at
            return (index >= 0) & instant.survives & (instant.count < self.most) & (rounds < _SLIDES)

        def switches(
            at: tuple[Instant, tuple[Scalar, Flag], Scalar],
        ) -> tuple[Instant, tuple[Scalar, Flag], Scalar]:
            instant, (index, jumps), rounds = at
            instant = self.switched(instant, index, index >= 0, jumps=jumps)
            return instant, due(instant), rounds + 1

        instant, _, rounds = lax.while_loop(goes_on, switches, (instant, due(instant), 0 * instant.count))
        return instant._replace(slides=instant.slides | (rounds >= _SLIDES))

    def commuting(self, instant: Instant, segment: Segment, along: EndTimeDependence, before: Instant) -> Instant:
        """An instant without the derivatives that another order of its events would change.

        Args:
            instant: after all events.
            segment: to the first of them.
            along: its end.
            before: where the segment began, in time.
        """
        equations = self.problem.equations
        if not self.compares or len(self.problem.directions) < 2:
            return instant

        def compared(instant: Instant, at_end: Flag) -> list[tuple[Augmented, Scalar]]:
            """The state at a fixed time; where the lane ends, the state there and the time."""
            since = equations.unpack(tuple(-part for part in instant.elapsed))
            along = AlongFlow(equations, instant.value_and_tangents)
            fixed = at_event(along, jnp.full((), ARRIVED), instant.elapsed[0], _itself, since).outputs
            states = chosen(at_end, instant.met, equations.pack(fixed))
            return [(state, jnp.where(at_end, time, 0.0)) for state, time in zip(states, instant.elapsed, strict=True)]

        def at_own_time(event: Scalar) -> Instant:
            """The state at an event, before any other of this time."""
            end = at_event(along, event, segment.time, _itself, _NO_TIME)
            time = tuple(map(jnp.add, before.elapsed, equations.pack(end.time)))
            state = equations.pack(end.outputs)
            return before._replace(value_and_tangents=state, elapsed=time, soonest=time, latest=time)

        def checked() -> Instant:
            count, is_end = how_many(segment.at_once), self.ends(instant)
            one = compared(instant, is_end)

            def with_next(at: tuple[Scalar, tuple[Scalar, ...], tuple[Scalar, ...]]) -> Any:
                place, soonest, latest = at
                time = at_own_time(self.next_of(segment.at_once, place)).elapsed
                return place + 1, tuple(map(jnp.minimum, soonest, time)), tuple(map(jnp.maximum, latest, time))

            # Those too that do not happen, after the last one of a lane: in another order they do.
            begin = 0 * count, instant.soonest, instant.latest
            _, soonest, latest = lax.while_loop(lambda at: at[0] < count, with_next, begin)

            def lost(order: Scalar) -> tuple[Flag, list[list[PyTree]]]:
                """Whether a tangent moves events apart, and the tangents of state and time that an order changes."""
                first = self.next_of(segment.at_once, lax.rem(order, count))
                other = self.in_turn(at_own_time(first), segment, first, order)
                other_ends = self.ends(other)
                two = compared(other, other_ends)
                unknown = (count > _ORDERED) | (is_end != other_ends)
                jumps = (
                    jax.tree.map(lambda a, b: differ(a, b, ALIKE[0], 0.0) | unknown, one[0][0], two[0][0]),
                    differ(one[0][1], two[0][1], ALIKE[0], 0.0) | (unknown & (is_end | other_ends)),
                )
                apart = self.apart(zip(soonest, latest, other.soonest, other.latest, strict=True), 0.0)
                tangents = unlike(one[1:], two[1:], [one[0]] * len(one[1:]), equations.shares[1:])
                both = [jax.tree.map(lambda *flags, moves=moves: moves & (flags[0] | flags[1]), jumps, each)
                        for moves, each in zip(apart, tangents, strict=True)]  # fmt: skip
                return functools.reduce(jnp.logical_or, apart), list(map(list, zip(*both, strict=True)))

            def also(so_far: tuple[Scalar, Flag, list[list[PyTree]]]) -> tuple[Scalar, Flag, list[list[PyTree]]]:
                order, moves, flags = so_far
                apart, more = lost(order)
                return order - 1, moves | apart, jax.tree.map(jnp.logical_or, flags, more)

            # The reverse first: between it and the own order each event comes before and after each other one. If no
            # tangent moves them apart in both, none does.
            orders = of_event(count, [math.factorial(n) for n in range(_ORDERED + 1)], jnp.asarray(2))
            none = jax.tree.map(lambda _: jnp.asarray(False), list(map(list, zip(*one[1:], strict=True))))
            start = orders - 1, jnp.asarray(False), none

            def goes_on(so_far: tuple[Scalar, Flag, list[list[PyTree]]]) -> Flag:
                order, moves, _ = so_far
                return (order > 0) & (moves | (order == orders - 1))

            *_, (states, times) = lax.while_loop(goes_on, also, start)
            return self.lacking(instant, states, times)

        return lax.cond(segment.several, checked, lambda: instant)

    def apart(self, times: Iterable[tuple[Scalar, ...]], size: Scalar) -> list[Flag]:
        """Of each tangent whether it moves some of the events at one time against others, or against the end.

        Args:
            times: and their tangents, each of all that happens at one time.
            size: of these times.
        """
        _, *tangents = times
        apart: list[Flag] = [
            differ(functools.reduce(jnp.minimum, each), functools.reduce(jnp.maximum, each), share, size)
            | functools.reduce(jnp.logical_or, map(jnp.isnan, each))
            for each, share in zip(tangents, self.problem.equations.shares[1:], strict=True)
        ]
        if self.problem.order == 2:
            apart[-1] = functools.reduce(jnp.logical_or, apart)
        return apart

    def lacking(self, instant: Instant, states: list[PyTree], times: list[Flag]) -> Instant:
        """An instant without some tangents of the state, and of the time."""
        order = self.problem.order

        def of(member: tuple[PyTree, ...], lost: list[PyTree]) -> tuple[PyTree, ...]:
            return member[0], *without(member[1:], lost, order)

        return instant._replace(
            value_and_tangents=of(instant.value_and_tangents, states), met=of(instant.met, states),
            elapsed=of(instant.elapsed, times),
        )  # fmt: skip

    def two_sided_at_end(self, instant: Instant, met: Instant, arrives: Flag, time_to_end: Derivatives) -> Instant:
        """Without the derivatives that events exactly at the end of the lane have on one side alone.

        Args:
            instant: after the events.
            met: before them.
            arrives: whether the lane would end there without them.
            time_to_end: when that is.
        """
        equations = self.problem.equations
        if not self.compares or time_to_end.value is None:
            return instant
        late, stops = equations.pack(time_to_end), self.ends(instant)

        def ended(at: Instant) -> tuple[tuple[Augmented, ...], Augmented]:
            remaining = jax.tree.map(jnp.subtract, time_to_end, equations.unpack(at.elapsed))
            along = AlongFlow(equations, at.value_and_tangents)
            end = at_event(along, jnp.full((), ARRIVED), at.elapsed[0], _itself, remaining)
            return equations.pack(end.outputs), along.curve(_itself)

        def checked() -> Instant:
            (one, curve), (two, other) = ended(instant), ended(met)
            one = chosen(stops, instant.met, one)
            # The event is as near the end as rounding says: by so much the rates have changed.
            size = jnp.abs(self.problem.clock.t0) + late[0]
            rounding = late[0] * (MOMENT * self.problem.time_scale + ULPS * size)
            least = jax.tree.map(lambda a, b: rounding * (jnp.abs(a) + jnp.abs(b)), curve, other)
            jumps = jax.tree.map(lambda a, b: differ(a, b, ALIKE[0], 0.0), one[0], two[0])
            if self.problem.switches is not None:
                # A mode jumps where nothing that is wanted does.
                rows, modes = len(self.problem.switches.moves), self.problem.switches.count
                jumps = jumps._replace(state=(*jumps.state[:rows], *[jnp.asarray(False)] * modes))
            apart = self.apart(zip(instant.soonest, instant.latest, late, strict=True), late[0])
            tangents = unlike(one[1:], two[1:], [one[0]] * len(one[1:]), equations.shares[1:])
            states = [
                jax.tree.map(
                    lambda a, b, differs, least, jump, moves=moves: moves
                    & (jump | (differs & ~(jnp.abs(a - b) <= least))),
                    *each, least, jumps,
                )
                for *each, moves in zip(one[1:], two[1:], tangents, apart, strict=True)
            ]  # fmt: skip
            return self.lacking(instant, states, [stops & moves for moves in apart])

        return lax.cond(arrives & instant.happened, checked, lambda: instant)

    def two_sided_at_start(self, value_and_tangents: tuple[Augmented, ...]) -> tuple[Augmented, ...]:
        """A state at the start without the derivatives that a break exactly there has on one side alone."""
        equations, here = self.problem.equations, self.here
        if not self.problem.order or not self.bounds:
            return value_and_tangents
        assert isinstance(here, SwitchedMotion)
        at, scale = value_and_tangents[0], self.problem.time_scale
        values, rates, sizes = here.events(at), self.rates(at), here.sizes_of_bounds(at)
        moved = equations.pack(equations.of(lambda at, motion: motion.events(at), value_and_tangents))[1:]
        flow = jax.tree.leaves(equations.rate(value_and_tangents))
        lost = [jnp.asarray(False) for _ in moved]
        for j, i in enumerate(self.bounds):
            near = MOMENT * scale * jnp.abs(rates[i]) + ULPS * sizes[j]

            def beyond(at: Augmented, motion: Motion, j: int = j) -> Augmented:
                assert isinstance(motion, SwitchedMotion)
                return motion.switched(jnp.asarray(j), jnp.asarray(False), at)

            other = jax.tree.leaves(equations.rate(equations.pack(equations.of(beyond, value_and_tangents))))
            jumps = [differ(*pair, ALIKE[0], 0.0) for pair in zip(flow, other, strict=True)]
            width = self.problem.width
            breaks, bends = (
                functools.reduce(jnp.logical_or, those) for those in (jumps[:width], jumps[: len(jumps) - width])
            )
            moves = [(jnp.abs(values[i]) <= near) & (jnp.abs(part[i]) > near) for part in moved]
            for k in range(len(moved)):
                is_second = equations.order == 2 and k == len(moved) - 1
                gone = bends & functools.reduce(jnp.logical_or, moves) if is_second else breaks & moves[k]
                lost[k] = lost[k] | gone
        pairs = zip(value_and_tangents[1:], lost, strict=True)
        others = [jax.tree.map(lambda u, gone=gone: jnp.where(gone, jnp.nan, u), member) for member, gone in pairs]
        return value_and_tangents[0], *others

    def settled(
        self, instant: Instant, before: Sequence[Scalar], flat: Sequence[Flag] | None = None, *, begins: bool
    ) -> tuple[Instant, Flag]:
        """With the events whose functions a reset takes through zero, and whether they are without end.

        Also with those at times that have come, which have an end.

        Args:
            instant: after the events that happened by themselves.
            before: the event functions before their resets; 0 of those that happened. Without bounds.
            flat: of each whether it has rested at zero before that, as max(x, 0) does; None where no mode may end it.
            begins: whether a lane begins there.
        """

        def crosses(i: int, old: Scalar, new: Scalar) -> Flag:
            if i in self.scheduled:
                return jnp.asarray(False)
            if self.problem.directions[i]:
                return (old > 0) & (new <= 0)
            return (old * new < 0) | ((old != 0) & (new == 0))

        def values(instant: Instant) -> list[Scalar]:
            return self.here.events(instant.value_and_tangents[0])[: len(self.own)]

        def due(instant: Instant, old: Sequence[Scalar], rested: Sequence[Flag]) -> tuple[list[Flag], list[Flag]]:
            """Of each event whether a reset has taken it through zero, and whether its time has come."""
            now = values(instant)
            crossed = [crosses(i, *pair) for i, pair in enumerate(zip(old, now, strict=True))]
            if flat is not None:
                rates = zip(rested, self.rates(instant.value_and_tangents[0]), self.problem.directions, strict=False)
                leaves = [flag & (rate < 0 if direction else rate != 0) for flag, rate, direction in rates]
                crossed = [one | other for one, other in zip(crossed, leaves, strict=False)]
            come = [self.due(i, value, instant) & (instant.happened | begins) for i, value in enumerate(now)]
            return crossed, come

        def goes_on(state: tuple[Instant, list[Scalar], list[Flag], Flag, Scalar, Scalar]) -> Flag:
            instant, old, rested, _, event, rounds = state
            crossed, come = due(instant, old, rested)
            happens = functools.reduce(jnp.logical_or, [*crossed, *come], jnp.asarray(False))
            begun = happens & instant.survives & (instant.count < self.most) & (rounds < _ENDLESS)
            return begun | (event > 0)

        def asked(
            state: tuple[Instant, list[Scalar], list[Flag], Flag, Scalar, Scalar],
        ) -> tuple[Instant, list[Scalar], list[Flag], Flag, Scalar, Scalar]:
            instant, old, rested, by_resets, event, rounds = state
            crossed, come = (_flag_of(event, flags) for flags in due(instant, old, rested))
            at_zero = of_event(event, values(instant), 1.0) == 0
            at_zero = at_zero if begins else jnp.logical_and(at_zero, ~come)
            instant = self._also(instant, event, crossed | come, at_zero=at_zero, own_time=come)
            pairs = enumerate(zip(old, values(instant), strict=True))
            asked_now: list[Scalar] = [jnp.where(event == i, new, value) for i, (value, new) in pairs]
            by_resets, within = by_resets | crossed, jnp.asarray(event < len(before) - 1)
            rest: list[Flag] = [jnp.logical_and(flag, within) for flag in rested]
            event, rounds = jnp.where(within, event + 1, 0), rounds + jnp.where(~within & by_resets, 1, 0)
            return instant, asked_now, rest, jnp.logical_and(by_resets, within), event, rounds

        none, no = 0 * instant.count, jnp.asarray(False)
        begin = instant, list(before), list(flat or ()), no, none, none
        instant, *_, rounds = lax.while_loop(goes_on, asked, begin)
        return instant, rounds >= _ENDLESS

    def at_start(self, instant: Instant) -> tuple[Instant, Flag]:
        """With the events at whose functions a lane begins, or past them, and whether they are without end."""
        before, past = self.here.events(instant.value_and_tangents[0])[: len(self.own)], self._past(instant)

        def asked(at: tuple[Instant, Scalar]) -> tuple[Instant, Scalar]:
            instant, event = at
            value = of_event(event, before, 0.0)
            own_time = _flag_of(event, [jnp.asarray(i in self.scheduled) for i in self.own]) & (value != 0)
            happens = _flag_of(event, past) & _flag_of(event, self._past(instant))
            return self._also(instant, event, happens, at_zero=value == 0, own_time=own_time), event + 1

        instant, _ = lax.while_loop(lambda at: at[1] < len(self.own), asked, (instant, 0 * instant.count))
        before = [jnp.where(*each) for each in zip(past, [0.0] * len(past), before, strict=True)]
        return self.settled(instant, before, begins=True)

    def _past(self, instant: Instant) -> list[Flag]:
        """Of each event whether it happens where a lane begins."""
        values = self.here.events(instant.value_and_tangents[0])
        due = [self.due(i, values[i], instant) for i in self.own]
        if not self.problem.options.fires:
            return due
        past = self.loop.past_at_start(jax.tree.leaves(instant.value_and_tangents))
        return [due[i] if i in self.scheduled else past[i] for i in self.own]

    def _also(self, instant: Instant, event: Scalar, happens: Flag, *, at_zero: Flag, own_time: Flag) -> Instant:
        """With an event for which no segment ends, if it `happens`; the way back does not know it."""
        fires = happens & instant.survives & (instant.count < self.most)
        instant = instant._replace(written=self.loop.after_event_at_once(instant.written, fires))
        instant = self.at_event(self._edged(instant, event, fires & at_zero), event, fires & own_time)
        instant = self.fired(instant, event, fires)
        if not self.bounds:
            return instant
        # The switches that the reset makes.
        none = [jnp.asarray(False) for _ in self.bounds]
        return self.in_modes(instant, none, [0.0 * instant.elapsed[0] for _ in self.bounds])

    def stands(
        self, instant: Instant, falling: Sequence[Scalar], zero: Sequence[Flag], typical: Scalar
    ) -> tuple[Flag, Flag]:
        """Whether a body stands on an event that has happened: it is pulled through, and hardly rises before.

        Also whether it hops: it rises, and is back soon.

        Args:
            instant: after all events.
            falling: the rates of the event functions before them.
            zero: of each whether it is zero after them, but for rounding.
            typical: a typical time.
        """
        stands = hops = jnp.asarray(False)
        if not any(i in self.problem.chains for i in self.own):
            return stands, hops
        at = instant.value_and_tangents[0]
        values = [jnp.where(is_zero, 0.0, value) for is_zero, value in zip(zero, self.here.events(at), strict=True)]
        rates, bends = jax.jvp(self.rates, (at,), (self.here.rate(at),))
        for event, value, rate, bend, before, direction in zip(
            instant.at_once, values, rates, bends, falling, self.problem.directions[: len(self.own)], strict=False
        ):
            pull = -bend if direction else jnp.where(before == 0, jnp.abs(bend), bend * jnp.sign(before))
            height = jnp.maximum(jnp.abs(value), pull * (_ACCUMULATED * typical) ** 2)
            near = (jnp.abs(value) <= pull * (_RESTS * typical) ** 2) & (pull * typical > _RESTS * jnp.abs(before))
            stands = stands | (event & near & (rate * rate <= _RESIDUAL * pull * height))
            hops = hops | (event & near & (jnp.abs(rate) <= _RESTS * pull * typical))
        return stands, hops

    def _edged(self, instant: Instant, event: Scalar, at_zero: Flag) -> Instant:
        """Without the derivatives that decide whether an event happens now or, as its function is zero, soon."""
        equations = self.problem.equations
        if not self.problem.order:
            return instant
        moved = equations.pack(equations.of(event_function(event), instant.value_and_tangents))
        lost = [at_zero & (part != 0) for part in moved[1:]]
        if equations.order == 2:
            lost[-1] = functools.reduce(jnp.logical_or, lost)
        pairs = zip(instant.value_and_tangents[1:], lost, strict=True)
        value_and_tangents = [
            jax.tree.map(lambda u, gone=gone: jnp.where(gone, jnp.nan, u), member) for member, gone in pairs
        ]
        return instant._replace(value_and_tangents=(instant.value_and_tangents[0], *value_and_tangents))


def trajectory(problem: LaneEquations, loop: SegmentLoop) -> tuple[Segment, AtEvent, Written]:
    """Integrate one lane through the events that it survives: its last segment, and its end with derivatives."""
    equations, time_to_end, transitions = problem.equations, problem.time_to_end, Transitions(problem, loop)
    zero = 0.0 * problem.time_scale
    control = step_control.begin(problem.time_scale, jnp.asarray(True), jnp.asarray(True), FIRST_STEP)
    none, no = 0 * control.mode, jnp.asarray(False)
    nothing = [no] * len(problem.directions)
    initial, written = problem.value_and_tangents(problem.initial), [recorder.begin() for recorder in loop.recorders]
    elapsed = tuple(zero for _ in initial)
    sizes = problem.method.sizes_at_start(problem.initial, None)
    start = Segment(control, initial, none - 1, zero, none, nothing, no, sizes, nothing)

    def ended(
        instant: Instant, endless: Flag, segment: Segment, amplification: Scalar, accumulates: Flag, hops: Flag
    ) -> _Trajectory:
        more = instant.happened & instant.survives & (instant.count < problem.clock.max_events)
        stops, control = accumulates | endless | instant.slides, segment.control
        control = control._replace(
            mode=jnp.where(more & stops, UNFINISHED, control.mode),
            event=jnp.where(more & instant.slides, SLIDES, control.event),
        )
        goes_on = more & jnp.logical_not(stops)
        value_and_tangents = chosen(goes_on, instant.value_and_tangents, instant.met)
        segment = segment._replace(
            control=control,
            value_and_tangents=value_and_tangents,
            event=instant.last,
            count=instant.count,
            at_once=instant.at_once,
        )
        return _Trajectory(goes_on, segment, instant.elapsed, amplification, hops, instant.written)

    def flown(so_far: _Trajectory) -> _Trajectory:
        before = so_far.segment
        remaining = time_to_end
        if time_to_end.value is not None:
            remaining = jax.tree.map(lambda part, gone: part - gone, time_to_end, equations.unpack(so_far.elapsed))
            remaining = remaining._replace(
                value=jnp.where(remaining.value <= MOMENT * problem.time_scale, 0.0, remaining.value)
            )
        segment, along, written = loop.to_its_event(
            jax.tree.leaves(before.value_and_tangents), remaining.value, so_far.written, before, so_far.elapsed
        )
        end = at_event(along, segment.event, segment.time, _itself, remaining)
        value_and_tangents, elapsed = (
            equations.pack(end.outputs),
            tuple(map(jnp.add, so_far.elapsed, equations.pack(end.time))),
        )
        written = loop.after_segment(written, segment._replace(value_and_tangents=value_and_tangents))
        met = Instant(
            value_and_tangents,
            value_and_tangents,
            elapsed,
            elapsed,
            elapsed,
            segment.event,
            before.count,
            no,
            no,
            jnp.asarray(True),
            segment.at_once,
            written,
        )
        instant = transitions.in_turn(met, segment, segment.event, 0 * before.count)
        instant = transitions.commuting(instant, segment, along, met._replace(elapsed=so_far.elapsed))
        instant = transitions.two_sided_at_end(instant, met, segment.arrives, time_to_end)
        rounding, falling = transitions.here.events(value_and_tangents[0]), transitions.rates(value_and_tangents[0])
        functions = [jnp.where(near, 0.0, value) for near, value in zip(segment.at_once, rounding, strict=True)]
        flat = None
        if transitions.bounds:
            own = zip(transitions.own, functions, falling, strict=False)
            flat = [~segment.at_once[i] & (value == 0) & (rate == 0) for i, value, rate in own]
        typical = jnp.minimum(problem.time_scale, elapsed[0])
        instant, endless = transitions.settled(instant, functions[: problem.own_events], flat, begins=False)
        both = zip(segment.at_once, transitions.here.events(instant.value_and_tangents[0]), rounding, strict=True)
        still_zero = [near & (jnp.abs(after) <= _RESIDUAL * jnp.abs(met)) for near, after, met in both]
        stands, hops = transitions.stands(instant, falling, still_zero, typical)
        soon = jnp.where(instant.last == before.event, _ACCUMULATED * typical, _ROUNDING * elapsed[0])
        # An event so soon after another that its function does not fall any more, as of a body that comes to rest.
        rests = (jnp.where(i == segment.event, rate > 0, False) for i, rate in enumerate(falling))
        own = problem.directions[: problem.own_events]
        directed = (each for each, direction in zip(rests, own, strict=False) if direction)
        rests = functools.reduce(jnp.logical_or, directed, jnp.asarray(False)) & (segment.time < _RESTS * typical)
        amplification = jnp.maximum(so_far.amplification, end.amplification)
        # A lane that has passed the time of an event has not done all that is due.
        mode = jnp.where(
            transitions.passed(rounding, met) & (segment.control.mode == ENDED), UNFINISHED, segment.control.mode
        )
        segment = segment._replace(control=segment.control._replace(mode=mode))
        # No motion goes on from a segment that failed or was given up, whatever its state there.
        instant = instant._replace(happened=instant.happened & (segment.control.mode == ENDED))
        segment = segment._replace(count=before.count, still_zero=still_zero)
        after = ended(instant, endless, segment, amplification, (segment.time <= soon) | rests | stands, hops)
        # A hop lower than the rounding of its event function has no end.
        accumulated = before._replace(control=segment.control._replace(mode=0 * segment.control.mode + UNFINISHED))
        at_rest = _Trajectory(no, accumulated, so_far.elapsed, so_far.amplification, no, after.written)
        return chosen(so_far.hops & (segment.control.mode == FAILED), at_rest, after)

    at_start = Instant(
        initial, initial, elapsed, elapsed, elapsed, none - 1, none, no, no, jnp.asarray(True), nothing, written
    )
    if transitions.bounds:
        settled = transitions.in_modes(at_start, [no] * len(transitions.bounds), [zero] * len(transitions.bounds))
        at_start = at_start._replace(value_and_tangents=transitions.two_sided_at_start(settled.value_and_tangents))
        mode = jnp.where(settled.slides & (control.mode == ADVANCING), UNFINISHED, control.mode)
        event = jnp.where(settled.slides, SLIDES, control.event)
        start = start._replace(
            value_and_tangents=at_start.value_and_tangents, control=control._replace(mode=mode, event=event)
        )
        begun = _Trajectory(jnp.logical_not(settled.slides), start, elapsed, zero + 1.0, no, written)
    else:
        begun = _Trajectory(jnp.asarray(True), start, elapsed, zero + 1.0, no, written)
    at_begin = begun.goes_on
    if problem.options.fires or transitions.scheduled:
        instant, endless = transitions.at_start(at_start)
        here = at_start.value_and_tangents[0]
        falling, at_zero = transitions.rates(here), [value == 0 for value in transitions.here.events(here)]
        stands, hops = transitions.stands(instant, falling, at_zero, problem.time_scale)
        ends = (instant.count > 0) & ~(instant.survives & (instant.count < problem.clock.max_events))
        begun = ended(instant, endless, start, zero + 1.0, stands, hops)
        mode = jnp.where(ends, ENDED, begun.segment.control.mode)
        segment = begun.segment._replace(control=begun.segment.control._replace(mode=mode))
        fires = instant.count > 0
        goes_on = jnp.where(fires, begun.goes_on, at_begin)
        segment = segment._replace(
            value_and_tangents=chosen(fires, segment.value_and_tangents, at_start.value_and_tangents)
        )
        begun = begun._replace(goes_on=goes_on, segment=segment)
    last = lax.while_loop(lambda so_far: so_far.goes_on, flown, begun)
    outputs = equations.of(outputs_of, last.segment.value_and_tangents)
    return last.segment, AtEvent(equations.unpack(last.elapsed), outputs, last.amplification), last.written


def _flag_of(event: Scalar, flags: Sequence[Flag]) -> Flag:
    """The flag of an event, from those of all."""
    each = [(event == i) & flag for i, flag in enumerate(flags)]
    return functools.reduce(jnp.logical_or, each, jnp.asarray(False))


def _itself(at: Augmented, _: Motion) -> Augmented:
    return at


def chosen(condition: Flag, this: PyTree, that: PyTree) -> PyTree:
    """One of two trees, number by number."""
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), this, that)
