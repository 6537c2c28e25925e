"""Figures of fits: data, curves, band and profile are where the numbers are.

Figures of posteriors show the draws.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import ErrorbarContainer

import erosion
from erosion import TABLE_1, FitProblem, calibrate, next_test, posterior
from erosion.models import BUILT_IN
from erosion.models.rigid import LinearizedCut
from erosion.plotting.fits import (
    plot_best_angles,
    plot_calibration,
    plot_means,
    plot_next_test,
    plot_pairs,
    plot_prediction,
    plot_traces,
)
from erosion.plotting.labels import coinciding

SI = TABLE_1.to("si")

DEGREES = np.linspace(5.0, 88.0, 12)


@pytest.fixture(scope="module")
def fit():
    volume = np.asarray(LinearizedCut().volume(SI.replace(alpha=np.deg2rad(DEGREES))))
    noisy = volume + 1e-10 * np.random.default_rng(1).standard_normal(12)
    table = {"angle [deg]": DEGREES, "volume [m^3/impact]": noisy, "uncertainty [m^3]": np.full(12, 1e-10)}
    return calibrate(FitProblem("linearized", SI, table, ["k", "psi"]), starts=1)


TITLE = BUILT_IN["linearized"].summary


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
    assert upper.get_ylabel() == "$V$  removed volume  [mm³]"
    np.testing.assert_allclose(measured(upper), [DEGREES, fit.data.erosion * 1e9])
    degrees, best = drawn(upper, TITLE)
    np.testing.assert_allclose(best, fit.curve(np.deg2rad(degrees))[0] * 1e9)
    np.testing.assert_allclose(drawn(upper, f"{TITLE}, as {TITLE}")[1], best)
    (band,) = [one for one in upper.collections if isinstance(one, PolyCollection)]
    highest = np.asarray(band.get_paths()[0].vertices)[:, 1].max()
    predicted = erosion.predict(fit, np.deg2rad(np.arange(5.0, 90.0))).columns["mean_high"].max()
    assert highest == pytest.approx(predicted * 1e9, rel=0.02)
    np.testing.assert_allclose(measured(lower)[1], fit.residuals * 1e9)


def test_predictions_at_the_speed_of_the_tests_have_the_rows(fit):
    (ax,) = plot_means(fit.predictor, [{"v0": float(SI.v0)}]).axes
    np.testing.assert_allclose(measured(ax), [DEGREES, fit.data.erosion * 1e9])
    (faster,) = plot_means(fit.predictor, [{"v0": 2 * float(SI.v0)}]).axes
    assert not [one for one in faster.containers if isinstance(one, ErrorbarContainer)]


def test_a_fit_is_called_the_same_where_it_is_in_each_group():
    # At the lower speed the second is twice the first, which is little beside the erosion at the greater speed.
    first = np.outer([1.0, 1000.0], np.sin(np.linspace(0.1, 3.0, 50)))
    assert coinciding([first, first * [[2.0], [1.0]], first * 1.001], 0.9) == [[], [], [0]]
    assert coinciding([*first, first[0]], 0.9) == [[], [], [0]]


@pytest.fixture(scope="module")
def at_two_speeds():
    """Rows at two speeds in mg/kg, from a curve of another shape than the fitted one."""
    speed = np.repeat([50.0, 100.0], 6)
    p = SI.replace(alpha=np.deg2rad(DEGREES), v0=speed)
    loss = np.asarray(LinearizedCut().volume(p)) / float(SI.m) * 2700 * np.exp(0.6 * np.sin(DEGREES / 12))
    table = {"angle [deg]": DEGREES, "mass_loss [mg/kg]": loss * 1e6, "speed [m/s]": speed}
    return calibrate(FitProblem("linearized", SI, table, ["k", "psi"], density=2700), starts=1)


def test_each_speed_has_a_curve_and_a_colour(at_two_speeds):
    upper, lower = plot_calibration([at_two_speeds, at_two_speeds]).axes
    curves = [line for line in upper.get_lines() if len(np.asarray(line.get_xdata())) == 180]
    assert len(curves) == 4
    assert len({line.get_color() for line in curves}) == 2
    heights = [np.asarray(line.get_ydata()).max() for line in curves[:2]]
    assert heights[1] == pytest.approx(4 * heights[0])
    bars = [one for one in upper.containers if isinstance(one, ErrorbarContainer)]
    assert [one.get_label() for one in bars] == ["v₀ = 50 m/s", "v₀ = 100 m/s"]
    assert [one.lines[0].get_color() for one in bars] == [line.get_color() for line in curves[:2]]
    assert [np.asarray(one.lines[0].get_data()).shape for one in bars] == [(2, 6), (2, 6)]
    assert [one.lines[0].get_color() for one in lower.containers if isinstance(one, ErrorbarContainer)] == [
        line.get_color() for line in curves[:2]
    ]


@pytest.fixture(scope="module")
def result():
    degrees = np.linspace(8.0, 80.0, 8)
    volume = np.asarray(LinearizedCut().volume(SI.replace(alpha=np.deg2rad(degrees))))
    data = {"angle [deg]": degrees, "volume [m^3/impact]": volume, "uncertainty [m^3]": np.full(8, 8e-11)}
    return posterior(FitProblem("linearized", SI, data, ["sigma", "psi", "k"]), draws=125)


def test_pairs_show_each_draw_and_a_ridge_on_logarithmic_axes(result):
    fig = plot_pairs(result)
    assert len(fig.axes) == 6  # three parameters, and their pairs
    cloud = next(ax for ax in fig.axes if ax.get_ylabel() == "$ψ$")
    assert (cloud.get_xscale(), cloud.get_yscale()) == ("log", "log")
    x, y = cloud.lines[0].get_data()
    np.testing.assert_array_equal(y, result.samples["psi"].values.ravel())
    np.testing.assert_array_equal(x, result.samples["sigma"].values.ravel())
    k = fig.axes[-1]
    assert k.get_xscale() == "linear"


def test_traces_have_a_line_for_each_population(result):
    fig = plot_traces(result)
    left = fig.axes[4]
    assert len(left.lines) == 4
    np.testing.assert_array_equal(left.lines[2].get_ydata(), result.samples["k"].values[2])


def test_a_prediction_has_bands_and_how_cuts_end(result):
    fig = plot_prediction(result)
    upper, lower = fig.axes
    angles, median = upper.lines[0].get_data()
    exact = LinearizedCut().volume(SI.replace(alpha=np.deg2rad(angles)))
    # Beyond the tests, up to 80°, metals are expected to wear at 90°.
    tested = np.asarray(angles) <= 80.0
    np.testing.assert_allclose(1e-9 * np.asarray(median)[tested], np.asarray(exact)[tested], atol=0.03 * np.max(exact))
    labels = fig.legends[0].get_texts()
    assert {"95%", "50%", "median", "measured", "rebound", "stop"} <= {text.get_text() for text in labels}
    assert lower.get_ylim() == (0, 1)


def test_best_angles_are_coloured_by_kind(result):
    best = result.alpha_max(50)
    fig = plot_best_angles(best)
    upper, lower = fig.axes
    bars: list[Any] = [bar for bar in upper.patches if hasattr(bar, "get_height")]
    assert sum(bar.get_height() for bar in bars) == pytest.approx(50)
    assert "discrepancy" in fig.legends[0].get_texts()[-1].get_text()
    np.testing.assert_allclose(np.sort(lower.lines[0].get_xdata()), np.sort(np.rad2deg(best.of_model)))


def test_the_next_test_has_a_curve_for_each_speed_and_a_star(result):
    angles = np.deg2rad([20.0, 60.0, 40.0])
    answer = next_test(result, {"alpha": angles[:, None], "v0": [200.0, 100.0]})
    ax, lower = plot_next_test(answer).axes
    slow, fast, star = ax.lines
    assert [line.get_label() for line in ax.lines[:2]] == ["100 m/s", "200 m/s"]
    np.testing.assert_allclose(np.asarray(slow.get_xdata()), [20, 40, 60])
    np.testing.assert_allclose(np.asarray(fast.get_ydata()), 100 * answer.prediction[[0, 4, 2]])
    assert star.get_ydata() == 100 * answer.prediction.max()
    np.testing.assert_allclose(np.asarray(lower.lines[1].get_ydata()), 100 * answer.parameters[[0, 4, 2]])
    assert str(star.get_label()).startswith("best: ")
    assert str(star.get_label()).endswith(", 100 m/s")


def test_the_label_of_a_small_number_stays_on_the_paper(result):
    answer = next_test(result, {"alpha": np.deg2rad([20.0, 40.0])})
    # Numbers that need two digits beside the axis move the label, which stays on the paper.
    ax, _ = plot_next_test(dataclasses.replace(answer, prediction=0.426 * np.ones(2))).axes
    ax.figure.draw_without_rendering()  # pyrefly: ignore
    assert ax.yaxis.label.get_window_extent().x0 > 0
