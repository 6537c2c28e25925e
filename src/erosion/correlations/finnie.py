"""Finnie's closed form as CFD codes have it."""

import functools
import types
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, of_table, require_jax, warn_outside

FORCE_RATIO = 2.0  # K [-]; the default of COMSOL and of OpenFOAM
CONTACT_RATIO = 2.0  # ψ [-]; OpenFOAM's default


@dataclass(frozen=True)
class FinnieMaterial:
    """A target.

    Args:
        flow_stress: p, in CFD codes often the hardness [Pa].
        density: [kg/m³].
        fraction: share of the particles that cut as Finnie assumes [-].
    """

    flow_stress: float
    density: float
    fraction: float = 1.0


FINNIE_MATERIALS: Mapping[str, FinnieMaterial] = types.MappingProxyType(
    {"steel": FinnieMaterial(2e9, 7500.0, 0.1)}  # defaults of COMSOL 6.2, Particle Tracing Module, node Erosion
)
"""Targets by name."""

FINNIE_RANGES: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES})


def finnie_angle(alpha: Values, force_ratio: Values = FORCE_RATIO) -> Array:
    """Finnie's closed form as CFD codes have it, per V²/(ψ K p) and unit mass of erodent.

    F = sin 2α - (6/K) sin²α for tan α < K/6, (K/6) cos²α above. It is the model `finnie` with
    β = ½ and no spin.

    Args:
        alpha: α [rad].
        force_ratio: K, normal over tangential force [-].

    References:
        I. Finnie, Wear 3 (1960) 87-103; OpenFOAM, `ParticleErosion`.
    """
    sine, cosine = jnp.sin(alpha), jnp.cos(alpha)
    shallow = 2 * sine * cosine - 6 / force_ratio * sine**2
    return jnp.where(jnp.tan(alpha) < force_ratio / 6, shallow, force_ratio / 6 * cosine**2)


def finnie_volume(alpha: Values, speed: Values, mass: Values, flow_stress: Values, psi: Values = CONTACT_RATIO,
                  force_ratio: Values = FORCE_RATIO) -> Array:  # fmt: skip
    """The removed volume as OpenFOAM's `ParticleErosion` has it: m V²/(p ψ K) · F(α).

    Args:
        alpha: α [rad].
        speed: V, relative to the wall [speed].
        mass: m, of the particle(s) [mass].
        flow_stress: p [stress].
        psi: depth of contact over length of the cut ψ [-]; OpenFOAM's default.
        force_ratio: K [-]; OpenFOAM's default.

    Returns:
        Volume, in any consistent unit system.
    """
    scale = jnp.asarray(mass * speed**2 / (flow_stress * psi * force_ratio))
    return scale * finnie_angle(alpha, force_ratio)


def finnie(
    alpha: Values,
    v0: Values,
    material: str | FinnieMaterial = "steel",
    *,
    force_ratio: Values = FORCE_RATIO,
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion after Finnie as CFD codes have it: E = c ρ v₀²/(p ψ K) F(α), with ψ = 2.

    Args:
        alpha: α [rad]; all numbers broadcast.
        v0: speed of the particles at the wall [m/s].
        material: a name in `FINNIE_MATERIALS`, or constants of your own: p, ρ and c.
        force_ratio: K, normal over tangential force [-].
        units: "kg/kg", "mm3/kg" or "mm3/impact".
        mass: of a particle [kg], for "mm3/impact".

    Returns:
        E in `units`, of the broadcast shape; differentiable by JAX.

    Raises:
        ValueError: for an unknown material or unit.

    References:
        I. Finnie, Wear 3 (1960) 87-103; OpenFOAM, `ParticleErosion`, which has c = 1; COMSOL, Particle Tracing Module,
        node Erosion, for the target. COMSOL takes a sphere (β = 2/5) where this form has β = ½.
    """
    require_jax(alpha, v0)
    target = of_table(FINNIE_MATERIALS, material, FinnieMaterial)
    warn_outside("Finnie", FINNIE_RANGES, alpha=alpha)
    return in_units(_ratio(alpha, v0, force_ratio, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _ratio(alpha: Values, v0: Values, force_ratio: Values, target: FinnieMaterial) -> Array:
    volume = finnie_volume(alpha, v0, 1.0, target.flow_stress, CONTACT_RATIO, force_ratio)
    return target.fraction * target.density * volume
