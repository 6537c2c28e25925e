"""Where the motion of a lane ends: at its event, by Newton's method from the last step, or at a time."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.ode import crossings, stiff
from erosion.ode.crossings import Ends, Watched
from erosion.ode.explicit import SOON, short_step
from erosion.ode.extended import Extended
from erosion.ode.kinks import is_kinked
from erosion.ode.reduction import Rows
from erosion.ode.step_control import ENDED, FAILED, FIRST_STEP, NOT_BEGUN, Control
from erosion.ode.variational import Along, AlongFlow, Augmented

_INSIDE = 1e-10  # of the time scale: as near to an end beyond which the motion is not defined
_BESIDE = 1e-12  # the same beside an end at which a rate has a kink or a jump
_VANISHES = 1e-5  # of the time scale: a divisor that is zero as soon leaves too few digits of second derivatives
_SHARE = 0.98  # of the way to it is a step, by Newton's method
_ULPS = 1e-15  # of the time so far: rounding
_ORDERS, _ROUNDS = 64.0, 100  # of a zero, and of the search for it, at most
_BENDS = 0.01  # of what is left of a step: by less a rate changes where rounding hides the zero
_HIDDEN = 1e-5  # of the time scale: what Newton's method says beside a zero that is no rounding
_MOSTLY = 0.99  # of the way to such a zero is a step
_LONG = 0.1  # of the time scale: a way to the event by Newton's method that is no graze's


class Lane(NamedTuple):
    """A lane under way: its control, and the events, state and slopes at the start of its next step.

    An event of the last step is one that counted where that step began: `watched`.
    `greatest` is the greatest size so far of each row of the motion itself, where the whole state is wanted.
    `shift` holds the derivatives of the time by which a stiff motion was shifted, see `stiff.shifted`; `stiff` counts
    steps that only stability made short, where they are watched. `longest` is the longest step so far, where a rate may
    jump and the problem names no time scale: what a row at zero gains in it is its size.
    """

    control: Control
    events: list[Ends]
    state: Rows
    slope: Rows
    watched: list[Watched]
    greatest: Rows
    shift: Rows
    stiff: Scalar | None
    longest: Scalar | None


class Flight(NamedTuple):
    """A motion to its first event.

    Args:
        control: at its end.
        members: state and integrals at the event, with derivatives at a fixed time.
        event: its index; below 0 if there is none.
        time: since the motion began.
        count: events so far, of all motions of a chain.
        at_once: for each event whether it happens there.
        greatest: the greatest size of each row of the motion itself, where the whole state is wanted.
    """

    control: Control
    members: tuple[Augmented, ...]
    event: Scalar
    time: Scalar
    count: Scalar  # pyright: ignore[reportIncompatibleMethodOverride]
    at_once: Sequence[Flag]
    greatest: Rows
    shift: Rows


def landed(problem: Extended, lane: Lane, until: Scalar | None) -> tuple[Flight, Along]:
    """The motion to where its last step found its end; with how what is wanted there depends on the event's time."""
    motion, along = (_by_a_short_step if problem.rodas is None else _by_the_last_step)(problem, lane, until)
    if not problem.order:
        return motion, along
    lost = has_no_derivatives(problem, motion)
    control = motion.control._replace(mode=jnp.where(lost, FAILED, motion.control.mode))
    at_once = [event & ~lost for event in motion.at_once]
    return motion._replace(control=control, at_once=at_once, count=jnp.where(lost, 0, motion.count)), along


def has_no_derivatives(problem: Extended, motion: Flight) -> Flag:
    """Whether derivatives at the end of a motion are not defined, as far as nothing else tells.

    A rate that divides by what vanishes there leaves nothing but rounding of them, as of those of sin(v)/v.
    """
    if problem.rough or not problem.options.waits:
        return jnp.asarray(False)
    rows: Rows = jax.tree.leaves(motion.members[0])
    scale = problem.scale_near(motion.control.step, FIRST_STEP)
    ends = zip(*jax.jvp(problem.dividing, (rows,), (problem.motion_rate(rows),)), strict=True)
    vanish = (~(jnp.abs(value) > _VANISHES * scale * jnp.abs(rate)) for value, rate in ends)
    return (motion.control.mode == ENDED) & functools.reduce(jnp.logical_or, vanish, jnp.asarray(False))


