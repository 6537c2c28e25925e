"""Numbers that others published of the formulas, or have in their programs: which agree, and how far others are off."""

import math

import jax
import numpy as np
import pytest

import erosion
from erosion import correlations
from erosion.checks.validate import sphere
from erosion.impacts.simulate import path
from erosion.models import Linearized
from erosion.models.deformation import DeformationWear

pytestmark = pytest.mark.slow

# One grain of 10 µg at 50 m/s, K = ψ = 2, p = 1 GPa [µm³]; OpenFOAM's formula, evaluated apart.
OPENFOAM = {10.0: 1572.24421565, 40.0: 1222.55018507}
# 5 mm sphere of 7850 kg/m³ at 10 m/s and 90°, p = 1.005 GPa: constant contact pressure (Tabor 1951).
DEPTH, TIME, VOLUME = 57.0487557e-6, 8.9611976e-6, 0.0255612586e-9  # v √(m/(2πRp)), (π/2) √(m/(2πRp)), m v²/(2p)


def speed_exponent(erosion_of_speed):
    """∂ ln E/∂ ln v₀ at 50 m/s."""
    return jax.grad(erosion_of_speed)(50.0) * 50.0 / erosion_of_speed(50.0)


def cutting(material):
    """Arabnejad's E/(F_s cos²α) at 1 m/s and 60°, steeper than the transition and too slow to deform."""
    return correlations.arabnejad(math.radians(60), 1.0, material=material) / math.cos(math.radians(60)) ** 2


def threshold(material):
    """Arabnejad's speed at which E begins at 90°, where nothing is cut: from √E at two greater speeds."""
    slow, fast = (math.sqrt(correlations.arabnejad(math.pi / 2, v0, material=material)) for v0 in (50.0, 100.0))
    return 50.0 - slow * 50.0 / (fast - slow)


def at_30(correlation, **factors):
    return lambda v0=50.0: correlation(math.radians(30), v0, **factors)


PARTICLE_MODULE = "ASBLittle/ParticleModule, particle_model/Collision.py"
GEMINI = "GEMINI-Digital-Twin/gemini-geothermal-suite-open, src/gemini_model/erosion/correlation"
NEKTAR = "a copy of Nektar++, library/FieldUtils/ProcessModules/ProcessWear.cpp, function TulsaAnsys"
FLUENT = "Ansys Fluent 2024 R2 Theory Guide, table 12.3"

PUBLISHED = {
    "E/CRC, E": (at_30(correlations.ecrc, brinell=200.0, sharpness=1.0), 1.42655014e-4, 1.0, GEMINI),
    "E/CRC, n": (lambda: speed_exponent(at_30(correlations.ecrc)), 2.41, 1.0, "COMSOL 6.2"),
    "Finnie, f(45°)": (lambda: correlations.finnie_angle(math.pi / 4), 1 / 6, 1.0, "Ansys CFX 2024 R2, (6-91)"),
    "DNV 2007, F(30°)": (lambda: correlations.dnv_polynomial(math.pi / 6), 0.992543276, 1.0, GEMINI),
    "Oka, k₂ of aluminium": (
        lambda: speed_exponent(at_30(correlations.oka, material="aluminium")), 2.21242, 1.0, "Altair EDEM",
    ),
    "Oka, k₂ of steel": (lambda: speed_exponent(at_30(correlations.oka)), 2.35, 1.00083, FLUENT),
    # Programs round the exponents, take 1 for a constant of the target, or have another W.
    "Oka, g(30°)": (lambda: correlations.oka_angle(math.pi / 6), 1.32299, 1.0750, FLUENT),
    "Oka, E₉₀ by the hardness alone": (
        lambda: correlations.oka(math.pi / 2, 104.0, units="mm3/kg"), 60.5732193, 1 / 0.768, GEMINI,
    ),
    "Oka, E₉₀ by K W^0.12": (
        lambda: correlations.oka(math.pi / 2, 104.0, material="carbon-steel"), 6.154e-4, 0.9400, FLUENT,
    ),
    # Nektar++ has the same A and n, and another F.
    "McLaury, n": (lambda: speed_exponent(at_30(correlations.mclaury)), 1.73, 1.0, "Autodesk CFD 2023"),
    "McLaury, E": (at_30(correlations.mclaury, brinell=200.0, sharpness=1.0), 2.27691836e-4, 1 / 1.64, NEKTAR),
    "McLaury, F(10°)": (lambda: correlations.mclaury_angle(math.pi / 18), 2.79216651, 1 / 1.325, NEKTAR),
    "McLaury, F(90°)": (lambda: correlations.mclaury_angle(math.pi / 2), 2.89642209, 0.33662, NEKTAR),
    "Arabnejad 1018, cutting": (lambda: cutting("carbon-steel-1018"), 2.76289e-8, 1.0677, PARTICLE_MODULE),
    "Arabnejad 316, cutting": (lambda: cutting("stainless-steel-316"), 2.64111e-8, 0.8671, PARTICLE_MODULE),
    "Arabnejad 6061, cutting": (lambda: cutting("aluminium-6061"), 2.55583e-8, 0.7747, PARTICLE_MODULE),
    "Arabnejad 1018, threshold": (lambda: threshold("carbon-steel-1018"), 5.0, 1.1, PARTICLE_MODULE),
    "Arabnejad 316, threshold": (lambda: threshold("stainless-steel-316"), 5.7, 5.8 / 5.7, PARTICLE_MODULE),
    "Arabnejad 6061, threshold": (lambda: threshold("aluminium-6061"), 7.3, 1.0, PARTICLE_MODULE),
}  # fmt: skip
"""By name: what computes it, the number, computed over published, and the source."""


@pytest.mark.parametrize("name", PUBLISHED)
def test_formulas_give_what_others_print_or_miss_it_by_what_is_known(name):
    compute, published, ratio, _ = PUBLISHED[name]
    # Published numbers have six digits or more, ratios four.
    assert float(compute()) == pytest.approx(published * ratio, rel=1e-6 if ratio == 1.0 else 1e-3)


@pytest.mark.parametrize("angle", OPENFOAM)
def test_openfoams_formula_is_a_limit_of_finnies_model_and_the_correlation(angle):
    alpha = math.radians(angle)
    p = erosion.Parameters(k=2.0, psi=2.0, r=1e-4, b=1e-4, m=1e-8, v0=50.0, sigma=1e9, alpha=alpha, units="si")
    for volume in (erosion.impact("finnie", p).volume, correlations.finnie_volume(alpha, 50.0, 1e-8, 1e9)):
        assert float(volume) * 1e18 == pytest.approx(OPENFOAM[angle], rel=1e-8)


def test_a_sphere_under_constant_pressure_is_a_limit_of_models():
    normal = path(Linearized(), sphere(10.0 * np.sqrt(2), 45.0))
    assert normal.max_depth == pytest.approx(DEPTH, rel=1e-8)
    assert normal.t_c / 2 == pytest.approx(TIME, rel=1e-8)
    # What the energy displaces: a model that deforms removes it with ε in the place of p; at 90° nothing is cut.
    model = Linearized(deformation=DeformationWear(specific_energy=3 * 335e6, threshold=0.0))
    assert float(erosion.impact(model, sphere(10.0, 90.0)).volume) == pytest.approx(VOLUME, rel=1e-8)
