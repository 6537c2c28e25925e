"""The correlations by name."""

import dataclasses
import functools
import inspect
import types
from collections.abc import Callable, Mapping

import jax
import numpy as np
from jax import Array

from erosion.correlations import families
from erosion.correlations.families import DIAMETER_EXPONENT, OKA_MATERIALS, SAND, WEAR_EXPONENT
from erosion.correlations.ranges import ANGLES_ALONE, Range, Values
from erosion.ode.step_control import require_xla

HARD_ENOUGH = 1.2
"""Hardness of an abrasive over that of the metal, from which it scratches: G. Pintaude, J. Tribol. 132 (2010) 034502.

Among harder ones no effect of hardness on the erosion of a ductile metal was found, by shot, glass beads, silica,
alumina, silicon and tungsten carbide, and diamond on stainless steel: Z. Feng, A. Ball, Wear 233-235 (1999) 674-684.
"""

SHAPES: Mapping[str, str] = types.MappingProxyType(
    {"angular": "sharp", "semi-rounded": "semi-rounded", "round": "rounded"}
)
"""The shape of a grain as E/CRC names it, by the shape of a particle; `SHARPNESS` has the factors."""


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True)
class Correlation:
    """A named correlation: its shape F(α) over the angle, and the erosion E(α, v₀) with all factors.

    Args:
        name: as it is called in `CORRELATIONS` and on the command line.
        title: as it is called in a legend.
        function: F [-] of α [rad].
        erosion: E(alpha [rad], v0 [m/s], …) [kg/kg], with the arguments of the function of that name.
        density: of the default target [kg/m³].
        ranges: what it is made for, by argument, as far as that is known here.
        valid_for: the particle and target behind it.
        source: where it is published.
        formula: E and its constants in words, those of a target as "{0.exponent}".
        materials: the targets by name, for a correlation with a table of them.
    """

    name: str
    title: str
    function: Callable[[Values], Array]
    erosion: Callable[..., Array]
    density: float
    ranges: Mapping[str, Range]
    valid_for: str
    source: str
    formula: str
    materials: Mapping[
        str, families.DNVMaterial | families.FinnieMaterial | families.OkaMaterial | families.ArabnejadMaterial
    ] = dataclasses.field(default_factory=dict)

    def __call__(self, alpha: Values) -> Array:
        """F at the angle(s) α [rad]."""
        require_xla()
        return self._compiled(alpha)

    @functools.cached_property
    def _compiled(self) -> Callable[[Values], Array]:
        return jax.jit(self.function)

    @functools.cached_property
    def alpha_max(self) -> float:
        """The angle of greatest erosion [rad]."""
        from scipy.optimize import root_scalar  # 0.9 s: the explorer, which knows the names, starts without

        # Every F here rises to one maximum and then falls.
        coarse = np.deg2rad(np.arange(1.0, 90.0))
        near = coarse[np.argmax(np.asarray(self(coarse)))]
        step = np.deg2rad(1.0)
        return float(root_scalar(jax.jit(jax.grad(self.function)), bracket=(near - step, near + step), xtol=1e-14).root)

    @property
    def peak(self) -> float:
        """F at `alpha_max`."""
        return float(self(self.alpha_max))

    def in_words(self, material: str | None = None) -> str:
        """E with its constants: "E = K v₀ⁿ F(α), K = 2e-09 (m/s)⁻ⁿ, n = 2.6"; of a target, or the usual one."""
        if not self.materials:
            return self.formula
        usual = inspect.signature(self.erosion).parameters["material"].default
        return self.formula.format(self.materials[material or usual])

    def normalised(self, alpha: Values) -> Array:
        """F(α)/F(α_max), to lay curves of any scale over each other."""
        return self(alpha) / self.peak


_DNV = "E = K v₀ⁿ F(α), K = {0.coefficient:g} (m/s)⁻ⁿ, n = {0.exponent:g}"
_HARDNESS = f"E = C BH^-0.59 F_s v₀^{{n:g}} F(α), C = {{c:g}}, BH = {families.BRINELL_CARBON_STEEL:g} kgf/mm²"
_DNV_STEEL = families.DNV_MATERIALS["carbon-steel"].density

