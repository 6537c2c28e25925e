"""One lane from its start to its end: an error-controlled Runge-Kutta method that ends exactly at an event.

Plain JAX for one lane's numbers. `erosion.lanes` compiles it for many at a time.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, PerImpact, Scalar
from erosion.ode import crossings, step_control
from erosion.ode.crossings import Ends
from erosion.ode.events import GRAZE, Armed, EventSet, Falling
from erosion.ode.extended import Extended
from erosion.ode.guards import MOMENT, ULPS, Guard, guards_of
from erosion.ode.horizon import Horizon, To
from erosion.ode.landing import Flight, Lane, all_finite, landed
from erosion.ode.methods.base import LEAST, TIGHTEST
from erosion.ode.problem import OTHER_ENDS
from erosion.ode.recorders import Recorder, recorders_of
from erosion.ode.reduction import Rows
from erosion.ode.step_control import ARRIVED, ENDED, FIRST_STEP, NOT_BEGUN, STIFF, UNFINISHED
from erosion.ode.tape import Recorded
from erosion.ode.variational import (
    Along,
    AtEvent,
    Augmented,
    Derivatives,
    Direction,
    Layout,
    Motion,
    at_event,
    outputs_of,
)

_DOUBT = 100.0  # errors are mostly smaller than the tolerance by this factor
_MANY_STEPS, _MANY_FACTOR = 64, 1e-2  # the errors of this many steps add up, and may grow from step to step
_CHEAPER, _CHEAPEST = 1e4, 1e-2  # times the tolerance, at most: of an integration that tells how errors grow
_ROUGH_FACTOR = 1e-3  # across a kink an estimate says little, and a step may pass over a short visit behind one
_ACCUMULATED = (
    1e-11  # of the time scale, and of the time so far: where an event follows itself sooner, events accumulate
)
_ROUNDING = 1e-14  # of the time so far: where any event follows sooner, they do


class LaneEnd(NamedTuple):
    """The results of a lane: numbers, and after the batch arrays of shape (lanes,).

    Args:
        outcome: an index of `Layout.end_names`.
        tolerance: the tolerance that the lane needs for results as exact as asked for; a greater one than asked for
            where an integration with that would tell whether it needs a smaller one. After the
            batch that of the results.
        time: from the start to the end, with derivatives.
        outputs: what is wanted there, with derivatives; see `erosion.ode.reduction`.
        trials: number of steps tried.
        count: number of events on the way, that at the end included.
        at_once: for each event whether it happens at the end.
        least: where the whole state is wanted, a size of each of its elements below which it need not be known.
        stiff: whether the lane was given up as stiff, or integrated by the method for that; where it is looked for.
        error: after the batch, what the values err by as two integrations tell; 0 where there was one.
        saved: the token of what is written at times; after the batch outputs there and their derivatives, in the
            order of `Variational.pack`, shape (lanes, times, members, outputs).
        recorded: the steps, where they are recorded.
        logged: the events, where they are logged.
    """

    outcome: PerImpact
    tolerance: PerImpact
    time: Derivatives
    outputs: Derivatives
    trials: PerImpact
    count: PerImpact  # pyright: ignore[reportIncompatibleMethodOverride]
    at_once: Sequence[PerImpact] = ()
    least: Sequence[PerImpact] = ()
    stiff: PerImpact | None = None
    error: PerImpact | None = None
    saved: PerImpact | None = None
    recorded: Recorded | None = None
    logged: Recorded | None = None

    @property
    def quantities(self) -> Derivatives:
        """Lists of the time and the outputs, and of their derivatives."""
        both = zip(self.time, self.outputs, strict=True)
        return Derivatives(*(None if time is None else [time, *outputs] for time, outputs in both))


Written = list[Any]  # by each recorder, so far


def integrate_lane(
    layout: Layout,
    numbers: Sequence[Number],
    directions: tuple[Direction, ...],
    rtol: Scalar,
    *,
    order: int = 0,
    rows: Scalar = 0,
) -> LaneEnd:
    """Integrate one lane to its end.

    Args:
        layout: of problem and arguments.
        numbers: of this lane.
        directions: of the derivatives; see `Variational`.
        rtol: of outputs, end time and derivatives.
        order: 0, 1 or 2 derivatives.
        rows: of the tape, where steps are recorded or events logged.
    """
    problem = Extended(layout, numbers, order, directions)
    loop = _Loop(problem, rtol, rows)
    return (_chain if problem.chains else _single)(problem, loop, rtol)


class _Loop:
    """The loop of steps, for every motion of a lane.

    Args:
        problem: the equations.
        rtol: relative tolerance.
        rows: of the tape, where steps are recorded or events logged.
    """

    def __init__(self, problem: Extended, rtol: Scalar, rows: Scalar) -> None:
        self.problem, self.rtol, self.method = problem, rtol, problem.method
        self.guards: list[Guard] = guards_of(problem, rtol)
        self.recorders: list[Recorder] = recorders_of(problem, rtol, rows)
        self.events: EventSet = Falling(problem.directions, rough=problem.rough)
        if problem.options.waits:
            self.events = Armed(
                problem.directions,
                rough=problem.rough,
                affine=problem.affine_events,
                smooth=problem.events_are_smooth,
            )

    def to_its_event(
        self, initial: Rows, until: Scalar | None, written: Written, before: Flight | None, elapsed: tuple[Scalar, ...]
    ) -> tuple[Flight, Along, Written]:
        """Integrate from a state to the first event; with how it and what is wanted there depend on the event's time.

        Args:
            initial: the state with derivatives.
            until: stop after this time.
            written: by the recorders so far.
            before: the motion before it in a chain.
            elapsed: the time since the chain began, with derivatives.
        """
        end = Horizon() if until is None else To(until, self.problem.clock.max_step)
        recorders = [recorder.of_motion(elapsed) for recorder in self.recorders]

        def tries(at: tuple[Lane, Written]) -> tuple[Lane, Written]:
            lane, written = at
            after = self._try_step(end, lane)
            return after, [one.after_step(so_far, lane, after) for one, so_far in zip(recorders, written, strict=True)]

        start = self._start(initial, end, before), written
        lane, written = lax.while_loop(lambda at: step_control.goes_on(at[0].control), tries, start)
        motion, along = landed(self.problem, lane, until)
        written = [one.after_landing(so_far, lane, motion) for one, so_far in zip(recorders, written, strict=True)]
        return motion, along, written

    def after_event(
        self, written: Written, motion: Flight, happens: Sequence[Flag], elapsed: tuple[Scalar, ...]
    ) -> Written:
        """What the recorders have written with the end of a motion."""
        pairs = zip(self.recorders, written, strict=True)
        return [recorder.of_motion(elapsed).after_event(so_far, motion, happens) for recorder, so_far in pairs]

    def recorded(self, written: Written) -> Mapping[str, Any]:
        """What they leave of the lane's results."""
        results: dict[str, Any] = {}
        for recorder, so_far in zip(self.recorders, written, strict=True):
            results |= recorder.results(so_far)
        return results

    def _start(self, initial: Rows, end: Horizon, before: Flight | None) -> Lane:
        problem, method = self.problem, self.method
        slope, events = _at_start(problem, initial, problem.time_scale)
        scale = problem.scale_at_start(initial, slope)
        # 0·NaN and 0·∞ are NaN: this finds them also in parameters that the motion does not depend on.
        zero = sum(jnp.sum(0.0 * number) for number in _own(problem))
        zero = zero + sum(0.0 * row for row in (*initial, *slope)) + 0.0 * scale
        for event in events:
            zero = zero + 0.0 * event.value + 0.0 * event.rate
        begins = self.events.begins(events, scale) if problem.options.begins else jnp.asarray(True)
        if before is not None:
            begins = begins | (before.count > 0)
        control = step_control.begin(scale, begins, jnp.isfinite(zero), FIRST_STEP)
        events = self.events.begun(events)
        if before is not None:
            # The functions of events that have just happened are zero, but for rounding.
            events = [crossings.after_event(*each, scale) for each in zip(events, before.at_once, strict=True)]
            past, trial = before.control, jnp.minimum(control.trial, before.control.step)
            control = control._replace(
                trial=trial, step=trial, trials=past.trials, rejected=past.rejected, margin=past.margin
            )
        first = method.first_step(initial, slope, scale, control.trial)
        control = control._replace(trial=first, step=first)
        memories = tuple(guard.begin(scale) for guard in self.guards)
        watched, greatest = self.events.watch(events, scale), method.sizes_at_start(initial, before)
        return Lane(end.within(control), events, initial, slope, watched, greatest, memories)

    def _try_step(self, end: Horizon, lane: Lane) -> Lane:
        """Try one step, and decide what follows."""
        problem, method, before = self.problem, self.method, lane.control
        guarded = list(zip(self.guards, lane.memories, strict=True))
        at_rest = scale = visible = problem.scale_near(before.step, FIRST_STEP)
        for guard, memory in guarded:
            at_rest = guard.at_rest(memory, before, at_rest)
        step = method.tried(lane, (scale, at_rest), self.rtol)
        # Events may be NaN where the motion is not: 0·NaN is NaN, and an error too.
        step = step._replace(error=sum((0.0 * part for event in step.events for part in event), step.error))
        step = self.events.resolved(lane.events, step, before.trial)
        for guard in self.guards:
            step, visible = guard.sees(lane, step, visible)
        watched = self.events.watch(lane.events, scale)
        control, moved = self.events.decide(
            watched, before, lane.events, step, (scale, visible), self.rtol, problem.limits, method.ending,
            lambda: end.reach(before),
        )  # fmt: skip
        memories = []
        for guard, memory in guarded:
            memory, step, control = guard.decided(memory, lane, step, moved, control, end)
            memories.append(memory)
        control, moved = method.arrives(before, end.within(control), moved)
        greatest = method.sizes(lane.greatest, step.state)
        after = step.events, step.state, step.slope, watched, greatest, tuple(memories)
        kept = jax.tree.map(lambda new, old: jnp.where(moved, new, old), after, tuple(lane[1:]))
        return Lane(control, *kept)


