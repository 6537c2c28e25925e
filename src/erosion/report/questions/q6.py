"""Question 6: whether the erodent's size and mass matter."""

import numpy as np

from erosion.report.case import Answer, ReportCase
from erosion.report.studies import family_figure, family_numbers

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: ReportCase) -> Answer:
    """R is absent from the equations; V ∝ m."""
    masses, sizes = (case.families(_MODEL)[name] for name in ("m", "r"))
    numbers = {
        "m": family_numbers(case, masses, _MODEL) | {"departure_from_proportion": masses.departure(1)},
        "r": family_numbers(case, sizes, _MODEL) | {"largest_difference": float(np.ptp(sizes.volumes, axis=0).max())},
    }
    return Answer(numbers, {"masses": family_figure(case, masses)}, {"masses": masses})
