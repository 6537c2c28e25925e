"""Fits to synthetic data: the truth is found, and what cannot be found is said.

Draws of what a fit leaves open, against closed forms.

Rows far from a fit: found by a closed form, named with their line, and what the fit is without them.
"""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
from scipy import stats

import erosion
from erosion import TABLE_1, SamplingError
from erosion.advice.advise import _uncertain
from erosion.fits import Calibration, CalibrationError, calibrate, to_fluent, to_openfoam
from erosion.fits.export import to_case
from erosion.fits.least_squares import identify
from erosion.fits.outliers import studentized
from erosion.models.rigid import LinearizedCut
from tests.fits.problems import calibrated, ranked
from tests.models.test_own_parameters import P as PULLED

SI = TABLE_1.to("si")

GUESS = SI.replace(k=3.0, psi=0.06)
DEGREES = np.linspace(5.0, 88.0, 50)


def exact(degrees: np.ndarray = DEGREES, **changes) -> np.ndarray:
    return np.asarray(LinearizedCut().volume(SI.replace(alpha=np.deg2rad(degrees), **changes)))


EXACT = exact()
NOISE = 0.03 * EXACT.max()


def synthetic(seed: int, volume: np.ndarray = EXACT) -> dict[str, np.ndarray]:
    """Table 1 measured with errors of 3 % of the greatest volume."""
    error = np.full(volume.size, 0.03 * volume.max())
    noisy = volume + error * np.random.default_rng(seed).standard_normal(volume.size)
    return {"angle [deg]": DEGREES, "volume [m^3/impact]": noisy, "uncertainty [m^3]": error}


def without_errors(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: values for name, values in columns.items() if "uncertainty" not in name}


def fitted(free=("k", "psi"), data=None, model: Any = "linearized", **options) -> Calibration:
    data = synthetic(1) if data is None else data
    return calibrated(model, GUESS, data, list(free), **{"starts": 1, **options})


@pytest.fixture(scope="module")
def fit():
    return fitted(starts=8)


def test_exact_data_give_the_truth_back():
    result = fitted(data=synthetic(0) | {"volume [m^3/impact]": EXACT}, starts=4)
    # The kernel keeps nine digits.
    assert result.estimates == pytest.approx({"k": 2.0, "psi": 0.04}, rel=1e-7)
    assert result.chi2 < 1e-9
    assert result.warnings == ()
    numbers = result.to_dict()
    assert numbers["parameters"]["k"] == result.p.k == result.estimates["k"]
    assert numbers["intervals"] == {name: list(interval) for name, interval in result.intervals().items()}


def test_errors_are_those_of_the_normal_equations(fit):
    best = fit.estimates
    slopes = [(exact(**{**best, name: 1.0001 * best[name]}) - exact(**{**best, name: 0.9999 * best[name]}))
              / (2e-4 * best[name] * NOISE) for name in best]  # fmt: skip
    covariance = np.linalg.inv(np.array(slopes) @ np.array(slopes).T)
    errors = np.sqrt(np.diag(covariance))
    # Central differences of 1e-4, across the cusp for some.
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-3)
    np.testing.assert_allclose(list(fit.standard_errors.values()), errors, rtol=1e-3)
    np.testing.assert_allclose(fit.correlation, covariance / np.outer(errors, errors), rtol=1e-3)
    np.testing.assert_allclose(fit.residuals, synthetic(1)["volume [m^3/impact]"] - exact(**best), atol=1e-6 * NOISE)
    assert fit.chi2 == pytest.approx(np.sum((fit.residuals / NOISE) ** 2))
    assert (fit.degrees_of_freedom, fit.aicc) == (48, pytest.approx(fit.chi2 + 4 + 12 / 47))


