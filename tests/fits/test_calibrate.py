"""Fits to synthetic data: the truth is found, and what cannot be found is said."""

import dataclasses
import re

import numpy as np
import pytest

import erosion
from erosion.fits import Calibration, CalibrationError, calibrate, doubts, rank_models, to_fluent, to_openfoam
from erosion.fits.least_squares import identify
from erosion.models.closed_forms import LinearizedCut
from erosion.parameters.parameters import TABLE_1

pytestmark = pytest.mark.slow

GUESS = TABLE_1.replace(k=3.0, psi=0.06)
DEGREES = np.linspace(5.0, 88.0, 50)
EXACT = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(DEGREES))))
NOISE = 0.03 * EXACT.max()


def synthetic(seed: int, exact: np.ndarray = EXACT, uncertain: bool = True) -> dict[str, np.ndarray]:
    """Table 1 measured with errors of 3 % of the greatest volume."""
    noise = 0.03 * exact.max()
    volume = exact + noise * np.random.default_rng(seed).standard_normal(exact.size)
    columns = {"angle [deg]": DEGREES, "volume [in^3]": volume}
    return {**columns, "uncertainty [in^3]": np.full(exact.size, noise)} if uncertain else columns


@pytest.fixture(scope="module")
def fit():
    return calibrate("linearized", GUESS, synthetic(1), ["k", "psi"])


def test_a_row_that_alone_determines_a_parameter_cannot_be_left_out():
    degrees = np.array([10.0, 50.0, 60.0, 70.0])  # only at 10° does the tip leave the surface, which k decides
    volume = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(degrees)))) * [1, 1.01, 0.98, 1.02]
    fit = calibrate("linearized", GUESS, {"angle [deg]": degrees, "volume [in^3]": volume}, ["k", "psi"], starts=4)
    assert fit.leave_one_out == np.inf
    row = next(row for row in fit.rows() if row.name == "leave_one_out")
    assert row.meaning.endswith("there is a row without which a parameter is open")


def test_exact_data_give_the_truth_back():
    result = calibrate("linearized", GUESS, synthetic(0) | {"volume [in^3]": EXACT}, ["k", "psi"], starts=4)
    # The kernel keeps nine digits.
    assert result.estimates == pytest.approx({"k": 2.0, "psi": 0.04}, rel=1e-7)
    assert result.chi2 < 1e-9
    assert result.p.k == result.estimates["k"]
    assert result.p.units == "inch-pound"
    assert result.warnings == ()
    numbers = result.to_dict()
    assert (numbers["model"], numbers["estimates"]) == ("linearized", result.estimates)
    assert numbers["parameters"]["k"] == result.estimates["k"]
    assert numbers["intervals"] == {name: list(interval) for name, interval in result.intervals().items()}


def test_errors_are_those_of_the_normal_equations(fit):
    k, psi = fit.estimates["k"], fit.estimates["psi"]
    angles = np.deg2rad(DEGREES)

    def volume(k: float, psi: float) -> np.ndarray:
        return np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=angles, k=k, psi=psi)))

    by_k = (volume(k * 1.0001, psi) - volume(k * 0.9999, psi)) / (2e-4 * k)
    by_psi = (volume(k, psi * 1.0001) - volume(k, psi * 0.9999)) / (2e-4 * psi)
    jacobian = np.stack([by_k, by_psi], axis=1) / NOISE
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    # Central differences of 1e-4, across the cusp for some.
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-3)
    errors = np.sqrt(np.diag(covariance))
    assert list(fit.standard_errors.values()) == pytest.approx(errors, rel=1e-3)
    np.testing.assert_allclose(fit.correlation, covariance / np.outer(errors, errors), rtol=1e-3)
    np.testing.assert_allclose(fit.residuals, synthetic(1)["volume [in^3]"] - volume(k, psi), atol=1e-12)
    assert fit.chi2 == pytest.approx(np.sum((fit.residuals / NOISE) ** 2))
    assert fit.degrees_of_freedom == 48
    assert fit.aicc == pytest.approx(fit.chi2 + 4 + 12 / 47)


