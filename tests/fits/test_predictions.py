"""Discrepancy and exponent: the likelihood against dense matrices, curves against the closed posterior, what holds."""

import dataclasses

import h5py
import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.fits import Posterior
from erosion.fits.discrepancy import Discrepant, with_few_conditions
from erosion.fits.errors import ErrorModel
from erosion.fits.fit_files import read_draws, read_predictor
from erosion.fits.likelihood import make_likelihood
from erosion.fits.prediction import predictor_of
from erosion.fits.problem import FitProblem
from erosion.parameters.parameters import QUANTITIES, TABLE_1

SI = TABLE_1.to("si")

INCH3 = 0.0254**3  # m³
ERROR = ErrorModel(1e-6 * INCH3, 0.05)
V0 = float(SI.v0)


def rows(*, error: ErrorModel | None = ERROR, degrees=(15.0, 30.0, 50.0)):
    """Repeats at three angles and two speeds, of a curve that no model has."""
    angle, speed = (part.ravel() for part in np.meshgrid(np.repeat(degrees, 2), (0.6 * V0, V0)))
    true = 8e-5 * INCH3 * np.sin(np.deg2rad(2 * angle)) ** 0.6 * (speed / V0) ** 2.5
    volume = true + ERROR.deviation(true) * np.random.default_rng(4).standard_normal(true.size)
    table = {"angle [deg]": angle, "speed [m/s]": speed, "volume [m^3/impact]": volume}
    return FitProblem("linearized", SI, table, ["k", "psi"], error=error)


def dense(misfit: Discrepant, values: dict, i: int, asked=None):
    """Mean and covariance of all rows, and of `asked` (α, v) if given, typed once more; rows without pooling."""
    data, p = misfit.plain.problem.data, misfit.plain.problem.p
    angle, speed = data.angle, data.conditions["v0"]
    if asked is not None:
        angle, speed = np.append(angle, asked[0]), np.append(speed, asked[1])
    at = p.replace(alpha=angle, v0=speed, k=values["k"][i], psi=values["psi"][i])
    of_model = erosion.impact("linearized", at).volume
    mean = of_model * (speed / V0) ** (values["exponent"][i] - 2)
    if not misfit.has_discrepancy:
        return mean, np.zeros((len(angle), len(angle)))
    mean = mean * np.sin(angle) ** values["sine_exponent"][i]
    greatest = np.max((of_model * (V0 / speed) ** 2)[: len(data)])
    mean = mean + values["normal_wear"][i] * greatest * np.sin(angle) ** 2 * (speed / V0) ** values["exponent"][i]

    def matern(r):
        return (1 + np.sqrt(5) * r + 5 / 3 * r**2) * np.exp(-np.sqrt(5) * r)

    apart, faster = np.subtract.outer(angle, angle), np.subtract.outer(np.log(speed), np.log(speed))
    both = np.hypot(apart / values["length"][i], faster / values["length_speed"][i])
    kernel = values["tau_angle"][i] ** 2 * matern(np.abs(apart) / values["length_angle"][i])
    return mean, kernel + values["tau"][i] ** 2 * matern(both)


@pytest.mark.parametrize("discrepancy", [True, False])
@pytest.mark.parametrize("error", [ERROR, None, ErrorModel(1e-6 * INCH3, 0.05, 0.04), ErrorModel(common=0.04)], ids=str)
def test_the_likelihood_is_that_of_all_rows(error, discrepancy):
    misfit = Discrepant(make_likelihood(rows(error=error)), True, discrepancy)
    points = np.random.default_rng(1).standard_normal((5, misfit.priors.dimension)) / 2
    squares, variance = misfit.squares(points, 0)
    values, data = misfit.values(points), misfit.plain.problem.data
    logs = misfit.plain.constant - 0.5 * (squares / variance + len(data) * np.log(variance))
    for i, log in enumerate(logs):
        mean, kernel = dense(misfit, values, i)
        own = (
            values["noise"][i] ** 2 + (values["relative_noise"][i] * mean) ** 2
            if data.uncertainty is None
            else data.weighed(mean).deviation ** 2
        )
        covariance = np.outer(mean, mean) * kernel + np.diag(own) + common(data, mean)
        joint = stats.multivariate_normal(mean, covariance)
        assert log == pytest.approx(joint.logpdf(data.erosion), rel=1e-5)


