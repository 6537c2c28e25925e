"""Where a lane ends: which event functions may fall through zero in a step, and what follows near one.

A step is shortened to end where an event is expected. A lane whose step went past an event locates it: it
tries again **from the same start** with the length at which it expects the event. So the state at the event
has the full order of the method, not an interpolant's.

An event is *armed* in a step at whose start its function is before zero, or at zero and leaving it. Every function is
multiplied by a sign, so that it falls to zero: of either direction by its sign at the step's start. It is brought to
order 1 in each step, as the functions come in any unit.
"""

import abc
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.ode.step_control import (
    ADVANCING,
    ARRIVED,
    ENDED,
    FAILED,
    LOCATING,
    Control,
    Limits,
    counted,
    foreseen_step,
    given_up,
    goes_on,
    next_step,
)

_ENDS = 0.02  # of a step: a lowest point that the cubic puts this far beyond an end may be at that end
_LANDED = 1e-6  # of a step: this near the lowest point of an event function, its sign is known
_STRAIGHT = 0.5  # of its slope at a step's end: an event function keeps at least as much up to an expected zero
_STEEP = 0.02  # of its slopes in a step: an event function that is flatter may turn before zero
_CONVERGED = 1e-3  # of a step: the cubic's zero is known when Newton's method would move by less
_NONE = 1e-200  # instead of no slope
_LOW = 0.1  # a local minimum's cubic errs by less than this times its variation times θ²(1-θ)², unless `is_crooked`
_MISSED = 0.05  # of the range of an event function in a step: by so much its cubic may miss values within the step
_FAR = 2.0  # times that range: a function so far from zero does not come to it
_EQUAL = 1e-12  # of its size: a smaller range is rounding
_SAMPLED = (0.25, 0.5, 0.75)  # of a step: where the cubic of a crooked function is asked


class Ends(NamedTuple):
    """An event function and its rate at one time."""

    value: Scalar
    rate: Scalar


# JAX traces these once, for all events and programs.
@functools.partial(jax.jit, static_argnames="smooth")
def unresolved(
    start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]], *, smooth: bool
) -> Scalar:
    """By how much an event function moves too fast for a step, as an error of 8th order over the tolerance.

    The cubic through both ends errs by the fourth power of the length. It may miss the values within the step by a
    share of the range of all values. Unless the function is `smooth` it may miss them by more where all are far from
    zero: at a kink its error stays the same share in any step.
    """
    values = [start.value, end.value, *(value for _, value in samples)]
    size = functools.reduce(jnp.maximum, map(jnp.abs, values))
    spread = functools.reduce(jnp.maximum, values) - functools.reduce(jnp.minimum, values)
    misses = [jnp.abs(value - _cubic(start, end, length, theta)) for theta, value in samples]
    miss = functools.reduce(jnp.maximum, misses)
    share = miss / (_MISSED * jnp.maximum(spread, _EQUAL * size) + _NONE)
    if smooth:
        return share * share
    is_far = functools.reduce(jnp.minimum, map(jnp.abs, values)) > _FAR * (spread + miss)
    return jnp.where(is_far, 0.0, share * share)


@jax.jit
def cubic_error(start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]]) -> Scalar:
    """How many times θ²(1-θ)² the cubic through both ends errs by, from the function's values within the step.

    Args:
        start: the event function where the step begins.
        end: the event function where the step ends.
        length: length of the step.
        samples: places in the step, from 0 to 1, and the values there.
    """
    worst: Scalar = 0.0
    for theta, value in samples:
        error = jnp.abs(value - _cubic(start, end, length, theta))
        worst = jnp.maximum(worst, error * (theta * (1 - theta)) ** -2)
    return worst


@jax.jit
def is_crooked(start: Ends, end: Ends, length: Scalar, error: Scalar) -> Flag:
    """Whether the cubic errs by more than a search for local minima assumes; see `cubic_error`."""
    return 2 * error > _LOW * length * (jnp.abs(start.rate) + jnp.abs(end.rate))


