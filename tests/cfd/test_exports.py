"""What CFD codes take of a model and a case: forms of OpenFOAM and Fluent, tables of volumes, and rebounds."""

import csv
import io
import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import erosion
from erosion.cfd.exports import particle_of, to_csv

P = erosion.TABLE_1
SI = P.to("si")
ANGLES = np.deg2rad(np.linspace(1.0, 89.0, 177))


def openfoam_volume(text: str, alpha, speed, mass):
    """Q of one particle as OpenFOAM's ParticleErosion computes it from the numbers in its dictionary."""
    p, psi, ratio = (float(re.findall(rf"\n    {name} +([-\d.e+]+);", text)[0]) for name in ("p", "psi", "K"))
    shallow = np.sin(2 * alpha) - 6 / ratio * np.sin(alpha) ** 2
    steep = ratio * np.cos(alpha) ** 2 / 6
    return mass * speed**2 / (p * psi * ratio) * np.where(np.tan(alpha) < ratio / 6, shallow, steep)


@pytest.mark.parametrize("case", [P, SI, P.replace(k=np.pi / 3, v0="900 in/s", psi=np.e)])
def test_openfoam_computes_the_volumes_of_finnie_from_the_file(case):
    text = erosion.to_openfoam("finnie", case).text()
    in_si = case.to("si")
    for speed in (20.0, 111.0):
        exact = erosion.impact("finnie", in_si.replace(alpha=ANGLES, v0=speed), rtol=1e-13).volume
        assert openfoam_volume(text, ANGLES, speed, float(in_si.m)) == pytest.approx(exact, rel=1e-9)


# K = 3k and p = σ/3 for a body that does not turn, at any speed and size.
@pytest.mark.parametrize(("model", "ratio", "stress"), [("finnie", 2.0, 1.0), ("linearized", 6.0, 1 / 3)])
def test_the_coefficients_of_finnies_shape_are_those_of_the_case(model, ratio, stress):
    form = erosion.to_openfoam(model, P, v0=["100 in/s", "9000 in/s"] if model == "linearized" else None, d=None)
    assert (form.K, form.p) == pytest.approx((ratio, stress * float(SI.sigma)), rel=1e-9)
    assert (form.psi, form.findings) == (0.04, ())
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
    assert form.findings[-1].text.startswith(said)
    assert form.losses.finding().text in form.text()
    with pytest.raises(erosion.ExportError, match=at):
        export("rotating", P, v0=["4400 in/s", "8800 in/s"])
    narrow = export("rotating", P, v0=["4300 in/s", "4400 in/s"])
    assert narrow.losses.finding().text.startswith("Over 109.2 to 111.8 m/s the form is off by up to ")


@pytest.mark.parametrize(
    ("model", "exponent"), [("linearized", 2.0), ("dnv", 2.6), ("ecrc", 2.41), ("linearized-deformation", 2.0)]
)
def test_fluent_gets_the_exponent_that_the_model_has(model, exponent):
    table = erosion.to_fluent(model, P)
    assert table.exponent == pytest.approx(exponent, abs=1e-9)
    # f and C v^b are those of the model, at every speed.
    assert table.losses.worst == pytest.approx(table.misfit, abs=1e-9)
    assert table.findings == ()
    steep = np.deg2rad(30.0)
    exact = float(erosion.impact(model, SI.replace(alpha=steep, v0=40.0)).volume)
    form = float(SI.m) * table.factor * np.interp(steep, table.angle, table.f) * 40.0**table.exponent
    assert form == pytest.approx(exact, rel=0.01)


