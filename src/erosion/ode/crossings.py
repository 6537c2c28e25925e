"""Where a lane ends: which event functions may fall through zero in a step, and what follows near one.

A step is shortened to end where an event is expected. A lane whose step went past an event locates it: it
tries again **from the same start** with the length at which it expects the event. So the state at the event
has the full order of the method, not an interpolant's.

`arming` says which events count, and `cubics` where a function may be zero within a step. A function is brought to
order 1 in each step, as the functions come in any unit.
"""

import abc
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.ode.arming import Watched, disarmed
from erosion.ode.cubics import (
    SHARP,
    Ends,
    expected_fall,
    is_clear,
    is_imminent,
    minimum_unless_clear,
    rise_unless_clear,
    signed,
    size_in_step,
)
from erosion.ode.step_control import (
    ADVANCING,
    ARRIVED,
    ENDED,
    FAILED,
    LOCATING,
    MOMENT,
    TINY,
    Control,
    Limits,
    counted,
    foreseen_step,
    given_up,
    goes_on,
    next_step,
)

# Of the time scale, the time so far and a good step: this near a steep fall, a short step and Newton's do the rest.
_NEAR = 1e-2
_NEAR_FLAT = 1e-3  # the same for a flat one
_SETTLED = 1e-6  # of that: as exactly a flat fall must be expected
_STIFF_NEAR, _STIFF_FLAT = 1e-3, 1e-6  # of a stiff motion's last step: Newton's method does the rest
_LAST_STEP = 0.2  # of the step before it is a stiff motion's last step at least
_PARTED, _NEARER = 0.3, 0.75  # of a step: a longer way to the event is gone in two
_AHEAD = 3.0  # trials: as far beyond its end as an event is looked for
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
        imminent=_any(is_imminent(event, control.trial_length) for event in end),
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
            least = jnp.where(on, graze * jnp.maximum(size_in_step(start, end, h), TINY), 0.0)
            start, end, samples = (
                signed(start, sign),
                signed(end, sign),
                [(theta, sign * value) for theta, value in samples],
            )
            clear.append(is_clear(start, end, h, samples, least))
        else:
            clear.append(is_clear(start, end, h, samples, graze))
    return clear


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
    """What a trial says about the events that count; see `look`.

    Where one that does not count rises above zero within the step, the step ends there: it counts from there on.
    """
    h = control.trial_length
    on, factors, rises = [event.armed for event in events], [], []
    for i, (event, start, end, clear_of_it) in enumerate(zip(events, starts, ends, clear, strict=True)):
        factors.append(event.sign / jnp.maximum(size_in_step(start, end, h), TINY))
        samples = [(theta, event.sign * values[i]) for theta, values in interior_samples]
        both = signed(start, event.sign), signed(end, event.sign)
        rises.append(rise_unless_clear(event.armed | clear_of_it, *both, h, samples))

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
    trial = look(control, begun, watched(ends), inside, error, scale, clear=clear, sharp=SHARP)
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
    return [jnp.abs(time - remaining) <= MOMENT * scale for time in times]
