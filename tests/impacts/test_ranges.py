"""The answer lies within the range that was asked for, whatever its size and place."""

import math

import jax
import numpy as np
import pytest

import erosion
from erosion.impacts.maxima import limit_at_zero
from tests.reference import closed_form

P = erosion.TABLE_1
QUARTER = np.pi / 2
PEAK = {"linearized": np.arctan(2) / 2, "finnie": np.arctan(2 / 3) / 2, "tan-alpha": 0.0}
RANGES = [
    (0.0, 1e-5), (0.0, 1e-8), (0.0, 0.5), (1e-9, 1e-8), (1e-8, 0.3), (1e-5, 0.01), (1e-3, 1e-2), (1e-4, 1.00001e-4),
    (0.3, 0.3 + 1e-9), (0.3, math.nextafter(0.3, 1)), (1.5, QUARTER), (QUARTER - 1e-10, QUARTER),
    (QUARTER - 1e-12, QUARTER), (1.5, QUARTER - 1e-12),
]  # fmt: skip


@pytest.mark.parametrize("name", PEAK)
@pytest.mark.parametrize("ends", RANGES, ids=str)
def test_the_answer_is_that_of_the_closed_form_within_the_range(name, ends):
    low, high = ends
    inside = min(max(PEAK[name], low), high)
    for best, at in [
        (erosion.alpha_max(name, P, alpha_range=ends), inside),
        # V rises to its peak and falls from there.
        (erosion.alpha_min(name, P, alpha_range=ends), min(ends, key=lambda end: volume_of(name, end))),
    ]:
        assert best.certified
        assert low <= best.low <= best.alpha <= best.high <= high
        assert (best.regimes[0].low, best.regimes[-1].high) == ends
        # 1e-10 of V, and what falls below the rounding of v₀ cos α beside 90°.
        assert best.value == pytest.approx(volume_of(name, at), rel=1e-9, abs=1e-30)
        if best.kind == "plateau":  # the same to nine digits
            assert low <= at <= high
        else:
            assert best.alpha == pytest.approx(at, rel=1e-9, abs=1e-12)
            assert best.kind == ("interior" if low < at < high else "boundary")
            assert best.attained == (at > 0)


def volume_of(name: str, alpha: float) -> float:
    """V, also its limit as α → 0, and 0 at 90°, where nothing is cut."""
    if alpha >= QUARTER or (alpha == 0 and name != "tan-alpha"):
        return 0.0
    return float(closed_form(name).volume(P.replace(alpha=max(alpha, 1e-15))))


@pytest.mark.parametrize("aside", [0.0, 1e-13, 1e-11, 1e-9, 1e-6, 1e-4])
def test_a_range_that_ends_at_the_maximum(aside):
    peak = PEAK["linearized"]
    greatest = float(P.volume_scale) * (np.sqrt(5) - 1) / 4
    for low, high in ((0.2, peak + aside), (peak - aside, 1.0), (peak - aside, peak + max(aside, 1e-15))):
        best = erosion.alpha_max("linearized", P, alpha_range=(low, high))
        assert best.kind in ("interior", "boundary", "plateau")
        assert low <= best.alpha <= high
        assert best.alpha == pytest.approx(peak, abs=1e-9)
        assert best.value == pytest.approx(greatest, rel=1e-11)


def test_a_maximum_at_less_than_a_ten_thousandth_of_a_radian_is_found():
    # sin α ≤ P u/2 is a rebound: V/V* = (2u sin α - 2/P sin²α)/k, greatest near α = P u/2.
    p = P.replace(phidot0=-0.9999 * P.v0 / P.r)
    best = erosion.alpha_max("finnie", p)
    angles = np.geomspace(1e-6, 1e-3, 20_001)
    volumes = np.asarray(closed_form("finnie").volume(p.replace(alpha=angles)))
    assert (best.kind, best.certified) == ("interior", True)
    assert best.alpha == pytest.approx(angles[np.argmax(volumes)], rel=1e-3)
    assert best.value == pytest.approx(np.max(volumes), rel=1e-6)


@pytest.mark.parametrize(
    ("power", "limit"), [(-0.5, np.inf), (0.5, 0.0), (0.6, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)]
)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_limits_of_powers(power, limit, sign):
    def of(alpha):
        return sign * alpha**power

    alpha = 1e-6
    slope = jax.grad(of)
    assert limit_at_zero(alpha, of(alpha), float(slope(alpha)), float(jax.grad(slope)(alpha))) == sign * limit


@pytest.mark.parametrize(("power", "limit"), [(1.0, 3.0), (2.0, 3.0), (0.5, 3.0)])
def test_limits_of_a_constant_and_a_power(power, limit):
    alpha = 1e-4
    first, second = power * alpha ** (power - 1), power * (power - 1) * alpha ** (power - 2)
    assert limit_at_zero(alpha, limit + alpha**power, first, second) == pytest.approx(limit, rel=2e-2)


def test_least_removal_over_all_angles_is_nothing():
    best = erosion.alpha_min("linearized", P)
    assert best.value == 0
    assert (best.kind, best.alpha) == ("boundary", QUARTER)
    below = erosion.alpha_min("rotating-tan-alpha", P, alpha_range=(0.0, 0.5))
    assert (below.value, below.alpha, below.attained) == (0.0, 0.0, False)


@pytest.mark.parametrize("ends", [(0.0, 1e-5), (0.3, 0.3 + 1e-9)])
def test_a_narrow_range_is_drawn(ends):
    from erosion.plotting.curves import pieces

    best = erosion.alpha_max("linearized", P, alpha_range=ends)
    angles = np.concatenate([piece.alpha for piece in pieces(best)])
    assert ends[0] < np.min(angles) < np.max(angles) < ends[1]
