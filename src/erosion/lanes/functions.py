"""Elementary functions as plain arithmetic, for the compiler of lanes.

The vector code calls no library of functions. Each function here is sums, products, selects and
operations on the bits of a float64, so its bits do not depend on the machine's library. There are
no branches: every case is computed, and one is selected.

The compiler may round a product and its sum once (fma) or twice. Where a rounding error must be
known, the product is exact instead: its two factors have at most 53 bits together.

Each polynomial minimizes the largest relative error of its function on the stated interval (Remez's
exchange and Lawson's weights, in 45 digits). The first coefficients were rounded to float64 one
after another, and the rest fitted again each time. The stated error is that of the function.

Errors in the docstrings are the largest of some 10⁷ random points against 113-bit results, with and
without fma, in units in the last place (ulp) of the exact result. Where the result is subnormal,
the unit is 2⁻¹⁰⁷⁴. Special values are those of C99, annex F, and of NumPy.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
from jax import lax

_INFINITY = float("inf")
_NAN = float("nan")

# Bits of a float64: its sign, its mantissa, and the numbers √½ and 1.
_SIGN = -(2**63)
_MANTISSA = 2**52 - 1
_SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
_ONE_BITS = 0x3FF0000000000000

# AVX2 cannot convert float64 to int64, but adding 1.5·2⁵² leaves a whole number in the low bits of the
# sum. The other way, a whole number in the low bits of 2⁵² is added to it.
_TO_INTEGER = 1.5 * 2.0**52
_TWO_52_BITS = 0x4330000000000000

# The first part of ln 2 has 32 bits, so its product with an exponent is exact.
_LN2_HIGH = float.fromhex("0x1.62e42feep-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
_LN2 = float.fromhex("0x1.62e42fefa39efp-1")
_LOG2_E = float.fromhex("0x1.71547652b82fep+0")
_PI_2 = float.fromhex("0x1.921fb54442d18p+0")
_PI_2_LOW = float.fromhex("0x1.1a62633145c07p-54")
_2_PI = float.fromhex("0x1.45f306dc9c883p-1")

# π/2 in four parts; three have 23 bits, so that their products with up to 2³⁰ quarter turns are exact.
_PI_2_PARTS = [
    float.fromhex(part) for part in ("0x1.921fb4p+0", "0x1.4442dp-24", "0x1.846988p-48", "0x1.8cc51701b839ap-72")
]
_LARGEST_ANGLE = 2.0**30

# (e^r - 1 - r - r²/2) / r³ for r between ln 3/4 and ln 3/2, halfway 0.085 ln 2; error 2⁻⁵⁷.
_EXP = [
    0.16666666666667698, 0.041666666666677406, 0.008333333332444999, 0.001388888888704153, 0.00019841272430440267,
    2.4801574708866646e-05, 2.7554161412563765e-06, 2.7590658685875693e-07, 2.6451837094680418e-08,
]  # fmt: skip
_EXP_CENTER = 0.085

# (sinh r - r) / r³ and (cosh r - 1) / r² in r², for |r| ≤ ln 2 / 2; errors 2⁻⁶¹ and 2⁻⁵⁷.
_SINH = [
    0.16666666666666677, 0.008333333333321452, 0.00019841269886523933, 2.755724385158562e-06, 2.5109149847386138e-08,
]  # fmt: skip
_COSH = [0.5, 0.04166666666660285, 0.001388888892724076, 2.480150813364115e-05, 2.7625400590772156e-07]

# (tanh x - x) / x³ in x², for |x| ≤ 9/16; error 2⁻⁵⁹.
_TANH = [
    -0.33333333333333276, 0.13333333333322864, -0.05396825396159047, 0.021869488323953162, -0.008863231589401813,
    0.003592081821770703, -0.0014554771721935569, 0.0005881744777740686, -0.00023269502289190324,
    8.233318697353431e-05, -1.8888253975993972e-05,
]  # fmt: skip

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
_THIRD = 1 / 3
_THIRD_LOW = 1 / 3 / 2**54  # 1/3 is 0.010101… in binary, so its rest after 54 digits is 2⁻⁵⁴/3.

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

# m^(-1/3) for m between √½ and √2; error 2⁻¹⁷.
_CBRT = [
    1.999174950949276, -2.485939138255288, 2.792244622087239, -1.8981614781436147, 0.7007510833196626,
    -0.10806618738726702,
]  # fmt: skip

# erf x / x - 1 in x², for |x| ≤ 3/4; error 2⁻⁵⁶.
_ERF = [
    0.1283791670955126, -0.37612638903184153, 0.11283791670976936, -0.026866170649770867, 0.005223977675414944,
    -0.0008548330077010312, 0.00012055443509943943, -1.4927978563540945e-05, 1.6486961162820519e-06,
    -1.6404476339770264e-07, 1.3103677255893536e-08,
]  # fmt: skip

# (x + 2) e^(x²) erfc x in 9/16 - 4 / (x + 2), for x between 3/4 and 27.3; error 2⁻⁵⁶.
_ERFC = [
    0.7707249824838277, -0.4693256071824847, 0.21366322612696984, -0.05809989708365673, -0.0023225449973500695,
    0.008891660315730687, -0.0016369474693008926, -0.0014956231485853558, 0.0005367160635143934, 0.0003439902742974731,
    -0.00015041689188263977, -0.00010835331571014983, 3.89206632320967e-05, 4.185722501869355e-05,
    -6.848627853440833e-06, -1.7218281560791863e-05, -1.8992080574771843e-06, 5.9968134230839765e-06,
    2.9439137584996398e-06, -5.324817227721365e-07, -8.055176919133556e-07, -1.8958729665738347e-07,
]  # fmt: skip


def exp(x: Any) -> Any:
    """Exponential. Error 0.9 ulp."""
    n, head, low = _reduced(_between(x, -746.0, 710.0))
    return _scaled(1.0 + (head + _exp_tail(head, low)), n)


def exp2(x: Any) -> Any:
    """Power of two. Error 0.8 ulp."""
    x = _between(x, -1076.0, 1025.0)
    n = _round(x - _EXP_CENTER)
    rest = x - n
    error = x - (rest + n)  # for x just above -1/2
    first = _leading(rest, 21)
    head = first * _LN2_HIGH
    low = first * _LN2_LOW + ((rest - first) + error) * _LN2
    return _scaled(1.0 + (head + _exp_tail(head, low)), n)


def expm1(x: Any) -> Any:
    """Exponential less 1. Error 1 ulp."""
    n, head, low = _reduced(_between(x, -40.0, 710.0))
    r = head + low
    tail = _exp_tail(head, low) + r * ((head - r) + low)  # e^r - 1 is about r
    half = _power_of_two(n - 1.0)  # half of 2ⁿ, which may overflow
    value, error = _sum(half, -0.5)
    value, error_2 = _sum(value, half * head)
    return jnp.where(abs(x) < 2.0**-54, x, 2.0 * (value + ((error + error_2) + half * tail)))


def log(x: Any) -> Any:
    """Natural logarithm. Error 1 ulp."""
    k, m = _split_any(x)
    value = _log(k, m - 1.0, k * _LN2_LOW)
    special = jnp.where(x == 0.0, -_INFINITY, jnp.where(x > 0.0, x, _NAN))
    return jnp.where((x > 0.0) & (x < _INFINITY), value, special)


def log1p(x: Any) -> Any:
    """Natural logarithm of 1 + x. Error 1 ulp."""
    return _log1p(x, 0.0)


def sin(x: Any) -> Any:
    """Sine of |x| ≤ 2³⁰, else NaN. Error 1.6 ulp."""
    sine, cosine, quarter = _turned(x)
    value = jnp.where((quarter & 1) == 1, cosine, sine)
    return _flipped(value, ((quarter << 62) & _SIGN) + _sign(x))


def cos(x: Any) -> Any:
    """Cosine of |x| ≤ 2³⁰, else NaN. Error 1.6 ulp."""
    sine, cosine, quarter = _turned(x)
    value = jnp.where((quarter & 1) == 1, sine, cosine)
    return _flipped(value, ((quarter + 1) << 62) & _SIGN)


def tan(x: Any) -> Any:
    """Tangent 2t / (1 - t²) with t the tangent of x / 2 of |x| ≤ 2³⁰, else NaN. Error 2 ulp."""
    head, low, quarter = _quarter_turns(x)
    r = head + low
    low = _sum_error(low, head, r)
    z = 0.25 * r * r
    double, error = _sum(r, r * z * _polynomial(_TAN, z) + low)
    rest = 1.0 - (0.25 * double * double + 0.5 * double * error)
    odd = (quarter & 1) == 1
    value = jnp.where(odd, rest, double) / jnp.where(odd, double, rest)
    return _flipped(value, (quarter << 63) + _sign(x))


def asin(x: Any) -> Any:
    """Arc sine, of x > 1/2 as π/2 - 2 asin √((1 - x) / 2). Error 1.8 ulp."""
    large, root, tail = _asin_parts(abs(x))
    value = jnp.where(large, _PI_2 - (2.0 * root + (2.0 * tail - _PI_2_LOW)), root + tail)
    return _flipped(value, _sign(x))


def acos(x: Any) -> Any:
    """Arc cosine, of x > 1/2 as 2 asin √((1 - x) / 2), else π/2 - asin x. Error 1.2 ulp."""
    large, root, tail = _asin_parts(abs(x))
    negative = x < 0.0
    added = negative & ~large
    signed_root, signed_tail = jnp.where(added, -root, root), jnp.where(added, -tail, tail)
    value = _PI_2 - (signed_root + (signed_tail - _PI_2_LOW))
    return jnp.where(large, 2.0 * jnp.where(negative, value, root + tail), value)


def atan(x: Any) -> Any:
    """Arc tangent, of x > 1 as π/2 - atan 1/x. Error 1.3 ulp."""
    size = abs(x)
    large = size > 1.0
    t = jnp.where(large, 1.0 / size, size)
    tail = _atan_tail(t)
    head, error = _sum(_PI_2, -t)
    value = jnp.where(large, head + (error - (tail - _PI_2_LOW)), t + tail)
    return _flipped(value, _sign(x))


def atan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y). Error 1.7 ulp."""
    along, across = abs(x), abs(y)
    steep = across > along
    behind = _bits(x) < 0
    shorter, longer = jnp.where(steep, along, across), jnp.where(steep, across, along)
    ratio = jnp.where(shorter == longer, jnp.where(longer == 0.0, 0.0, 1.0), shorter / longer)
    angle = ratio + _atan_tail(ratio)
    quarters = jnp.where(steep, 1.0, jnp.where(behind, 2.0, 0.0))
    angle = jnp.where(steep == behind, angle, -angle)
    return _flipped(quarters * _PI_2 + (angle + quarters * _PI_2_LOW), _sign(y))


