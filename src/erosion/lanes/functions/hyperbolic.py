"""Hyperbolic functions and their inverses."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.arithmetic import (
    NAN,
    flipped,
    ordered_sum,
    polynomial,
    power_of_two,
    scaled,
    sign_of,
)
from erosion.lanes.functions.exponential import LN2, exp_tail, log1p, log1p_of_sum, reduced

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
