"""One lane from its start to its end: an error-controlled Runge-Kutta method that ends exactly at an event.

Plain JAX for one lane's numbers. `erosion.lanes` compiles it for many at a time.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, PerImpact, Scalar
from erosion.ode import crossings, explicit, step_control, stiff
from erosion.ode.crossings import Ends
from erosion.ode.explicit import APART, LEAST, NOISE
from erosion.ode.extended import Extended
from erosion.ode.kinks import breaks, corrected, is_broken
from erosion.ode.landing import Flight, Lane, all_finite, has_no_derivatives, landed
from erosion.ode.problem import OTHER_ENDS
from erosion.ode.reduction import Rows
from erosion.ode.step_control import ADVANCING, ARRIVED, ENDED, FIRST_STEP, NOT_BEGUN, STIFF, UNFINISHED, Control
from erosion.ode.tape import Recorded, Saved, Tape, Writer
from erosion.ode.variational import (
    Along,
    AtEvent,
    Augmented,
    Derivatives,
    Direction,
    Layout,
    Motion,
    OfMotion,
    at_event,
    outputs_of,
)

_SLACK = 4.0  # the embedded estimate is of 7th order, the solution of 8th; benchmarks/TUNING.md
# By order, where states are wanted, too: at an event they err by the error of its time as well. Measured on the six
# problems of benchmarks/ode_accuracy.py.
_SLACK_WHOLE = (1.0, 0.7, 4.0)
_DOUBT = 100.0  # errors are mostly smaller than the tolerance by this factor
_GRAZE = 1e4  # tolerances: a dip this close to zero may be a fall, after many turns of a fast spin
TIGHTEST = 1e-13  # tolerance of a second integration: rounding is near
_MANY_STEPS, _MANY_FACTOR = 64, 1e-2  # the errors of this many steps add up, and may grow from step to step
_CHEAPER, _CHEAPEST = 1e4, 1e-2  # times the tolerance, at most: of an integration that tells how errors grow
_MANY_STIFF = 12  # steps, more than others, that are short although the motion is smooth: it is stiff
_FAR = 200  # steps: a nearer end is reached all the same
_COARSER = 30.0  # times the tolerance: tells what second derivatives of a stiff motion err by
_FIXED = 1e-6  # of its size, by a change of a parameter by its own size: a smaller second derivative is not needed
_LINEAR = 1e-3  # of that of a power: a second derivative this small is almost zero
_TINY = 1e-200  # keeps 0/0 away
_ROUGH_FACTOR = 1e-3  # across a kink an estimate says little, and a step may pass over a short visit behind one
_MOMENT = 1e-12  # of the time scale: a rate that is 0·∞ at the start, or jumps, is taken this much later
_ULPS = 1e-15  # of a number, at least: then it is another one
_ZERO = 1e-15  # event functions of order 1 below this are zero at the start: cos(π/2) is 6e-17 in floating point
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
        second_sizes: of a stiff motion, sizes of time and outputs relative to which their second derivatives should
            be known.
        error: after the batch, what the values err by as two integrations tell; 0 where there was one.
        saved: the token of what is written at times; after the batch outputs there and their derivatives, in the
            order of `Variational.pack`, shape (lanes, times, members, outputs).
        recorded: the steps, where they are recorded.
    """

    outcome: PerImpact
    tolerance: PerImpact
    time: Derivatives
    outputs: Derivatives
    trials: PerImpact
    count: PerImpact  # pyright: ignore[reportIncompatibleMethodOverride]
    at_once: Sequence[PerImpact] = ()
    least: Sequence[PerImpact] = ()
    second_sizes: Sequence[PerImpact] = ()
    stiff: PerImpact | None = None
    error: PerImpact | None = None
    saved: PerImpact | None = None
    recorded: Recorded | None = None

    @property
    def quantities(self) -> Derivatives:
        """Lists of the time and the outputs, and of their derivatives."""
        both = zip(self.time, self.outputs, strict=True)
        return Derivatives(*(None if time is None else [time, *outputs] for time, outputs in both))


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
        rows: of the tape, where the steps are recorded.
    """
    problem = Extended(layout, numbers, order, directions)
    tape = saved = None
    if layout.options.saves:
        saved = Saved(jnp.zeros((), int), 0.0 * rtol)
    if layout.options.records:
        tape = Tape(jnp.zeros((), int), lax.convert_element_type(rows, int), 0.0 * rtol, jnp.asarray(True))
    if problem.chains:
        return _chain(problem, rtol, tape, saved)
    until = problem.until
    motion, along, tape, saved = _to_its_event(problem, problem.initial, until.value, rtol, tape, saved)
    end = _at_its_event(problem, motion, along, outputs_of, until)
    if tape is not None:
        tape = tape.with_event(motion.event, [], jax.tree.leaves(motion.members))
    return _finish(problem, motion, end, rtol, saved, tape)


def _at_its_event(problem: Extended, motion: "Flight", along: Along, outputs: OfMotion, until: Derivatives) -> AtEvent:
    """The end of a motion with derivatives; those of the time by which it was shifted on its way are added."""
    if not motion.shift:
        return at_event(along, motion.event, motion.time, outputs, until)
    zero = 0.0 * motion.time
    shift = problem.equations.unpack((zero, *motion.shift))
    rest = jax.tree.map(lambda given, gone: given - gone, until, shift)
    end = at_event(along, motion.event, motion.time, outputs, rest)
    return end._replace(time=jax.tree.map(jnp.add, end.time, shift))


def _to_its_event(
    problem: Extended,
    initial: Rows,
    until: Scalar | None,
    rtol: Scalar,
    tape: Tape | None,
    saved: Saved | None,
    *,
    before: Flight | None = None,
    elapsed: tuple[Scalar, ...] = (),
) -> tuple[Flight, Along, Tape | None, Saved | None]:
    """Integrate from a state to the first event; with how it and what is wanted there depend on the event's time.

    Args:
        problem: the equations.
        initial: the state with derivatives.
        until: stop after this time.
        rtol: relative tolerance.
        tape: where its steps are written, the one that ends at the event as well.
        saved: the states at times so far; None where none are wanted.
        before: the motion before it in a chain.
        elapsed: the time since the chain began, with derivatives.
    """
    slope, events = _at_start(problem, initial, problem.time_scale)
    scale = problem.scale_at_start(initial, slope)
    # 0·NaN and 0·∞ are NaN: this finds them also in parameters that the motion does not depend on.
    zero = sum(jnp.sum(0.0 * number) for number in _own(problem))
    zero = zero + sum(0.0 * row for row in (*initial, *slope)) + 0.0 * scale
    for event in events:
        zero = zero + 0.0 * event.value + 0.0 * event.rate
    begins = _begins(problem, events, scale)
    if before is not None:
        begins = begins | (before.count > 0)
    control = step_control.begin(scale, begins, jnp.isfinite(zero), FIRST_STEP)
    if not problem.options.waits:
        # Where an event function is zero at the start it rises, or the lane ends there.
        events = [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in events]
    if before is not None:
        # The functions of events that have just happened are zero, but for rounding.
        events = [crossings.after_event(*each, scale) for each in zip(events, before.at_once, strict=True)]
        past, trial = before.control, jnp.minimum(control.trial, before.control.step)
        control = control._replace(
            trial=trial, step=trial, trials=past.trials, rejected=past.rejected, margin=past.margin
        )
    if problem.rodas is not None:
        first = jnp.minimum(control.trial, stiff.first_step(problem, initial, slope, scale))
        control = control._replace(trial=first, step=first)
    watched = crossings.watch(problem.directions, events, scale) if problem.options.waits else []
    largest = [0.0 * row for row in initial] if before is None or problem.rodas is None else before.greatest
    greatest = _greatest(problem, largest, initial)
    shift = stiff.no_shift(problem)
    count = 0.0 * scale if problem.watches else None
    longest = 0.0 * scale if problem.rough and problem.layout.problem.time_scale is None else None
    lane = Lane(_within(problem, control, until), events, initial, slope, watched, greatest, shift, count, longest)
    writer = Writer(problem, rtol, elapsed)

    def tries(at: tuple[Lane, Tape | None, Saved | None]) -> tuple[Lane, Tape | None, Saved | None]:
        lane, tape, saved = at
        after = _try_step(problem, rtol, until, lane)
        if tape is not None:
            moved = after.control.time != lane.control.time
            tape = tape.with_step(after.control.time - lane.control.time, lane.state, moved)
        return after, tape, saved and writer.after_step(saved, lane, after)

    lane, tape, saved = lax.while_loop(lambda at: step_control.goes_on(at[0].control), tries, (lane, tape, saved))
    motion, along = landed(problem, lane, until)
    if tape is not None:
        tape = tape.with_step(motion.time - lane.control.time, lane.state, jnp.asarray(True))
        tape = tape._replace(has_derivatives=tape.has_derivatives & ~has_no_derivatives(problem, motion))
    return motion, along, tape, saved and writer.after_landing(saved, lane, motion)


def _greatest(problem: Extended, before: Rows, state: Rows) -> Rows:
    """The greatest sizes of the rows of the motion itself; what is wanted of it without them is an integral alone."""
    if not problem.options.whole and problem.rodas is None:
        return []
    return [jnp.maximum(size, jnp.abs(row)) for size, row in zip(before, state[: problem.width], strict=False)]


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
        changes = [(_MOMENT * scale * k, _ULPS * jnp.abs(u) * jnp.sign(k)) for u, k in zip(initial, known, strict=True)]
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


def _begins(problem: Extended, events: Sequence[Ends], time: Scalar) -> Flag:
    """Whether a lane goes on from its start: every event function is positive or rises from zero."""
    if not problem.options.begins:
        return jnp.asarray(True)
    if problem.options.waits:
        return crossings.all_count(problem.directions, events, time)
    rises = ((jnp.abs(event.value) <= _ZERO) & (event.rate * time > _ZERO) for event in events)
    going = ((event.value > _ZERO) | rising for event, rising in zip(events, rises, strict=True))
    return functools.reduce(jnp.logical_and, going, jnp.asarray(True))


def _try_step(problem: Extended, rtol: Scalar, until: Scalar | None, lane: Lane) -> Lane:
    """Try one step, and decide what follows."""
    scale = problem.scale_near(lane.control.step, FIRST_STEP)
    h = lane.control.trial
    longest = lane.longest
    at_rest = scale if longest is None else problem.scale_near(jnp.maximum(lane.control.step, longest), FIRST_STEP)
    (state, slope, stages), events, within, error = _tried(problem, rtol, lane, (scale, at_rest))
    for event in events:
        # Events may be NaN where the motion is not: 0·NaN is NaN, and an error too.
        error = error + 0.0 * event.value + 0.0 * event.rate
    visible = scale
    if problem.rough and problem.layout.equations.timed and not problem.order:
        # A jump is met no closer than the clock's digits tell, however small its row is there.
        sizes = zip(lane.slope, slope, lane.greatest, strict=False)
        still = (jnp.abs(h * k) <= rtol * size for *ks, size in sizes for k in ks)
        blink = functools.reduce(jnp.logical_and, still, h <= _ULPS * jnp.abs(problem.clock.t0 + lane.control.time))
        error, visible = jnp.where(blink, 0.0 * error, error), jnp.where(blink, jnp.inf, scale)
    watched = crossings.watch(problem.directions, lane.events, scale) if problem.options.waits else []
    limits, rough = problem.limits, problem.rough

    def goes_on() -> tuple[Control, Flag]:
        return step_control.go_on(lane.control, error, scale, limits)

    def looks() -> tuple[Control, Flag]:
        looked = lane.control, lane.events, events, within, error, visible
        if problem.options.waits:
            trial = crossings.look_directed(watched, *looked, clear=clear, rough=rough)
        else:
            trial = crossings.look(*looked, clear=clear, rough=rough)
        reach = None if problem.rodas is None else _reach(problem, lane.control, until)
        return crossings.decide(lane.control, trial, scale, limits, rough=rough, reach=reach)

    clear = crossings.are_clear(watched, h, lane.events, events, within, _GRAZE * rtol, rough=rough)
    quiet = functools.reduce(jnp.logical_and, clear, lane.control.mode == ADVANCING)
    control, moved = lax.cond(quiet, goes_on, looks)
    if problem.rough and problem.order:
        broken = is_broken(problem, lane.state, stages, h, problem.time_scale)
        ends = (lane.state, lane.slope), (state, slope)
        begun = jnp.maximum(_MOMENT, _ULPS * jnp.abs(problem.clock.t0) / h)
        begun = jnp.where(lane.control.time == 0, begun, -1.0)
        broken = moved & (broken | breaks(problem, *ends, h, problem.time_scale, begun))
        control = control._replace(mode=jnp.where(broken, step_control.FAILED, control.mode))
    if problem.rough and problem.order == 2:
        ends = (lane.state, lane.slope), (state, slope)
        state, slope = corrected(problem, *ends, stages, h, problem.time_scale)
    count = lane.stiff
    if count is not None:
        one = explicit.stiffness(problem, lane.greatest, (lane.state, state), stages, h, rtol)
        count = jnp.maximum(count + jnp.where(moved, one, 0.0), 0.0)
        far = until is None or until - control.time > _FAR * control.step
        stops = step_control.goes_on(control) & (count >= _MANY_STIFF) & far
        control = control._replace(
            mode=jnp.where(stops, UNFINISHED, control.mode), event=jnp.where(stops, STIFF, control.event)
        )
    control = _within(problem, control, until)
    if problem.rodas is not None:
        # The step that arrives is the last one, which a lane ends with.
        last = moved & (control.mode == ENDED)
        control = control._replace(
            time=jnp.where(last, lane.control.time, control.time), left=jnp.where(last, h, control.left)
        )
        moved = moved & jnp.logical_not(last)
    greatest, shift = _greatest(problem, lane.greatest, state), lane.shift
    if shift:
        state, slope, shift = stiff.shifted(problem, greatest, state, slope, shift, stages, rtol)
    longest = longest if longest is None else jnp.maximum(longest, h)
    after, before = (events, state, slope, watched, greatest, shift, count, longest), tuple(lane[1:])
    kept = jax.tree.map(lambda new, old: jnp.where(moved, new, old), after, before)
    return Lane(control, *kept)


def _tried(
    problem: Extended, rtol: Scalar, lane: Lane, scales: tuple[Scalar, Scalar]
) -> tuple[tuple[Rows, Rows, Any], list[Ends], list[tuple[float, list[Scalar]]], Scalar]:
    """State, slope and all slopes of a trial; the events at its end and within; its error over the tolerance."""
    h, before = lane.control.trial, lane.state
    if problem.rodas is None:
        state, stages, within = explicit.step(problem, before, lane.slope, h)
        slope, events = problem.rate_and_events(state)
        stages = [[*ks, k] for ks, k in zip(stages, slope, strict=True)]
        slack = _SLACK_WHOLE[problem.order] if problem.options.whole else _SLACK
        error = explicit.error_of(problem, lane.greatest, (before, state), stages, h, scales, rtol) / (slack * rtol)
        return (state, slope, stages), events, within, error
    state, found = problem.rodas.step(before, lane.slope, h)
    slope, events = problem.rate_and_events(state)
    apart = jnp.maximum(APART, NOISE / rtol) if problem.layout.problem.typical is None else 1.0
    error = stiff.error_of(problem, lane.greatest, apart, (before, state), found, h, rtol)
    return (state, slope, found), events, problem.rodas.within(before, state, found), error


def _reach(problem: Extended, control: Control, until: Scalar | None) -> Scalar:
    """How long a step may be, as is asked for."""
    return jnp.asarray(jnp.inf) if until is None else jnp.minimum(problem.clock.max_step, until - control.time)


def _within(problem: Extended, control: Control, until: Scalar | None) -> Control:
    if until is None:
        return control
    return crossings.stop_at(control._replace(trial=jnp.minimum(control.trial, problem.clock.max_step)), until)


def _finish(
    problem: Extended, motion: Flight, end: AtEvent, rtol: Scalar, saved: Saved | None, tape: Tape | None
) -> LaneEnd:
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
    ended = control.mode == ENDED
    if problem.rodas is not None:
        ended = ended & (end.amplification < stiff.BLURRED / TIGHTEST)
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, numbers), ended)
    # What an unfinished lane has reached is told, where nothing else says so.
    reached = finite | (control.mode == UNFINISHED) if problem.options.clock else finite
    known = [jnp.where(reached, number, jnp.nan) for number in numbers[: len(jax.tree.leaves(results.value))]]
    others = [jnp.where(finite, number, jnp.nan) for number in numbers[len(known) :]]
    results = jax.tree.unflatten(structure, known + others)
    time, outputs = (Derivatives(*(part and part[i] for part in results)) for i in range(2))
    amplified = ended & begun & (end.amplification > _DOUBT)
    factor = jnp.where(amplified, _DOUBT / end.amplification, 1.0)
    factor = jnp.where(control.margin < _GRAZE * rtol, jnp.minimum(factor, 1 / _GRAZE), factor)
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
    second_sizes: list[Scalar] = []
    if problem.rodas is not None and problem.order == 2:
        # What cancels in them is not foreseen: a cheaper integration tells.
        factor = jnp.where(factor < 1, factor, _COARSER)
        second_sizes = _second_sizes(problem, time, outputs, least)
    return LaneEnd(
        outcome=_outcome(problem, finite, control.mode, event),
        tolerance=jnp.where(finite, jnp.maximum(factor * rtol, jnp.minimum(TIGHTEST, rtol)), rtol),
        time=time,
        outputs=outputs,
        trials=lax.convert_element_type(control.trials, np.int32),
        count=lax.convert_element_type(motion.count, np.int32) if problem.options.clock else None,
        at_once=[lax.convert_element_type(each, np.int8) for each in motion.at_once] if problem.options.clock else [],
        least=least,
        second_sizes=second_sizes,
        stiff=lax.convert_element_type(control.event == STIFF, np.int8) if problem.watches else None,
        saved=saved and saved.token,
        recorded=tape and Recorded(jnp.where(tape.has_derivatives, tape.rows, 0), tape.token),
    )


def _second_sizes(problem: Extended, time: Derivatives, outputs: Derivatives, least: Sequence[Scalar]) -> list[Scalar]:
    """Sizes of time and outputs relative to which their second derivatives should be known.

    A power of a parameter, q^n, has n²/q² times its value, and near a zero of a second derivative nothing is known
    relative to itself. Nor is anything where a value is fixed by its event, but for rounding.
    """
    one = jax.tree.map(jnp.ones_like, outputs.value)
    unit = jax.tree.leaves(problem.equations.per_unit(Derivatives(one, one, one, one)).second)[0]
    sizes, floors = [], [0.0 * time.value, *least, *[0.0 * time.value] * (len(outputs.value) - len(least))]
    for value, first, other, second, floor in zip(
        *([of_time, *of_outputs] for of_time, of_outputs in zip(time, outputs, strict=True)), floors, strict=True
    ):
        power = _LINEAR * jnp.abs(first * other) / (jnp.abs(value) + floor + _TINY)
        rounding = jnp.maximum(_FIXED * jnp.abs(value), _FIXED / LEAST * floor) * unit
        sizes.append(functools.reduce(jnp.maximum, (jnp.abs(second), power, rounding)))
    return sizes


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
        tape: where the steps are written.
        saved: the states at times so far.
    """

    goes_on: Flag
    motion: Flight
    elapsed: tuple[Scalar, ...]
    amplification: Scalar
    tape: Tape | None
    saved: Saved | None


