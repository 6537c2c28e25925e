"""Draws of what a fit leaves open, against closed forms."""

import numpy as np
import pytest
from scipy import stats

import erosion
from tests.models.test_own_parameters import P

DEGREES = np.arange(10.0, 70.0, 10.0)


def fit_of_size(uncertainty: float | None) -> erosion.Calibration:
    """A fit of ψ alone: the curve is proportional to 1/ψ, so that for small errors θ = ln ψ is a linear parameter."""
    exact = np.asarray(erosion.impact("linearized", P.replace(alpha=np.deg2rad(DEGREES))).volume)
    size = 0.01 * exact.mean()
    rows = {"angle [deg]": DEGREES, "volume [in^3]": exact + size * np.array([1, -1, 0.5, 1, -1.5, 0.3])}
    if uncertainty is not None:
        rows["uncertainty [in^3]"] = np.full(DEGREES.size, uncertainty * size)
    return erosion.calibrate("linearized", P, rows, free=["psi"], starts=1)


@pytest.mark.parametrize("uncertainty", [1.0, 3.0, None])
def test_draws_have_the_law_of_the_errors_of_a_linear_parameter(uncertainty):
    fit = fit_of_size(uncertainty)
    drawn = np.log(fit.rows_of_draws(2048).columns["psi"] / fit.estimates["psi"])
    scores = drawn / np.sqrt(fit.covariance_of_theta[0, 0])
    # With unknown scatter Student's law of the degrees of freedom: six rows, one parameter.
    law = stats.norm() if uncertainty is not None else stats.t(5)
    # Kolmogorov and Smirnov's distance of 2048 draws exceeds 0.043 once in a thousand times; these know of others.
    assert stats.kstest(scores, law.cdf).statistic < 0.06


def test_draws_of_the_same_rows_are_the_same_and_of_exact_rows_close():
    fit = fit_of_size(None)
    assert repr(fit.rows_of_draws()) == repr(fit.rows_of_draws())
    exact = np.asarray(erosion.impact("linearized", P.replace(alpha=np.deg2rad(DEGREES))).volume)
    sharp = erosion.calibrate(
        "linearized", P, {"angle [deg]": DEGREES, "volume [in^3]": exact}, free=["k", "psi"], starts=1
    )
    columns = sharp.rows_of_draws().columns
    assert 0 < np.ptp(columns["k"]) < 1e-2 * sharp.estimates["k"]