def sinh(x: Any) -> Any:
    """Hyperbolic sine. Error 1.2 ulp."""
    sine, _, n = _hyperbolic(abs(x))
    return _flipped(_scaled(sine, n - 1.0), _sign(x))


def cosh(x: Any) -> Any:
    """Hyperbolic cosine. Error 1.6 ulp."""
    _, cosine, n = _hyperbolic(abs(x))
    return _scaled(cosine, n - 1.0)


def tanh(x: Any) -> Any:
    """Hyperbolic tangent, of x > 9/16 as 1 - 2 / (1 + e^2x). Error 1.5 ulp."""
    size = abs(x)
    z = x * x
    n, head, low = _reduced(jnp.where(size > 22.0, 44.0, 2.0 * size))
    large = 1.0 - 2.0 / (1.0 + (1.0 + (head + _exp_tail(head, low))) * _power_of_two(n))
    return _flipped(jnp.where(size > 0.5625, large, size + size * z * _polynomial(_TANH, z)), _sign(x))


def asinh(x: Any) -> Any:
    """Inverse of sinh, ln(1 + x + x² / (1 + √(1 + x²))), and ln 2x where x² would overflow. Error 1.8 ulp."""
    size = abs(x)
    large = size > 2.0**500
    square = size * size
    value = log1p(jnp.where(large, size, size + square / (1.0 + jnp.sqrt(1.0 + square))))
    return _flipped(value + jnp.where(large, _LN2, 0.0), _sign(x))


