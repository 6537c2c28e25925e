"""The figures that a tab exports."""

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure

from erosion.explorer.computed import ANGLES, SPINS, Answers
from erosion.explorer.state import PageState
from erosion.plotting.curves import AngleSeries, plot_best_angles, plot_optimum
from erosion.plotting.motion import plot_end_times, plot_trajectory
from erosion.plotting.style import new_axes, render
from erosion.plotting.sweeps import plot_comparison
from erosion.sweeps.sweep import compare


def draw(name: str, suffix: str, answers: Answers, state: PageState) -> bytes:
    """Draw the figure of this name; returns the bytes of an "svg" or "png" file."""
    return render(_DRAWN[name](answers, state), suffix)


def _cut(answers: Answers, state: PageState) -> Figure:
    return plot_trajectory(answers.cut(state.shown, state.case))


def _volumes(answers: Answers, state: PageState) -> Figure:
    models = [answers.model(name, state.case) for name in state.models]
    return plot_comparison(compare(models, state.case.parameters()))


def _optimum(answers: Answers, state: PageState) -> Figure:
    return plot_optimum(answers.best(state.shown, state.case.at_any_angle()))


def _end_times(answers: Answers, state: PageState) -> Figure:
    over_angles = state.case.at_any_angle()
    fig, ax = new_axes(6.2, 4.4)
    case_point = state.case.numbers()["alpha"], float(answers.point(state.shown, state.case).t_c)
    ends, curve = answers.ends(state.shown, over_angles), answers.curve(state.shown, over_angles)
    plot_end_times(ax, ANGLES, ends, np.asarray(curve.t_c), units=state.case.units, marks={"case": case_point})
    return fig


def _spins(answers: Answers, state: PageState) -> Figure:
    fig, ax = new_axes(6.2, 4.4)
    curves = []
    for name in state.models:
        spins = answers.spins(name, state.case.at_any_spin())
        curves.append(AngleSeries(name, SPINS, spins.alpha, spins.kind == "jump"))
    plot_best_angles(ax, curves, xlabel="$s = r\\,\\dot\\varphi_0/v_0$  initial spin")
    return fig


_DRAWN: Mapping[str, Callable[[Answers, PageState], Figure]] = {
    "cut": _cut,
    "volumes": _volumes,
    "optimum": _optimum,
    "end-times": _end_times,
    "spins": _spins,
}
