"""Annealed sequential Monte Carlo: from draws of the prior to draws of the posterior, and the evidence.

Every parameter is a function of one standard normal number, value = law⁻¹(Φ(z)). In z the prior of all parameters is
the same, so that one sampler fits all, and only the inverse distribution of a law is needed.

An extra noise τ is added to the errors of all rows. While it is great, the data say nothing, and the draws are those
of the prior. It falls in steps that leave half of the draws effective. After each step they are drawn again by their
weights, and moved by Metropolis steps along differences of other draws (ter Braak 2006), half of a population at a
time. At τ = 0 the draws are those of the posterior. No gradient is needed, several modes keep their shares, and each
step is one batch. Several populations run side by side: they know nothing of each other, so they show whether they
agree.

With known errors an extra noise is the usual power of the likelihood, β = 1/(1 + τ²). With an unknown one it is
better: near the power that is parameters/rows, a model that explains nothing, with much noise, is as likely as the one
that fits, with little noise. The draws go over from the one to the other all at once, and the evidence is poor.

References:
    P. Del Moral, A. Doucet, A. Jasra, Sequential Monte Carlo samplers, J. R. Stat. Soc. B 68 (2006) 411-436.
    C. J. F. ter Braak, A Markov chain Monte Carlo version of the genetic algorithm differential evolution,
    Stat. Comput. 16 (2006) 239-249.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from scipy import optimize, special

from erosion.arguments import Progress
from erosion.extras import library

_EFFECTIVE = 0.5  # share of the draws that a step of τ leaves effective
_HOPS = 0.1  # share of the moves by a whole difference, which leads from mode to mode
_JITTER = 1e-6  # of a move, in standard deviations of the prior: without it draws would stay on a lattice
_ACCEPTED = 0.25  # share of moves that is best for differences
_GAIN = 0.5  # of the logarithm of the step per sweep
_SHORTEST, _LONGEST = 0.02, 1.5  # scale of the step
_FORGOTTEN = 0.5  # correlation of draws with those before the sweeps of one step of τ
_FEWEST, _MOST = 3, 25  # sweeps of a step of τ
_LAST = 10  # sweeps between two looks at the draws of the posterior
_LOOKS = 30
_STEPS = 500  # of τ; a sharp posterior of ten parameters takes 60
_APART = 3.0  # of log τ², between two trials for the first one
_GONE = 30.0  # log τ² below the errors, where τ changes no digit


class SamplingError(RuntimeError):
    """A posterior that could not be sampled."""


class Misfit(abc.ABC):
    """Data with normal errors, in parts of the rows, under standard normal priors.

    Of a part, the log-likelihood is -½(χ² + ln |C|) but for a constant, where C is the covariance of its rows. Its
    variance is |C|^(1/rows), to which the sampler adds its extra noise.
    """

    @property
    @abc.abstractmethod
    def sizes(self) -> Sequence[int]:
        """The number of rows of each part."""

    @abc.abstractmethod
    def squares(self, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
        """χ² times the variance, and the variance, of one part at points (n, names), both of the shape (n,).

        The first is infinite where impacts fail.
        """

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """The logarithm of likelihood and prior, without their constants, shape (n, names) -> (n,)."""
        logs = -0.5 * np.sum(points**2, axis=1)
        for part, rows in enumerate(self.sizes):
            logs += log_likelihood(*self.squares(points, part), rows)
        return logs


@dataclasses.dataclass(frozen=True)
class Run:
    """Draws of the posterior.

    Args:
        points: standard normal numbers, shape (chains, draws, names).
        log_likelihood: without the constant of the unit of squares, shape (chains, draws).
        log_evidence: of each population, without it, shape (chains,).
        acceptance: share of the moves that were accepted at last.
        sweeps: moves of all draws.
    """

    points: np.ndarray
    log_likelihood: np.ndarray
    log_evidence: np.ndarray
    acceptance: float
    sweeps: int

    @property
    def mean_log_evidence(self) -> float:
        """The logarithm of the mean evidence of the populations."""
        return float(special.logsumexp(self.log_evidence) - np.log(len(self.log_evidence)))


def log_likelihood(chi2: np.ndarray, variance: np.ndarray, rows: int) -> np.ndarray:
    """The logarithm of a normal likelihood, without its constant; -∞ for infinite squares."""
    with np.errstate(divide="ignore"):
        return -0.5 * (chi2 / variance + rows * np.log(variance))


class _Populations:
    """Draws on their way from the prior to the posterior.

    A draw is a record: its point, the variance of a row there, the log-likelihood of the parts that are in already, and
    χ² of the part that is coming in. Arrays of records have the shape (chains, n).
    """

    def __init__(self, misfit: Misfit, shape: tuple[int, int, int], rng: np.random.Generator) -> None:
        self.misfit, self.rng = misfit, rng
        numbers = [(name, float) for name in ("variance", "known", "chi2")]
        self.record = np.dtype([("point", float, shape[2:]), *numbers])
        self.part, self.noise, self.scale = 0, np.inf, 1.0  # `noise` is τ²
        self.log_evidence = np.zeros(shape[0])
        self.steps = self.sweeps = 0
        self.acceptance = 0.0
        self.draws = self._evaluated(rng.standard_normal(shape))
        self.seen = [self.draws]  # after each sweep at this τ

    def add_part(self) -> None:
        """Let the next rows in, from τ = ∞."""
        self.part, self.noise = self.part + 1, np.inf
        self.draws = self._evaluated(self.draws["point"])
        self.seen = [self.draws]

    def anneal(self) -> None:
        """One step of τ, and draws by the weights."""
        self.steps += 1
        if not np.isfinite(self.draws["chi2"]).any(axis=1).all():
            raise SamplingError("The posterior could not be sampled: the impacts of all draws of the prior failed.")
        noise = self._next()
        # All sweeps at the old τ say how much greater the evidence is at the new one.
        seen = np.concatenate([self._gains(draws, noise) for draws in self.seen], axis=1)
        self.log_evidence += special.logsumexp(seen, axis=1) - np.log(seen.shape[1])
        chosen = np.stack([self._systematic(special.softmax(row)) for row in self._gains(self.draws, noise)])
        self.draws, self.noise, self.seen = np.take_along_axis(self.draws, chosen, axis=1), noise, []

    def sweep(self) -> None:
        """Move all draws once: each half along differences of the other one."""
        self.sweeps += 1
        order = np.argsort(self.rng.random(self.draws.shape), axis=1)
        halves = np.array_split(order, 2, axis=1)
        self.acceptance = float(np.mean([self._move(halves[i], halves[1 - i]) for i in (0, 1)]))
        self.scale *= np.exp(_GAIN * (self.acceptance - _ACCEPTED))
        self.scale = float(np.clip(self.scale, _SHORTEST, _LONGEST))
        self.seen.append(self.draws.copy())

    def _gains(self, draws: np.ndarray, noise: float) -> np.ndarray:
        """How much the log-likelihood grows with τ² from the present one to another, shape (chains, n)."""
        rows = self.misfit.sizes[self.part]
        alive, variance = np.isfinite(draws["chi2"]), draws["variance"]
        chi2 = np.where(alive, draws["chi2"], 0.0)
        gains = log_likelihood(chi2, variance + noise, rows)
        if self.noise < np.inf:
            gains = gains - log_likelihood(chi2, variance + self.noise, rows)
        return np.where(alive, gains, -np.inf)

    def _next(self) -> float:
        """The least τ² that leaves enough draws of each population effective."""
        count = np.isfinite(self.draws["chi2"]).sum(axis=1)

        def excess(log_noise: float) -> float:
            logs = self._gains(self.draws, np.exp(log_noise))
            weights = np.exp(logs - logs.max(axis=1, keepdims=True))
            effective = weights.sum(axis=1) ** 2 / (weights**2).sum(axis=1)
            return float((effective / count).min()) - _EFFECTIVE

        least = float(np.log(self.draws["variance"].min())) - _GONE
        if excess(least) >= 0:
            return 0.0
        greatest = float(np.log(self.noise)) if self.noise < np.inf else _APART
        while excess(greatest) < 0:
            greatest += _APART
        return float(np.exp(optimize.bisect(excess, least, greatest, xtol=1e-3)))  # pyrefly: ignore

    def _systematic(self, weights: np.ndarray) -> np.ndarray:
        """Indexes by weights, copies of a draw side by side: so a chain's autocorrelation shows them."""
        marks = (np.arange(len(weights)) + self.rng.random()) / len(weights)
        return np.minimum(np.searchsorted(np.cumsum(weights), marks), len(weights) - 1)

    def _move(self, moving: np.ndarray, resting: np.ndarray) -> float:
        """Propose a move to each of the draws `moving`, shape (chains, n); gives the share that was accepted."""
        rng, old = self.rng, np.take_along_axis(self.draws, moving, axis=1)
        count, names = resting.shape[1], old["point"].shape[2]
        first = rng.integers(count, size=moving.shape)
        second = (first + 1 + rng.integers(count - 1, size=moving.shape)) % count
        one, other = (
            np.take_along_axis(self.draws, np.take_along_axis(resting, index, axis=1), axis=1)["point"]
            for index in (first, second)
        )
        short = self.scale * 2.38 / np.sqrt(2 * names)
        length = np.where(rng.random(moving.shape) < _HOPS, 1.0, short)
        shift = length[..., None] * (one - other) + _JITTER * rng.standard_normal(one.shape)
        new = self._evaluated(old["point"] + shift)
        accept = np.log(rng.random(moving.shape)) < self._log_target(new) - self._log_target(old)
        self.draws[np.nonzero(accept)[0], moving[accept]] = new[accept]
        return float(accept.mean())

    def _log_target(self, draws: np.ndarray) -> np.ndarray:
        """The logarithm of the density of draws at this τ, shape (chains, n)."""
        latest = log_likelihood(draws["chi2"], draws["variance"] + self.noise, self.misfit.sizes[self.part])
        return draws["known"] + latest - 0.5 * (draws["point"] ** 2).sum(axis=-1)

    def _evaluated(self, points: np.ndarray) -> np.ndarray:
        """Draws at points (chains, n, names), with all parts so far."""
        flat = points.reshape(-1, points.shape[2])
        *earlier, (chi2, variance) = (self.misfit.squares(flat, part) for part in range(self.part + 1))
        known = np.zeros(len(flat))
        for (squares, of_part), rows in zip(earlier, self.misfit.sizes, strict=False):
            known += log_likelihood(squares, of_part, rows)
        draws = np.empty(len(flat), self.record)
        draws["point"], draws["variance"], draws["known"], draws["chi2"] = flat, variance, known, chi2
        return draws.reshape(points.shape[:2])


