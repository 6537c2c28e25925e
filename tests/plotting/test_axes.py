"""Public figures of one panel draw into axes of the caller's.

Figures as files: the same bytes each time, and nothing half written.

Figures say which share of the volume is cut and which share deformation removes.

Figures of one impact: the curves carry the right data in readable units.

Figures of solutions: which lines, and what is refused.

Figures of sweeps and streams: the drawn numbers are the computed ones, in readable units.
"""

import inspect
import io
import struct
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

import erosion
from erosion import TABLE_1, Estimate, NozzleAngle, Trajectory, ode, simulate, sweep
from erosion.impacts import BEYOND_LABEL
from erosion.models import BUILT_IN, Linearized, ProportionalDeformationWear
from erosion.models.rigid import LinearizedCut
from erosion.plotting.curves import plot_end_times, plot_optimum
from erosion.plotting.labels import AT_CONTACT, PALETTE
from erosion.plotting.maps import plot_nozzle_angle
from erosion.plotting.motion import (
    animate_cut,
    plot_histories,
    plot_path,
    plot_removal_rate,
    plot_solution,
    plot_trajectory,
)
from erosion.plotting.style import (
    fit_legends,
    house_style,
    legend_below,
    new_axes,
    new_figure,
    plot_files,
    render,
    save_plot,
    save_plots,
)
from erosion.plotting.sweeps import plot_comparison, plot_sweep
from erosion.report.case import families_of
from erosion.sweeps.boundaries import with_boundaries
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import prepare_sweep

P = erosion.TABLE_1
INCH = 0.0254  # m
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


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_files_are_the_same_each_time_and_undated(cut: Trajectory, tmp_path, suffix: str) -> None:
    contents = {save_plot(plot_trajectory(cut), tmp_path / f"{n}.{suffix}").read_bytes() for n in range(2)}
    assert len(contents) == 1
    assert b"Date" not in contents.pop()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"0.{suffix}", f"1.{suffix}"]


def test_style_does_not_depend_on_the_users_settings(cut: Trajectory, tmp_path) -> None:
    import matplotlib as mpl

    usual = save_plot(plot_trajectory(cut), tmp_path / "a.svg").read_bytes()
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red", "svg.fonttype": "none"}):
        before = mpl.rcParams["font.size"]
        assert save_plot(plot_trajectory(cut), tmp_path / "b.svg").read_bytes() == usual
        assert mpl.rcParams["font.size"] == before


def test_one_text_names_files_of_several_widths() -> None:
    assert plot_files("a,b.png") == {Path("a,b.png"): None}
    named = {Path(name): width for name, width in (("a.PNG", None), ("b@c.pdf", 0.084), ("d.svg", 0.174))}
    for between in ("a.PNG, b@c.pdf@84mm,d.svg@17.4 cm", "a.PNG ,b@c.pdf @ 84mm , d.svg@17.4 cm"):
        assert plot_files(between) == named
    cloud = "GoogleDrive-jo.smith@gmail.com/My Drive/wear.png"
    assert plot_files(f"{cloud},Berlin,2026.png@84mm") == {Path(cloud): None, Path("Berlin,2026.png"): 0.084}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a.png,b.doc", "b.doc: a plot's"),
        ("a.eps,a.png", "a.eps: a plot's"),
        ("a.png,", "a plot's file name must end in"),
        ("a.svg@84 kg", "a.svg: the width must be a length"),
        ("a.svg@0.084", "a.svg: the width must be from 50 mm to 500 mm, with its unit"),
        ("a.png@84,a.svg", "a.png: the width must be from 50 mm to 500 mm, with its unit"),
        ("a.png@84mm,a.png", "a.png: is named twice"),
        ("a.png@84mm,./a.png@17cm", "a.png: is named twice"),
    ],
)
def test_a_text_that_names_no_files_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot_files(text)


def test_a_figure_for_print_has_its_width_and_all_of_its_legend(tmp_path) -> None:
    drawn = []

    def make() -> Any:
        fig, ax = new_axes(6.2, 4.4)
        for i in range(5):
            ax.errorbar([0, 1], [i, i], 1, label=f"a model with the long name {i}")
        legend_below(ax, 4)
        drawn.append((fig, mpl.rcParams["font.size"]))
        return fig

    files = plot_files(f"{tmp_path}/a.png@84mm,{tmp_path}/b.svg@84mm,{tmp_path}/c.png")
    save_plots(make, files)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.svg", "c.png"]
    widths = [struct.unpack(">I", (tmp_path / name).read_bytes()[16:20])[0] for name in ("a.png", "c.png")]
    assert widths == [int(84 / 25.4 * 400), 992]
    # Two files of one width are one drawing.
    (narrow, _), (_, _) = drawn
    (legend,) = narrow.legends
    assert legend.get_window_extent().width <= narrow.bbox.width
    assert [text.get_text()[-1] for text in legend.get_texts()] == ["0", "1", "2", "3", "4"]