def _chain(problem: Extended, rtol: Scalar, tape: Tape | None, saved: Saved | None) -> LaneEnd:
    """Integrate one lane through events that it survives.

    At each event the state gets its total derivatives, those of the event's time included; the reset is pushed
    forward over them, and the next motion starts on its own clock. So there are no saltation matrices.
    """
    equations, until = problem.equations, problem.until
    end_of = functools.partial(jax.tree.map, lambda part, gone: part - gone)

    def flown(chain: _Chain) -> _Chain:
        before = chain.motion
        rest = end_of(until, equations.unpack(chain.elapsed))
        motion, along, tape, saved = _to_its_event(
            problem, jax.tree.leaves(before.members), rest.value, rtol, chain.tape, chain.saved,
            before=before, elapsed=chain.elapsed,
        )  # fmt: skip
        end = _at_its_event(problem, motion, along, lambda at, _: at, rest)
        members = equations.pack(end.outputs)
        elapsed = tuple(map(jnp.add, chain.elapsed, equations.pack(end.time)))
        last, count, happens = _in_turn(problem, members[0], motion, before.count)
        if tape is not None:
            tape = tape.with_event(motion.event, happens, jax.tree.leaves(members))
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
        return _Chain(goes_on, motion, elapsed, amplification, tape, saved)

    zero = 0.0 * problem.time_scale
    control = step_control.begin(problem.time_scale, jnp.asarray(True), jnp.asarray(True), FIRST_STEP)
    none = 0 * control.mode
    nothing = [jnp.asarray(False)] * len(problem.directions)
    sizes = _greatest(problem, [0.0 * row for row in problem.initial], problem.initial)
    shift = stiff.no_shift(problem)
    start = Flight(control, problem.members(problem.initial), none - 1, zero, none, nothing, sizes, shift)
    elapsed = tuple(zero for _ in problem.members(problem.initial))
    chain = _Chain(jnp.asarray(True), start, elapsed, zero + 1.0, tape, saved)
    chain = lax.while_loop(lambda chain: chain.goes_on, flown, chain)
    outputs = equations.of(outputs_of, chain.motion.members)
    end = AtEvent(equations.unpack(chain.elapsed), outputs, chain.amplification)
    return _finish(problem, chain.motion, end, rtol, chain.saved, chain.tape)


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
