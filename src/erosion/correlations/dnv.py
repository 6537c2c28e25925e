"""DNV RP-O501, *Managing sand production and erosion*: E = K v₀ⁿ F(α) for steels, plastics and ceramics."""

import functools
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, of_table, require_jax, warn_outside


@dataclass(frozen=True)
class DNVMaterial:
    """A target: E = K v₀ⁿ F(α).

    Args:
        coefficient: K [(m/s)⁻ⁿ].
        exponent: n [-].
        density: [kg/m³].
        brittle: whether F = 2α/π, which is greatest at 90°.
    """

    coefficient: float
    exponent: float
    density: float
    brittle: bool = False


# DNVGL-RP-O501 (August 2015), table 3-1; compared with the table in pysand 2.0.0 (Equinor).
DNV_MATERIALS: Mapping[str, DNVMaterial] = types.MappingProxyType(
    {
        "carbon-steel": DNVMaterial(2.0e-9, 2.6, 7800.0),
        "duplex": DNVMaterial(2.0e-9, 2.6, 7850.0),
        "stainless-steel-316": DNVMaterial(2.0e-9, 2.6, 8000.0),
        "inconel": DNVMaterial(2.0e-9, 2.6, 8440.0),
        "grp-epoxy": DNVMaterial(3.0e-10, 3.6, 1800.0),
        "grp-vinyl-ester": DNVMaterial(6.0e-10, 3.6, 1800.0),
        "hdpe": DNVMaterial(3.5e-9, 2.9, 1150.0),
        "aluminium": DNVMaterial(5.8e-9, 2.3, 2700.0),
        "dc-05-tungsten": DNVMaterial(1.1e-10, 2.3, 15250.0, brittle=True),
        "cs-10-tungsten": DNVMaterial(3.2e-10, 2.2, 14800.0, brittle=True),
        "cr-37-tungsten": DNVMaterial(8.8e-11, 2.5, 14600.0, brittle=True),
        "aluminium-oxide-95": DNVMaterial(6.8e-8, 2.0, 3700.0, brittle=True),
        "aluminium-oxide-99": DNVMaterial(9.5e-7, 1.2, 3700.0, brittle=True),
        "psz-zirconia": DNVMaterial(4.1e-9, 2.5, 5700.0, brittle=True),
        "zro2-y3-zirconia": DNVMaterial(4.0e-11, 2.7, 6070.0, brittle=True),
        "silicon-carbide": DNVMaterial(6.5e-9, 1.9, 3100.0, brittle=True),
        "silicon-nitride": DNVMaterial(2.0e-10, 2.0, 3200.0, brittle=True),
        "titanium-diboride": DNVMaterial(9.3e-9, 1.9, 4250.0, brittle=True),
        "boron-carbide": DNVMaterial(3.0e-8, 0.9, 2500.0, brittle=True),
        "sisic": DNVMaterial(7.4e-11, 2.7, 3100.0, brittle=True),
    }
)
"""The targets of RP-O501 by name; "grp" is glass-reinforced plastic."""

_RP = "DNVGL-RP-O501 (2015), as checked by pysand 2.0.0"
DNV_RANGES: Mapping[str, Range] = types.MappingProxyType(
    {"alpha": ALL_ANGLES, "v0": Range(0.0, 200.0, "m/s", _RP), "diameter": Range(2e-5, 5e-3, "m", _RP)}
)

# Copies of this table are in print with 110.804 for A₃ and 98.298 for A₆: they give F(90°) = 1.838.
_POLYNOMIAL = (9.370, 42.295, 110.864, 175.804, 170.137, 98.398, 31.211, 4.170)


def dnv_2015(alpha: Values) -> Array:
    """F = 0.6 [sin α + 7.2 (sin α - sin²α)]^0.6 (1 - e^(-20α)) for ductile targets, of DNV RP-O501 since 2015."""
    sine = jnp.sin(alpha)
    return 0.6 * (sine + 7.2 * (sine - sine**2)) ** 0.6 * -jnp.expm1(-20 * alpha)


def dnv_brittle(alpha: Values) -> Array:
    """F = 2α/π for brittle targets, of DNV RP-O501."""
    return 2 * jnp.asarray(alpha) / jnp.pi


def dnv_polynomial(alpha: Values, coefficients: Sequence[float] = _POLYNOMIAL) -> Array:
    """F = Σ (-1)^(i+1) A_i α^i, i = 1 … 8, for ductile targets, of DNV RP-O501 before 2015.

    Args:
        alpha: α [rad].
        coefficients: A_i; a table of one's own can be checked by F(90°) = 0.56851.
    """
    return alternating(coefficients, alpha)


def alternating(coefficients: Sequence[float], alpha: Values) -> Array:
    """The sum A₁α - A₂α² + A₃α³ - … of a published table."""
    alpha = jnp.asarray(alpha)
    value = jnp.zeros_like(alpha)
    for i in reversed(range(len(coefficients))):
        value = (value + coefficients[i] * (-1) ** i) * alpha
    return value


def dnv(
    alpha: Values,
    v0: Values,
    material: str | DNVMaterial = "carbon-steel",
    *,
    edition: Literal[2007, 2015] = 2015,
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion by sand after DNV RP-O501: E = K v₀ⁿ F(α).

        erosion.correlations.dnv(np.deg2rad(30), 30.0, "duplex")  # 1.37e-5 kg/kg

    Args:
        alpha: α [rad]; broadcasts with `v0`.
        v0: speed of the particles at the wall [m/s].
        material: a name in `DNV_MATERIALS`, or constants of your own.
        edition: 2015, or 2007 for the angle polynomial of the editions before (ductile targets).
        units: "kg/kg", "mm3/kg" or "mm3/impact".
        mass: of a particle [kg], for "mm3/impact".

    Returns:
        E in `units`, of the broadcast shape; differentiable by JAX.

    Raises:
        ValueError: for an unknown material, edition or unit.

    References:
        DNVGL-RP-O501, Managing sand production and erosion, August 2015, (3.1)-(3.3) and table 3-1.
    """
    require_jax(alpha, v0)
    target = of_table(DNV_MATERIALS, material, DNVMaterial)
    if edition not in (2007, 2015):
        raise ValueError(f"Argument `edition` must be 2007 or 2015, but is {edition!r}.")
    warn_outside("DNV RP-O501", DNV_RANGES, alpha=alpha, v0=v0)
    return in_units(_ratio(alpha, v0, target, edition), units, target.density, mass)


@functools.partial(jax.jit, static_argnames=("target", "edition"))
def _ratio(alpha: Values, v0: Values, target: DNVMaterial, edition: int) -> Array:
    ductile = dnv_2015 if edition == 2015 else dnv_polynomial
    angle = dnv_brittle(alpha) if target.brittle else ductile(alpha)
    return target.coefficient * jnp.asarray(v0, float) ** target.exponent * angle
