"""Fits to data as laboratories have it: mg/kg, several speeds, few rows, particles that do not all cut."""

import numpy as np
import pytest

import erosion
from erosion.fits import Measurements, calibrate, rank_models, to_fluent, to_openfoam
from erosion.fits.doubts import advise, find_patterns, rounded
from erosion.fits.export import exported_case
from erosion.fits.forward import Forward
from erosion.fits.least_squares import make_problem
from erosion.fits.measurements import conditions
from erosion.models.closed_forms import LinearizedCut
from erosion.parameters.parameters import TABLE_1

pytestmark = pytest.mark.slow

# Grains of sand of 0.3 mm, of density 2650 kg/m³; the target's flow stress is that of steel at high strain rates.
SAND = erosion.Parameters(
    k=2.0, psi=2.0, r=0.15e-3, b=0.3e-3, m=2650 * np.pi / 6 * 0.3e-3**3, v0=60.0, sigma=1.5e9, alpha=0.35,
    inertia=0.4, units="si",
)  # fmt: skip
DENSITY = 7850.0
DEGREES = np.array([10, 15, 20, 25, 30, 35, 40, 45, 50, 60, 70, 80.0])
SPEEDS = (30.0, 60.0)
FRACTION = 0.3


def measured(noise: float = 0.03, p: erosion.Parameters = SAND, power: float = 0.0) -> dict[str, np.ndarray]:
    """Mass loss in mg/kg at two speeds, with errors of 3 % of the greatest at each speed.

    Args:
        noise: standard deviation over that greatest.
        p: the truth.
        power: of the speed, by which erosion grows more than the model says.
    """
    rng = np.random.default_rng(7)
    columns: dict[str, list[np.ndarray]] = {"angle [deg]": [], "speed [m/s]": [], "mass_loss [mg/kg]": [],
                                            "uncertainty [mg/kg]": []}  # fmt: skip
    for speed in SPEEDS:
        volume = LinearizedCut().volume(p.replace(alpha=np.deg2rad(DEGREES), v0=speed))
        loss = FRACTION * np.asarray(volume) * DENSITY / float(p.m) * 1e6 * (speed / SPEEDS[0]) ** power
        error = np.full(DEGREES.size, 0.03 * loss.max())
        row = (
            DEGREES,
            np.full(DEGREES.size, speed),
            loss + noise / 0.03 * error * rng.standard_normal(DEGREES.size),
            error,
        )
        for values, column in zip(row, columns.values(), strict=True):
            column.append(values)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def test_the_first_guess_comes_from_the_size_of_the_data():
    # Table 1 removes 300 times as much from a particle's mass as this data has.
    fit = calibrate("linearized", TABLE_1, measured(0.0), ["k", "psi"], density="7850 kg/m^3", starts=1)
    assert fit.warnings == ()
    assert fit.chi2 < 1e-6
    product = SAND.sigma * SAND.psi / FRACTION
    assert float(fit.p.to("si").sigma) * fit.estimates["psi"] == pytest.approx(float(product), rel=1e-5)


def test_a_guess_stays_within_given_bounds():
    bounds = {"psi": (0.01, 0.3)}
    fit = calibrate("linearized", TABLE_1, measured(), ["k", "psi"], density="7850 kg/m^3", starts=1, bounds=bounds)
    assert fit.estimates["psi"] == pytest.approx(0.3)


def test_the_share_of_particles_that_cut_is_found():
    fit = calibrate("linearized", SAND, measured(), ["k", "cutting_fraction"], density=DENSITY)
    assert fit.cutting_fraction == fit.estimates["cutting_fraction"]
    for name, truth in (("k", 2.0), ("cutting_fraction", FRACTION)):
        assert abs(fit.estimates[name] - truth) < 3 * fit.standard_errors[name] < 0.2 * truth
    assert [row.symbol for row in fit.rows()[:2]] == ["k", "c"]
    given = calibrate("linearized", SAND, measured(), ["k", "psi"], density=DENSITY, cutting_fraction=0.6)
    assert given.estimates["psi"] == pytest.approx(2.0 * 0.6 / fit.cutting_fraction, rel=1e-4)
    np.testing.assert_allclose(given.fitted, fit.fitted, rtol=1e-4)
    assert (given.cutting_fraction, given.to_dict()["cutting_fraction"]) == (0.6, 0.6)