@jax.jit
def may_hide_a_fall(start: Ends, end: Ends, length: Scalar, error: Scalar) -> Flag:
    """Whether an event function may fall to zero within the step, given the error of its cubic."""
    low: Flag = end.value <= 0
    for theta in _SAMPLED:
        low = low | (_cubic(start, end, length, theta) <= 2 * error * (theta * (1 - theta)) ** 2)
    return low


def _cubic(start: Ends, end: Ends, length: Scalar, theta: Scalar) -> Scalar:
    """The cubic through both ends (Hermite), at a share of the step."""
    rest = 1 - theta
    values = rest**2 * (1 + 2 * theta) * start.value + theta**2 * (3 - 2 * theta) * end.value
    return values + length * theta * rest * (rest * start.rate - theta * end.rate)


@jax.jit
def minimum_in_step(start: Ends, end: Ends, length: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
    """Where in the step (0 to 1) an event function may dip to zero and return, or 2; and its least value.

    The cubic through both ends has its minimum at θ. It errs by less than a small multiple
    of θ²(1-θ)², so that a minimum above this error is harmless. The least value is that of the
    cubic, infinity where it only rises or falls, or has fallen at the end. For `error` see `cubic_error`.
    """
    from_, to, rise = length * start.rate, length * end.rate, end.value - start.value
    a, b = 3 * (from_ + to - 2 * rise), 2 * (3 * rise - 2 * from_ - to)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * from_, 0.0))
    # Of the two roots of the cubic's derivative, the one with positive curvature √….
    upper = jnp.where(b >= 0, -2 * from_ / (b + root), (root - b) / (2 * a))
    turns = b * b > 4 * a * from_
    inside = turns & (upper > 0) & (upper < 1)
    # A step that ends at a lowest point has it at its end, the next step at its start.
    near = turns & (upper > -_ENDS) & (upper < 1 + _ENDS)
    theta = jnp.where(near, jnp.clip(upper, 0.0, 1.0), 0.5)
    lowest = start.value + theta * (from_ + theta * (b / 2 + theta * (a / 3)))
    width = theta * (1 - theta)
    harmless = lowest > jnp.maximum(_LOW * (jnp.abs(from_) + jnp.abs(to)), 2 * error) * width**2
    # A function that is zero or below at the end has returned from a local minimum only if it has a local maximum
    # above zero after it.
    maximum, is_maximum = _maximum(start, end, length)
    is_maximum = is_maximum & (maximum > theta) & (maximum < 1)
    returns = (end.value > 0) | (is_maximum & (_cubic(start, end, length, jnp.where(is_maximum, maximum, 0.5)) > 0))
    place = jnp.where(inside & returns & ~harmless & (width > _LANDED), theta, 2.0)
    return place, jnp.where(near & (end.value > 0), lowest, jnp.inf)


@functools.partial(jax.jit, static_argnames="sharp")
def minimum_unless_clear(
    clear: Flag, start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]], sharp: float
) -> tuple[Scalar, Scalar, Flag]:
    """A local minimum as in `minimum_in_step`, and whether the step may hide a fall; neither where that is `clear`.

    The function may err by `sharp` times as much as its values within the step show.
    """

    def asked() -> tuple[Scalar, Scalar, Flag]:
        error = cubic_error(start, end, length, samples)
        place, lowest = minimum_in_step(start, end, length, error)
        error = sharp * error
        return place, lowest, is_crooked(start, end, length, error) & may_hide_a_fall(start, end, length, error)

    return lax.cond(clear, lambda: (jnp.asarray(2.0), jnp.asarray(jnp.inf), jnp.asarray(False)), asked)


def _maximum(start: Ends, end: Ends, length: Scalar) -> tuple[Scalar, Flag]:
    """Where the cubic through both ends turns from rising to falling, as a share of the step, and whether it does."""
    mean = (end.value - start.value) / length
    a, b = 3 * (start.rate + end.rate - 2 * mean), 2 * (3 * mean - 2 * start.rate - end.rate)
    # Of the two zeros of the rate start.rate + b θ + a θ² the one where it falls.
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * start.rate, 0.0))
    theta = jnp.where(b <= 0, 2 * start.rate / (root - b), -(root + b) / (2 * a))
    return theta, b * b > 4 * a * start.rate