def _single(problem: Extended, loop: _Loop, rtol: Scalar) -> LaneEnd:
    until = problem.until
    written = [recorder.begin() for recorder in loop.recorders]
    motion, along, written = loop.to_its_event(problem.initial, until.value, written, None, ())
    end = at_event(along, motion.event, motion.time, outputs_of, until)
    written = loop.after_event(written, motion, [], ())
    return _finish(problem, motion, end, rtol, loop.recorded(written))


def _own(problem: Extended) -> list[Number]:
    """The numbers that must be finite: those of the arguments, and of the clock t0, and t1 if it is not ∞."""
    if not problem.options.clock:
        return problem.numbers
    t0, t1, *_ = problem.clock
    return [*problem.numbers[: -len(problem.clock)], t0, jnp.where(t1 == jnp.inf, t0, t1)]


def _at_start(problem: Extended, initial: Rows, scale: Scalar) -> tuple[Rows, list[Ends]]:
    """Rate and events at the start; where a rate is 0·∞ by a √0, or jumps there, those just after it."""
    slope, events = problem.rate_and_events(initial)
    if not problem.rough:
        return slope, events
    known = [jnp.where(jnp.isfinite(k), k, 0.0) for k in slope]

    def after(moments: float) -> Rows:
        changes = [(MOMENT * scale * k, ULPS * jnp.abs(u) * jnp.sign(k)) for u, k in zip(initial, known, strict=True)]
        pairs = zip(initial, changes, strict=True)
        return [u + moments * jnp.where(jnp.abs(d) > jnp.abs(least), d, least) for u, (d, least) in pairs]

    # What a rate that is no root, but jumps, does once it does hardly again in a time that is longer.
    jumps: Flag = jnp.asarray(False)
    rates, later = (problem.motion_rate(after(moments)[: problem.width]) for moments in (1.0, 3.0))
    for now, soon, then in zip(known, rates, later, strict=False):
        jump = jnp.abs(soon - now)
        jumps = jumps | ((jump > _ROUGH_FACTOR * jnp.abs(now)) & (jnp.abs(then - soon) < _ROUGH_FACTOR * jump))

    def limit() -> tuple[Rows, list[Ends]]:
        rates, ends = problem.rate_and_events(after(1.0))
        return rates, [Ends(event.value, end.rate) for event, end in zip(events, ends, strict=True)]

    return lax.cond(all_finite(slope) & ~jumps, lambda: (slope, events), limit)


