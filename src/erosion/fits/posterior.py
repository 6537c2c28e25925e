"""`posterior` and its result: draws, intervals, evidence, best angles, and warnings on what is doubtful."""

import dataclasses
import functools
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from scipy import special, stats

from erosion.arguments import Progress, check_share, check_whole, no_progress
from erosion.fits.doubts import LEVEL, POOR, rounded
from erosion.fits.fit import Fit
from erosion.fits.least_squares import Group, identify
from erosion.fits.likelihood import (
    Likelihood,
    make_likelihood,
    sampled_quantities,
)
from erosion.fits.predicted import ANGLES, BestAngles, highest
from erosion.fits.prediction import Predictor, by_parameters, make_predictor
from erosion.fits.problem import OF_ERROR, FitProblem
from erosion.fits.tempering import EFFECTIVE, RHAT, Run, effective, rhats, sample
from erosion.impacts.batch import impact
from erosion.impacts.optimum import alpha_max
from erosion.impacts.turn import finding_of_turned
from erosion.laws import JointLaw, law_in_words
from erosion.models import CuttingModel, impact_to_dict, model_name, with_values
from erosion.ode.step_control import require_float64
from erosion.output.tables import Record
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import Quantity, Scale, table_scale
from erosion.results import Columns, Declared, Finding, Value, ValueGroup, found

_EVIDENCE = 0.5  # standard error of ln Z, from which on a factor of evidence means little
_END, _PILED = 0.01, 0.1  # an end of a prior, and the share of draws there that shows that the prior decides


_FACTOR = 1.5  # by which a deviation and an interval may differ to be shown together
_SOME = 400  # draws that show a curve's quantiles, and take a second for the best angles


class ConvergenceWarning(UserWarning):
    """The draws of a posterior are not good enough."""