@jax.jit
def maximum_above_zero(start: Ends, end: Ends, length: Scalar, error: Scalar) -> Scalar:
    """Where in the step (0 to 1) a function that begins below zero is highest before it falls to zero, or 2.

    For `error` see `cubic_error`.
    """
    theta, turns = _maximum(start, end, length)
    inside = turns & (theta > 0) & (theta < 1) & (theta * (1 - theta) > _LANDED)
    place = jnp.where(inside, theta, 0.5)
    minimum, _ = minimum_in_step(start, end, length, 0.0)
    height = _cubic(start, end, length, place)
    falls = (end.value <= jnp.maximum(_LANDED * height, 0.0)) | ((minimum > place) & (minimum < 1))
    # The cubic may put the maximum too low by as much as it may put a local minimum too high.
    slopes = length * (jnp.abs(start.rate) + jnp.abs(end.rate))
    doubt = jnp.maximum(_LOW * slopes, 2 * error) * (place * (1 - place)) ** 2
    return jnp.where(inside & falls & (height > -doubt), place, 2.0)


@jax.jit
def rise_unless_clear(
    clear: Flag, start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]]
) -> tuple[Scalar, Flag]:
    """A local maximum as in `maximum_above_zero`, and whether the step may hide a rise; neither where it is `clear`."""

    def asked() -> tuple[Scalar, Flag]:
        error = cubic_error(start, end, length, samples)
        maximum, below = maximum_above_zero(start, end, length, error), (signed(start, -1.0), signed(end, -1.0))
        error = _SHARP * error
        hidden = is_crooked(*below, length, error) & may_hide_a_fall(*below, length, error)
        return maximum, hidden & (end.value < 0)

    return lax.cond(clear, lambda: (jnp.asarray(2.0), jnp.asarray(False)), asked)


@jax.jit
def expected_fall(start: Ends, end: Ends, length: Scalar, low: Scalar, high: Scalar) -> tuple[Scalar, Flag, Scalar]:
    """When an event function is expected to fall through zero, whether steeply, and the error of that time.

    The zero is that of the cubic through both ends of a trial, continued beyond them where needed. It lies
    between two lengths: one before the event, and one past it or as far as to look.

    A function is steep if its slope at that zero is no small part of its slopes at the trial's ends.
    A flat one may turn before zero, and Newton's method converges slowly.
    """
    mean = (end.value - start.value) / length
    c3 = start.rate + end.rate - 2 * mean
    c2 = mean - start.rate - c3
    left, right = low / length, high / length

    def cubic(theta: Scalar) -> tuple[Scalar, Scalar]:
        value = start.value / length + theta * (start.rate + theta * (c2 + theta * c3))
        return value, start.rate + theta * (2 * c2 + theta * (3 * c3))

    # Newton from the trial's end, because an event function may start at zero.
    falls = end.rate < 0
    first = 1 - end.value / length / jnp.where(falls, end.rate, -1.0)
    theta = jnp.clip(jnp.where(falls, first, right), left, right)
    for _ in range(3):
        value, slope = cubic(theta)
        left, right = jnp.where(value > 0, theta, left), jnp.where(value > 0, right, theta)
        newton = theta - value / jnp.where(slope == 0, 1.0, slope)
        # A converged step may leave the bracket by rounding: that is no reason to bisect. Where the cubic does not
        # fall, as at a local minimum, a small value says nothing about how near its zero is.
        inside = (slope < 0) & (newton > left - 1e-9) & (newton < right + 1e-9)
        theta = jnp.where(inside, jnp.clip(newton, left, right), (left + right) / 2)
    value, slope = cubic(theta)
    error = jnp.minimum(jnp.abs(value / jnp.where(slope == 0, _NONE, slope)), right - left)
    steep = jnp.minimum(_STRAIGHT * end.rate, -_STEEP * (jnp.abs(start.rate) + jnp.abs(end.rate)))
    return length * theta, (slope < steep) & (end.rate < steep) & (error < _CONVERGED), length * error


