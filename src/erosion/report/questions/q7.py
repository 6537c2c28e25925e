"""Question 7: whether the surface material matters."""

from typing import Any

from markupsafe import Markup

from erosion.report.case import Answer, Case
from erosion.report.text import degrees, formula, join, math, paragraph
from erosion.report.varied import (
    family_figure,
    family_numbers,
    family_table,
    said_angle,
    said_part,
    said_rates,
    volume_range,
)

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: Case) -> Answer:
    """All of Table 2 and the case's own σ; V ∝ 1/σ."""
    family = case.families(_MODEL)["sigma"]
    numbers = family_numbers(case, family, _MODEL) | {"departure_from_inverse": family.departure(-1)}
    return Answer(
        key="q7",
        title="Does the surface material change the best angle?",
        sentence=Markup("<strong>No</strong>: the flow stress divides the volume and leaves the best angle at {}, "
                        "the same to within {} for all metals of Table 2.").format(
            degrees(float(family.alpha[0])), said_angle(family.spread)
        ),
        figures=(
            family_figure(case, family, "materials",
                          Markup("The volume removed over the angle of attack for the metals of Table 2 and for this "
                                 "case: the softer the metal, the more is removed, at the same angle.")),
        ),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    family = case.families(_MODEL)["sigma"]
    least, greatest = volume_range(case, family)
    return join(
        paragraph("By the answer to question 5, ", math(r"V=(mv_0^2/\sigma\psi)\,f(\alpha,k)"), ", so"),
        formula(r"V\propto\frac{1}{\sigma},\qquad\frac{\partial\alpha_\text{max}}{\partial\sigma}=0"),
        family_table(case, family, "The greatest volume for several metals"),
        paragraph(f"From the hardest to the softest the volume goes from {least} to {greatest}, while ",
                  math(r"\sigma V_\text{max}"), " stays the same to within ",
                  said_part(numbers["departure_from_inverse"]), ", and the angles to within ",
                  said_angle(numbers["spread"]), ". The sensitivity ",
                  math(r"\sigma\,\partial\alpha_\text{max}/\partial\sigma"), " is ",
                  said_rates(numbers["sensitivity"]), "."),
    )  # fmt: skip
