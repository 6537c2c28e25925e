"""Draws of what a fit leaves open: parameters that explain the rows as well as their scatter allows."""

import dataclasses
from collections.abc import Collection

import numpy as np
from scipy import special

from erosion.arguments import no_progress
from erosion.fits.least_squares import FINEST, THINNED, FitProblem, FitSolution
from erosion.fits.tempering import Misfit, sample

_POPULATION = 256
_WIDE = np.log(100.0)  # of the scale of data in units of its own, which has no bounds
_STEEP = 20  # power of the squares by which draws that explain too little lose their likelihood


class _Fit(Misfit):
    """The rows of a fit, under the same density everywhere within its bounds of θ.

    A scatter that is not known has the value that suits each θ best: so the density falls with the sum of squares to
    the power -rows/2, and about a single minimum the draws have Student's law, like the intervals of the fit. Where
    the rows scatter much, this density is not small where nearly nothing is removed, and there are many such θ. So a
    draw must explain half of the squares that the fit explains.

    A robust loss counts as the squares that are tangent to it at the fit: it rises so little far off that draws would
    be anywhere. Of very many rows some stand for all, by their distance from the fit.
    """

    def __init__(self, problem: FitProblem, solution: FitSolution, moving: np.ndarray) -> None:
        whole, rows = problem.data, problem.data.some(THINNED)
        self._forward, self._theta, self._moving = problem.forward, solution.theta, moving
        fitted, _ = problem.forward.predict(solution.theta, whole.conditions)
        residuals = whole.over_errors(fitted - whole.erosion)
        weights, least = problem.weights(residuals), 2 * solution.cost
        most = least + float(np.sum(weights * (whole.over_errors(whole.erosion) ** 2 - residuals**2)))
        self._enough = (least + max(least, most)) / 2
        self._rows, self._known = len(whole), whole.uncertainty is not None
        is_part = len(rows) < len(whole)
        target = fitted if is_part else whole.erosion
        self._least = least if is_part else least - float(np.sum(weights * residuals**2))
        self._data, self._target = whole.of_rows(rows), target[rows]
        if is_part and self._data.common is not None:  # which does not grow with the rows
            common = self._data.common * np.sqrt(len(whole) / len(rows))
            self._data = dataclasses.replace(self._data, common=common)
        self._weights = weights[rows] * len(whole) / len(rows)
        self._finest = float(np.mean((FINEST * whole.erosion / whole.deviation) ** 2))
        lower, upper, start = problem.lower[moving], problem.upper[moving], problem.start[moving]
        self._lower = np.where(np.isfinite(lower), lower, start - _WIDE)
        self._width = np.where(np.isfinite(upper), upper, start + _WIDE) - self._lower

    @property
    def sizes(self) -> list[int]:
        """All rows are one part."""
        return [self._rows]

    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Misfit`; the unit is that of the weighted residuals."""
        predicted = self._forward.predict_many(self.theta(points), self._data.conditions)
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = self._data.over_errors(predicted - self._target)
            squares = self._least + np.sum(self._weights * residuals**2, axis=-1)
            squares *= np.clip(squares / self._enough, 1.0, 2.0) ** _STEEP
        squares = np.where(np.isfinite(squares), squares, np.inf)
        if self._known:
            return squares, np.ones_like(squares)
        scatter = squares / self._rows
        return squares, np.where(np.isfinite(scatter), scatter, 1.0) + self._finest

    def theta(self, points: np.ndarray) -> np.ndarray:
        """θ at standard normal numbers of those that move, shape (…, names)."""
        theta = np.broadcast_to(self._theta, (*points.shape[:-1], self._theta.size)).copy()
        theta[..., self._moving] = self._lower + self._width * special.ndtr(points)
        return theta


def draws_of_theta(problem: FitProblem, solution: FitSolution, held: Collection[str], count: int) -> np.ndarray:
    """Draws of θ, shape (count, names); always the same for the same rows.

    Args:
        problem: model, rows and bounds.
        solution: the fit.
        held: names of parameters that keep their estimates.
        count: of draws.

    Raises:
        SamplingError: where impacts fail all over the bounds.
    """
    moving = np.array([name not in held for name in problem.forward.names])
    misfit = _Fit(problem, solution, moving)
    shape = (1, max(count, _POPULATION), int(moving.sum()))
    run = sample(misfit, shape, np.random.default_rng(0), lambda points: True, no_progress)
    return misfit.theta(run.points[0, np.linspace(0, shape[1] - 1, count).round().astype(int)])
