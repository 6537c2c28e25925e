"""Figures of sweeps and streams: the drawn numbers are the computed ones, in readable units."""

from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import QuadMesh

import erosion
from erosion.distributions import LogNormal, Normal
from erosion.plotting.maps import plot_nozzle_angle, plot_stream
from erosion.plotting.style import new_axes
from erosion.plotting.sweeps import plot_comparison, plot_sweep
from erosion.streams.result import NozzleAngle
from erosion.streams.stream import stream
from erosion.streams.tally import Estimate
from erosion.sweeps.sweep import sweep

P = erosion.TABLE_1


def make(**axes: Any) -> xr.Dataset:
    return sweep("linearized", P, **axes)


def test_one_axis_is_a_curve_in_degrees():
    found = make(alpha=np.deg2rad([10.0, 20.0, 30.0]))
    ax = plot_sweep(found).axes[0]
    degrees, volume = ax.lines[0].get_data()
    np.testing.assert_allclose(np.asarray(degrees), [10, 20, 30])
    np.testing.assert_allclose(np.asarray(volume) * 1e-4, found.volume, rtol=1e-12)
    assert ax.get_xlabel() == "α  angle of attack  [°]"
    assert ax.get_ylabel() == "$V$  removed volume  [10⁻⁴ in³]"


def test_models_whose_curves_coincide_are_all_seen():
    models = ["first", "second", "third", "other"]
    compared = erosion.compare(["linearized", "finnie"], P).isel(model=[0, 0, 0, 1]).assign_coords(model=models)
    lines: list[Any] = [*plot_comparison(compared).axes[0].lines]
    drawn = {str(line.get_label()).split(":")[0]: line for line in lines}
    assert [drawn[name].is_dashed() for name in models] == [False, True, True, False]
    gaps = [drawn[name]._unscaled_dash_pattern[1] for name in ("second", "third")]
    assert gaps == [(4, 4), (2, 6)]  # through which the others are seen


def test_few_values_of_a_second_axis_are_a_family():
    ax = plot_sweep(make(k=[1.0, 2.0], alpha=np.deg2rad(np.linspace(10, 40, 9)))).axes[0]
    assert [line.get_label() for line in ax.lines] == ["k = 1", "k = 2"]
    ax = plot_sweep(make(v0=[2200.0], alpha=np.deg2rad(np.linspace(10, 40, 9)))).axes[0]
    assert [line.get_label() for line in ax.lines] == ["v₀ = 2200 in/s"]


def test_many_values_of_a_second_axis_are_a_map():
    found = make(alpha=np.deg2rad(np.linspace(1, 89, 12)), v0=np.linspace(1000, 4000, 9))
    ax = plot_sweep(found).axes[0]
    (image,) = [one for one in ax.collections if isinstance(one, QuadMesh)]
    np.testing.assert_allclose(np.asarray(image.get_array()) * 1e-4, found.volume.T, rtol=1e-12)
    assert ax.get_ylabel() == "v₀  impact speed  [in/s]"


def test_what_cannot_be_drawn_says_so():
    with pytest.raises(ValueError, match=r"one or two dimensions, .* to be drawn; this is 2 alpha × 1 k × 1 v0\.$"):
        plot_sweep(make(alpha=[0.2, 0.3], k=[2.0], v0=[2200.0]))


def test_a_streams_histogram_holds_its_shares():
    found = stream("linearized", P, n=1024, best_angle=False, v0=LogNormal(4400.0, 0.2))
    (ax,) = plot_stream(found).axes
    assert ax.get_title() == "every particle removes something"
    assert ax.get_xlabel() == "V  removed volume  [10⁻⁴ in³]"
    ax.figure.draw_without_rendering()  # pyright: ignore[reportAttributeAccessIssue]
    ticks = [text.get_text() for text in ax.get_xticklabels(which="both")]
    assert [text for text in ticks if text]
    assert not any("times" in text for text in ticks)
    values, edges, _ = ax.patches[0].get_data()  # pyright: ignore[reportAttributeAccessIssue]
    assert values.sum() == pytest.approx(1, abs=0.01)
    assert edges[0] < 1e4 * found.quantiles[0.05] < 1e4 * found.quantiles[0.95] < edges[-1]


def test_the_curve_of_the_nozzle_has_its_band_and_its_top():
    angles = np.deg2rad(np.linspace(10, 90, 9))
    curve = np.full(9, 2e-4)
    best = Estimate(np.deg2rad(40), 0.01, np.deg2rad(39), np.deg2rad(41))
    top = Estimate(2e-4, 0.0, 2e-4, 2e-4)
    nozzle = NozzleAngle(best, top, False, angles, curve, curve / 10, 0.5, "jump", angles, curve)
    ax = plot_nozzle_angle(new_axes()[1], nozzle, "inch-pound")
    labels = [str(line.get_label()) for line in ax.lines]
    assert labels == [
        "one typical particle, greatest at 28.65°",
        "mean of the stream",
        "greatest at 40.0 ± 1.0° (95 %, sampling alone)",
    ]
    band = ax.collections[0].get_paths()[0].get_extents()
    assert band.y0 == pytest.approx(2 * (1 - 0.196))
    assert band.y1 == pytest.approx(2 * (1 + 0.196))


def test_errors_and_bands_say_that_they_are_by_sampling_alone():
    result = stream("linearized", P, alpha=Normal(0.5, 0.05), n=256)
    rows = result.rows()
    assert "± is the error by sampling these particles alone, all other parameters taken as exact" in rows[0].meaning
    assert [row.meaning for row in rows if "95 % interval" in row.meaning] == ["its 95 % interval, by sampling alone"]
    (legend,) = plot_stream(result).legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert sum("sampling alone" in text for text in texts) == 2
    assert not any(text == "95 % band" for text in texts)
