"""`rank`: fits of several models to the same data, ordered by Akaike's criterion or by evidence.

The criterion counts parameters so dearly where rows are few that it may put a model first which misses the data by far.
So a model whose misfit is no noise, by the uncertainties, by the rows' own scatter or by the misfit of another model,
is not ranked. Nor is one with too many parameters for the criterion.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar, overload

import numpy as np

from erosion.arguments import Progress, no_progress, refuse
from erosion.fits.calibration import Calibration
from erosion.fits.doubts import is_poor
from erosion.fits.fit import Fit, require_fits
from erosion.fits.least_squares import CalibrationError, with_noise
from erosion.fits.outliers import FEW_PER_CENT
from erosion.fits.posterior import Posterior
from erosion.fits.problem import FitProblem
from erosion.fits.residual_checks import RARE, is_beyond_scatter, variances_differ, worst_row
from erosion.fits.tempering import SamplingError
from erosion.models import model_name, own_in_words
from erosion.results import Columns, Declared, Finding, Mark, Result, Scale, Value, ValueGroup, found

_Fit = TypeVar("_Fit", bound=Fit)
_EQUAL = 2.0  # ΔAICc below which data does not decide between models (Burnham and Anderson 2002)
_SAME = 1e-5  # of the typical erosion: fits that differ by less are the same curve


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking(Result):
    """Fits of several models to the same data, the best first.

    Args:
        fits: those that are ranked by ascending AICc, then those that are not.
        ties: groups of models, by name, whose fits are the same curve: no data of this kind
            distinguishes them.
        failures: of each model that could not be fitted.
        reasons: why the last of `fits` are not ranked.
        preferred: the place in `fits` of the model that something else than AICc chose, the evidence for example.
    """

    lines = ("ranking",)

    fits: tuple[Calibration, ...]
    ties: tuple[tuple[str, ...], ...]
    failures: tuple[Finding, ...] = ()
    reasons: tuple[Finding, ...] = ()
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
        """Return the ranking with another model as the best one; files then hold its fit."""
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
        of_models = [own_in_words(fit.model, but=fit.names, system=fit.p.shown_in) for fit in self.ranked]
        held = [Finding("parameters_held", name, {"held": own})
                for own, name in zip(of_models, self.names, strict=False) if own]  # fmt: skip
        prefers = Finding("evidence_prefers", self.names[self.preferred], {"before": self.names[0]})
        return (
            *self._misfit(),
            *(Finding("same_curve", "", {"models": tie}) for tie in self.ties),
            *self.reasons,
            *self._undecided(),
            *found((self.preferred, prefers)),
            *(held if len(self.ranked) > 1 else []),
            *self.failures,
            *self.best.findings,
        )

    @property
    def findings_of_best(self) -> tuple[Finding, ...]:
        """The findings that concern a user of the best fit."""
        return (*self._misfit(), *self._undecided(), *self.best.findings)

    def _misfit(self) -> list[Finding]:
        """Whether no one of several models fits."""
        if len(self.fits) > 1 and all(is_beyond_scatter(fit) for fit in self.fits):
            return [Finding("no_model_fits_scatter")]
        if len(self.fits) > 1 and all(is_poor(fit) for fit in self.fits):
            least = min(fit.chi2 / fit.degrees_of_freedom for fit in self.fits)
            return [Finding("no_model_fits_errors", "", {"least": least})]
        return []

    def _undecided(self) -> list[Finding]:
        """Whether AICc says nothing of any model, or models of other curves fit as well as the best."""
        if len(self.ranked) < 2:
            return []
        if not self.has_aicc:
            needed = min(fit.rows_for_aicc for fit in self.ranked)
            return [Finding("criterion_of_few_rows", "", {"needed": needed, "rows": len(self.best.data)})]
        near = [name for name, diff in zip(self.names, self._differences, strict=False) if diff < _EQUAL]
        if {*near} <= {self.names[0], *self.tied_with(self.names[0])}:
            return []
        return [Finding("models_not_decided", "", {"models": near, "weights": self.weights[: len(near)]})]

    def declare(self) -> list[Declared]:
        """The models beside each other, and all numbers of the best fit; in data those of the others, too."""
        best, ranked = self.best, len(self.ranked)
        measure, scale = best.data.quantity, best.data.scale_of(best.rms)
        missing = [None] * len(self.reasons)
        differences = [*self._differences, *missing] if self.has_aicc else [None] * len(self.fits)
        left_out = [fit.leave_one_out if np.isfinite(fit.leave_one_out) else None for fit in self.fits]
        has_errors, names = best.data.uncertainty is not None, list(self.names)
        misfit = [fit.chi2 / fit.degrees_of_freedom for fit in self.fits]
        rms = Value("rms", [fit.rms for fit in self.fits], measure=measure, scale=scale, digits=4)
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
                [*self.weights[:ranked].tolist(), *missing] if self.has_aicc else [None] * len(names),
                scale=Scale(0.01, "%"),
                digits=3,
            ),
            *([Value("chi2_over_freedom", misfit, "χ²/dof", digits=3), rms.but(only="data")] if has_errors else [rms]),
            Value("leave_one_out", left_out, "left out", measure=measure, scale=scale, digits=4),
            Value("estimates", self._in_words(), only="table"),
            Value("tied_with", [", ".join(self.tied_with(name)) for name in names], only="data"),
            Value("not_ranked", [None] * ranked + [reason.code for reason in self.reasons], only="data"),
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


def fit_each(
    problems: Sequence[FitProblem], fit: Callable[[FitProblem, Progress], _Fit], progress: Progress = no_progress
) -> tuple[list[_Fit], tuple[Finding, ...]]:
    """The fits of several problems, and a finding for each that fails.

        fits, failures = fit_each(problems, lambda problem, progress: erosion.calibrate(problem, starts=8))

    Args:
        problems: such as those of `FitProblem.of_models`.
        fit: the fit of a problem, which tells how much of it is done.
        progress: called with what is done to which model, how many parts of the whole are done, and how many there are.

    Raises:
        CalibrationError, SamplingError: if no model could be fitted.
    """
    fits, failures, kinds = [], list[Finding](), list[type[RuntimeError]]()
    for at, problem in enumerate(problems):
        name = model_name(problem.model)
        progress(f"fitting {name}", at, len(problems))

        def of_all(work: str, done: int, total: int, at: int = at, name: str = name) -> None:
            progress(f"{work} {name}", total * at + done, total * len(problems))

        try:
            fits.append(fit(problem, of_all))
        except (CalibrationError, SamplingError) as error:
            failures.append(Finding("model_failed", name, {"text": str(error)}))
            kinds.append(type(error))
    if not fits:
        raise kinds[0](" ".join(map(str, failures)))
    return fits, tuple(failures)


@overload
def rank(fits: Calibration | Sequence[Calibration], failures: Sequence[Finding] = ()) -> Ranking: ...
@overload
def rank(fits: Posterior | Sequence[Posterior], failures: Sequence[Finding] = ()) -> "PosteriorRanking": ...
def rank(fits: Fit | Sequence[Fit], failures: Sequence[Finding] = ()) -> "Ranking | PosteriorRanking":
    """Order fits of several models to the same tests: by AICc, or posteriors by their evidence.

        problems = erosion.FitProblem.of_models(["linearized", "rotating"], p, data, ["k", "psi"])
        erosion.rank([erosion.calibrate(problem) for problem in problems])

    Calibrations whose misfit is no noise are not ranked. A robust loss gets the same noise for all models, the least of
    their fits: what is far off is the same for all.

    The evidence judges a model together with its priors: a prior ten times as wide as it need be takes ln 10 = 2.3 from
    ln Z of a parameter that the data determine. Give priors that mean something before its verdict is trusted.

    Args:
        fits: all calibrations, or all posteriors.
        failures: of the models that could not be fitted, see `fit_each`.

    Raises:
        ValueError: for no fits, fits of both kinds, and fits to other tests.

    References:
        R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795.
    """
    fits = require_fits("fits", [fits] if isinstance(fits, Fit) else fits)
    calibrations = [fit for fit in fits if isinstance(fit, Calibration)]
    posteriors = [fit for fit in fits if isinstance(fit, Posterior)]
    refuse(
        "Argument `fits` must ",
        (len(fits) not in (len(calibrations), len(posteriors)), "have calibrations or posteriors, but has both."),
        (not all(fit.data.has_tests_of(fits[0].data) for fit in fits), "be of the same tests."),
    )
    if posteriors:
        return PosteriorRanking(tuple(sorted(posteriors, key=lambda drawn: -drawn.log_evidence)), tuple(failures))
    # Robust losses of several noises are not comparable, so the least is taken.
    noise = min(fit.squares.noise for fit in calibrations)
    ranked = [fit if fit.squares.noise == noise
              else Calibration(*with_noise(fit.squares, fit.solution.theta, noise), fit.level)
              for fit in calibrations]  # fmt: skip
    reasons = _reasons(ranked)
    # Models of the same curve differ by rounding: they keep their order.
    order = sorted(
        range(len(ranked)), key=lambda at: (reasons[at] is not None, round(ranked[at].aicc, 3), ranked[at].variance)
    )
    ranked = [ranked[at] for at in order]
    ties = tuple(tuple(model_name(fit.model) for fit in group) for group in _curves(ranked) if len(group) > 1)
    return Ranking(tuple(ranked), ties, tuple(failures), tuple(reason for at in order if (reason := reasons[at])))


def _reasons(fits: Sequence[Calibration]) -> list[Finding | None]:
    """Why fits are not ranked; None for those that are."""
    misses = [is_poor(fit) or is_beyond_scatter(fit) for fit in fits]
    reasons = [
        Finding("misses_data", model_name(fit.model), worst_row(fit.data, fit.fitted))
        if is_miss and not all(misses)
        else _beside_others(fit, fits)
        for fit, is_miss in zip(fits, misses, strict=True)
    ]
    if any(fit.aicc < np.inf and not reason for fit, reason in zip(fits, reasons, strict=True)):
        for at, fit in enumerate(fits):
            if not reasons[at] and fit.aicc == np.inf:
                needed = {"needed": fit.rows_for_aicc}
                reasons[at] = Finding("not_ranked_of_few_rows", model_name(fit.model), needed)
    return reasons


def _beside_others(fit: Calibration, fits: Sequence[Calibration]) -> Finding | None:
    """The fit whose residuals are so much less that this one's are no noise; None without one.

    Another model may fit a few rows too well by chance, so residuals of usual noise are no reason. A robust loss lets
    rows be far off: then variances say nothing.
    """
    linear = fit.data.uncertainty is None and fit.squares.loss == "linear"
    if not linear or fit.rms <= FEW_PER_CENT * float(np.abs(fit.data.erosion).max()):
        return None
    own, erosion = (fit.variance, fit.degrees_of_freedom), fit.data.erosion / fit.data.deviation
    tests = [(*variances_differ(own, (other.variance, other.degrees_of_freedom), erosion), other) for other in fits]
    ratio, probability, other = min(tests, key=lambda test: test[1])
    # The more curves a fit is compared with, the better the best of them is by chance (Bonferroni).
    if probability * max(len(_curves(fits)) - 1, 1) >= RARE:
        return None
    numbers = {"ratio": np.sqrt(ratio), "other": model_name(other.model)}
    return Finding("not_ranked_beside", model_name(fit.model), numbers)


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
    of_each = ValueGroup("fits", [ValueGroup(name, fit.declare()) for name, fit in fits.items()], only="data")
    failures = [Value("model", [failure.about for failure in ranking.failures]),
                Value("text", [failure.text for failure in ranking.failures])]  # fmt: skip
    of_several = [] if is_alone else [of_each, Columns("failures", "", failures, only="data")]
    table = Columns("ranking", ranking.title, columns, only="data" if is_alone else "")
    return [table, ValueGroup("", best.declare(), best.title), *of_several]


_DECISIVE = 3.0  # difference of ln Z, a factor of 20, below which data do not decide (Kass and Raftery 1995)


@dataclasses.dataclass(frozen=True, repr=False)
class PosteriorRanking(Result):
    """Posteriors of several models from the same data, the likeliest model first.

    Args:
        fits: by descending evidence.
        failures: of each model that could not be sampled.
    """

    lines = ("ranking",)

    fits: tuple[Posterior, ...]
    failures: tuple[Finding, ...] = ()

    @property
    def best(self) -> Posterior:
        """The posterior of the greatest evidence."""
        return self.fits[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The models, the likeliest first."""
        return tuple(model_name(drawn.model) for drawn in self.fits)

    @property
    def weights(self) -> np.ndarray:
        """The probability of each model, if one of them is right and all were alike before; shape (fits,)."""
        likely = np.exp(self._differences)
        return likely / likely.sum()

    @property
    def _differences(self) -> list[float]:
        """The logarithm of each evidence less the greatest."""
        return [drawn.log_evidence - self.best.log_evidence for drawn in self.fits]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on models between which the data do not decide, on failures and on draws."""
        pairs = zip(self.names[1:], self.fits[1:], strict=True)
        of_others = [dataclasses.replace(doubt, about=name) for name, drawn in pairs for doubt in drawn.not_converged]
        near = [name for name, diff in zip(self.names, self._differences, strict=True) if -diff < _DECISIVE]
        numbers = {"models": near, "weights": self.weights[: len(near)]}
        equals = found((len(near) > 1, Finding("posteriors_not_decided", "", numbers)))
        return (*equals, *self.failures, *of_others, *self.best.findings)

    @property
    def title(self) -> str:
        """The number of models and the data; of one model that of its posterior."""
        if _is_alone(self):
            return self.best.title
        return f"{len(self.fits)} posteriors from {len(self.best.data):,} rows of {self.best.data.source}"

    def declare(self) -> list[Declared]:
        """The models beside each other, and all numbers of the likeliest one; in data those of the others, too."""
        parts = self.fits
        columns = [
            Value("model", list(self.names)),
            Value("delta_log_evidence", self._differences, "Δ ln Z", error=[part.log_evidence_error for part in parts]),
            Value("probability", self.weights.tolist(), scale=Scale(0.01, "%"), digits=3),
            Value("estimates", [", ".join(map(part.mean_in_words, part.names)) for part in parts], only="table"),
        ]
        return _beside(self, dict(zip(self.names, parts, strict=True)), columns)
