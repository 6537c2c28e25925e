"""Question 6: whether the erodent's size and mass matter."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.report.case import Answer, Case
from erosion.report.text import degrees, formula, join, math, number, paragraph, quantity
from erosion.report.varied import family_figure, family_numbers, family_table, said_angle, said_part, said_rates

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: Case) -> Answer:
    """R is absent from the equations; V ∝ m."""
    families = case.families(_MODEL)
    numbers = {
        "m": family_numbers(case, families["m"], _MODEL) | {"departure_from_proportion": families["m"].departure(1)},
        "r": family_numbers(case, families["r"], _MODEL)
        | {"largest_difference": float(np.ptp(families["r"].volumes, axis=0).max())},
    }
    return Answer(
        key="q6",
        title="Does the erodent change the best angle?",
        sentence=Markup("<strong>No</strong>: its size {} is not in the equations at all, and the volume is simply "
                        "proportional to its mass {}; the best angle stays {}.").format(
            math("r"), math("m"), degrees(float(families["m"].alpha[0]))
        ),
        figures=(
            family_figure(case, families["m"], "masses",
                          Markup("The volume removed over the angle of attack for five masses, {} = {}. Twice the mass "
                                 "removes twice the volume, at the same angle.").format(
                              math("m"), quantity(float(case.p.m), "mass", case.units, 4))),
        ),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    families = case.families(_MODEL)
    r, m = numbers["r"], numbers["m"]
    same = "exactly the same" if r["largest_difference"] == 0 else f"the same to {number(r['largest_difference'], 1)}"
    return join(
        paragraph(Markup("<b>Size.</b> "), "Equations (22) to (25) do not contain ", math("r"), ": without rotation it "
                  "does not matter how far the tip is from the centre of mass. The solver agrees: from a quarter to "
                  f"four times the size, every volume at every angle is {same}."),
        paragraph(Markup("<b>Mass.</b> "), "By the answer to question 5, ", math(r"V=(mv_0^2/\sigma\psi)\,f(\alpha,k)"),
                  ". The mass stretches the curve, and"),
        formula(r"V\propto m,\qquad\frac{\partial\alpha_\text{max}}{\partial m}=0"),
        family_table(case, families["m"], "The greatest volume for several masses"),
        paragraph("The angles differ by ", said_angle(m["spread"]), ", and ", math(r"V_\text{max}/m"), " by ",
                  said_part(m["departure_from_proportion"]), ". The sensitivities ",
                  math(r"m\,\partial\alpha_\text{max}/\partial m"), " and ",
                  math(r"r\,\partial\alpha_\text{max}/\partial r"), " are ",
                  said_rates(case.sensitivity(_MODEL, "m"), case.sensitivity(_MODEL, "r")),
                  ": a stream of mixed grains has the best angle of each of them."),
    )  # fmt: skip
