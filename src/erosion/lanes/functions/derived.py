"""Hyperbolic functions, the error function, and their inverses and complements."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.elementary import (
    LN2,
    NAN,
    between,
    exp_tail,
    flipped,
    leading,
    log1p,
    log1p_of_sum,
    ordered_sum,
    polynomial,
    power_of_two,
    reduced,
    scaled,
    sign_of,
)

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


def sinh(x: Array) -> Array:
    """Hyperbolic sine. Error 1.2 ulp."""
    sine, _, n = _hyperbolic(abs(x))
    return flipped(scaled(sine, n - 1.0), sign_of(x))


def cosh(x: Array) -> Array:
    """Hyperbolic cosine. Error 1.6 ulp."""
    _, cosine, n = _hyperbolic(abs(x))
    return scaled(cosine, n - 1.0)


def tanh(x: Array) -> Array:
    """Hyperbolic tangent, of x > 9/16 as 1 - 2 / (1 + e^2x). Error 1.5 ulp."""
    size = abs(x)
    z = x * x
    n, head, low = reduced(jnp.where(size > 22.0, 44.0, 2.0 * size))
    large = 1.0 - 2.0 / (1.0 + (1.0 + (head + exp_tail(head, low))) * power_of_two(n))
    return flipped(jnp.where(size > 0.5625, large, size + size * z * polynomial(_TANH, z)), sign_of(x))


def asinh(x: Array) -> Array:
    """Inverse of sinh, ln(1 + x + x² / (1 + √(1 + x²))), and ln 2x where x² would overflow. Error 1.8 ulp."""
    size = abs(x)
    large = size > 2.0**500
    square = size * size
    value = log1p(jnp.where(large, size, size + square / (1.0 + jnp.sqrt(1.0 + square))))
    return flipped(value + jnp.where(large, LN2, 0.0), sign_of(x))


def acosh(x: Array) -> Array:
    """Inverse of cosh, ln(1 + d + √(2d + d²)) with d = x - 1, and ln 2x where d² would overflow. Error 2 ulp."""
    rest = x - 1.0
    large = x > 2.0**500
    total, low = ordered_sum(jnp.sqrt(2.0 * rest + rest * rest), rest)
    value = log1p_of_sum(jnp.where(large, x, total), jnp.where(large, 0.0, low))
    return jnp.where(x < 1.0, NAN, value + jnp.where(large, LN2, 0.0))


def atanh(x: Array) -> Array:
    """Inverse of tanh, ln(1 + 2x / (1 - x)) / 2. Error 1.9 ulp."""
    size = abs(x)
    return flipped(0.5 * log1p(2.0 * size / (1.0 - size)), sign_of(x))


def _hyperbolic(x: Array) -> tuple[Array, Array, Array]:
    """2^(1-n) sinh x, 2^(1-n) cosh x and n, of x ≥ 0."""
    n, head, low = reduced(jnp.where(x > 711.0, 711.0, x), 0.0)
    r = head + low
    z = r * r
    s = low + r * z * polynomial(_SINH, z)  # sinh r - head
    c = z * polynomial(_COSH, z)  # cosh r - 1
    q = power_of_two(-2.0 * jnp.where(n > 32.0, 32.0, n))
    a, b = 1.0 - q, 1.0 + q
    sine, error = ordered_sum(a, head)
    sine = sine + (error + (a * c + (q * head + b * s)))
    return sine, b + (b * c + a * (head + s)), n


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


def erf(x: Array) -> Array:
    """Error function. Error 1.1 ulp."""
    size = abs(x)
    far = flipped(1.0 - _erfc(size), sign_of(x))
    return jnp.where(size < 0.75, x + x * polynomial(_ERF, x * x), far)


def erfc(x: Array) -> Array:
    """Complement 1 - erf x of the error function. Error 2 ulp."""
    size = abs(x)
    far = _erfc(size)
    near = (1.0 - x) - x * polynomial(_ERF, x * x)
    return jnp.where(size < 0.75, near, jnp.where(x < 0.0, 2.0 - far, far))


def _erfc(x: Array) -> Array:
    """1 - erf x = e^(-x²) q H(9/16 - 4q) with q = 1 / (x + 2), of x ≥ 3/4."""
    x = between(x, 0.75, 28.0)
    total = x + 2.0
    q = 1.0 / total
    u = 0.5625 - 4.0 * q
    constant, *higher = _ERFC
    rest = u * polynomial(higher, u)
    # 1 / (x + 2) = q (1 + error), and q H changes by about (1 + 2.6 q) error.
    total_first, q_first = leading(total, 26), leading(q, 26)
    total_rest, q_rest = x - (total_first - 2.0), q - q_first
    error = ((1.0 - q_first * total_first) - q_first * total_rest) - q_rest * total
    first = leading(x, 26)
    n, head, low = reduced(-(first * first))
    tail = exp_tail(head, low - (x - first) * (x + first))
    growth = head + (tail + error * (1.0 + 2.6 * q))
    value, low = ordered_sum(constant, rest)
    value, low_2 = ordered_sum(value, value * growth)
    value_first = leading(value, 26)
    low = q_first * ((value - value_first) + (low_2 + (low + low * growth))) + q_rest * value
    return scaled(q_first * value_first + low, n)
