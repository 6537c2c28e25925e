"""Events that wait: one whose function is zero or beyond it at the start counts once it has returned.

An event *counts* in a step at whose start its function is before zero, or at zero and leaving it. Every function is
turned so that it falls to zero: of either direction by its sign at the step's start. It is brought to order 1 in each
step, as the functions come in any unit.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from erosion.array_types import Flag, Scalar
from erosion.ode import event_steps
from erosion.ode.crossings import Ends, crest_above_zero
from erosion.ode.event_steps import Trial
from erosion.ode.step_control import ARRIVED, Control

_ROUNDING = 1e-15  # of what a function changes by within the time scale: zero
_LEFT = 1e-9  # of the same: a function of an event that has just happened, with the errors of state and reset
_TOGETHER = 1e-12  # of the time scale: events this near happen at once, and one this near the end happens
_TINY = 1e-300
_SHARP = 8.0  # times what a cubic was seen to err by: it may err by as much


class Watched(NamedTuple):
    """How an event is watched in a step.

    Args:
        turn: what turns its function so that it falls to the event.
        counts: whether it counts.
    """

    turn: Scalar
    counts: Flag


def sign(direction: int, start: Ends, scale: Scalar) -> Scalar:
    """What turns an event function so that it falls to its event; 1 where it is turned already."""
    if direction:
        return 1.0
    return jnp.sign(jnp.where(_is_zero(start, scale), start.rate, start.value))


def turned(event: Ends, sign: Scalar) -> Ends:
    """An event function times its sign."""
    return Ends(sign * event.value, sign * event.rate)


def counts(event: Ends, scale: Scalar) -> Flag:
    """Whether an event function is before zero, or leaves it."""
    return jnp.where(_is_zero(event, scale), event.rate > 0, event.value > 0)


def all_count(directions: Sequence[int], events: Sequence[Ends], scale: Scalar) -> Flag:
    """Whether every event function is before its event, or leaves it."""
    going: Flag = jnp.asarray(True)
    for event in watch(directions, events, scale):
        going = going & event.counts
    return going


def watch(directions: Sequence[int], starts: Sequence[Ends], scale: Scalar) -> list[Watched]:
    """How the events are watched in a step."""
    turns = [sign(direction, start, scale) for direction, start in zip(directions, starts, strict=True)]
    return [Watched(turn, counts(turned(start, turn), scale)) for turn, start in zip(turns, starts, strict=True)]


def silenced(event: Ends, on: Flag) -> Ends:
    """The event function; far from zero where it does not count."""
    return Ends(jnp.where(on, event.value, 1.0), jnp.where(on, event.rate, 0.0))


def after_event(event: Ends, fired: Flag, scale: Scalar) -> Ends:
    """An event function where the motion goes on: zero without its rounding if its event has just happened."""
    left = fired & (jnp.abs(event.value) <= _LEFT * jnp.abs(event.rate) * scale)
    return Ends(jnp.where(left, 0.0, event.value), event.rate)


def look(
    events: Sequence[Watched],
    control: Control,
    starts: Sequence[Ends],
    ends: Sequence[Ends],
    within: Sequence[tuple[float, Sequence[Scalar]]],
    error: Scalar,
    scale: Scalar,
    *,
    rough: bool = False,
) -> Trial:
    """What a trial says about the events that count; see `erosion.ode.event_steps.look`.

    Where one that does not count rises above zero within the step, the step ends there: it counts from there on.
    """
    h = control.trial
    on, factors, crests = [event.counts for event in events], [], []
    for event, start, end in zip(events, starts, ends, strict=True):
        size = jnp.maximum(jnp.maximum(jnp.abs(start.value), jnp.abs(end.value)), h * jnp.abs(start.rate))
        factors.append(event.turn / jnp.maximum(size, _TINY))
        crests.append(jnp.where(event.counts, 2.0, crest_above_zero(start, end, h)))

    def watched(events: Sequence[Ends]) -> list[Ends]:
        parts = zip(events, factors, on, strict=True)
        return [silenced(turned(event, factor), there) for event, factor, there in parts]

    begun = [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in watched(starts)]
    inside = [
        (
            theta,
            [jnp.where(there, factor * value, 1.0) for value, factor, there in zip(values, factors, on, strict=True)],
        )
        for theta, values in within
    ]
    trial = event_steps.look(control, begun, watched(ends), inside, error, scale, rough=rough)
    # A function such as a distance bends in a small part of a step, where the cubic errs by more than was seen.
    errors = [_SHARP * error for error in trial.cubic_errors]
    return trial._replace(dip=functools.reduce(jnp.minimum, crests, trial.dip), cubic_errors=errors)


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