def test_an_interval_ends_where_the_misfit_has_risen(fit):
    angles, measured = np.deg2rad(DEGREES), synthetic(1)["volume [in^3]"]

    def rise(k: float) -> float:
        # V is proportional to 1/ψ, whose best value for this k is a quotient.
        shape = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=angles, k=k)))
        best = (shape @ measured) / (shape @ shape)
        return float(np.sum((best * shape - measured) ** 2)) / NOISE**2 - fit.chi2

    for level, quantile in ((0.95, 1.959964), (0.5, 0.674490)):
        for end in fit.intervals(level)["k"]:
            # To 2 % of the half width, and the minimum to 2 % of the rise.
            assert np.sqrt(rise(end)) == pytest.approx(quantile, rel=0.04)
    low, high = fit.intervals()["k"]
    assert low < fit.estimates["k"] < high
    assert np.log(high / low) == pytest.approx(2 * 1.96 * fit.standard_errors["k"] / fit.estimates["k"], rel=0.05)


def test_left_out_errors_are_those_of_fits_without_the_row(fit):
    data = synthetic(1)
    alone = []
    for row in range(0, 50, 7):
        rest = {name: np.delete(values, row) for name, values in data.items()}
        other = calibrate("linearized", fit.p, rest, ["k", "psi"], starts=1)
        alone.append(data["volume [in^3]"][row] - other.curve(np.deg2rad(DEGREES[row]))[0])
    leverage = np.sum((fit.solution.jacobian @ fit.identifiability.modes) ** 2, axis=1)
    # To first order in the noise of 3 %.
    np.testing.assert_allclose(alone, (fit.residuals / (1 - leverage))[::7], atol=0.02 * NOISE)
    assert np.sqrt(np.mean(fit.residuals**2)) < fit.leave_one_out < 1.1 * np.sqrt(np.mean(fit.residuals**2))


def test_noise_is_estimated_where_none_is_given(fit):
    result = calibrate("linearized", GUESS, synthetic(1, uncertain=False), ["k", "psi"])
    assert result.estimates == pytest.approx(fit.estimates, rel=1e-6)
    spread = np.sqrt(np.sum(result.residuals**2) / 48)
    assert result.standard_errors["k"] == pytest.approx(fit.standard_errors["k"] * spread / NOISE, rel=1e-5)
    # Student's t is wider than the normal distribution: by half at 5 degrees of freedom.
    few = {name: values[:35:5] for name, values in synthetic(1, uncertain=False).items()}
    small = calibrate("linearized", GUESS, few, ["k", "psi"], starts=1)
    low, high = small.intervals()["psi"]
    error = small.standard_errors["psi"] / small.estimates["psi"]
    assert np.log(high / low) / (2 * error) == pytest.approx(2.571, rel=0.1)


def test_estimates_are_unbiased_and_intervals_cover():
    # The full demonstration, 100 seeds of each model, is benchmarks/calibration.py.
    seeds = 30
    fits = [calibrate("linearized", GUESS, synthetic(100 + seed), ["k", "psi"], starts=1) for seed in range(seeds)]
    for name, truth in (("k", 2.0), ("psi", 0.04)):
        off = np.array([one.estimates[name] for one in fits]) - truth
        assert abs(off.mean()) < 2.5 * off.std(ddof=1) / np.sqrt(seeds)
        covered = sum(low <= truth <= high for low, high in (one.intervals()[name] for one in fits))
        assert covered >= 25  # 28.5 are expected, and fewer than 25 seen once in 300 runs


