"""Question 3: the volume removed."""

import numpy as np
from matplotlib.figure import Figure

from erosion.output.tables import Record
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import conversion_factor
from erosion.plotting.motion import plot_removal_rate
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase

_PANELS = (10, 100, 1000)


def answer(case: ReportCase) -> Answer:
    """V by closed form, by the integrator, by the midpoint rule and from the speeds at both ends."""
    to_si = conversion_factor("volume", case.units, "si")
    scale = readable_scale("volume", "si", case.volume * to_si)
    return Answer(
        _numbers(case),
        {} if case.ended_by == "no-cut" else {"rate-of-removal": _figure(case)},
        {"bars": _PANELS[0], "si_unit": scale.unit, "to_si_unit": to_si / scale.size},
    )


def midpoint_rule(case: ReportCase, panels: int) -> float:
    """B ∫ y ẋ dt by the midpoint rule on the closed forms of question 1."""
    width = case.t_c / panels
    state = case.closed.state((np.arange(panels) + 0.5) * width, case.p)
    return float(case.p.b) * float(np.sum(np.asarray(state.y * state.vx))) * width


def _numbers(case: ReportCase) -> Record:
    p, motion = case.p, case.trajectory
    lost = float(motion.vx[0] ** 2 - motion.vx[-1] ** 2)
    return {
        "volume": case.volume,
        "volume_si": case.volume * conversion_factor("volume", case.units, "si"),
        "volume_numerical": motion.volume,
        "volume_from_speeds": float(p.m / (2 * p.sigma * p.psi)) * lost,
        "volume_midpoint": {str(panels): midpoint_rule(case, panels) for panels in _PANELS},
        "volume_scale": float(p.volume_scale),
    }


def _figure(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.4, 3.5)
    plot_removal_rate(ax, case.trajectory, bars=_PANELS[0])
    return fig
