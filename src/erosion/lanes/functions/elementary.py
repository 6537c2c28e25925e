"""Polynomials, roots, exponentials, logarithms, powers and trigonometric functions as plain arithmetic."""

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


# The first part of ln 2 has 32 bits, so its product with an exponent is exact.
_LN2_HIGH = float.fromhex("0x1.62e42feep-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
LN2 = float.fromhex("0x1.62e42fefa39efp-1")
_LOG2_E = float.fromhex("0x1.71547652b82fep+0")

# (e^r - 1 - r - r²/2) / r³ for r between ln 3/4 and ln 3/2, halfway 0.085 ln 2; error 2⁻⁵⁷.
_EXP = [
    0.16666666666667698, 0.041666666666677406, 0.008333333332444999, 0.001388888888704153, 0.00019841272430440267,
    2.4801574708866646e-05, 2.7554161412563765e-06, 2.7590658685875693e-07, 2.6451837094680418e-08,
]  # fmt: skip
_EXP_CENTER = 0.085

# (ln(1 + f) - f) / f² for 1 + f between √½ and √2; error 2⁻⁵⁶.
_LOG = [
    -0.5, 0.3333333333333314, -0.24999999999987965, 0.20000000000066906, -0.16666666669827665,
    0.14285714280053846, -0.12499999691305695, 0.11111111149817574, -0.10000015212816533, 0.09090923856591143,
    -0.08332913335428563, 0.07691531183473796, -0.07149443588265825, 0.06684575549069206, -0.06196629869838472,
    0.05668437830906615, -0.05678097955618363, 0.06503511021699755, -0.05980860257046133, 0.026143373101599372,
]  # fmt: skip

# (artanh s / s - 1 - s²/3) / s⁴ in s², for |s| ≤ 3 - 2√2; error 2⁻⁶⁶.
_ARTANH = [
    0.2, 0.14285714285714687, 0.11111111110825837, 0.09090909168122097, 0.07692297440283653, 0.06667404371088727,
    0.05853068596754802, 0.05862066184366374,
]  # fmt: skip


def exp(x: Array) -> Array:
    """Exponential. Error 0.9 ulp."""
    n, head, low = reduced(between(x, -746.0, 710.0))
    return scaled(1.0 + (head + exp_tail(head, low)), n)


def exp2(x: Array) -> Array:
    """Power of two. Error 0.8 ulp."""
    x = between(x, -1076.0, 1025.0)
    n = nearest_whole(x - _EXP_CENTER)
    rest = x - n
    error = x - (rest + n)  # for x just above -1/2
    first = leading(rest, 21)
    head = first * _LN2_HIGH
    low = first * _LN2_LOW + ((rest - first) + error) * LN2
    return scaled(1.0 + (head + exp_tail(head, low)), n)


def expm1(x: Array) -> Array:
    """Exponential minus 1. Error 1 ulp."""
    n, head, low = reduced(between(x, -40.0, 710.0))
    r = head + low
    tail = exp_tail(head, low) + r * ((head - r) + low)  # e^r - 1 is about r
    half = power_of_two(n - 1.0)  # half of 2ⁿ, which may overflow
    value, error = ordered_sum(half, -0.5)
    value, error_2 = ordered_sum(value, half * head)
    return jnp.where(abs(x) < 2.0**-54, x, 2.0 * (value + ((error + error_2) + half * tail)))


def log(x: Array) -> Array:
    """Natural logarithm. Error 1 ulp."""
    k, m = split(x)
    value = _log(k, m - 1.0, k * _LN2_LOW)
    special = jnp.where(x == 0.0, -INFINITY, jnp.where(x > 0.0, x, NAN))
    return jnp.where((x > 0.0) & (x < INFINITY), value, special)


def log1p(x: Array) -> Array:
    """Natural logarithm of 1 + x. Error 1 ulp."""
    return log1p_of_sum(x, 0.0)


def power(x: Array, y: Array) -> Array:
    """Power e^(y ln x), with ln x and its product with y as sums of two numbers. Error 0.9 ulp."""
    size = abs(x)
    infinite, zero = size == INFINITY, size == 0.0
    log_first, log_rest = _log_twice(size)
    bounded = between(y, -(2.0**65), 2.0**65)  # beyond, every result is 0, 1 or infinite
    first = leading(bounded, 26)
    product = first * log_first
    n, head, low = reduced(product)
    low = low + (first * log_rest + (bounded - first) * (log_first + log_rest))
    value = scaled(1.0 + (head + exp_tail(head, low)), n)
    product = jnp.where(zero | infinite, jnp.where(zero, -y, y) * INFINITY, product)
    value = jnp.where(product > 710.0, INFINITY, jnp.where(product < -746.0, 0.0, value))
    half = 0.5 * y
    whole = jnp.floor(y) == y
    odd = whole & (jnp.floor(half) != half)
    value = jnp.where(odd, flipped(value, sign_of(x)), value)
    value = jnp.where((x != x) | ((x < 0.0) & ~infinite & ~whole), NAN, value)
    return jnp.where((y == 0.0) | (x == 1.0), 1.0, value)


def logistic(x: Array) -> Array:
    """Logistic function 1 / (1 + e^-x), of x < 0 as e^x / (1 + e^x). Error 1.9 ulp."""
    small = exp(-abs(x))
    total, error = ordered_sum(1.0, small)
    value = jnp.where(x < 0.0, small, 1.0) / total
    return value - value * (error * (1.0 - 0.5 * small))  # 1 / total is about 1 - small/2


def reduced(x: Array, center: float = _EXP_CENTER) -> tuple[Array, Array, Array]:
    """(n, head, low) with x = n ln 2 + head + low: n is whole, head exact, and |head - center ln 2| ≤ ln 2 / 2."""
    n = nearest_whole(x * _LOG2_E - center)
    return n, x - n * _LN2_HIGH, -n * _LN2_LOW


def exp_tail(head: Array, low: Array) -> Array:
    """e^(head + low) - 1 - head, where low is small."""
    r = head + low
    z = r * r
    return 0.5 * z + (r * z * polynomial(_EXP, r) + low)


def _log(k: Array, f: Array, low: Array) -> Array:
    """ln((1 + f) 2^k), where low holds k _LN2_LOW and what else is to be added last."""
    head, error = ordered_sum(k * _LN2_HIGH, f)
    return head + (error + (low + f * f * polynomial(_LOG, f)))


def log1p_of_sum(x: Array, low: Real) -> Array:
    """ln(1 + x + low), where low is smaller than the last digit of x."""
    total = 1.0 + x
    error = sum_error(1.0, x, total) + low
    k, m = split_normal(total)
    within = k == 0.0
    f = jnp.where(within, x, m - 1.0)
    low = jnp.where(within, low, jnp.where(k > 60.0, 0.0, error * power_of_two(-k)))
    # d ln(1 + f) = df / (1 + f) = df (1 - f + f² - …)
    value = _log(k, f, k * _LN2_LOW + low * (1.0 - f * (1.0 - f)))
    value = jnp.where(x > -1.0, value, jnp.where(x == -1.0, -INFINITY, NAN))
    return jnp.where((x == 0.0) | ~(x < INFINITY), x, value)


def _log_twice(x: Array) -> tuple[Array, Array]:
    """Logarithm of x as a sum of two numbers, the first of 26 bits; relative error 2⁻⁶⁵."""
    k, m = split(x)
    # ln m = 2 artanh s = 2 (s + s³ (1/3 + s² …)), s = f / d
    f, d = m - 1.0, m + 1.0
    d_first = leading(d, 26)
    d_rest = m - (d_first - 1.0)
    inverse = 1.0 / d
    s = f * inverse
    s_first = leading(s, 26)
    s_rest = ((f - s_first * d_first) - s_first * d_rest) * inverse
    # z = s²
    square = s_first * s_first
    square_rest = s_rest * (s + s_first)
    z = square + square_rest
    z_first = leading(z, 26)
    z_rest = (square - z_first) + square_rest
    # a = 1/3 + s² …
    higher = z * polynomial(_ARTANH, z)
    a = THIRD + higher
    a_first = leading(a, 26)
    a_rest = ((THIRD - a_first) + higher) + THIRD_LOW
    # b = s² a
    b = z_first * a_first
    b_first = leading(b, 26)
    b_rest = (b - b_first) + (z_first * a_rest + z_rest * a)
    head, error = ordered_sum(k * _LN2_HIGH, 2.0 * s_first)
    head, error_2 = ordered_sum(head, 2.0 * s_first * b_first)
    low = (error + error_2) + (2.0 * (s_rest + (s_first * b_rest + s_rest * (b_first + b_rest))) + k * _LN2_LOW)
    first = leading(head, 26)
    return first, (head - first) + low


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
