"""`posterior`: all values of a model's parameters that measured erosion leaves, each as often as it is likely."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Progress, check_whole, no_progress
from erosion.calibration.fitting import make_forward
from erosion.models.base import CuttingModel
from erosion.ode.precision import require_float64
from erosion.parameters.parameters import Parameters
from erosion.posteriors.convergence import EFFECTIVE, RHAT, effective, rhats
from erosion.posteriors.likelihood import Likelihood
from erosion.posteriors.priors import make_priors
from erosion.posteriors.result import ConvergenceWarning, Posterior
from erosion.posteriors.tempering import sample

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

    No gradient is used, as V(α) jumps: see `erosion.posteriors.tempering`. The evidence comes with the draws.

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