CORRELATIONS: Mapping[str, Correlation] = types.MappingProxyType(
    {
        correlation.name: correlation
        for correlation in (
            Correlation("finnie-cfd", "Finnie (CFD, K = 2)", families.finnie_angle, families.finnie,
                        families.FINNIE_MATERIALS["steel"].density, ANGLES_ALONE,
                        "ductile targets; predicts no erosion at 90°, where tests find some",
                        "I. Finnie, Wear 3 (1960) 87-103, as in OpenFOAM's ParticleErosion",
                        "E = c ρ v₀²/(p ψ K) F(α), c = {0.fraction:g}, "
                        f"ψ = {families.CONTACT_RATIO:g}, K = {families.FORCE_RATIO:g}", families.FINNIE_MATERIALS),
            Correlation("dnv", "DNV RP-O501 (2015)", families.dnv_2015, families.dnv, _DNV_STEEL, families.DNV_RANGES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNVGL-RP-O501, Managing sand production and erosion, 2015", _DNV, families.DNV_MATERIALS),
            Correlation("dnv-polynomial", "DNV RP-O501 (before 2015)", families.dnv_polynomial,
                        functools.partial(families.dnv, edition=2007), _DNV_STEEL, families.DNV_RANGES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNV RP O501, Erosive wear in piping systems, revision 4.2, 2007", _DNV,
                        families.DNV_MATERIALS),
            Correlation("ecrc", "E/CRC (Zhang 2007)", families.ecrc_angle, families.ecrc, families.STEEL_DENSITY,
                        ANGLES_ALONE,
                        "sand on carbon steel and nickel alloy",
                        "Y. Zhang, E. P. Reuterfors, B. S. McLaury, S. A. Shirazi, E. F. Rybicki, "
                        "Wear 263 (2007) 330-338", _HARDNESS.format(n=2.41, c=families.ECRC)),
            Correlation("oka", "Oka (SiO₂, Hv = 1.8 GPa)", families.oka_angle, families.oka,
                        families.OKA_MATERIALS["steel"].density, families.OKA_RANGES,
                        "angular sand on metals; the exponents are those of SiO₂",
                        "Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101",
                        "E = ρ E₉₀ (v₀/v')^k₂ (D/D')^k₃ g(α), E₉₀ = {0.normal_erosion:g} m³/kg, "
                        "Hv = {0.hardness:g} GPa, "
                        f"v' = {families.REFERENCE_SPEED:g} m/s, D' = {families.REFERENCE_DIAMETER * 1e6:g} µm, "
                        "k₂ = {0.exponents[0]:.4g}, "
                        f"k₃ = {families.DIAMETER_EXPONENT:g}, g = (sin α)^n₁ [1 + Hv (1 - sin α)]^n₂, "
                        "n₁ = {0.exponents[1]:.4g}, n₂ = {0.exponents[2]:.4g}", families.OKA_MATERIALS),
            Correlation("mclaury", "McLaury (Edwards 2000)", families.mclaury_angle, families.mclaury,
                        families.STEEL_DENSITY, ANGLES_ALONE,
                        "sand on carbon steel",
                        "J. K. Edwards, B. S. McLaury, S. A. Shirazi, ASME FEDSM 2000, 959-966",
                        _HARDNESS.format(n=1.73, c=families.MCLAURY)),
            Correlation("arabnejad", "Arabnejad, cutting (K = 0.4)", families.arabnejad_cutting, families.arabnejad,
                        families.ARABNEJAD_MATERIALS["carbon-steel-4130"].density, families.ARABNEJAD_RANGES,
                        "150 µm sand on steels; F is the cutting term alone, E has deformation too",
                        "H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050",
                        "E = F_s [C₁ v₀^2.41 f(α) + C₂ (v₀ sin α - U)₊²/2], C₁ = {0.cutting:g}, "
                        "C₂ = {0.deformation:g}, K of f = {0.force_ratio:g}, U = {0.threshold:g} m/s",
                        families.ARABNEJAD_MATERIALS),
        )
    }
)  # fmt: skip
"""Every correlation by name: `CORRELATIONS["dnv"].erosion(alpha, v0)`, `CORRELATIONS["dnv"].normalised(alpha)`."""
