"""Additional question 2: k = tan α."""

import numpy as np
from matplotlib.figure import Figure

from erosion.models.closed_forms import StraightCut
from erosion.output.tables import Record
from erosion.plotting.curves import plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase

_MODEL, _TURNING = "tan-alpha", "rotating-tan-alpha"
NEEDS = tuple((kind, model) for model in (_MODEL, _TURNING, "linearized") for kind in ("optimum", "hits"))


def answer(case: ReportCase) -> Answer:
    """V = (V*/2) cos²α only falls: no interior maximum, a supremum that is not reached."""
    return Answer(_numbers(case), {"tan-alpha": _figure(case)})


def _numbers(case: ReportCase) -> Record:
    optimum, turning, hits = case.optimum(_MODEL), case.optimum(_TURNING), case.hits(_MODEL)
    exact = np.asarray(StraightCut().volume(hits.p))
    return {
        "supremum": float(optimum.volume),
        "supremum_closed_form": float(case.p.volume_scale) / 2,
        "alpha_of_supremum": float(optimum.alpha),
        "attained": bool(optimum.attained),
        "kind": str(optimum.kind),
        "largest_difference": float(np.abs(hits.volume - exact).max() / float(case.p.volume_scale)),
        "largest_slope": float(hits.dvolume.max()),
        "volume_at_case": float(hits.volume[-1]),
        "rotating": {
            "alpha_max": float(turning.alpha),
            "volume_max": float(turning.volume),
            "kind": str(turning.kind),
            "ended_by": str(turning.ended_by),
        },
    }


def _figure(case: ReportCase) -> Figure:
    labels = {"linearized": "k constant", _MODEL: "k = tan α", _TURNING: "k = tan α, the body turns"}
    fig, ax = new_axes(5.4, 4.1)
    plot_family(ax, [case.curve(model, label) for model, label in labels.items()], units=case.units, columns=2)
    return fig
