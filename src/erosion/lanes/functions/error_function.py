"""The error function and its complement."""

import jax.numpy as jnp
from jax import Array

from erosion.lanes.functions.arithmetic import (
    between,
    flipped,
    leading,
    ordered_sum,
    polynomial,
    scaled,
    sign_of,
)
from erosion.lanes.functions.exponential import exp_tail, reduced

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
