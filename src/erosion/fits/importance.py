"""Adaptive importance sampling: draws and evidence from a few thousand likelihoods, where the posterior has one mode.

Draws come from Student's law about the mode, with the inverse of the curvature there, and count by their weights. Each
round fits the next law to the weighted draws, and all draws count under the mixture of all laws so far. So no draw is
lost, and a law that was too narrow does no harm.

References:
    J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert, Adaptive multiple importance sampling, Scand. J. Stat. 39 (2012)
    798-812.
"""

import dataclasses
import functools

import numpy as np
from scipy import optimize, special

from erosion.fits.tempering import Misfit


@dataclasses.dataclass(frozen=True)
class _Settings:
    """How the law is found and refined; points are standard normal numbers."""

    furthest: float = 4.0  # of the mode from the middle of the prior, where a bound is the best value
    end: float = 8.0  # of the prior, in rounded shares of it
    slope_step: float = 0.02  # wide enough for jumps of V(α), and narrow beside a sharp posterior
    first_step: float = 0.05  # of the curvature; the second one is a standard deviation of the first
    least_precision: float = 0.5  # the prior alone has 1; less would be a likelihood that bends up
    freedom: float = 5.0  # of Student's law, whose tails are heavier than those of posteriors
    draws: int = 1000  # of a round
    rounds: int = 4
    most_rounds: int = 12
    enough: float = 500.0  # effective draws


SETTINGS = _Settings()


@dataclasses.dataclass(frozen=True)
class Weighted:
    """Draws with weights.

    Args:
        points: standard normal numbers, shape (n, names).
        log_weights: shape (n,); -∞ where impacts fail.
    """

    points: np.ndarray
    log_weights: np.ndarray

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """Their sum is 1, shape (n,)."""
        return special.softmax(self.log_weights)

    @property
    def effective(self) -> float:
        """The number of draws of equal weights that know a mean as well."""
        return float(1 / np.sum(self.weights**2))

    @property
    def log_evidence(self) -> float:
        """The logarithm of the evidence, without the constant of the unit of squares."""
        return float(special.logsumexp(self.log_weights) - np.log(len(self.log_weights)))

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance."""
        mean = self.weights @ self.points
        apart = self.points - mean
        return mean, (apart * self.weights[:, None]).T @ apart

    def chosen(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """As many points by their weights, in an order of chance, shape (count, names)."""
        marks = (np.arange(count) + rng.random()) / count
        places = np.minimum(np.searchsorted(np.cumsum(self.weights), marks), len(self.weights) - 1)
        return self.points[rng.permutation(places)]


@dataclasses.dataclass(frozen=True)
class _Student:
    """Student's law of several numbers.

    Args:
        mean: shape (names,).
        factor: L of the covariance LLᵀ of its normal law, shape (names, names).
    """

    mean: np.ndarray
    factor: np.ndarray

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Points, shape (count, names)."""
        normal = rng.standard_normal((count, len(self.mean)))
        shrink = np.sqrt(rng.chisquare(SETTINGS.freedom, count) / SETTINGS.freedom)
        return self.mean + (normal / shrink[:, None]) @ self.factor.T

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Over that of the standard normal law at its middle, shape (n,)."""
        freedom, names = SETTINGS.freedom, len(self.mean)
        squares = np.sum(np.linalg.solve(self.factor, (points - self.mean).T) ** 2, axis=0)
        constant = (
            special.gammaln((freedom + names) / 2) - special.gammaln(freedom / 2) - names / 2 * np.log(freedom / 2)
        )
        tails = (freedom + names) / 2 * np.log1p(squares / freedom)
        return constant - np.sum(np.log(np.diag(self.factor))) - tails


def sample_near(misfit: Misfit, start: np.ndarray, rng: np.random.Generator) -> Weighted:
    """Weighted draws of the posterior; `Weighted.effective` says whether one law about the mode is near to it.

    Args:
        misfit: the data, under standard normal priors.
        start: from where the mode is looked for, standard normal numbers, shape (names,).
        rng: of all random numbers.
    """
    mode = _mode(misfit, start)
    rough = np.linalg.inv(_precision(misfit, mode, np.full(len(mode), SETTINGS.first_step)))
    steps = np.clip(np.sqrt(np.diag(rough)), SETTINGS.first_step / 10, 1.0)
    covariance = np.linalg.inv(_precision(misfit, mode, steps))
    laws, points, logs = [_Student(mode, np.linalg.cholesky(covariance))], [], []
    while True:
        points.append(laws[-1].draw(SETTINGS.draws, rng))
        is_near = np.abs(points[-1]).max(axis=1) <= SETTINGS.end
        inside = np.where(is_near[:, None], points[-1], mode)
        logs.append(np.where(is_near, misfit.log_density(inside), -np.inf))
        there = np.concatenate(points)
        mixed = special.logsumexp([law.log_density(there) for law in laws], axis=0) - np.log(len(laws))
        drawn = Weighted(there, np.concatenate(logs) - mixed)
        rounds = len(laws)
        is_enough = rounds >= SETTINGS.rounds and drawn.effective >= SETTINGS.enough
        if is_enough or rounds == SETTINGS.most_rounds or not np.isfinite(drawn.log_weights).any():
            return drawn
        mean, spread = drawn.moments()
        # Few draws span no law of their own: the first one keeps its part.
        share = len(mean) / (len(mean) + drawn.effective)
        laws.append(_Student(mean, np.linalg.cholesky((1 - share) * spread + share * covariance)))


def _mode(misfit: Misfit, start: np.ndarray) -> np.ndarray:
    """The most likely point, by slopes over steps as wide as jumps of V(α) allow."""
    step = SETTINGS.slope_step * np.eye(len(start))

    def value(point: np.ndarray) -> tuple[float, np.ndarray]:
        logs = misfit.log_density(np.vstack([point, point + step, point - step]))
        logs = np.where(np.isfinite(logs), logs, -1 / np.finfo(float).eps)
        there, above, below = logs[0], *np.split(logs[1:], 2)
        return -there, (below - above) / (2 * SETTINGS.slope_step)

    bounds = [(-SETTINGS.furthest, SETTINGS.furthest)] * len(start)
    begin = np.clip(start, *bounds[0])
    return optimize.minimize(value, begin, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-7}).x


def _precision(misfit: Misfit, mode: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Minus the second differences of the logarithm of the density, made positive; shape (names, names)."""
    names, shifts = len(mode), np.diag(steps)
    first, second = np.tril_indices(names)
    pairs = np.concatenate([shifts[first] + shifts[second], -shifts[first] - shifts[second]])
    logs = misfit.log_density(mode + np.concatenate([np.zeros((1, names)), shifts, -shifts, pairs]))
    there, alone = logs[0], logs[1 : 1 + 2 * names].reshape(2, names).sum(axis=0)
    both = logs[1 + 2 * names :].reshape(2, -1).sum(axis=0)
    bend = np.zeros((names, names))
    with np.errstate(invalid="ignore"):  # beside points at which impacts fail
        bend[first, second] = bend[second, first] = (alone[first] + alone[second] - both - 2 * there) / 2
        bend[np.diag_indices(names)] = 2 * there - alone
    values, vectors = np.linalg.eigh(np.nan_to_num(bend / np.outer(steps, steps), posinf=0.0, neginf=0.0))
    return (vectors * np.maximum(values, SETTINGS.least_precision)) @ vectors.T