def test_a_product_is_reported_as_a_product():
    result = calibrate("linearized", GUESS, synthetic(2), ["k", "psi", "sigma"])
    assert result.warnings == ("psi and sigma cannot be told apart: only psi·sigma is determined. Fix one of them.",)
    assert result.undetermined == ("psi", "sigma")
    assert result.standard_errors["psi"] == result.standard_errors["sigma"] == np.inf
    assert result.intervals()["psi"] == (0.0, np.inf)
    assert result.standard_errors["k"] == pytest.approx(0.043, rel=0.05)
    both = calibrate("linearized", GUESS, synthetic(2), ["k", "psi"])
    assert result.estimates["psi"] * result.estimates["sigma"] == pytest.approx(both.estimates["psi"] * 200e3, rel=1e-6)
    assert result.estimates["k"] == pytest.approx(both.estimates["k"], rel=1e-6)
    assert "cannot be told apart" in str(result)
    assert "not determined" in result._repr_html_()
    # The curve and its band do not depend on how the product is shared out.
    np.testing.assert_allclose(result.curve(0.5), both.curve(0.5), rtol=1e-5)
    assert result.leave_one_out == pytest.approx(both.leave_one_out, rel=1e-5)


def test_what_has_no_influence_is_said():
    result = calibrate("linearized", GUESS, synthetic(2), ["k", "psi", "r"], starts=2)
    assert result.warnings == ("r has no influence on these data and cannot be determined. Fix it.",)
    assert result.standard_errors["r"] == np.inf
    assert np.isfinite(result.standard_errors["psi"])


def test_combinations_are_named_as_products_of_powers():
    rng = np.random.default_rng(0)
    shape, height, spin = rng.standard_normal((3, 20))
    names = ["k", "m", "sigma", "v0", "phidot0", "r"]
    columns = [shape, height, -height, 2 * height, 0.3 * spin, 0.3 * spin]
    result = identify(names, np.stack(columns, axis=1), np.ones(6), 1.0)
    assert result.rank == 3
    assert result.warnings == (
        "m, sigma and v0 cannot be told apart: only m·v0^2/sigma is determined.",
        "phidot0 and r cannot be told apart: only phidot0·r is determined.",
    )
    assert result.undetermined == ("m", "sigma", "v0", "phidot0", "r")
    # θ = φ̇₀ r₀/v₀ is not a logarithm: at half the size, its column is twice as strong.
    columns[4] = columns[4] * 2
    again = identify(names, np.stack(columns, axis=1), np.array([1, 1, 1, 1, 0.5, 1]), 1.0)
    assert again.warnings == result.warnings
    root = identify(["m", "b"], np.stack([shape, -shape / 2], axis=1), np.ones(2), 1.0)
    assert root.warnings == ("m and b cannot be told apart: only m/b^(1/2) is determined.",)


def test_a_profile_of_a_nearly_linear_fit_is_a_parabola(fit):
    profile = fit.profile("k", 9)
    error = fit.standard_errors["k"] / fit.estimates["k"]
    parabola = (np.log(profile.values / fit.estimates["k"]) / error) ** 2
    # Errors of 2 % bend it by some percents; each point is found to 0.02.
    np.testing.assert_allclose(profile.rise, parabola, rtol=0.12, atol=0.02)
    with pytest.raises(ValueError, match="Argument `name` must be one of k, psi, but is 'r'"):
        fit.profile("r")


def test_what_is_not_determined_has_a_flat_profile():
    result = calibrate("linearized", GUESS, synthetic(2), ["psi", "sigma"], starts=1)
    np.testing.assert_allclose(result.profile("sigma", 3).rise, 0, atol=1e-4)


def test_an_interval_ends_at_a_bound():
    bounds = {"k": (1.99, 2.02)}
    result = calibrate("linearized", GUESS, synthetic(1), ["k", "psi"], bounds=bounds, starts=1)
    assert result.intervals()["k"] == pytest.approx(bounds["k"])
    # With k so nearly known, ψ is known better.
    low, high = result.intervals()["psi"]
    free_low, free_high = calibrate("linearized", GUESS, synthetic(1), ["k", "psi"], starts=1).intervals()["psi"]
    assert high - low < 0.9 * (free_high - free_low)


