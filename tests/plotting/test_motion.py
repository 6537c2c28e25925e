"""Figures of one impact: the curves carry the right data in readable units."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from erosion.impacts.simulate import Trajectory, simulate
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from erosion.parameters.quantities import readable_scale
from erosion.plotting.curves import plot_end_times, plot_volume
from erosion.plotting.motion import plot_histories, plot_path, plot_removal_rate, plot_trajectory
from erosion.plotting.style import new_axes, new_figure, save_plot

CLOSED = LinearizedCut()


def line(ax: Axes, label: str) -> np.ndarray:
    """x and y of the line with this label, shape (2, n)."""
    found = [one for one in ax.lines if str(one.get_label()).startswith(label)]
    assert len(found) == 1, [str(one.get_label()) for one in ax.lines]
    return np.array(found[0].get_data(), dtype=float)


def test_histories_are_the_closed_form(cut: Trajectory) -> None:
    panels = plot_histories(new_figure(), cut, CLOSED)
    exact = CLOSED.state(cut.t, TABLE_1)
    for panel, values, size in zip(panels, (exact.x, exact.y, exact.vx, exact.vy), (1e-3, 1e-3, 1, 1), strict=True):
        time, drawn = line(panel, "tip")
        np.testing.assert_allclose(time, np.linspace(0, 66.353363429, 201), rtol=1e-9)
        # The solver's tolerance of 1e-12 relative, against the greatest value: y returns to 0.
        np.testing.assert_allclose(drawn, np.asarray(values) / size, atol=1e-10 * np.abs(drawn).max())
        np.testing.assert_allclose(line(panel, "closed form")[1], np.asarray(values) / size, rtol=1e-14)
    assert [panel.get_ylabel() for panel in panels] == ["x  [mil]", "y  [mil]", "ẋ  [in/s]", "ẏ  [in/s]"]


def test_path_points_down_into_the_target(cut: Trajectory) -> None:
    ax = plot_path(cut, ax=new_axes()[1])
    x, depth = line(ax, "path of the tip")
    np.testing.assert_allclose(x, cut.x_tip * 1e3, rtol=1e-12)
    np.testing.assert_allclose(depth, cut.depth * 1e3, rtol=1e-12)
    bottom, top = ax.get_ylim()
    assert bottom > depth.max() > 0 > top
    assert line(ax, "start").ravel() == pytest.approx([0, 0])
    assert line(ax, "end: rebound")[0, 0] == pytest.approx(x[-1])
    (removed,) = [part for part in ax.collections if part.get_label() == "cut away"]
    corners = np.asarray(removed.get_paths()[0].vertices)
    # The shoelace formula on the filled outline, times the width, is the volume.
    twice = np.sum(corners[:-1, 0] * corners[1:, 1] - corners[1:, 0] * corners[:-1, 1])
    # 200 trapezes of an arc: relative error of 1e-4.
    assert abs(twice) / 2 * 1e-6 * TABLE_1.b == pytest.approx(cut.volume, rel=1e-4)


@pytest.mark.slow
def test_rotating_body_shows_tip_and_centre_of_mass() -> None:
    cut = simulate("rotating", TABLE_1)
    fig = plot_trajectory(cut)
    x_panel, y_panel = fig.subfigs[1].axes[:2]
    np.testing.assert_allclose(line(x_panel, "tip")[1], cut.x_tip * 1e3)
    np.testing.assert_allclose(line(x_panel, "centre of mass")[1], cut.x * 1e3)
    np.testing.assert_allclose(line(y_panel, "centre of mass")[1], cut.y * 1e3)
    heading = fig.get_suptitle()
    assert heading.startswith("rotating at α = 20°: rebound after 49.68 µs")
    assert "1.0141 × 10⁻⁴ in³ removed, turned by −69.69°" in heading


def test_an_impact_that_cuts_nothing_is_drawn(tmp_path) -> None:
    fig = plot_trajectory(simulate("linearized", TABLE_1.replace(alpha=np.pi / 2)))
    assert "nothing is cut" in fig.get_suptitle()
    assert save_plot(fig, tmp_path / "nothing.png").stat().st_size > 0


def test_end_times_are_both_candidates_and_the_lesser() -> None:
    angles = np.deg2rad(np.array([10.0, 46.0, 50.0, 80.0]))
    p = TABLE_1.replace(alpha=angles)
    rebound = np.pi / 47346.4 * np.ones(4)
    stop = np.array([np.nan, *np.arccos(1 - 2 / np.tan(angles[1:])) / 47346.4])
    ends = {name: np.asarray(times) for name, times in CLOSED.end_times(p).items()}
    ax = plot_end_times(new_axes()[1], angles, ends, np.asarray(CLOSED.t_c(p)), units=p.units,
                        marks={"cusp": (np.pi / 4, rebound[0])})  # fmt: skip
    # ω is typed in above to six digits.
    np.testing.assert_allclose(line(ax, "rebound"), [np.rad2deg(angles), rebound * 1e6], rtol=1e-5)
    np.testing.assert_allclose(line(ax, "stop")[1], stop * 1e6, rtol=1e-5)
    np.testing.assert_allclose(line(ax, "actual end")[1], np.fmin(rebound, stop) * 1e6, rtol=1e-5)
    assert line(ax, "cusp at 45°")[0, 0] == pytest.approx(45)
    assert ax.get_ylabel().endswith("[µs]")


def test_volume_is_split_by_the_end_of_the_cut() -> None:
    angles = np.deg2rad(np.array([20.0, 40.0, 60.0, 70.0]))
    scale = 6.9091e-4  # V* of Table 1
    volume = scale * np.array([*(np.sin(2 * angles[:2]) - np.sin(angles[:2]) ** 2) / 2, *np.cos(angles[2:]) ** 2 / 2])
    ends = np.array(["rebound", "rebound", "stop", "stop"])
    ax = plot_volume(new_axes()[1], angles, volume, ends, units="si", marks={"best": (0.5, 1e-4)})
    assert "m³" in ax.get_ylabel()
    degrees, rebound = line(ax, "ends by rebound")
    np.testing.assert_allclose(degrees, [20, 40, 60, 70])
    size = readable_scale("volume", "si", float(volume.max())).size
    np.testing.assert_allclose(rebound[:2] * size, volume[:2])
    assert np.isnan(rebound[2:]).all()
    stop = line(ax, "ends by stop")[1]
    np.testing.assert_allclose(stop[1:] * size, volume[1:])
    assert np.isnan(stop[0])


def test_bars_are_the_midpoint_rule(cut: Trajectory) -> None:
    ax = plot_removal_rate(new_axes()[1], cut, bars=100)
    bars = sum(bar.get_bbox().width * bar.get_bbox().height for bar in ax.patches if isinstance(bar, Rectangle))
    assert ax.get_ylabel() == "$dV/dt$  [10⁻⁶ in³/µs]"
    # The midpoint rule with 100 bars errs by 4.1e-5, here and in the report's table.
    assert bars * 1e-6 / cut.volume - 1 == pytest.approx(4.11e-5, rel=0.01)
