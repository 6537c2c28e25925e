"""`rank_models` and `rank_posteriors`: several models and the same data, ordered by Akaike's criterion or by evidence.

The criterion counts parameters so dearly where rows are few that it may put a model first which misses the data by far.
So a model whose misfit is no noise, by the uncertainties, by the rows' own scatter or by the misfit of another model,
is not ranked. Nor is one with too many parameters for the criterion.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Progress, no_progress
from erosion.fits.calibration import Calibration, calibrate
from erosion.fits.doubts import RARE, is_beyond_scatter, is_poor, variances_differ, worst_row
from erosion.fits.errors import ErrorModel
from erosion.fits.fit import Fit
from erosion.fits.forward import FRACTION, FREE, USUAL_FREE, USUAL_MODELS
from erosion.fits.least_squares import CalibrationError, with_noise
from erosion.fits.measurements import read_measurements
from erosion.fits.outliers import FEW_PER_CENT
from erosion.fits.posterior import Posterior, posterior
from erosion.fits.tempering import SamplingError
from erosion.models import CuttingModel, load_model, model_name, own_in_words, quantities, usable_models
from erosion.output import format_number, sentences
from erosion.parameters import Parameters
from erosion.results import Columns, Declared, Finding, Mark, Part, Result, Scale, Value, stated

_Models = Sequence[CuttingModel | str | Path] | None
_EQUAL = 2.0  # ΔAICc below which data does not decide between models (Burnham and Anderson 2002)
_SAME = 1e-5  # of the typical erosion: fits that differ by less are the same curve


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking(Result):
    """Fits of several models to the same data, the best first.

    Args:
        fits: those that are ranked by ascending AICc, then those that are not.
        ties: groups of models, by name, whose fits are the same curve: no data of this kind
            distinguishes them.
        failures: a sentence for each model that could not be fitted.
        reasons: why the last of `fits` are not ranked, a clause for each of them.
        preferred: the place in `fits` of the model that something else than AICc chose, the evidence for example.
    """

    fits: tuple[Calibration, ...]
    ties: tuple[tuple[str, ...], ...]
    failures: tuple[str, ...]
    reasons: tuple[str, ...] = ()
    preferred: int = 0

    @property
    def best(self) -> Calibration:
        """The fit of least AICc, or the preferred one."""
        return self.fits[self.preferred]

    @property
    def ranked(self) -> tuple[Calibration, ...]:
        """The fits that are ranked."""
        return self.fits[: len(self.fits) - len(self.reasons)]

    @property
    def best_first(self) -> tuple[Calibration, ...]:
        """The ranked fits with the best one first."""
        return (self.best, *(fit for fit in self.ranked if fit is not self.best))

    def preferring(self, name: str) -> "Ranking":
        """The same with another model as the best one, of which everything that is written then is."""
        return dataclasses.replace(self, preferred=self.names.index(name))

    @property
    def names(self) -> tuple[str, ...]:
        """The models, the best first."""
        return tuple(model_name(fit.model) for fit in self.fits)

    @property
    def weights(self) -> np.ndarray:
        """Akaike weights, the probability of each model if one of them is right; shape (fits,).

        0 for models that are not ranked; NaN for all where AICc says nothing, see `has_aicc`.
        """
        if not self.has_aicc:
            return np.full(len(self.fits), np.nan)
        likely = np.exp([-difference / 2 for difference in self._differences])
        return np.append(likely / likely.sum(), np.zeros(len(self.reasons)))

    @property
    def has_aicc(self) -> bool:
        """Whether there are rows enough for AICc; without it the models are ordered by their residuals' variance."""
        return self.fits[0].aicc < np.inf

    @property
    def _differences(self) -> list[float]:
        """AICc less the least, of the ranked fits; that of exact fits is -∞."""
        least = self.fits[0].aicc
        return [0.0 if fit.aicc == least else fit.aicc - least for fit in self.ranked]

    def tied_with(self, name: str) -> tuple[str, ...]:
        """The other models that give the same curve as this one."""
        return next((tuple(tied for tied in tie if tied != name) for tie in self.ties if name in tie), ())

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Models that cannot be distinguished, what is held, failures, and what is doubtful in the best fit."""
        same = [_and(tie) for tie in self.ties]
        reasons = _grouped(zip(self.reasons, self.names[len(self.ranked) :], strict=True))
        of_models = [own_in_words(fit.model, but=fit.names, units=fit.p.units) for fit in self.ranked]
        held = _grouped((own, name) for own, name in zip(of_models, self.names, strict=False) if own)
        best, listed = self.names[self.preferred], "; ".join(f"{own} ({of})" for own, of in held.items())
        said = (
            *self._misfit(),
            *sentences(
                (len(same) == 1, f"{'; '.join(same)} give the same curve: these data cannot tell them apart."),
                (len(same) > 1, f"These data cannot tell models of the same curve apart: {'; '.join(same)}."),
                (reasons, f"Not ranked: {'; '.join(f'{names} ({reason})' for reason, names in reasons.items())}."),
                *((True, sentence) for sentence in self._undecided()),
                (
                    self.preferred,
                    f"AICc prefers {self.names[0]}, the evidence {best}: all that is written is of {best}.",
                ),
                (held and len(self.ranked) > 1, f"Own parameters that are not free are held: {listed}."),
            ),
            *self.failures,
        )
        return (*map(stated, said), *self.best.findings)

    @property
    def findings_of_best(self) -> tuple[Finding, ...]:
        """Those of the findings that concern whoever uses the best fit."""
        return (*map(stated, (*self._misfit(), *self._undecided())), *self.best.findings)

    def _misfit(self) -> list[str]:
        """A sentence where no one of several models fits."""
        if len(self.fits) > 1 and all(is_beyond_scatter(fit) for fit in self.fits):
            return ["None of the models fits: the residuals of each are greater than the scatter of the rows."]
        if len(self.fits) > 1 and all(is_poor(fit) for fit in self.fits):
            least = min(fit.chi2 / fit.degrees_of_freedom for fit in self.fits)
            return [f"None of the models fits within the uncertainties: χ²/dof is {least:.3g} or more."]
        return []

    def _undecided(self) -> list[str]:
        """A sentence where AICc says nothing of any model, or where models of other curves fit as well as the best."""
        if len(self.ranked) < 2:
            return []
        if not self.has_aicc:
            needed = min(fit.rows_for_aicc for fit in self.ranked)
            return [
                f"AICc needs at least {needed} rows for so many parameters, but there are {len(self.best.data)}: the "
                "models are in the order of their residuals' variance. Measure more, or free fewer parameters."
            ]
        near = [name for name, diff in zip(self.names, self._differences, strict=False) if diff < _EQUAL]
        if {*near} <= {self.names[0], *self.tied_with(self.names[0])}:
            return []
        return [f"The data do not decide between {_and(near)}: their weights are {_ratio(self.weights, near)}."]

    def declare(self) -> list[Declared]:
        """The models beside each other, and all numbers of the best fit; in data those of the others, too."""
        best, ranked = self.best, len(self.ranked)
        unit, scale = best.erosion_unit, best.data.scale_of(best.rms)
        missing = [None] * len(self.reasons)
        differences = [*self._differences, *missing] if self.has_aicc else [None] * len(self.fits)
        left_out = [fit.leave_one_out if np.isfinite(fit.leave_one_out) else None for fit in self.fits]
        has_errors, names = best.data.uncertainty is not None, list(self.names)
        misfit = [fit.chi2 / fit.degrees_of_freedom for fit in self.fits]
        rms = Value("rms", [fit.rms for fit in self.fits], unit=unit, scale=scale, digits=4)
        columns = [
            Value("model", names),
            Value(
                "delta_aicc",
                differences,
                "ΔAICc",
                digits=4,
                marks=[Mark([at >= ranked for at in range(len(names))], "not ranked")],
            ),
            Value(
                "weight",
                self.weights.tolist() if self.has_aicc else [None] * len(names),
                scale=Scale(0.01, "%"),
                digits=3,
            ),
            *([Value("chi2_over_freedom", misfit, "χ²/dof", digits=3), rms.but(only="data")] if has_errors else [rms]),
            Value("leave_one_out", left_out, "left out", unit=unit, scale=scale, digits=4),
            Value("estimates", self._in_words(), only="table"),
            Value("tied_with", [", ".join(self.tied_with(name)) for name in names], only="data"),
            Value("not_ranked", [None] * ranked + [*self.reasons], only="data"),
        ]
        return _beside(self, dict(zip(names, self.fits, strict=True)), columns)

    def _in_words(self) -> list[str]:
        """The estimates of each model; of models of the same curve, the first one has them."""
        of_each, first_of = dict(zip(self.names, map(_in_words, self.fits), strict=True)), {}
        for tie in self.ties:
            first_of |= dict.fromkeys(tie[1:], tie[0])
        for name, first in first_of.items():
            words = of_each[name]
            of_each[name] = f"same as {first}" if words == of_each[first] else f"{words} (curve of {first})"
        return [*of_each.values()]

    @property
    def title(self) -> str:
        """The number of models and the data; of one model that of its fit."""
        if _is_alone(self):
            return self.best.title
        return f"{len(self.fits)} models fitted to {len(self.best.data):,} rows of {self.best.data.source}"


def rank_models(
    p: Parameters,
    data: Any,
    free: Sequence[str] | None = None,
    *,
    models: Sequence[CuttingModel | str | Path] | None = None,
    progress: Progress = no_progress,
    bounds: Mapping[str, Sequence[float]] | None = None,
    error: ErrorModel | float | str | None = None,
    **options: Any,
) -> Ranking:
    """Fit several models to the same data and order them by AICc; those whose misfit is no noise are not ranked.

    Args:
        p: the case: the first guess of the free parameters, and the values of all others.
        data: as for `calibrate`.
        free: the parameters to fit; in each model those that it has. Without it and models `linearized` with and
            without deformation is fitted, k, ψ and the energy ratio are free; without it k and ψ.
        models: models, names or paths; every registered model without it.
        progress: called before each fit with "fitting" and the model's name, how many models are done, and how
            many there are.
        bounds: as for `calibrate`; in each model those of its free parameters.
        error: as for `calibrate`.
        options: `density`, `cutting_fraction`, `loss` and `starts` of `calibrate`. A robust loss has the
            same noise for all models, the least of their fits: what is far off is the same for all.

    Raises:
        ValueError: for arguments or data that cannot be used.
        CalibrationError: if no model could be fitted.
    """
    measured, (models, free) = read_measurements(data, p.units, error=error), _usual(models, free)

    def fitted(model: CuttingModel, own_free: Sequence[str], own_bounds: dict[str, Any], at: tuple[int, int]) -> Any:
        progress(f"fitting {model_name(model)}", *at)
        return calibrate(model, p, measured, own_free, bounds=own_bounds, **options)

    fits, failures = _of_each(models, free, bounds or {}, fitted, CalibrationError)
    # Robust losses of several noises are not comparable, so the least is taken.
    noise = min(fit.problem.noise for fit in fits)
    fits = [fit if fit.problem.noise == noise else Calibration(*with_noise(fit.problem, fit.solution.theta, noise))
            for fit in fits]  # fmt: skip
    reasons = _reasons(fits)
    # Models of the same curve differ by rounding: they keep their order.
    order = sorted(range(len(fits)), key=lambda at: (reasons[at] != "", round(fits[at].aicc, 3), fits[at].variance))
    fits = [fits[at] for at in order]
    ties = tuple(tuple(model_name(fit.model) for fit in group) for group in _curves(fits) if len(group) > 1)
    return Ranking(tuple(fits), ties, failures, tuple(reasons[at] for at in order if reasons[at]))


def _usual(models: _Models, free: Sequence[str] | None) -> tuple[_Models, Sequence[str]]:
    """The models and the free parameters, also where they are not named."""
    if free is not None:
        return models, free
    return (USUAL_MODELS, USUAL_FREE) if models is None else (models, FREE)


def _of_each(
    models: Sequence[CuttingModel | str | Path] | None,
    free: Sequence[str],
    limits: Mapping[str, Any],
    fit: Callable[[CuttingModel, Sequence[str], dict[str, Any], tuple[int, int]], Any],
    failure: type[Exception],
) -> tuple[list[Any], tuple[str, ...]]:
    """The results of all models, and a sentence for each that fails.

    Args:
        models: as for `rank_models`.
        free: as for `rank_models`.
        limits: of parameters, bounds or laws.
        fit: takes a model, those of the free parameters and limits that it has, its number, and how many there are.
        failure: the error of a model that fails, and of all.
    """
    results, failures, ranked = [], [], models_with_free(models, free)
    for done, (model, own_free) in enumerate(ranked):
        # Limits of what no model has are refused by `fit`.
        own_limits = {name: limit for name, limit in limits.items() if name in own_free or name not in free}
        try:
            results.append(fit(model, own_free, own_limits, (done, len(ranked))))
        except failure as error:
            failures.append(f"{model_name(model)}: {error}")
    if not results:
        raise failure(" ".join(failures))
    return results, tuple(failures)


def _reasons(fits: Sequence[Calibration]) -> list[str]:
    """Why fits are not ranked, a clause for each; "" for those that are."""
    misses = [is_poor(fit) or is_beyond_scatter(fit) for fit in fits]
    reasons = [
        f"misses the data: {worst_row(fit.data, fit.fitted)}"
        if is_miss and not all(misses)
        else _beside_others(fit, fits)
        for fit, is_miss in zip(fits, misses, strict=True)
    ]
    if any(fit.aicc < np.inf and not reason for fit, reason in zip(fits, reasons, strict=True)):
        for at, fit in enumerate(fits):
            if not reasons[at] and fit.aicc == np.inf:
                reasons[at] = f"AICc needs at least {fit.rows_for_aicc} rows for its parameters"
    return reasons


def _beside_others(fit: Calibration, fits: Sequence[Calibration]) -> str:
    """A clause on the fit whose residuals are so much less that this one's are no noise; "" without one.

    Another model may fit a few rows too well by chance, so residuals of usual noise are no reason. A robust loss lets
    rows be far off: then variances say nothing.
    """
    linear = fit.data.uncertainty is None and fit.problem.loss == "linear"
    if not linear or fit.rms <= FEW_PER_CENT * float(np.abs(fit.data.erosion).max()):
        return ""
    own, erosion = (fit.variance, fit.degrees_of_freedom), fit.data.erosion / fit.data.deviation
    tests = [(*variances_differ(own, (other.variance, other.degrees_of_freedom), erosion), other) for other in fits]
    ratio, probability, other = min(tests, key=lambda test: test[1])
    # The more curves a fit is compared with, the better the best of them is by chance (Bonferroni).
    if probability * max(len(_curves(fits)) - 1, 1) >= RARE:
        return ""
    return f"its residuals are {format_number(np.sqrt(ratio), 2)} times those of {model_name(other.model)}"


def models_with_free(
    models: Sequence[CuttingModel | str | Path] | None, free: Sequence[str]
) -> list[tuple[CuttingModel, Sequence[str]]]:
    """Models, all registered ones without names, each with those of the free parameters that it has.

    Raises:
        ValueError: for no model, one that is named twice, a parameter that none has, and a model that has none of them.
    """
    wanted = usable_models() if models is None else list(models)
    named = [str(model) for model in wanted if isinstance(model, (str, Path))]
    if not wanted or len(set(named)) != len(named):
        raise ValueError(f"Argument `models` must name one or several different models, but is {wanted}.")
    loaded = [load_model(source) for source in wanted]
    if len(loaded) == 1 or isinstance(free, str) or not isinstance(free, Sequence):
        return [(model, free) for model in loaded]
    known = [{*quantities(model), FRACTION} for model in loaded]
    for name in free:
        if not any(name in has for has in known):
            listed = ", ".join(map(model_name, loaded))
            raise ValueError(f"Argument `free` must name parameters of the models, but {name!r} is none of {listed}.")
    of_each = [(model, [name for name in free if name in has]) for model, has in zip(loaded, known, strict=True)]
    for model, own_free in of_each:
        if free and not own_free:
            none = f"{model_name(model)} has no {free[0]!r}"
            raise ValueError(f"Argument `free` must name a parameter of each model, but {none}.")
    return [*of_each]


def _grouped(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """The names that share a text, listed, by this text."""
    groups: dict[str, str] = {}
    for text, name in pairs:
        groups[text] = f"{groups[text]}, {name}" if text in groups else name
    return groups


def _and(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _ratio(weights: np.ndarray, names: Sequence[str]) -> str:
    """The weights of the first models, one for each name: "60 : 40"."""
    return " : ".join(f"{100 * weight:.0f}" for weight in weights[: len(names)])


def _in_words(fit: Calibration) -> str:
    """The estimates, then the parameters whose estimates mean nothing: "psi = 0.13, k not determined"."""
    left_open = dict.fromkeys(fit.undetermined, "not determined") | dict.fromkeys(fit.undecided, "not decided")
    touched, known = fit.bounds_touched(), []
    for name, value in fit.estimates.items():
        if name not in left_open:
            sides = [side for side in ("lower", "upper") if f"estimate at {side}" in touched.get(name, ())]
            known.append(f"{name} = {fit.in_words(name, value)}{f' (at its {sides[0]} bound)' if sides else ''}")
    return ", ".join([*known, *(f"{name} {state}" for name, state in left_open.items())])


def _curves(fits: Sequence[Calibration]) -> list[list[Calibration]]:
    """The fits in groups of the same curve."""
    near = _SAME * float(np.sqrt(np.mean(fits[0].data.erosion ** 2)))
    groups: list[list[Calibration]] = []
    for fit in fits:
        alike = (group for group in groups if np.abs(group[0].fitted - fit.fitted).max() < near)
        if (group := next(alike, None)) is None:
            groups.append([fit])
        else:
            group.append(fit)
    return groups


def _is_alone(ranking: "Ranking | PosteriorRanking") -> bool:
    """Whether it is of one model, without another that failed."""
    return len(ranking.names) + len(ranking.failures) == 1


def _beside(ranking: "Ranking | PosteriorRanking", fits: Mapping[str, Fit], columns: Sequence[Value]) -> list[Declared]:
    """Models beside each other, and all numbers of the best one; in data those of each of several."""
    best, is_alone = ranking.best, _is_alone(ranking)
    of_each = [] if is_alone else [Part("fits", [Part(name, fit.declare()) for name, fit in fits.items()], only="data")]
    table = Columns("ranking", ranking.title, columns, only="data" if is_alone else "")
    return [table, Part("", best.declare(), best.title), *of_each]


_DECISIVE = 3.0  # difference of ln Z, a factor of 20, below which data do not decide (Kass and Raftery 1995)


@dataclasses.dataclass(frozen=True, repr=False)
class PosteriorRanking(Result):
    """Posteriors of several models from the same data, the likeliest model first.

    Args:
        posteriors: by descending evidence.
        failures: a sentence for each model that could not be sampled.
    """

    posteriors: tuple[Posterior, ...]
    failures: tuple[str, ...] = ()

    @property
    def best(self) -> Posterior:
        """The posterior of the greatest evidence."""
        return self.posteriors[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The models, the likeliest first."""
        return tuple(model_name(drawn.model) for drawn in self.posteriors)

    @property
    def weights(self) -> np.ndarray:
        """The probability of each model, if one of them is right and all were alike before; shape (posteriors,)."""
        likely = np.exp(self._differences)
        return likely / likely.sum()

    @property
    def _differences(self) -> list[float]:
        """The logarithm of each evidence less the greatest."""
        return [drawn.log_evidence - self.best.log_evidence for drawn in self.posteriors]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Models that the data do not tell apart, failures and doubtful draws."""
        pairs = zip(self.names[1:], self.posteriors[1:], strict=True)
        of_others = [f"{name}: {sentence}" for name, drawn in pairs for sentence in drawn.not_converged]
        near = [name for name, diff in zip(self.names, self._differences, strict=True) if -diff < _DECISIVE]
        equals = [
            f"Data and priors do not decide between {_and(near)}: their probabilities are {_ratio(self.weights, near)}."
        ] * (len(near) > 1)
        return (*map(stated, (*equals, *self.failures, *of_others)), *self.best.findings)

    @property
    def title(self) -> str:
        """The number of models and the data; of one model that of its posterior."""
        if _is_alone(self):
            return self.best.title
        return f"{len(self.posteriors)} posteriors from {len(self.best.data):,} rows of {self.best.data.source}"

    def declare(self) -> list[Declared]:
        """The models beside each other, and all numbers of the likeliest one; in data those of the others, too."""
        parts = self.posteriors
        columns = [
            Value("model", list(self.names)),
            Value("delta_log_evidence", self._differences, "Δ ln Z", error=[part.log_evidence_error for part in parts]),
            Value("probability", self.weights.tolist(), scale=Scale(0.01, "%"), digits=3),
            Value("estimates", [", ".join(map(part.mean_in_words, part.names)) for part in parts], only="table"),
        ]
        return _beside(self, dict(zip(self.names, parts, strict=True)), columns)


def rank_posteriors(
    p: Parameters,
    data: Any,
    free: Sequence[str] | None = None,
    *,
    models: Sequence[CuttingModel | str | Path] | None = None,
    priors: Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    error: ErrorModel | float | str | None = None,
    **options: Any,
) -> PosteriorRanking:
    """Draw the posteriors of several models from the same data, and order the models by their evidence.

    The evidence judges a model together with its priors: a prior ten times as wide as it need be takes ln 10 = 2.3 from
    ln Z of a parameter that the data determine. Give priors that mean something before its verdict is trusted.

    Args:
        p: the case, as for `posterior`.
        data: as for `calibrate`.
        free: the parameters to draw, in each model those that it has; without it as for `rank_models`.
        models: as for `rank_models`.
        priors: as for `posterior`; in each model those of its free parameters.
        progress: as for `posterior`.
        error: as for `calibrate`.
        options: `density`, `cutting_fraction`, `draws` and `seed` of `posterior`.

    Raises:
        ValueError, TypeError: for arguments or data that cannot be used.
        SamplingError: if no model could be sampled.

    References:
        R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795.
    """
    measured, (models, free) = read_measurements(data, p.units, error=error), _usual(models, free)

    def drawn(model: CuttingModel, own_free: Sequence[str], laws: dict[str, Any], at: tuple[int, int]) -> Any:
        def of_all(work: str, percent: int, total: int) -> None:
            progress(f"{work} {model_name(model)}", 100 * at[0] + percent, total * at[1])

        return posterior(model, p, measured, own_free, priors=laws, progress=of_all, **options)

    posteriors, failures = _of_each(models, free, priors or {}, drawn, SamplingError)
    return PosteriorRanking(tuple(sorted(posteriors, key=lambda part: -part.log_evidence)), failures)