def test_no_more_than_all_particles_cut():
    fit = calibrate("linearized", SAND.replace(sigma=1.5e10), measured(), ["k", "cutting_fraction"], density=DENSITY)
    assert fit.cutting_fraction == pytest.approx(1.0)
    for share in (0.0, 1.5):
        with pytest.raises(ValueError, match="`cutting_fraction` must be above 0 and at most 1, but is"):
            calibrate("linearized", SAND, measured(), ["k"], density=DENSITY, cutting_fraction=share)
    with pytest.raises(ValueError, match="`bounds` must give cutting_fraction two ascending values in its range"):
        calibrate("linearized", SAND, measured(), ["cutting_fraction"], density=DENSITY,
                  bounds={"cutting_fraction": (0.1, 2.0)})  # fmt: skip


def assert_derivatives(forward: Forward) -> None:
    """The derivatives of a prediction are those by differences, which err by step²/6 of the third derivative."""
    theta, steps, rows = forward.start, 1e-4 * np.eye(len(forward.names)), forward.data.conditions
    rates = forward.predict(theta, rows)[1]
    for step, rate in zip(steps, rates.T, strict=True):
        differences = (forward.predict(theta + step, rows)[0] - forward.predict(theta - step, rows)[0]) / 2e-4
        assert differences == pytest.approx(rate, rel=1e-6, abs=1e-8 * np.abs(rates).max())


@pytest.mark.parametrize("free", [("k", "cutting_fraction", "m"), ("cutting_fraction",)])
def test_derivatives_by_the_cutting_fraction(free):
    data = erosion.read_measurements(measured(), "si")
    assert_derivatives(Forward(erosion.load_model("linearized"), SAND.replace(k=1.9), free, data, DENSITY, 0.4))


def test_as_many_rows_as_parameters_are_too_few():
    data = {name: values[[2, 5]] for name, values in measured().items()}
    message = "must have at least 3 rows for 2 free parameters, as no degree of freedom is left otherwise, but has 2"
    with pytest.raises(ValueError, match=message):
        calibrate("linearized", SAND, data, ["k", "psi"], density=DENSITY)


def turning_data() -> dict[str, np.ndarray]:
    """The same with bodies that turn, whose ψ and share of cutting particles differ in little but the size."""
    columns = measured()
    p = SAND.replace(alpha=np.deg2rad(columns["angle [deg]"]), v0=columns["speed [m/s]"])
    loss = FRACTION * erosion.impact("rotating", p).volume * DENSITY / float(SAND.m) * 1e6
    noise = columns["uncertainty [mg/kg]"] * np.random.default_rng(7).standard_normal(loss.size)
    return columns | {"mass_loss [mg/kg]": loss + noise}


def test_what_the_data_do_not_decide_is_said():
    fit = calibrate("rotating", SAND, turning_data(), ["k", "psi", "cutting_fraction"], density=DENSITY)
    assert fit.undecided == ("psi", "cutting_fraction")
    assert fit.warnings[0].startswith("The data do not decide between psi and cutting_fraction: fix one of them")
    assert not any("psi is known" in said for said in fit.warnings)
    rows = {row.name: row for row in fit.rows()}
    assert rows["k"].meaning.startswith("95%: ")
    for name in fit.undecided:
        assert "±" not in rows[name].value
        assert rows[name].meaning.startswith("not decided by these data; 95%: ")
    # With one of them fixed, all is decided.
    assert calibrate("rotating", SAND, turning_data(), ["k", "psi"], density=DENSITY).undecided == ()