def _finish(problem: Extended, motion: Flight, end: AtEvent, rtol: Scalar, recorded: Mapping[str, Any]) -> LaneEnd:
    """The results where a lane ended, or at its start where it does not begin; NaN where one of them is not finite."""
    control, equations, event = motion.control, problem.equations, motion.event
    begun = event != NOT_BEGUN if problem.options.begins else jnp.asarray(True)
    outputs, time = end.outputs, end.time
    if problem.options.begins:
        at_start = equations.of(outputs_of, problem.members(problem.initial))
        outputs = jax.tree.map(lambda there, alone: jnp.where(begun, there, alone), outputs, at_start)
        time = jax.tree.map(lambda number: jnp.where(begun, number, 0.0), time)
    both = zip(equations.per_unit(time), equations.per_unit(outputs), strict=True)
    results = Derivatives(*(None if of_time is None else [of_time, of_outputs] for of_time, of_outputs in both))
    numbers, structure = jax.tree.flatten(results)
    ended = problem.method.is_known(control.mode == ENDED, end.amplification)
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, numbers), ended)
    # What an unfinished lane has reached is told, where nothing else says so.
    reached = finite | (control.mode == UNFINISHED) if problem.options.clock else finite
    known = [jnp.where(reached, number, jnp.nan) for number in numbers[: len(jax.tree.leaves(results.value))]]
    others = [jnp.where(finite, number, jnp.nan) for number in numbers[len(known) :]]
    results = jax.tree.unflatten(structure, known + others)
    time, outputs = (Derivatives(*(part and part[i] for part in results)) for i in range(2))
    amplified = ended & begun & (end.amplification > _DOUBT)
    factor = jnp.where(amplified, _DOUBT / end.amplification, 1.0)
    factor = jnp.where(control.margin < GRAZE * rtol, jnp.minimum(factor, 1 / GRAZE), factor)
    many = control.trials > _MANY_STEPS
    if problem.options.whole:
        # Most motions forget their errors: a cheaper integration tells which do not.
        cheaper = jnp.clip(_CHEAPEST / rtol, 1.0, _CHEAPER)
        factor = jnp.where(many, jnp.where(factor < 1, jnp.minimum(factor, _MANY_FACTOR), cheaper), factor)
    else:
        factor = jnp.where(many, jnp.minimum(factor, _MANY_FACTOR), factor)
    if problem.rough:
        factor = jnp.minimum(factor, _ROUGH_FACTOR)
    least = [LEAST * size for size in problem.sizes_of_state(motion.greatest)]
    return LaneEnd(
        outcome=_outcome(problem, finite, control.mode, event),
        tolerance=jnp.where(finite, jnp.maximum(factor * rtol, jnp.minimum(TIGHTEST, rtol)), rtol),
        time=time,
        outputs=outputs,
        trials=lax.convert_element_type(control.trials, np.int32),
        count=lax.convert_element_type(motion.count, np.int32) if problem.options.clock else None,
        at_once=[lax.convert_element_type(each, np.int8) for each in motion.at_once] if problem.options.clock else [],
        least=least,
        stiff=lax.convert_element_type(control.event == STIFF, np.int8) if problem.watches else None,
        **recorded,
    )


