"""Figures of solutions: which lines, and what is refused."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from erosion import ode
from erosion.plotting.motion import plot_solution

SPRING = ode.Problem(
    y0={"x": 1.0, "v": np.zeros(2)},
    vector_field=lambda t, y, args: {"x": y["v"][0], "v": -args["c"] * y["v"] * 0 - y["x"]},
)
TS = np.linspace(0.0, 3.0, 7)


def test_a_line_for_each_part_and_a_mark_at_each_end() -> None:
    end = ode.solve(SPRING, {"c": np.array([1.0, 2.0])}, t1=2.5, ts=TS)
    ax = plot_solution(end, ["x"])
    lines = ax.get_lines()
    assert len(lines) == 4
    assert np.array_equal(np.asarray(lines[0].get_ydata()), end.ys["x"][0], equal_nan=True)
    assert np.isnan(end.ys["x"][0, -1])
    assert lines[1].get_xdata() == pytest.approx(2.5)
    whole = plot_solution(end, ax=plt.figure().add_subplot())
    assert len(whole.get_lines()) == 12
    assert set(whole.get_legend_handles_labels()[1]) == {"x", "v[0]", "v[1]"}
    plt.close("all")


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(ValueError, match="ts"):
        plot_solution(ode.solve(SPRING, {"c": 1.0}, t1=1.0))
    with pytest.raises(ValueError, match="names"):
        plot_solution(ode.solve(SPRING, {"c": 1.0}, t1=1.0, ts=[0.5]), ["z"])
    with pytest.raises(ValueError, match="has 0"):
        plot_solution(ode.solve(SPRING, {"c": np.ones(0)}, t1=1.0, ts=[0.5]))
    with pytest.raises(ValueError, match="lanes"):
        plot_solution(ode.solve(SPRING, {"c": np.ones(13)}, t1=1.0, ts=[0.5]))