# Of the time scale, the time so far and a good step: this near a steep fall, a short step and Newton's do the rest.
_NEAR = 1e-2
_NEAR_FLAT = 1e-3  # the same for a flat one
_SETTLED = 1e-6  # of that: as exactly a flat fall must be expected
_STIFF_NEAR, _STIFF_FLAT = 1e-3, 1e-6  # of a stiff motion's last step: Newton's method does the rest
_LAST_STEP = 0.2  # of the step before it is a stiff motion's last step at least
_PARTED, _NEARER = 0.3, 0.75  # of a step: a longer way to the event is gone in two
_AHEAD = 3.0  # trials: as far beyond its end as an event is looked for
_IMMINENT = 2.0  # trials, at the rate of now: an event that near is worth looking for
_NONSMOOTH_NEAR = 1e-9  # of the time scale: near enough for a motion whose rates may be infinite at the end
_SHORT_OF_IT = 0.999  # of the way to an expected event
_TOO_LONG = 256.0  # an error over the tolerance, for which the next step is 0.4 times as long


class Trial(NamedTuple):
    """What is known after a trial step."""

    error: Scalar  # over the tolerance; NaN is an error
    start: Sequence[Ends]  # the event functions where it began
    end: Sequence[Ends]  # the event functions where it ended
    minimum: Scalar  # where in the step, from 0 to 1, an event function may dip to zero and return; 2 if none does
    lowest: Scalar  # the least value in the step
    past: Flag  # whether its end is past an event
    imminent: Flag  # whether an event is so near the end that it is worth looking for
    low: Scalar  # a length before the event
    high: Scalar  # a length past the event, or how far to look ahead
    hidden: Flag  # whether an event may be in the step that its ends do not show


def look(
    control: Control,
    start: Sequence[Ends],
    end: Sequence[Ends],
    interior_samples: Sequence[tuple[float, Sequence[Scalar]]],
    error: Scalar,
    scale: Scalar,
    *,
    clear: Sequence[Flag],
    sharp: float = 1.0,
) -> Trial:
    """What a trial says about events; `interior_samples` holds their values at some shares of the step.

    At an event that is `clear` nothing is looked for within the step; see `are_clear`.
    """
    minima = [
        minimum_unless_clear(
            *each, control.trial_length, [(theta, values[i]) for theta, values in interior_samples], sharp
        )
        for i, each in enumerate(zip(clear, start, end, strict=True))
    ]
    places = [minimum for minimum, *_ in minima]
    past = _any(event.value <= 0 for event in end)
    ahead = jnp.where(control.mode == LOCATING, control.high, _AHEAD * control.trial_length)
    return Trial(
        error=error,
        start=start,
        end=end,
        minimum=_least(places, 2.0),
        lowest=_least([lowest for _, lowest, _ in minima], jnp.inf),
        past=past,
        imminent=_any(_is_imminent(event, control.trial_length) for event in end),
        low=jnp.where(past, 0.0, control.trial_length),
        high=jnp.where(_good(control, error) & past, control.trial_length, ahead),
        hidden=_any(hidden for *_, hidden in minima),
    )


