"""Figures of fits: data, curves, band and profile are where the numbers are."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import ErrorbarContainer

from erosion.fits import calibrate
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from erosion.plotting.fits import plot_calibration
from erosion.plotting.labels import coinciding

pytestmark = pytest.mark.slow

DEGREES = np.linspace(5.0, 88.0, 50)


@pytest.fixture(scope="module")
def fit():
    volume = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(DEGREES))))
    noisy = volume + 6e-6 * np.random.default_rng(1).standard_normal(50)
    table = {"angle [deg]": DEGREES, "volume [in^3]": noisy, "uncertainty [in^3]": np.full(50, 6e-6)}
    return calibrate("linearized", TABLE_1, table, ["k", "psi"], starts=1)


def drawn(ax: Axes, label: str, which: int = 0) -> np.ndarray:
    """x and y of a line with this label, shape (2, n)."""
    lines = [line for line in ax.get_lines() if line.get_label() == label]
    return np.array(lines[which].get_data(), dtype=float)


def measured(ax: Axes) -> np.ndarray:
    """x and y of the points with error bars."""
    (bars,) = [one for one in ax.containers if isinstance(one, ErrorbarContainer)]
    return np.array(bars.lines[0].get_data(), dtype=float)


def test_data_fit_band_and_residuals(fit):
    upper, lower = plot_calibration([fit, fit]).axes
    assert upper.get_ylabel() == "$V$  removed volume  [10⁻⁴ in³]"
    np.testing.assert_allclose(measured(upper), [DEGREES, fit.data.erosion * 1e4])
    degrees, best = drawn(upper, "linearized")
    erosion, error = fit.curve(np.deg2rad(degrees))
    np.testing.assert_allclose(best, erosion * 1e4)
    np.testing.assert_allclose(drawn(upper, "linearized, as linearized")[1], best)
    bands = [one for one in upper.collections if isinstance(one, PolyCollection)]
    assert len(bands) == 2
    corners = np.asarray(bands[0].get_paths()[0].vertices)
    assert corners[:, 1].max() == pytest.approx((erosion + 1.959964 * error).max() * 1e4)
    np.testing.assert_allclose(measured(lower)[1], fit.residuals * 1e4)


def test_a_fit_is_called_the_same_where_it_is_in_each_group():
    # At the lower speed the second is twice the first, which is little beside the erosion at the greater speed.
    first = np.outer([1.0, 1000.0], np.sin(np.linspace(0.1, 3.0, 50)))
    assert coinciding([first, first * [[2.0], [1.0]], first * 1.001], 0.9) == [[], [], [0]]
    assert coinciding([*first, first[0]], 0.9) == [[], [], [0]]


@pytest.fixture(scope="module")
def at_two_speeds():
    """Rows at two speeds in mg/kg, from a curve of another shape than the fitted one."""
    speed = np.repeat([2000.0, 4000.0], 25)
    p = TABLE_1.replace(alpha=np.deg2rad(DEGREES), v0=speed)
    loss = np.asarray(LinearizedCut().volume(p)) / float(TABLE_1.m) * 1e-7 * np.exp(0.6 * np.sin(DEGREES / 12))
    table = {"angle [deg]": DEGREES, "mass_loss [mg/kg]": loss * 1e6, "speed [in/s]": speed}
    return calibrate("linearized", TABLE_1, table, ["k", "psi"], density=1e-7, starts=1)


def test_each_speed_has_a_curve_and_a_colour(at_two_speeds):
    upper, lower = plot_calibration([at_two_speeds, at_two_speeds]).axes
    curves = [line for line in upper.get_lines() if len(np.asarray(line.get_xdata())) == 180]
    assert len(curves) == 4
    assert len({line.get_color() for line in curves}) == 2
    heights = [np.asarray(line.get_ydata()).max() for line in curves[:2]]
    assert heights[1] == pytest.approx(4 * heights[0])
    bars = [one for one in upper.containers if isinstance(one, ErrorbarContainer)]
    assert [one.get_label() for one in bars] == ["v₀ = 2000 in/s", "v₀ = 4000 in/s"]
    assert [one.lines[0].get_color() for one in bars] == [line.get_color() for line in curves[:2]]
    assert [np.asarray(one.lines[0].get_data()).shape for one in bars] == [(2, 25), (2, 25)]
    assert [one.lines[0].get_color() for one in lower.containers if isinstance(one, ErrorbarContainer)] == [
        line.get_color() for line in curves[:2]
    ]


def test_labels_are_whole_and_residuals_have_a_unit(at_two_speeds):
    fig = plot_calibration([at_two_speeds])
    upper = fig.axes[0]
    assert upper.get_ylabel() == "$Δm/m$  mass loss per mass of erodent\n[mg/kg]"
    assert fig.axes[1].get_ylabel().split() == ["residuals", "[mg/kg]"]
    assert at_two_speeds.warnings
    assert not upper.get_title(loc="left")  # what is doubtful is in the fit's text, not in a figure for a journal
    assert upper.get_xlim() == (0, 92)  # a mark at 90° is whole
    fig.draw_without_rendering()
    for text in (upper.yaxis.label, fig.axes[1].yaxis.label):
        box = text.get_window_extent()
        assert fig.bbox.x0 <= box.x0 <= box.x1 <= fig.bbox.x1
        assert fig.bbox.y0 <= box.y0 <= box.y1 <= fig.bbox.y1
