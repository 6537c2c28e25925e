"""Where in a step an event function may fall through zero, from the cubic through its ends.

Straight-line arithmetic, so that a kernel can do it for all lanes at once.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

_LANDED = 1e-6  # of a step: this near the lowest point of an event function, its sign is known
_LOW = 0.1  # a dip's cubic errs by less than this times its variation times θ²(1-θ)²


class Ends(NamedTuple):
    """An event function and its rate at one time."""

    value: Any
    rate: Any


def dip_in_step(start: Ends, end: Ends, length: Any) -> tuple[Any, Any]:
    """Where in the step (0 to 1) an event function may dip to zero and return; 2 if it does not.

    And its least value in between, by the cubic; infinity where it only rises or falls.

    The cubic through both ends has its minimum at θ. It errs by less than a small multiple
    of θ²(1-θ)², so that a minimum above that is harmless, and one below is to be looked at.
    """
    from_, to, rise = length * start.rate, length * end.rate, end.value - start.value
    a, b = 3 * (from_ + to - 2 * rise), 2 * (3 * rise - 2 * from_ - to)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * from_, 0.0))
    # Of the two roots of the cubic's derivative, the one with positive curvature √….
    upper = jnp.where(b >= 0, -2 * from_ / (b + root), (root - b) / (2 * a))
    inside = (b * b > 4 * a * from_) & (upper > 0) & (upper < 1) & (end.value > 0)
    theta = jnp.where(inside, upper, 0.5)
    lowest = start.value + theta * (from_ + theta * (b / 2 + theta * (a / 3)))
    width = theta * (1 - theta)
    harmless = lowest > _LOW * (jnp.abs(from_) + jnp.abs(to)) * width**2
    where = jnp.where(inside & ~harmless & (width > _LANDED), theta, 2.0)
    return where, jnp.where(inside, lowest, jnp.inf)


def expected_fall(start: Ends, end: Ends, length: Any, low: Any, high: Any) -> Any:
    """When an event function is expected to fall through zero.

    By the cubic through both ends of a trial, taken a little beyond it if need be; always
    between the lengths `low` and `high`, known to be before and past the event.
    """
    from_, to, rise = length * start.rate, length * end.rate, end.value - start.value
    c2, c3 = 3 * rise - 2 * from_ - to, from_ + to - 2 * rise
    left, right = low / length, high / length
    # Newton from the trial's end, because an event function may start at zero.
    theta = jnp.clip(1 - end.value / jnp.where(to < 0, to, -1.0), left, right)
    for _ in range(4):
        value = start.value + theta * (from_ + theta * (c2 + theta * c3))
        slope = from_ + theta * (2 * c2 + theta * 3 * c3)
        left, right = jnp.where(value > 0, theta, left), jnp.where(value > 0, right, theta)
        newton = theta - value / jnp.where(slope == 0, 1.0, slope)
        # A converged step may leave the bracket by rounding: that is no reason to bisect.
        inside = (newton > left - 1e-9) & (newton < right + 1e-9)
        theta = jnp.where(inside, jnp.clip(newton, left, right), (left + right) / 2)
    return length * theta