def acosh(x: Any) -> Any:
    """Inverse of cosh, ln(1 + d + √(2d + d²)) with d = x - 1, and ln 2x where d² would overflow. Error 2 ulp."""
    rest = x - 1.0
    large = x > 2.0**500
    total, low = _sum(jnp.sqrt(2.0 * rest + rest * rest), rest)
    value = _log1p(jnp.where(large, x, total), jnp.where(large, 0.0, low))
    return jnp.where(x < 1.0, _NAN, value + jnp.where(large, _LN2, 0.0))


def atanh(x: Any) -> Any:
    """Inverse of tanh, ln(1 + 2x / (1 - x)) / 2. Error 1.9 ulp."""
    size = abs(x)
    return _flipped(0.5 * log1p(2.0 * size / (1.0 - size)), _sign(x))


def power(x: Any, y: Any) -> Any:
    """Power e^(y ln x), with ln x and its product with y as sums of two numbers. Error 0.9 ulp."""
    size = abs(x)
    infinite, zero = size == _INFINITY, size == 0.0
    log_first, log_rest = _log_twice(size)
    bounded = _between(y, -(2.0**65), 2.0**65)  # beyond, every result is 0, 1 or infinite
    first = _leading(bounded, 26)
    product = first * log_first
    n, head, low = _reduced(product)
    low = low + (first * log_rest + (bounded - first) * (log_first + log_rest))
    value = _scaled(1.0 + (head + _exp_tail(head, low)), n)
    product = jnp.where(zero | infinite, jnp.where(zero, -y, y) * _INFINITY, product)
    value = jnp.where(product > 710.0, _INFINITY, jnp.where(product < -746.0, 0.0, value))
    half = 0.5 * y
    whole = jnp.floor(y) == y
    odd = whole & (jnp.floor(half) != half)
    value = jnp.where(odd, _flipped(value, _sign(x)), value)
    value = jnp.where((x != x) | ((x < 0.0) & ~infinite & ~whole), _NAN, value)
    return jnp.where((y == 0.0) | (x == 1.0), 1.0, value)


