"""The figures that a tab exports."""

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure

from erosion.explorer.computed import ANGLES, SPINS, Answers
from erosion.explorer.state import PageState
from erosion.plotting.curves import AngleSeries, plot_best_angles, plot_end_times, plot_optimum
from erosion.plotting.motion import plot_trajectory
from erosion.plotting.style import new_axes
from erosion.plotting.sweeps import plot_comparison
from erosion.sweeps.sweep import compare


def _volumes(answers: Answers, state: PageState) -> Figure:
    models = [answers.model(name, state.case) for name in state.models]
    return plot_comparison(compare(models, state.case.parameters()))


def _end_times(answers: Answers, state: PageState) -> Figure:
    fig, ax = new_axes(6.2, 4.4)
    ends, curve, point = (answers(kind, state.shown, state.case) for kind in ("ends", "curve", "point"))
    marks = {"case": (state.case.numbers()["alpha"], float(point.t_c))}
    plot_end_times(ax, ANGLES, ends, np.asarray(curve.t_c), units=state.case.units, marks=marks)
    return fig


def _spins(answers: Answers, state: PageState) -> Figure:
    fig, ax = new_axes(6.2, 4.4)
    spins = {name: answers("spins", name, state.case) for name in state.models}
    curves = [AngleSeries(name, SPINS, best.alpha, best.kind == "jump") for name, best in spins.items()]
    plot_best_angles(ax, curves, xlabel="$s = r\\,\\dot\\varphi_0/v_0$  initial spin")
    return fig


FIGURES: Mapping[str, Callable[[Answers, PageState], Figure]] = {
    "cut": lambda answers, state: plot_trajectory(answers("cut", state.shown, state.case)),
    "volumes": _volumes,
    "optimum": lambda answers, state: plot_optimum(answers("best", state.shown, state.case)),
    "end-times": _end_times,
    "spins": _spins,
}
"""By the name of its file, without the suffix."""