def test_no_place_is_advised_for_a_product():
    fit = calibrate("linearized", SAND, measured(), ["k", "sigma", "cutting_fraction"], density=DENSITY)
    assert fit.warnings == (
        "sigma and cutting_fraction cannot be told apart: only sigma/cutting_fraction is determined. Fix one of them.",
    )
    assert fit.rows()[1].value == f"{fit.estimates['sigma'] / 1e9:.4g}"


def test_a_place_to_measure_is_one_where_the_parameter_acts():
    # All rows are steeper than the cusp at tan α = k/2, where k has no influence; at shallow angles it has.
    columns = {name: values[DEGREES.size + 8 :] for name, values in measured().items()}
    fit = calibrate("linearized", SAND, columns, ["k", "psi"], density=DENSITY)
    said = fit.warnings[0]
    assert said.startswith(("k has no influence on these data", "The data do not decide k: fix it, or measure at "))
    assert float(said.split("measure at ")[1].split("°")[0]) < columns["angle [deg]"].min()


def test_bounds_that_are_touched_are_marked():
    bounds = {"k": (1.99, 2.5), "cutting_fraction": (0.2, 0.25)}
    fit = calibrate("linearized", SAND, measured(), ["k", "cutting_fraction"], density=DENSITY, bounds=bounds)
    assert {name: pytest.approx(pair) for name, pair in fit.bounds.items()} == bounds
    touched = fit.bounds_touched()
    assert touched["cutting_fraction"] == ("estimate at upper", "interval at upper")
    numbers = fit.to_dict()
    mark = {"parameter": "cutting_fraction", "touches": ["estimate at upper", "interval at upper"]}
    assert mark in numbers["bounds_touched"]
    assert numbers["bounds"]["cutting_fraction"] == pytest.approx([0.2, 0.25])
    row = next(row for row in fit.rows() if row.name == "cutting_fraction")
    assert row.value == "0.25"
    assert row.meaning.startswith("at its upper bound; 95%, if the model were right: 0.24")
    assert row.meaning.endswith(" … 0.25000 (upper bound)")
    near = calibrate("linearized", SAND, measured(), ["k", "psi"], density=DENSITY, bounds={"k": (1.9, 1.99)})
    (end,) = [said for said in near.warnings if said.startswith("The interval of k ends at")] or [""]
    assert near.bounds_touched()["k"][0].startswith(("interval", "estimate"))
    assert "bound" in end or any("k is at its" in said for said in near.warnings)


def test_numbers_of_a_fit_for_programs():
    fit = calibrate("linearized", SAND, measured(), ["k", "psi"], density=DENSITY)
    numbers = fit.to_dict()
    assert numbers["chi2"] == fit.chi2
    assert numbers["degrees_of_freedom"] == 22
    assert numbers["rms"] == pytest.approx(np.sqrt(np.mean(fit.residuals**2)))
    assert numbers["residuals"] == fit.residuals.tolist()
    assert [(test["over"], test["seen"]) for test in numbers["patterns"]] == [("angle", False), ("speed", False)]
    assert fit.warnings == ()


def test_residuals_over_the_angle_with_a_pattern_are_said():
    # Finnie's K = tan α has another shape at shallow angles.
    fit = calibrate("tan-alpha", SAND, measured(), ["psi"], density=DENSITY)
    (pattern,) = [test for test in fit.patterns if test.seen and test.over == "angle"]
    assert pattern.probability < 0.01
    assert pattern.statistic < -2
    assert pattern.sentence.startswith("The residuals show a pattern over the angle: ")
    assert pattern.sentence in fit.warnings
    assert pattern.sentence in str(fit)


def test_residuals_over_the_speed_with_a_pattern_are_said():
    # Erosion with the exponent 2.6 of speed, as many tests find, where every model here has 2.
    fit = calibrate("linearized", SAND, measured(power=0.6), ["k", "psi"], density=DENSITY)
    (pattern,) = [test for test in fit.patterns if test.seen and test.over == "speed"]
    assert pattern.statistic > 0.5
    assert pattern.sentence.startswith("The residuals rise with the speed (correlation of ranks 0.")
    assert pattern.sentence.endswith("the data grow more with the speed than the fit.")
    assert pattern.sentence in fit.warnings


