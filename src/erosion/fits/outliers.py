"""Rows that are far from a fit: which one it is, what it does to the fit, and which ones a robust loss holds back."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from erosion.fits.least_squares import Loss, settle
from erosion.output.tables import format_number
from erosion.parameters.quantities import table_scale

if TYPE_CHECKING:
    from erosion.fits.calibration import Calibration

_UNLIKELY = 0.01  # probability that any of the rows is so far off by noise
_ROUNDING = 1e-9  # of 1 less the leverage, below which a row has no residual of its own
FEW_PER_CENT = 0.05  # of the greatest erosion: residuals that erosion tests seldom go below
_USUAL = 2.0  # stated errors that a row may be off
_FURTHEST = 30.0  # standard errors, beyond which those of first order are no measure
_HELD_BACK = 0.5  # of a row's weight
_LISTED = 8  # rows that a sentence lists

_WEIGHTS: Mapping[Loss, Callable[[np.ndarray], np.ndarray]] = {
    "soft_l1": lambda z: (1 + z) ** -0.5,
    "huber": lambda z: np.maximum(z, 1.0) ** -0.5,
    "cauchy": lambda z: 1 / (1 + z),
    "arctan": lambda z: 1 / (1 + z**2),
}
"""ρ'(z) of the robust losses of scipy.optimize.least_squares, z the squared residual over the noise."""


def studentized(residuals: np.ndarray, leverage: np.ndarray, freedom: int) -> np.ndarray:
    """Residuals over their errors as a fit without the row has them, shape (rows,); 0 where that is not known.

    Of a linear fit with normal errors each follows Student's law of `freedom - 1`.

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
    return residuals / np.sqrt(others * rest)


def far_rows(fit: "Calibration") -> list[str]:
    """A sentence on the row that is furthest off, or on those that a robust loss holds back."""
    data, problem = fit.data, fit.problem
    residuals = fit.residuals / problem.data.deviation
    if problem.loss != "linear":
        return _held_back(fit, _WEIGHTS[problem.loss]((residuals / problem.noise) ** 2))
    freedom = fit.degrees_of_freedom
    if freedom < 2 or not residuals.any():
        return []
    of_rows = studentized(residuals, fit.leverage, freedom)
    row = int(np.argmax(np.abs(of_rows)))
    # A few other rows may be fitted too well by chance.
    usual = FEW_PER_CENT * np.abs(data.erosion).max() if data.uncertainty is None else _USUAL * data.uncertainty[row]
    if abs(fit.residuals[row]) <= usual:
        return []
    probability = min(1.0, 2 * len(residuals) * float(stats.t.sf(abs(of_rows[row]), freedom - 1)))
    return [_outlier(fit, row, float(of_rows[row]), probability)] if probability < _UNLIKELY else []


def _outlier(fit: "Calibration", row: int, distance: float, probability: float) -> str:
    data, problem = fit.data, fit.problem
    others = dataclasses.replace(problem, data=problem.data.of_rows(np.flatnonzero(np.arange(len(data)) != row)))
    without, changes = settle(others, fit.solution.theta), ""
    if without is not None:
        values = [
            float(problem.forward.from_theta(name, theta)) for name, theta in zip(fit.names, without.theta, strict=True)
        ]
        parts = [
            f"{name} = {fit.in_words(name, value)} (with it {fit.in_words(name, fit.estimates[name])})"
            for name, value in zip(fit.names, values, strict=True)
            if name not in fit.undetermined
        ]
        changes = f" Without it the fit is {', '.join(parts)}." if parts else ""
    scale = table_scale(data.dimension, data.units, float(np.abs(data.erosion).max()))
    measured, fitted = (scale.beside(format_number(of[row], 3, scale.size)) for of in (data.erosion, fit.fitted))
    errors = (
        f"more than {_FURTHEST:.0f} standard errors"
        if abs(distance) > _FURTHEST
        else f"{abs(distance):.1f} standard errors (probability {probability:.1g})"
    )
    return (
        f"{data.source}, {data.where(row)}, is an outlier: it has {measured}, the fit has {fitted}, "
        f"{errors}.{changes} See that it is written down right; the loss soft_l1 holds it back."
    )


def _held_back(fit: "Calibration", weights: np.ndarray) -> list[str]:
    """A sentence on the rows that a robust loss counts for less than half."""
    rows = [int(row) for row in np.argsort(weights) if weights[row] < _HELD_BACK]
    if not rows:
        return []
    data = fit.data
    listed = ", ".join(f"{data.where(row)} (to {weights[row]:.0%})" for row in rows[:_LISTED])
    more = f" and {len(rows) - _LISTED:,} more" if len(rows) > _LISTED else ""
    return [f"{data.source}: the loss {fit.problem.loss} weighs down {listed}{more}."]
