"""Public figures of one panel draw into axes of the caller's."""

import inspect

import numpy as np
import pytest

import erosion
from erosion.plotting.curves import plot_optimum
from erosion.plotting.motion import plot_path
from erosion.plotting.style import new_figure, render
from erosion.plotting.sweeps import plot_comparison, plot_sweep

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
ANGLES = np.deg2rad(np.linspace(5, 85, 9))
FIGURES = {
    plot_optimum: lambda: erosion.alpha_max("linearized", P),
    plot_comparison: lambda: erosion.compare(["linearized", "finnie"], P),
    plot_sweep: lambda: erosion.sweep("linearized", P, alpha=ANGLES),
    plot_path: lambda: erosion.simulate("linearized", P),
}


@pytest.mark.parametrize("plot", FIGURES, ids=lambda plot: plot.__name__)
def test_a_figure_draws_where_it_is_told(plot):
    assert inspect.signature(plot).parameters["ax"].kind == inspect.Parameter.KEYWORD_ONLY
    fig = new_figure(8.0, 4.0)
    left, right = fig.subplots(1, 2)
    plot(FIGURES[plot](), ax=right)
    assert right.lines
    assert not left.lines
    assert not fig.legends
    assert render(fig, "png")


def test_without_axes_there_is_a_new_figure():
    assert len(plot_sweep(FIGURES[plot_sweep]()).axes) == 1
    assert plot_path(FIGURES[plot_path]()).lines