def test_fluents_constant_is_a_number_where_the_density_is_known():
    # E = K v0^n F(α), so that C is K times the greatest F; a correlation has its density.
    table = erosion.to_fluent("dnv", P)
    constant, unit = table.constant(table.factor).split(" ", 1)
    assert float(constant) == pytest.approx(2e-9 * erosion.CORRELATIONS["dnv"].peak, rel=1e-5)
    assert (table.density, unit) == (7800.0, "(s/m)^2.6")
    assert f"C = {constant} (s/m)^2.6, for a target of 7800 kg/m^3, the same" in table.text()
    unknown, known = erosion.to_fluent("finnie", P), erosion.to_fluent("finnie", P, density=2700.0)
    assert float(known.constant(known.factor).split()[0]) == pytest.approx(2700.0 * unknown.factor, rel=1e-6)
    assert unknown.constant(unknown.factor).endswith("x density of the target")
    with pytest.raises(ValueError, match="Argument `density` must be that of the target of dnv"):
        erosion.to_fluent("dnv", P, density=2700.0)


def test_fluents_diameter_function_is_that_of_oka():
    table, turning = erosion.to_fluent("oka", P), erosion.to_fluent("rotating", P)
    # Oka: E grows as D^0.19; the diameter is that of the particle's density.
    growth = np.log(table.factors[-1] / table.factors[0]) / np.log(table.diameter[-1] / table.diameter[0])
    assert growth == pytest.approx(0.19, abs=1e-9)
    assert "piecewise-linear:" in table.text()
    assert np.ptp(turning.factors) < 1e-9
    assert "the same for all diameters." in turning.text()
    # Speeds alone leave the diameter function, and diameters the exponent.
    assert erosion.to_fluent("oka", SI, v0=[111.76, 150.0]).factors == pytest.approx(table.factors)
    alone = erosion.to_fluent("dnv", SI, d=[1.3e-3, 2e-3])
    assert (alone.exponent, alone.losses.misfit.shape) == (pytest.approx(2.6, abs=1e-9), (2, 1))
    assert erosion.to_fluent("dnv", P, v0="4400 in/s").exponent == pytest.approx(2.6, abs=1e-9)


def test_the_diameter_is_2_r_or_that_of_the_particles_density():
    assert particle_of("finnie", P).diameter == pytest.approx(2 * 0.04 * 0.0254)
    quartz = particle_of("finnie", SI, 2650.0)
    assert quartz.density == pytest.approx(2650.0)
    assert 2650.0 * math.pi / 6 * quartz.diameter**3 == pytest.approx(float(SI.m))
    # A density is in kg/m³, whatever units show the case.
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
            {"p": BACKWARD, "v0": ["1000 in/s", "2000 in/s"]},
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
        ({"d": "a"}, "Argument `d` must be a length such as \"1 mm\", but 'a' cannot be read."),
        ({"particle_density": 0.0}, "Argument `particle_density` must be positive and finite, but has 0."),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    for export in (erosion.to_openfoam, erosion.to_fluent):
        with pytest.raises(ValueError, match=message):
            export("finnie", SI, **arguments)


def test_a_table_has_the_volumes_of_similar_bodies():
    alpha, speeds, diameters = np.deg2rad([10.0, 35.0, 90.0]), [76.0, 112.0], [1e-3, 2e-3, 5e-3]
    table = erosion.volume_table("rotating", SI.replace(phidot0=1e4), alpha=alpha, v0=speeds, d=diameters)
    assert table.volume.dims == ("d", "v0", "alpha")
    assert table.volume.attrs["units"] == "m^3"
    # The case's particle is 2 r wide.
    s = np.array(diameters)[:, None, None] / (2 * 0.04 * 0.0254)
    size = 0.04 * 0.0254 * s
    copy = SI.replace(alpha=alpha, v0=np.array(speeds)[:, None], r=size, b=size, m=SI.m * s**3, phidot0=1e4)
    np.testing.assert_allclose(table.volume, erosion.impact("rotating", copy).volume, rtol=1e-8)