def test_outliers_are_borne_by_a_robust_loss():
    data = synthetic(3, uncertain=False)
    data["volume [in^3]"][[36, 40]] += EXACT.max()
    plain = calibrate("linearized", GUESS, data, ["k", "psi"], starts=2).estimates
    robust = calibrate("linearized", GUESS, data, ["k", "psi"], starts=2, loss="cauchy").estimates
    assert abs(robust["k"] - 2) < 0.15 < abs(plain["k"] - 2)


def test_other_kinds_of_erosion_give_the_same_answer(fit):
    volume, noise = synthetic(1)["volume [in^3]"], synthetic(1)["uncertainty [in^3]"]
    kinds = {
        "[in^3/slinch]": ("volume", 1 / float(GUESS.m), None),
        "[slinch]": ("mass_loss", 2.5e-4, 2.5e-4),
        "[slinch/slinch]": ("mass_loss", 2.5e-4 / float(GUESS.m), "2.5e-4 slinch/in^3"),
    }
    for unit, (name, factor, density) in kinds.items():
        table = {"angle [deg]": DEGREES, f"{name} {unit}": volume * factor, f"uncertainty {unit}": noise * factor}
        result = calibrate("linearized", GUESS, table, ["k", "psi"], starts=1, density=density)
        assert result.estimates == pytest.approx(fit.estimates, rel=1e-6), unit
        assert result.standard_errors == pytest.approx(fit.standard_errors, rel=1e-6)


def test_a_free_scale_leaves_the_shape(fit):
    table = {"angle [deg]": DEGREES, "erosion [-]": synthetic(1)["volume [in^3]"] * 1e5}
    result = calibrate("linearized", GUESS, table, ["k"], starts=2)
    assert result.names == ("k", "scale")
    assert result.estimates["k"] == pytest.approx(fit.estimates["k"], rel=1e-5)
    # The scale takes up the guess's wrong ψ.
    assert result.estimates["scale"] == pytest.approx(1e5 * 0.06 / fit.estimates["psi"], rel=1e-5)
    tied = calibrate("linearized", GUESS, table, ["k", "psi"], starts=1)
    assert tied.warnings == ("psi and scale cannot be told apart: only psi/scale is determined. Fix one of them.",)


def test_speed_and_mass_by_row():
    speed, mass = np.linspace(3000, 6000, 50), np.geomspace(1e-7, 1e-6, 50)
    p = TABLE_1.replace(alpha=np.deg2rad(DEGREES), v0=speed, m=mass)
    table = {"angle [deg]": DEGREES, "volume [in^3]": np.asarray(LinearizedCut().volume(p)),
             "speed [in/s]": speed, "mass [slinch]": mass}  # fmt: skip
    result = calibrate("linearized", GUESS, table, ["k", "psi"], starts=1)
    assert result.estimates == pytest.approx({"k": 2.0, "psi": 0.04}, rel=1e-7)
    with pytest.raises(ValueError, match="must not name `v0`: the data has a column of it"):
        calibrate("linearized", GUESS, table, ["v0"])


def test_bounds_are_kept_and_said():
    result = calibrate("linearized", GUESS, synthetic(1), ["k", "psi"], bounds={"k": (2.5, 4.0)}, starts=2)
    assert result.estimates["k"] == pytest.approx(2.5, rel=1e-6)
    assert result.warnings[0] == "k is at its lower bound, 2.5: its error means nothing."
    assert result.warnings[1].startswith("psi is known better than its standard error says")
    assert result.warnings[2].startswith("The model does not fit within the uncertainties: χ² is")


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
        ({"data": {"angle [deg]": [20, 30], "mass_loss [mg]": [1, 2]}}, "`density` of the target must be given"),
        ({"data": {"angle [deg]": [20, 30], "volume [mm^3]": [1, 2]}}, "must have at least 3 rows for 2 free"),
        ({"data": {"angle [deg]": [20, 30, 40], "volume [mm^3]": [0, 0, 0]}}, "must have erosion other than zero"),
        (
            {"data": {"angle [deg]": [20, 30, 40], "volume [mm^3]": [1e300] * 3}},
            "must have erosion that a metal can have",
        ),
        ({"data": {"angle [deg]": [20, 30, 40], "volume [mm^3]": [1e-300] * 3}}, "must have erosion that a metal can"),
    ],
)
def test_bad_arguments(options, message):
    arguments = {"p": GUESS, "free": ["k", "psi"], "data": synthetic(0), **options}
    with pytest.raises(ValueError, match=message):
        calibrate("linearized", **arguments)


