"""Where in a step an event function may fall through zero, from the cubic through its ends."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from erosion.array_types import Flag, Scalar

_ENDS = 0.02  # of a step: a lowest point that the cubic puts this far beyond an end may be at that end
_LANDED = 1e-6  # of a step: this near the lowest point of an event function, its sign is known
_STRAIGHT = 0.5  # of its slope at a step's end: an event function keeps at least as much up to an expected zero
_STEEP = 0.02  # of its slopes in a step: an event function that is flatter may turn before zero
_CONVERGED = 1e-3  # of a step: the cubic's zero is known when Newton's method would move by less
_CREST = 3e-3  # of a step: this near a highest point, it is where the step begins or ends
_NONE = 1e-200  # instead of no slope
_LOW = 0.1  # a dip's cubic errs by less than this times its variation times θ²(1-θ)², unless `is_crooked`
_LOOKS = (0.25, 0.5, 0.75)  # of a step: where the cubic of a crooked function is asked


class Ends(NamedTuple):
    """An event function and its rate at one time."""

    value: Scalar
    rate: Scalar


# JAX traces these once, for all events and programs.
@jax.jit
def cubic_error(start: Ends, end: Ends, length: Scalar, looks: Sequence[tuple[Scalar, Scalar]]) -> Scalar:
    """How many times θ²(1-θ)² the cubic through both ends errs by, from the function's values within the step.

    Args:
        start: the event function where the step begins.
        end: the event function where the step ends.
        length: length of the step.
        looks: places in the step, from 0 to 1, and the values there.
    """
    worst: Scalar = 0.0
    for theta, value in looks:
        error = jnp.abs(value - _cubic(start, end, length, theta))
        worst = jnp.maximum(worst, error / (theta * (1 - theta)) ** 2)
    return worst


@jax.jit
def is_crooked(start: Ends, end: Ends, length: Scalar, error: Scalar) -> Flag:
    """Whether the cubic errs by more than a search for dips assumes; see `cubic_error`."""
    return 2 * error > _LOW * length * (jnp.abs(start.rate) + jnp.abs(end.rate))


@jax.jit
def may_hide_a_fall(start: Ends, end: Ends, length: Scalar, error: Scalar) -> Flag:
    """Whether an event function may fall to zero within the step, given the error of its cubic."""
    low: Flag = end.value <= 0
    for theta in _LOOKS:
        low = low | (_cubic(start, end, length, theta) <= 2 * error * (theta * (1 - theta)) ** 2)
    return low


def _cubic(start: Ends, end: Ends, length: Scalar, theta: Scalar) -> Scalar:
    """The cubic through both ends (Hermite), at a share of the step."""
    rest = 1 - theta
    values = rest**2 * (1 + 2 * theta) * start.value + theta**2 * (3 - 2 * theta) * end.value
    return values + length * theta * rest * (rest * start.rate - theta * end.rate)


@jax.jit
def dip_in_step(start: Ends, end: Ends, length: Scalar, error: Scalar) -> tuple[Scalar, Scalar]:
    """Where in the step (0 to 1) an event function may dip to zero and return, or 2; and its least value.

    The cubic through both ends has its minimum at θ. It errs by less than a small multiple
    of θ²(1-θ)², so that a minimum above this error is harmless. The least value is that of the
    cubic, infinity where it only rises or falls. For `error` see `cubic_error`.
    """
    from_, to, rise = length * start.rate, length * end.rate, end.value - start.value
    a, b = 3 * (from_ + to - 2 * rise), 2 * (3 * rise - 2 * from_ - to)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * from_, 0.0))
    # Of the two roots of the cubic's derivative, the one with positive curvature √….
    upper = jnp.where(b >= 0, -2 * from_ / (b + root), (root - b) / (2 * a))
    turns = (b * b > 4 * a * from_) & (end.value > 0)
    inside = turns & (upper > 0) & (upper < 1)
    # A step that ends at a lowest point has it at its end, the next step at its start.
    within = turns & (upper > -_ENDS) & (upper < 1 + _ENDS)
    theta = jnp.where(within, jnp.clip(upper, 0.0, 1.0), 0.5)
    lowest = start.value + theta * (from_ + theta * (b / 2 + theta * (a / 3)))
    width = theta * (1 - theta)
    harmless = lowest > jnp.maximum(_LOW * (jnp.abs(from_) + jnp.abs(to)), 2 * error) * width**2
    place = jnp.where(inside & ~harmless & (width > _LANDED), theta, 2.0)
    return place, jnp.where(within, lowest, jnp.inf)


@jax.jit
def crest_in_step(start: Ends, end: Ends, length: Scalar) -> Scalar:
    """Where in the step (0 to 1) the cubic through both ends has its highest point, or 2."""
    mean = (end.value - start.value) / length
    a, b = 3 * (start.rate + end.rate - 2 * mean), 2 * (3 * mean - 2 * start.rate - end.rate)
    # The rate start.rate + b θ + a θ² has one zero between a positive and a negative end.
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * start.rate, 0.0))
    theta = jnp.where(b <= 0, 2 * start.rate / (root - b), -(root + b) / (2 * a))
    crests = (start.rate > 0) & (end.rate < 0) & (theta > _CREST) & (theta < 1 - _CREST)
    return jnp.where(crests, theta, 2.0)


@jax.jit
def crest_above_zero(start: Ends, end: Ends, length: Scalar) -> Scalar:
    """Where in the step (0 to 1) a function that is not positive at its ends has a crest above zero, or 2."""
    place = crest_in_step(start, end, length)
    height = _cubic(start, end, length, jnp.where(place < 1, place, 0.5))
    return jnp.where((end.value <= 0) & (height > 0), place, 2.0)


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
        # A converged step may leave the bracket by rounding: that is no reason to bisect.
        inside = (newton > left - 1e-9) & (newton < right + 1e-9)
        theta = jnp.where(inside, jnp.clip(newton, left, right), (left + right) / 2)
    value, slope = cubic(theta)
    error = jnp.minimum(jnp.abs(value / jnp.where(slope == 0, _NONE, slope)), right - left)
    steep = jnp.minimum(_STRAIGHT * end.rate, -_STEEP * (jnp.abs(start.rate) + jnp.abs(end.rate)))
    return length * theta, (slope < steep) & (end.rate < steep) & (error < _CONVERGED), length * error
