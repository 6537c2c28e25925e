"""Discrepancy of a model: an exponent of the speed, and a smooth function of angle and speed, integrated out.

    y = μ (1 + δ) + e,   μ = η(α, v; θ) (v/v_ref)^(n-2) (sin α)^s + ω E_ref (v/v_ref)^n sin²α

η is the model, v_ref the fastest speed of the data, e the error of a row. E_ref is the greatest η of the tests,
brought to v_ref. So ω is the wear at 90° that the model lacks, over the greatest wear: metals wear at 90°, and neither
a model without it nor tests that end before say that they do not. δ is a Gaussian process of two
parts, one of the angle alone and one of angle and speed:

    τ₁² M(Δα/ℓ₁) + τ₂² M(√((Δα/ℓ₂)² + (Δln v/ℓ_v)²)),   M(r) = (1 + √5 r + 5r²/3) exp(-√5 r)

So rows are normal about μ, with the covariance μμᵀ∘K and that of their errors, and nothing of δ need be sampled. An
error that all rows of a speed share adds to the covariance of the rows, but not to that with what is asked for. μ may
be zero, and rows near the error of a balance are no trouble, as no logarithm is taken.

References:
    M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001) 425-464.
    C. E. Rasmussen, C. K. I. Williams, Gaussian processes for machine learning (2006), (2.25), (2.26), (4.17).
    J. G. A. Bitter, A study of erosion phenomena, Wear 6 (1963) 5-21: wear by deformation follows the normal speed.
    Wear at 90° over the greatest one of ductile metals, for the law of ω: 0.60 in DNVGL-RP-O501 (2015), 0.71 in
    Y. Zhang et al., Wear 263 (2007) 330-338, 0.51 to 0.70 in Y. I. Oka et al., Wear 259 (2005) 95-109, 0.41 in
    J. K. Edwards et al., FEDSM 2000, 959-966.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from scipy import special, stats

from erosion.fits.errors import by_common
from erosion.fits.likelihood import LAW_OF_EXPONENT, Likelihood
from erosion.fits.tempering import Misfit
from erosion.laws import JointLaw
from erosion.models import SPEED_EXPONENT
from erosion.ode.batch import in_threads

EXPONENT = "exponent"
"""n, the exponent of the speed."""
_SINE = "sine_exponent"
NORMAL_WEAR = "normal_wear"
"""ω, the wear at 90° that the model lacks, over the greatest wear."""
_OF_ANGLE, _OF_BOTH = ("tau_angle", "length_angle"), ("tau", "length", "length_speed")

PRIORS: Mapping[str, Any] = {
    EXPONENT: LAW_OF_EXPONENT,
    _SINE: stats.norm(0.0, 0.5),
    NORMAL_WEAR: stats.lognorm(np.log(1.8), scale=0.4),
    "tau_angle": stats.lognorm(np.log(1.5), scale=0.4),
    "length_angle": stats.lognorm(np.log(1.6), scale=np.deg2rad(25.0)),
    "tau": stats.lognorm(np.log(1.6), scale=0.07),
    "length": stats.lognorm(np.log(1.6), scale=np.deg2rad(25.0)),
    "length_speed": stats.lognorm(np.log(2.0)),
}
"""Of the exponents and the process; lengths in rad and in ln v. Others of twice the width predict alike."""
_RANGES = {
    EXPONENT: (1.0, 4.0),
    _SINE: (-np.inf, np.inf),
    **dict.fromkeys((NORMAL_WEAR, *_OF_ANGLE, *_OF_BOTH), (0.0, np.inf)),
}

MOST = 200
"""Conditions of one process; nearer ones of more are put together."""
_NUMBERS = 2**17  # of the covariances of a batch: 1 MB, which stays in a core's cache
_FEW = 2**16  # of the covariances that one thread computes sooner
_JITTER, _BLUR = 1e-9, 1e-8  # of a variance, of rows and of curves
_STEP, _COARSER = np.deg2rad(1.0), 1.3  # of angles that are put together, and by which it grows
_SPEED_STEP = 1 / np.deg2rad(25.0)  # of ln v for each of the angle, as the lengths


@dataclasses.dataclass(frozen=True)
class Discrepant(Misfit):
    """The data's likelihood about a model with exponents, and with a discrepancy.

    Args:
        plain: that of the model alone, with at most `MOST` conditions.
        has_exponent: whether the speed's exponent is sampled.
        has_discrepancy: whether there is a process.
    """

    plain: Likelihood
    has_exponent: bool
    has_discrepancy: bool

    @functools.cached_property
    def priors(self) -> JointLaw:
        """The laws of the model's parameters, the errors, the exponents and the process."""
        added = [EXPONENT] * self.has_exponent + [_SINE, NORMAL_WEAR, *_OF_ANGLE, *_OF_BOTH] * self.has_discrepancy
        plain = self.plain.priors
        laws = {**plain.laws, **{name: PRIORS[name] for name in added}}
        return JointLaw(laws).within({**(plain.ranges or {}), **_RANGES})

    @functools.cached_property
    def reference(self) -> float:
        """v_ref, the fastest speed of the data or the case's [m/s]."""
        problem = self.plain.problem
        return float(np.max(problem.data.conditions.get("v0", np.asarray(problem.p.v0))))

    @property
    def sizes(self) -> list[int]:
        """All rows at once."""
        return [len(self.plain.problem.data)]

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """All parameters at standard normal numbers, by name."""
        return self.priors.draw(special.ndtr(points))

    def mean(self, values: Mapping[str, np.ndarray], conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """μ, shape (n, conditions)."""
        model = self.plain.predict(values, conditions)
        mean = model
        if self.has_exponent:
            held = self.plain.problem.held_exponent
            assert held is not None
            mean = mean * np.exp(np.multiply.outer(values[EXPONENT] - held, self._log_speed(conditions)))
        if self.has_discrepancy:
            sine = np.sin(conditions["alpha"])
            mean = mean * np.exp(np.multiply.outer(values[_SINE], np.log(sine)))
            known = self.plain.parts[0].conditions
            greatest = self._greatest(values, model if conditions is known else self.plain.predict(values, known))
            powers = np.exp(np.multiply.outer(self._exponents(values), self._log_speed(conditions)))
            mean = mean + (values[NORMAL_WEAR] * greatest)[:, None] * sine**2 * powers * self._mass(conditions)
        return mean

    def _exponents(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The exponent of the speed, shape (n,)."""
        held = self.plain.problem.held_exponent
        own = values.get(SPEED_EXPONENT, np.full(len(values[NORMAL_WEAR]), 2.0 if held is None else held))
        return values.get(EXPONENT, own)

    def _greatest(self, values: Mapping[str, np.ndarray], model: np.ndarray) -> np.ndarray:
        """E_ref, shape (n,), of what the model removes at the conditions of the data, shape (n, conditions)."""
        known = self.plain.parts[0].conditions
        held = self.plain.problem.held_exponent
        powers = values[SPEED_EXPONENT] if held is None else np.full(len(model), held)
        at_reference = model * np.exp(np.multiply.outer(-powers, self._log_speed(known))) / self._mass(known)
        return at_reference.max(axis=1)

    def _mass(self, conditions: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """The mass of each condition over that of the case, where the erosion is that of one impact; else 1."""
        problem = self.plain.problem
        return 1.0 if problem.data.per_mass or "m" not in conditions else conditions["m"] / float(np.max(problem.p.m))

    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        """See `Misfit`; the unit of squares is that of `deviation`."""
        pooled, values, count = self.plain.parts[part], self.values(points), len(points)
        with np.errstate(over="ignore", invalid="ignore"):
            mean = self.mean(values, pooled.conditions)
            variances = self.plain.variances(values, mean, pooled)
            variances = np.ones_like(mean) if variances is None else variances
            works = np.isfinite(mean).all(axis=1) & (np.isfinite(variances) & (variances > 0)).all(axis=1)
        chi2, variance = np.full(count, np.inf), np.ones(count)
        rows = np.flatnonzero(works)
        values = {name: column[rows] for name, column in values.items()}
        mean, variances = mean[rows], variances[rows]
        of_process, logs = self._of_process(values, mean, variances)
        # What the rows of a condition say beside their mean.
        of_process += np.sum(pooled.spread / variances, axis=1)
        logs += np.log(variances) @ (pooled.counts - 1)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            variance[rows] = np.exp(logs / pooled.rows)
            chi2[rows] = of_process * variance[rows]
        fails = ~(np.isfinite(chi2) & np.isfinite(variance) & (variance > 0))
        return np.where(fails, np.inf, chi2), np.where(fails, 1.0, variance)

    def _of_process(
        self, values: Mapping[str, np.ndarray], mean: np.ndarray, variances: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """χ² of the conditions' means, and the logarithm of their covariance's determinant in units of `deviation`."""
        pooled = self.plain.parts[0]
        if not self.has_discrepancy:
            residuals = (mean - pooled.mean) / pooled.deviation / np.sqrt(variances)
            chi2, logs = np.sum(residuals**2, axis=1), np.log(variances).sum(axis=1)
            common = self.plain.common(values, mean, pooled)
            if common is None:
                return chi2, logs
            taken, added = by_common(residuals, common / np.sqrt(variances), pooled.speeds)
            return chi2 - taken, logs + added
        chi2, logs = np.empty((2, len(mean)))

        def fill(batch: np.ndarray, _: Any) -> None:
            some = {name: column[batch] for name, column in values.items()}
            factor, whitened, size = self._factored(some, mean[batch], variances[batch])
            chi2[batch] = np.sum(whitened**2, axis=1)
            diagonal = np.diagonal(factor, axis1=1, axis2=2)
            logs[batch] = 2 * np.sum(np.log(diagonal) + np.log(size / pooled.deviation), axis=1)

        count = len(pooled.mean)
        in_threads(fill, np.arange(len(mean)), _batch(count), _FEW // count**2)
        return chi2, logs

    def _factored(
        self, values: Mapping[str, np.ndarray], mean: np.ndarray, variances: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """L of LLᵀ = C/(s sᵀ), L⁻¹ of the residuals over s, and s, the size of each condition's mean."""
        pooled = self.plain.parts[0]
        count = len(pooled.mean)
        error = variances * pooled.deviation**2
        size = np.sqrt(mean**2 + error)
        scaled = mean / size
        joint = np.empty((len(size), count + 1, count + 1))
        joint[:, :count, :count] = self._process(values)
        joint[:, :count, :count] *= scaled[:, :, None] * scaled[:, None, :]
        common = self.plain.common(values, mean, pooled)
        if common is not None:
            shared = common * pooled.deviation / size
            is_of_one = pooled.speeds[:, None] == pooled.speeds
            joint[:, :count, :count] += is_of_one * shared[:, :, None] * shared[:, None, :]
        places = np.arange(count)
        joint[:, places, places] = joint[:, places, places] * (1 + _JITTER) + error / size**2 + _JITTER
        # The last row of the factor is the residuals' L⁻¹.
        joint[:, count, :count] = joint[:, :count, count] = (pooled.mean - mean) / size
        joint[:, count, count] = 1e300
        factor = np.linalg.cholesky(joint)
        return factor[:, :count, :count], factor[:, count, :count], size

    @functools.cached_property
    def _process(self) -> Callable[[Mapping[str, np.ndarray]], np.ndarray]:
        """The covariance of the data's conditions."""
        return self._between(self.plain.parts[0].conditions)

    def draw(
        self, values: Mapping[str, np.ndarray], conditions: Mapping[str, np.ndarray], rng: np.random.Generator
    ) -> np.ndarray:
        """The erosion without error at conditions, a curve of the process for each draw.

        Args:
            values: of all parameters, shape (n,).
            conditions: as for `Likelihood.predict`, shape (rows,).
            rng: of the curves.

        Returns:
            Shape (n, rows); zero or more.
        """
        asked = self.mean(values, conditions)
        if not self.has_discrepancy:
            return asked
        there, index = self._distinct(conditions)
        discrepancy = np.empty((len(asked), len(there["alpha"])))
        for batch, middle, left in self._at_questions(values, there):
            curves = np.linalg.cholesky(left) @ rng.standard_normal((*middle.shape, 1))
            discrepancy[batch] = middle + curves[:, :, 0]
        return asked * np.maximum(1 + discrepancy[:, index], 0.0)

    def _distinct(self, conditions: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """The angles and speeds of conditions, each once, and where each condition is: these have one δ."""
        places = np.stack([conditions["alpha"], self._log_speed(conditions)])
        distinct, index = np.unique(places, axis=1, return_inverse=True)
        return {"alpha": distinct[0], "log_speed": distinct[1]}, index.ravel()

    def _at_questions(
        self, values: Mapping[str, np.ndarray], there: Mapping[str, np.ndarray]
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """In batches of draws, δ after the data: its mean, shape (n, conditions), and its covariance."""
        pooled, known = self.plain.parts[0], self.mean(values, self.plain.parts[0].conditions)
        variances = self.plain.variances(values, known, pooled)
        variances = np.ones_like(known) if variances is None else variances
        own, across = self._between(there), self._between(there, pooled.conditions)
        places = np.arange(len(there["alpha"]))
        step = _batch(max(len(places), len(pooled.mean)))
        for start in range(0, len(known), step):
            batch = slice(start, start + step)
            of_batch = {name: column[batch] for name, column in values.items()}
            factor, whitened, size = self._factored(of_batch, known[batch], variances[batch])
            tie = across(of_batch) * (known[batch] / size)[:, None, :]
            tie = np.linalg.solve(factor, tie.swapaxes(1, 2))
            left = own(of_batch) - tie.swapaxes(1, 2) @ tie
            left[:, places, places] += (
                _BLUR * np.sum([of_batch[name] ** 2 for name in ("tau_angle", "tau")], axis=0)[:, None]
            )
            yield batch, np.einsum("nij,ni->nj", tie, whitened), left

    def _log_speed(self, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """ln(v/v_ref), shape (conditions,)."""
        if "log_speed" in conditions:
            return conditions["log_speed"]
        speed = conditions.get("v0", np.asarray(float(np.max(self.plain.problem.p.v0))))
        return np.broadcast_to(np.log(speed / self.reference), np.shape(conditions["alpha"]))

    def _between(
        self, here: Mapping[str, np.ndarray], there: Mapping[str, np.ndarray] | None = None
    ) -> Callable[[Mapping[str, np.ndarray]], np.ndarray]:
        """The process' covariance between two sets of conditions, as a function of the parameters' values."""
        there = here if there is None else there
        apart = np.abs(np.subtract.outer(here["alpha"], there["alpha"]))
        faster = np.abs(np.subtract.outer(self._log_speed(here), self._log_speed(there)))
        # Angles and speeds repeat, so that few distances are distinct.
        pairs, index = np.unique(np.round([apart.ravel(), faster.ravel()], 12), axis=1, return_inverse=True)
        return functools.partial(_covariance, pairs, index.reshape(apart.shape))


def _covariance(pairs: np.ndarray, index: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Of δ, where `index` says which of the `pairs` of distances, in angle and ln v, each of its elements has."""
    part = {name: values[name][:, None] for name in (*_OF_ANGLE, *_OF_BOTH)}
    of_angle = part["tau_angle"] ** 2 * _matern(pairs[0] / part["length_angle"])
    both = np.hypot(pairs[0] / part["length"], pairs[1] / part["length_speed"])
    return (of_angle + part["tau"] ** 2 * _matern(both))[:, index]


def _matern(distance: np.ndarray) -> np.ndarray:
    """Matérn's function of index 5/2."""
    scaled = np.sqrt(5) * distance
    return (1 + scaled + scaled**2 / 3) * np.exp(-scaled)


def _batch(conditions: int) -> int:
    """Draws whose covariances are in memory at once."""
    return max(_NUMBERS // (conditions + 1) ** 2, 1)


def with_few_conditions(likelihood: Likelihood, most: int = MOST) -> Likelihood:
    """The same rows, where there are more than `most` conditions with near ones put at their mean."""
    data, log_steps = likelihood.problem.data, {"alpha": _STEP, "v0": _STEP * _SPEED_STEP, "m": 3 * _STEP * _SPEED_STEP}
    columns, places = data.conditions, data.at_conditions()[1]
    while places.max() >= most:
        cells = [np.floor((column if name == "alpha" else np.log(column)) / log_steps[name])
                 for name, column in columns.items()]  # fmt: skip
        cells += [] if data.speeds is None else [data.speeds]
        places = np.unique(np.stack(cells), axis=1, return_inverse=True)[1].ravel()
        log_steps = {name: step * _COARSER for name, step in log_steps.items()}
    if places.max() + 1 == data.at_conditions()[0].shape[1]:
        return likelihood
    counts = np.bincount(places)
    middle = {name: (np.bincount(places, column) / counts)[places] for name, column in columns.items()}
    rows = dataclasses.replace(data, angle=middle["alpha"], speed=middle.get("v0"), mass=middle.get("m")).weighed()
    return dataclasses.replace(likelihood, problem=dataclasses.replace(likelihood.problem, data=rows))
