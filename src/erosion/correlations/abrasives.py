"""What an abrasive changes by tests: hardness, shape, and the constants of three abrasives."""

import types
from collections.abc import Mapping
from dataclasses import dataclass

from erosion.correlations.families import DIAMETER_EXPONENT, OKA_MATERIALS, SAND, WEAR_EXPONENT

HARD_ENOUGH = 1.2
"""Hardness of an abrasive over that of the metal, from which it scratches: G. Pintaude, J. Tribol. 132 (2010) 034502.

Among harder ones no effect of hardness on the erosion of a ductile metal was found, by shot, glass beads, silica,
alumina, silicon and tungsten carbide, and diamond on stainless steel: Z. Feng, A. Ball, Wear 233-235 (1999) 674-684.
"""

SHAPES: Mapping[str, str] = types.MappingProxyType(
    {"angular": "sharp", "semi-rounded": "semi-rounded", "round": "rounded"}
)
"""The shape of a grain as E/CRC names it, by the shape of a particle; `SHARPNESS` has the factors."""


@dataclass(frozen=True)
class OkaParticle:
    """Constants of an abrasive: E₉₀ = K W^-k₁ (v₀/v')^k₂ (D/D')^k₃, where W is the target's.

    Args:
        coefficient: K [mm³/kg].
        wear_exponent: -k₁ [-].
        speed_exponent: k₂ [-] as factor and power of the target's hardness in GPa.
        speed: v' [m/s].
        diameter: D' [m].
    """

    coefficient: float
    wear_exponent: float
    speed_exponent: tuple[float, float]
    speed: float
    diameter: float


# Oka and Yoshida, Wear 259 (2005) 102-109, as the class ErosionOKA of gemini_model quotes them; sand also as EDEM does.
OKA_PARTICLES: Mapping[str, OkaParticle] = types.MappingProxyType(
    {
        "sand": OkaParticle(SAND, WEAR_EXPONENT, (2.3, 0.038), 104.0, 326e-6),
        "silicon-carbide": OkaParticle(45.0, 0.05, (3.0, 0.085), 99.0, 326e-6),
        "glass-beads": OkaParticle(27.0, 0.16, (2.1, 0.0), 100.0, 200e-6),
    }
)
"""Abrasives by name. All have the same exponent k₃ of the diameter."""


def oka_normal(particle: str, v0: float, diameter: float, material: str) -> float:
    """E₉₀, the erosion at 90° by one of `OKA_PARTICLES` [m³/kg].

    Args:
        particle: its name.
        v0: speed [m/s].
        diameter: of the particle [m].
        material: a target in `OKA_MATERIALS`, whose wear constant W follows from its erosion by sand.
    """
    target, abrasive = OKA_MATERIALS[material], OKA_PARTICLES[particle]
    wear = (target.normal_erosion * 1e9 / SAND) ** (1 / WEAR_EXPONENT)
    factor, power = abrasive.speed_exponent
    speed = (v0 / abrasive.speed) ** (factor * target.hardness**power)
    size = (diameter / abrasive.diameter) ** DIAMETER_EXPONENT
    return abrasive.coefficient * 1e-9 * wear**abrasive.wear_exponent * speed * size