def sample(
    misfit: Misfit,
    shape: tuple[int, int, int],
    rng: np.random.Generator,
    enough: Callable[[np.ndarray], bool],
    progress: Progress,
) -> Run:
    """Draw from the posterior.

    Args:
        misfit: the data, under standard normal priors.
        shape: (chains, draws, names), of the result; eight draws or more.
        rng: of all random numbers.
        enough: whether points of this shape are good draws; else they are moved on, up to a limit.
        progress: called with the percentage of the way, whose length is a guess.

    Raises:
        SamplingError: where the likelihood is zero for all draws of the prior.
    """
    populations, parts = _Populations(misfit, shape, rng), len(misfit.sizes)
    for part in range(parts):
        if part:
            populations.add_part()
        first = None
        while populations.noise > 0:
            if populations.steps == _STEPS:
                raise SamplingError(f"The posterior could not be sampled: it is not reached in {_STEPS} steps.")
            populations.anneal()
            first = populations.noise if first is None else first
            progress("sampling", round(80 * (part + _way(populations, first)) / parts), 100)
            _forget(populations)
    for look in range(_LOOKS):
        progress("sampling", 80 + round(20 * look / _LOOKS), 100)
        for _ in range(_LAST):
            populations.sweep()
        if enough(populations.draws["point"]):
            break
    last = populations.draws
    return Run(
        np.ascontiguousarray(last["point"]),
        last["known"] + log_likelihood(last["chi2"], last["variance"], misfit.sizes[-1]),
        populations.log_evidence,
        populations.acceptance,
        populations.sweeps,
    )