def _by_a_short_step(problem: Extended, lane: Lane, until: Scalar | None) -> tuple[Flight, Along]:
    """The motion where its last step found its end."""
    control, options = lane.control, problem.options
    scale = problem.scale_near(control.step, FIRST_STEP)
    left, state, moves = _to_the_end(problem, lane, scale)
    search = None
    if options.waits:
        search = _searched(problem, lane, left, state, moves, scale)
        left, state, slope = search.left, search.rows, search.slope
        # What is rounding has no zero.
        lost = search.slow & ~(_ORDERS * jnp.abs(search.time) < _HIDDEN * scale)
        control = control._replace(mode=jnp.where(lost, FAILED, control.mode))
        events = [
            crossings.silenced(crossings.turned(event, watched.turn), watched.counts | (control.event == i))
            for i, (event, watched) in enumerate(zip(search.events, lane.watched, strict=True))
        ]
    else:
        slope, events = problem.rate_and_events(state)
    ended = (control.mode == ENDED) & (control.event != NOT_BEGUN)
    event, remaining = crossings.first_fall(control, events)
    if options.waits and until is not None:
        event, remaining = crossings.last_moment(event, remaining, events, scale)
    remaining = jnp.where(ended, remaining, 0.0)
    if search is not None:
        # The derivatives are those beside such a zero: at it they are 0/0.
        remaining, moves = jnp.where(search.slow, search.length, remaining), moves & ~search.slow
    rows: Rows = [u + jnp.where(moves, remaining, 0.0) * k for u, k in zip(state, slope, strict=True)]
    rest = None if search is None and not problem.rough else jnp.where(moves, 0.0, remaining)
    along = AlongFlow(problem.equations, problem.members(rows), rest)
    at_once = _at_once(problem, ended, event, remaining, events, scale)
    motion = _motion(lane._replace(control=control), along.members, event, control.time + left + remaining, at_once)
    return motion, along


class _Search(NamedTuple):
    """The way to an event that Newton's method does not reach soon.

    Args:
        rounds: so far.
        left: time since the last trial.
        rows, slope, events: there.
        time: to the zero by Newton's method.
        low, high: times before and after the zero.
        length: of the next step.
        slow: whether Newton's method alone is too slow.
    """

    rounds: Scalar
    left: Scalar
    rows: Rows
    slope: Rows
    events: list[Ends]
    time: Scalar
    low: Scalar
    high: Scalar
    length: Scalar
    slow: Flag


