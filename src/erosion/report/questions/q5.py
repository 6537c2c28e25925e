"""Question 5: whether the speed matters."""

from typing import Any

from markupsafe import Markup

from erosion.report.case import Answer, Case
from erosion.report.text import degrees, formula, join, math, note, paragraph
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
    """V(α) for several speeds; α_max the same, V ∝ v₀²; and why, for questions 5 to 8 at once."""
    family = case.families(_MODEL)["v0"]
    numbers = family_numbers(case, family, _MODEL) | {"departure_from_square": family.departure(2)}
    return Answer(
        key="q5",
        title="Does the speed change the best angle?",
        sentence=Markup("<strong>No</strong>: at every speed most is removed at {}, the same to within {}; how much "
                        "is removed grows with the square of the speed.").format(
            degrees(float(family.alpha[0])), said_angle(family.spread)
        ),
        figures=(
            family_figure(case, family, "speeds",
                          Markup("The volume removed over the angle of attack at {} speeds. The maxima lie on one "
                                 "upright line.").format(len(family.values))),
        ),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    family = case.families(_MODEL)["v0"]
    least, greatest = volume_range(case, family)
    return join(
        paragraph("Measure time by ", math(r"1/\omega"), " and length by ", math(r"v_0/\omega"), ", that is, write ",
                  math(r"\tau=\omega t"), ", ", math(r"X=\omega x/v_0"), " and ", math(r"Y=\omega y/v_0"),
                  ". With ", math(r"\omega^2=k\sigma b\psi/m"), ", equations (22) to (25) become"),
        formula(r"\begin{align*} X''&=-\frac{Y}{k}, & X(0)&=0, & X'(0)&=\cos\alpha \\ "
                r"Y''&=-Y, & Y(0)&=0, & Y'(0)&=\sin\alpha \end{align*}"),
        paragraph("and the volume (27) becomes"),
        formula(r"V=b\left(\frac{v_0}{\omega}\right)^2\int_0^{\tau_c}Y\,X'\,d\tau"
                r"=\frac{m v_0^2}{\sigma\psi}\cdot f(\alpha,k),\qquad f=\frac{1}{k}\int_0^{\tau_c}Y\,X'\,d\tau"),
        paragraph("All that is left in ", math("f"), " is the angle and ", math("k"), ". The speed, the mass, the flow "
                  "stress and ", math(r"\psi"), " stand before it: they stretch the whole curve and move its maximum "
                  "neither left nor right. So"),
        formula(r"V\propto v_0^2,\qquad\frac{\partial\alpha_\text{max}}{\partial v_0}=0"),
        family_table(case, family, "The greatest volume at several speeds"),
        paragraph("The angles were found for each speed anew, by the solver; they differ by ",
                  said_angle(family.spread), ". ", math(r"V_\text{max}/v_0^2"), " is the same to within ",
                  said_part(numbers["departure_from_square"]), f", while the volume goes from {least} to "
                  f"{greatest}."),
        _sensitivity(case),
        note("The answer holds as long as nothing else brings in a length or a time. Rotation does: see the first "
             "additional question."),
    )  # fmt: skip


def _sensitivity(case: Case) -> Markup:
    return paragraph(
        "A number instead of a look: by the implicit function theorem ",
        math(r"v_0\,\partial\alpha_\text{max}/\partial v_0=-v_0V_{\alpha v_0}/V_{\alpha\alpha}"),
        ", from second derivatives of the solver, is ",
        said_rates(case.sensitivity(_MODEL, "v0")),
        ".",
    )