def common(data, mean: np.ndarray) -> np.ndarray:
    """The covariance by what rows of a speed share."""
    rows = data.weighed(mean)
    shared = None if rows.common is None else rows.common * rows.deviation
    return (
        np.zeros((len(data), len(data)))
        if shared is None
        else np.outer(shared, shared) * np.equal.outer(data.speed, data.speed)
    )


@pytest.mark.parametrize("factor", [None, 1.7])
def test_the_parameters_are_drawn_with_what_rows_of_a_speed_share(factor):
    error = ErrorModel(1e-6 * INCH3, 0.05, 0.1)
    laws = {} if factor is None else {"error_factor": stats.uniform(1.0, 1.0)}
    likelihood = make_likelihood(dataclasses.replace(rows(error=error), priors=laws))
    points = np.array([[0.02, 0.1, 0.524][: 2 if factor is None else 3]])
    squares, variance = likelihood.squares(points, 0)
    values, data = likelihood.values(points), likelihood.problem.data
    mean = likelihood.predict({name: values[name] for name in ("k", "psi")}, data.conditions)[0]
    covariance = np.diag(data.weighed(mean).deviation ** 2) + common(data, mean)
    covariance = covariance * values.get("error_factor", np.ones(1)) ** 2
    log = likelihood.constant - 0.5 * (squares / variance + len(data) * np.log(variance))
    assert log[0] == pytest.approx(stats.multivariate_normal(mean, covariance).logpdf(data.erosion), rel=1e-5)
    misses = data.erosion - mean
    assert likelihood.chi2(points)[0] == pytest.approx(misses @ np.linalg.solve(covariance, misses), rel=1e-5)


@pytest.mark.parametrize("error", [ERROR, ErrorModel(1e-6 * INCH3, 0.05, 0.1)], ids=str)
def test_curves_are_those_of_the_closed_posterior(error):
    misfit = Discrepant(make_likelihood(rows(error=error)), True, True)
    one = misfit.values(np.full((1, misfit.priors.dimension), 0.2))
    values = {name: np.repeat(value, 4000) for name, value in one.items()}
    asked = np.deg2rad(70.0), 1.3 * V0
    there = {"alpha": np.array([asked[0]]), "v0": np.array([asked[1]])}
    drawn = misfit.draw(values, there, np.random.default_rng(0))[:, 0]
    mean, kernel = dense(misfit, one, 0, asked)
    data = misfit.plain.problem.data
    joint = np.outer(mean, mean) * kernel
    own = np.diag(data.weighed(mean[:-1]).deviation ** 2)
    gain = np.linalg.solve(joint[:-1, :-1] + own + common(data, mean[:-1]), joint[:-1, -1])
    middle = mean[-1] + gain @ (data.erosion - mean[:-1])
    deviation = np.sqrt(joint[-1, -1] - gain @ joint[:-1, -1])
    # Of 4000 draws: 1.6 % of a deviation, and 1.1 % of it.
    assert drawn.mean() == pytest.approx(middle, abs=0.06 * deviation)
    assert drawn.std() == pytest.approx(deviation, rel=0.05)


def test_beyond_the_tested_angles_the_discrepancy_counts_alone():
    problem = rows()
    misfit = Discrepant(make_likelihood(problem), True, True)
    lacking = misfit.values(np.random.default_rng(2).standard_normal((50, misfit.priors.dimension)) / 3)
    alone = {name: lacking[name][:1].repeat(50) for name in ("k", "psi")}
    hypotheses = {"model": (alone, 0.9), "discrepancy": (lacking, 0.1)}
    kept = {name: {"values": part, "log_evidence": 0.0, "weight": weight}
            for name, (part, weight) in hypotheses.items()}  # fmt: skip
    alpha, predictor = np.deg2rad([15.0, 50.0, 10.0, 55.0]), predictor_of(problem, kept, 0)
    curves = predictor.draw(alpha, {"v0": V0}, 200)
    of_model = erosion.impact("linearized", SI.replace(alpha=alpha, **{name: part[0] for name, part in alone.items()}))
    is_of_model = np.isclose(curves, of_model.volume, rtol=1e-5, atol=0).mean(axis=0)
    np.testing.assert_allclose(is_of_model, [0.9, 0.9, 0.0, 0.0], atol=0.01)
    # No curve jumps at the last tested angle.
    inside, beside = predictor.draw(np.deg2rad([50.0, 50.0 + 1e-7]), {"v0": V0}, 200).T
    np.testing.assert_allclose(beside, inside, rtol=2e-3)