def test_an_interval_ends_where_the_misfit_has_risen(fit):
    measured = synthetic(1)["volume [m^3/impact]"]

    def rise(k: float) -> float:
        # V is proportional to 1/ψ, whose best value for this k is a quotient.
        shape = exact(k=k)
        best = (shape @ measured) / (shape @ shape)
        return float(np.sum((best * shape - measured) ** 2)) / NOISE**2 - fit.chi2

    for level, quantile in ((0.95, 1.959964), (0.5, 0.674490)):
        for end in fit.intervals(level)["k"]:
            # To 2 % of the half width, and the minimum to 2 % of the rise.
            assert np.sqrt(rise(end)) == pytest.approx(quantile, rel=0.04)
    low, high = fit.intervals()["k"]
    assert low < fit.estimates["k"] < high
    profile, error = fit.profile("k", 9), fit.standard_errors["k"] / fit.estimates["k"]
    # Nearly linear: errors of 2 % bend the parabola by some percents; each point is found to 0.02.
    parabola = (np.log(profile.values / fit.estimates["k"]) / error) ** 2
    np.testing.assert_allclose(profile.rise, parabola, rtol=0.12, atol=0.02)


def test_left_out_errors_are_those_of_fits_without_the_row(fit):
    data, alone = synthetic(1), []
    for row in range(0, 50, 14):
        other = fitted(data={name: np.delete(values, row) for name, values in data.items()})
        alone.append(data["volume [m^3/impact]"][row] - other.curve(np.deg2rad(DEGREES[row]))[0])
    leverage = np.sum((fit.solution.jacobian @ fit.identifiability.modes) ** 2, axis=1)
    # To first order in the noise of 3 %.
    np.testing.assert_allclose(alone, (fit.residuals / (1 - leverage))[::14], atol=0.02 * NOISE)
    assert fit.rms < fit.leave_one_out < 1.1 * fit.rms


def test_noise_is_estimated_where_none_is_given(fit):
    data = without_errors(synthetic(1))
    result = fitted(data=data)
    assert result.estimates == pytest.approx(fit.estimates, rel=1e-6)
    spread = np.sqrt(np.sum(result.residuals**2) / 48)
    assert result.standard_errors["k"] == pytest.approx(fit.standard_errors["k"] * spread / NOISE, rel=1e-5)
    # Student's t is wider than the normal distribution: by half at 5 degrees of freedom.
    small = fitted(data={name: values[:35:5] for name, values in data.items()})
    low, high = small.intervals()["psi"]
    error = small.standard_errors["psi"] / small.estimates["psi"]
    assert np.log(high / low) / (2 * error) == pytest.approx(2.571, rel=0.1)


def test_what_cannot_be_told_apart_and_what_has_no_influence_is_said(fit):
    result = fitted(["k", "psi", "sigma", "r"])
    told = [(finding.code, finding.about, dict(finding.numbers)) for finding in result.findings]
    assert told == [
        ("parameter_has_no_influence", "r", {}),
        ("fix_parameter", "r", {"parameters": ["r"]}),
        ("parameters_are_tied", "psi, sigma", {"parameters": ["psi", "sigma"], "determined": ["psi·sigma"]}),
        ("fix_parameter", "psi, sigma", {"parameters": ["psi", "sigma"]}),
    ]
    assert result.undetermined == ("psi", "sigma", "r")
    assert {result.standard_errors[name] for name in result.undetermined} == {np.inf}
    assert result.intervals()["psi"] == (0.0, np.inf)
    assert result.estimates["psi"] * result.estimates["sigma"] == pytest.approx(
        fit.estimates["psi"] * float(GUESS.sigma), rel=1e-6
    )
    assert result.estimates["k"] == pytest.approx(fit.estimates["k"], rel=1e-6)
    np.testing.assert_allclose(result.profile("sigma", 3).rise, 0, atol=1e-3)
    assert "not determined" in result._repr_html_()
    # The curve and its band do not depend on how the product is shared out.
    np.testing.assert_allclose(result.curve(0.5), fit.curve(0.5), rtol=1e-5)
    assert result.leave_one_out == pytest.approx(fit.leave_one_out, rel=1e-5)