def cbrt(x: Any) -> Any:
    """Cube root. Error 0.6 ulp."""
    size = abs(x)
    k, m = _split_any(size)
    third = jnp.floor((k + 0.5) * _THIRD)
    remainder = k - 3.0 * third
    inverse = _polynomial(_CBRT, m) * jnp.where(
        remainder == 0.0, 1.0, jnp.where(remainder == 1.0, 0.5 ** (1 / 3), 0.25 ** (1 / 3))
    )
    m = m * _power_of_two(remainder)
    inverse = inverse + inverse * (1.0 - m * inverse * inverse * inverse) * _THIRD
    root = _leading(m * inverse * inverse, 26)
    # With d = (m - root³) / 3 m^(2/3), the root is root + d + d² / root + ….
    square = root * root
    first = _leading(square, 26)
    error = ((m - first * root) - (square - first) * root) * inverse * inverse * _THIRD
    value = (root + (error + error * error * inverse)) * _power_of_two(third)
    return jnp.where((size > 0.0) & (size < _INFINITY), _flipped(value, _sign(x)), x)


def rsqrt(x: Any) -> Any:
    """Inverse square root. Error 0.6 ulp."""
    small = x < 2.0**-900
    scaled = jnp.where(small, x * 2.0**200, x)  # whose last bits are no subnormal number
    value = 1.0 / jnp.sqrt(scaled)
    first, scaled_first = _leading(value, 26), _leading(scaled, 26)
    # e = 1 - x first², and 1/√x = first (1 - e)^(-1/2) = first (1 + e/2 + 3e²/8 + …)
    root = scaled_first * first
    root_first = _leading(root, 26)
    e = (1.0 - root_first * first) - ((root - root_first) + (scaled - scaled_first) * first) * first
    value = jnp.where((x > 0.0) & (x < _INFINITY), first + first * (e * (0.5 + 0.375 * e)), value)
    return jnp.where(small, value * 2.0**100, value)