def _outcome(problem: Extended, finite: Flag, mode: Scalar, event: Scalar) -> Scalar:
    """The code of an end, an index of `Layout.end_names`."""
    names = problem.layout.end_names
    code = {name: names.index(name) for name in OTHER_ENDS}
    without_event = jnp.where(event == ARRIVED, code["t1"], event)
    ended = jnp.where(event == NOT_BEGUN, code["start"], without_event)
    no_result = jnp.where(mode == UNFINISHED, code["unfinished"], code["failed"])
    return lax.convert_element_type(jnp.where(finite, ended, no_result), np.int8)


class _Chain(NamedTuple):
    """A chain of events under way.

    Args:
        goes_on: whether there is another motion.
        motion: the last one; its members are those from which the next begins, or at the end.
        elapsed: time since the start, with derivatives as the members of a state have them.
        amplification: the greatest so far.
        written: by the recorders so far.
    """

    goes_on: Flag
    motion: Flight
    elapsed: tuple[Scalar, ...]
    amplification: Scalar
    written: Written


def _chain(problem: Extended, loop: _Loop, rtol: Scalar) -> LaneEnd:
    """Integrate one lane through events that it survives.

    At each event the state gets its total derivatives, those of the event's time included; the reset is pushed
    forward over them, and the next motion starts on its own clock. So there are no saltation matrices.
    """
    equations, until = problem.equations, problem.until
    end_of = functools.partial(jax.tree.map, lambda part, gone: part - gone)

    def flown(chain: _Chain) -> _Chain:
        before = chain.motion
        rest = end_of(until, equations.unpack(chain.elapsed))
        initial: Rows = jax.tree.leaves(before.members)
        motion, along, written = loop.to_its_event(initial, rest.value, chain.written, before, chain.elapsed)
        end = at_event(along, motion.event, motion.time, lambda at, _: at, rest)
        members = equations.pack(end.outputs)
        elapsed = tuple(map(jnp.add, chain.elapsed, equations.pack(end.time)))
        last, count, happens = _in_turn(problem, members[0], motion, before.count)
        written = loop.after_event(written, motion._replace(members=members), happens, elapsed)
        survives = functools.reduce(jnp.logical_or, [last == i for i in problem.chains])
        typical = jnp.minimum(problem.time_scale, elapsed[0])
        soon = jnp.where(last == before.event, _ACCUMULATED * typical, _ROUNDING * elapsed[0])
        accumulates = motion.time <= soon
        more = (count > before.count) & survives & (count < problem.clock.max_events)
        mode = jnp.where(more & accumulates, UNFINISHED, motion.control.mode)
        goes_on = more & ~accumulates

        both = equations.of(functools.partial(resets, happens), members)
        met, after = (equations.pack(Derivatives(*(part and part[i] for part in both))) for i in range(2))
        members = _chosen(goes_on, after, met)
        control = motion.control._replace(mode=mode)
        amplification = jnp.maximum(chain.amplification, end.amplification)
        motion = motion._replace(control=control, members=members, event=last, count=count)
        return _Chain(goes_on, motion, elapsed, amplification, written)

    zero = 0.0 * problem.time_scale
    control = step_control.begin(problem.time_scale, jnp.asarray(True), jnp.asarray(True), FIRST_STEP)
    none = 0 * control.mode
    nothing = [jnp.asarray(False)] * len(problem.directions)
    sizes = problem.method.sizes_at_start(problem.initial, None)
    start = Flight(control, problem.members(problem.initial), none - 1, zero, none, nothing, sizes)
    elapsed = tuple(zero for _ in problem.members(problem.initial))
    chain = _Chain(jnp.asarray(True), start, elapsed, zero + 1.0, [recorder.begin() for recorder in loop.recorders])
    chain = lax.while_loop(lambda chain: chain.goes_on, flown, chain)
    outputs = equations.of(outputs_of, chain.motion.members)
    end = AtEvent(equations.unpack(chain.elapsed), outputs, chain.amplification)
    return _finish(problem, chain.motion, end, rtol, loop.recorded(chain.written))


