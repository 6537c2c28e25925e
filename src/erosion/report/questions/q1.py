"""Question 1: the solutions x(t) and y(t)."""

import numpy as np
from matplotlib.figure import Figure

from erosion.impacts.simulate import SimulationError, path
from erosion.models import load_model
from erosion.output.tables import Record
from erosion.parameters.units import Dimension
from erosion.plotting.motion import plot_histories, plot_path
from erosion.plotting.style import new_axes, new_figure
from erosion.report.case import Answer, ReportCase

_STATE: tuple[tuple[str, str, Dimension], ...] = (
    ("x", "x", "length"),
    ("y", "y", "length"),
    ("vx", "ẋ", "speed"),
    ("vy", "ẏ", "speed"),
)


def answer(case: ReportCase) -> Answer:
    """x(t) and y(t) as formulas and with numbers; Figures 7 and 8."""
    numbers = _numbers(case)
    checks = [
        (symbol, dimension, float(np.abs(getattr(case.trajectory, name)).max()), numbers["largest_difference"][name])
        for name, symbol, dimension in _STATE
    ]
    figures = {} if case.ended_by == "no-cut" else _figures(case)
    return Answer(numbers, figures, {"warnings": case.trajectory.warnings, "checks": checks})


def _numbers(case: ReportCase) -> Record:
    p, motion = case.p, case.trajectory
    along, down = float(p.v0 * np.cos(p.alpha)), float(p.v0 * np.sin(p.alpha))
    exact = case.closed.state(motion.t, p)
    differences = {}
    for name, _, _ in _STATE:
        closed = np.asarray(getattr(exact, name))
        differences[name] = float(np.abs(getattr(motion, name) - closed).max())
    return {
        "omega": case.omega,
        "stiffness": float(p.stiffness),
        "vx_0": along,
        "vy_0": down,
        "x_slope": along - down / float(p.k),
        "x_amplitude": down / (float(p.k) * case.omega),
        "y_amplitude": down / case.omega,
        "vx_amplitude": down / float(p.k),
        "x_end": float(motion.x[-1]),
        "y_end": float(motion.y[-1]),
        "vx_end": float(motion.vx[-1]),
        "vy_end": float(motion.vy[-1]),
        "largest_difference": differences,
        "turn_if_free": _turn_if_free(case),
    }


def _turn_if_free(case: ReportCase) -> float | None:
    """How far the body would turn [rad] if the force could turn it."""
    try:
        return path(load_model("rotating"), case.p).turn
    except SimulationError:
        return None


def _figures(case: ReportCase) -> dict[str, Figure]:
    histories = new_figure(5.6, 4.5)
    plot_histories(histories, case.trajectory, case.closed)
    tip_path, ax = new_axes(5.6, 3.4)
    plot_path(case.trajectory, ax=ax)
    return {"figure-7-histories": histories, "figure-8-path": tip_path}
