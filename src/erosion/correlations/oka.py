"""Oka, Okamura and Yoshida (2005): E = g(α) E₉₀, with the hardness in every exponent."""

import functools
import types
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, of_table, require_jax, warn_outside

# For sand (SiO₂): Oka et al. 2005 as quoted by the Altair EDEM documentation, The Oka Wear Model, table 1.
REFERENCE_SPEED = 104.0  # v' [m/s]
REFERENCE_DIAMETER = 326e-6  # D' [m]
DIAMETER_EXPONENT = 0.19  # k₃ [-]
_SAND = 65.0  # K [mm³/kg]
_WEAR_EXPONENT = 0.12  # -k₁ [-]; EDEM's constant W is (a Hv)^-b, so that E₉₀ at v' and D' is K W^0.12
_MM3 = 1e-9  # m³


@dataclass(frozen=True)
class OkaMaterial:
    """A target of sand.

    Args:
        normal_erosion: E₉₀ at 90°, `REFERENCE_SPEED` and `REFERENCE_DIAMETER` [m³/kg].
        hardness: Vickers hardness Hv [GPa].
        density: [kg/m³].
    """

    normal_erosion: float
    hardness: float
    density: float


# The densities are those of DNVGL-RP-O501 (2015), table 3-1.
OKA_MATERIALS: Mapping[str, OkaMaterial] = types.MappingProxyType(
    {
        # Ansys Fluent 2024 R2 Theory Guide, table 12.3, "sand - steel": E₉₀ = 6.154e-4 kg/kg, Hv = 1.8 GPa.
        "steel": OkaMaterial(6.154e-4 / 7800.0, 1.8, 7800.0),
        # Altair EDEM, The Oka Wear Model, table 2: W = 3 with Hv = 0.54 to 1.18 GPa; W = 10; W = 1000.
        "carbon-steel": OkaMaterial(_SAND * 3.0**_WEAR_EXPONENT * _MM3, 1.18, 7800.0),
        "stainless-steel": OkaMaterial(_SAND * 10.0**_WEAR_EXPONENT * _MM3, 1.77, 8000.0),
        "aluminium": OkaMaterial(_SAND * 1000.0**_WEAR_EXPONENT * _MM3, 0.36, 2700.0),
    }
)
"""Targets of sand by name."""

# The speeds of the tests behind the correlation were not at hand; the rig of the same authors reached this one.
_RIG = "test rig of Y. I. Oka et al., Wear 250 (2001) 736-743, abstract"
OKA_RANGES: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES, "v0": Range(0.0, 135.0, "m/s", _RIG)})


def oka_angle(alpha: Values, hardness: Values = 1.8) -> Array:
    """Oka's (sin α)^n₁ [1 + Hv (1 - sin α)]^n₂ for sand (SiO₂), which is 1 at 90°.

    n₁ = 0.71 Hv^0.14 and n₂ = 2.4 Hv^-0.94: shallow angles gain on hard targets less.

    Args:
        alpha: α [rad].
        hardness: Vickers hardness Hv of the target [GPa]. 1.8 GPa is a carbon steel.

    References:
        Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101.
    """
    sine = jnp.sin(alpha)
    return sine ** (0.71 * hardness**0.14) * (1 + hardness * (1 - sine)) ** (2.4 * hardness**-0.94)


def oka_speed_exponent(hardness: Values) -> Values:
    """k₂ = 2.3 Hv^0.038 [-] for sand, Hv in GPa."""
    return 2.3 * hardness**0.038


def oka(
    alpha: Values,
    v0: Values,
    diameter: Values = REFERENCE_DIAMETER,
    *,
    material: str | OkaMaterial = "steel",
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion by sand after Oka et al. (2005): E = E₉₀ (v₀/v')^k₂ (D/D')^k₃ g(α).

    Args:
        alpha: α [rad]; all numbers broadcast.
        v0: speed of the particles at the wall [m/s].
        diameter: D of the particles [m]; D' = 326 µm without it.
        material: a name in `OKA_MATERIALS`, or constants of your own.
        units: "kg/kg", "mm3/kg" or "mm3/impact".
        mass: of a particle [kg], for "mm3/impact".

    Returns:
        E in `units`, of the broadcast shape; differentiable by JAX.

    Raises:
        ValueError: for an unknown material or unit.

    References:
        Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101; Y. I. Oka, T. Yoshida, the same, 102-109.
        Constants as the documentation of Ansys Fluent and Altair EDEM quotes them. The speeds and sizes of its tests
        were not at hand: speeds are checked against the greatest of the authors' test rig, 135 m/s.
    """
    require_jax(alpha, v0)
    target = of_table(OKA_MATERIALS, material, OkaMaterial)
    warn_outside("Oka", OKA_RANGES, alpha=alpha, v0=v0)
    return in_units(_ratio(alpha, v0, diameter, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _ratio(alpha: Values, v0: Values, diameter: Values, target: OkaMaterial) -> Array:
    speed = jnp.asarray(v0 / REFERENCE_SPEED) ** oka_speed_exponent(target.hardness)
    size = jnp.asarray(diameter / REFERENCE_DIAMETER) ** DIAMETER_EXPONENT
    return target.normal_erosion * target.density * speed * size * oka_angle(alpha, target.hardness)
