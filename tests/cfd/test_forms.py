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


# K = 3k and p = σ/3 for a body that does not turn, at any speed and size.
@pytest.mark.parametrize(("model", "ratio", "stress"), [("finnie", 2.0, 1.0), ("linearized", 6.0, 1 / 3)])
def test_the_coefficients_of_finnies_shape_are_those_of_the_case(model, ratio, stress):
    form = erosion.to_openfoam(model, P, v0=[100.0, 9000.0] if model == "linearized" else None, d=None)
    assert (form.K, form.p) == pytest.approx((ratio, stress * float(SI.sigma)), rel=1e-9)
    assert (form.psi, form.warnings) == (0.04, ())
    assert form.losses.worst < 1e-9
    assert model in form.text()


@pytest.mark.parametrize(
    ("export", "said", "at"),
    [
        (erosion.to_openfoam, "OpenFOAM: The form is made at 111.76 m/s. At half and at twice this speed it is off by",
         r"OpenFOAM is made at 111\.8 m/s, and at 223\.5 m/s and 2032 µm it is"),
        (erosion.to_fluent, "Fluent: The form is made at 111.76 m/s. At half and at twice this speed it is off by",
         r"Fluent is made at 111\.8 m/s"),
    ],
)  # fmt: skip
def test_what_a_form_loses_at_other_speeds_is_said_and_refused_if_asked_for(export, said, at):
    # The shape over the angle changes with rω/v₀.
    form = export("rotating", P)
    assert 0.4 < form.losses.worst < 0.8
    assert form.warnings[-1].startswith(said)
    assert form.losses.statement in form.text()
    with pytest.raises(erosion.ExportError, match=at):
        export("rotating", P, v0=[4400.0, 8800.0])
    narrow = export("rotating", P, v0=[4300.0, 4400.0])
    assert narrow.losses.statement.startswith("Over 109.2 to 111.8 m/s the form is off by up to ")


def test_openfoam_says_how_far_off_finnies_curve_is():
    form = erosion.to_openfoam("rotating", P)
    assert 0.05 < form.misfit < 0.1
    assert form.warnings[0].startswith("OpenFOAM knows Finnie's curve only: it is off by up to 7.1% of the maximum.")


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
    table, turning = erosion.to_fluent("oka", P), erosion.to_fluent("rotating", P)
    # Oka: E grows as D^0.19; the diameter is that of the erodent's density.
    growth = np.log(table.factors[-1] / table.factors[0]) / np.log(table.diameter[-1] / table.diameter[0])
    assert growth == pytest.approx(0.19, abs=1e-9)
    assert "piecewise-linear:" in table.text()
    assert np.ptp(turning.factors) < 1e-9
    assert "the same for all diameters." in turning.text()
    # Speeds alone leave the diameter function, and diameters the exponent.
    assert erosion.to_fluent("oka", P, v0=[4400.0, 6000.0]).factors == pytest.approx(table.factors)
    alone = erosion.to_fluent("dnv", P, d=[0.05, 0.08])
    assert (alone.exponent, alone.losses.misfit.shape) == (pytest.approx(2.6, abs=1e-9), (2, 1))
    assert erosion.to_fluent("dnv", P, v0=4400.0).exponent == pytest.approx(2.6, abs=1e-9)


def test_the_diameter_is_2_r_or_that_of_the_particles_density():
    assert particle_of("finnie", P).diameter == pytest.approx(2 * 0.04 * 0.0254)
    quartz = particle_of("finnie", SI, 2650.0)
    assert quartz.density == pytest.approx(2650.0)
    assert 2650.0 * math.pi / 6 * quartz.diameter**3 == pytest.approx(float(SI.m))
    # A density is in kg/m³, whatever the units of the case.
    other = particle_of("finnie", P, 2650.0)
    assert other.diameter == pytest.approx(quartz.diameter, rel=1e-9)


BACKWARD = P.replace(phidot0=-0.6 * 4400 / 0.04)  # s = rφ̇₀/v₀ = -0.6 at the case's speed, and -1.2 at half of it


@pytest.mark.parametrize(
    ("export", "model", "options", "message"),
    [
        # The tip moves backward at every angle.
        (erosion.to_fluent, "rotating", {"p": P.replace(phidot0=-2.2e5)}, "rotating removes nothing at any angle"),
        (
            erosion.to_fluent,
            "finnie",
            {"p": BACKWARD, "v0": [1000.0, 2000.0]},
            "finnie removes nothing at other speeds",
        ),
        # Both remove something at 90°.
        (erosion.to_openfoam, "dnv", {"p": P}, "dnv is not of that shape"),
        (erosion.to_openfoam, "linearized-deformation", {"p": P}, "linearized-deformation is not of that shape"),
    ],
)
def test_a_curve_that_has_no_form_is_refused(export, model, options, message):
    with pytest.raises(erosion.ExportError, match=message):
        export(model, **options)


def test_where_nothing_is_cut_at_half_the_speed_all_is_lost():
    assert erosion.to_fluent("finnie", BACKWARD).losses.misfit[4, 0] == 1.0


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
