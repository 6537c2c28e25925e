"""Draws of what a fit leaves open: parameters that explain the rows as well as their scatter allows."""

import numpy as np
from scipy import special

from erosion.arguments import no_progress
from erosion.fits.least_squares import FitProblem
from erosion.fits.tempering import Misfit, sample

_POPULATION = 256
_FINEST = 1e-4  # scatter over the typical erosion: the digits of a balance
_WIDE = np.log(100.0)  # of the scale of data in units of its own, which has no bounds


class _Fit(Misfit):
    """The rows of a fit, under the same density everywhere within its bounds of θ.

    A scatter that is not known has the value that suits each θ best: so the density falls with the sum of squares to
    the power -rows/2, and about a single minimum the draws have Student's law, like the intervals of the fit.
    """

    def __init__(self, problem: FitProblem) -> None:
        # As for the choice among valleys: of very many rows some say enough.
        self._problem = problem.thinned()
        lower, upper, start = problem.lower, problem.upper, problem.start
        self._lower = np.where(np.isfinite(lower), lower, start - _WIDE)
        self._width = np.where(np.isfinite(upper), upper, start + _WIDE) - self._lower

    @property
    def sizes(self) -> list[int]:
        """All rows are one part."""
        return [len(self._problem.data)]

    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Misfit`; the unit is that of the weighted residuals."""
        squares = 2 * self._problem.costs(self.theta(points))
        data = self._problem.data
        if data.uncertainty is not None:
            return squares, np.ones_like(squares)
        scatter = squares / len(data)
        finest = float(np.mean((_FINEST * data.erosion / data.deviation) ** 2))
        return squares, np.where(np.isfinite(scatter), scatter, 1.0) + finest

    def theta(self, points: np.ndarray) -> np.ndarray:
        """θ at standard normal numbers, shape (…, names)."""
        return self._lower + self._width * special.ndtr(points)


def draws_of_theta(problem: FitProblem, count: int) -> np.ndarray:
    """Draws of θ, shape (count, names); always the same for the same rows.

    Raises:
        SamplingError: where impacts fail all over the bounds.
    """
    misfit = _Fit(problem)
    shape = (1, max(count, _POPULATION), len(problem.start))
    run = sample(misfit, shape, np.random.default_rng(0), lambda points: True, no_progress)
    return misfit.theta(run.points[0, np.linspace(0, shape[1] - 1, count).round().astype(int)])