def test_the_csv_is_in_si_and_degrees_and_can_be_read_again():
    table = erosion.volume_table("finnie", P, alpha=np.deg2rad([20.0, 30.0]), v0=["4400 in/s"], d=["0.08 in"])
    rows = list(csv.DictReader(io.StringIO(to_csv(table))))
    assert list(rows[0]) == ["diameter [m]", "speed [m/s]", "angle [deg]", "volume [m^3]"]
    assert [float(row["angle [deg]"]) for row in rows] == pytest.approx([20.0, 30.0])
    assert float(rows[0]["speed [m/s]"]) == pytest.approx(111.76)
    exact = float(erosion.impact("finnie", SI.replace(alpha=np.deg2rad(30.0))).volume)
    assert float(rows[1]["volume [m^3]"]) == pytest.approx(exact, rel=1e-9)


def volumes_over(**axes):
    return erosion.volume_table("finnie", SI, **axes)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: volumes_over(alpha=[20.0]),
            ValueError,
            r"Argument `alpha` must be in \(0, 90°\], but has 1145.92°.",
        ),
        (lambda: volumes_over(alpha=[[0.1]]), ValueError, "Argument `alpha` must be a number or a list of them"),
        (lambda: volumes_over(v0=[np.nan]), ValueError, "Argument `v0` must be positive and finite, but has nan."),
        (
            lambda: volumes_over(d=np.ma.masked_less([1.0, 2.0], 1.5)),
            ValueError,
            "Argument `d` must have no masked values",
        ),
        (lambda: volumes_over(d=np.array([1e150])), erosion.SimulationError, "could not be computed"),
        (lambda: erosion.restitution("dnv", P), erosion.ExportError, "dnv has no motion of a rigid body"),
        (
            lambda: erosion.to_openfoam("finnie", SI.replace(v0=np.array([1.0, 2.0]))),
            ValueError,
            "`v0` must be a scalar",
        ),
        (lambda: erosion.to_openfoam("finnie"), TypeError, "Argument `p` must be Parameters, but is left out"),
    ],
)
def test_what_makes_no_table_or_form_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("table", [erosion.volume_table, erosion.restitution])
def test_a_table_of_too_many_rows_is_refused_before_it_is_computed(table):
    axes = {"alpha": np.linspace(0.1, 1.5, 2000), "v0": np.linspace(1.0, 100.0, 20_000)}
    with pytest.raises(ValueError, match=r"at most 1,000,000 rows, but makes \d*0,000,000\."):
        table("linearized", SI, **axes)


ALPHA = np.deg2rad([5.0, 15.0, 25.0, 40.0, 55.0, 70.0, 85.0])
SPEEDS = [55.88, 111.76]


SPEED = np.array(SPEEDS)[:, None]


def rebounds(model, p=SI):
    table = erosion.restitution(model, p, alpha=ALPHA, v0=SPEEDS)
    words = np.array(table.ended_by.attrs["flag_meanings"].split())[table.ended_by.values]
    return table, words


def test_a_body_that_does_not_turn_keeps_its_normal_speed_or_stops():
    table, words = rebounds("linearized", SI.replace(phidot0=300.0))
    rebound = np.broadcast_to(np.tan(ALPHA) <= 1, (2, 7))
    np.testing.assert_array_equal(words, np.where(rebound, "rebound", "stop"))
    # tan α ≤ k/2 = 1 rebounds: ẏ = -ẏ(0), and k (ẋ - ẋ(0)) = -2 ẏ(0). A stop ends with the velocity of that moment:
    # cos ωt = 1 - k cot α, so that the tip rises below 2 = k cot α, and sinks above.
    cosine = np.where(rebound, -1.0, 1 - 2 / np.tan(ALPHA))
    expected = {
        "e_n": np.maximum(-cosine, 0.0),
        "e_t": np.where(rebound, 1 - np.tan(ALPHA), 0.0),
        "vy": SPEED * np.sin(ALPHA) * cosine,
        "spin": np.full((2, 7), 300.0),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-9, atol=1e-10 * max(1.0, np.abs(values).max()))


