"""Exponentials, logarithms and powers."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.arithmetic import (
    INFINITY,
    NAN,
    THIRD,
    THIRD_LOW,
    Real,
    between,
    flipped,
    leading,
    nearest_whole,
    ordered_sum,
    polynomial,
    power_of_two,
    scaled,
    sign_of,
    split,
    split_normal,
    sum_error,
)

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
