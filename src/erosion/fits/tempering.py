"""Annealed sequential Monte Carlo: from draws of the prior to draws of the posterior, and the evidence.

A row differs from the model by a normal error: of the row's uncertainty, or of one unknown size. This is what a least-
squares fit assumes, too.

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
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import optimize, special

from erosion.arguments import Progress
from erosion.distributions import Distribution, LogUniform, Uniform, as_law
from erosion.fits.forward import FACTORS, FRACTION, SCALE, Forward
from erosion.fits.least_squares import default_width
from erosion.joint_laws import SHARE, LawSet, Member
from erosion.models.own_parameters import quantities, ranges
from erosion.parameters.quantities import Quantity

NOISE = "noise"
"""The standard deviation of a row, a parameter where the data give no uncertainties."""

_NOISES = 1e-4, 10.0  # of the typical erosion: from the digits of a balance to a model that explains nothing


def make_likelihood(forward: Forward, given: Mapping[str, Any]) -> "Likelihood":
    """The data's likelihood under the laws that are given, and for all other parameters under default ones.

    The default is as wide as a fit looks for a parameter: all factors from 1/100 to 100 of the case's value are alike;
    a spin may differ from the case's by 2 v₀/r; a share of particles is anything up to 1. The scale of data in units of
    its own, and the noise, have a size that only the data know: their defaults are wide laws about it.

    Raises:
        ValueError, TypeError: for laws of parameters that are not free, or that do not fit the parameter.
    """
    names = (*forward.names, NOISE) if forward.data.uncertainty is None else forward.names
    for name, law in given.items():
        if name not in names:
            raise ValueError(f"Argument `priors` must name free parameters ({', '.join(names)}), but has {name!r}.")
        if isinstance(law, Member):
            raise ValueError(f"Argument `priors` must give {name} a law of its own, but gives {law}.")
    laws = {name: as_law(given[name]) if name in given else _default(forward, name) for name in names}
    positive = dict.fromkeys((SCALE, NOISE), (0.0, np.inf))
    priors = LawSet(laws, {**ranges(forward.model), FRACTION: SHARE, **positive}, "`priors` of `{}`")
    return Likelihood(forward, priors, tuple(given))


def sampled_quantities(forward: Forward) -> dict[str, Quantity]:
    """Symbol, meaning and dimension of all parameters that may be sampled."""
    noise = Quantity("s_n", "standard deviation of a row", forward.data.dimension)
    return {**quantities(forward.model), **FACTORS, NOISE: noise}


def _default(forward: Forward, name: str) -> Distribution:
    if name == FRACTION:
        return Uniform(0.0, 1.0)
    typical = float(np.sqrt(np.mean(forward.data.erosion**2)))
    if name == NOISE:
        return LogUniform(_NOISES[0] * typical, _NOISES[1] * typical)
    at = forward.names.index(name)
    start, width = forward.start[at], default_width(forward)[at]
    if name == SCALE:
        computed = np.nan_to_num(forward.predict_many(forward.start[None], forward.data.conditions)[0])
        size = float(np.sqrt(np.mean(computed**2)))
        start = np.log(typical / size if size > 0 else 1.0)
    low, high = forward.limits[at]
    low, high = (start - width if low == -np.inf else low), (start + width if high == np.inf else high)
    law = LogUniform if forward.logarithmic[at] else Uniform
    return law(float(forward.from_theta(name, low)), float(forward.from_theta(name, high)))


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
    """Data with normal errors, in parts of the rows, under standard normal priors."""

    @property
    @abc.abstractmethod
    def sizes(self) -> Sequence[int]:
        """The number of rows of each part."""

    @abc.abstractmethod
    def chi2(self, points: np.ndarray, part: int) -> np.ndarray:
        """The sum of squares of one part at points (n, names), of the shape (n,); infinite where impacts fail."""

    @abc.abstractmethod
    def variance(self, points: np.ndarray) -> np.ndarray:
        """The variance of a row, in the unit of these squares, shape (n,)."""


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
        return float(np.exp(optimize.bisect(excess, least, greatest, xtol=1e-3)))  # pyright: ignore[reportArgumentType, reportCallIssue]

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
        variance = self.misfit.variance(flat)
        *earlier, chi2 = (self.misfit.chi2(flat, part) for part in range(self.part + 1))
        known = np.zeros(len(flat))
        for squares, rows in zip(earlier, self.misfit.sizes, strict=False):
            known += log_likelihood(squares, variance, rows)
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
        priors: the laws of the sampled parameters; "noise" is the last where the data give no uncertainties.
        chosen: the parameters whose laws the user gave; the others are defaults.
    """

    forward: Forward
    priors: LawSet
    chosen: tuple[str, ...]

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters at standard normal numbers, shape (…, names), by name; each of the shape (…)."""
        return self.priors.draw(special.ndtr(points))

    @property
    def constant(self) -> float:
        """What squares over the data's `deviation` leave out of the log-likelihood."""
        return -float(np.sum(np.log(self.forward.data.deviation) + 0.5 * np.log(2 * np.pi)))

    @functools.cached_property
    def parts(self) -> list["_RowPart"]:
        """The rows of each part, by conditions, in an order of chance that is always the same."""
        data = self.forward.data
        values, places = data.at_conditions()
        count = values.shape[1]
        weights = data.deviation**-2
        weight = np.bincount(places, weights, count)
        mean = np.bincount(places, weights * data.erosion, count) / weight
        spread = np.bincount(places, weights * (data.erosion - mean[places]) ** 2, count)
        rows = np.bincount(places, minlength=count)
        ends, end = [], _FIRST
        while end < count:
            ends.append(end)
            end *= _GROWTH
        return [
            _RowPart(
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
        predicted = self.predict(self.values(points), pooled.conditions)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = pooled.spread + np.sum(((predicted - pooled.mean) / pooled.deviation) ** 2, axis=1)
        return np.where(np.isnan(squares), np.inf, squares)

    def variance(self, points: np.ndarray) -> np.ndarray:
        """The variance of a row over that of `deviation`, shape (n,)."""
        if self.forward.data.uncertainty is not None:
            return np.ones(len(points))
        return (self.values(points)[NOISE] / self.forward.data.deviation[0]) ** 2

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