def test_many_conditions_are_put_together_and_no_row_is_lost():
    likelihood = make_likelihood(rows(degrees=np.linspace(10, 80, 300)))
    few = with_few_conditions(likelihood, 60)
    before, after = likelihood.problem.data, few.problem.data
    assert len(few.parts[0].mean) <= 60
    np.testing.assert_array_equal(before.erosion, after.erosion)
    assert np.abs(after.angle - before.angle).max() < np.deg2rad(3)
    assert with_few_conditions(few, 60) is few


def test_conditions_that_are_put_together_are_of_one_speed():
    degrees, speeds = np.tile(np.linspace(10, 80, 150), 2), V0 * np.repeat([0.97, 1.0], 150)
    volume = erosion.impact("linearized", SI.replace(alpha=np.deg2rad(degrees), v0=speeds)).volume
    table = {"angle [deg]": degrees, "speed [m/s]": speeds, "volume [m^3/impact]": volume}
    error = ErrorModel(1e-6 * INCH3, 0.05, 0.05)
    few = with_few_conditions(make_likelihood(FitProblem("linearized", SI, table, ["psi"], error=error)), 60)
    assert len(few.parts[0].mean) <= 60
    assert few.problem.data.speed is not None
    np.testing.assert_allclose(few.problem.data.speed, speeds)


@pytest.fixture(scope="module")
def missed() -> Posterior:
    problem = rows(degrees=(10.0, 20.0, 30.0, 45.0, 65.0, 85.0))
    return erosion.posterior(erosion.FitProblem("linearized", SI, problem.data, ["k", "psi"]), draws=125, seed=3)


def test_a_model_that_misses_predicts_with_wide_intervals(missed):
    degrees = np.array([15.0, 35.0, 55.0, 75.0])
    true = 8e-5 * INCH3 * np.sin(np.deg2rad(2 * degrees)) ** 0.6
    curves, alone = (each.draw(np.deg2rad(degrees), {"v0": V0}) for each in (missed.predictor, missed.of_model))
    low, high = np.quantile(curves, [0.025, 0.975], axis=0)
    assert ((low < true) & (true < high)).all()
    low, high = np.quantile(alone, [0.025, 0.975], axis=0)
    assert not ((low < true) & (true < high)).all()
    assert missed.predictor.weights["discrepancy"] > 0.99
    assert missed.predictor.exponent == pytest.approx((2.5, 0.1), abs=0.2)
    best = missed.alpha_max()
    low, high = np.quantile(best.alpha, [0.025, 0.975])
    assert low < np.deg2rad(45.0) < high  # of the law
    assert np.ptp(np.quantile(best.of_model, [0.025, 0.975])) < (high - low) / 2
    assert "discrepancy" in str(best)
    faster = missed.predictor.draw(np.deg2rad(degrees), {"v0": 2 * V0}) / (4 * true)
    assert (faster.std(axis=0) > curves.std(axis=0) / true).all()
    noisy = missed.predictor.draw(np.deg2rad(degrees), {"v0": V0}, 2000, noise=ErrorModel(2e-5 * INCH3))
    assert noisy.std() > 2e-5 * INCH3


def test_predictions_are_kept_in_the_file_of_draws(missed, tmp_path):
    path = missed.save(tmp_path / "draws.nc")
    again = read_predictor(path)
    asked = np.deg2rad([20.0, 70.0]), {"v0": np.array([V0, 1.5 * V0])}
    np.testing.assert_allclose(again.draw(*asked, noise=True), missed.predictor.draw(*asked, noise=True), rtol=1e-9)
    assert again.weights == missed.predictor.weights
    draws = read_draws(path, QUANTITIES)
    assert draws.rows.tested == missed.joint_samples().tested == {name: pytest.approx(ends) for name, ends in {
        "alpha": np.deg2rad((10.0, 85.0)), "v0": (0.6 * V0, V0), "m": 2 * (float(SI.m),)
    }.items()}  # fmt: skip
    assert draws.findings == missed.doubts != ()
    # An older version kept the evidence of each population.
    with h5py.File(path, "r+") as file:
        file["prediction/model"].attrs["log_evidence"] = np.zeros(4)
    with pytest.raises(ValueError, match=r"draws\.nc: was written by an older version"):
        read_predictor(path)


