"""Figures as files: the same bytes each time, and nothing half written."""

from typing import Any

import pytest

from erosion.impacts.simulate import Trajectory
from erosion.plotting.motion import plot_path, plot_trajectory
from erosion.plotting.style import new_axes, new_figure, save_figure, save_plot

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


@pytest.mark.parametrize("name", ["plot.jpg", "plot", "plot.svg.gz"])
def test_other_suffixes_are_refused_before_anything_is_written(tmp_path, name: str) -> None:
    with pytest.raises(ValueError, match=r"must end in \.svg, \.png or \.pdf\.$"):
        save_plot(new_figure(), tmp_path / name)
    assert not list(tmp_path.iterdir())
