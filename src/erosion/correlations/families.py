"""Erosion after six families of tests: for each its targets, its shape F(α), and E with all factors.

A family is a table of targets, the ranges that it is made for, a formula E(α, v₀, …) of one target [kg/kg], and a
function that reads the target, warns outside of the ranges, and gives the unit that is asked for.
"""

import functools
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array

from erosion.correlations.ranges import (
    ALL_ANGLES,
    ANGLES_ALONE,
    Range,
    Values,
    in_units,
    of_table,
    sharpness_factor,
    warn_outside,
)
from erosion.output import briefly

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


def finnie_angle(alpha: Values, force_ratio: Values = FORCE_RATIO) -> Array:
    """Finnie's closed form as CFD codes have it, per V²/(ψ K p) and unit mass of particles.

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
        speed: V, relative to the wall [m/s].
        mass: m, of the particle(s) [mass].
        flow_stress: p [Pa].
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
    target = of_table(FINNIE_MATERIALS, material, FinnieMaterial)
    warn_outside("Finnie", ANGLES_ALONE, alpha=alpha, v0=v0)
    return in_units(_finnie(alpha, v0, force_ratio, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _finnie(alpha: Values, v0: Values, force_ratio: Values, target: FinnieMaterial) -> Array:
    volume = finnie_volume(alpha, v0, 1.0, target.flow_stress, CONTACT_RATIO, force_ratio)
    return target.fraction * target.density * volume


# For sand (SiO₂): Oka et al. 2005 as quoted by the Altair EDEM documentation, The Oka Wear Model, table 1.
REFERENCE_SPEED = 104.0  # v' [m/s]
REFERENCE_DIAMETER = 326e-6  # D' [m]
DIAMETER_EXPONENT = 0.19  # k₃ [-]
SAND = 65.0  # K [mm³/kg]
WEAR_EXPONENT = 0.12  # -k₁ [-]; EDEM's constant W is (a Hv)^-b, so that E₉₀ at v' and D' is K W^0.12


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

    @property
    def exponents(self) -> tuple[Values, Values, Values]:
        """k₂ of the speed, and n₁ and n₂ of g(α)."""
        return _oka_exponents(self.hardness)


# The densities are those of DNVGL-RP-O501 (2015), table 3-1.
OKA_MATERIALS: Mapping[str, OkaMaterial] = types.MappingProxyType(
    {
        # Ansys Fluent 2024 R2 Theory Guide, table 12.3, "sand - steel": E₉₀ = 6.154e-4 kg/kg, Hv = 1.8 GPa.
        "steel": OkaMaterial(6.154e-4 / 7800.0, 1.8, 7800.0),
        # Altair EDEM, The Oka Wear Model, table 2: W = 3 with Hv = 0.54 to 1.18 GPa; W = 10; W = 1000.
        "carbon-steel": OkaMaterial(SAND * 3.0**WEAR_EXPONENT * 1e-9, 1.18, 7800.0),
        "stainless-steel": OkaMaterial(SAND * 10.0**WEAR_EXPONENT * 1e-9, 1.77, 8000.0),
        "aluminium": OkaMaterial(SAND * 1000.0**WEAR_EXPONENT * 1e-9, 0.36, 2700.0),
    }
)
"""Targets of sand by name."""

# The speeds of the tests behind the correlation were not at hand; the rig of the same authors reached this one.
_RIG = "test rig of Y. I. Oka et al., Wear 250 (2001) 736-743, abstract"
OKA_RANGES: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES, "v0": Range(0.0, 135.0, "m/s", _RIG)})


def _oka_exponents(hardness: Values) -> tuple[Values, Values, Values]:
    return 2.3 * hardness**0.038, 0.71 * hardness**0.14, 2.4 * hardness**-0.94


def oka_angle(alpha: Values, hardness: Values = 1.8) -> Array:
    """Oka's (sin α)^n₁ [1 + Hv (1 - sin α)]^n₂ for sand (SiO₂), which is 1 at 90°.

    Args:
        alpha: α [rad].
        hardness: Vickers hardness Hv of the target [GPa]. 1.8 is carbon steel; shallow angles gain on hard ones less.

    References:
        Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101.
    """
    sine, (_, n1, n2) = jnp.sin(alpha), _oka_exponents(hardness)
    return sine**n1 * (1 + hardness * (1 - sine)) ** n2


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
    target = of_table(OKA_MATERIALS, material, OkaMaterial)
    warn_outside("Oka", OKA_RANGES, alpha=alpha, v0=v0)
    return in_units(_oka(alpha, v0, diameter, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _oka(alpha: Values, v0: Values, diameter: Values, target: OkaMaterial) -> Array:
    speed = jnp.asarray(v0 / REFERENCE_SPEED) ** target.exponents[0]
    size = jnp.asarray(diameter / REFERENCE_DIAMETER) ** DIAMETER_EXPONENT
    return target.normal_erosion * target.density * speed * size * oka_angle(alpha, target.hardness)


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
    return _alternating(coefficients, alpha)


def _alternating(coefficients: Sequence[float], alpha: Values) -> Array:
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
    target = of_table(DNV_MATERIALS, material, DNVMaterial)
    if edition not in (2007, 2015):
        raise ValueError(f"Argument `edition` must be 2007 or 2015, but is {briefly(edition)}.")
    warn_outside("DNV RP-O501", DNV_RANGES, alpha=alpha, v0=v0)
    return in_units(_dnv(alpha, v0, target, edition), units, target.density, mass)


@functools.partial(jax.jit, static_argnames=("target", "edition"))
def _dnv(alpha: Values, v0: Values, target: DNVMaterial, edition: int) -> Array:
    ductile = dnv_2015 if edition == 2015 else dnv_polynomial
    angle = dnv_brittle(alpha) if target.brittle else ductile(alpha)
    return target.coefficient * jnp.asarray(v0, float) ** target.exponent * angle


ECRC = 2.17e-7  # C [(m/s)⁻ⁿ], for Brinell hardness; COMSOL 6.2, Particle Tracing Module, node Erosion
_HARDNESS_EXPONENT = -0.59  # of the Brinell hardness [-], Zhang 2007
_ECRC_EXPONENT = 2.41  # n [-], the same
_ECRC_ANGLES = (5.40, 10.11, 10.93, 6.33, 1.42)  # A_i [rad⁻ⁱ], Zhang 2007

BRINELL_CARBON_STEEL = 120.0  # kgf/mm², Edwards et al. 2000 as quoted by Autodesk CFD 2023
STEEL_DENSITY = 7800.0  # kg/m³, DNVGL-RP-O501 (2015), table 3-1, carbon steel


def ecrc_angle(alpha: Values) -> Array:
    """F = 5.40α - 10.11α² + 10.93α³ - 6.33α⁴ + 1.42α⁵, of the E/CRC in Tulsa (Zhang 2007)."""
    return _alternating(_ECRC_ANGLES, alpha)


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
    factor = sharpness_factor(sharpness)
    warn_outside("E/CRC", ANGLES_ALONE, alpha=alpha, v0=v0)
    ratio = _hardness_law(alpha, v0, brinell, factor, (ECRC, _ECRC_EXPONENT, ecrc_angle))
    return in_units(ratio, units, density, mass)


@functools.partial(jax.jit, static_argnames="constants")
def _hardness_law(
    alpha: Values,
    v0: Values,
    brinell: Values,
    sharpness: Values,
    constants: tuple[float, float, Callable[[Values], Array]],
) -> Array:
    """E = C BH^-0.59 F_s v₀ⁿ F(α) [kg/kg], for the constants (C, n, F)."""
    coefficient, exponent, angle = constants
    hardness, speed = (jnp.asarray(value, float) for value in (brinell, v0))
    return coefficient * hardness**_HARDNESS_EXPONENT * sharpness * speed**exponent * angle(alpha)


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
EDWARDS = AngleConstants(0.2617993877991494, -33.4, 17.9, 1.0, 1.239, -1.192, 2.167)

MCLAURY = 1.559e-6  # A [(m/s)⁻ⁿ], for Brinell hardness; Nektar++ (a copy of it), ProcessWear.cpp, TulsaAnsys
_MCLAURY_EXPONENT = 1.73  # n [-], Edwards et al. 2000; Autodesk CFD 2023


def mclaury_angle(alpha: Values, constants: AngleConstants = EDWARDS) -> Array:
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
        J. K. Edwards, B. S. McLaury, S. A. Shirazi, ASME FEDSM 2000, 959-966, as Autodesk CFD's help prints F, n, F_s
        and BH, paired with A of Nektar++. Which F belongs to A = 1559e-9 is open: that of Nektar++ is 64 % greater at
        30°, so **compare F with the paper before you rely on absolute numbers**.
        The speeds and sizes of its tests were not at hand, so that only the angle is checked.
    """
    factor = sharpness_factor(sharpness)
    warn_outside("McLaury", ANGLES_ALONE, alpha=alpha, v0=v0)
    ratio = _hardness_law(alpha, v0, brinell, factor, (MCLAURY, _MCLAURY_EXPONENT, mclaury_angle))
    return in_units(ratio, units, density, mass)


_ARABNEJAD_EXPONENT = 2.41  # of the cutting term [-]


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
    target, factor = of_table(ARABNEJAD_MATERIALS, material, ArabnejadMaterial), sharpness_factor(sharpness)
    warn_outside("Arabnejad", ARABNEJAD_RANGES, alpha=alpha, v0=v0)
    return in_units(_arabnejad(alpha, v0, factor, target), units, target.density, mass)


@functools.partial(jax.jit, static_argnames="target")
def _arabnejad(alpha: Values, v0: Values, sharpness: Values, target: ArabnejadMaterial) -> Array:
    speed = jnp.asarray(v0, float)
    cutting = target.cutting * speed**_ARABNEJAD_EXPONENT * arabnejad_cutting(alpha, target.force_ratio)
    excess = jnp.maximum(speed * jnp.sin(alpha) - target.threshold, 0.0)
    return jnp.asarray(sharpness, float) * (cutting + target.deformation / 2 * excess**2)