def logistic(x: Any) -> Any:
    """Logistic function 1 / (1 + e^-x), of x < 0 as e^x / (1 + e^x). Error 1.9 ulp."""
    small = exp(-abs(x))
    total, error = _sum(1.0, small)
    value = jnp.where(x < 0.0, small, 1.0) / total
    return value - value * (error * (1.0 - 0.5 * small))  # 1 / total is about 1 - small/2


def erf(x: Any) -> Any:
    """Error function. Error 1.1 ulp."""
    size = abs(x)
    far = _flipped(1.0 - _erfc(size), _sign(x))
    return jnp.where(size < 0.75, x + x * _polynomial(_ERF, x * x), far)


def erfc(x: Any) -> Any:
    """Complement 1 - erf x of the error function. Error 2 ulp."""
    size = abs(x)
    far = _erfc(size)
    near = (1.0 - x) - x * _polynomial(_ERF, x * x)
    return jnp.where(size < 0.75, near, jnp.where(x < 0.0, 2.0 - far, far))


FUNCTIONS: Mapping[str, Callable[..., Any]] = {"pow": power} | {
    function.__name__: function
    for function in (
        exp, exp2, expm1, log, log1p, sin, cos, tan, asin, acos, atan, atan2, sinh, cosh, tanh, asinh, acosh, atanh,
        cbrt, rsqrt, logistic, erf, erfc,
    )
}  # fmt: skip


def _polynomial(coefficients: Sequence[float], x: Any) -> Any:
    """Sum of coefficients[i] xⁱ (Horner)."""
    *rest, value = coefficients
    for coefficient in reversed(rest):
        value = value * x + coefficient
    return value


def _bits(x: Any) -> Any:
    return lax.bitcast_convert_type(x, jnp.int64)


def _sign(x: Any) -> Any:
    return _bits(x) & _SIGN


def _number(bits: Any) -> Any:
    return lax.bitcast_convert_type(bits, jnp.float64)


def _round(x: Any) -> Any:
    return lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN)


def _flipped(x: Any, sign: Any) -> Any:
    """The number, its sign changed where `sign` is -2⁶³ instead of 0; the carry of the sum is lost."""
    return _number(_bits(x) + sign)


def _leading(x: Any, count: int) -> Any:
    """The number cut to its first `count` bits."""
    return _number(_bits(x) & -(1 << (53 - count)))


def _between(x: Any, low: float, high: float) -> Any:
    """The nearest number from low to high; NaN stays."""
    return jnp.where(x < low, low, jnp.where(x > high, high, x))


def _sum(a: Any, b: Any) -> tuple[Any, Any]:
    """Sum and its rounding error, for |a| ≥ |b| or a = 0 (Dekker 1971)."""
    total = a + b
    return total, (a - total) + b


def _sum_error(a: Any, b: Any, total: Any) -> Any:
    """Rounding error of a + b (Knuth, The Art of Computer Programming 2, section 4.2.2)."""
    moved = total - b
    return (a - moved) + (b - (total - moved))


def _power_of_two(n: Any) -> Any:
    """Power 2ⁿ of a whole number n from -1022 to 1023."""
    return _number((_bits(n + _TO_INTEGER) << 52) + _ONE_BITS)


def _scaled(x: Any, n: Any) -> Any:
    """Product x 2ⁿ in two steps, since 2ⁿ alone may overflow."""
    whole = _bits(n + _TO_INTEGER)
    half = lax.shift_right_logical(whole, 1)
    return x * _number((half << 52) + _ONE_BITS) * _number((whole - half << 52) + _ONE_BITS)


