"""The erosion with all factors: published numbers, units, derivatives, ranges and mistakes."""

import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion import correlations
from erosion.correlations import CORRELATIONS, OutOfRangeWarning

pytestmark = pytest.mark.slow

STEEP = math.pi / 2
FUNCTIONS = {name: correlation.erosion for name, correlation in CORRELATIONS.items()}


def test_dnv_is_k_v_n_f():
    # F(90°) = 0.6 (1 - e^(-10π)); K and n of RP-O501's table 3-1, as pysand's tests have them.
    assert float(correlations.dnv(STEEP, 30.0)) == pytest.approx(2e-9 * 30**2.6 * 0.6, rel=1e-12)
    assert float(correlations.dnv(STEEP, 30.0, "grp-epoxy")) == pytest.approx(3e-10 * 30**3.6 * 0.6, rel=1e-12)
    # Brittle: F = 2α/π, ½ at 45° and 1 at 90°.
    for angle, shape in ((math.pi / 4, 0.5), (STEEP, 1.0)):
        eroded = correlations.dnv(angle, 50.0, "psz-zirconia")
        assert float(eroded) == pytest.approx(4.1e-9 * 50**2.5 * shape, rel=1e-12)
    older = correlations.dnv(STEEP, 30.0, edition=2007)
    assert float(older) == pytest.approx(2e-9 * 30**2.6 * 0.56851, rel=1e-5)


@pytest.mark.parametrize(
    ("material", "coefficient", "exponent", "density"),
    # The three that pysand's tests hold.
    [("carbon-steel", 2e-9, 2.6, 7800), ("grp-epoxy", 3e-10, 3.6, 1800), ("psz-zirconia", 4.1e-9, 2.5, 5700)],
)
def test_dnv_materials(material, coefficient, exponent, density):
    target = correlations.DNV_MATERIALS[material]
    assert (target.coefficient, target.exponent, target.density) == (coefficient, exponent, density)
    assert target.brittle == (material == "psz-zirconia")


def test_ecrc_has_comsols_constants():
    # COMSOL 6.2: C = 2.17e-7, n = 2.41, BH = 200 and F_s = 0.2; F(1 rad) is the alternating sum of A_i.
    shape = 5.40 - 10.11 + 10.93 - 6.33 + 1.42
    expected = 2.17e-7 * 200**-0.59 * 0.2 * 40**2.41 * shape
    eroded = correlations.ecrc(1.0, 40.0, brinell=200, sharpness="rounded")
    assert float(eroded) == pytest.approx(expected, rel=1e-12)
    assert correlations.SHARPNESS == {"sharp": 1.0, "semi-rounded": 0.53, "rounded": 0.2}


def test_oka_has_the_constants_of_ansys_and_edem():
    # Ansys Fluent, table 12.3: 6.154e-4 kg/kg at 104 m/s, 326 µm and 90° on steel of 1.8 GPa; k₂ = 2.35.
    assert float(correlations.oka(STEEP, 104.0, 326e-6)) == pytest.approx(6.154e-4, rel=1e-12)
    slower, larger = correlations.oka(STEEP, 52.0), correlations.oka(STEEP, 104.0, 652e-6)
    assert float(slower) == pytest.approx(6.154e-4 / 2 ** (2.3 * 1.8**0.038), rel=1e-12)
    assert float(larger) == pytest.approx(6.154e-4 * 2**0.19, rel=1e-12)
    # EDEM: 65 W^0.12 mm³/kg with W = 1000 for aluminium.
    volume = correlations.oka(STEEP, 104.0, material="aluminium", units="mm3/kg")
    assert float(volume) == pytest.approx(65 * 1000**0.12, rel=1e-12)


def test_finnie_has_comsols_constants_and_openfoams_form():
    # At tan α = K/6 both branches are (K/6) cos²α = 0.3 for K = 2.
    angle = math.atan(1 / 3)
    assert float(correlations.finnie(angle, 50.0)) == pytest.approx(0.1 * 7500 * 50**2 / (2e9 * 2 * 2) * 0.3, rel=1e-12)
    target = correlations.FinnieMaterial(5e8, 7000.0)
    volume = correlations.finnie(0.4, 50.0, target, units="mm3/impact", mass=2e-8)
    assert float(volume) == pytest.approx(float(correlations.finnie_volume(0.4, 50.0, 2e-8, 5e8)) * 1e9, rel=1e-12)


