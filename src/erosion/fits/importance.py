"""Adaptive importance sampling: draws and evidence from a few thousand likelihoods, where the posterior has few modes.

Draws come from the prior and from Student's law about each mode, with the inverse of the curvature there, and count by
their weights. Each round fits the next law to the weighted draws, and all draws count under the mixture of all laws so
far. So no draw is lost, and a law that was too narrow does no harm.

Modes are looked for from a given point and from the best of some draws of the prior. A mode that none of these climbs
reaches, and that no draw of the prior hits, is missed, and the number of effective draws does not show it.

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
    greatest_precision: float = 1e10  # more are jumps of V(α), and no inverse keeps its digits
    freedom: float = 5.0  # of Student's law, whose tails are heavier than those of posteriors
    wide: int = 400  # draws of the prior
    climbs: int = 3  # from the best one of as many parts of them
    few_steps: int = 8  # of these climbs, which are made together
    hopeless: float = 50.0  # below the first mode after them, where a climb ends; a logarithm
    steps: int = 50  # of a climb
    evidence: float = 10.0  # of a mode below the best one, where it counts no more; a logarithm
    draws: int = 1000  # of a round
    rounds: int = 4
    most_rounds: int = 24
    judged: int = 8  # rounds, after which fewer than `least` effective draws are given up
    least: float = 50.0
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
        """The number of draws of equal weights that know a mean as well; 0 where all impacts fail."""
        return float(1 / np.sum(self.weights**2)) if np.isfinite(self.log_weights).any() else 0.0

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

    def has_near(self, point: np.ndarray) -> bool:
        """Whether a point lies where its normal law has draws: all but one in a thousand or so."""
        names = len(point)
        square = np.sum(np.linalg.solve(self.factor, point - self.mean) ** 2)
        return bool(square < names + 4 * np.sqrt(2 * names))


class _Normal:
    """The standard normal law, which is the prior."""

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """Over that at its middle, shape (n,)."""
        return -0.5 * np.sum(points**2, axis=1)


def sample_near(misfit: Misfit, start: np.ndarray, rng: np.random.Generator) -> Weighted:
    """Weighted draws of the posterior; `Weighted.effective` says whether the laws about the modes found are near to it.

    Args:
        misfit: the data, under standard normal priors.
        start: from where a mode is looked for, standard normal numbers, shape (names,).
        rng: of all random numbers.
    """
    names = len(start)
    wide = rng.standard_normal((SETTINGS.wide, names))
    logs = [misfit.log_density(wide)]
    modes = _modes(misfit, start, wide, logs[0])
    points, counts = [wide], [len(wide)]
    laws: list[_Normal | _Student] = [_Normal()]
    new, rounds = modes, 0
    while True:
        rounds += 1
        for law in new:
            drawn = law.draw(SETTINGS.draws, rng)
            is_near = np.abs(drawn).max(axis=1) <= SETTINGS.end
            inside = np.where(is_near[:, None], drawn, modes[0].mean)
            points.append(drawn)
            logs.append(np.where(is_near, misfit.log_density(inside), -np.inf))
            laws.append(law)
            counts.append(len(drawn))
        there, shares = np.concatenate(points), np.array(counts) / sum(counts)
        mixed = special.logsumexp([law.log_density(there) for law in laws], axis=0, b=shares[:, None])
        found = Weighted(there, np.concatenate(logs) - mixed)
        is_enough = rounds >= SETTINGS.rounds and found.effective >= SETTINGS.enough
        is_hopeless = rounds >= SETTINGS.judged and found.effective < SETTINGS.least
        if is_enough or is_hopeless or rounds == SETTINGS.most_rounds or not found.effective:
            return found
        mean, spread = found.moments()
        # Few draws span no law of their own: the first one keeps its part.
        share = names / (names + found.effective)
        first = modes[0].factor @ modes[0].factor.T
        new = [_Student(mean, np.linalg.cholesky((1 - share) * spread + share * first))]


def _modes(misfit: Misfit, start: np.ndarray, wide: np.ndarray, logs: np.ndarray) -> list[_Student]:
    """The laws about the modes that count, the one of the greatest evidence first.

    Args:
        misfit: the data.
        start: where the first climb begins, shape (names,).
        wide: draws of the prior, shape (n, names), where others begin.
        logs: their `Misfit.log_density`.
    """
    best = [part[np.argmax(logs[part])] for part in np.array_split(np.arange(len(wide)), SETTINGS.climbs)]
    begin = wide[[at for at in best if np.isfinite(logs[at])]]
    first = _climbed(misfit, start[None], SETTINGS.steps)
    laws = [_about(misfit, first[0])]
    if len(begin):
        others = _climbed(misfit, begin, SETTINGS.few_steps)
        heights = misfit.log_density(np.concatenate([first, others]))
        is_far = [not laws[0].has_near(point) for point in others]
        others = others[is_far & (heights[1:] > heights[0] - SETTINGS.hopeless)]
        for top in _climbed(misfit, others, SETTINGS.steps) if len(others) else ():
            if not any(law.has_near(top) for law in laws):
                laws.append(_about(misfit, top))
    heights = misfit.log_density(np.array([law.mean for law in laws]))
    evidence = heights + [np.sum(np.log(np.diag(law.factor))) for law in laws]
    order = np.argsort(-evidence, kind="stable")
    return [laws[at] for at in order if at == order[0] or evidence[at] > evidence[order[0]] - SETTINGS.evidence]


def _about(misfit: Misfit, mode: np.ndarray) -> _Student:
    """The law about a mode, by the curvature there."""
    rough = _covariance(misfit, mode, np.full(len(mode), SETTINGS.first_step))
    steps = np.clip(np.sqrt(np.diag(rough)), SETTINGS.first_step / 10, 1.0)
    return _Student(mode, np.linalg.cholesky(_covariance(misfit, mode, steps)))


def _climbed(misfit: Misfit, starts: np.ndarray, most: int) -> np.ndarray:
    """Likely points uphill of `starts`, shape (n, names), by slopes over steps as wide as jumps of V(α) allow.

    All climb together, as a batch takes hardly longer than a point.
    """
    count, names = starts.shape
    step = SETTINGS.slope_step * np.eye(names)

    def value(flat: np.ndarray) -> tuple[float, np.ndarray]:
        points = flat.reshape(count, 1, names)
        logs = misfit.log_density(np.concatenate([points, points + step, points - step], axis=1).reshape(-1, names))
        logs = np.where(np.isfinite(logs), logs, -1 / np.finfo(float).eps).reshape(count, -1)
        above, below = logs[:, 1 : 1 + names], logs[:, 1 + names :]
        return -float(logs[:, 0].sum()), ((below - above) / (2 * SETTINGS.slope_step)).ravel()

    bounds = [(-SETTINGS.furthest, SETTINGS.furthest)] * starts.size
    options = {"ftol": 1e-7, "maxiter": most}
    begin = np.clip(starts.ravel(), *bounds[0])
    found = optimize.minimize(value, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return found.x.reshape(starts.shape)


def _covariance(misfit: Misfit, mode: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The inverse of minus the second differences of the log density, made positive; shape (names, names)."""
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
    return (vectors / np.clip(values, SETTINGS.least_precision, SETTINGS.greatest_precision)) @ vectors.T