def test_combinations_are_named_as_products_of_powers():
    shape, height, spin = np.random.default_rng(0).standard_normal((3, 20))
    names = ["k", "m", "sigma", "v0", "phidot0", "r"]
    columns = np.array([shape, height, -height, 2 * height, 0.3 * spin, 0.3 * spin])
    result = identify(names, columns.T, np.ones(6), 1.0)
    assert result.rank == 3
    ties = [(group.names, group.determined) for group in result.groups]
    assert ties == [(("m", "sigma", "v0"), ("m·v0^2/sigma",)), (("phidot0", "r"), ("phidot0·r",))]
    assert result.undetermined == ("m", "sigma", "v0", "phidot0", "r")
    # θ = φ̇₀ r₀/v₀ is not a logarithm: at half the size, its column is twice as strong.
    columns[4] *= 2
    again = identify(names, columns.T, np.array([1, 1, 1, 1, 0.5, 1]), 1.0)
    assert [(group.names, group.determined) for group in again.groups] == ties
    root = identify(["m", "b"], np.stack([shape, -shape / 2], axis=1), np.ones(2), 1.0)
    assert [group.determined for group in root.groups] == [("m/b^(1/2)",)]


def test_bounds_are_texts_with_units_beside_a_case_in_inches(fit):
    inches = erosion.FitProblem("linearized", TABLE_1, fit.data, ["sigma"], bounds={"sigma": ["1 GPa", "2e5 lbf/in^2"]})
    assert inches.bounds == {"sigma": pytest.approx((1e9, 2e5 * 4.4482216152605 / 0.0254**2), rel=1e-15)}
    assert dataclasses.replace(inches, free=("sigma", "psi")).bounds == inches.bounds


def test_conditions_are_texts_with_units_beside_a_case_in_inches(fit):
    in_inches = dataclasses.replace(fit.problem, p=fit.p.to("inch-pound"))
    of_texts = in_inches.conditions("20 deg", {"v0": ["2000 in/s", "100 m/s"]})
    in_si = fit.problem.conditions(np.deg2rad(20), {"v0": [50.8, 100.0]})
    for name in ("alpha", "v0"):
        np.testing.assert_allclose(of_texts[name], in_si[name], rtol=1e-15)


def test_bounds_are_kept_and_said(fit):
    result = fitted(bounds={"k": (1.99, 2.02)})
    assert result.intervals()["k"] == pytest.approx((1.99, 2.02))
    # With k so nearly known, ψ is known better.
    assert np.ptp(result.intervals()["psi"]) < 0.9 * np.ptp(fit.intervals()["psi"])
    off = fitted(bounds={"k": (2.5, 4.0)})
    assert off.estimates["k"] == pytest.approx(2.5, rel=1e-6)
    at_bound, narrow, misfit = off.findings[:3]
    assert (at_bound.code, at_bound.about) == ("estimate_at_bound", "k")
    assert at_bound.numbers == {"side": "lower", "bound": "2.5"}
    assert (narrow.code, narrow.about) == ("error_too_great", "psi")
    assert (misfit.code, misfit.numbers["chi2"]) == ("misfit_beyond_errors", off.chi2)


@pytest.mark.parametrize(
    ("unit", "name", "factor", "density"),
    [
        ("[in^3/lb]", "volume", 0.45359237 / 0.0254**3 / float(GUESS.m), None),
        ("[kg/impact]", "mass_loss", 2700.0, 2700.0),
        ("[kg/kg]", "mass_loss", 2700.0 / float(GUESS.m), "2.7 g/cm^3"),
    ],
)
def test_other_kinds_of_erosion_give_the_same_answer(fit, unit, name, factor, density):
    columns = {
        f"{name} {unit}": synthetic(1)["volume [m^3/impact]"] * factor,
        f"uncertainty {unit}": np.full(50, NOISE * factor),
    }
    result = fitted(data={"angle [deg]": DEGREES, **columns}, density=density)
    assert result.estimates == pytest.approx(fit.estimates, rel=1e-6)
    assert result.standard_errors == pytest.approx(fit.standard_errors, rel=1e-6)


