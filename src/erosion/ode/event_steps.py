"""Where a lane ends: what a trial step says about the events, and what follows near one.

A step is shortened to end where an event is expected. A lane whose step went past an event locates it: it
tries again **from the same start** with the length at which it expects the event. So the state at the event
has the full order of the method, not an interpolant's.
"""

import functools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from erosion.array_types import Flag, Scalar
from erosion.ode.crossings import (
    Ends,
    crest_in_step,
    cubic_error,
    dip_in_step,
    expected_fall,
    is_crooked,
    may_hide_a_fall,
)
from erosion.ode.step_control import (
    ADVANCING,
    ARRIVED,
    ENDED,
    FAILED,
    LOCATING,
    Control,
    Limits,
    counted,
    given_up,
    goes_on,
    next_step,
)

# Of the time scale, the time so far and a good step: this near a steep fall, a short step and Newton's do the rest.
_NEAR = 1e-2
_NEAR_FLAT = 1e-3  # the same for a flat one
_SETTLED = 1e-6  # of that: as exactly a flat fall must be expected
_AHEAD = 3.0  # trials: as far beyond its end as an event is looked for
_IMMINENT = 2.0  # trials, at the rate of now: an event that near is worth looking for
_ROUGH_NEAR = 1e-9  # of the time scale: near enough for a motion whose rates may be infinite at the end
_LONG = 1e-3  # of the time scale: a shorter step is already there for a kink
_SHORT_OF_IT = 0.999  # of the way to an expected event
_TOO_LONG = 256.0  # an error over the tolerance, for which the next step is 0.4 times as long


class Trial(NamedTuple):
    """What is known after a trial step."""

    error: Scalar  # over the tolerance; NaN is an error
    start: Sequence[Ends]  # the event functions where it began
    end: Sequence[Ends]  # the event functions where it ended
    dip: Scalar  # where in the step, from 0 to 1, an event function may dip to zero and return; 2 if none does
    lowest: Scalar  # the least value in the step
    past: Flag  # whether its end is past an event
    imminent: Flag  # whether an event is so near the end that it is worth looking for
    low: Scalar  # a length before the event
    high: Scalar  # a length past the event, or how far to look ahead
    cubic_errors: Sequence[Scalar]  # of each event function; see `cubic_error`


def look(
    control: Control,
    start: Sequence[Ends],
    end: Sequence[Ends],
    within: Sequence[tuple[float, Sequence[Scalar]]],
    error: Scalar,
    scale: Scalar,
    *,
    rough: bool = False,
) -> Trial:
    """What a trial says about events; `within` holds their values at some shares of the step.

    Where the motion is `rough`, a step ends at a crest of an event function as it does at a dip: between two
    stages the motion may go behind a kink, and return unseen.
    """
    errors = [
        cubic_error(*each, control.trial, [(theta, values[i]) for theta, values in within])
        for i, each in enumerate(zip(start, end, strict=True))
    ]
    dips = [dip_in_step(*each, control.trial, error) for *each, error in zip(start, end, errors, strict=True)]
    places = [dip for dip, _ in dips]
    if rough:
        # Where a force jumps, an event function may turn at once: steps that short need not end there.
        long = control.trial > _LONG * scale
        crests = [crest_in_step(*each, control.trial) for each in zip(start, end, strict=True)]
        places += [jnp.where(long, crest, 2.0) for crest in crests]
    past = _any(event.value <= 0 for event in end)
    ahead = jnp.where(control.mode == LOCATING, control.high, _AHEAD * control.trial)
    return Trial(
        error=error,
        start=start,
        end=end,
        dip=_least(places, 2.0),
        lowest=_least([lowest for _, lowest in dips], jnp.inf),
        past=past,
        imminent=_any(event.value < -_IMMINENT * control.trial * event.rate for event in end),
        low=jnp.where(past, 0.0, control.trial),
        high=jnp.where(_good(control, error) & past, control.trial, ahead),
        cubic_errors=errors,
    )


def is_near_an_end(control: Control, trial: Trial) -> Flag:
    """Whether an event may be in the step or near its end."""
    advancing = control.mode == ADVANCING
    crooked = _any(is_crooked(*each, control.trial, error) for *each, error in _events(trial))
    return (control.mode == LOCATING) | (advancing & (trial.past | trial.imminent | crooked | (trial.dip < 1)))


