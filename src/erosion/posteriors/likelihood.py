"""How likely data are at many values of the parameters: one batch of impacts, rows times points.

A row differs from the model by a normal error: of the row's uncertainty, or of one unknown size. This is what a least-
squares fit assumes, too.
"""

import dataclasses
import functools

import numpy as np

from erosion.calibration.forward import Forward
from erosion.posteriors.priors import NOISE, Priors
from erosion.posteriors.tempering import Misfit

IMPACTS = 2**20
"""Impacts of one batch: some 100 MB."""

_RTOL = 1e-6  # of the volumes: a hundredth of the least default noise, and twice as fast as 1e-9
_FIRST = 500  # conditions of the first part, as many as choose among the valleys of a fit
_GROWTH = 5  # of the conditions from part to part


@dataclasses.dataclass(frozen=True)
class _Part:
    """Rows that come in together. Those of the same conditions are one impact, and their mean says all of a model.

    Args:
        conditions: the distinct ones, each parameter of the shape (conditions,).
        mean: erosion, weighted by the rows' uncertainties, shape (conditions,).
        deviation: of this mean, shape (conditions,).
        spread: the sum of squares of all rows about their means.
        rows: number of all rows.
    """

    conditions: dict[str, np.ndarray]
    mean: np.ndarray
    deviation: np.ndarray
    spread: float
    rows: int


@dataclasses.dataclass(frozen=True)
class Likelihood(Misfit):
    """The squares of a model's residuals, part by part of the rows.

    Many conditions are added in parts: while the sampler is far from the answer, few of them say where to go.

    Args:
        forward: the model, and the data.
        priors: of the sampled parameters.
    """

    forward: Forward
    priors: Priors

    @functools.cached_property
    def deviation(self) -> np.ndarray:
        """The divisor of residuals, shape (rows,): the uncertainties, or the typical erosion without them."""
        data = self.forward.data
        if data.uncertainty is not None:
            return data.uncertainty
        return np.full(len(data), float(np.sqrt(np.mean(data.erosion**2))))

    @property
    def constant(self) -> float:
        """What squares over `deviation` leave out of the log-likelihood."""
        return -float(np.sum(np.log(self.deviation) + 0.5 * np.log(2 * np.pi)))

    @functools.cached_property
    def parts(self) -> list["_Part"]:
        """The rows of each part, by conditions, in an order of chance that is always the same."""
        data = self.forward.data
        values, places = np.unique(np.stack(list(data.conditions.values())), axis=1, return_inverse=True)
        count = values.shape[1]
        weights = self.deviation**-2
        weight = np.bincount(places.ravel(), weights, count)
        mean = np.bincount(places.ravel(), weights * data.erosion, count) / weight
        spread = np.bincount(places.ravel(), weights * (data.erosion - mean[places.ravel()]) ** 2, count)
        rows = np.bincount(places.ravel(), minlength=count)
        ends, end = [], _FIRST
        while end < count:
            ends.append(end)
            end *= _GROWTH
        return [
            _Part(
                dict(zip(data.conditions, values[:, chosen], strict=True)),
                mean[chosen],
                weight[chosen] ** -0.5,
                float(spread[chosen].sum()),
                int(rows[chosen].sum()),
            )
            for chosen in np.split(np.random.default_rng(0).permutation(count), ends)
        ]

    @property
    def sizes(self) -> list[int]:
        """The number of rows of each part."""
        return [part.rows for part in self.parts]

    def chi2(self, points: np.ndarray, part: int) -> np.ndarray:
        """The sum of squares of one part at points (n, names), of the shape (n,); infinite where impacts fail."""
        pooled = self.parts[part]
        predicted = self.predict(self.priors.values(points), pooled.conditions)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = pooled.spread + np.sum(((predicted - pooled.mean) / pooled.deviation) ** 2, axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def variance(self, points: np.ndarray) -> np.ndarray:
        """The variance of a row over that of `deviation`, shape (n,)."""
        if self.forward.data.uncertainty is not None:
            return np.ones(len(points))
        return (self.priors.values(points)[NOISE] / self.deviation[0]) ** 2

    def predict(self, values: dict[str, np.ndarray], conditions: dict[str, np.ndarray]) -> np.ndarray:
        """The erosion without noise, shape (points, rows), in batches that the memory holds.

        Args:
            values: of all sampled parameters, shape (points,).
            conditions: parameters that vary from row to row, each of shape (rows,).
        """
        count, rows = len(next(iter(values.values()))), len(conditions["alpha"])
        size = max(IMPACTS // rows, 1)
        of_model = {name: column for name, column in values.items() if name != NOISE}
        parts = [{name: column[i : i + size] for name, column in of_model.items()} for i in range(0, count, size)]
        return np.concatenate([self.forward.erosion(part, conditions, _RTOL) for part in parts])
