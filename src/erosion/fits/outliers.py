"""Rows that are far from a fit: which one it is, what it does to the fit, and which ones a robust loss holds back."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from scipy import special, stats

from erosion.fits.least_squares import settle
from erosion.output import format_number

if TYPE_CHECKING:
    from erosion.fits.calibration import Calibration

_UNLIKELY = 0.01  # probability that any of the rows is so far off by noise
_ROUNDING = 1e-9  # of 1 less the leverage, below which a row has no residual of its own
FEW_PER_CENT = 0.05  # of the greatest erosion: residuals that erosion tests seldom go below
_USUAL = 2.0  # stated errors that a row may be off
_RATIOS = 0.0, *np.geomspace(0.3, 300.0, 10).tolist()  # of a relative error of the greatest erosion to the absolute one
_HELD_BACK = 0.5  # of a row's weight
_LISTED = 8  # rows that a sentence lists


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


def far_rows(fit: "Calibration") -> list[str]:
    """A sentence on the row that is furthest off, or on those that a robust loss holds back."""
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
    return [_outlier(fit, row, probability)] if probability < _UNLIKELY else []


def _outlier(fit: "Calibration", row: int, probability: float) -> str:
    data, squares = fit.data, fit.squares
    others = dataclasses.replace(squares, data=squares.data.of_rows(np.flatnonzero(np.arange(len(data)) != row)))
    without, changes = settle(others, fit.solution.theta), ""
    if without is not None:
        values = [
            float(squares.problem.from_theta(name, theta)) for name, theta in zip(fit.names, without.theta, strict=True)
        ]
        parts = [
            f"{name} = {fit.in_words(name, value)} (with it {fit.in_words(name, fit.estimates[name])})"
            for name, value in zip(fit.names, values, strict=True)
            if name not in fit.undetermined
        ]
        changes = f" Without it the fit is {', '.join(parts)}." if parts else ""
    measured, fitted = (data.scale.beside(format_number(of[row], 3, data.scale.size))
                        for of in (data.erosion, fit.fitted))  # fmt: skip
    remedy = "; the loss soft_l1 holds it back" if data.speeds is None else ""
    return (
        f"{data.source}, {data.where(row)}, is an outlier: it has {measured}, the fit has {fitted} "
        f"(probability {probability:.1g}).{changes} See that it is written down right{remedy}."
    )


def _held_back(fit: "Calibration", weights: np.ndarray) -> list[str]:
    """A sentence on the rows that a robust loss counts for less than half."""
    rows = [int(row) for row in np.argsort(weights) if weights[row] < _HELD_BACK]
    if not rows:
        return []
    data = fit.data
    listed = ", ".join(f"{data.where(row)} (to {weights[row]:.0%})" for row in rows[:_LISTED])
    more = f" and {len(rows) - _LISTED:,} more" if len(rows) > _LISTED else ""
    return [f"{data.source}: the loss {fit.squares.loss} weighs down {listed}{more}."]