def decide(
    control: Control, trial: Trial, scale: Scalar, limits: Limits, *, rough: bool = False
) -> tuple[Control, Flag]:
    """The control after a trial near an event, and whether the lane moves to the trial's end.

    Where the motion is `rough`, it may not be defined past its end, and a step towards it ends a little before it.

    Where a dip may reach below zero, the next step ends there before anything else is decided. Where a body
    turns by radians within a step, the cubic says little: the step is too long if an event may be in it.
    """
    hidden = _any(
        is_crooked(*each, control.trial, error) & may_hide_a_fall(*each, control.trial, error)
        for *each, error in _events(trial)
    )
    too_long = (control.mode == ADVANCING) & hidden
    trial = trial._replace(error=jnp.where(too_long, jnp.maximum(trial.error, _TOO_LONG), trial.error))
    locating, past = control.mode == LOCATING, trial.past
    good = _good(control, trial.error)
    lands, fits = good & (trial.dip < 1), good & (trial.dip >= 1)
    bracketed = good & (past | locating)
    expected, event, steep, uncertainty = _first_expected(control, trial)
    left = expected - control.trial
    size = jnp.minimum(jnp.minimum(scale, control.step), control.time + control.trial)
    flat = jnp.where(uncertainty <= _SETTLED * _NEAR_FLAT * size, _NEAR_FLAT * size, -1.0)
    near = jnp.maximum(_NEAR * size, _ROUGH_NEAR * scale) if rough else _NEAR * size
    ended = fits & (jnp.abs(left) <= jnp.where(steep, near, flat))
    # A lane that locates moves on as well, or it would look at both sides of a dip for ever.
    accepted = fits & ~past & ~ended

    step = jnp.where(locating, control.step, next_step(control, trial.error, good))
    aim = jnp.where(past, expected, _SHORT_OF_IT * left if rough else left)
    length = jnp.where(lands, trial.dip * control.trial, jnp.where(bracketed | (good & (left < step)), aim, step))
    after = counted(control, trial.lowest, good | too_long, accepted | ended)._replace(
        mode=jnp.where(bracketed & ~lands, LOCATING, control.mode),
        step=step,
        trial=length,
        high=jnp.where(accepted, trial.high - control.trial, trial.high),
        event=jnp.where(ended, event, control.event),
        left=jnp.where(ended, left, control.left),
    )
    after = given_up(after, scale, limits)
    mode = jnp.where(ended, ENDED, jnp.where(locating & ~good, FAILED, after.mode))
    return after._replace(mode=mode), accepted | ended


def stop_at(control: Control, until: Scalar) -> Control:
    """Go no further than to a time: the next step ends there, and so does the lane."""
    rest = until - control.time
    # An event located beyond that time does not count.
    over = (control.mode == ENDED) & (control.event >= 0) & (control.left > rest)
    arrived = goes_on(control) & (rest <= 0)
    return control._replace(
        mode=jnp.where(arrived, ENDED, control.mode),
        event=jnp.where(arrived | over, ARRIVED, control.event),
        left=jnp.where(arrived, 0.0, jnp.where(over, rest, control.left)),
        trial=jnp.where(goes_on(control) & (rest > 0), jnp.minimum(control.trial, rest), control.trial),
    )


def first_fall(control: Control, events: Sequence[Ends]) -> tuple[Scalar, Scalar]:
    """The index of the event that ends the lane, and the time that remains, from the events where it was expected.

    Where two events fall almost together, the trial's cubics may have expected the wrong one first:
    they err by far less than the time that was left.
    """
    newton = [-event.value / event.rate for event in events]
    index = control.event
    remaining: Scalar = sum((jnp.where(index == i, time, 0.0) for i, time in enumerate(newton)), jnp.zeros(()))
    for i, (event, time) in enumerate(zip(events, newton, strict=True)):
        earlier = (event.rate < 0) & (time < remaining) & (time > -jnp.abs(control.left)) & (index >= 0)
        index, remaining = jnp.where(earlier, i, index), jnp.where(earlier, time, remaining)
    return index, remaining


def _events(trial: Trial) -> list[tuple[Ends, Ends, Scalar]]:
    return list(zip(trial.start, trial.end, trial.cubic_errors, strict=True))


def _any(conditions: Iterable[Flag]) -> Flag:
    return functools.reduce(jnp.logical_or, conditions, jnp.asarray(False))


def _least(values: Iterable[Scalar], otherwise: float) -> Scalar:
    return functools.reduce(jnp.minimum, values, jnp.asarray(otherwise))


def _good(control: Control, error: Scalar) -> Flag:
    """Whether a trial counts: while locating every finite trial does, as a longer one from the same start did."""
    return jnp.where(control.mode == LOCATING, jnp.isfinite(error), error <= 1)


def _first_expected(control: Control, trial: Trial) -> tuple[Scalar, Scalar, Flag, Scalar]:
    """The time of the first event from the step's start, its index, whether it falls steeply, and the time's error."""
    advancing = control.mode == ADVANCING
    falls = []
    for before, after in zip(trial.start, trial.end, strict=True):
        root, steep, uncertainty = expected_fall(before, after, control.trial, trial.low, trial.high)
        # Events that have fallen at the trial's end are known; while locating before the event, all are.
        known = (after.value <= 0) | (~trial.past & ~advancing)
        foreseen = advancing & ~trial.past & trial.imminent & (after.rate < 0)
        falls.append((jnp.where(known | foreseen, root, jnp.inf), known | steep, steep, uncertainty))
    first = _least([root for root, *_ in falls], jnp.inf)
    sure, is_steep, error, index = True, False, 0.0 * first, 0 * control.mode
    for i, (root, trusted, steep, uncertainty) in enumerate(falls):
        # An event that is not sure to fall, but would be the first, may fall after the others.
        sure = ((root > first) | trusted) & sure
        is_steep, error = jnp.where(root == first, steep, is_steep), jnp.where(root == first, uncertainty, error)
        index = jnp.where(root == first, i, index)
    return jnp.where(sure, first, jnp.inf), index, is_steep, error