def test_a_free_scale_leaves_the_shape(fit):
    table = {"angle [deg]": DEGREES, "erosion [-]": synthetic(1)["volume [m^3/impact]"] * 1e5}
    result = fitted(["k"], table, starts=2)
    # The scale takes up the guess's wrong ψ.
    expected = {"k": fit.estimates["k"], "scale": 1e5 * 0.06 / fit.estimates["psi"]}
    assert result.estimates == pytest.approx(expected, rel=1e-5)
    tied = fitted(["k", "psi"], table)
    assert [finding.code for finding in tied.findings] == ["parameters_are_tied", "fix_parameter"]
    assert tied.findings[0].about == "psi, scale"
    assert tied.findings[0].numbers == {"parameters": ["psi", "scale"], "determined": ["psi/scale"]}


def test_speed_and_mass_by_row():
    speed, mass = np.linspace(75, 150, 50), np.geomspace(2e-5, 2e-4, 50)
    table = {"angle [deg]": DEGREES, "volume [m^3/impact]": exact(v0=speed, m=mass),
             "speed [m/s]": speed, "mass [kg]": mass}  # fmt: skip
    assert fitted(data=table).estimates == pytest.approx({"k": 2.0, "psi": 0.04}, rel=1e-7)
    with pytest.raises(ValueError, match="must not name `v0`: the data has a column of it"):
        fitted(["v0"], table)


