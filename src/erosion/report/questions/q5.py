"""Question 5: whether the speed matters."""

from erosion.report.case import Answer, ReportCase
from erosion.report.studies import family_figure, family_numbers

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: ReportCase) -> Answer:
    """V(α) for several speeds: α_max is constant and V ∝ v₀². The reason holds for questions 5 to 8."""
    family = case.families(_MODEL)["v0"]
    numbers = family_numbers(case, family, _MODEL) | {"departure_from_square": family.departure(2)}
    return Answer(numbers, {"speeds": family_figure(case, family)}, {"family": family})