@pytest.mark.parametrize("letters", range(52, 100, 8))
def test_a_legend_with_a_name_wider_than_the_figure_is_not_cut(letters: int) -> None:
    name = "full rotation, constant K = k, torque of both components (rotating-full-torque) at the limit of the turn"

    fig, ax = new_axes(4.5, 4.4)
    ax.plot([0, 1], label=name[:letters].strip())
    with house_style():
        legend_below(ax, 1)
    before = fig.legends[0].get_texts()[0].get_fontsize()
    fit_legends(fig)
    (text,) = fig.legends[0].get_texts()
    assert text.get_text().replace("\n", " ") == name[:letters].strip()
    assert text.get_fontsize() == before
    # What is as wide as the figure, or wider, leaves no white at its sides.
    picture = mpl.image.imread(io.BytesIO(render(fig, "png")))[-60:, :, :3]
    assert (picture[:, [0, -1]] == 1).all()
    assert (picture != 1).any()


def test_a_legend_of_a_part_of_a_figure_is_not_cut() -> None:
    with pytest.warns(erosion.TurnWarning):  # so that the legend has one entry more
        cut = simulate("rotating-velocity-aligned-full-torque", TABLE_1)
    fig = plot_trajectory(cut)
    part, height = fig.subfigs[0], fig.get_figheight()
    assert part.legends[0].get_window_extent().width > part.bbox.width
    fit_legends(fig)
    (legend,) = part.legends
    assert legend.get_window_extent().width <= part.bbox.width
    assert fig.get_figheight() > height


@pytest.mark.parametrize("name", ["plot.jpg", "plot", "plot.svg.gz"])
def test_other_suffixes_are_refused_before_anything_is_written(tmp_path, name: str) -> None:
    with pytest.raises(ValueError, match=r"must end in \.svg, \.png or \.pdf\.$"):
        save_plot(new_figure(), tmp_path / name)
    assert not list(tmp_path.iterdir())


MODEL = Linearized(deformation=ProportionalDeformationWear(1.6, 0.25 * float(P.v0)))


def labels(fig: Figure) -> list[str]:
    return [text.get_text() for text in fig.legends[0].get_texts()]


@pytest.mark.parametrize("objective", ["volume", "volume per mass"])
def test_the_area_below_what_deformation_removes_is_shaded(objective) -> None:
    best = erosion.alpha_max(MODEL, P, objective=objective)
    fig = plot_optimum(best)
    assert AT_CONTACT in labels(fig)
    corners = np.concatenate([np.asarray(area.get_paths()[0].vertices) for area in fig.axes[0].collections])
    top = corners[corners[:, 1] > 0]
    expected = (np.sin(np.deg2rad(top[:, 0])) - 0.25) ** 2 / 3.2 * float(P.volume_scale)
    # On the axis of the curve, whose greatest value is known.
    drawn = top[:, 1] / max(np.max(np.asarray(line.get_ydata())) for line in fig.axes[0].lines) * best.value
    np.testing.assert_allclose(drawn, expected / (1 if objective == "volume" else P.m), rtol=1e-4)


def test_a_comparison_has_a_title_and_another_line_for_each_model() -> None:
    one = erosion.compare(["linearized"], P)
    fig = plot_comparison(one.isel(model=[0] * len(BUILT_IN)).assign_coords(model=[*BUILT_IN]))
    said = [label.rpartition(": ")[0] for label in labels(fig)]
    assert said == [info.summary.replace("F_x", "Fₓ") for info in BUILT_IN.values()]
    drawn = [line for line in fig.axes[0].lines if str(line.get_label()) in labels(fig)]
    for look in (Line2D.get_color, Line2D.get_marker):
        looks = {(look(line), str(vars(line)["_unscaled_dash_pattern"])) for line in drawn}
        assert len(looks) == len(BUILT_IN)


