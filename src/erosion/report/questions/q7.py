"""Question 7: whether the surface material matters."""

from erosion.report.case import Answer, ReportCase
from erosion.report.studies import family_figure, family_numbers

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: ReportCase) -> Answer:
    """All metals of Table 2 and the case's own σ; V ∝ 1/σ."""
    family = case.families(_MODEL)["sigma"]
    numbers = family_numbers(case, family, _MODEL) | {"departure_from_inverse": family.departure(-1)}
    return Answer(numbers, {"materials": family_figure(case, family)}, {"family": family})
