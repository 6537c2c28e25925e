"""Likelihood of rows with normal errors, and priors of a model's parameters.

A row differs from the model by a normal error: of the row's uncertainty, or of an unknown size with an absolute and a
relative part.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import special, stats

from erosion.fits.errors import by_common, of_which
from erosion.fits.least_squares import default_width, make_squares
from erosion.fits.problem import ERROR_FACTOR, FACTORS, FRACTION, NOISE, RELATIVE, SCALE, FitProblem
from erosion.fits.tempering import Misfit
from erosion.laws import LAWS, JointLaw
from erosion.models import SPEED_EXPONENT, SpeedExponent, quantities
from erosion.parameters import Quantity

_NOISES = {NOISE: (1e-4, 10.0), RELATIVE: (1e-4, 1.0)}
"""Of the typical erosion, and of each: from the digits of a balance to a model that explains nothing."""


def flat_laws(problem: FitProblem, bounds: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """Laws by which all θ between bounds are alike."""
    are_logs = dict(zip(problem.names, problem.logarithmic, strict=True))
    return {name: LAWS["loguniform" if are_logs[name] else "uniform"](*ends) for name, ends in bounds.items()}


def given_laws(problem: FitProblem) -> dict[str, Any]:
    """The laws of parameters that a user gives, by priors or by bounds."""
    return {**flat_laws(problem, problem.bounds), **problem.priors}


def make_likelihood(problem: FitProblem) -> "Likelihood":
    """The data's likelihood under the problem's priors and bounds, and for all other parameters under default laws.

    The default is as wide as a fit looks for a parameter: all factors from 1/100 to 100 of the fit's first guess are
    alike: of the case's value, but of ψ or σ of the value that gives the data's size. A spin may differ from the case's
    by 2 v₀/r; a share of particles is anything up to 1. The scale of data in units of its own, and the noise, have a
    size that only the data know: their defaults are wide laws about it. A factor on the uncertainties is sampled if a
    law is given for it.
    """
    given = given_laws(problem)
    names = tuple(name for name in (*problem.names, *problem.of_error) if name != ERROR_FACTOR or name in given)
    laws = {name: given[name] if name in given else _default(problem, name) for name in names}
    return Likelihood(problem, problem.joint_law(laws), tuple(given))


LAW_OF_EXPONENT = stats.norm(2.4, 0.3)
"""Of an exponent of the speed before the data, as metals have it."""


def sampled_quantities(problem: FitProblem) -> dict[str, Quantity]:
    """Symbol, meaning and dimension of all parameters that may be sampled."""
    of_error = {
        NOISE: Quantity("s_n", "absolute part of a row's standard deviation", problem.data.dimension),
        RELATIVE: Quantity("s_r", "part of a row's standard deviation that grows with the erosion", "1"),
        ERROR_FACTOR: Quantity("f", "true over stated errors", "1"),
    }
    return {**quantities(problem.model), **FACTORS, **of_error}


def _default(problem: FitProblem, name: str) -> Any:
    if name == FRACTION:
        return stats.uniform(0.0, 1.0)
    if name == SPEED_EXPONENT and isinstance(problem.model, SpeedExponent):
        return LAW_OF_EXPONENT
    typical = float(np.sqrt(np.mean(problem.data.erosion**2)))
    if name in _NOISES:
        low, high = np.array(_NOISES[name]) * (typical if name == NOISE else 1.0)
        return stats.loguniform(low, high)
    at = problem.names.index(name)
    start, width = problem.start[at], default_width(problem)[at]
    if problem.logarithmic[at]:
        start = make_squares(dataclasses.replace(problem, bounds={})).start[at]
    if name == SCALE:
        computed = np.nan_to_num(problem.predict_many(problem.start[None], problem.data.conditions)[0])
        size = float(np.sqrt(np.mean(computed**2)))
        start = np.log(typical / size if size > 0 else 1.0)
    low, high = problem.limits[at]
    low, high = (start - width if low == -np.inf else low), (start + width if high == np.inf else high)
    ends = float(problem.from_theta(name, low)), float(problem.from_theta(name, high))
    return flat_laws(problem, {name: ends})[name]


IMPACTS = 2**20
"""Impacts of one batch: some 100 MB."""

_RTOL = 1e-6  # of the volumes: a hundredth of the least default noise, and twice as fast as 1e-9
_FIRST = 500  # conditions of the first part, as many as choose among the valleys of a fit
_GROWTH = 5  # of the conditions from part to part


@dataclasses.dataclass(frozen=True)
class _RowPart:
    """Rows that come in together. Those of the same conditions are one impact, and their mean says all of a model.

    Args:
        conditions: the distinct ones, each parameter of the shape (conditions,).
        mean: erosion, weighted by the rows' uncertainties, shape (conditions,).
        deviation: of this mean, shape (conditions,).
        spread: the sum of squares of the rows about their mean, shape (conditions,).
        counts: number of rows, shape (conditions,).
        parts: of a row's error over its `deviation`, shape (conditions, 2); None where it is one number.
        speeds: which speed each condition has, shape (conditions,).
    """

    conditions: dict[str, np.ndarray]
    mean: np.ndarray
    deviation: np.ndarray
    spread: np.ndarray
    counts: np.ndarray
    parts: np.ndarray | None
    speeds: np.ndarray

    @property
    def rows(self) -> int:
        """The number of all rows."""
        return int(self.counts.sum())


@dataclasses.dataclass(frozen=True)
class Likelihood(Misfit):
    """The squares of a model's residuals, part by part of the rows.

    Many conditions are added in parts: while the sampler is far from the answer, few of them say where to go.

    Args:
        problem: the model, and the data.
        priors: the laws of the sampled parameters; those of the error come last.
        chosen: the parameters whose laws the user gave; the others are defaults.
    """

    problem: FitProblem
    priors: JointLaw
    chosen: tuple[str, ...]

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters at standard normal numbers, shape (…, names), by name; each of the shape (…)."""
        return self.priors.draw(special.ndtr(points))

    @property
    def constant(self) -> float:
        """The constant of the log-likelihood beside the squares over the data's `deviation`."""
        return -float(np.sum(np.log(self.problem.data.deviation) + 0.5 * np.log(2 * np.pi)))

    @functools.cached_property
    def parts(self) -> list["_RowPart"]:
        """The rows of each part, by conditions, in an order of chance that is always the same."""
        data = self.problem.data
        values, places = data.at_conditions()
        count = values.shape[1]
        weights = data.deviation**-2
        weight = np.bincount(places, weights, count)
        mean = np.bincount(places, weights * data.erosion, count) / weight
        spread = np.bincount(places, weights * (data.erosion - mean[places]) ** 2, count)
        rows = np.bincount(places, minlength=count)
        first = np.unique(places, return_index=True)[1]
        parts = None if data.parts is None else (data.parts / data.deviation[:, None])[first]
        # Rows that share an error say nothing one without the other.
        ends, end = [], _FIRST if data.speeds is None else count
        while end < count:
            ends.append(end)
            end *= _GROWTH
        return [
            _RowPart(
                dict(zip(data.conditions, values[:, chosen], strict=True)),
                mean[chosen],
                weight[chosen] ** -0.5,
                spread[chosen],
                rows[chosen],
                None if parts is None else parts[chosen],
                np.zeros(len(chosen), int) if data.speeds is None else data.speeds[first][chosen],
            )
            for chosen in np.split(np.random.default_rng(0).permutation(count), ends)
        ]

    @property
    def sizes(self) -> list[int]:
        """The number of rows of each part."""
        return [part.rows for part in self.parts]

    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Misfit`; the unit of squares is that of `deviation`."""
        pooled, values = self.parts[part], self.values(points)
        predicted = self.predict(values, pooled.conditions)
        variances, common = self.variances(values, predicted, pooled), self.common(values, predicted, pooled)
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = (predicted - pooled.mean) / pooled.deviation
            if variances is None and common is None:
                chi2, variance = float(pooled.spread.sum()) + np.sum(residuals**2, axis=1), np.ones(len(points))
            else:
                variances = np.ones_like(predicted) if variances is None else variances
                chi2 = np.sum((residuals**2 + pooled.spread) / variances, axis=1)
                logs = np.log(variances) @ pooled.counts
                if common is not None:
                    taken, added = by_common(residuals / np.sqrt(variances), common / np.sqrt(variances), pooled.speeds)
                    chi2, logs = chi2 - taken, logs + added
                variance = np.exp(logs / pooled.rows)
                chi2 = chi2 * variance
        failed = np.isnan(chi2) | ~(np.isfinite(variance) & (variance > 0))
        return np.where(failed, np.inf, chi2), np.where(failed, 1.0, variance)

    def variances(
        self, values: Mapping[str, np.ndarray], predicted: np.ndarray, pooled: "_RowPart"
    ) -> np.ndarray | None:
        """The variance of a row of each condition over that of `deviation`, shape (n, conditions); None for ones.

        Args:
            values: of the sampled parameters, shape (n,).
            predicted: the erosion that is expected, shape (n, conditions).
            pooled: the rows.
        """
        data = self.problem.data
        if data.uncertainty is None:
            absolute, relative = (values[name][:, None] for name in (NOISE, RELATIVE))
            return (absolute**2 + (relative * predicted) ** 2) / data.deviation[0] ** 2
        factor = values[ERROR_FACTOR][:, None] ** 2 if ERROR_FACTOR in values else None
        if pooled.parts is not None:
            own = pooled.parts[:, 0] ** 2 + (pooled.parts[:, 1] * of_which(predicted, pooled.mean)) ** 2
            return own if factor is None else factor * own
        return None if factor is None else np.broadcast_to(factor, predicted.shape)

    def common(self, values: Mapping[str, np.ndarray], predicted: np.ndarray, pooled: "_RowPart") -> np.ndarray | None:
        """The error that all of a speed share over the `deviation` of each mean, shape (n, conditions); None without.

        Arguments as of `variances`.
        """
        share = self.problem.data.share_of_speeds
        if not share:
            return None
        factor = values[ERROR_FACTOR][:, None] if ERROR_FACTOR in values else 1.0
        return factor * share * np.abs(predicted) / pooled.deviation

    def chi2(self, points: np.ndarray) -> np.ndarray:
        """χ² of all rows at points, shape (n, names) -> (n,)."""
        of_parts = [self.squares(points, part) for part in range(len(self.parts))]
        return np.sum([squares / variance for squares, variance in of_parts], axis=0)

    def predict(self, values: Mapping[str, np.ndarray], conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """The erosion without noise, shape (points, rows), in batches that the memory holds.

        Args:
            values: of all sampled parameters, shape (points,).
            conditions: parameters that vary from row to row, each of shape (rows,).
        """
        count, rows = len(next(iter(values.values()))), len(conditions["alpha"])
        size = max(IMPACTS // rows, 1)
        of_model = {name: values[name] for name in self.problem.names}
        parts = [{name: column[i : i + size] for name, column in of_model.items()} for i in range(0, count, size)]
        return np.concatenate([self.problem.erosion(part, conditions, _RTOL) for part in parts])
