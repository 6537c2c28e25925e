"""Question 2: when the cut stops."""

import numpy as np
from matplotlib.figure import Figure

from erosion.plotting.motion import plot_end_times
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase


def answer(case: ReportCase) -> Answer:
    """t_c as the smaller of two candidates; Figure 9."""
    times = {name: float(time) for name, time in case.closed.end_times(case.p).items()}
    numbers = {
        "t_c": case.t_c,
        "ended_by": case.ended_by,
        "candidates": {name: time if np.isfinite(time) else None for name, time in times.items()},
        "cusp": case.cusp,
        "t_c_numerical": case.trajectory.t_c,
        "ended_by_numerical": case.trajectory.ended_by,
    }
    end = case.closed.state(case.t_c, case.p)
    fields = {"vx_end": float(end.vx), "y_end": float(end.y), "k_cot_alpha": float(case.p.k) / np.tan(case.alpha)}
    return Answer(numbers, {"figure-9-end-of-cut": _figure(case)}, fields)


def _figure(case: ReportCase) -> Figure:
    angles, p = case.angles, case.over_angles()
    candidates = {name: np.asarray(times) for name, times in case.closed.end_times(p).items()}
    # The real part of the complex root of cos ωt = 1 - k cot α is π/ω wherever 1 - k cot α < -1.
    real_part = np.where(angles <= case.cusp, np.pi / case.omega, np.nan)
    fig, ax = new_axes(5.4, 4.1)
    plot_end_times(
        ax,
        angles,
        candidates,
        np.asarray(case.closed.t_c(p)),
        units=case.units,
        real_part=real_part,
        marks={"cusp": (case.cusp, np.pi / case.omega), "case": (case.alpha, case.t_c)},
    )
    return fig