def test_mclaury_has_the_constants_of_edwards():
    # Autodesk CFD: B = 120, F_s = 0.53, n = 1.73; below 15° F = -33.4 α² + 17.9 α, at 90° y + z = 0.975.
    size = 1.559e-6 * 120**-0.59 * 0.53 * 25**1.73
    assert float(correlations.mclaury(0.2, 25.0)) == pytest.approx(size * (-33.4 * 0.04 + 17.9 * 0.2), rel=1e-12)
    assert float(correlations.mclaury(STEEP, 25.0)) == pytest.approx(size * 0.975, rel=1e-12)


def test_arabnejad_cuts_and_deforms():
    steep = correlations.arabnejad(STEEP, 30.0)
    assert float(steep) == pytest.approx(3.02e-8 / 2 * (30 - 3.0) ** 2, rel=1e-12)  # no cutting at 90°
    slow = correlations.arabnejad(0.2, 10.0)  # the normal speed is below the threshold of 3 m/s
    shape = math.sin(0.2) * (0.8 * math.cos(0.2) - math.sin(0.2)) / (2 * 0.4**2)
    assert float(slow) == pytest.approx(4.94e-8 * 10**2.41 * shape, rel=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_units_go_by_density_and_mass(name):
    erosion, density = FUNCTIONS[name], CORRELATIONS[name].density
    ratio = float(erosion(0.5, 40.0))
    volume = float(erosion(0.5, 40.0, units="mm³/kg"))
    assert volume == pytest.approx(ratio / density * 1e9, rel=1e-12)
    assert float(erosion(0.5, 40.0, units="mm3/impact", mass=3e-8)) == pytest.approx(volume * 3e-8, rel=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_broadcasts_and_differentiates(name):
    erosion = FUNCTIONS[name]
    angles, speeds = np.deg2rad([10.0, 30.0, 70.0])[:, None], np.array([20, 50])
    assert erosion(angles, speeds).shape == (3, 2)
    h = 1e-6
    for slope, ahead, behind in (
        (jax.grad(erosion)(0.6, 40.0), erosion(0.6 + h, 40.0), erosion(0.6 - h, 40.0)),
        (jax.grad(erosion, 1)(0.6, 40.0), erosion(0.6, 40.0 + h), erosion(0.6, 40.0 - h)),
    ):
        # Central differences of 1e-6: rounding leaves some 1e-8 of E over the step.
        assert float(slope) == pytest.approx(float(ahead - behind) / (2 * h), rel=1e-5, abs=1e-8 * float(ahead))


def test_all_grow_with_the_speed_and_are_of_one_order():
    for name, erosion in FUNCTIONS.items():
        slow, fast = (float(erosion(np.deg2rad(30), speed)) for speed in (30.0, 60.0))
        assert fast > slow, name
        # Sand on steel at 30 m/s and 30°: all within a factor of three of 3e-5 kg/kg.
        assert 1e-5 < slow < 9e-5, name


def test_a_warning_says_by_how_much():
    with pytest.warns(OutOfRangeWarning, match="DNV RP-O501 is made for speeds from 0 m/s to 200 m/s: 250 m/s is 1.25"):
        correlations.dnv(0.5, np.array([100.0, 250.0]))
    with pytest.warns(OutOfRangeWarning, match="angles from 0° to 90°: 114.6° is 1.27 times the greatest"):
        correlations.oka(2.0, 100.0)
    with pytest.warns(OutOfRangeWarning, match=r"-5.73° is 0.1 rad below the least"):
        correlations.ecrc(-0.1, 100.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        correlations.dnv(STEEP, 200.0)
        jax.jit(correlations.dnv)(jnp.asarray(2.0), 300.0)  # traced numbers are not known


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: correlations.dnv(0.5, 30.0, "steel"), "Argument `material` must be one of carbon-steel, duplex, "),
        (lambda: correlations.dnv(0.5, 30.0, units="g/kg"), "Argument `units` must be one of kg/kg, mm3/kg, mm3/imp"),
        (lambda: correlations.oka(0.5, 30.0, units="mm3/impact"), "Argument `mass` must be the mass of a particle"),
        (lambda: correlations.ecrc(0.5, 30.0, mass=1e-8), "Argument `mass` must be the mass of a particle"),
        (lambda: correlations.ecrc(0.5, 30.0, sharpness="round"), "Argument `sharpness` must be a number or one of"),
    ],
)
def test_mistakes_are_sentences(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_target_of_ones_own():
    glass = correlations.DNVMaterial(1e-9, 2.0, 2500.0, brittle=True)
    assert float(correlations.dnv(STEEP, 10.0, glass)) == pytest.approx(1e-7, rel=1e-12)
    hard = correlations.OkaMaterial(1e-8, 5.0, 8000.0)
    assert float(correlations.oka(STEEP, 104.0, material=hard)) == pytest.approx(8e-5, rel=1e-12)