def _searched(problem: Extended, lane: Lane, start: Scalar, state: Rows, moves: Flag, scale: Scalar) -> _Search:
    """Take one more short step before Newton's last, as an event function may bend more than the motion.

    Towards a zero of higher order, as of (y - 1)⁵, or one beside other zeros, Newton's method leaves a share of the way
    at each step. There the steps are as many times longer as the zero has orders, or halve what is known to hold it,
    and end beside it.
    """
    control = lane.control
    near = jnp.maximum(_BESIDE * scale, _ULPS * control.time)
    happens = moves & (control.mode == ENDED) & (control.event >= 0)

    def chosen(parts: Sequence[Scalar]) -> Scalar:
        return sum((jnp.where(control.event == i, part, 0.0) for i, part in enumerate(parts)), jnp.zeros(()))

    def rate_of(events: Sequence[Ends]) -> Scalar:
        return chosen([event.rate for event in events])

    def at(left: Scalar, rows: Rows, before: _Search | None) -> _Search:
        slope, events = problem.rate_and_events(rows)
        time = chosen([-event.value / event.rate for event in events])
        fits = happens & jnp.isfinite(time) & (jnp.abs(time) < jnp.abs(start) + SOON * scale)
        simple = jnp.where(fits, time, 0.0)
        if before is None:
            far = simple + jnp.inf
            return _Search(0 * control.mode, left, rows, slope, events, simple, -far, far, simple, jnp.asarray(False))
        # Newton's last step leaves the third power of this one over the square of that before. By as much the rate
        # has changed, if it is not rounding that hides the zero.
        ratio = jnp.abs(time / before.time)
        bends = jnp.abs(rate_of(events) / rate_of(before.events) - 1) > _BENDS * ratio
        far = (jnp.abs(time) > near) & (jnp.abs(time) * ratio * ratio > near)
        # Behind a kink of the function a step along a line is too long, unless its rate has gone, as at a graze.
        straight = jnp.abs(rate_of(events) / rate_of(before.events) - 1) < _BENDS
        long = happens & ~fits & straight & (jnp.abs(time) < _LONG * scale)
        slow = before.slow | ((before.rounds == 0) & ((fits & bends & far) | long))
        turns = zip(lane.watched, events, strict=True)
        is_before = chosen([watched.turn * event.value for watched, event in turns]) > 0
        low, high = jnp.where(is_before, left, before.low), jnp.where(is_before, before.high, left)
        order = jnp.clip(before.length / (before.time - time), 1.0, _ORDERS)
        aim = _MOSTLY * order * time
        inside = (left + aim > low) & (left + aim < high)
        shorter = jnp.abs(aim) < jnp.abs(before.length) / 2
        bracketed = high - low < jnp.inf
        further = jnp.where(is_before, 2.0, -2.0) * jnp.abs(before.length)
        length = jnp.where(inside & (shorter | ~bracketed), aim, jnp.where(bracketed, (low + high) / 2 - left, further))
        return _Search(
            before.rounds + 1, left, rows, slope, events, time, low, high, jnp.where(slow, length, 0.0), slow
        )

    def goes_on(search: _Search) -> Flag:
        far = (
            (jnp.abs(search.length) > near) & (search.high - search.low > near) & (jnp.abs(search.left - start) < scale)
        )
        return (search.rounds == 0) | (search.slow & far & (search.rounds < _ROUNDS))

    def nearer(search: _Search) -> _Search:
        rows = short_step(problem, search.rows, search.slope, search.length)
        return at(search.left + search.length, rows, search)

    return lax.while_loop(goes_on, nearer, at(start, state, None))


class _Landing(NamedTuple):
    """The last step of a stiff motion on its way to the event.

    Args:
        rounds: of Newton's method so far.
        length: of the step.
        event, remaining: which event is first, and how much longer the step must be, where `events` were looked at.
        events: event functions after the step, turned so that they fall to their events.
        step: rows after the step, and their derivatives by its length.
    """

    rounds: Scalar
    length: Scalar
    event: Scalar
    remaining: Scalar
    events: list[Ends]
    step: tuple[Rows, Rows, Rows]


def _by_the_last_step(problem: Extended, lane: Lane, until: Scalar | None) -> tuple[Flight, Along]:
    """The same by the method for stiff motions: the length of the last step is what Newton's method finds.

    The step is written once, in a loop: it is most of a program for many unknowns.
    """
    control, options = lane.control, problem.options
    scale = problem.scale_near(control.step, FIRST_STEP)
    watched = crossings.watch(problem.directions, lane.events, scale) if options.waits else []
    ended = (control.mode == ENDED) & (control.event != NOT_BEGUN)

    def nearer(landing: _Landing) -> _Landing:
        along = stiff.last_step(problem, lane.state, lane.slope, lane.greatest, landing.length)
        events = along.events
        if options.waits:
            events = [
                crossings.silenced(crossings.turned(event, each.turn), each.counts | (control.event == i))
                for i, (event, each) in enumerate(zip(events, watched, strict=True))
            ]
        more = sum(
            (jnp.where(control.event == i, -each.value / each.rate, 0.0) for i, each in enumerate(events)),
            jnp.zeros(()),
        )
        near = ended & (jnp.abs(more) < stiff.NEAR * landing.length)
        event, remaining = crossings.first_fall(control, events)
        if options.waits and until is not None:
            event, remaining = crossings.last_moment(event, remaining, events, scale)
        found = event, jnp.where(ended, remaining, 0.0), events
        # The first round finds the place of the event that was seen, the second which is the first there.
        looks = landing.rounds == 1
        event, remaining, events = jax.tree.map(
            functools.partial(jnp.where, looks), found, (landing.event, landing.remaining, landing.events)
        )
        moves = jnp.where(landing.rounds == 0, jnp.where(near, more, 0.0), jnp.where(looks, remaining, 0.0))
        step = along.rows, along.rates, along.curves
        return _Landing(landing.rounds + 1, landing.length + moves, event, remaining, events, step)

    length = stiff.length_of(control.left, scale)
    nothing = [0.0 * row for row in lane.state]
    landing = _Landing(
        0 * control.mode, length, control.event, 0.0 * length, lane.events,
        (nothing, nothing, nothing[: problem.width]),
    )  # fmt: skip
    landing = lax.while_loop(lambda landing: landing.rounds < 3, nearer, landing)
    stepped = control.left > 0
    rows, rates, curves = landing.step
    rows: Rows = [jnp.where(stepped, new, old) for new, old in zip(rows, lane.state, strict=True)]
    along = stiff.LastStep(problem, rows, rates, curves, lane.greatest)
    at_once = _at_once(problem, ended, landing.event, landing.remaining, landing.events, scale)
    time = control.time + jnp.where(stepped, landing.length, 0.0)
    return _motion(lane, problem.members(rows), landing.event, time, at_once), along


