"""Where the lanes of a block stand, and what a trial step changes about it.

Straight-line arithmetic of one lane's numbers, so that a kernel can do it for all lanes at once.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from erosion.crossings import Ends

ADVANCING, LOCATING, ENDED, FAILED, UNFINISHED = range(5)

NO_CUT = -1
"""The event index of a lane in which nothing is cut."""

_SAFETY = 0.8  # of the step that would just do
_LONGEST_CUT = 1e4  # of the model's time scale; later is "unfinished"
_MAX_TRIALS = 20_000
_REJECTED = 64  # trials, and one more for each eight accepted: then the error must be rounding
_NEAR = 1e-2  # of the time scale, the cut and a good step: this near a steep fall, a short step and Newton do the rest
_NEAR_FLAT = 1e-3  # likewise, a flat one
_SETTLED = 1e-6  # of that: as exactly a flat fall must be expected
_AHEAD = 3.0  # trials: as far beyond its end as an event is looked for


class Clock(NamedTuple):
    """Where a lane stands: the rows of one array of floats, no more than `WIDTH`."""

    mode: Any
    time: Any  # from contact to the start of the step
    trial: Any  # the length to try next
    step: Any  # the length the error control would like
    high: Any  # while locating: a length past the event
    which: Any
    left: Any  # from the last trial's end to the event
    moved: Any  # whether the lane took the last trial


class Record(NamedTuple):
    """What a lane went through: the rows of another."""

    trials: Any
    rejected: Any  # of them, those whose error was too large
    margin: Any  # the least value that an event function dipped to so far


def bracket(clock: Clock, error: Any, past: Any, soon: Any) -> list[Any]:
    """Lengths before and past the event, whether the trial's end is past it, and whether it may come soon.

    A length past the event is known while locating; else it is as far as to look ahead.
    """
    ahead = jnp.where(clock.mode == LOCATING, clock.high, _AHEAD * clock.trial)
    high = jnp.where(_good(clock, error) & past, clock.trial, ahead)
    return [jnp.where(past, 0.0, clock.trial), high, past.astype(float), soon.astype(float)]


def _good(clock: Clock, error: Any) -> Any:
    """Whether a trial counts: while locating, any that is shorter than the one that did, if it is finite."""
    return jnp.where(clock.mode == LOCATING, jnp.isfinite(error), error <= 1)


def decide(
    clock: Any, record: Any, error: Any, scale: Any, dips: Any, fences: Any, falls: Sequence[Any]
) -> tuple[Clock, Record]:
    """Clock and record after a trial.

    Args:
        clock: its rows before it.
        record: likewise.
        error: over the tolerance; NaN is an error.
        scale: the model's time scale.
        dips: see `dip_in_step`; the least of all events. A dip that may reach below zero is
            landed on before anything is decided.
        fences: see `bracket`.
        falls: when each event is expected to fall through zero, from the trial's start; else infinity.
            Then of the first of them, whether it is steep, and how far its time may be off.
    """
    clock, dip, high, past = Clock(*clock), dips[0], fences[1], fences[2] > 0
    going, locating = clock.mode <= LOCATING, clock.mode == LOCATING
    good = _good(clock, error)
    landing, fits = good & (dip < 1), good & (dip >= 1)
    bracketed = good & (past | locating)
    *roots, steep, off = falls
    expected = functools.reduce(jnp.minimum, roots)
    which = jnp.zeros_like(expected)
    for i, root in enumerate(roots):
        which = jnp.where(root == expected, float(i), which)
    left = expected - clock.trial
    size = jnp.minimum(jnp.minimum(scale, clock.step), clock.time + clock.trial)
    flat = jnp.where(off <= _SETTLED * _NEAR_FLAT * size, _NEAR_FLAT * size, -1.0)
    ended = going & fits & (jnp.abs(left) <= jnp.where(steep > 0, _NEAR * size, flat))
    # A locating lane moves on as well, or it would look for ever at both sides of a dip.
    accepted = going & fits & ~past & ~ended

    step = jnp.where(locating, clock.step, _next_step(clock, error, good))
    aim = jnp.where(past, expected, left)
    trial = jnp.where(landing, dip * clock.trial, jnp.where(bracketed | (good & (left < step)), aim, step))
    mode = jnp.where(bracketed & ~landing, float(LOCATING), clock.mode)
    after, record = _after(clock, record, scale, mode, step, trial, good=good, moved=accepted | ended, least=dips[1])
    mode = jnp.where(going & locating & ~good, FAILED, after.mode)
    after = after._replace(
        mode=jnp.where(ended, ENDED, mode),
        high=jnp.where(accepted, high - clock.trial, high),
        which=jnp.where(ended, which, clock.which),
        left=jnp.where(ended, left, clock.left),
    )
    return after, record


def first_fall(clock: Clock, events: Sequence[Ends]) -> tuple[Any, Any]:
    """Which event a lane ends at, and what time remains to it, given the events where it was expected.

    Of events that fall almost together the trial's cubics may have expected the wrong one first:
    they are off by far less than the way that was left.
    """
    newton = [-event.value / event.rate for event in events]
    which = clock.which
    remaining = sum(jnp.where(which == i, time, 0.0) for i, time in enumerate(newton))
    for i, (event, time) in enumerate(zip(events, newton, strict=True)):
        earlier = (event.rate < 0) & (time < remaining) & (time > -jnp.abs(clock.left)) & (which != NO_CUT)
        which, remaining = jnp.where(earlier, float(i), which), jnp.where(earlier, time, remaining)
    return which, remaining


def go_on(clock: Any, record: Any, error: Any, scale: Any, dips: Any) -> tuple[Clock, Record]:
    """Clock and record after a trial that came close to no event: `decide` for less."""
    clock, good = Clock(*clock), error <= 1
    step = _next_step(clock, error, good)
    moved = good & (clock.mode == ADVANCING)
    return _after(clock, record, scale, clock.mode, step, step, good=good, moved=moved, least=dips[1])


def _next_step(clock: Clock, error: Any, good: Any) -> Any:
    """The length that the error control would like, of the order of the embedded estimate."""
    factor = _SAFETY / eighth_root(error + 1e-30)
    wanted = jnp.where(jnp.isfinite(error), jnp.clip(factor, 0.2, 5.0), 0.2) * clock.trial
    # Steps cut short to land on a dip or at an event say little about the step to take next.
    return jnp.where(good & (clock.trial < clock.step), jnp.maximum(wanted, clock.step), wanted)


def _after(
    clock: Clock, record: Any, scale: Any, mode: Any, step: Any, trial: Any, *, good: Any, moved: Any, least: Any
) -> tuple[Clock, Record]:
    """Clock and record with one trial more, and whether the lane gives up."""
    record = Record(*record)
    going = clock.mode <= LOCATING
    time = clock.time + jnp.where(moved, clock.trial, 0.0)
    rejected = record.rejected + (going & ~good)
    hopeless = rejected > _REJECTED + (record.trials - record.rejected) / 8
    mode = jnp.where((time > _LONGEST_CUT * scale) | (record.trials >= _MAX_TRIALS), UNFINISHED, mode)
    mode = jnp.where(~(trial > 1e-14 * scale) | hopeless, FAILED, mode)
    after = clock._replace(
        mode=jnp.where(going, mode, clock.mode),
        time=time,
        trial=jnp.where(going, trial, clock.trial),
        step=step,
        moved=moved.astype(float),
    )
    margin = jnp.where(moved, jnp.minimum(record.margin, least), record.margin)
    return after, Record(record.trials + going, rejected, margin)


def eighth_root(value: Any) -> Any:
    """The root of the step control's order; XLA's `pow` on a CPU is one library call a number."""
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(value)))
