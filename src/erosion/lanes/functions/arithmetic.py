"""Steps that the elementary functions share: polynomials, sums with their errors, and the bits of a number."""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array, lax

Real = Array | float
"""One real number: of a lane, or a constant."""

INFINITY = float("inf")
NAN = float("nan")

# Bits of a float64: its sign, its mantissa, and the numbers √½ and 1.
SIGN = -(2**63)
_MANTISSA = 2**52 - 1
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
_ONE_BITS = 0x3FF0000000000000

# AVX2 cannot convert float64 to int64, but adding 1.5·2⁵² leaves a whole number in the low bits of the
# sum. For the other direction, the whole number is written into the low bits of 2⁵².
TO_INTEGER = 1.5 * 2.0**52
_TWO_52_BITS = 0x4330000000000000

THIRD = 1 / 3
THIRD_LOW = 1 / 3 / 2**54  # 1/3 is 0.010101… in binary, so its rest after 54 digits is 2⁻⁵⁴/3.


def polynomial(coefficients: Sequence[float], x: Array) -> Real:
    """Sum of coefficients[i] xⁱ (Horner)."""
    *rest, value = coefficients
    for coefficient in reversed(rest):
        value = value * x + coefficient
    return value


def bits_of(x: Real) -> Array:
    """The bits of a float64 as an int64."""
    return lax.bitcast_convert_type(x, jnp.int64)


def sign_of(x: Array) -> Array:
    """The sign bit as an int64: -2⁶³ for a minus sign, else 0."""
    return bits_of(x) & SIGN


def number_of(bits: Array) -> Array:
    """The float64 of 64 bits."""
    return lax.bitcast_convert_type(bits, jnp.float64)


def nearest_whole(x: Array) -> Array:
    """The nearest whole number; halfway between two, the even one."""
    return lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN)


def flipped(x: Array, sign: Array) -> Array:
    """The number with its sign changed where `sign` is -2⁶³, not 0. The carry of the sum is lost."""
    return number_of(bits_of(x) + sign)


def leading(x: Real, count: int) -> Array:
    """The number with all but its first `count` bits set to 0."""
    return number_of(bits_of(x) & -(1 << (53 - count)))


def between(x: Array, low: float, high: float) -> Array:
    """The nearest number from low to high; NaN stays."""
    return jnp.where(x < low, low, jnp.where(x > high, high, x))


def ordered_sum(a: Real, b: Real) -> tuple[Real, Real]:
    """Sum and its rounding error, for |a| ≥ |b| or a = 0 (Dekker 1971)."""
    total = a + b
    return total, (a - total) + b


def sum_error(a: Real, b: Real, total: Array) -> Array:
    """Rounding error of a + b (Knuth, The Art of Computer Programming 2, section 4.2.2)."""
    moved = total - b
    return (a - moved) + (b - (total - moved))


def power_of_two(n: Array) -> Array:
    """Power 2ⁿ of a whole number n from -1022 to 1023."""
    return number_of((bits_of(n + TO_INTEGER) << 52) + _ONE_BITS)


def scaled(x: Array, n: Array) -> Array:
    """Product x 2ⁿ in two steps, since 2ⁿ alone may overflow."""
    whole = bits_of(n + TO_INTEGER)
    half = lax.shift_right_logical(whole, 1)
    return x * number_of((half << 52) + _ONE_BITS) * number_of((whole - half << 52) + _ONE_BITS)


def split_normal(x: Array) -> tuple[Array, Array]:
    """Exponent k and mantissa m from √½ to √2 with x = m 2^k, of normal x > 0."""
    shifted = bits_of(x) + (_ONE_BITS - _SQRT_HALF_BITS)
    k = number_of(lax.shift_right_logical(shifted, 52) + _TWO_52_BITS) - (2.0**52 + 1023)
    return k, number_of((shifted & _MANTISSA) + _SQRT_HALF_BITS)


def split(x: Array) -> tuple[Array, Array]:
    """Exponent and mantissa of x > 0 that may be subnormal."""
    subnormal = x < 2.0**-1022
    k, m = split_normal(jnp.where(subnormal, x * 2.0**54, x))
    return jnp.where(subnormal, k - 54.0, k), m