class Ending(abc.ABC):
    """How the step that ends a lane is found from a trial near the event.

    Of a trial `expected` is the time to the event from its start, and `time_to_event` that from its end.
    """

    @abc.abstractmethod
    def nearness(self, control: Control, size: Scalar, scale: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
        """How near the end of a trial a steep fall may be that ends the lane, and a flat one."""

    def may_end(self, expected: Scalar, step: Scalar, past: Flag) -> Flag:
        """Whether the lane may end by such a trial."""
        return True

    def moves_lane(
        self, steep: Flag, time_to_event: Scalar, expected: Scalar, trial: Scalar, reach: Callable[[], Scalar]
    ) -> Flag:
        """Whether a trial that does not end the lane moves it."""
        return True

    def aim(self, expected: Scalar, time_to_event: Scalar, past: Flag, accepted: Flag, step: Scalar) -> Scalar:
        """The length of the next trial towards the event."""
        return jnp.where(past, expected, time_to_event)

    def moved(self, accepted: Flag, ended: Flag) -> Flag:
        """Whether the lane moves to the trial's end."""
        return accepted | ended

    def time_to_event(self, expected: Scalar, time_to_event: Scalar) -> Scalar:
        """The time to the event from where the lane stays."""
        return time_to_event


class ByAShortStep(Ending):
    """From the end of the last step, which is near the event."""

    def nearness(self, control: Control, size: Scalar, scale: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
        """See `Ending`."""
        return _NEAR * size, jnp.where(error <= _SETTLED * _NEAR_FLAT * size, _NEAR_FLAT * size, -1.0)


class ShortOfKinks(ByAShortStep):
    """The same of a motion that may not be defined past its end: a step towards it ends a little before it."""

    def nearness(self, control: Control, size: Scalar, scale: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
        """See `Ending`."""
        near, flat = super().nearness(control, size, scale, error)
        return jnp.maximum(near, _NONSMOOTH_NEAR * scale), flat

    def may_end(self, expected: Scalar, step: Scalar, past: Flag) -> Flag:
        """See `Ending`: beyond the event the rates may be others."""
        return jnp.logical_not(past)

    def aim(self, expected: Scalar, time_to_event: Scalar, past: Flag, accepted: Flag, step: Scalar) -> Scalar:
        """See `Ending`."""
        return _SHORT_OF_IT * super().aim(expected, time_to_event, past, accepted, step)


class ByTheLastStep(Ending):
    """From the start of the step that ends the lane, which is no short one, as of a stiff motion."""

    def nearness(self, control: Control, size: Scalar, scale: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
        """See `Ending`."""
        return _STIFF_NEAR * control.trial_length, _STIFF_FLAT * control.trial_length

    def may_end(self, expected: Scalar, step: Scalar, past: Flag) -> Flag:
        """See `Ending`: the derivatives of a long step by its length err by far more than the step."""
        return expected <= _PARTED * step

    def moves_lane(
        self, steep: Flag, time_to_event: Scalar, expected: Scalar, trial: Scalar, reach: Callable[[], Scalar]
    ) -> Flag:
        """See `Ending`: one that ends a little before the event is tried again with the whole length to it."""
        return jnp.logical_not(
            steep & (time_to_event > 0) & (time_to_event < _LAST_STEP * trial) & (expected <= reach())
        )

    def aim(self, expected: Scalar, time_to_event: Scalar, past: Flag, accepted: Flag, step: Scalar) -> Scalar:
        """See `Ending`."""
        aim = jnp.where(accepted, time_to_event, expected)
        return jnp.where(aim > _PARTED * step, _NEARER * aim, aim)

    def moved(self, accepted: Flag, ended: Flag) -> Flag:
        """See `Ending`."""
        return accepted

    def time_to_event(self, expected: Scalar, time_to_event: Scalar) -> Scalar:
        """See `Ending`."""
        return expected


def decide(
    control: Control,
    trial: Trial,
    scale: Scalar,
    limits: Limits,
    *,
    ending: "Ending | None" = None,
    reach: Callable[[], Scalar] = lambda: jnp.asarray(jnp.inf),
) -> tuple[Control, Flag]:
    """The control after a trial near an event, and whether the lane moves to the trial's end.

    Where a local minimum may reach below zero, the next step ends there before anything else is decided. Where a body
    turns by radians within a step, the cubic says little: the step is too long if an event may be in it.

    `ending` is how the method finds the end from a trial near it, `reach` the longest step that is allowed.
    """
    ending = ending or ByAShortStep()
    too_long = (control.mode == ADVANCING) & trial.hidden
    trial = trial._replace(error=jnp.where(too_long, jnp.maximum(trial.error, _TOO_LONG), trial.error))
    locating, past = control.mode == LOCATING, trial.past
    good = _good(control, trial.error)
    lands, fits = good & (trial.minimum < 1), good & (trial.minimum >= 1)
    bracketed = good & (past | locating)
    expected, event, steep, uncertainty = _first_expected(control, trial)
    time_to_event = expected - control.trial_length
    size = jnp.minimum(jnp.minimum(scale, control.step), control.time + control.trial_length)
    near, flat = ending.nearness(control, size, scale, uncertainty)
    ended = fits & (jnp.abs(time_to_event) <= jnp.where(steep, near, flat))
    wanted = next_step(control, trial.error, good)
    step = jnp.where(locating, control.step, foreseen_step(control, wanted, good, limits))
    ended = _both(ended, ending.may_end(expected, step, past))
    # A lane that locates moves on as well, or it would look at both sides of a local minimum for ever.
    accepted = fits & jnp.logical_not(past | ended)
    accepted = _both(accepted, ending.moves_lane(steep, time_to_event, expected, control.trial_length, reach))
    aim = ending.aim(expected, time_to_event, past, accepted, step)
    moved = ending.moved(accepted, ended)
    length = jnp.where(
        lands, trial.minimum * control.trial_length, jnp.where(bracketed | (good & (time_to_event < step)), aim, step)
    )
    after = counted(control, trial.lowest, good | too_long, moved)._replace(
        mode=jnp.where(bracketed & ~lands, LOCATING, control.mode),
        step=step,
        trial_length=length,
        wanted=jnp.where(accepted & ~locating, wanted, control.wanted),
        high=jnp.where(accepted, trial.high - control.trial_length, trial.high),
        event=jnp.where(ended, event, control.event),
        time_to_event=jnp.where(ended, ending.time_to_event(expected, time_to_event), control.time_to_event),
    )
    after = given_up(after, scale, limits)
    mode = jnp.where(ended, ENDED, jnp.where(locating & ~good, FAILED, after.mode))
    return after._replace(mode=mode), moved


def stop_at(control: Control, t_stop: Scalar) -> Control:
    """Go no further than to a time: the next step ends there, and so does the lane."""
    remaining = t_stop - control.time
    # An event located beyond that time does not count.
    over = (control.mode == ENDED) & (control.event >= 0) & (control.time_to_event > remaining)
    arrived = goes_on(control) & (remaining <= 0)
    return control._replace(
        mode=jnp.where(arrived, ENDED, control.mode),
        event=jnp.where(arrived | over, ARRIVED, control.event),
        time_to_event=jnp.where(arrived, 0.0, jnp.where(over, remaining, control.time_to_event)),
        trial_length=jnp.where(
            goes_on(control) & (remaining > 0), jnp.minimum(control.trial_length, remaining), control.trial_length
        ),
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
        earlier = (event.rate < 0) & (time < remaining) & (time > -jnp.abs(control.time_to_event)) & (index >= 0)
        index, remaining = jnp.where(earlier, i, index), jnp.where(earlier, time, remaining)
    return index, remaining


def _both(one: Flag, other: Flag) -> Flag:
    return one if other is True else one & other


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
    falls, never = [], (jnp.asarray(jnp.inf), jnp.asarray(False), jnp.asarray(jnp.inf))
    for before, after in zip(trial.start, trial.end, strict=True):
        # Events that have fallen at the trial's end are known; while locating before the event, all are.
        known = (after.value <= 0) | (~trial.past & ~advancing)
        foreseen = advancing & ~trial.past & trial.imminent & (after.rate < 0)
        expected = functools.partial(expected_fall, before, after, control.trial_length, trial.low, trial.high)
        root, steep, uncertainty = lax.cond(known | foreseen, expected, lambda: never)
        falls.append((root, known | steep, steep, uncertainty))
    first = _least([root for root, *_ in falls], jnp.inf)
    sure, is_steep, error, index = True, False, 0.0 * first, 0 * control.mode
    for i, (root, trusted, steep, uncertainty) in enumerate(falls):
        # An event that is not sure to fall, but would be the first, may fall after the others.
        sure = ((root > first) | trusted) & sure
        is_steep, error = jnp.where(root == first, steep, is_steep), jnp.where(root == first, uncertainty, error)
        index = jnp.where(root == first, i, index)
    return jnp.where(sure, first, jnp.inf), index, is_steep, error


_ROUNDING = 1e-15  # of what a function changes by within the time scale: zero
_LEFT = 1e-9  # of the same: a function of an event that has just happened, with the errors of state and reset
_TOGETHER = 1e-12  # of the time scale: events this near happen at once, and one this near the end happens
_TINY = 1e-300
_SHARP = 8.0  # times what a cubic was seen to err by: it may err by as much


class Watched(NamedTuple):
    """How an event is watched in a step.

    Args:
        sign: times its function, which then falls to the event.
        armed: whether it may happen in the step.
    """

    sign: Scalar
    armed: Flag


def sign_of(direction: int, start: Ends, scale: Scalar) -> Scalar:
    """What turns an event function so that it falls to its event; 1 where it is turned already."""
    if direction:
        return 1.0
    return jnp.sign(jnp.where(_is_zero(start, scale), start.rate, start.value))


def signed(event: Ends, sign: Scalar) -> Ends:
    """An event function times its sign."""
    return Ends(sign * event.value, sign * event.rate)


def is_armed(event: Ends, scale: Scalar) -> Flag:
    """Whether an event function is before zero, or leaves it."""
    return jnp.where(_is_zero(event, scale), event.rate > 0, event.value > 0)


def all_armed(directions: Sequence[int], events: Sequence[Ends], scale: Scalar) -> Flag:
    """Whether every event function is before its event, or leaves it."""
    going: Flag = jnp.asarray(True)
    for event in watch(directions, events, scale):
        going = going & event.armed
    return going


def watch(directions: Sequence[int], starts: Sequence[Ends], scale: Scalar) -> list[Watched]:
    """How the events are watched in a step."""
    signs = [sign_of(direction, start, scale) for direction, start in zip(directions, starts, strict=True)]
    return [Watched(sign, is_armed(signed(start, sign), scale)) for sign, start in zip(signs, starts, strict=True)]


def disarmed(event: Ends, on: Flag) -> Ends:
    """The event function; far from zero where it does not count."""
    return Ends(jnp.where(on, event.value, 1.0), jnp.where(on, event.rate, 0.0))


def after_event(event: Ends, fired: Flag, still_zero: Flag, scale: Scalar) -> Ends:
    """An event function where the motion goes on: zero without its rounding if its event has just happened."""
    event = Ends(jnp.where(still_zero, 0.0, event.value), event.rate)
    return jax.tree.map(functools.partial(jnp.where, fired), without_rounding(event, _LEFT * scale), event)


def without_rounding(event: Ends, time: Scalar) -> Ends:
    """An event function; zero where it would be within a time."""
    is_zero = jnp.abs(event.value) <= jnp.abs(event.rate) * time
    return Ends(jnp.where(is_zero, 0.0, event.value), event.rate)


def are_clear(
    events: Sequence[Watched],
    h: Scalar,
    starts: Sequence[Ends],
    ends: Sequence[Ends],
    interior_samples: Sequence[tuple[float, Sequence[Scalar]]],
    graze: Scalar,
) -> list[Flag]:
    """Whether neither an event nor a local minimum below `graze` times its size can be in a step or near its end.

    Most steps are *quiet*: all events are clear, and then nothing needs to be looked for. A cubic lies between the
    least and the greatest of four numbers (its Bézier points), so the sign of an event function is mostly known
    without its extrema.

    Args:
        events: how they are watched; nothing where all of them count and fall.
        h: length of the step.
        starts: the event functions where it begins.
        ends: and where it ends.
        interior_samples: their values at some shares of the step.
        graze: see above.
    """
    clear: list[Flag] = []
    for i, (start, end) in enumerate(zip(starts, ends, strict=True)):
        samples = [(theta, values[i]) for theta, values in interior_samples]
        if events:
            # One that does not count is before zero on its other side.
            on = events[i].armed
            sign = jnp.where(on, events[i].sign, -events[i].sign)
            least = jnp.where(on, graze * jnp.maximum(_size(start, end, h), _TINY), 0.0)
            start, end, samples = (
                signed(start, sign),
                signed(end, sign),
                [(theta, sign * value) for theta, value in samples],
            )
            clear.append(_is_clear(start, end, h, samples, least))
        else:
            clear.append(_is_clear(start, end, h, samples, graze))
    return clear


@jax.jit
def _is_clear(start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]], least: Scalar) -> Flag:
    """Whether an event function is above `least` in all of a step, by more than `look` and `decide` doubt."""
    lowest = functools.reduce(jnp.minimum, _bezier(start, end, length))
    slopes = jnp.abs(length * start.rate) + jnp.abs(length * end.rate)
    doubt = jnp.maximum(_LOW * slopes, 2 * _SHARP * cubic_error(start, end, length, samples)) / 16
    return (lowest > jnp.maximum(doubt, least)) & jnp.logical_not(_is_imminent(end, length))


def _bezier(start: Ends, end: Ends, length: Scalar) -> tuple[Scalar, ...]:
    """The four numbers between the least and the greatest of which the cubic through both ends lies."""
    third = length * (1 / 3)
    return start.value, start.value + third * start.rate, end.value - third * end.rate, end.value


def _is_imminent(end: Ends, length: Scalar) -> Flag:
    return end.value < -_IMMINENT * length * end.rate


def _size(start: Ends, end: Ends, length: Scalar) -> Scalar:
    """Of an event function in a step."""
    return jnp.maximum(jnp.maximum(jnp.abs(start.value), jnp.abs(end.value)), length * jnp.abs(start.rate))


def look_directed(
    events: Sequence[Watched],
    control: Control,
    starts: Sequence[Ends],
    ends: Sequence[Ends],
    interior_samples: Sequence[tuple[float, Sequence[Scalar]]],
    error: Scalar,
    scale: Scalar,
    *,
    clear: Sequence[Flag],
) -> Trial:
    """What a trial says about the events that count; see `erosion.ode.crossings.look`.

    Where one that does not count rises above zero within the step, the step ends there: it counts from there on.
    """
    h = control.trial_length
    on, factors, rises = [event.armed for event in events], [], []
    for i, (event, start, end, is_clear) in enumerate(zip(events, starts, ends, clear, strict=True)):
        factors.append(event.sign / jnp.maximum(_size(start, end, h), _TINY))
        samples = [(theta, event.sign * values[i]) for theta, values in interior_samples]
        both = signed(start, event.sign), signed(end, event.sign)
        rises.append(rise_unless_clear(event.armed | is_clear, *both, h, samples))

    def watched(events: Sequence[Ends]) -> list[Ends]:
        parts = zip(events, factors, on, strict=True)
        return [disarmed(signed(event, factor), there) for event, factor, there in parts]

    begun = [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in watched(starts)]
    inside = [
        (
            theta,
            [jnp.where(there, factor * value, 1.0) for value, factor, there in zip(values, factors, on, strict=True)],
        )
        for theta, values in interior_samples
    ]
    # A function such as a distance bends in a small part of a step, where the cubic errs by more than was seen.
    trial = look(control, begun, watched(ends), inside, error, scale, clear=clear, sharp=_SHARP)
    maximum, hidden = _least([maximum for maximum, _ in rises], 2.0), _any(hidden for _, hidden in rises)
    return trial._replace(minimum=jnp.minimum(maximum, trial.minimum), hidden=trial.hidden | hidden)


def last_moment(event: Scalar, remaining: Scalar, events: Sequence[Ends], scale: Scalar) -> tuple[Scalar, Scalar]:
    """The event and the time to it: the first by order of those at once, and one at the end's own time.

    Args:
        event: its index; `ARRIVED` where the end has come without one.
        remaining: time to it.
        events: the functions that count, near the end.
        scale: the time scale.
    """
    here = jnp.where(event >= 0, remaining, 0.0)
    # From the last to the first: the first in order stays.
    for i, near in reversed(list(enumerate(at_once(events, here, scale)))):
        happens = near & ((event >= 0) | (event == ARRIVED))
        event = jnp.where(happens, i, event)
    return event, here


def at_once(events: Sequence[Ends], remaining: Scalar, scale: Scalar) -> list[Flag]:
    """Which events happen in a time that remains."""
    times = [-event.value / jnp.where(event.rate < 0, event.rate, jnp.nan) for event in events]
    return [jnp.abs(time - remaining) <= _TOGETHER * scale for time in times]


def _is_zero(event: Ends, scale: Scalar) -> Flag:
    return jnp.abs(event.value) <= _ROUNDING * jnp.abs(event.rate) * scale
