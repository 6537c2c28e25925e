"""Figures say which share of the volume is cut and which share deformation removes."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import erosion
from erosion.models import Linearized, ProportionalDeformationWear
from erosion.plotting.curves import plot_optimum
from erosion.plotting.labels import AT_CONTACT
from erosion.plotting.motion import plot_trajectory
from erosion.plotting.sweeps import plot_comparison

P = erosion.TABLE_1
MODEL = Linearized(deformation=ProportionalDeformationWear(1.6, 0.25 * float(P.v0)))


def labels(fig: Figure) -> list[str]:
    return [text.get_text() for text in fig.legends[0].get_texts()]


@pytest.mark.slow
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


@pytest.mark.slow
def test_nothing_is_shaded_where_the_cut_removes_all_or_the_time_is_asked_for() -> None:
    never_cuts = erosion.alpha_max("dnv", P)
    for best in (erosion.alpha_max("linearized", P), erosion.alpha_max(MODEL, P, objective="t_c"), never_cuts):
        fig = plot_optimum(best)
        assert AT_CONTACT not in labels(fig)
        assert not fig.axes[0].collections


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_heading_of_a_cut_names_both_shares() -> None:
    heading = plot_trajectory(erosion.simulate(MODEL, P.replace(alpha=0.9))).get_suptitle()
    assert heading.endswith("in³ of it at contact, beside the cut")
    at_90_degrees = plot_trajectory(erosion.simulate(MODEL, P.replace(alpha=np.pi / 2))).get_suptitle()
    assert (
        "nothing is cut\n1.2145 × 10⁻⁴ in³ removed, 1.2145 × 10⁻⁴ in³ of it at contact, beside the cut" in at_90_degrees
    )
    assert AT_CONTACT not in plot_trajectory(erosion.simulate("linearized", P)).get_suptitle()
