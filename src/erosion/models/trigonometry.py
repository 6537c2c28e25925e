"""Sine and cosine that vectorize.

XLA's float64 `sin` on a CPU is one scalar library call per number, which takes longer than all the
rest of a step. Range reduction by three-part π/2 (Cody and Waite) and the Taylor polynomials on
[-π/4, π/4] are plain arithmetic, so they run as fast as the rest, and the sine and the cosine share them.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from erosion.arguments import Broadcast

UPRIGHT = np.pi / 2  # φ at contact [rad]

# π/2 in three parts; the first two have 33 significant bits, so that their products with
# the number of quarter turns (below 2^20) are exact.
_PI_2_HIGH = float.fromhex("0x1.921fb544p+0")
_PI_2_MIDDLE = float.fromhex("0x1.0b4611a6p-34")
_PI_2_LOW = float.fromhex("0x1.3198a2e037073p-69")

# On [-π/4, π/4] the first omitted terms are below 5e-17 (sin) and 2e-18 (cos).
_SIN = [(-1) ** n / math.factorial(2 * n + 1) for n in range(8)]
_COS = [(-1) ** n / math.factorial(2 * n) for n in range(9)]

_Pair = tuple[Array, Array]


@jax.custom_jvp
@jax.jit
def sincos(angle: Broadcast) -> _Pair:
    """Sine and cosine of `angle` [rad] between -10⁶ and 10⁶, to within 2 ulp of 1.

    Differentiable to any order; traceable.
    """
    turns = jnp.round(angle * (2 / np.pi))
    rest = ((angle - turns * _PI_2_HIGH) - turns * _PI_2_MIDDLE) - turns * _PI_2_LOW
    square = rest * rest
    sine = rest * _polynomial(_SIN, square)
    cosine = _polynomial(_COS, square)
    quarter = turns - 4 * jnp.floor(turns / 4)
    odd = (quarter == 1) | (quarter == 3)
    sine, cosine = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(quarter >= 2, -sine, sine), jnp.where((quarter == 1) | (quarter == 2), -cosine, cosine)


@sincos.defjvp
def _sincos_jvp(primals: tuple[Broadcast], tangents: tuple[Broadcast]) -> tuple[_Pair, _Pair]:
    (angle,), (rate,) = primals, tangents
    sine, cosine = sincos(angle)
    return (sine, cosine), (cosine * rate, -sine * rate)


def _polynomial(coefficients: list[float], x: Broadcast) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def orientation(phi: Broadcast) -> tuple[Array, Array, Array]:
    """1 - sin φ, sin φ and cos φ, from half the turn: the first keeps its digits near φ = π/2."""
    sine, cosine = sincos((phi - UPRIGHT) / 2)
    lifted = 2 * sine * sine
    return lifted, 1 - lifted, -2 * sine * cosine