class Broken(erosion.models.Linearized):
    """A model whose impacts all fail."""

    def removal_rate(self, state, p):
        return super().removal_rate(state, p) * np.nan


def test_a_model_that_fails_is_said_to_fail():
    broken = Broken()
    with pytest.raises(CalibrationError, match="its impacts failed for every start"):
        calibrate(broken, GUESS, synthetic(0), ["k"], starts=2)
    told = []
    ranking = rank_models(
        GUESS, synthetic(0), ["k"], models=[broken, "linearized"], starts=2, progress=lambda *call: told.append(call)
    )
    assert told == [("fitting Broken", 0, 2), ("fitting linearized", 1, 2)]
    assert ranking.names == ("linearized",)
    assert ranking.failures[0].startswith("Broken: The model could not be fitted")


def test_an_interval_on_whose_way_the_model_fails_is_said(fit, monkeypatch):
    monkeypatch.setattr(doubts, "settle", lambda *arguments: None)
    again = Calibration(fit.problem, fit.solution)
    assert np.isnan(again.intervals()["k"]).all()
    assert again.warnings[0].startswith("The interval of k has an end that is not known: the model fails")
    with pytest.raises(CalibrationError, match="The profile of k cannot be made"):
        again.profile("k")


@pytest.fixture(scope="module")
def turning() -> np.ndarray:
    # With the derivatives of the fits, so that one compiled program serves all.
    p = TABLE_1.replace(alpha=np.deg2rad(DEGREES))
    return np.asarray(erosion.impact("rotating", p, derivatives=1, wrt=("k", "psi")).volume)


def test_intervals_end_at_cliffs(turning):
    # Two sets in which the jump of V(α) comes upon a row within the standard error of k.
    k, psi = np.meshgrid(2.0 * np.linspace(0.87, 1.13, 105), 0.04 * np.linspace(0.94, 1.06, 73), indexing="ij")
    k, psi = k.ravel(), psi.ravel()
    case = TABLE_1.replace(alpha=np.deg2rad(DEGREES), k=k[:, None], psi=psi[:, None])
    volume = np.asarray(erosion.impact("rotating", case, derivatives=1, wrt=("k", "psi")).volume)
    for seed in (0, 1):
        data = synthetic(seed, turning)
        result = calibrate("rotating", GUESS, data, ["k", "psi"])
        misfit = np.sum(((volume - data["volume [in^3]"]) / data["uncertainty [in^3]"]) ** 2, axis=1)
        assert result.chi2 < misfit.min() + 0.05
        inside = k[misfit - result.chi2 < 1.959964**2]
        # As near as the grid is.
        assert result.intervals()["k"] == pytest.approx((inside.min(), inside.max()), abs=0.01)


def test_a_curve_with_a_jump_is_found_from_afar(turning):
    # V(α) of `rotating` jumps at 42.9°, and the misfit jumps as k moves that across a row.
    result = calibrate("rotating", GUESS, synthetic(5, turning), ["k", "psi"], starts=8)
    for name, truth in (("k", 2.0), ("psi", 0.04)):
        assert abs(result.estimates[name] - truth) < 3 * result.standard_errors[name]
    # Here the jump comes upon a row 0.6 standard errors below k.
    (sentence,) = result.warnings
    assert sentence.startswith("k is known better than its standard error says (V(α) jumps, or a bound)")