@dataclasses.dataclass(frozen=True, repr=False)
class Posterior(Fit):
    """The parameters of a model after the data: draws of them, and the evidence.

    Args:
        likelihood: the model, the data and the priors.
        run: the draws, as the sampler left them.
        seed: of the draws.
        discrepancy: whether predictions hold what the model may lack.
        level: of the intervals in tables and documents.
    """

    likelihood: Likelihood
    run: Run
    seed: int
    discrepancy: bool = True
    level: float = LEVEL

    @property
    def model(self) -> CuttingModel:
        """The model, its own parameters as they were given."""
        return self.likelihood.problem.model

    @property
    def typed(self) -> dict[str, Any]:
        """See `Fit.typed`; also whether predictions hold a discrepancy."""
        return super().typed | ({} if self.discrepancy else {"discrepancy": "none"})

    @property
    def p(self) -> Parameters:
        """The case, its parameters as they were given."""
        return self.likelihood.problem.p

    @property
    def problem(self) -> FitProblem:
        """The model, the case and the data."""
        return self.likelihood.problem

    @property
    def priors(self) -> JointLaw:
        """The laws before the data."""
        return self.likelihood.priors

    @property
    def names(self) -> tuple[str, ...]:
        """The sampled parameters; "scale" and those of the error come last."""
        return self.priors.names

    @functools.cached_property
    def samples(self) -> xr.Dataset:
        """The draws of each parameter, over the dimensions (chain, draw).

        Chains are populations that know nothing of each other. Within one, copies of a draw stand side by side.
        """
        return self.dataset(self.likelihood.values(self.run.points))

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Symbol, meaning and dimension of each parameter."""
        known = sampled_quantities(self.likelihood.problem)
        return {name: known[name] for name in self.names}

    @property
    def means(self) -> dict[str, float]:
        """The mean of each parameter."""
        return {name: float(self.samples[name].mean()) for name in self.names}

    @property
    def deviations(self) -> dict[str, float]:
        """The standard deviation of each parameter."""
        return {name: float(self.samples[name].std(ddof=1)) for name in self.names}

    @property
    def correlation(self) -> np.ndarray:
        """The correlation of the parameters, shape (names, names)."""
        return np.atleast_2d(np.corrcoef([self.samples[name].values.ravel() for name in self.names]))

    def intervals(self, level: float = LEVEL) -> dict[str, tuple[float, float]]:
        """The values between which each parameter is with this probability, as likely below as above."""
        check_share("level", level)
        ends = [(1 - level) / 2, (1 + level) / 2]
        quantiles = {name: np.quantile(self.samples[name].values, ends) for name in self.names}
        return {name: (float(low), float(high)) for name, (low, high) in quantiles.items()}

    @property
    def log_evidence(self) -> float:
        """The logarithm of the probability density of the data [per unit of erosion, by row] under model and priors.

        Only its difference from that of another model on the same data means something.
        """
        return self.likelihood.constant + self.run.mean_log_evidence

    @property
    def log_evidence_error(self) -> float:
        """Standard error of `log_evidence`, from the spread of the populations."""
        logs = self.run.log_evidence
        return float(np.std(logs, ddof=1) / np.sqrt(len(logs)))

    @functools.cached_property
    def rhat(self) -> dict[str, float]:
        """R̂ of each parameter; near 1 where the populations agree."""
        return dict(zip(self.names, rhats(self.run.points).tolist(), strict=True))

    @functools.cached_property
    def effective(self) -> dict[str, float]:
        """The number of independent draws that say as much about the middle of each parameter."""
        return dict(zip(self.names, effective(self.run.points).tolist(), strict=True))

    @property
    def converged(self) -> bool:
        """Whether the draws are good, by R̂ ≤ 1.01, 100 effective draws of each population, and one evidence."""
        return not self.not_converged

    @property
    def not_converged(self) -> tuple[Finding, ...]:
        """Why draws are not good, with advice; empty for good ones."""
        least = EFFECTIVE * len(self.run.log_evidence)
        bad = {name: rhat for name, rhat in self.rhat.items() if not rhat <= RHAT}
        few = {name: count for name, count in self.effective.items() if not count >= least}
        of_bad = {"parameters": [*bad], "rhat": max(bad.values(), default=1.0), "good": RHAT}
        of_few = {"parameters": [*few], "effective": min(few.values(), default=np.inf), "good": least}
        return found(
            (bad, Finding("draws_disagree", "", of_bad)),
            (few, Finding("draws_too_few", "", of_few)),
            (not self.log_evidence_error <= _EVIDENCE,
             Finding("evidence_disagrees", "", {"error": self.log_evidence_error})),
        )  # fmt: skip

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of the posterior; empty for a good one."""
        return (*self.not_converged, *self.doubts)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings but for those on the draws."""
        said = [one for group in self.groups
                for one in (group.finding, Finding("draws_of_prior", ", ".join(group.names)))]  # fmt: skip
        shares = special.ndtr(self.run.points)
        below, above = (shares < _END).mean(axis=(0, 1)), (shares > 1 - _END).mean(axis=(0, 1))
        for name, low, high in zip(self.names, below, above, strict=True):
            share, end = max((low, "lowest"), (high, "highest"))
            numbers = {"share": share, "end": end, "law": self._law_in_words(name)}
            said += found((share > _PILED, Finding("prior_decides", name, numbers)))
        turned = self.problem.count_turned(self.likeliest, self.data.conditions)
        said += filter(None, [finding_of_turned(turned, self.data.source)])
        if not self._has_known_errors:
            return tuple(said)
        points, rows = self.run.points.reshape(-1, len(self.names)), len(self.data)
        chi2 = self.likelihood.chi2(points[:: max(len(points) // _SOME, 1)])
        is_poor = float(stats.chi2.sf(chi2, rows).mean()) < POOR
        misfit = Finding("misfit_of_draws_beyond_errors", "", {"chi2": np.median(chi2), "rows": rows})
        return (*said, *found((is_poor, misfit)))

    @functools.cached_property
    def groups(self) -> Sequence[Group]:
        """Groups of parameters that the data determine together only, at the likeliest draw."""
        theta, deviation = self.problem.theta(self.likeliest), self.data.deviation
        predicted, rates = self.problem.predict(theta, self.data.conditions)
        jacobian = rates / deviation[:, None]
        if len(self.data) < len(self.problem.names) or not np.isfinite(jacobian).all():
            return ()
        exponent = np.where(self.problem.logarithmic | (theta == 0), 1.0, theta)
        return identify(self.problem.names, jacobian, exponent, float(np.linalg.norm(predicted / deviation))).groups

    def some(self, count: int) -> dict[str, np.ndarray]:
        """Draws of all parameters, from all populations alike, each of shape (count,) or, of fewer draws, of all."""
        total = self.run.log_likelihood.size
        chosen = np.linspace(0, total, min(check_whole("count", count, 1), total), endpoint=False).astype(int)
        return {name: self.samples[name].values.reshape(-1)[chosen] for name in self.names}

    def cases(self, count: int = _SOME) -> tuple[CuttingModel, Parameters]:
        """Model and case at draws, as arrays of shape (count,), for `erosion.impact` and all that takes arrays."""
        of_impact = self.likelihood.problem.of_impact
        return with_values(self.model, self.p, {name: self.some(count)[name] for name in of_impact})

    def alpha_max(self, count: int = _SOME, *, discrepancy: bool = True) -> BestAngles:
        """The angle of greatest removal at draws, at the speed and the mass of most rows.

        Args:
            count: number of draws.
            discrepancy: also with what the model may lack.
        """
        model, p = self.cases(count)
        optimum = alpha_max(model, dataclasses.replace(p, **self.of_model.usual))  # pyrefly: ignore
        if not (discrepancy and self.discrepancy):
            return BestAngles(optimum)
        return BestAngles(optimum, highest(self.predictor.draw(ANGLES, count=count)), self.predictor.parts)

    @functools.cached_property
    def predictor(self) -> Predictor:
        """The predictor that `predict` uses, drawn on first use, which takes some times as long as the fit."""
        return self.prepared(no_progress)

    def prepared(self, progress: Progress) -> Predictor:
        """The same, with the progress told."""
        if "predictor" not in vars(self):
            alone = self.of_model
            vars(self)["predictor"] = (
                make_predictor(self.likelihood, self.likeliest, self.seed, progress, alone.hypotheses["model"])
                if self.discrepancy
                else alone
            )
        return vars(self)["predictor"]

    @functools.cached_property
    def of_model(self) -> Predictor:
        """Predictions by the parameters alone, as if the model lacked nothing."""
        values = {name: self.samples[name].values.reshape(-1) for name in self.names}
        return by_parameters(self.likelihood, values, self.run.mean_log_evidence, self.seed)

    def ends(self, alpha: Any, at: Mapping[str, Any] | None = None, count: int = _SOME) -> np.ndarray:
        """How the cuts end at angles, for draws of the parameters; arguments and shape as of `Predictor.draw`."""
        asked = self.of_model.question(alpha, at)
        draws, of_impact = self.some(count), self.likelihood.problem.of_impact
        model, p = with_values(self.model, self.p, {name: draws[name][:, None] for name in of_impact})
        shape, flat = asked["alpha"].shape, {name: column.ravel() for name, column in asked.items()}
        ends = impact(model, dataclasses.replace(p, **flat)).ended_by  # pyrefly: ignore
        drawn = len(next(iter(draws.values())))
        return np.broadcast_to(ends, (drawn, flat["alpha"].size)).reshape((drawn, *shape))

    @property
    def _has_known_errors(self) -> bool:
        return not {*OF_ERROR} & {*self.names}

    @property
    def subject(self) -> Record:
        """Model and case as they were given."""
        return impact_to_dict(self.model, self.p)

    def declare(self) -> list[Declared]:
        """Means with deviations, or medians, intervals and priors; the evidence; the draws' quality."""
        chains, count = self.run.points.shape[:2]
        rhat, effective = (np.array(list(numbers.values())) for numbers in (self.rhat, self.effective))
        of_draws = f"of {chains * count:,} draws, the fewest; good from {EFFECTIVE * chains}"
        return [
            *map(self._row, self.names),
            Value("rows", len(self.data), only="data"),
            self.of_parameters("means", self.means),
            self.of_parameters("deviations", self.deviations),
            self.of_parameters("intervals", self.intervals(self.level)),
            Value("level", self.level, only="data"),
            Value("correlation", self.correlation, dims=("parameter", "other_parameter"), only="data"),
            ValueGroup("priors", [Value(name, self.prior_in_words(name)) for name in self.names], only="data"),
            Value("log_evidence", self.log_evidence, "ln Z", "of the data, under this model and these priors",
                  error=self.log_evidence_error),
            Value("converged", self.converged, only="data"),
            Value("rhat", float(rhat.max()), "R̂", f"the greatest; good to {RHAT}", digits=5, only="table"),
            Value("effective", float(np.round(effective.min())), meaning=of_draws, only="table"),
            Columns("quality", "", [Value("parameter", self.names), Value("rhat", rhat), Value("effective", effective)],
                    only="data"),
            Value("acceptance", self.run.acceptance, meaning="share of the last moves"),
            Value("draws", chains * count, only="data"),
            Value("chains", chains, only="data"),
            Value("seed", self.seed, only="data"),
            Value("erosion_unit", self.data.quantity.unit(self.shown_in), only="data"),
        ]  # fmt: skip

    def _row(self, name: str) -> Value:
        """A parameter in tables, in the unit in which it reads well."""
        quantity = self.quantities[name]
        scale = table_scale(quantity.dimension, self.p.shown_in, abs(self.means[name]))
        mean, deviation = self.means[name] / scale.size, self.deviations[name] / scale.size
        low, high = (end / scale.size for end in self.intervals(self.level)[name])
        prior = f"prior: {self.prior_in_words(name)}"
        width = float(stats.norm.ppf((1 + self.level) / 2)) * deviation
        is_symmetric = all(width < _FACTOR * distance < _FACTOR**2 * width for distance in (mean - low, high - mean))
        if is_symmetric:
            ends = f"{rounded(low, high - low, 2)} … {rounded(high, high - low, 2)}"
            value = f"{rounded(mean, deviation)} ± {rounded(deviation, deviation)}"
        else:  # a mean and a deviation would say that other values are likely than the interval does
            middle = float(self.samples[name].median()) / scale.size
            ends = f"{rounded(low, middle - low, 2)} … {rounded(high, high - middle, 2)}"
            value = rounded(middle, min(middle - low, high - middle))
        meaning = f"{'' if is_symmetric else 'the median; '}{self.level:.0%}: {ends}; {prior}"
        return Value(name, value, quantity.symbol, meaning, scale=scale._replace(size=1.0), only="table")

    def mean_in_words(self, name: str) -> str:
        """A parameter's mean and deviation, or its median: "threshold = 7.3 ± 1.0 m/s"."""
        row = self._row(name)
        assert isinstance(row.scale, Scale)
        return f"{name} = {row.scale.beside(row.value)}"

    def _law_in_words(self, name: str) -> str:
        return law_in_words(self.priors.laws[name], self.quantities[name].dimension, self.p.shown_in)

    def prior_in_words(self, name: str) -> str:
        """The law of a parameter before the data, and whether it is the default."""
        return self._law_in_words(name) + ("" if name in self.likelihood.chosen else ", the default")

    @property
    def title(self) -> str:
        """The model and the data."""
        return f"{model_name(self.model)}: the posterior from {len(self.data):,} rows of {self.data.source}"

    @property
    def described(self) -> dict[str, Any]:
        """Attributes of the samples in a file."""
        return super().described | {
            "log_evidence": self.log_evidence,
            "log_evidence_error": self.log_evidence_error,
            **{f"prior_{name}": self.prior_in_words(name) for name in self.names},
        }

    @property
    def sample_stats(self) -> xr.Dataset:
        """The log-likelihood of each draw."""
        logs = self.run.log_likelihood + self.likelihood.constant
        return xr.Dataset({"log_likelihood": (("chain", "draw"), logs)}, self.samples.coords)

    @property
    def likeliest(self) -> dict[str, float]:
        """The parameters of the likeliest draw."""
        at = np.unravel_index(int(np.argmax(self.run.log_likelihood)), self.run.log_likelihood.shape)
        return {name: float(self.samples[name].values[at]) for name in self.names}


