"""`posterior` and `rank_posteriors`: draws of a model's parameters from measured erosion, and models by evidence."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Progress, check_whole, no_progress
from erosion.fits.calibration import make_forward
from erosion.fits.doubts import LEVEL
from erosion.fits.measurements import read_measurements
from erosion.fits.posterior import EFFECTIVE, RHAT, ConvergenceWarning, Posterior, effective, rhats
from erosion.fits.ranking import models_with_free
from erosion.fits.tempering import Likelihood, SamplingError, make_priors, sample
from erosion.models import model_name
from erosion.models.base import CuttingModel
from erosion.ode.step_control import require_float64
from erosion.output.tables import Result, to_plain
from erosion.parameters.parameters import Parameters

CHAINS = 4
"""Populations of draws, as many as R̂ needs."""

_LEAST = 125  # draws of a population, of which 100 can be effective


def posterior(
    model: CuttingModel | str | Path,
    p: Parameters,
    data: Any,
    free: Sequence[str],
    *,
    priors: Mapping[str, Any] | None = None,
    density: float | str | None = None,
    cutting_fraction: float = 1.0,
    draws: int = 500,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Posterior:
    """Draw a model's parameters as likely as measured erosion and priors leave them.

        from erosion.distributions import Uniform
        erosion.posterior("rotating", p, data, free=["k", "psi"], priors={"psi": Uniform(0.01, 0.2)}).samples["psi"]

    No gradient is used, as V(α) jumps: see `erosion.fits.tempering`. The evidence comes with the draws.

    Args:
        model: a model, its name, or the path of its file.
        p: the case: the values of all parameters that are not free, and the middle of default priors.
        data: as for `calibrate`. Rows without uncertainties have normal errors of one unknown size, which is the
            parameter "noise" [of the data]; erosion in units of its own has an unknown factor, "scale".
        free: the parameters to draw, of the case or the model's own: ["k", "psi"]; or "cutting_fraction".
        priors: by parameter, also "noise" and "scale": a law of `erosion.distributions` or any frozen distribution of
            scipy, in the case's units. Without one: all factors from 1/100 to 100 of the case's value alike, see
            docs/posterior.md. The result names them all.
        density: of the target, as for `calibrate`.
        cutting_fraction: as for `calibrate`; where it is free, its prior counts alone.
        draws: of each of the 4 populations, 125 or more.
        seed: the same seed gives the same draws.
        progress: called with the name of the work, how much of it is done in percent, and 100.

    Returns:
        Draws, evidence, and sentences on all that is doubtful.

    Raises:
        ValueError, TypeError: for arguments or data that cannot be used (data: `MeasurementError`).
        SamplingError: where all impacts fail.
        MissingExtraError: without the extra `posterior`.

    Warns:
        ConvergenceWarning: where the draws are not good enough; the result says so, too.
    """
    require_float64()
    forward = make_forward(model, p, data, free, density, cutting_fraction)
    if not np.any(forward.data.erosion):
        raise ValueError("Argument `data` must have erosion other than zero.")
    likelihood = Likelihood(forward, make_priors(forward, priors or {}))
    draws, seed = check_whole("draws", draws, _LEAST), check_whole("seed", seed, 0)
    shape = CHAINS, draws, len(likelihood.priors.names)
    result = Posterior(likelihood, sample(likelihood, shape, np.random.default_rng(seed), _are_good, progress), seed)
    for sentence in result.not_converged:
        warnings.warn(sentence, ConvergenceWarning, stacklevel=2)
    return result


def _are_good(points: np.ndarray) -> bool:
    return bool((rhats(points) <= RHAT).all() and (effective(points) >= EFFECTIVE * CHAINS).all())


_EQUAL = 3.0  # difference of ln Z, a factor of 20, below which data do not decide (Kass and Raftery 1995)


@dataclasses.dataclass(frozen=True)
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
        likely = np.exp([drawn.log_evidence - self.best.log_evidence for drawn in self.posteriors])
        return likely / likely.sum()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on models that the data do not tell apart, on failures and doubtful draws."""
        of_others = [
            f"{name}: {sentence}"
            for name, drawn in zip(self.names[1:], self.posteriors[1:], strict=True)
            for sentence in drawn.not_converged
        ]
        return (*self._equals(), *self.failures, *of_others, *self.best.warnings)

    def _equals(self) -> tuple[str, ...]:
        near = [
            name
            for name, drawn in zip(self.names, self.posteriors, strict=True)
            if self.best.log_evidence - drawn.log_evidence < _EQUAL
        ]
        if len(near) < 2:
            return ()
        weights = " : ".join(f"{100 * weight:.0f}" for weight in self.weights[: len(near)])
        both = f"{', '.join(near[:-1])} and {near[-1]}"
        return (f"Data and priors do not decide between {both}: their probabilities are {weights}.",)

    @property
    def title(self) -> str:
        """The number of models and the data."""
        return f"{len(self.posteriors)} posteriors from {len(self.best.data):,} rows of {self.best.data.source}"

    @property
    def headings(self) -> tuple[str, ...]:
        """The columns of the table."""
        return ("model", "Δ ln Z", "probability", "estimates")

    def rows(self) -> list[tuple[str, ...]]:
        """A row for each model."""
        rows = []
        for name, drawn, weight in zip(self.names, self.posteriors, self.weights, strict=True):
            difference = f"{drawn.log_evidence - self.best.log_evidence:.2f} ± {drawn.log_evidence_error:.2f}"
            means = ", ".join(drawn.mean_in_words(name) for name in drawn.names)
            rows.append((name, difference, f"{weight:.1%}", means))
        return rows

    def to_dict(self, level: float = LEVEL) -> dict[str, Any]:
        """The posteriors, each with its probability; and the failures."""
        drawn = [
            {**part.to_dict(level), "probability": weight}
            for part, weight in zip(self.posteriors, self.weights, strict=True)
        ]
        return to_plain({"posteriors": drawn, "failures": self.failures, "warnings": self.warnings})