def test_runs_are_counted_as_in_the_textbook():
    # Mood, Graybill and Boes: n₁ = n₂ = 10 has the mean 11 and the variance 90/19 of the number of runs.
    angle = np.linspace(0.1, 1.5, 20)
    data = Measurements(angle, np.ones(20), "volume", None, None, None, "si", "x")
    residuals = np.where(np.arange(20) % 20 < 10, 1.0, -1.0)
    (pattern,) = find_patterns(data, residuals, conditions(data))
    assert pattern.statistic == pytest.approx((2 - 11) / np.sqrt(90 / 19))
    assert pattern.seen
    (noise,) = find_patterns(data, np.tile([1.0, 1, -1, -1], 5), conditions(data))
    assert not noise.seen
    # All above: a fair coin makes 1 + 19/2 runs, with the variance 19/4.
    (above,) = find_patterns(data, np.ones(20), conditions(data))
    assert above.statistic == pytest.approx(-9.5 / np.sqrt(19 / 4))
    assert "1 run of one sign" in above.sentence
    assert find_patterns(data, np.zeros(20), conditions(data)) == ()


@pytest.mark.parametrize(
    ("value", "size", "least", "text"),
    [
        (1.91723, 0.0978, 1, "1.917"),
        (0.0978, 0.0978, 1, "0.098"),
        (1964.56, 2900.0, 1, "2000"),
        (0.067791, 7.2, 2, "0.068"),
        (-3725.84, 11500.0, 2, "-3700"),
        (1.78566e10, np.inf, 1, "1.786e+10"),
        (2.765e9, 3.1e7, 1, "2.765e+09"),
        (0.0, 1.0, 1, "0"),
    ],
)
def test_digits_end_with_the_error(value, size, least, text):
    assert rounded(value, size, least) == text


def test_rows_of_one_speed_and_mass_are_a_group():
    speed, mass = np.repeat([30.0, 60.0], 4), np.tile([1e-8, 4e-8], 4)
    data = Measurements(np.full(8, 0.5), np.ones(8), "volume", None, speed, mass, "si", "x")
    groups = conditions(data)
    assert [group.label for group in groups[:2]] == ["v₀ = 30 m/s, m = 10 µg", "v₀ = 30 m/s, m = 40 µg"]
    assert [group.values for group in groups] == [{"v0": v, "m": m} for v in (30.0, 60.0) for m in (1e-8, 4e-8)]
    assert sorted(int(row) for group in groups for row in group.rows) == list(range(8))
    many = Measurements(np.full(50, 0.5), np.ones(50), "volume", None, np.linspace(30, 60, 50), None, "si", "x")
    assert [len(group.rows) for group in conditions(many, 5)] == [10] * 5
    # Rows of one speed stay together.
    speeds = Measurements(
        np.full(24, 0.5), np.ones(24), "volume", None, np.repeat(np.arange(30.0, 38), 3), None, "si", ""
    )
    assert [len(group.rows) for group in conditions(speeds, 4)] == [6] * 4
    assert conditions(many, 5)[0].label.startswith("v₀ ≈ 3")
    assert conditions(Measurements(speed, speed, "volume", None, None, None, "si", "x"))[0].label == ""


def test_exports_are_at_a_speed_of_the_data():
    # The case is at 110 m/s, at which nothing was measured.
    fit = calibrate("linearized", SAND.replace(v0=110.0), measured(), ["k", "cutting_fraction"], density=DENSITY)
    for export, energy in ((to_openfoam(fit), None), (to_fluent(fit), float(SAND.m) * 60.0**2)):
        text = export.text()
        assert ", at v0 = 60 m/s\n" in text
        assert "This speed is one of the data's.\n" in text
        # Without rotation V grows as v₀².
        assert "At v₀ = 30 m/s the volume over m V^2 differs from it by up to 0.00% of its maximum." in text
        assert f"The cutting fraction {fit.cutting_fraction:.4g} is part of what is written here." in text
        if energy is not None:
            greatest = fit.curve(np.arctan(fit.estimates["k"]) / 2, {"v0": 60.0})[0] * float(SAND.m) / DENSITY
            assert getattr(export, "factor") == pytest.approx(float(greatest) / energy, rel=1e-4)  # noqa: B009
    # A speed of the case that the data has is kept.
    assert (
        float(exported_case(calibrate("linearized", SAND.replace(v0=30.0), measured(), ["k"], density=DENSITY)).v0)
        == 30
    )