def _split(x: Any) -> tuple[Any, Any]:
    """Exponent k and mantissa m from √½ to √2 with x = m 2^k, of normal x > 0."""
    shifted = _bits(x) + (_ONE_BITS - _SQRT_HALF_BITS)
    k = _number(lax.shift_right_logical(shifted, 52) + _TWO_52_BITS) - (2.0**52 + 1023)
    return k, _number((shifted & _MANTISSA) + _SQRT_HALF_BITS)


def _split_any(x: Any) -> tuple[Any, Any]:
    """Exponent and mantissa of x > 0 that may be subnormal."""
    subnormal = x < 2.0**-1022
    k, m = _split(jnp.where(subnormal, x * 2.0**54, x))
    return jnp.where(subnormal, k - 54.0, k), m


def _reduced(x: Any, center: float = _EXP_CENTER) -> tuple[Any, Any, Any]:
    """Whole n, exact head and low of x = n ln 2 + head + low, with |head - center ln 2| ≤ ln 2 / 2."""
    n = _round(x * _LOG2_E - center)
    return n, x - n * _LN2_HIGH, -n * _LN2_LOW


def _exp_tail(head: Any, low: Any) -> Any:
    """e^(head + low) - 1 - head, where low is small."""
    r = head + low
    z = r * r
    return 0.5 * z + (r * z * _polynomial(_EXP, r) + low)


def _log(k: Any, f: Any, low: Any) -> Any:
    """ln((1 + f) 2^k), with all that is to be added last in low."""
    head, error = _sum(k * _LN2_HIGH, f)
    return head + (error + (low + f * f * _polynomial(_LOG, f)))


def _log1p(x: Any, low: Any) -> Any:
    """ln(1 + x + low), where low is smaller than the last digit of x."""
    total = 1.0 + x
    error = _sum_error(1.0, x, total) + low
    k, m = _split(total)
    within = k == 0.0
    f = jnp.where(within, x, m - 1.0)
    low = jnp.where(within, low, jnp.where(k > 60.0, 0.0, error * _power_of_two(-k)))
    # d ln(1 + f) = df / (1 + f) = df (1 - f + f² - …)
    value = _log(k, f, k * _LN2_LOW + low * (1.0 - f * (1.0 - f)))
    value = jnp.where(x > -1.0, value, jnp.where(x == -1.0, -_INFINITY, _NAN))
    return jnp.where((x == 0.0) | ~(x < _INFINITY), x, value)


def _log_twice(x: Any) -> tuple[Any, Any]:
    """Logarithm of x as a number of 26 bits and the rest, together to 2⁻⁶⁵ of it."""
    k, m = _split_any(x)
    # ln m = 2 artanh s = 2 (s + s³ (1/3 + s² …)), s = f / d
    f, d = m - 1.0, m + 1.0
    d_first = _leading(d, 26)
    d_rest = m - (d_first - 1.0)
    inverse = 1.0 / d
    s = f * inverse
    s_first = _leading(s, 26)
    s_rest = ((f - s_first * d_first) - s_first * d_rest) * inverse
    # z = s²
    square = s_first * s_first
    square_rest = s_rest * (s + s_first)
    z = square + square_rest
    z_first = _leading(z, 26)
    z_rest = (square - z_first) + square_rest
    # a = 1/3 + s² …
    higher = z * _polynomial(_ARTANH, z)
    a = _THIRD + higher
    a_first = _leading(a, 26)
    a_rest = ((_THIRD - a_first) + higher) + _THIRD_LOW
    # b = s² a
    b = z_first * a_first
    b_first = _leading(b, 26)
    b_rest = (b - b_first) + (z_first * a_rest + z_rest * a)
    head, error = _sum(k * _LN2_HIGH, 2.0 * s_first)
    head, error_2 = _sum(head, 2.0 * s_first * b_first)
    low = (error + error_2) + (2.0 * (s_rest + (s_first * b_rest + s_rest * (b_first + b_rest))) + k * _LN2_LOW)
    first = _leading(head, 26)
    return first, (head - first) + low