def test_the_variant_that_made_the_data_comes_first(turning):
    names = ["linearized", "finnie", "rotating"]
    ranking = rank_models(GUESS, synthetic(6, turning), ["k", "psi"], models=names, starts=6)
    assert ranking.names == ("rotating", "linearized", "finnie")
    assert ranking.weights.sum() == pytest.approx(1)
    assert ranking.weights[0] > 0.99
    # With 3k for k and a third of ψ, Finnie's curve is the linearized one.
    assert ranking.ties == (("linearized", "finnie"),)
    assert ranking.tied_with("finnie") == ("linearized",)
    assert "linearized and finnie give the same curve" in ranking.warnings[0]
    other = ranking.fits[1].estimates
    assert ranking.fits[2].estimates == pytest.approx({"k": 3 * other["k"], "psi": other["psi"] / 3}, rel=1e-4)
    assert ranking.fits[0].leave_one_out < ranking.fits[1].leave_one_out
    assert "ΔAICc" in str(ranking)
    assert "<th>left out [10⁻⁶ in³]</th>" in ranking._repr_html_()


def test_a_ranking_says_what_is_the_same_and_what_is_open(turning):
    names = ["linearized", "finnie", "tan-alpha", "velocity-aligned"]
    ranking = rank_models(GUESS, synthetic(6, turning), ["k", "psi"], models=names, starts=2)
    estimates = {row[0]: row[-1] for row in ranking.rows()}
    assert estimates["finnie"].endswith("(curve of linearized)")
    assert re.fullmatch(r"psi = [\d.]+, k not determined", estimates["tan-alpha"])
    assert estimates["velocity-aligned"] == "same as tan-alpha"
    tied = (
        "These data cannot tell models of the same curve apart: linearized and finnie; tan-alpha and velocity-aligned."
    )
    assert tied in ranking.warnings


def test_a_ranking_says_which_own_parameters_are_held(turning):
    names = ["linearized", "linearized-deformation", "rotating-deformation"]
    ranking = rank_models(GUESS, synthetic(6, turning), ["psi", "energy_ratio"], models=names, starts=1)
    held = (
        "Own parameters that are not free are held: threshold = 0 in/s (rotating-deformation, linearized-deformation)."
    )
    assert held in ranking.warnings
    fits = dict(zip(ranking.names, ranking.fits, strict=True))
    of_threshold = {row.name: row for row in fits["linearized-deformation"].rows()}["threshold"]
    assert (of_threshold.value, of_threshold.unit, of_threshold.meaning) == ("0", "in/s", "held")


def test_a_parameter_that_lost_its_influence_counts_in_the_ranking():
    # With k below 2 tan α of all rows, `linearized` is `tan-alpha`: it may not come first for that.
    exact = float(TABLE_1.m * TABLE_1.v0**2 / (TABLE_1.sigma * TABLE_1.psi) / 2) * np.cos(np.deg2rad(DEGREES)) ** 2
    ranking = rank_models(GUESS, synthetic(1, exact), ["k", "psi"], models=["linearized", "tan-alpha"])
    assert ranking.names == ("tan-alpha", "linearized")
    simple, nested = ranking.fits
    assert nested.undetermined == simple.undetermined == ("k",)
    assert nested.chi2 == pytest.approx(simple.chi2, rel=1e-6)
    # One parameter against two, of 50 rows.
    assert nested.aicc - simple.aicc == pytest.approx((4 + 12 / 47) - (2 + 4 / 48))


def test_finnies_shape_goes_to_openfoam_without_loss(fit):
    coefficients = to_openfoam(fit)
    # V = (V*/k) F(α; 3k), so that p is a third of σ, in Pa.
    assert pytest.approx(3 * fit.estimates["k"], rel=1e-6) == coefficients.K
    assert coefficients.psi == fit.estimates["psi"]
    assert coefficients.p == pytest.approx(200e3 / 3 * 6894.757293168, rel=1e-6)
    assert coefficients.misfit < 1e-6
    text = coefficients.text()
    assert "type        particleErosion;" in text
    assert f"K           {coefficients.K:.12g};" in text
    assert "differs from the model's by up to 0.00% of its maximum" in text


