"""Question 8: whether the guessed parameters ψ and k matter."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.parameters.parameters import QUANTITIES
from erosion.plotting.families import BestAngles, plot_best_angles
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import degrees, degrees_tex, formula, join, math, number, paragraph
from erosion.report.varied import family_figure, family_numbers, family_table, said_angle, said_part

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: Case) -> Answer:
    """ψ does not matter; k does: α_max = ½ arctan k."""
    families = case.families(_MODEL)
    ratios = families["k"]
    numbers = {
        "psi": family_numbers(case, families["psi"], _MODEL)
        | {"departure_from_inverse": families["psi"].departure(-1)},
        "k": family_numbers(case, ratios, _MODEL)
        | {"largest_difference_from_law": float(np.abs(ratios.alpha - np.arctan(ratios.values) / 2).max())},
    }
    return Answer(
        key="q8",
        title="Do the guesses for ψ and k change the best angle?",
        sentence=Markup("ψ does <strong>not</strong>, <strong>but k does</strong>: {}, from {} at {} to {} at {}; the "
                        "one guess that decides the answer.").format(
            math(r"\alpha_\text{max}=\frac{1}{2}\arctan k"),
            degrees(float(ratios.alpha[0])), math(f"k={number(ratios.values[0], 3, strip=True)}"),
            degrees(float(ratios.alpha[-1])), math(f"k={number(ratios.values[-1], 3, strip=True)}"),
        ),
        figures=_figures(case),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _figures(case: Case) -> tuple[Illustration, ...]:
    families = case.families(_MODEL)
    ratios = families["k"]
    fig, ax = new_axes(5.4, 3.7)
    found = BestAngles("computed", ratios.values, ratios.alpha, ratios.kind == "jump", line=False)
    law = np.geomspace(ratios.values[0], ratios.values[-1], 200)
    plot_best_angles(ax, [found], xlabel=QUANTITIES["k"].label(case.units), log=True,
                     exact=("½ arctan k", law, np.arctan(law) / 2))  # fmt: skip
    return (
        family_figure(case, families["psi"], "contact-heights",
                      Markup("The volume removed over the angle of attack for {} over (0, 5), on a logarithmic axis: "
                             "one shape, shifted up and down.").format(math(r"\psi"))),
        family_figure(case, ratios, "force-ratios",
                      Markup("The same for {} over (0.1, 10). The larger the force that lifts the erodent, the less is "
                             "removed, and the steeper the best angle.").format(math("k"))),
        Illustration("best-angle-over-k", fig,
                     Markup("The angle of greatest removal over {}: computed points on the law {}.")
                     .format(math("k"), math(r"\frac{1}{2}\arctan k")),
                     "Angle of greatest removal over the force ratio, points on the curve ½ arctan k."),
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    families = case.families(_MODEL)
    psi, k = numbers["psi"], numbers["k"]
    exact = np.rad2deg(float(case.p.k) / (1 + float(case.p.k) ** 2) / 2)
    return join(
        paragraph(Markup("<b>ψ</b> "), "stands in ", math(r"V=(mv_0^2/\sigma\psi)\,f(\alpha,k)"), " as the flow stress "
                  "does: it divides the volume. That it was a wild guess costs the amount, not the angle. Over the "
                  "values tried the angles differ by ", said_angle(psi["spread"]), ", and ", math(r"\psi V_\text{max}"),
                  " by ", said_part(psi["departure_from_inverse"]), "."),
        family_table(case, families["psi"], "The greatest volume for several ψ"),
        paragraph(Markup("<b>k</b> "), "is left in ", math("f"), ". Question 4 found"),
        formula(r"\alpha_\text{max}=\frac{1}{2}\arctan k,\qquad"
                r"k\frac{\partial\alpha_\text{max}}{\partial k}=\frac{1}{2}\cdot\frac{k}{1+k^2},\qquad"
                r"V_\text{max}=\frac{V^{*}}{k^2}\left(\sqrt{1+k^2}-1\right)"),
        paragraph("It is below 45° for every ", math("k"), ", and goes to 0 with it. The computed angles lie on the "
                  "law to ", degrees(k["largest_difference_from_law"], 1), ":"),
        family_table(case, families["k"], "The greatest volume for several k"),
        paragraph("In this case ", math(r"k\,\partial\alpha_\text{max}/\partial k"), " is ",
                  degrees(case.sensitivity(_MODEL, "k"), 8), " by second derivatives of the solver and ",
                  math(degrees_tex(np.deg2rad(exact), 8)), " by the law: if ", math("k"), " is off by a tenth, so is "
                  "the angle by about ", degrees(case.sensitivity(_MODEL, "k") / 10, 2), "."),
    )  # fmt: skip