@pytest.mark.parametrize("model", ["finnie", "rotating", "rotating-deformation"])
def test_momentum_is_balanced(model):
    table, _ = rebounds(model, SI.replace(phidot0=2e3))
    lost = table.vx.values - SPEED * np.cos(ALPHA)
    # Constant K: ẏ - ẏ(0) = K (ẋ - ẋ(0)); torque r F_x: φ̇ - φ̇0 = (ẋ - ẋ(0))/(β r).
    assert table.vy.values == pytest.approx(SPEED * np.sin(ALPHA) + 2.0 * lost, abs=1e-9 * 111.76)
    assert table.spin.values == pytest.approx(2e3 + lost / (0.5 * 0.04 * 0.0254), rel=1e-9)


@pytest.mark.parametrize("model", ["linearized", "rotating-full-torque"])
def test_the_energy_that_is_lost_is_the_work_of_cutting(model):
    table, words = rebounds(model)
    turning = float(P.moment_of_inertia) * table.spin.values**2 / 2
    lost = float(P.m) * (SPEED**2 - table.vx.values**2 - table.vy.values**2) / 2 - turning
    assert (lost >= 0).all()
    volume, rebound = erosion.impact(model, SI.replace(alpha=ALPHA, v0=SPEED)).volume, words == "rebound"
    assert rebound.sum() >= 4
    assert volume[rebound] == pytest.approx(lost[rebound] / float(P.sigma * P.psi), rel=1e-8)


def integrated(alpha: float, v0: float, p) -> tuple[np.ndarray, str]:
    """The end of `rotating-full-torque` by scipy: (ẋ, ẏ, φ̇), and which event."""
    k, r, m = float(p.k), float(p.r), float(p.m)
    c, inertia = float(p.sigma * p.b * p.psi), float(p.inertia) * m * r**2

    def depth(t, s):
        return s[1] - r * (1 - np.sin(s[2]))

    def along(t, s):
        return s[3] + r * np.sin(s[2]) * s[5]

    def rate(t, s):
        fx = -c * depth(t, s)
        return [*s[3:], fx / m, k * fx / m, r * (np.sin(s[2]) * fx + np.cos(s[2]) * k * fx) / inertia]

    for event in (depth, along):
        event.__dict__.update(terminal=True, direction=-1)
    start = [0.0, 0.0, np.pi / 2, v0 * np.cos(alpha), v0 * np.sin(alpha), float(p.phidot0)]
    ended = solve_ivp(rate, (0, 1e-2), start, "DOP853", events=(depth, along), rtol=1e-12, atol=1e-14, max_step=1e-7)
    which = int(ended.t_events[1].size > 0)
    return ended.y_events[which][0][3:], ("rebound", "stop")[which]


@pytest.mark.parametrize(("angle", "ended_by"), [(12.0, "rebound"), (50.0, "stop")])
def test_an_independent_integration_ends_with_the_same_velocities(angle, ended_by):
    p, alpha = SI.replace(phidot0=-1500.0, inertia=0.4), np.deg2rad(angle)
    row = erosion.restitution("rotating-full-torque", p, alpha=[alpha], v0=[111.76]).isel(v0=0, alpha=0)
    (vx, vy, spin), end = integrated(alpha, 111.76, p)
    assert row.ended_by.attrs["flag_meanings"].split()[int(row.ended_by)] == end == ended_by
    ratios = vx / (111.76 * np.cos(alpha)), max(0.0, -vy / (111.76 * np.sin(alpha)))
    given = [float(row[name]) for name in ("vx", "vy", "spin", "e_t", "e_n")]
    assert given == pytest.approx([vx, vy, spin, *ratios], rel=1e-8)


def test_what_cuts_nothing_has_no_rebound():
    table = erosion.restitution("linearized", P, alpha=[0.5, np.pi / 2])
    assert table.e_n.isnull().values.tolist() == [[False, True]] * 7
    assert "no-cut" in to_csv(table)
    # A spinning tip cuts at 90°: there is a spin after it, but no tangential velocity before.
    upright = erosion.restitution("rotating", P.replace(phidot0=2e4), alpha=[np.pi / 2])
    assert upright.e_t.isnull().all()
    assert upright.spin.notnull().all()
    assert upright.vx.notnull().all()