def test_other_shapes_go_to_openfoam_with_their_misfit(turning):
    result = calibrate("rotating", TABLE_1, synthetic(5, turning), ["psi"], starts=1)
    coefficients = to_openfoam(result)
    # The turning body's curve is broader than Finnie's and jumps.
    assert 0.05 < coefficients.misfit < 0.12
    assert coefficients.rms < coefficients.misfit
    assert f"by up to {coefficients.misfit:.2%} of its maximum" in coefficients.text()


def test_the_table_for_fluent_says_how_far_off_it_is(fit):
    table = to_fluent(fit)
    assert len(table.angle) == 20
    assert (table.angle[0], table.f[0]) == (0.0, 0.0)
    assert table.angle[-1] == pytest.approx(np.pi / 2)
    assert table.f.max() == 1.0
    dense = np.deg2rad(np.linspace(1, 90, 179))
    curve = fit.curve(dense)[0] / fit.curve(np.arctan(fit.estimates["k"]) / 2)[0]
    # The table's own maximum and misfit are taken on a grid of ¼°.
    assert np.abs(np.interp(dense, table.angle, table.f) - curve).max() == pytest.approx(table.misfit, abs=2e-4)
    assert to_fluent(fit, points=30).misfit < table.misfit < to_fluent(fit, points=8).misfit
    lines = table.text().splitlines()
    assert f"by up to {table.misfit:.2%} of its maximum" in table.text()
    assert lines.index("angle [deg],f [-]") == len(lines) - 21
    # C = V_max/(m V²), per density of the target.
    si = fit.p.to("si")
    largest = fit.curve(np.arctan(fit.estimates["k"]) / 2)[0] * 0.0254**3
    assert table.factor == pytest.approx(largest / float(si.m * si.v0**2), rel=1e-4)
    with pytest.raises(ValueError, match="`points` must be from 2 to 30, but is 31"):
        to_fluent(fit, points=31)
    with pytest.raises(ValueError, match="`p` must be left out for a calibration, which has a case of its own"):
        to_fluent(fit, fit.p)


def test_results_are_frozen_and_speak(fit):
    with pytest.raises(dataclasses.FrozenInstanceError):
        fit.problem = None
    assert "linearized: fitted to 50 rows of data" in str(fit)
    assert fit.erosion_unit == fit.to_dict()["erosion_unit"] == "in^3"
    assert [row.name for row in fit.rows()] == ["k", "psi", "rms", "leave_one_out", "chi2", "aicc"]
    with pytest.raises(ValueError, match=r"`level` must be in \(0, 1\)"):
        fit.intervals(95.0)


@pytest.mark.parametrize(
    ("heading", "factor", "said"),
    [
        ("mass_loss [g]", 50.0, "must be that of one impact."),
        ("mass_loss [g/kg]", 500.0, "(fits to tests: DNVGL-RP-O501, 2015, table 3-1)."),
        ("mass_loss [g/kg]", 0.5, ""),
    ],
)
def test_rows_of_another_order_than_all_tests_are_told(heading, factor, said):
    degrees = np.array([10.0, 20.0, 30.0, 45.0, 60.0])
    volume = np.asarray(LinearizedCut().volume(GUESS.replace(alpha=np.deg2rad(degrees), k=2.0)))
    columns = {"angle [deg]": degrees, heading: factor * volume / volume.max()}
    statements = calibrate("linearized", GUESS, columns, ["psi"], density="2.7 g/cm^3", starts=1).warnings
    far = [sentence for sentence in statements if " is far from what tests on ductile metals find at " in sentence]
    assert [sentence.startswith("data: ") and sentence.endswith(said) for sentence in far] == [True] * bool(said)
