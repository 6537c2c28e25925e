"""The correlation of the Erosion/Corrosion Research Center in Tulsa (Zhang 2007)."""

import functools
import types
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.dnv import alternating
from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, require_jax, warn_outside

COEFFICIENT = 2.17e-7  # C [(m/s)⁻ⁿ], for Brinell hardness; COMSOL 6.2, Particle Tracing Module, node Erosion
HARDNESS_EXPONENT = -0.59  # of the Brinell hardness [-], Zhang 2007
SPEED_EXPONENT = 2.41  # n [-], the same
_ANGLES = (5.40, 10.11, 10.93, 6.33, 1.42)  # A_i [rad⁻ⁱ], Zhang 2007

SHARPNESS: Mapping[str, float] = types.MappingProxyType({"sharp": 1.0, "semi-rounded": 0.53, "rounded": 0.2})
"""F_s [-] by the shape of sand (Edwards et al. 2000; Autodesk CFD 2023, Erosion)."""

BRINELL_CARBON_STEEL = 120.0  # kgf/mm², Edwards et al. 2000 as quoted by Autodesk CFD 2023
STEEL_DENSITY = 7800.0  # kg/m³, DNVGL-RP-O501 (2015), table 3-1, carbon steel

ECRC_RANGES: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES})


def ecrc_angle(alpha: Values) -> Array:
    """F = 5.40α - 10.11α² + 10.93α³ - 6.33α⁴ + 1.42α⁵, of the E/CRC in Tulsa (Zhang 2007)."""
    return alternating(_ANGLES, alpha)


def sharpness_factor(sharpness: str | Values) -> Values:
    """F_s by name, or a number as it is; a ValueError for another name."""
    if isinstance(sharpness, str):
        if sharpness not in SHARPNESS:
            known = ", ".join(SHARPNESS)
            raise ValueError(f"Argument `sharpness` must be a number or one of {known}, but is {sharpness!r}.")
        return SHARPNESS[sharpness]
    return sharpness


def ecrc(
    alpha: Values,
    v0: Values,
    *,
    brinell: Values = BRINELL_CARBON_STEEL,
    sharpness: str | Values = "semi-rounded",
    density: Values = STEEL_DENSITY,
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion by sand after Zhang et al. (2007): E = C BH^-0.59 F_s v₀^2.41 F(α).

    Args:
        alpha: α [rad]; all numbers broadcast.
        v0: speed of the particles at the wall [m/s].
        brinell: Brinell hardness BH of the target [kgf/mm²]; 120 is a carbon steel.
        sharpness: F_s [-], or "sharp" (1), "semi-rounded" (0.53), "rounded" (0.2).
        density: of the target [kg/m³], for volumes.
        units: "kg/kg", "mm3/kg" or "mm3/impact".
        mass: of a particle [kg], for "mm3/impact".

    Returns:
        E in `units`, of the broadcast shape; differentiable by JAX.

    Raises:
        ValueError: for an unknown shape or unit.

    References:
        Y. Zhang, E. P. Reuterfors, B. S. McLaury, S. A. Shirazi, E. F. Rybicki, Wear 263 (2007) 330-338;
        C, n and the exponent of BH also in the COMSOL documentation, Particle Tracing Module, node Erosion.
        The speeds and sizes of its tests were not at hand, so that only the angle is checked.
    """
    require_jax(alpha, v0)
    factor = sharpness_factor(sharpness)
    warn_outside("E/CRC", ECRC_RANGES, alpha=alpha)
    ratio = hardness_law(alpha, v0, brinell, factor, (COEFFICIENT, SPEED_EXPONENT, ecrc_angle))
    return in_units(ratio, units, density, mass)


@functools.partial(jax.jit, static_argnames="constants")
def hardness_law(
    alpha: Values,
    v0: Values,
    brinell: Values,
    sharpness: Values,
    constants: tuple[float, float, Callable[[Values], Array]],
) -> Array:
    """E = C BH^-0.59 F_s v₀ⁿ F(α) [kg/kg], for the constants (C, n, F)."""
    coefficient, exponent, angle = constants
    hardness, speed = (jnp.asarray(value, float) for value in (brinell, v0))
    return coefficient * hardness**HARDNESS_EXPONENT * sharpness * speed**exponent * angle(alpha)
