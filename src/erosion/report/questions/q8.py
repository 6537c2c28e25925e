"""Question 8: whether the guessed parameters ψ and k matter."""

import numpy as np
from matplotlib.figure import Figure

from erosion.parameters.parameters import QUANTITIES
from erosion.plotting.curves import AngleSeries, plot_best_angles
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase
from erosion.report.studies import family_figure, family_numbers

_MODEL = "linearized"
NEEDS = (("families", _MODEL), ("optimum", _MODEL), ("sensitivities", _MODEL))


def answer(case: ReportCase) -> Answer:
    """ψ does not matter; k does: α_max = ½ arctan k."""
    contacts, ratios = (case.families(_MODEL)[name] for name in ("psi", "k"))
    k = float(case.p.k)
    numbers = {
        "psi": family_numbers(case, contacts, _MODEL) | {"departure_from_inverse": contacts.departure(-1)},
        "k": family_numbers(case, ratios, _MODEL)
        | {"largest_difference_from_law": float(np.abs(ratios.alpha - np.arctan(ratios.values) / 2).max())},
    }
    figures = {
        "contact-heights": family_figure(case, contacts),
        "force-ratios": family_figure(case, ratios),
        "best-angle-over-k": _figure(case),
    }
    return Answer(numbers, figures, {"contacts": contacts, "ratios": ratios, "by_law": k / (1 + k**2) / 2})


def _figure(case: ReportCase) -> Figure:
    ratios = case.families(_MODEL)["k"]
    fig, ax = new_axes(5.4, 3.7)
    computed = AngleSeries("computed", ratios.values, ratios.alpha, ratios.kind == "jump", line=False)
    law = np.geomspace(ratios.values[0], ratios.values[-1], 200)
    plot_best_angles(ax, [computed], xlabel=QUANTITIES["k"].label(case.units), log=True,
                     exact=("½ arctan k", law, np.arctan(law) / 2))  # fmt: skip
    return fig
