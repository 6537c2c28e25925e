"""The correlation of Ahlert and McLaury with the constants of Edwards (2000), which CFD codes call McLaury's."""

import types
from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
from jax import Array

from erosion.correlations.ecrc import BRINELL_CARBON_STEEL, STEEL_DENSITY, hardness_law, sharpness_factor
from erosion.correlations.ranges import ALL_ANGLES, Range, Values, in_units, require_jax, warn_outside


@dataclass(frozen=True)
class AngleConstants:
    """F = a α² + b α below the transition, x cos²α sin(w α) + y sin²α + z above.

    Args:
        transition: [rad].
        a: [rad⁻²].
        b: [rad⁻¹].
        w: [rad⁻¹].
        x, y, z: [-].
    """

    transition: float
    a: float
    b: float
    w: float
    x: float
    y: float
    z: float


# Sand on carbon steel: Edwards et al. 2000 as quoted by Autodesk CFD 2023, Erosion. That page prints y = -0.1192,
# with which F would jump by 2.5 % at the transition; with -1.192 its branches meet to 0.5 %.
# Nektar++ has another F, 22.7α - 38.4α² at first, for the same A and n: a third greater at 10°, three times at 90°.
CARBON_STEEL = AngleConstants(0.2617993877991494, -33.4, 17.9, 1.0, 1.239, -1.192, 2.167)

COEFFICIENT = 1.559e-6  # A [(m/s)⁻ⁿ], for Brinell hardness; Nektar++ (a copy of it), ProcessWear.cpp, TulsaAnsys
SPEED_EXPONENT = 1.73  # n [-], Edwards et al. 2000; Autodesk CFD 2023

MCLAURY_RANGES: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES})


def mclaury_angle(alpha: Values, constants: AngleConstants = CARBON_STEEL) -> Array:
    """F of `AngleConstants`, by default of sand on carbon steel.

    Args:
        alpha: α [rad].
        constants: of another target.
    """
    c, alpha = constants, jnp.asarray(alpha)
    sine, cosine = jnp.sin(alpha), jnp.cos(alpha)
    above = c.x * cosine**2 * jnp.sin(c.w * alpha) + c.y * sine**2 + c.z
    return jnp.where(alpha <= c.transition, c.a * alpha**2 + c.b * alpha, above)


def mclaury(
    alpha: Values,
    v0: Values,
    *,
    brinell: Values = BRINELL_CARBON_STEEL,
    sharpness: str | Values = "semi-rounded",
    density: Values = STEEL_DENSITY,
    units: str = "kg/kg",
    mass: Values | None = None,
) -> Array:
    """The erosion of carbon steel by sand after Edwards, McLaury and Shirazi (2000): E = A BH^-0.59 F_s v₀^1.73 F(α).

    Arguments, result and errors are those of `ecrc`; the derivative by α does not exist at α = 15°.

    References:
        J. K. Edwards, B. S. McLaury, S. A. Shirazi, ASME FEDSM 2000, 959-966. The paper was not at hand: constants of
        F, n, F_s and BH are those of Autodesk CFD's help, A and n those of Nektar++, whose F is 64 % greater at
        30°: **compare F with the paper before you rely on absolute numbers**.
        The speeds and sizes of its tests were not at hand, so that only the angle is checked.
    """
    require_jax(alpha, v0)
    factor = sharpness_factor(sharpness)
    warn_outside("McLaury", MCLAURY_RANGES, alpha=alpha)
    ratio = hardness_law(alpha, v0, brinell, factor, (COEFFICIENT, SPEED_EXPONENT, mclaury_angle))
    return in_units(ratio, units, density, mass)
