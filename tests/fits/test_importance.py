"""Importance sampling against closed forms, and where annealing takes its place."""

import warnings

import numpy as np
import pytest

from erosion import TABLE_1, impact
from erosion.fits.discrepancy import Discrepant
from erosion.fits.importance import sample_near
from erosion.fits.likelihood import make_likelihood
from erosion.fits.prediction import drawn
from erosion.fits.problem import FitProblem
from erosion.fits.tempering import Misfit
from tests.fits.test_tempering import Rows

SI = TABLE_1.to("si")


def test_rows_that_are_linear_in_the_parameters_have_the_closed_posterior():
    rng = np.random.default_rng(5)
    slopes, y, error = rng.standard_normal((8, 3)), rng.standard_normal(8), 0.2
    near = sample_near(Rows(lambda points: (points @ slopes.T - y) / error), np.array([2.0, 2.0, -2.0]), rng)
    covariance = np.linalg.inv(np.eye(3) + slopes.T @ slopes / error**2)
    mean = covariance @ slopes.T @ y / error**2
    found, spread = near.moments()
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((found - mean) / deviations, 0, atol=0.08)
    np.testing.assert_allclose(spread / np.outer(deviations, deviations), covariance / np.outer(deviations, deviations),
                               atol=0.1)  # fmt: skip
    evidence = 0.5 * (mean @ np.linalg.solve(covariance, mean) - y @ y / error**2 + np.linalg.slogdet(covariance)[1])
    assert near.log_evidence == pytest.approx(evidence, abs=0.05)
    assert near.effective > 0.5 * len(near.points)
    np.testing.assert_allclose(near.chosen(2000, rng).mean(axis=0), mean, atol=0.1 * deviations.max())


class TwoModes(Misfit):
    """Modes at ±1.5 of the first parameter, by normal laws of σ 0.1; of the others the prior alone is known."""

    sizes = (1,)

    def squares(self, points, part):
        first = points[:, 0]
        logs = np.logaddexp(3 - 0.5 * ((first + 1.5) / 0.1) ** 2, -0.5 * ((first - 1.5) / 0.1) ** 2) + 0.5 * first**2
        return 10 - 2 * logs, np.ones(len(points))


@pytest.mark.parametrize("start", [1.0, -1.0])
@pytest.mark.parametrize("names", [1, 6])
def test_two_modes_count_by_their_shares(names, start):
    begin = np.full(names, start)
    near = sample_near(TwoModes(), begin, np.random.default_rng(1))
    assert near.weights @ (near.points[:, 0] > 0) == pytest.approx(1 / (1 + np.exp(3)), abs=0.04)
    assert near.log_evidence == pytest.approx(np.log(0.1 * (1 + np.exp(3))) - 5, abs=0.1)
    assert near.effective > 500


def test_points_at_which_the_model_fails_everywhere_have_no_effective_draw():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nowhere = sample_near(
            Rows(lambda points: np.full((len(points), 1), np.nan)), np.zeros(2), np.random.default_rng(0)
        )
    assert nowhere.effective == 0


def test_points_at_which_the_model_fails_get_no_weight():
    def residuals(points):
        return np.where(points[:, :1] > 0, points[:, :1] - 0.2, np.nan)

    near = sample_near(Rows(residuals), np.array([0.5]), np.random.default_rng(0))
    assert near.chosen(500, np.random.default_rng(0)).min() > 0


def test_parameters_that_only_a_product_determines_are_annealed():
    degrees = np.linspace(10.0, 80.0, 12)
    volume = np.asarray(impact("linearized", SI.replace(alpha=np.deg2rad(degrees))).volume)
    table = {
        "angle [deg]": degrees,
        "volume [m^3/impact]": volume,
        "uncertainty [m^3]": np.full(12, 0.003 * volume.max()),
    }
    problem = FitProblem("linearized", SI, table, ["k", "psi", "sigma"])
    misfit = Discrepant(make_likelihood(problem), has_exponent=False, has_discrepancy=False)
    start = {name: float(getattr(SI, name)) for name in misfit.priors.laws}
    assert sample_near(misfit, np.zeros(3), np.random.default_rng(0)).effective < 500
    way = drawn(misfit, start, np.random.default_rng(0))
    product = way.values["psi"] * way.values["sigma"]
    assert np.median(product) == pytest.approx(float(SI.psi * SI.sigma), rel=0.02)
    assert np.ptp(np.log(way.values["psi"])) > np.log(20)
