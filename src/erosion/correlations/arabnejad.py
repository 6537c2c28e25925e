"""Arabnejad, Mansouri, Shirazi and McLaury (2015): cutting, and deformation above a threshold speed."""

import functools
import types
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.ecrc import sharpness_factor
from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, of_table, require_jax, warn_outside

SPEED_EXPONENT = 2.41  # of the cutting term [-]


@dataclass(frozen=True)
class ArabnejadMaterial:
    """A target of sand.

    Args:
        cutting: C₁ [(m/s)^-2.41].
        deformation: C₂ [(m/s)⁻²].
        force_ratio: K [-].
        threshold: normal speed below which deformation removes nothing, U_tsh [m/s].
        density: [kg/m³], DNVGL-RP-O501 (2015), table 3-1, of the nearest material there.
    """

    cutting: float
    deformation: float
    force_ratio: float
    threshold: float
    density: float


# Constants for 150 µm sand. The paper's abstract, not its table, was at hand: these constants are not confirmed.
# Another public code (ParticleModule) has constants of the same form for three of the targets: with them
# the cutting of 1018, 316 and 6061 is 6 % less, 15 % and 29 % greater, thresholds are 5.0, 5.7 and 7.3 m/s.
ARABNEJAD_MATERIALS: Mapping[str, ArabnejadMaterial] = types.MappingProxyType(
    {
        "carbon-steel-1018": ArabnejadMaterial(5.90e-8, 4.25e-8, 0.5, 5.5, 7800.0),
        "carbon-steel-4130": ArabnejadMaterial(4.94e-8, 3.02e-8, 0.4, 3.0, 7800.0),
        "stainless-steel-316": ArabnejadMaterial(4.58e-8, 5.56e-8, 0.4, 5.8, 8000.0),
        "stainless-steel-2205": ArabnejadMaterial(3.92e-8, 2.30e-8, 0.4, 2.3, 7850.0),
        "13cr-duplex": ArabnejadMaterial(4.11e-8, 3.07e-8, 0.5, 5.1, 7850.0),
        "inconel-625": ArabnejadMaterial(4.58e-8, 4.22e-8, 0.4, 5.5, 8440.0),
        "aluminium-6061": ArabnejadMaterial(3.96e-8, 3.38e-8, 0.4, 7.3, 2700.0),
    }
)
"""Targets of sand by name."""

ARABNEJAD_RANGES: Mapping[str, Range] = types.MappingProxyType(
    {"alpha": ALL_ANGLES, "diameter": Range(150e-6, 150e-6, "m", "Arabnejad et al. 2015, abstract")}
)


def arabnejad_cutting(alpha: Values, force_ratio: Values = 0.4) -> Array:
    """The cutting term: sin α (2K cos α - sin α)/(2K²) for tan α < K, cos²α/2 above.

    Args:
        alpha: α [rad].
        force_ratio: K [-], 0.4 for the carbon steels it was fitted to.

    References:
        H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050.
    """
    sine, cosine = jnp.sin(alpha), jnp.cos(alpha)
    shallow = sine * (2 * force_ratio * cosine - sine) / (2 * force_ratio**2)
    return jnp.where(jnp.tan(alpha) < force_ratio, shallow, cosine**2 / 2)


def arabnejad(
    alpha: Values,
    v0: Values,
    *,
    material: str | ArabnejadMaterial = "carbon-steel-4130",
    sharpness: str | Values = "sharp",
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion by sand after Arabnejad et al. (2015), cutting and deformation.

    E = F_s [C₁ v₀^2.41 f(α) + C₂ (v₀ sin α - U_tsh)₊²/2], with f of `arabnejad_cutting`. Its shape over α
    changes with the speed.

    Args:
        alpha: α [rad]; all numbers broadcast.
        v0: speed of the particles at the wall [m/s].
        material: a name in `ARABNEJAD_MATERIALS`, or constants of your own.
        sharpness: F_s [-], or "sharp" (1), "semi-rounded" (0.53), "rounded" (0.2).
        units: "kg/kg", "mm3/kg" or "mm3/impact".
        mass: of a particle [kg], for "mm3/impact".

    Returns:
        E in `units`, of the broadcast shape; differentiable by JAX.

    Raises:
        ValueError: for an unknown material, shape or unit.

    References:
        H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050. Its tests were made with
        sand of 150 µm. Their speeds were not at hand, so that only the angle is checked. Nor was the paper's table:
        **compare the constants with it before you rely on absolute numbers**.
    """
    require_jax(alpha, v0)
    target, factor = of_table(ARABNEJAD_MATERIALS, material, ArabnejadMaterial), sharpness_factor(sharpness)
    warn_outside("Arabnejad", ARABNEJAD_RANGES, alpha=alpha)
    return in_units(_ratio(alpha, v0, factor, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _ratio(alpha: Values, v0: Values, sharpness: Values, target: ArabnejadMaterial) -> Array:
    speed = jnp.asarray(v0, float)
    cutting = target.cutting * speed**SPEED_EXPONENT * arabnejad_cutting(alpha, target.force_ratio)
    excess = jnp.maximum(speed * jnp.sin(alpha) - target.threshold, 0.0)
    return jnp.asarray(sharpness, float) * (cutting + target.deformation / 2 * excess**2)
