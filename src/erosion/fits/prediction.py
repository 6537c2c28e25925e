"""Predictions whose intervals hold where the model misses the data: averaged over what a model may lack.

Three hypotheses are drawn: the model, the model with a free exponent of the speed, and that with a
discrepancy too (`erosion.fits.discrepancy`). Each counts by its evidence. So a model that is right predicts almost as
closely as by its parameters alone, and a model that misses does not hide it. A choice by χ² would.

Evidence is of the rows. Beyond their angles nothing says that a model is right: there the last hypothesis counts alone.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special, stats

from erosion.arguments import Progress, check_whole, no_progress
from erosion.fits.discrepancy import EXPONENT, PRIORS, Discrepant, with_few_conditions
from erosion.fits.errors import ErrorModel
from erosion.fits.importance import SETTINGS, sample_near
from erosion.fits.likelihood import Likelihood
from erosion.fits.measurements import Measurements
from erosion.fits.outliers import chances
from erosion.fits.problem import ERROR_FACTOR, NOISE, OF_ERROR, RELATIVE, FitProblem
from erosion.fits.tempering import sample
from erosion.laws import JointLaw, law_in_words
from erosion.models import own_parameters
from erosion.output import first_of, sentences
from erosion.parameters import InSI
from erosion.results import Declared, Finding, Result, Scale, System, Value, found

CHAINS = 4
_DRAWS = 600  # of a hypothesis: 500 independent ones know ends of intervals to 4 % of their width (1 σ)
_MIXED = 2000  # draws of the average
_SOME = 400
_APART = 0.3  # deviation of populations' means over that of their draws; R̂ is about 1.05
_UNLIKELY = 0.01  # probability that any of the rows is so far off by its error
_NOTHING = 0.05  # of a row's erosion, which the model does not have
_FEW = 16  # draws that show whether bodies turn too far
_LISTED = 4  # rows that a sentence lists
_COUNTS = 0.01  # probability of a hypothesis whose draws matter
_FADE = np.deg2rad(5.0)  # beyond the tested angles, over which the discrepancy comes to count alone
Noise = bool | float | np.ndarray | ErrorModel


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """One hypothesis about the data.

    Args:
        misfit: the likelihood.
        values: draws of all its parameters, shape (draws,).
        log_evidence: but for a constant.
        weight: its probability beside the others.
        converged: whether its draws are good.
    """

    misfit: Discrepant
    values: Mapping[str, np.ndarray]
    log_evidence: float
    weight: float = 1.0
    converged: bool = True


@dataclasses.dataclass(frozen=True, repr=False)
class Predictor(Result):
    """Predictions of a fit between its rows and beyond them.

    Args:
        problem: the model, the case and the data.
        hypotheses: the hypotheses, by name: "discrepancy", "exponent" and "model", those that can be; rows of many
            conditions are put together there.
        seed: of what is drawn for a prediction.
    """

    problem: FitProblem
    hypotheses: Mapping[str, Hypothesis]
    seed: int

    @property
    def data(self) -> Measurements:
        """The measurements."""
        return self.problem.data

    def in_unit(self, unit: str) -> "Predictor":
        """The same, whose tables and figures show erosion in a unit; see `Measurements.in_unit`."""
        problem = dataclasses.replace(self.problem, data=self.data.in_unit(unit))
        return dataclasses.replace(self, problem=problem)

    def to_specific_volume(self, mass: float) -> float:
        """Volume per mass of particles [m³/kg] over the erosion of the tests.

        Args:
            mass: of a particle [kg], where the tests are of one impact.
        """
        data, density = self.data, self.problem.density
        factor = 1.0 / density if data.needs_density and density is not None else 1.0
        return factor if data.per_mass else factor / mass

    @functools.cached_property
    def usual(self) -> Mapping[str, float]:
        """Speed and mass where none is asked for, if the data have their own."""
        return self.data.usual

    @property
    def weights(self) -> dict[str, float]:
        """The probability of each hypothesis, if all were alike before."""
        return {name: hypothesis.weight for name, hypothesis in self.hypotheses.items()}

    @property
    def parts(self) -> tuple[str, ...]:
        """The meaning of the intervals, in words."""
        has = [hypothesis.misfit for hypothesis in self.hypotheses.values()]
        return ("parameters", *sentences(
            (any(hypothesis.has_discrepancy for hypothesis in has), "discrepancy"),
            (any(hypothesis.has_exponent for hypothesis in has), "speed exponent"),
        ))  # fmt: skip

    def chosen(self, count: int) -> list[tuple[Hypothesis, dict[str, np.ndarray]]]:
        """Draws of all parameters, of each hypothesis by its weight; of a single one at most those it has."""
        ends = np.round(np.cumsum([0.0, *self.weights.values()]) * count).astype(int)
        hypotheses = []
        for hypothesis, wanted in zip(self.hypotheses.values(), np.diff(ends), strict=True):
            total = _size(hypothesis.values)
            wanted = min(wanted, total) if len(self.hypotheses) == 1 else wanted
            hypotheses.append((hypothesis, _some_of(hypothesis.values, wanted)))
        return hypotheses

    def share_turned(self, conditions: Mapping[str, Any]) -> float:
        """In what share of impacts under conditions, at some draws, the body turns by more than 90°."""
        chosen = (values for _, values in self.chosen(_FEW) if _size(values))
        drawn = [{name: value[:, None] for name, value in values.items()} for values in chosen]
        turned, impacts = np.sum([self.problem.count_turned(values, conditions) for values in drawn], axis=0).tolist()
        return turned / max(1, impacts)

    @property
    def exponent(self) -> tuple[float, float] | None:
        """Mean and standard deviation of the speed's exponent over the model's v², in the average; None without."""
        held = self.problem.held_exponent
        if held is None or not any(hypothesis.misfit.has_exponent for hypothesis in self.hypotheses.values()):
            return None
        draws = [values.get(EXPONENT, np.full(_size(values), held)) for _, values in self.chosen(_MIXED)]
        draws = np.concatenate(draws)
        return float(draws.mean()), float(draws.std())

    def draw(
        self, alpha: Any, at: Mapping[str, Any] | None = None, count: int = _SOME, *, noise: Noise = False
    ) -> np.ndarray:
        """Draws of the erosion at angles.

        Args:
            alpha: α [rad], of any shape.
            at: other parameters of the case than the sampled ones, such as {"v0": "60 m/s"}, or arrays, read as
                `Parameters.replace` reads them. Speed and mass without it are those of most rows, or the case's where
                the data have none.
            count: number of draws.
            noise: True for a new measurement, with the data's error or the sampled noise; or another error, a standard
                deviation [SI], one for each angle, or an `ErrorModel`. Else the mean of measurements.

        Returns:
            In SI, draws first and then the shape of `alpha`.
        """
        if noise is False:
            return self._means(alpha, at, count)[0]
        means, deviation = self.with_errors(alpha, at, count, noise=noise)
        return means + deviation * np.random.default_rng([self.seed, 3]).standard_normal(means.shape)

    def with_errors(
        self, alpha: Any, at: Mapping[str, Any] | None = None, count: int = _SOME, *, noise: Noise = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draws of the mean, and the standard deviation of a new weighing about each; arguments as of `draw`."""
        means, hypotheses = self._means(alpha, at, count)
        own, common = self._errors(means.reshape(len(means), -1), hypotheses, noise)
        return means, np.hypot(own, common).reshape(means.shape)

    def _errors(
        self, means: np.ndarray, hypotheses: Sequence[Mapping[str, np.ndarray]], noise: Noise = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """`deviations` about means, shape (draws, n), of draws of the parameters by each hypothesis in turn."""
        parts = np.split(means, np.cumsum([_size(values) for values in hypotheses])[:-1])
        about = [deviations(self.data, values, part, None if noise is True else noise)
                 for values, part in zip(hypotheses, parts, strict=True)]  # fmt: skip
        own, common = (np.concatenate(part) for part in zip(*about, strict=True))
        return own, common

    def _means(
        self, alpha: Any, at: Mapping[str, Any] | None, count: int
    ) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
        """Draws of the mean, and the parameters of those of each hypothesis."""
        asked = self.question(alpha, at)
        conditions = {name: column.ravel() for name, column in asked.items()}
        rng, chosen = np.random.default_rng([self.seed, 1]), self.chosen(check_whole("count", count, 1))
        chosen = [(hypothesis, values) for hypothesis, values in chosen if _size(values)]
        curves = np.concatenate([hypothesis.misfit.draw(values, conditions, rng) for hypothesis, values in chosen])
        if alone := self._alone(conditions, chosen):
            last, values, there, place, share = alone
            curves[place] += share * (last.misfit.draw(values, there, rng) - curves[place])
        return curves.reshape((-1, *asked["alpha"].shape)), [values for _, values in chosen]

    def _alone(
        self, conditions: Mapping[str, np.ndarray], chosen: Sequence[tuple[Hypothesis, Mapping[str, np.ndarray]]]
    ) -> tuple[Hypothesis, dict[str, np.ndarray], dict[str, np.ndarray], tuple[np.ndarray, ...], np.ndarray] | None:
        """The hypothesis that counts alone beyond the tested angles, for draws of others; None where it has no place.

        Returns:
            It, its draws, the conditions beyond the angles, the place of both among all draws and conditions, and
            how much it counts there: up to 1, from `_FADE` beyond the angles.
        """
        angle, last, alpha = self.data.angle, self.hypotheses.get("discrepancy"), conditions["alpha"]
        others = np.flatnonzero(
            np.concatenate([np.full(_size(values), hypothesis is not last) for hypothesis, values in chosen])
        )
        share = np.clip(np.maximum(angle.min() - alpha, alpha - angle.max()) / _FADE, 0.0, 1.0)
        beyond = share > 0
        if last is None or not others.size or not beyond.any():
            return None
        there = {name: column[beyond] for name, column in conditions.items()}
        return last, _some_of(last.values, len(others)), there, np.ix_(others, beyond), share[beyond]

    def question(self, alpha: Any, at: Mapping[str, Any] | None) -> InSI:
        """What is asked, speed and mass among it, as arrays of one shape; arguments as of `draw`."""
        return self.problem.conditions(alpha, at, self.usual)

    def outside(self, alpha: Any, at: Mapping[str, Any] | None = None) -> tuple[Finding, ...]:
        """How far a question lies outside the tests; arguments as of `draw`."""
        given = {name: getattr(self.problem.p, name) for name in self.problem.tested.ranges}
        return tuple(self.problem.tested.outside(given | self.question(alpha, at)))

    @property
    def row_errors(self) -> np.ndarray:
        """Standard deviations of the rows, given or the mean of the sampled ones; shape (n,)."""
        if not {*OF_ERROR} & {*self.hypotheses["model"].values}:
            return self.data.whole_error
        hypotheses = [values for _, values in self.chosen(_SOME)]
        erosion = np.tile(self.data.erosion, (sum(map(_size, hypotheses)), 1))
        return np.hypot(*self._errors(erosion, hypotheses)).mean(axis=0)

    @property
    def title(self) -> str:
        """The meaning of the intervals of predictions."""
        return f"predictions hold {', '.join(self.parts)}"

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.data.shown_in

    def declare(self) -> list[Declared]:
        """The probability of each hypothesis, and the exponent of the speed."""
        words = {"model": "that the model is right", "exponent": "that it is but for the speed's exponent",
                 "discrepancy": "that it misses more, by a discrepancy over angle and speed"}  # fmt: skip
        mean, deviation = self.exponent or (2.0, 0.0)
        return [
            Value("parts", [*self.parts], dims=("part",), only="data"),
            *(Value(name, weight, meaning=words[name], scale=Scale(0.01, "%"), digits=3, only="table")
              for name, weight in self.weights.items()),
            Value("weights", [*self.weights.values()], labels=[*self.weights], only="data"),
            Value("exponent", mean, "n", "factor (v₀/v_ref)^(n-2)", error=deviation,
                  only="data" if self.exponent is None else ""),
        ]  # fmt: skip

    @functools.cached_property
    def _missed(self) -> tuple[Finding, ...]:
        """The rows that a new weighing would not give; empty where it would give all."""
        data, few = self.data, self.hypotheses["model"].misfit.plain.problem.data
        at = InSI(few.conditions)
        means, hypotheses = self._means(at.pop("alpha"), at, _SOME)
        own, common = (np.mean(errors**2, axis=0) for errors in self._errors(means, hypotheses))
        middle = means.mean(axis=0)
        distance = np.abs(data.erosion - middle) / np.sqrt(means.var(axis=0) + own + common)
        distance = np.maximum(distance, _from_repeats(data, data.erosion - middle, np.sqrt(own)))
        odds, freedom = 2 * stats.norm.sf(distance), len(data) - len(self.hypotheses["model"].values)
        if data.uncertainty is None and freedom > 1:  # a row far off makes a sampled error large, which hides the row
            apart = data.weighed(middle, np.sqrt(own)).over_errors(data.erosion - middle) * data.deviation
            odds = np.minimum(odds, chances(apart, np.zeros((len(data), 0)), middle, freedom))
        rows = np.flatnonzero(len(data) * odds < _UNLIKELY)
        if not len(rows):
            return ()
        listed = [f"{data.where(row)}: {data.in_words(data.erosion[row])}, predicted {data.in_words(middle[row])}"
                  for row in rows[np.argsort(odds[rows])].tolist()]  # fmt: skip
        is_nothing = (middle[rows] < _NOTHING * data.erosion[rows]).any()
        numbers = {"missed": len(rows), "rows": len(data), "listed": first_of(listed, _LISTED)}
        return found(
            (True, Finding("rows_missed", data.source, numbers)),
            (is_nothing, Finding("removes_nothing_at_rows", data.source)),
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of the predictions; none for good ones."""
        bad = [
            name
            for name, hypothesis in self.hypotheses.items()
            if not hypothesis.converged and hypothesis.weight > _COUNTS
        ]
        law = {"law": law_in_words(PRIORS[EXPONENT])}
        of_prior = self.exponent is not None and self.data.has_one_speed
        return (
            *found((bad, Finding("hypotheses_disagree", "", {"hypotheses": bad}))),
            *self._missed,
            *found((of_prior, Finding("exponent_of_prior", "", law))),
        )


def _from_repeats(data: Measurements, residuals: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """How far each row is from the mean of its repeats, over the error of their difference; 0 without, shape (n,)."""
    others = np.bincount(data.repeats)[data.repeats] - 1
    sums = np.bincount(data.repeats, residuals)[data.repeats] - residuals
    apart = np.abs(residuals - sums / np.maximum(others, 1)) / (errors * np.sqrt(1 + 1 / np.maximum(others, 1)))
    return np.where(others > 0, apart, 0.0)


def by_parameters(
    likelihood: Likelihood, values: Mapping[str, np.ndarray], log_evidence: float, seed: int
) -> Predictor:
    """Predictions by the parameters alone.

    Args:
        likelihood: of the model.
        values: draws of its parameters, shape (draws,).
        log_evidence: but for a constant.
        seed: see `Predictor`.
    """
    misfit = Discrepant(likelihood, has_exponent=False, has_discrepancy=False)
    return Predictor(likelihood.problem, {"model": Hypothesis(misfit, values, log_evidence)}, seed)


def predictor_of(problem: FitProblem, hypotheses: Mapping[str, Mapping[str, Any]], seed: int) -> Predictor:
    """Predictions by draws that were kept: by hypothesis, the arguments of `Hypothesis` but for its likelihood."""
    whole = Likelihood(problem, JointLaw(), ())
    few = with_few_conditions(whole) if len(hypotheses) > 1 else whole
    kept = {name: Hypothesis(Discrepant(few, EXPONENT in hypothesis["values"], name == "discrepancy"), **hypothesis)
            for name, hypothesis in hypotheses.items()}  # fmt: skip
    return Predictor(problem, kept, seed)


def make_predictor(
    whole: Likelihood,
    estimates: Mapping[str, float],
    seed: int,
    progress: Progress = no_progress,
    model: Hypothesis | None = None,
) -> Predictor:
    """The average of the hypotheses.

    Args:
        whole: the likelihood of the model.
        estimates: values of its parameters that fit the rows, from where modes are looked for.
        seed: see `Predictor`.
        progress: as of `posterior`.
        model: the model alone, where it is drawn already.
    """
    few, rng, problem = with_few_conditions(whole), np.random.default_rng([seed, 2]), whole.problem
    if model is None or few is not whole:
        model = drawn(Discrepant(few, False, False), estimates, rng, progress)
    hypotheses = {"model": model}
    exponent = "v0" not in problem.free and EXPONENT not in own_parameters(problem.model)
    exponent = exponent and problem.held_exponent is not None
    if exponent and problem.data.has_one_speed:  # n has no influence on these data
        count = _size(model.values)
        law = {**model.values, EXPONENT: PRIORS[EXPONENT].ppf((rng.permutation(count) + 0.5) / count)}
        misfit = dataclasses.replace(model.misfit, has_exponent=True)
        hypotheses["exponent"] = dataclasses.replace(model, misfit=misfit, values=law)
    elif exponent:
        hypotheses["exponent"] = drawn(Discrepant(few, True, False), estimates, rng, progress)
    hypotheses["discrepancy"] = drawn(Discrepant(few, exponent, True), estimates, rng, progress)
    weights = special.softmax([hypothesis.log_evidence for hypothesis in hypotheses.values()]).tolist()
    weighed = {name: dataclasses.replace(hypothesis, weight=weight)
               for (name, hypothesis), weight in zip(hypotheses.items(), weights, strict=True)}  # fmt: skip
    return Predictor(problem, weighed, seed)


def _some_of(values: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """As many draws, evenly from all."""
    rows = np.linspace(0, _size(values), count, endpoint=False).astype(int)
    return {name: column[rows] for name, column in values.items()}


def _size(values: Mapping[str, np.ndarray]) -> int:
    """The number of draws."""
    return len(next(iter(values.values())))


def drawn(
    misfit: Discrepant, estimates: Mapping[str, float], rng: np.random.Generator, progress: Progress = no_progress
) -> Hypothesis:
    """One hypothesis, of weight 1.

    Importance sampling takes a tenth of the time of annealing; where its effective draws are too few, as along ridges,
    beside jumps of V(α), and where its laws miss a mode that draws of the prior hit, populations are annealed from the
    prior. What importance sampling cannot see of modes, `erosion.fits.importance` says.

    Args:
        misfit: the likelihood.
        estimates: as for `make_predictor`; other parameters begin in the middle of their priors.
        rng: of the draws.
        progress: as of `posterior`.
    """
    shares = [law.cdf(estimates[name]) if name in estimates else 0.5 for name, law in misfit.priors.laws.items()]
    near = sample_near(misfit, special.ndtri(shares), rng)
    if near.effective >= SETTINGS.enough:
        points = near.chosen(_DRAWS, rng)
        return Hypothesis(misfit, misfit.values(points), near.log_evidence)
    run = sample(misfit, (CHAINS, _DRAWS // CHAINS, misfit.priors.dimension), rng, _agree, progress)
    values = {name: column.reshape(-1) for name, column in misfit.values(run.points).items()}
    return Hypothesis(misfit, values, run.mean_log_evidence, converged=_agree(run.points))


def _agree(points: np.ndarray) -> bool:
    """Whether the means of populations, shape (chains, draws, names), differ little beside their deviations."""
    means, variances = points.mean(axis=1), points.var(axis=1).mean(axis=0)
    return bool((means.var(axis=0) <= _APART**2 * variances).all())


def deviations(
    data: Measurements,
    values: Mapping[str, np.ndarray],
    erosion: np.ndarray,
    given: float | np.ndarray | ErrorModel | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The standard deviations of a measurement by its own error and by that of its speed, which is of another day.

    Both are of the shape of the mean.

    Args:
        data: the measurements; their error counts where none is given.
        values: draws of the parameters, the sampled errors among them.
        erosion: the mean, shape (draws, rows).
        given: another error, which counts instead.
    """
    if isinstance(given, ErrorModel) and not given.has_own:
        return deviations(data, values, erosion)[0], given.common * np.abs(erosion)
    error = data.error if given is None else given
    factor = values[ERROR_FACTOR][:, None] if given is None and ERROR_FACTOR in values else 1.0
    common = error.common * np.abs(erosion) if isinstance(error, ErrorModel) else np.zeros(erosion.shape)
    if given is None and data.uncertainty is None:
        own = np.hypot(values[NOISE][:, None], values[RELATIVE][:, None] * erosion)
    else:
        own = error.deviation(erosion) if isinstance(error, ErrorModel) else np.asarray(error, float)
    return np.broadcast_to(factor * own, erosion.shape), factor * common