def test_models_that_fit_as_well_are_said_to():
    # Sand turns little before it leaves: with and without rotation, the curves are nearly alike.
    ranking = rank_models(SAND, turning_data(), ["k", "psi"], models=["rotating", "linearized", "finnie"],
                          density=DENSITY)  # fmt: skip
    assert ranking.ties == (("linearized", "finnie"),)
    first, second = ranking.warnings[:2]
    assert first == "linearized and finnie give the same curve: these data cannot tell them apart."
    assert second.startswith("The data do not decide between ")
    assert "rotating" in second
    assert ranking.to_dict()["warnings"][:2] == [first, second]
    apart = rank_models(SAND, measured(), ["psi"], models=["linearized", "tan-alpha"], density=DENSITY)
    assert not any("do not decide" in said for said in apart.warnings)


def test_a_ranking_marks_bounds():
    ranking = rank_models(SAND, measured(), ["k", "psi"], models=["linearized"], density=DENSITY,
                          bounds={"psi": (0.01, 0.3)}, starts=1)  # fmt: skip
    assert "psi = 0.3 (at its upper bound)" in ranking.rows()[0][-1]


def test_the_growth_with_speed_is_said_with_its_exponent():
    fit = calibrate("linearized", SAND, measured(power=0.3), ["k", "cutting_fraction"], density=DENSITY, starts=2)
    said = next(said for said in fit.warnings if said.startswith("Fit each speed alone: the model removes as v₀^2, "))
    # Errors of 3 % in 12 rows of each speed.
    assert float(said.rstrip(".").rsplit("^", 1)[1]) == pytest.approx(2.3, abs=0.05)


def test_errors_of_a_fit_that_is_wrong_are_marked():
    ranking = rank_models(SAND, measured(power=0.6), ["psi"], models=["linearized", "tan-alpha"], density=DENSITY)
    assert ranking.warnings[0].startswith("None of the models fits within the uncertainties: χ²/dof is ")
    best = ranking.best
    assert "95%, if the model were right: " in best.rows()[0].meaning
    assert any("hold only if the model were right" in said for said in best.warnings)
    assert ranking.headings[3] == "χ²/dof"
    shown = [float(row[3]) for row in ranking.rows()]
    assert shown == pytest.approx([fit.chi2 / fit.degrees_of_freedom for fit in ranking.fits], rel=5e-3)
    right = rank_models(SAND, measured(), ["psi"], models=["linearized", "tan-alpha"], density=DENSITY)
    assert not any("None of the models" in said for said in right.warnings)
    assert "if the model" not in right.best.rows()[0].meaning
    alone = {name: column for name, column in measured().items() if "uncertainty" not in name}
    assert rank_models(SAND, alone, ["psi"], models=["linearized"], density=DENSITY).headings[3] == "rms [mg/kg]"


def test_no_row_is_advised_that_the_data_has():
    every = np.deg2rad(np.arange(5.0, 90.0, 5.0))
    speeds = np.repeat(SPEEDS, every.size)
    columns = {"angle [rad]": np.tile(every, 2), "speed [m/s]": speeds, "volume [mm^3]": np.ones(speeds.size)}
    forward = Forward(erosion.load_model("linearized"), SAND, ("k",), erosion.read_measurements(columns, "si"), None)
    problem = make_problem(forward, forward.data, {})
    said = advise(problem, ["k"], np.log([[0.5], [4.0]]), 0.03)
    assert said.startswith("Fix it, or measure at ")
    assert said.endswith(("v₀ = 15 m/s.", "v₀ = 120 m/s."))
