"""The sampler on targets whose posterior and evidence are integrals over a line or a plane."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from erosion.arguments import no_progress
from erosion.fits.tempering import Misfit, Run, SamplingError, sample

LINE = np.linspace(-6.0, 6.0, 12_001)


class Rows(Misfit):
    """Rows with residuals that are functions of the points."""

    def __init__(
        self, *parts: Callable[[np.ndarray], np.ndarray], deviation: Callable = lambda points: np.ones(len(points))
    ):
        self.parts, self.deviation = parts, deviation

    @property
    def sizes(self) -> list[int]:
        return [len(part(np.zeros((1, 3))).T) for part in self.parts]

    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        squares = np.nan_to_num(np.sum(self.parts[part](points) ** 2, axis=1), nan=np.inf)
        return squares, self.deviation(points) ** 2


def drawn(
    misfit: Misfit, names: int = 1, draws: int = 1000, seed: int = 0, enough=lambda points: True, tell=no_progress
) -> Run:
    return sample(misfit, (4, draws, names), np.random.default_rng(seed), enough, tell)


def log_evidence(run: Run) -> float:
    return float(logsumexp(run.log_evidence) - np.log(len(run.log_evidence)))


def test_two_modes_keep_their_shares():
    # z² = 1 ± 0.1, and a second row that makes the left mode exp(2) times as likely.
    def residuals(points):
        z = points[:, :1]
        return np.concatenate([(z**2 - 1) / 0.1, np.where(z > 0, 2.0, 0.0)], axis=1)

    run = drawn(Rows(residuals))
    density = np.exp(-0.5 * np.sum(residuals(LINE[:, None]) ** 2, axis=1)) * stats.norm.pdf(LINE)
    left = density[LINE < 0].sum() / density.sum()
    # 4000 draws with a share of 0.88: one standard error is 0.005.
    assert np.mean(run.points < 0) == pytest.approx(left, abs=0.02)
    assert log_evidence(run) == pytest.approx(np.log(np.trapezoid(density, LINE)), abs=0.05)


def test_a_cliff_is_no_trouble():
    run = drawn(Rows(lambda points: np.where(points[:, :1] > 0.3, 5.0, 0.5) * np.ones((1, 4))))
    expected = stats.norm.cdf(0.3) * np.exp(-0.5) + stats.norm.sf(0.3) * np.exp(-50)
    assert log_evidence(run) == pytest.approx(np.log(expected), abs=0.03)
    assert run.points.max() <= 0.3
    assert run.points.mean() == pytest.approx(-stats.norm.pdf(0.3) / stats.norm.cdf(0.3), abs=0.06)


@pytest.mark.parametrize("seed", range(2))
def test_an_unknown_noise_has_the_evidence_of_its_integral(seed):
    # 40 rows of a slope that must be known to 1/1000 of its prior; the noise has a prior of some decades.
    x = np.linspace(0.0, 1.0, 40)
    y = 0.7 * x + 0.002 * np.random.default_rng(7).standard_normal(40)

    misfit = Rows(lambda points: points[:, :1] * x - y, deviation=lambda points: np.exp(2.5 * points[:, 1] - 3))
    run = drawn(misfit, 2, seed=seed)
    slope, level = np.linspace(0.695, 0.705, 401), np.linspace(-2.2, -0.8, 401)
    points = np.stack(np.meshgrid(slope, level, indexing="ij"), axis=-1).reshape(-1, 2)
    squares, variance = misfit.squares(points, 0)
    logs = -0.5 * squares / variance - 20 * np.log(variance)
    density = np.exp(logs - logs.max()) * stats.norm.pdf(points).prod(axis=1)
    cell = (slope[1] - slope[0]) * (level[1] - level[0])
    # The spread of the populations promises 0.05.
    assert log_evidence(run) == pytest.approx(np.log(density.sum() * cell) + logs.max(), abs=0.15)
    mean = (density[:, None] * points).sum(axis=0) / density.sum()
    spread = np.sqrt((density[:, None] * (points - mean) ** 2).sum(axis=0) / density.sum())
    np.testing.assert_allclose(run.points.mean(axis=(0, 1)), mean, atol=0.08 * spread.max(), rtol=0)
    np.testing.assert_allclose(run.points.std(axis=(0, 1)), spread, rtol=0.08)


def test_rows_that_come_in_parts_give_the_same():
    x, y = np.linspace(0.1, 1.0, 60), np.random.default_rng(3).standard_normal(60)

    def of(rows: slice) -> Callable:
        return lambda points: (points[:, :1] * x[rows] - y[rows]) / 0.5

    run = drawn(Rows(of(slice(0, 4)), of(slice(4, 20)), of(slice(20, 60))))
    variance = 1 / (1 + np.sum(x**2) / 0.25)
    mean = variance * np.sum(x * y) / 0.25
    evidence = -0.5 * np.sum(y**2) / 0.25 + 0.5 * mean**2 / variance + 0.5 * np.log(variance)
    assert run.points.mean() == pytest.approx(mean, abs=0.06 * np.sqrt(variance))
    assert run.points.std() == pytest.approx(np.sqrt(variance), rel=0.05)
    assert log_evidence(run) == pytest.approx(evidence, abs=0.06)
    assert run.log_likelihood.shape == (4, 1000)
    # The likelihood of the result is that of all rows.
    np.testing.assert_allclose(
        run.log_likelihood[0], -0.5 * Rows(of(slice(0, 60))).squares(run.points[0], 0)[0], rtol=1e-12
    )


def test_points_at_which_the_model_fails_get_no_draws():
    run = drawn(Rows(lambda points: np.where(points[:, :1] > 0, 0.5 * points[:, :1], np.nan)))
    assert run.points.min() > 0
    with pytest.raises(SamplingError, match="impacts of all draws of the prior failed"):
        drawn(Rows(lambda points: np.full((len(points), 1), np.nan)))
