"""Rows that are far from a fit: which one it is, what it does to the fit, and which ones a robust loss holds back."""

from typing import TYPE_CHECKING

import numpy as np
from scipy import special, stats

from erosion.results import Finding

if TYPE_CHECKING:
    from erosion.fits.calibration import Calibration

_UNLIKELY = 0.01  # probability that any of the rows is so far off by noise
_ROUNDING = 1e-9  # of 1 less the leverage, below which a row has no residual of its own
FEW_PER_CENT = 0.05  # of the greatest erosion: residuals that erosion tests seldom go below
_USUAL = 2.0  # stated errors that a row may be off
_RATIOS = 0.0, *np.geomspace(0.3, 300.0, 10).tolist()  # of a relative error of the greatest erosion to the absolute one
_HELD_BACK = 0.5  # of a row's weight


def studentized(residuals: np.ndarray, leverage: np.ndarray, freedom: int) -> tuple[np.ndarray, np.ndarray]:
    """Residuals over their errors as a fit without the row has them, and the variance of the other rows, both (rows,).

    Of a linear fit with normal errors each residual follows Student's law of `freedom - 1`; 0 where it is not known.

    Args:
        residuals: weighted, shape (rows,).
        leverage: the diagonal of the hat matrix, shape (rows,).
        freedom: rows less determined parameters, 2 or more.

    References:
        R. D. Cook, S. Weisberg, Residuals and Influence in Regression (Chapman and Hall, 1982), equation 2.2.8.
    """
    rest = np.where(leverage < 1 - _ROUNDING, 1 - leverage, np.inf)
    total = float(np.sum(residuals**2))
    others = np.maximum(total - residuals**2 / rest, np.finfo(float).eps * total) / (freedom - 1)
    return residuals / np.sqrt(others * rest), others


def error_sizes(fitted: np.ndarray) -> list[np.ndarray]:
    """Errors of rows up to a factor, each of shape (rows,), of an absolute and a relative part in many ratios."""
    greatest = max(float(np.abs(fitted).max()), np.finfo(float).tiny)
    return [np.hypot(1, ratio * fitted / greatest) for ratio in _RATIOS]


def chances(residuals: np.ndarray, slopes: np.ndarray, fitted: np.ndarray, freedom: int) -> np.ndarray:
    """The probability that noise takes each row so far off or further, shape (rows,).

    Where errors are not known they have an absolute and a relative part. Their ratio is averaged over the likelihoods
    of the other rows, so that a row far off does not make its own error large.

    Args:
        residuals: weighted, shape (rows,).
        slopes: of the residuals along directions that are determined, shape (rows, directions).
        fitted: the erosion, shape (rows,), by which errors grow; zeros for known errors.
        freedom: as for `studentized`.
    """
    odds, logs = [], []
    for size in error_sizes(fitted):
        basis = np.linalg.qr(slopes / size[:, None])[0]
        of_rows = residuals / size
        of_rows = of_rows - basis @ (basis.T @ of_rows)
        distances, others = studentized(of_rows, np.sum(basis**2, axis=1), freedom)
        odds.append(2 * stats.t.sf(np.abs(distances), freedom - 1))
        logs.append(np.log(size) - np.log(size).sum() - (freedom - 1) / 2 * np.log(others))
    return np.sum(special.softmax(logs, axis=0) * odds, axis=0)


def findings_of_outliers(fit: "Calibration") -> list[Finding]:
    """The row that is furthest off, or those that a robust loss holds back."""
    data, squares = fit.data, fit.squares
    residuals = squares.data.over_errors(fit.residuals)
    if squares.loss != "linear":
        return _held_back(fit, squares.weights(residuals))
    freedom = fit.degrees_of_freedom
    if freedom < 2 or not residuals.any():
        return []
    slopes = fit.solution.jacobian @ fit.identifiability.modes
    odds = chances(residuals, slopes, fit.fitted if data.uncertainty is None else np.zeros(len(data)), freedom)
    row = int(np.argmin(odds))
    # A few other rows may be fitted too well by chance.
    usual = FEW_PER_CENT * np.abs(data.erosion).max() if data.uncertainty is None else _USUAL * data.uncertainty[row]
    if abs(residuals[row] * squares.data.deviation[row]) <= usual:
        return []
    probability = min(1.0, len(data) * float(odds[row]))
    return _outlier(fit, row, probability) if probability < _UNLIKELY else []


def _outlier(fit: "Calibration", row: int, probability: float) -> list[Finding]:
    data = fit.data
    without, place = fit.without(row), f"{data.source}, {data.where(row)}"
    measured, fitted = (data.in_words(of[row]) for of in (data.erosion, fit.fitted))
    numbers = {"row": data.where(row), "measured": measured, "fitted": fitted, "probability": probability}
    said = [Finding("outlier" if data.speeds is None else "outlier_of_speeds", place, numbers)]
    if without is not None:
        known = [name for name in fit.names if name not in (*fit.undetermined, *without.undetermined)]
        parts = [f"{name} = {fit.in_words(name, without.estimates[name])} (with it "
                 f"{fit.in_words(name, fit.estimates[name])})" for name in known]  # fmt: skip
        said += [Finding("fit_without_outlier", data.where(row), {"estimates": parts})] if parts else []
    return said


def _held_back(fit: "Calibration", weights: np.ndarray) -> list[Finding]:
    """The rows that a robust loss counts for less than half."""
    rows, least = int(np.sum(weights < _HELD_BACK)), int(np.argmin(weights))
    numbers = {"loss": fit.squares.loss, "rows": rows, "row": fit.data.where(least), "share": weights[least]}
    return [Finding("rows_held_back", fit.data.source, numbers)] if rows else []