ANGLES = {"angle [deg]": [20, 30, 40]}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"free": []}, "`free` must name one or several different parameters"),
        ({"free": ["k", "k"]}, "`free` must name one or several different parameters"),
        ({"free": ["nu"]}, r"`free` must name parameters \(k, psi"),
        ({"free": ["alpha"]}, "`free` must not name `alpha`: the data has a column of it"),
        ({"loss": "square"}, "`loss` must be one of linear, soft_l1"),
        ({"starts": 0}, "`starts` must be a whole number of at least 1"),
        ({"bounds": {"r": (1.0, 2.0)}}, "`bounds` must name free parameters, but has 'r'"),
        ({"bounds": {"k": (2.0, 1.0)}}, "`bounds` must give k two ascending values"),
        ({"bounds": {"k": [-1.0, 1.0]}}, "`bounds` must give k two ascending values"),
        ({"p": GUESS.replace(k=[1.0, 2.0])}, r"`k` must be a scalar here, but has shape \(2,\)"),
        ({"density": -1.0}, "`density` must be positive and finite, but is -1"),
        ({"density": "3 kg"}, "`density` must be a density such as"),
        ({"data": {**ANGLES, "mass_loss [mg/impact]": [1, 2, 3]}}, "`density` of the target must be given"),
        (
            {"data": {"angle [deg]": [20, 30], "volume [mm^3/impact]": [1, 2]}},
            "must have at least 3 rows for 2 free parameters",
        ),
        ({"data": {**ANGLES, "volume [mm^3/impact]": [0, 0, 0]}}, "must have erosion other than zero"),
        ({"data": {**ANGLES, "volume [mm^3/impact]": [1e300] * 3}}, "must have erosion that a metal can have"),
        ({"data": {**ANGLES, "volume [mm^3/impact]": [1e-300] * 3}}, "must have erosion that a metal can"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(ValueError, match=message):
        calibrated("linearized", **{"p": GUESS, "free": ["k", "psi"], "data": synthetic(0), **options})


class Unfittable(erosion.models.Linearized):
    """A model whose impacts all fail."""

    def removal_rate(self, state, p):
        return super().removal_rate(state, p) * np.nan


def test_a_model_that_fails_is_said_to_fail():
    with pytest.raises(CalibrationError, match="its impacts failed for every start"):
        fitted(["k"], model=Unfittable(), starts=2)
    told = []
    models = [Unfittable(), "linearized"]
    problems = erosion.FitProblem.of_models(models, GUESS, synthetic(0), ["k"])
    fits, failures = erosion.fit_each(problems, lambda problem, _: calibrate(problem), lambda *call: told.append(call))
    ranking = erosion.rank(fits, failures)
    assert told == [("fitting Unfittable", 0, 2), ("fitting linearized", 1, 2)]
    assert ranking.names == ("linearized",)
    assert (ranking.failures[0].code, ranking.failures[0].about) == ("model_failed", "Unfittable")


@pytest.fixture(scope="module")
def turning() -> np.ndarray:
    # With the derivatives of the fits, so that one compiled program serves all.
    p = SI.replace(alpha=np.deg2rad(DEGREES))
    return np.asarray(erosion.impact("rotating", p, derivatives=1, wrt=("k", "psi")).volume)


def test_intervals_end_at_cliffs(turning):
    # Two sets in which the jump of V(α) comes upon a row within the standard error of k.
    k, psi = np.meshgrid(2.0 * np.linspace(0.87, 1.13, 105), 0.04 * np.linspace(0.94, 1.06, 73), indexing="ij")
    k, psi = k.ravel(), psi.ravel()
    case = SI.replace(alpha=np.deg2rad(DEGREES), k=k[:, None], psi=psi[:, None])
    volume = np.asarray(erosion.impact("rotating", case, derivatives=1, wrt=("k", "psi")).volume)
    for seed in (0, 1):
        data = synthetic(seed, turning)
        result = fitted(data=data, model="rotating", starts=32)
        misfit = np.sum(((volume - data["volume [m^3/impact]"]) / data["uncertainty [m^3]"]) ** 2, axis=1)
        assert result.chi2 < misfit.min() + 0.05
        inside = k[misfit - result.chi2 < 1.959964**2]
        # As near as the grid is.
        assert result.intervals()["k"] == pytest.approx((inside.min(), inside.max()), abs=0.01)


def test_a_curve_with_a_jump_is_found_from_afar_and_goes_to_openfoam_with_its_misfit(turning):
    # V(α) of `rotating` jumps at 42.9°, and the misfit jumps as k moves that across a row.
    data = synthetic(5, turning)
    result = fitted(data=data, model="rotating", starts=8)
    for name, truth in (("k", 2.0), ("psi", 0.04)):
        assert abs(result.estimates[name] - truth) < 3 * result.standard_errors[name]
    # Here the jump comes upon a row 0.6 standard errors below k.
    turned, finding = result.findings
    assert turned.code == "turned_beyond_in_part"
    assert (finding.code, finding.about) == ("error_too_great", "k")
    coefficients = to_openfoam(result)
    # The turning body's curve is broader than Finnie's and jumps.
    assert 0.05 < coefficients.misfit < 0.12
    assert f"by up to {coefficients.misfit:.2%} of its maximum" in coefficients.text()


def test_a_ranking_has_the_right_model_first_and_says_what_is_the_same_and_what_is_open(turning):
    data = synthetic(6, turning)
    names = ["linearized", "finnie", "rotating", "tan-alpha", "velocity-aligned"]
    ranking = ranked(names, GUESS, data, ["k", "psi"], starts=4)
    assert ranking.names[0] == "rotating"
    assert ranking.weights.sum() == pytest.approx(1)
    assert ranking.weights[0] > 0.99
    # With 3k for k and a third of ψ, Finnie's curve is the linearized one.
    assert ranking.tied_with("finnie") == ("linearized",)
    fits = dict(zip(ranking.names, ranking.fits, strict=True))
    other = fits["linearized"].estimates
    assert fits["finnie"].estimates == pytest.approx({"k": 3 * other["k"], "psi": other["psi"] / 3}, rel=1e-4)
    tied = [finding.numbers["models"] for finding in ranking.findings if finding.code == "same_curve"]
    assert tied == [["linearized", "finnie"], ["tan-alpha", "velocity-aligned"]]
    estimates = {row[0]: row[-1] for row in ranking.rows()}
    assert estimates["finnie"].endswith("(curve of linearized)")
    assert re.fullmatch(r"psi = [\d.]+, k not determined", estimates["tan-alpha"])
    assert estimates["velocity-aligned"] == "same as tan-alpha"
    assert "<th>left out [mm³]</th>" in ranking._repr_html_()


def test_a_fit_goes_to_cfd_codes_as_its_model_and_case_do(fit):
    for export in (to_openfoam, to_fluent):
        own, of_case = export(fit).text(), export(fit.model, fit.p).text()
        assert re.sub(r"(//|#).*\n", "", own) == re.sub(r"(//|#).*\n", "", of_case)
        assert "linearized, fitted to 50 rows of data" in own
        with pytest.raises(ValueError, match="`p` must be left out for a calibration, which has a case of its own"):
            export(fit, fit.p)


TO_60 = np.arange(10.0, 70.0, 10.0)


def fit_of_size(uncertainty: float | None) -> erosion.Calibration:
    """A fit of ψ alone: the curve is proportional to 1/ψ, so that for small errors θ = ln ψ is a linear parameter."""
    exact = np.asarray(erosion.impact("linearized", PULLED.replace(alpha=np.deg2rad(TO_60))).volume)
    size = 0.01 * exact.mean()
    rows = {"angle [deg]": TO_60, "volume [m^3/impact]": exact + size * np.array([1, -1, 0.5, 1, -1.5, 0.3])}
    if uncertainty is not None:
        rows["uncertainty [m^3]"] = np.full(TO_60.size, uncertainty * size)
    return erosion.calibrate(erosion.FitProblem("linearized", PULLED, rows, free=["psi"]), starts=1)


@pytest.mark.parametrize("uncertainty", [1.0, 3.0])
def test_samples_have_the_law_of_the_errors_of_a_linear_parameter(uncertainty):
    fit = fit_of_size(uncertainty)
    drawn = np.log(fit.samples["psi"].values.ravel() / fit.estimates["psi"])
    scores = drawn / np.sqrt(fit.covariance_of_theta[0, 0])
    # Kolmogorov and Smirnov's distance of 600 draws exceeds 0.08 once in a thousand times.
    assert stats.kstest(scores, stats.norm.cdf).statistic < 0.08


def test_samples_without_known_errors_are_as_wide_as_intervals():
    fit = fit_of_size(None)
    low, high = np.log(np.quantile(fit.samples["psi"], [0.025, 0.975]) / fit.estimates["psi"])
    below, above = np.log(np.array(fit.intervals()["psi"]) / fit.estimates["psi"])
    np.testing.assert_allclose([low, high], [below, above], rtol=0.35)


STEEL = erosion.TABLE_1.to("si").with_particle("garnet 80 mesh").with_target("mild steel").replace(v0=160.0)
SIX = np.arange(15.0, 91.0, 15.0)


def of_steel(losses: np.ndarray, loss: str = "linear") -> erosion.Calibration:
    rows = {"angle [deg]": SIX, "mass_loss [mg/kg]": losses}
    free = ["k", "psi", "energy_ratio"]
    return erosion.calibrate(
        erosion.FitProblem("linearized-deformation", STEEL, rows, free=free, density="7850 kg/m^3"), loss=loss, starts=4
    )


def test_residuals_are_in_the_unit_of_the_table():
    rows = {"angle [deg]": SIX, "erosion [g/kg]": np.array([1.27, 1.55, 1.95, 2.08, 1.45, 1.4])}
    fit = erosion.calibrate(
        erosion.FitProblem("linearized-deformation", STEEL, rows, ["psi"], density="7850 kg/m^3"), starts=1
    )
    units = {row[0]: row[3] for row in fit.rows()}
    assert units["rms"] == units["leave_one_out"] == "g/kg"


def amounts(fit: erosion.Calibration) -> np.ndarray:
    """The mean erosion of the rows by each draw, over that of the fit."""
    columns = {name: fit.samples[name].values.ravel() for name in fit.names}
    return fit.problem.erosion(columns, fit.data.conditions).mean(axis=1) / fit.fitted.mean()


def test_samples_of_a_robust_fit_explain_the_rows():
    fit = of_steel(np.array([1271.0, 1550, 1952, 2080, 1454, 1399]), "soft_l1")
    least, greatest = np.quantile(amounts(fit), [0.025, 0.975])
    assert 0.7 < least < greatest < 1.4


def test_samples_hold_for_other_tests_and_know_their_angles():
    rows = {"angle [deg]": TO_60, "erosion [-]": np.array([3.0, 5.2, 5.9, 5.5, 4.4, 3.1])}
    of_shape = erosion.calibrate(erosion.FitProblem("linearized", PULLED, rows, free=["k", "psi"]), starts=2)
    assert [*of_shape.joint_samples().columns] == ["k"]
    assert np.rad2deg(of_shape.joint_samples().tested["alpha"]) == pytest.approx([10, 60])
    in_own_units = _uncertain(of_shape, {}, "si")
    assert in_own_units is not None
    assert in_own_units.predictor is None
    assert in_own_units.laws.names == ("k",)
    volume = np.asarray(erosion.impact("rotating", PULLED.replace(alpha=np.deg2rad(TO_60))).volume)
    data = {"angle [deg]": TO_60, "volume [m^3/impact]": volume * np.array([1.01, 0.98, 1.02, 1, 0.99, 1])}
    of_jet = erosion.calibrate(erosion.FitProblem("rotating", PULLED, data, free=["k", "r"]), starts=2)
    assert [*of_jet.joint_samples().columns] == ["k", "r"]
    # An advice has another particle, of which predictions hold what the tests had.
    advised = _uncertain(of_jet, {}, "si")
    assert advised is not None
    assert advised.laws.names == ("k",)
    rows["erosion [-]"] = 2 * rows["erosion [-]"]
    of_amount = erosion.calibrate(erosion.FitProblem("linearized", PULLED, rows, free=["psi"]), starts=2)
    with pytest.raises(SamplingError, match="decides no parameter of an impact"):
        of_amount.joint_samples()
    assert "uncertain" not in to_case(of_amount)


P = erosion.TABLE_1.to("si")
TEN = np.array([10, 15, 20, 25, 30, 40, 50, 60, 75, 90.0])
WRONG = 3


@pytest.fixture
def fit_of(table):
    """The fit of finnie to its own curve with noise of 1 %; rows of a wrong weighing are given."""
    exact = erosion.impact("finnie", P.replace(alpha=np.deg2rad(TEN))).volume * 1e9
    noisy = exact * (1 + 0.01 * np.random.default_rng(0).standard_normal(len(TEN)))

    def fit(factor=1.0, **options):
        rows = noisy * np.where(np.arange(len(TEN)) == WRONG, factor, 1.0)
        lines = "".join(f"{angle},{value!r}\n" for angle, value in zip(TEN, rows.tolist(), strict=True))
        return calibrated(
            "finnie", P, table("angle [deg],volume [mm^3/impact]\n" + lines), ["psi"], starts=2, **options
        )

    return fit


def test_studentized_residuals_are_those_of_a_fit_without_the_row():
    rng = np.random.default_rng(0)
    design, rows = rng.standard_normal((12, 3)), rng.standard_normal(12)
    hat = design @ np.linalg.pinv(design)
    for i, value in enumerate(studentized(rows - hat @ rows, np.diag(hat), 12 - 3)[0]):
        others = np.arange(12) != i
        theta, squares = np.linalg.lstsq(design[others], rows[others])[:2]
        gram = np.linalg.inv(design[others].T @ design[others])
        error = np.sqrt(squares[0] / 8 * (1 + design[i] @ gram @ design[i]))
        assert value == pytest.approx((rows[i] - design[i] @ theta) / error, rel=1e-9)


def test_a_sampled_error_does_not_hide_an_outlier(table):
    """It is 10 relative errors off, but makes them three times as large; its repeat is no outlier."""
    degrees, rng = np.repeat([10, 20, 30, 45, 60, 75], 2), np.random.default_rng(1)
    exact = erosion.impact("finnie", P.replace(alpha=np.deg2rad(degrees))).volume * 1e9
    rows = exact * (1 + 0.05 * rng.standard_normal(12))
    rows[6] *= 1.5
    lines = "".join(f"{angle},{value!r}\n" for angle, value in zip(degrees, rows.tolist(), strict=True))
    data = table("angle [deg],volume [mm^3/impact]\n" + lines)
    drawn = erosion.posterior(erosion.FitProblem("finnie", P, data, ["psi"]), draws=125, discrepancy=False)
    (missed,) = (finding for finding in drawn.predictor.findings if finding.code == "rows_missed")
    assert (missed.numbers["missed"], missed.numbers["rows"]) == (1, 12)
    assert missed.numbers["listed"][0].startswith("line 8 (45°)")


def test_missed_rows_that_are_not_listed_are_counted(table):
    degrees = np.linspace(10, 70, 7)
    exact = erosion.impact("finnie", P.replace(alpha=np.deg2rad(degrees))).volume * 1e9
    rows = exact * np.where(np.arange(7) % 2, 1.5, 0.5)
    lines = "".join(f"{angle},{row!r},{row / 50!r}\n" for angle, row in zip(degrees, rows.tolist(), strict=True))
    data = table("angle [deg],volume [mm^3/impact],uncertainty [mm^3]\n" + lines)
    drawn = erosion.posterior(erosion.FitProblem("finnie", P, data, ["psi"]), draws=125, discrepancy=False)
    (missed,) = (finding for finding in drawn.predictor.findings if finding.code == "rows_missed")
    assert missed.numbers["missed"] > 4
    assert missed.numbers["listed"][4:] == [f"and {missed.numbers['missed'] - 4} more"]
    assert missed.text.endswith(f"; and {missed.numbers['missed'] - 4} more.")


def test_an_outlier_is_named_with_the_fit_without_it(fit_of):
    clean, spoiled = fit_of(), fit_of(2.0)
    assert not any("outlier" in finding.code for finding in clean.findings)
    outlier, of_others = (finding for finding in spoiled.findings if "outlier" in finding.code)
    assert (outlier.code, outlier.numbers["row"]) == ("outlier", f"line {WRONG + 2} (25°)")
    without = erosion.calibrate(
        erosion.FitProblem("finnie", P, spoiled.data.of_rows(np.delete(np.arange(10), WRONG)), ["psi"]), starts=2
    )
    (estimate,) = of_others.numbers["estimates"]
    assert f"psi = {without.in_words('psi', without.estimates['psi'])} " in estimate
    assert without.estimates["psi"] == pytest.approx(P.psi, rel=0.02)


def test_the_only_row_with_erosion_is_an_outlier_without_another_fit():
    volume = np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    only = calibrated("finnie", P, {"angle [deg]": np.arange(10.0, 80.0, 10.0), "volume [m^3/impact]": volume}, ["psi"])
    assert [finding.code for finding in only.findings if "outlier" in finding.code] == ["outlier"]


@pytest.mark.parametrize("density", [None, "7870 kg/m^3"])
def test_a_correlation_predicts_masses_by_its_own_density(tmp_path, density):
    # A ratio of masses is that of the correlation, whatever steel's density is in another table.
    data = tmp_path / "tests.csv"
    data.write_text("alpha [deg],v0 [m/s],mass_loss [mg/kg]\n15,50,30\n30,50,50\n60,50,40\n")
    fit = erosion.calibrate(erosion.FitProblem("dnv", erosion.TABLE_1, data, free=["k"], density=density))
    expected = 1e6 * np.asarray(erosion.correlations.dnv(np.deg2rad([15, 30, 60]), 50.0))
    rms = np.sqrt(np.mean((expected - [30, 50, 40]) ** 2))
    np.testing.assert_allclose(fit.rms * 1e6, rms, rtol=1e-9)
