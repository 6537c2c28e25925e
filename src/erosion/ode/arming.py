"""Which events may happen in a step.

An event is *armed* in a step at whose start its function is before zero, or at zero and leaving it. Every function is
multiplied by a sign, so that it falls to zero: of either direction by its sign at the step's start.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from erosion.arguments import Flag, Scalar
from erosion.ode.cubics import Ends, signed
from erosion.ode.step_control import ULPS

_LEFT = 1e-9  # of the time scale: a function that would be zero within it is, where its event has just happened


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


def _is_zero(event: Ends, scale: Scalar) -> Flag:
    return jnp.abs(event.value) <= ULPS * jnp.abs(event.rate) * scale
