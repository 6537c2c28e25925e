import numpy as np
import pytest

import erosion
from erosion.plotting.curves import pieces, plot_against_correlations, plot_optimum
from erosion.plotting.labels import broken
from erosion.plotting.style import render
from erosion.plotting.sweeps import plot_comparison, plot_regimes
from tests.reference import closed_form

pytestmark = pytest.mark.slow

P = erosion.TABLE_1


@pytest.fixture(scope="module")
def comparison():
    return erosion.compare(["linearized", "rotating"], P)


@pytest.fixture(scope="module")
def map_of_rotating():
    return erosion.regimes("rotating", P, alpha=np.deg2rad(np.arange(2.0, 90.0, 4.0)), phidot0=[-55000.0, 0.0, 27500.0])


def test_a_comparison_holds_curves_and_optima(comparison):
    assert dict(comparison.sizes) == {"model": 2, "alpha": 360}
    exact = closed_form("linearized")
    p = P.replace(alpha=comparison.alpha.values)
    np.testing.assert_allclose(comparison.volume.sel(model="linearized"), exact.volume(p), rtol=1e-8, atol=1e-20)
    np.testing.assert_allclose(comparison.dvolume.sel(model="linearized"), exact.dvolume(p), rtol=1e-8, atol=1e-18)
    np.testing.assert_allclose(np.rad2deg(comparison.alpha_max), [31.717474411, 25.571827308], atol=1e-8)
    ends = comparison.alpha_max_ended_by
    assert [ends.attrs["flag_meanings"].split()[code] for code in ends.values] == ["rebound", "rebound"]
    assert comparison.volume.attrs["units"] == "in^3"


def test_regimes_change_with_spin(map_of_rotating):
    dataset = map_of_rotating
    assert dict(dataset.sizes) == {"phidot0": 3, "alpha": 22}
    names = dataset.ended_by.attrs["flag_meanings"].split()
    ends = np.array(names)[dataset.ended_by.values]
    # With s = -0.5 nothing is cut where cos α ≤ 0.5.
    assert set(ends[0][np.rad2deg(dataset.alpha) > 60]) == {"no-cut"}
    np.testing.assert_allclose(np.rad2deg(dataset.alpha_max), [47.13850880, 25.57182731, 20.39], atol=5e-3)


def test_curves_are_broken_where_they_jump(comparison):
    one = comparison.sel(model="rotating")
    x, _ = broken(one.alpha.values, one.volume.values, one.dvolume.values)
    gaps = np.flatnonzero(np.isnan(x))
    assert len(gaps) == 1
    assert x[gaps[0] - 1] < np.deg2rad(42.92255530) < x[gaps[0] + 1]


def test_pieces_end_at_jumps():
    best = erosion.alpha_max("rotating", P.replace(k=1.0))
    curve = pieces(best)
    assert [piece.ended_by for piece in curve] == ["rebound", "stop", "stop"]
    for before, after, jump in zip(curve[:-1], curve[1:], best.jumps, strict=True):
        assert before.alpha[-1] < jump.alpha < after.alpha[0]
        assert before.value[-1] == pytest.approx(jump.below, rel=1e-5)
        assert after.value[0] == pytest.approx(jump.above, rel=1e-4)


def test_figures_are_the_same_each_time(comparison, map_of_rotating):
    best = erosion.alpha_max("rotating", P.replace(k=1.0))
    for draw in (
        lambda: plot_optimum(best),
        lambda: plot_comparison(comparison),
        lambda: plot_regimes(map_of_rotating),
    ):
        assert render(draw(), "svg") == render(draw(), "svg")


def test_a_batch_of_optima_is_not_one_figure():
    best = erosion.alpha_max("rotating", P.replace(k=np.array([1.0, 2.0])))
    with pytest.raises(ValueError, match="Argument `optimum` must be of one set of parameters"):
        plot_optimum(best)


def test_shapes_lie_over_each_other(comparison):
    ax = plot_against_correlations(comparison, ["dnv", "oka"]).axes[0]
    labels = ax.get_legend_handles_labels()[1]
    assert labels[:2] == ["DNV RP-O501 (2015): 34.7°", "Oka (SiO₂, Hv = 1.8 GPa): 33.9°"]
    assert len(labels) == 2 + comparison.sizes["model"]
    for line in ax.get_lines():
        # The grid of angles misses the greatest by little.
        assert 0.999 < np.nanmax(line.get_ydata()) <= 1 + 1e-12