def resets(happens: Sequence[Flag], at: Augmented, motion: Motion) -> tuple[Augmented, Augmented]:
    """State and integrals before the last reset of the events that happen, and after it."""
    met = at
    for i, event_happens in enumerate(happens):
        met, at = _chosen(event_happens, at, met), _chosen(event_happens, motion.after(i, at), at)
    return met, at


def _in_turn(problem: Extended, at: Augmented, motion: Flight, count: Scalar) -> tuple[Scalar, Scalar, list[Flag]]:
    """The last event of those at once, the number of events with them, and which of them happen.

    They happen in their order: each after the first where its function falls still after the resets before it.
    """
    here = problem.equations.at(problem.numbers)

    def rates(at: Augmented) -> list[Scalar]:
        return jax.jvp(here.events, (at,), (here.rate(at),))[1]

    last, going, happens = motion.event, jnp.asarray(True), []
    falling = rates(at)
    for i, near in enumerate(motion.at_once):
        still = (motion.event == i) | (rates(at)[i] * falling[i] > 0)
        happens.append(near & still & going & (count < problem.clock.max_events))
        last, count = jnp.where(happens[i], i, last), count + happens[i]
        if i in problem.chains:
            at = _chosen(happens[i], here.after(i, at), at)
        else:
            going = going & ~happens[i]
    return last, count, happens


def _chosen(condition: Flag, this: PyTree, that: PyTree) -> PyTree:
    return jax.tree.map(lambda one, other: jnp.where(condition, one, other), this, that)
