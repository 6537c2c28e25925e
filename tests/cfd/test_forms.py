"""A model and a case in the forms of OpenFOAM and Fluent, without a fit."""

import math
import re

import numpy as np
import pytest

import erosion
from erosion.cfd.exports import particle_of

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
SI = P.to("si")
ANGLES = np.deg2rad(np.linspace(1.0, 89.0, 177))


def openfoam_volume(text: str, alpha, speed, mass):
    """Q of one particle as OpenFOAM's ParticleErosion computes it from the numbers in its dictionary."""
    p, psi, ratio = (float(re.findall(rf"\n    {name} +([-\d.e+]+);", text)[0]) for name in ("p", "psi", "K"))
    shallow = np.sin(2 * alpha) - 6 / ratio * np.sin(alpha) ** 2
    steep = ratio * np.cos(alpha) ** 2 / 6
    return mass * speed**2 / (p * psi * ratio) * np.where(np.tan(alpha) < ratio / 6, shallow, steep)


@pytest.mark.parametrize("case", [P, SI, P.replace(k=np.pi / 3, v0=900.0, psi=np.e)])
def test_openfoam_computes_the_volumes_of_finnie_from_the_file(case):
    text = erosion.to_openfoam("finnie", case).text()
    in_si = case.to("si")
    for speed in (20.0, 111.0):
        exact = erosion.impact("finnie", in_si.replace(alpha=ANGLES, v0=speed), rtol=1e-13).volume
        assert openfoam_volume(text, ANGLES, speed, float(in_si.m)) == pytest.approx(exact, rel=1e-9)


def test_the_coefficients_of_finnie_are_those_of_the_case():
    form = erosion.to_openfoam("finnie", P)
    assert pytest.approx(2.0, rel=1e-9) == form.K
    assert form.p == pytest.approx(float(SI.sigma), rel=1e-9)
    assert form.psi == 0.04
    assert form.warnings == ()
    assert "finnie" in form.text()
    # K = 3k and p = σ/3 for a body that does not turn.
    other = erosion.to_openfoam("linearized", P)
    assert (other.K, other.p) == pytest.approx((6.0, float(SI.sigma) / 3), rel=1e-9)


def test_what_openfoam_loses_at_other_speeds_is_said_and_refused_if_asked_for():
    form = erosion.to_openfoam("rotating", P)
    # The shape over the angle changes with rω/v₀.
    assert 0.05 < form.misfit < 0.1
    assert 0.4 < form.losses.worst < 0.8
    assert form.warnings[0].startswith("OpenFOAM knows Finnie's curve only: it is off by up to 7.1% of the maximum.")
    assert "At half and at twice this speed it is off by up to 59" in form.warnings[1]
    assert form.losses.statement in form.text()
    with pytest.raises(
        erosion.ExportError, match=r"OpenFOAM is made at 111\.8 m/s, and at 223\.5 m/s and 2032 µm it is"
    ):
        erosion.to_openfoam("rotating", P, v0=[4400.0, 8800.0])
    narrow = erosion.to_openfoam("rotating", P, v0=[4300.0, 4400.0])
    assert narrow.losses.statement.startswith("Over 109.2 to 111.8 m/s the form is off by up to ")


def test_the_speeds_of_a_model_that_does_not_turn_lose_nothing():
    assert erosion.to_openfoam("linearized", P, v0=[100.0, 9000.0], d=[0.001, 1.0]).losses.worst < 1e-9


@pytest.mark.parametrize("model", ["dnv", "linearized-deformation"])
def test_openfoam_is_refused_a_curve_that_removes_something_at_90_degrees(model):
    with pytest.raises(erosion.ExportError, match=f"{model} is not of that shape"):
        erosion.to_openfoam(model, P)


@pytest.mark.parametrize(
    ("model", "exponent"), [("linearized", 2.0), ("dnv", 2.6), ("ecrc", 2.41), ("linearized-deformation", 2.0)]
)
def test_fluent_gets_the_exponent_that_the_model_has(model, exponent):
    table = erosion.to_fluent(model, P)
    assert table.exponent == pytest.approx(exponent, abs=1e-9)
    # f and C v^b are those of the model, at every speed.
    assert table.losses.worst == pytest.approx(table.misfit, abs=1e-9)
    assert table.warnings == ()
    steep = np.deg2rad(30.0)
    exact = float(erosion.impact(model, SI.replace(alpha=steep, v0=40.0)).volume)
    form = float(SI.m) * table.factor * np.interp(steep, table.angle, table.f) * 40.0**table.exponent
    assert form == pytest.approx(exact, rel=0.01)


