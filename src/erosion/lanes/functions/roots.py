"""Roots other than the square root, for which processors have an instruction."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.arithmetic import (
    INFINITY,
    THIRD,
    flipped,
    leading,
    polynomial,
    power_of_two,
    sign_of,
    split,
)

# m^(-1/3) for m between √½ and √2; error 2⁻¹⁷.
_CBRT = [
    1.999174950949276, -2.485939138255288, 2.792244622087239, -1.8981614781436147, 0.7007510833196626,
    -0.10806618738726702,
]  # fmt: skip


def cbrt(x: Array) -> Array:
    """Cube root. Error 0.6 ulp."""
    size = abs(x)
    k, m = split(size)
    third = jnp.floor((k + 0.5) * THIRD)
    remainder = k - 3.0 * third
    inverse = polynomial(_CBRT, m) * jnp.where(
        remainder == 0.0, 1.0, jnp.where(remainder == 1.0, 0.5 ** (1 / 3), 0.25 ** (1 / 3))
    )
    m = m * power_of_two(remainder)
    inverse = inverse + inverse * (1.0 - m * inverse * inverse * inverse) * THIRD
    root = leading(m * inverse * inverse, 26)
    # With d = (m - root³) / 3 m^(2/3), the root is root + d + d² / root + ….
    square = root * root
    first = leading(square, 26)
    error = ((m - first * root) - (square - first) * root) * inverse * inverse * THIRD
    value = (root + (error + error * error * inverse)) * power_of_two(third)
    return jnp.where((size > 0.0) & (size < INFINITY), flipped(value, sign_of(x)), x)


def rsqrt(x: Array) -> Array:
    """Inverse square root. Error 0.6 ulp."""
    small = x < 2.0**-900
    scaled = jnp.where(small, x * 2.0**200, x)  # whose last bits are no subnormal number
    value = 1.0 / jnp.sqrt(scaled)
    first, scaled_first = leading(value, 26), leading(scaled, 26)
    # e = 1 - x first², and 1/√x = first (1 - e)^(-1/2) = first (1 + e/2 + 3e²/8 + …)
    root = scaled_first * first
    root_first = leading(root, 26)
    e = (1.0 - root_first * first) - ((root - root_first) + (scaled - scaled_first) * first) * first
    value = jnp.where((x > 0.0) & (x < INFINITY), first + first * (e * (0.5 + 0.375 * e)), value)
    return jnp.where(small, value * 2.0**100, value)