def test_a_comparison_shades_it_below_the_curves_that_have_both() -> None:
    curves = erosion.compare(["linearized", "linearized-deformation", "dnv"], P)
    fig = plot_comparison(curves)
    (area,) = fig.axes[0].collections
    corners = np.asarray(area.get_paths()[0].vertices)
    top = corners[corners[:, 1] > 0]
    lines = [np.asarray(line.get_ydata()) for line in fig.axes[0].lines]
    scale = float(curves.volume_max.max()) / max(np.nanmax(line) for line in lines)
    expected = np.sin(np.deg2rad(top[:, 0])) ** 2 / 3.2 * float(P.volume_scale)
    np.testing.assert_allclose(top[:, 1] * scale, expected, rtol=1e-4)
    assert labels(fig)[-1] == AT_CONTACT
    assert AT_CONTACT not in labels(plot_comparison(erosion.compare(["linearized", "dnv"], P)))


CLOSED = LinearizedCut()


def line(ax: Axes, label: str) -> np.ndarray:
    """x and y of the line with this label, shape (2, n)."""
    found = [one for one in ax.lines if str(one.get_label()).startswith(label)]
    assert len(found) == 1, [str(one.get_label()) for one in ax.lines]
    return np.array(found[0].get_data(), dtype=float)


def test_histories_are_the_closed_form(cut: Trajectory) -> None:
    panels = plot_histories(new_figure(), cut, CLOSED)
    exact = CLOSED.state(cut.t, TABLE_1)
    for panel, values in zip(panels, (exact.x, exact.y, exact.vx, exact.vy), strict=True):
        in_inches = np.asarray(values) / INCH
        time, drawn = line(panel, "tip")
        np.testing.assert_allclose(time, np.linspace(0, 66.353363429, 201), rtol=1e-9)
        # The solver's tolerance of 1e-12 relative, against the greatest value: y returns to 0.
        np.testing.assert_allclose(drawn, in_inches, atol=1e-10 * np.abs(drawn).max())
        np.testing.assert_allclose(line(panel, "closed form")[1], in_inches, rtol=1e-14)
    assert [panel.get_ylabel() for panel in panels] == ["x  [in]", "y  [in]", "ẋ  [in/s]", "ẏ  [in/s]"]


def test_path_points_down_into_the_target(cut: Trajectory) -> None:
    ax = plot_path(cut, ax=new_axes()[1])
    x, depth = line(ax, "path of the tip")
    np.testing.assert_allclose(x, cut.x_tip / INCH, rtol=1e-12)
    np.testing.assert_allclose(depth, cut.depth / INCH, rtol=1e-12)
    bottom, top = ax.get_ylim()
    assert bottom > depth.max() > 0 > top
    assert line(ax, "start").ravel() == pytest.approx([0, 0])
    assert line(ax, "end: rebound")[0, 0] == pytest.approx(x[-1])
    (removed,) = [part for part in ax.collections if part.get_label() == "cut away"]
    corners = np.asarray(removed.get_paths()[0].vertices)
    # The shoelace formula on the filled outline, times the width, is the volume.
    twice = np.sum(corners[:-1, 0] * corners[1:, 1] - corners[1:, 0] * corners[:-1, 1])
    # 200 trapezes of an arc: relative error of 1e-4.
    assert abs(twice) / 2 * INCH**2 * TABLE_1.b == pytest.approx(cut.volume, rel=1e-4)


def test_rotating_body_shows_tip_and_centre_of_mass() -> None:
    cut = simulate("rotating", TABLE_1)
    fig = plot_trajectory(cut)
    x_panel, y_panel = fig.subfigs[1].axes[:2]
    np.testing.assert_allclose(line(x_panel, "tip")[1], cut.x_tip / INCH)
    np.testing.assert_allclose(line(x_panel, "centre of mass")[1], cut.x / INCH)
    np.testing.assert_allclose(line(y_panel, "centre of mass")[1], cut.y / INCH)
    heading = fig.get_suptitle()
    assert heading.startswith("full rotation, constant K = k, torque r Fₓ\nat α = 20°: rebound after 49.68 µs")
    assert "1.0141·10⁻⁴ in³ removed, turned by 69.69°" in heading


def test_end_times_are_both_candidates_and_the_lesser() -> None:
    angles = np.deg2rad(np.array([10.0, 46.0, 50.0, 80.0]))
    p = TABLE_1.replace(alpha=angles)
    rebound = np.pi / 47346.4 * np.ones(4)
    stop = np.array([np.nan, *np.arccos(1 - 2 / np.tan(angles[1:])) / 47346.4])
    ends = {name: np.asarray(times) for name, times in CLOSED.end_times(p).items()}
    ax = plot_end_times(new_axes()[1], angles, ends, np.asarray(CLOSED.t_c(p)), system=p.shown_in,
                        marks={"cusp": (np.pi / 4, rebound[0])})  # fmt: skip
    # ω is typed in above to six digits.
    np.testing.assert_allclose(line(ax, "rebound"), [np.rad2deg(angles), rebound * 1e6], rtol=1e-5)
    np.testing.assert_allclose(line(ax, "stop")[1], stop * 1e6, rtol=1e-5)
    np.testing.assert_allclose(line(ax, "actual end")[1], np.fmin(rebound, stop) * 1e6, rtol=1e-5)
    assert line(ax, "cusp at 45°")[0, 0] == pytest.approx(45)
    assert ax.get_ylabel().endswith("[µs]")