def test_fluents_diameter_function_is_that_of_oka():
    table = erosion.to_fluent("oka", P)
    # Oka: E grows as D^0.19; the diameter is that of the erodent's density.
    growth = np.log(table.factors[-1] / table.factors[0]) / np.log(table.diameter[-1] / table.diameter[0])
    assert growth == pytest.approx(0.19, abs=1e-9)
    assert "piecewise-linear:" in table.text()
    assert np.ptp(erosion.to_fluent("rotating", P).factors) < 1e-9
    assert "the same for all diameters." in erosion.to_fluent("rotating", P).text()


def test_speeds_alone_leave_the_diameter_function_and_diameters_the_exponent():
    speeds, sizes = [4400.0, 6000.0], [0.05, 0.08]
    assert erosion.to_fluent("oka", P, v0=speeds).factors == pytest.approx(erosion.to_fluent("oka", P).factors)
    alone = erosion.to_fluent("dnv", P, d=sizes)
    assert alone.exponent == pytest.approx(2.6, abs=1e-9)
    assert alone.losses.misfit.shape == (2, 1)
    assert erosion.to_fluent("dnv", P, v0=4400.0).exponent == pytest.approx(2.6, abs=1e-9)


def test_what_fluent_loses_at_other_speeds_is_said_and_refused_if_asked_for():
    table = erosion.to_fluent("rotating", P)
    assert table.losses.worst > 0.4
    assert table.warnings[0].startswith(
        "Fluent: The form is made at 111.76 m/s. At half and at twice this speed it is off by"
    )
    with pytest.raises(erosion.ExportError, match=r"Fluent is made at 111\.8 m/s"):
        erosion.to_fluent("rotating", P, v0=np.linspace(2200, 8800, 5))


def test_the_diameter_is_2_r_or_that_of_the_particles_density():
    assert particle_of("finnie", P).diameter == pytest.approx(2 * 0.04 * 0.0254)
    quartz = particle_of("finnie", SI, 2650.0)
    assert quartz.density == pytest.approx(2650.0)
    assert 2650.0 * math.pi / 6 * quartz.diameter**3 == pytest.approx(float(SI.m))
    # A density is in kg/m³, whatever the units of the case.
    other = particle_of("finnie", P, 2650.0)
    assert other.diameter == pytest.approx(quartz.diameter, rel=1e-9)


def test_a_spinning_particle_that_cuts_nothing_has_no_form():
    # s = rφ̇₀/v₀ = -2: the tip moves backward at every angle.
    with pytest.raises(erosion.ExportError, match="rotating removes nothing at any angle"):
        erosion.to_fluent("rotating", P.replace(phidot0=-2.2e5))


def test_where_nothing_is_removed_at_the_speeds_that_are_given_there_is_no_exponent():
    backward = P.replace(phidot0=-0.6 * 4400 / 0.04)
    with pytest.raises(erosion.ExportError, match="finnie removes nothing at other speeds"):
        erosion.to_fluent("finnie", backward, v0=[1000.0, 2000.0])


def test_where_nothing_is_cut_at_half_the_speed_all_is_lost():
    # s = -0.6 at the case's speed, and -1.2 at half of it.
    table = erosion.to_fluent("finnie", P.replace(phidot0=-0.6 * 4400 / 0.04))
    assert table.losses.misfit[4, 0] == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"v0": -1.0}, "Argument `v0` must be positive and finite, but has -1."),
        ({"v0": []}, r"Argument `v0` must be a number or a list of them, but has shape \(0,\)."),
        ({"d": "a"}, "Argument `d` must be numbers, but is 'a'."),
        ({"particle_density": 0.0}, "Argument `particle_density` must be positive and finite, but has 0."),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    for export in (erosion.to_openfoam, erosion.to_fluent):
        with pytest.raises(ValueError, match=message):
            export("finnie", P, **arguments)


def test_a_case_is_one_impact():
    with pytest.raises(ValueError, match="`v0` must be a scalar"):
        erosion.to_openfoam("finnie", P.replace(v0=np.array([1.0, 2.0])))
    with pytest.raises(TypeError, match="Argument `p` must be Parameters, but is left out"):
        erosion.to_openfoam("finnie")