CHAINS = 4
"""Populations of draws, as many as R̂ needs."""

_LEAST = 125  # draws of a population, of which 100 can be effective


def posterior(
    problem: FitProblem,
    *,
    draws: int = 500,
    seed: int = 0,
    discrepancy: bool = True,
    level: float = LEVEL,
    progress: Progress = no_progress,
) -> Posterior:
    """Draw a model's parameters as likely as measured erosion and priors leave them.

        from scipy import stats
        priors = {"psi": stats.loguniform(0.01, 0.2)}
        problem = erosion.FitProblem("rotating", p, data, ["k", "psi"], priors=priors)
        erosion.posterior(problem).samples["psi"]

    No gradient is used, as V(α) jumps: see `erosion.fits.tempering`. The evidence comes with the draws.

    Rows without uncertainties have normal errors of unknown size, √(a² + (b E)²) of their erosion E: the parameters
    "noise", a [of the data], and "relative_noise", b. Erosion in units of its own has an unknown factor, "scale". A
    parameter without a prior or bounds has all factors from 1/100 to 100 of the fit's first guess alike, see
    docs/posterior.md. The result names all priors.

    Args:
        problem: the model, the case, the tests, and what is free with its priors.
        draws: of each of the 4 populations, 125 or more.
        seed: the same seed gives the same draws.
        discrepancy: whether predictions hold a discrepancy and an exponent of the speed; draws of parameters never do,
            they are conditional on the model.
        level: of the intervals in tables and documents.
        progress: called with the name of the work, how much of it is done in percent, and 100.

    Returns:
        Draws, evidence, and findings on all that is doubtful.

    Raises:
        ValueError, TypeError: for arguments that cannot be used.
        SamplingError: where all impacts fail.
        MissingExtraError: without the extra `posterior`.

    Warns:
        ConvergenceWarning: where the draws are not good enough; the result says so, too.
    """
    require_float64()
    likelihood = make_likelihood(problem)
    draws, seed = check_whole("draws", draws, _LEAST), check_whole("seed", seed, 0)
    shape = CHAINS, draws, likelihood.priors.dimension
    run = sample(likelihood, shape, np.random.default_rng(seed), _are_good, progress)
    result = Posterior(likelihood, run, seed, discrepancy, check_share("level", level))
    for finding in result.not_converged:
        warnings.warn(finding.text, ConvergenceWarning, stacklevel=2)
    return result


def _are_good(points: np.ndarray) -> bool:
    return bool((rhats(points) <= RHAT).all() and (effective(points) >= EFFECTIVE * CHAINS).all())