def _at_once(
    problem: Extended, ended: Flag, event: Scalar, remaining: Scalar, events: Sequence[Ends], scale: Scalar
) -> list[Flag]:
    """For each event whether it happens at the end."""
    happened = ended & (event >= 0)
    near = crossings.at_once(events, remaining, scale) if problem.options.clock else [jnp.asarray(False)] * len(events)
    return [happened & (there | (event == i)) for i, there in enumerate(near)]


def _motion(lane: Lane, members: tuple[Augmented, ...], event: Scalar, time: Scalar, at_once: Sequence[Flag]) -> Flight:
    happened = (lane.control.mode == ENDED) & (event >= 0)
    count = lax.convert_element_type(happened, np.int32)
    return Flight(lane.control, members, event, time, count, at_once, lane.greatest, lane.shift)


def _to_the_end(problem: Extended, lane: Lane, scale: Scalar) -> tuple[Scalar, Rows, Flag]:
    """The time from the last trial to the end, the state there, and whether it may move to the event itself.

    A force such as depth^1.5 is not defined above the surface, and |v| has another slope beyond v = 0. At such an event
    only the side from which the motion comes counts: Newton's method ends a little before it.
    """
    left = lane.control.left
    state = short_step(problem, lane.state, lane.slope, left)
    if not problem.rough:
        return left, state, jnp.asarray(True)

    def remaining(events: list[Ends]) -> Scalar:
        times = (jnp.where(lane.control.event == i, -end.value / end.rate, 0.0) for i, end in enumerate(events))
        return sum(times, jnp.zeros(()))

    def nearer(at: tuple[Scalar, Rows, Rows, Scalar]) -> tuple[Scalar, Rows, Rows, Scalar]:
        passed, rows, slope, fall = at
        length = _SHARE * fall
        rows = short_step(problem, rows, slope, length)
        slope, events = problem.rate_and_events(rows)
        return passed + length, rows, slope, remaining(events)

    def inside() -> tuple[Scalar, Rows, Flag]:
        start = (0.0 * left, lane.state, lane.slope, jnp.minimum(remaining(lane.events), left))
        beside = jnp.where(reached, _BESIDE, _INSIDE) * scale
        passed, rows, *_ = lax.while_loop(lambda at: at[-1] > beside, nearer, start)
        return passed, rows, jnp.asarray(False)

    slope, events = problem.rate_and_events(state)
    event = [u + remaining(events) * k for u, k in zip(state, slope, strict=True)]
    reached = defined = all_finite([*state, *slope, *problem.rate(event)])
    if problem.options.waits:
        # One more short step follows: where the event is the edge of what is defined, rounding might pass over it.
        beyond = [u + _BESIDE * scale * k for u, k in zip(event, slope, strict=True)]
        defined = defined & all_finite(problem.rate(beyond))
    happens = (lane.control.mode == ENDED) & (lane.control.event >= 0)
    kinked = happens & is_kinked(problem, event, slope, scale)
    return lax.cond(defined & ~kinked, lambda: (left, state, jnp.asarray(True)), inside)


def all_finite(rows: Rows) -> Flag:
    """Whether each of them is."""
    return functools.reduce(jnp.logical_and, map(jnp.isfinite, rows))