def test_bars_are_the_midpoint_rule(cut: Trajectory) -> None:
    ax = plot_removal_rate(new_axes()[1], cut, bars=100)
    bars = sum(bar.get_bbox().width * bar.get_bbox().height for bar in ax.patches if isinstance(bar, Rectangle))
    assert ax.get_ylabel() == "$dV/dt$  [10⁻⁶ in³/µs]"
    # The midpoint rule with 100 bars errs by 4.1e-5, here and in the report's table.
    assert bars * 1e-6 * INCH**3 / cut.volume - 1 == pytest.approx(4.11e-5, rel=0.01)


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


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: plot_solution(ode.solve(SPRING, {"c": 1.0}, t1=1.0)), "ts"),
        (lambda: plot_solution(ode.solve(SPRING, {"c": 1.0}, t1=1.0, ts=[0.5]), ["z"]), "names"),
        (lambda: plot_solution(ode.solve(SPRING, {"c": np.ones(0)}, t1=1.0, ts=[0.5])), "has 0"),
        (lambda: plot_solution(ode.solve(SPRING, {"c": np.ones(13)}, t1=1.0, ts=[0.5])), "lanes"),
        (
            lambda: plot_sweep(make(alpha=[0.2, 0.3], k=[2.0], v0=["2200 in/s"])),
            r"one or two dimensions, .* to be drawn; this is 2 alpha × 1 k × 1 v0\.$",
        ),
    ],
    ids=["no times", "no part", "no lane", "many lanes", "three axes"],
)
def test_what_cannot_be_drawn_is_refused(draw, message) -> None:
    with pytest.raises(ValueError, match=message):
        draw()


def make(**axes: Any) -> xr.Dataset:
    return sweep("linearized", P, **axes)


def test_one_axis_is_a_curve_in_degrees():
    found = make(alpha=np.deg2rad([10.0, 20.0, 30.0]))
    ax = plot_sweep(found).axes[0]
    degrees, volume = ax.lines[0].get_data()
    np.testing.assert_allclose(np.asarray(degrees), [10, 20, 30])
    np.testing.assert_allclose(np.asarray(volume) * 1e-4 * INCH**3, found.volume, rtol=1e-12)
    assert ax.get_xlabel() == "α  angle of attack  [°]"
    assert ax.get_ylabel() == "$V$  removed volume  [10⁻⁴ in³]"


def test_a_sweep_is_dotted_where_the_body_turns_by_more_than_90_degrees():
    grid = make_grid("rotating", P, {"k": [1.0, 2.0], "alpha": np.deg2rad(np.arange(5.0, 90, 5))})
    found = with_boundaries(grid, prepare_sweep(grid).run())
    beyond = found.turned_beyond.values
    np.testing.assert_array_equal(beyond, erosion.sweep("rotating", P, **grid.axes, turn=True).turn > np.pi / 2)
    assert 0 < beyond[1].sum() < beyond[0].sum()
    fig = plot_sweep(found)
    drawn = {(line.get_color(), line.get_linestyle()): np.asarray(line.get_ydata()) for line in fig.axes[0].lines}
    for color, volume, turned in zip(("blue", "vermillion"), found.volume.values, beyond, strict=True):
        np.testing.assert_array_equal(np.isnan(drawn[PALETTE[color], "-"]), turned)
        np.testing.assert_allclose(drawn[PALETTE[color], ":"][turned] * 1e-4 * 0.0254**3, volume[turned], rtol=1e-12)
    assert labels(fig) == ["k = 1", "k = 2", BEYOND_LABEL]
    *_, sample = fig.legends[0].legend_handles
    assert isinstance(sample, Line2D)
    assert sample.get_linestyle() == ":"
    one = make_grid(["linearized", "rotating"], P, {"alpha": np.deg2rad(np.arange(5.0, 90, 5))})
    assert with_boundaries(one, prepare_sweep(one).run()).turned_beyond.any("alpha").values.tolist() == [False, True]


