"""Draws of what a fit leaves open, against closed forms."""

import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.fits.export import to_case
from erosion.fits.tempering import SamplingError
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


def test_draws_of_many_rows_have_the_spread_of_all_of_them():
    degrees = np.tile(DEGREES, 400)
    exact = np.asarray(erosion.impact("linearized", P.replace(alpha=np.deg2rad(degrees))).volume)
    rows = exact + 0.1 * exact.mean() * np.random.default_rng(1).standard_normal(degrees.size)
    fit = erosion.calibrate("linearized", P, {"angle [deg]": degrees, "volume [in^3]": rows}, free=["psi"], starts=1)
    drawn = np.log(fit.rows_of_draws(1024).columns["psi"] / fit.estimates["psi"])
    assert stats.kstest(drawn / np.sqrt(fit.covariance_of_theta[0, 0]), stats.norm().cdf).statistic < 0.06


STEEL = erosion.TABLE_1.to("si").with_particle("garnet 80 mesh").with_target("mild steel").replace(v0=160.0)
SIX = np.arange(15.0, 91.0, 15.0)


def of_steel(losses: np.ndarray, loss: str = "linear") -> erosion.Calibration:
    rows = {"angle [deg]": SIX, "mass_loss [mg/kg]": losses}
    free = ["k", "psi", "energy_ratio"]
    return erosion.calibrate(
        "linearized-deformation", STEEL, rows, free=free, density="7850 kg/m^3", loss=loss, starts=4
    )


def amounts(fit: erosion.Calibration) -> np.ndarray:
    """The mean erosion of the rows by each draw, over that of the fit."""
    columns, forward = fit.rows_of_draws().columns, fit.problem.forward
    thetas = np.stack([np.vectorize(lambda value, name=name: forward.to_theta(name, value))(columns[name])
                       for name in fit.names], axis=1)  # fmt: skip
    return forward.predict_many(thetas, fit.data.conditions).mean(axis=1) / fit.fitted.mean()


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy", "arctan"])
def test_draws_of_a_robust_fit_explain_the_rows(loss):
    fit = of_steel(np.array([1271.0, 1550, 1952, 2080, 1454, 1399]), loss)
    least, greatest = np.quantile(amounts(fit), [0.025, 0.975])
    assert 0.7 < least < greatest < 1.4


def test_no_draw_of_rows_that_scatter_much_removes_nothing():
    scattered = np.array([0.6, 1.5, 0.7, 1.4, 1.3, 0.5]) * np.array([1271.0, 1550, 1952, 2080, 1454, 1399])
    assert amounts(of_steel(scattered)).min() > 0.2


def test_draws_hold_for_other_tests_and_know_their_angles():
    rows = {"angle [deg]": DEGREES, "erosion [-]": np.array([3.0, 5.2, 5.9, 5.5, 4.4, 3.1])}
    in_own_units = erosion.calibrate("linearized", P, rows, free=["k", "psi"], starts=2).rows_of_draws()
    assert [*in_own_units] == ["k"]
    assert np.rad2deg(in_own_units.tested["alpha"]) == pytest.approx([10, 60])
    volume = np.asarray(erosion.impact("rotating", P.replace(alpha=np.deg2rad(DEGREES))).volume)
    data = {"angle [deg]": DEGREES, "volume [in^3]": volume * np.array([1.01, 0.98, 1.02, 1, 0.99, 1])}
    assert [*erosion.calibrate("rotating", P, data, free=["k", "r"], starts=2).rows_of_draws()] == ["k"]
    of_jet = erosion.calibrate("linearized", P, data, free=["m"], starts=2)
    with pytest.raises(SamplingError, match="decides no parameter of the metal"):
        of_jet.rows_of_draws()
    assert "uncertain" not in to_case(of_jet)
