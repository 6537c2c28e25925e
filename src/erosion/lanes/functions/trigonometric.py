"""Trigonometric functions and their inverses."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.arithmetic import (
    NAN,
    SIGN,
    TO_INTEGER,
    Real,
    bits_of,
    flipped,
    nearest_whole,
    ordered_sum,
    polynomial,
    sign_of,
    sum_error,
)

_PI_2 = float.fromhex("0x1.921fb54442d18p+0")
_PI_2_LOW = float.fromhex("0x1.1a62633145c07p-54")
_2_PI = float.fromhex("0x1.45f306dc9c883p-1")

# π/2 in four parts; three have 23 bits, so that their products with up to 2³⁰ quarter turns are exact.
_PI_2_PARTS = [
    float.fromhex(part) for part in ("0x1.921fb4p+0", "0x1.4442dp-24", "0x1.846988p-48", "0x1.8cc51701b839ap-72")
]
_LARGEST_ANGLE = 2.0**30

# (sin r - r) / r³ and (cos r - 1 + r²/2) / r⁴ in r², for |r| ≤ π/4; errors 2⁻⁵⁷ and 2⁻⁶³.
_SIN = [
    -0.1666666666666663, 0.008333333333321917, -0.0001984126982945692, 2.7557313582022962e-06, -2.5050742338266708e-08,
    1.5895947836236555e-10,
]  # fmt: skip
_COS = [
    0.041666666666666595, -0.0013888888888873346, 2.480158728900659e-05, -2.755731421855943e-07, 2.0875705617824767e-09,
    -1.1358761095558663e-11,
]  # fmt: skip

# (tan h - h) / h³ in h², for |h| ≤ π/8; error 2⁻⁵⁸.
_TAN = [
    0.33333333333333504, 0.13333333333289168, 0.053968254007662524, 0.021869486814998826, 0.008863277953853594,
    0.0035914987584203632, 0.0014615495407789292, 0.0005591256270055347, 0.0003287226338956181,
]  # fmt: skip

# (asin s - s) / s³ in s², for |s| ≤ 1/2; error 2⁻⁵⁵.
_ASIN = [
    0.16666666666665383, 0.07500000000342887, 0.044642856823617356, 0.030381959325602014, 0.022371753659503984,
    0.01735976905838857, 0.013884618526548235, 0.01217314939546292, 0.00651140605313253, 0.019572420560677286,
    -0.016291785759893724, 0.03195742709630872,
]  # fmt: skip

# (atan t - t) / t³ in t², for |t| ≤ 1; error 2⁻⁵⁷.
_ATAN = [
    -0.33333333333333065, 0.19999999999950957, -0.14285714282546094, 0.11111111006177478, -0.09090906988075978,
    0.07692279666237781, -0.0666640265135434, 0.0588051948800939, -0.05253481627520201, 0.04722197250463473,
    -0.04218852238998719, 0.036635268456315595, -0.0298933424177384, 0.021971943294912224, -0.013888401962232426,
    0.007187891155320342, -0.0028804813260392853, 0.0008297528708359939, -0.0001518204914613138, 1.3190927428773163e-05,
]  # fmt: skip


def sin(x: Array) -> Array:
    """Sine of |x| ≤ 2³⁰, else NaN. Error 1.6 ulp."""
    sine, cosine, quarter = _turned(x)
    value = jnp.where((quarter & 1) == 1, cosine, sine)
    return flipped(value, ((quarter << 62) & SIGN) + sign_of(x))


def cos(x: Array) -> Array:
    """Cosine of |x| ≤ 2³⁰, else NaN. Error 1.6 ulp."""
    sine, cosine, quarter = _turned(x)
    value = jnp.where((quarter & 1) == 1, sine, cosine)
    return flipped(value, ((quarter + 1) << 62) & SIGN)


def tan(x: Array) -> Array:
    """Tangent 2t / (1 - t²) with t the tangent of x / 2 of |x| ≤ 2³⁰, else NaN. Error 2 ulp."""
    head, low, quarter = _quarter_turns(x)
    r = head + low
    low = sum_error(low, head, r)
    z = 0.25 * r * r
    double, error = ordered_sum(r, r * z * polynomial(_TAN, z) + low)
    rest = 1.0 - (0.25 * double * double + 0.5 * double * error)
    odd = (quarter & 1) == 1
    value = jnp.where(odd, rest, double) / jnp.where(odd, double, rest)
    return flipped(value, (quarter << 63) + sign_of(x))


def asin(x: Array) -> Array:
    """Arc sine, of x > 1/2 as π/2 - 2 asin √((1 - x) / 2). Error 1.8 ulp."""
    large, root, tail = _asin_parts(abs(x))
    value = jnp.where(large, _PI_2 - (2.0 * root + (2.0 * tail - _PI_2_LOW)), root + tail)
    return flipped(value, sign_of(x))


def acos(x: Array) -> Array:
    """Arc cosine, of x > 1/2 as 2 asin √((1 - x) / 2), else π/2 - asin x. Error 1.2 ulp."""
    large, root, tail = _asin_parts(abs(x))
    negative = x < 0.0
    added = negative & ~large
    signed_root, signed_tail = jnp.where(added, -root, root), jnp.where(added, -tail, tail)
    value = _PI_2 - (signed_root + (signed_tail - _PI_2_LOW))
    return jnp.where(large, 2.0 * jnp.where(negative, value, root + tail), value)


def atan(x: Array) -> Array:
    """Arc tangent, of x > 1 as π/2 - atan 1/x. Error 1.3 ulp."""
    size = abs(x)
    large = size > 1.0
    t = jnp.where(large, 1.0 / size, size)
    tail = _atan_tail(t)
    head, error = ordered_sum(_PI_2, -t)
    value = jnp.where(large, head + (error - (tail - _PI_2_LOW)), t + tail)
    return flipped(value, sign_of(x))


def atan2(y: Array, x: Array) -> Array:
    """Angle of the point (x, y). Error 1.7 ulp."""
    along, across = abs(x), abs(y)
    steep = across > along
    behind = bits_of(x) < 0
    shorter, longer = jnp.where(steep, along, across), jnp.where(steep, across, along)
    ratio = jnp.where(shorter == longer, jnp.where(longer == 0.0, 0.0, 1.0), shorter / longer)
    angle = ratio + _atan_tail(ratio)
    quarters = jnp.where(steep, 1.0, jnp.where(behind, 2.0, 0.0))
    angle = jnp.where(steep == behind, angle, -angle)
    return flipped(quarters * _PI_2 + (angle + quarters * _PI_2_LOW), sign_of(y))


def _quarter_turns(x: Array) -> tuple[Real, Array, Array]:
    """|x| minus its nearest whole number of quarter turns, as head + low, and that number as an integer.

    The error of the rest is at most 0.7 ulp for every |x| up to 2²⁰; the numbers nearest to each multiple
    of π/2 were tried. The same holds up to 2³⁰, except for 260 numbers within 2⁻⁴⁴ of a multiple of π/2,
    where the error is below 2⁻⁹⁷. Beyond 2³⁰ the rest is NaN.
    """
    first, second, third, fourth = _PI_2_PARTS
    size = abs(x)
    size = jnp.where(size <= _LARGEST_ANGLE, size, NAN)
    turns = nearest_whole(size * _2_PI)
    head, error = ordered_sum((size - turns * first) - turns * second, -(turns * third))
    return head, error - turns * fourth, bits_of(turns + TO_INTEGER)


def _turned(x: Array) -> tuple[Array, Array, Array]:
    """Sine and cosine of what `_quarter_turns` leaves of |x|, and the number of quarter turns as an integer."""
    head, low, quarter = _quarter_turns(x)
    r = head + low
    z = r * r
    sine = r + r * z * polynomial(_SIN, z)
    cosine = 1.0 + z * (-0.5 + z * polynomial(_COS, z))
    return sine, cosine, quarter


def _asin_parts(x: Array) -> tuple[Array, Array, Array]:
    """(x > 1/2, s, asin s - s), where s = √((1 - x) / 2) if x > 1/2, else s = x."""
    large = x > 0.5
    square = jnp.where(large, 0.5 - 0.5 * x, x * x)
    root = jnp.where(large, jnp.sqrt(square), x)
    return large, root, root * square * polynomial(_ASIN, square)


def _atan_tail(t: Array) -> Array:
    """Arc tangent of t minus t, for t from 0 to 1."""
    z = t * t
    return t * z * polynomial(_ATAN, z)