def rank_posteriors(
    p: Parameters,
    data: Any,
    free: Sequence[str],
    *,
    models: Sequence[CuttingModel | str | Path] | None = None,
    priors: Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> PosteriorRanking:
    """Draw the posteriors of several models from the same data, and order the models by their evidence.

    The evidence judges a model together with its priors: a prior ten times as wide as it need be takes ln 10 = 2.3 from
    ln Z of a parameter that the data determine. Give priors that mean something before its verdict is trusted.

    Args:
        p: the case, as for `posterior`.
        data: as for `calibrate`.
        free: the parameters to draw; in each model those that it has.
        models: models, names or paths; every registered model without it.
        priors: as for `posterior`; in each model those of its free parameters.
        progress: as for `posterior`.
        options: `density`, `cutting_fraction`, `draws` and `seed` of `posterior`.

    Raises:
        ValueError, TypeError: for arguments or data that cannot be used.
        SamplingError: if no model could be sampled.

    References:
        R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795.
    """
    measured, drawn, failures = read_measurements(data, p.units), [], []
    ranked = models_with_free(models, free)
    for done, (model, own_free) in enumerate(ranked):
        laws = {name: law for name, law in (priors or {}).items() if name in own_free or name not in free}

        def of_all(work: str, percent: int, total: int, name: str = model_name(model), begun: int = done) -> None:
            progress(f"{work} {name}", 100 * begun + percent, total * len(ranked))

        try:
            drawn.append(posterior(model, p, measured, own_free, priors=laws, progress=of_all, **options))
        except SamplingError as error:
            failures.append(f"{model_name(model)}: {error}")
    if not drawn:
        raise SamplingError(" ".join(failures))
    drawn.sort(key=lambda part: -part.log_evidence)
    return PosteriorRanking(tuple(drawn), tuple(failures))
