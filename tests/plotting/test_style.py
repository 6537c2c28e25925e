"""Figures as files: the same bytes each time, and nothing half written."""

import struct
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from erosion.impacts.simulate import Trajectory
from erosion.plotting.motion import plot_path, plot_trajectory
from erosion.plotting.style import legend_below, new_axes, new_figure, plot_files, save_figure, save_plot, save_plots

pytestmark = pytest.mark.slow


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


def test_a_figure_is_laid_out_once_for_both_kinds(cut: Trajectory, tmp_path, monkeypatch) -> None:
    fig, ax = new_axes()
    plot_path(cut, ax=ax)
    engine: Any = fig.get_layout_engine()
    usual, laid_out = engine.execute, []
    monkeypatch.setattr(engine, "execute", lambda figure: (laid_out.append(figure), usual(figure))[1])
    assert [path.name for path in save_figure(fig, tmp_path / "v1.2")] == ["v1.2.svg", "v1.2.png"]
    assert laid_out == [fig]
    # It is laid out anew when it is saved again.
    assert fig.get_layout_engine() is engine


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


@pytest.mark.parametrize("name", ["plot.jpg", "plot", "plot.svg.gz"])
def test_other_suffixes_are_refused_before_anything_is_written(tmp_path, name: str) -> None:
    with pytest.raises(ValueError, match=r"must end in \.svg, \.png or \.pdf\.$"):
        save_plot(new_figure(), tmp_path / name)
    assert not list(tmp_path.iterdir())
