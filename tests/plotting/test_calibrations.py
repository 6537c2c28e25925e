"""Figures of fits: data, curves, band and profile are where the numbers are."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import ErrorbarContainer

from erosion.calibration import calibrate
from erosion.models.closed_forms import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from erosion.plotting.calibrations import plot_calibration, plot_profile
from erosion.plotting.style import new_axes

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
    np.testing.assert_allclose(drawn(upper, "linearized", 1)[1], best)
    bands = [one for one in upper.collections if isinstance(one, PolyCollection)]
    assert len(bands) == 2
    corners = np.asarray(bands[0].get_paths()[0].vertices)
    assert corners[:, 1].max() == pytest.approx((erosion + 1.959964 * error).max() * 1e4)
    np.testing.assert_allclose(measured(lower)[1], fit.residuals * 1e4)


def test_a_profile_shows_where_it_crosses(fit):
    ax = plot_profile(new_axes()[1], fit, "k", 0.9)
    profile = fit.profile("k")
    np.testing.assert_array_equal(drawn(ax, "profile"), [profile.values, profile.rise])
    np.testing.assert_allclose(drawn(ax, "90%")[1], 1.644854**2, rtol=1e-6)
    ends = sorted(float(np.asarray(line.get_xdata())[0]) for line in ax.lines[2:])
    assert ends == list(fit.intervals(0.9)["k"])
    rises = np.interp(ends, profile.values, profile.rise)
    np.testing.assert_allclose(rises, 1.644854**2, rtol=0.1)  # between 21 points of a parabola


def test_an_open_interval_has_no_lines(fit):
    loose = calibrate("linearized", TABLE_1, fit.data, ["psi", "sigma"], starts=1)
    assert len(plot_profile(new_axes()[1], loose, "sigma").lines) == 2