def test_what_rows_of_a_speed_share_is_kept_and_is_in_a_new_weighing(tmp_path):
    """A new weighing is of another day: its speed is off by an error of its own."""
    error = ErrorModel(1e-6 * INCH3, 0.05, 0.1)
    drawn = erosion.posterior(
        erosion.FitProblem("linearized", SI, rows(error=error).data, ["psi"]), draws=125, discrepancy=False
    )
    asked = np.deg2rad([20.0, 70.0]), {"v0": V0}
    mean, weighing = drawn.predictor.with_errors(*asked)
    np.testing.assert_allclose(weighing, np.hypot(error.deviation(mean), 0.1 * mean), rtol=1e-9)
    again = read_predictor(drawn.save(tmp_path / "draws.nc"))
    np.testing.assert_array_equal(again.data.speeds, drawn.data.speeds)
    assert again.data.error == error
    np.testing.assert_allclose(again.draw(*asked, noise=True), drawn.predictor.draw(*asked, noise=True), rtol=1e-9)
    data = drawn.data
    np.testing.assert_allclose(again.row_errors, np.hypot(data.deviation, 0.1 * data.erosion))
    # Alone it leaves a row's own error to the data.
    alone = drawn.predictor.with_errors(*asked, noise=ErrorModel(common=0.1))
    np.testing.assert_allclose(alone[1], weighing, rtol=1e-9)
    assert "5 % + 10 % of each speed" in erosion.predict(again, *asked).conclusions[0]


class Springs(erosion.models.ForceLaw):
    """As many springs as are said."""

    count = 1.0

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        return -self.count * p.stiffness * tip.depth, -self.count * p.k * p.stiffness * tip.depth

    def typical_ratio(self, p):
        """k, which sets the time scale."""
        return p.k


def test_a_fit_of_a_model_that_was_edited_since_predicts_nothing(monkeypatch):
    """Its numbers belong to the code that was fitted: the curve of another one would be that of no fit."""
    table = {"angle [deg]": [15.0, 25.0, 35.0, 45.0], "volume [in^3/impact]": [1e-4, 2e-4, 2e-4, 1e-4]}
    fit = erosion.calibrate(erosion.FitProblem(erosion.models.Rotating(force=Springs()), SI, table, ["psi"]))
    before = erosion.predict(fit, 0.5).columns["mean"]
    with monkeypatch.context() as edited:
        edited.setattr(Springs, "count", 2.0)
        for read in (lambda alpha: erosion.predict(fit, alpha), fit.curve):
            with pytest.raises(ValueError, match="fit it again"):
                read(0.5)
    np.testing.assert_array_equal(erosion.predict(fit, 0.5).columns["mean"], before)


def test_a_fit_predicts_as_the_posterior_of_its_rows(missed):
    """The parameters' errors alone would not hold the law, which the model misses."""
    fit = erosion.calibrate(erosion.FitProblem("linearized", SI, missed.data, ["k", "psi"]))
    degrees = np.array([15.0, 35.0, 75.0])
    tables = [erosion.predict(each, np.deg2rad(degrees)).columns for each in (fit, missed)]
    ends = [(table["mean_low"], table["mean_high"]) for table in tables]
    (low, high), (below, above) = ends
    np.testing.assert_allclose((high + low) / (above + below), 1.0, atol=0.1)
    np.testing.assert_allclose((high - low) / (above - below), 1.0, atol=0.3)
    true = 8e-5 * INCH3 * np.sin(np.deg2rad(2 * degrees)) ** 0.6
    assert ((low < true) & (true < high)).all()
    held = erosion.calibrate(
        erosion.FitProblem("linearized", SI, missed.data, ["k", "psi"], bounds={"k": (1.9, 2.1)})
    ).predictor
    drawn = np.concatenate([hypothesis.values["k"] for hypothesis in held.hypotheses.values()])
    assert 1.9 <= drawn.min() <= drawn.max() <= 2.1


def test_a_predictor_of_tests_at_shallow_angles_expects_wear_at_90_degrees():
    """Metals wear at 90°: that a model does not, or that nobody has weighed there, is no reason to expect none."""
    angle = np.repeat([10.0, 20.0, 30.0, 45.0, 60.0], 2)
    sine, cosine = np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))
    loss = 1e-4 * INCH3 * (sine * cosine**2 / 0.4 + 0.4 * sine**2)
    table = {"angle [deg]": angle, "volume [m^3/impact]": loss * np.tile([0.96, 1.04], 5)}
    fit = erosion.calibrate(erosion.FitProblem("linearized", SI, table, ["k", "psi"], error="5 %"))
    columns = erosion.predict(fit, np.deg2rad([90.0])).columns
    assert columns["mean_low"] < 4e-5 * INCH3 < columns["mean_high"]
    assert columns["mean_low"] > 1e-6 * INCH3
