"""An event function within a step, as the cubic through its values and rates at both ends.

Values within the step show by how much the cubic errs. Every function falls to zero: see `arming`.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, Scalar

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
_IMMINENT = 2.0  # trials, at the rate of now: an event that near is worth looking for
SHARP = 8.0  # times what a cubic was seen to err by: it may err by as much


class Ends(NamedTuple):
    """An event function and its rate at one time."""

    value: Scalar
    rate: Scalar


def signed(event: Ends, sign: Scalar) -> Ends:
    """An event function times its sign."""
    return Ends(sign * event.value, sign * event.rate)


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
        error = SHARP * error
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


@jax.jit
def is_clear(start: Ends, end: Ends, length: Scalar, samples: Sequence[tuple[Scalar, Scalar]], least: Scalar) -> Flag:
    """Whether an event function is above `least` in all of a step, by more than `look` and `decide` doubt."""
    lowest = functools.reduce(jnp.minimum, _bezier(start, end, length))
    slopes = jnp.abs(length * start.rate) + jnp.abs(length * end.rate)
    doubt = jnp.maximum(_LOW * slopes, 2 * SHARP * cubic_error(start, end, length, samples)) / 16
    return (lowest > jnp.maximum(doubt, least)) & jnp.logical_not(is_imminent(end, length))


def _bezier(start: Ends, end: Ends, length: Scalar) -> tuple[Scalar, ...]:
    """The four numbers between the least and the greatest of which the cubic through both ends lies."""
    third = length * (1 / 3)
    return start.value, start.value + third * start.rate, end.value - third * end.rate, end.value


def is_imminent(end: Ends, length: Scalar) -> Flag:
    """Whether a function at the end of a step is so near zero, at its rate there, that it is worth looking for."""
    return end.value < -_IMMINENT * length * end.rate


def size_in_step(start: Ends, end: Ends, length: Scalar) -> Scalar:
    """Of an event function in a step."""
    return jnp.maximum(jnp.maximum(jnp.abs(start.value), jnp.abs(end.value)), length * jnp.abs(start.rate))