def test_few_values_of_a_second_axis_are_a_family():
    ax = plot_sweep(make(k=[1.0, 2.0], alpha=np.deg2rad(np.linspace(10, 40, 9)))).axes[0]
    assert [line.get_label() for line in ax.lines] == ["k = 1", "k = 2"]
    ax = plot_sweep(make(v0=["2200 in/s"], alpha=np.deg2rad(np.linspace(10, 40, 9)))).axes[0]
    assert [line.get_label() for line in ax.lines] == ["v₀ = 2200 in/s"]
    ax = plot_sweep(make(v0=["6543.21 in/s", "14437 in/s"], alpha=np.deg2rad(np.linspace(10, 40, 9)))).axes[0]
    assert [line.get_label() for line in ax.lines] == ["v₀ = 6543 in/s", "v₀ = 14437 in/s"]
    fig = plot_sweep(make(k=[1.00001, 1.00002, 1.00003], alpha=np.deg2rad(np.linspace(10, 40, 9))))
    lines = fig.axes[0].lines
    assert [line.get_label() for line in lines] == ["k = 1.00001", "k = 1.00002", "k = 1.00003"]
    (legend,) = fig.legends
    assert [mark.get_color() for mark in legend.get_lines()] == [line.get_color() for line in lines]


@pytest.mark.parametrize(("name", "maxima"), [("v0", 0), ("r", 1)])
def test_a_family_marks_the_values_that_remove_something(name: str, maxima: int):
    backwards = P.replace(phidot0=-2 * P.v0 / P.r)
    family = families_of("rotating", backwards, ANGLES)[name]
    assert np.sum(family.kind != "none") == maxima
    ax = family.figure(P.shown_in).axes[0]
    marks = [line.get_label() for line in ax.lines if line.get_marker() != "None"]
    assert len(marks) == maxima
    assert all(label in ("greatest", "approached, not reached") for label in marks)


def test_many_values_of_a_second_axis_are_a_map():
    found = make(alpha=np.deg2rad(np.linspace(1, 89, 12)), v0="1000 in/s : 4000 in/s : 9")
    ax = plot_sweep(found).axes[0]
    (image,) = [one for one in ax.collections if isinstance(one, QuadMesh)]
    np.testing.assert_allclose(np.asarray(image.get_array()) * 1e-4 * INCH**3, found.volume.T, rtol=1e-12)
    assert ax.get_ylabel() == "v₀  impact speed  [in/s]"


def test_the_curve_of_the_nozzle_has_its_band_and_its_top():
    angles = np.deg2rad(np.linspace(10, 90, 9))
    curve = np.full(9, 2e-4 * INCH**3)
    best = Estimate(np.deg2rad(40), 0.01, np.deg2rad(39), np.deg2rad(41))
    top = Estimate(curve[0], 0.0, curve[0], curve[0])
    nozzle = NozzleAngle(best, top, False, angles, curve, curve / 10, 0.5, "jump", angles, curve, angles > 0.5)
    ax = plot_nozzle_angle(new_axes()[1], nozzle, "inch-pound")
    labels = [str(line.get_label()) for line in ax.lines]
    assert labels == [
        "one typical particle, greatest at 28.65°",
        "_child1",
        BEYOND_LABEL,
        "mean of the stream",
        "greatest at 40.0 ± 1.0° (95 %, sampling alone)",
    ]
    band = ax.collections[0].get_paths()[0].get_extents()
    assert band.y0 == pytest.approx(2 * (1 - 0.196))
    assert band.y1 == pytest.approx(2 * (1 + 0.196))


def test_an_animation_tells_arrows_from_shares_and_shows_its_scale(monkeypatch):
    drawn, whole = [], mpl.animation.FuncAnimation

    def of_two_frames(fig, show, frames):
        drawn.append(fig)
        return whole(fig, show, 2)

    monkeypatch.setattr("erosion.plotting.motion.FuncAnimation", of_two_frames)
    for degrees in (2, 30):
        assert animate_cut(simulate("linearized", P.replace(alpha=np.deg2rad(degrees)))).startswith(b"GIF89a")
        (legend,), ax = drawn[-1].legends, drawn[-1].axes[0]
        colors = [mpl.colors.to_hex(handle.get_color() if isinstance(handle, Line2D) else handle.get_facecolor())
                  for handle in legend.legend_handles]  # fmt: skip
        assert [isinstance(handle, Line2D) for handle in legend.legend_handles] == [True] * 2 + [False] * 3
        assert len({*colors, *(mpl.colors.to_hex(area.get_facecolor()) for area in ax.patches)}) == 5 + len(ax.patches)
        assert [text.get_text() for text in ax.texts] == ["0.02 in"]
