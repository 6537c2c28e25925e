"""Question 4: the angle at which most is removed."""

import numpy as np
from matplotlib.figure import Figure

from erosion.output.tables import Record
from erosion.plotting.motion import plot_volume
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase
from erosion.report.studies import greatest, volume_jet


def answer(case: ReportCase) -> Answer:
    """α_max by Newton's method on the derivative of the solver, checked against ½ arctan k."""
    steps = greatest(volume_jet(case.model, case.p))
    exact = float(case.closed.alpha_max(case.p))
    numbers = {
        "alpha_max": steps[-1].alpha,
        "volume_max": steps[-1].volume,
        "d2volume": steps[-1].d2volume,
        "alpha_max_closed_form": exact,
        "volume_max_closed_form": float(case.closed.volume(case.p.replace(alpha=exact))),
        **case.weighed(case.volume),
        **{f"{name}_max": value for name, value in case.weighed(steps[-1].volume).items()},
        "iterates": [step._asdict() for step in steps],
    }
    far = case.per_mass.far_from_tests(steps[-1].volume, case.p)
    return Answer(numbers, {"volume-over-angle": _figure(case, numbers)}, {"far": far})


def _figure(case: ReportCase, numbers: Record) -> Figure:
    p = case.over_angles()
    at_cusp = float(case.closed.volume(p.replace(alpha=case.cusp)))
    fig, ax = new_axes(5.4, 4.0)
    plot_volume(
        ax,
        case.angles,
        np.asarray(case.closed.volume(p)),
        case.closed.ended_by(p),
        units=case.units,
        marks={
            "branch": (case.cusp, at_cusp),
            "case": (case.alpha, case.volume),
            "best": (numbers["alpha_max"], numbers["volume_max"]),
        },
    )
    return fig