def _way(populations: _Populations, first: float) -> float:
    """How much of the way from the first τ² to 0 is done, if the errors are as small as the smallest of the draws'."""
    last = float(populations.draws["variance"].min())
    if populations.noise <= last or first <= last:
        return 1.0
    return float(np.log(first / populations.noise) / np.log(first / last))


def _forget(populations: _Populations) -> None:
    """Sweeps until the draws hardly remember where they were, by the correlation of each parameter with its past."""

    def centred() -> np.ndarray:
        points = populations.draws["point"]
        return points - points.mean(axis=1, keepdims=True)

    old = centred()
    for sweep in range(_MOST):
        populations.sweep()
        new = centred()
        norm = np.sqrt((old**2).sum(axis=(0, 1)) * (new**2).sum(axis=(0, 1)))
        correlation = (old * new).sum(axis=(0, 1)) / np.where(norm > 0, norm, 1.0)
        if sweep + 1 >= _FEWEST and correlation.max() < _FORGOTTEN:
            break


RHAT = 1.01
"""The greatest R̂ of draws that agree (Vehtari et al. 2021)."""

EFFECTIVE = 100
"""The fewest effective draws of a chain, by which R̂ can be trusted (Vehtari et al. 2021)."""


def rhats(draws: np.ndarray) -> np.ndarray:
    """R̂ of ranks, shape (chains, draws, names) -> (names,): the spread of all chains over that of one.

    References:
        A. Vehtari, A. Gelman, D. Simpson, B. Carpenter, P.-C. Bürkner, Rank-normalization, folding, and localization:
        an improved R̂ for assessing convergence of MCMC, Bayesian Analysis 16 (2021) 667-718.
    """
    return _of_each(draws, "rhat")


def effective(draws: np.ndarray) -> np.ndarray:
    """The number of independent draws that say as much of the middle, shape (chains, draws, names) -> (names,)."""
    return _of_each(draws, "ess")


def _of_each(draws: np.ndarray, name: str) -> np.ndarray:
    function = getattr(library("arviz_stats.base.array", "posterior").array_stats, name)
    # Draws that are all the same have no R̂: of a law of one value.
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array([float(function(part, chain_axis=0, draw_axis=1)) for part in np.moveaxis(draws, -1, 0)])
