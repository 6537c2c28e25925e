"""Fits of problems whose options come together, as parametrised tests have them."""

from collections.abc import Sequence
from typing import Any

import erosion

_OF_PROBLEM = ("bounds", "priors", "density", "cutting_fraction", "error")


def apart(options: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The options of `FitProblem`, and the others."""
    inside = {name: value for name, value in options.items() if name in _OF_PROBLEM}
    return inside, {name: value for name, value in options.items() if name not in inside}


def calibrated(model: Any, p: Any, data: Any, free: Sequence[str], **options: Any) -> erosion.Calibration:
    """The fit of one model."""
    of_problem, others = apart(options)
    return erosion.calibrate(erosion.FitProblem(model, p, data, free, **of_problem), **others)


def ranked(models: Any, p: Any, data: Any, free: Sequence[str], **options: Any) -> erosion.Ranking:
    """The fits of several models."""
    of_problem, others = apart(options)
    problems = erosion.FitProblem.of_models(models, p, data, free, **of_problem)
    return erosion.rank(*erosion.fit_each(problems, lambda problem, _: erosion.calibrate(problem, **others)))


def drawn(model: Any, p: Any, data: Any, free: Sequence[str], **options: Any) -> erosion.Posterior:
    """The posterior of one model."""
    of_problem, others = apart(options)
    return erosion.posterior(erosion.FitProblem(model, p, data, free, **of_problem), **others)