def _quarter_turns(x: Any) -> tuple[Any, Any, Any]:
    """Rest of |x| after its nearest quarter turns, as head + low, and their number as an integer.

    The rest is good to 0.7 ulp for every |x| up to 2²⁰ (the numbers nearest to each multiple of π/2
    were tried). Up to 2³⁰ it is so too but for 260 numbers, each within 2⁻⁴⁴ of a multiple, where
    its error is below 2⁻⁹⁷. Beyond, it is NaN.
    """
    first, second, third, fourth = _PI_2_PARTS
    size = abs(x)
    size = jnp.where(size <= _LARGEST_ANGLE, size, _NAN)
    turns = _round(size * _2_PI)
    head, error = _sum((size - turns * first) - turns * second, -(turns * third))
    return head, error - turns * fourth, _bits(turns + _TO_INTEGER)


def _turned(x: Any) -> tuple[Any, Any, Any]:
    """Sine and cosine of the rest of |x| after its nearest quarter turns, and their number as an integer."""
    head, low, quarter = _quarter_turns(x)
    r = head + low
    z = r * r
    sine = r + r * z * _polynomial(_SIN, z)
    cosine = 1.0 + z * (-0.5 + z * _polynomial(_COS, z))
    return sine, cosine, quarter


def _hyperbolic(x: Any) -> tuple[Any, Any, Any]:
    """2^(1-n) sinh x, 2^(1-n) cosh x and n, of x ≥ 0."""
    n, head, low = _reduced(jnp.where(x > 711.0, 711.0, x), 0.0)
    r = head + low
    z = r * r
    s = low + r * z * _polynomial(_SINH, z)  # sinh r - head
    c = z * _polynomial(_COSH, z)  # cosh r - 1
    q = _power_of_two(-2.0 * jnp.where(n > 32.0, 32.0, n))
    a, b = 1.0 - q, 1.0 + q
    sine, error = _sum(a, head)
    sine = sine + (error + (a * c + (q * head + b * s)))
    return sine, b + (b * c + a * (head + s)), n


def _asin_parts(x: Any) -> tuple[Any, Any, Any]:
    """Whether x > 1/2, then s and asin s - s of s = √((1 - x) / 2) or s = x."""
    large = x > 0.5
    square = jnp.where(large, 0.5 - 0.5 * x, x * x)
    root = jnp.where(large, jnp.sqrt(square), x)
    return large, root, root * square * _polynomial(_ASIN, square)


def _atan_tail(t: Any) -> Any:
    """Arc tangent of t less t, of t from 0 to 1."""
    z = t * t
    return t * z * _polynomial(_ATAN, z)


def _erfc(x: Any) -> Any:
    """1 - erf x = e^(-x²) q H(9/16 - 4q) with q = 1 / (x + 2), of x ≥ 3/4."""
    x = _between(x, 0.75, 28.0)
    total = x + 2.0
    q = 1.0 / total
    u = 0.5625 - 4.0 * q
    constant, *higher = _ERFC
    rest = u * _polynomial(higher, u)
    # 1 / (x + 2) = q (1 + error), and q H changes by about (1 + 2.6 q) error.
    total_first, q_first = _leading(total, 26), _leading(q, 26)
    total_rest, q_rest = x - (total_first - 2.0), q - q_first
    error = ((1.0 - q_first * total_first) - q_first * total_rest) - q_rest * total
    first = _leading(x, 26)
    n, head, low = _reduced(-(first * first))
    tail = _exp_tail(head, low - (x - first) * (x + first))
    growth = head + (tail + error * (1.0 + 2.6 * q))
    value, low = _sum(constant, rest)
    value, low_2 = _sum(value, value * growth)
    value_first = _leading(value, 26)
    low = q_first * ((value - value_first) + (low_2 + (low + low * growth))) + q_rest * value
    return _scaled(q_first * value_first + low, n)
