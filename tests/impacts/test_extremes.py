"""Extreme but valid impacts: micrometres to metres, 1 m/s to 10 km/s, α from 1e-6 to π/2."""

import numpy as np
import pytest

import erosion
from erosion.models.rigid import LinearizedCut
from tests.impacts.test_random_impacts import random_impacts

pytestmark = pytest.mark.slow

BASE = erosion.TABLE_1.to("si")
LENGTHS = np.array([1e-6, 1e-3, 1.0])[:, None, None]  # of r [m]
SPEEDS = np.array([1.0, 100.0, 1e4])[:, None]  # [m/s]
ALPHAS = np.array([1e-6, 1e-3, 0.3, 1.0, np.pi / 2])


def similar(length, speed, alpha):
    """Impacts with the k, rω/v₀, s and β of Table 1, at other sizes and speeds."""
    size, pace = length / BASE.r, speed / BASE.v0
    return BASE.replace(r=length, b=BASE.b * size, m=BASE.m * size**3, v0=speed, sigma=BASE.sigma * pace**2,
                        alpha=alpha)  # fmt: skip


@pytest.mark.parametrize("name", ["linearized", "rotating"])
def test_impacts_scale(name):
    p = similar(LENGTHS, SPEEDS, ALPHAS)
    found = erosion.impact(name, p, derivatives=1)
    base = erosion.impact(name, BASE.replace(alpha=ALPHAS), derivatives=1)
    np.testing.assert_array_equal(found.ended_by, np.broadcast_to(base.ended_by, found.ended_by.shape))
    for got, wanted in ((found.volume, base.volume), (found.dvolume, base.dvolume)):
        scaled = got / np.asarray(p.volume_scale)
        # The tolerance of one batch, 1e-9 of V*, twice.
        np.testing.assert_allclose(scaled, np.broadcast_to(wanted / BASE.volume_scale, scaled.shape), rtol=0, atol=2e-9)


def test_impacts_have_the_closed_form():
    p = random_impacts(2000)
    exact, found = LinearizedCut(), erosion.impact("linearized", p)
    error = np.abs(found.volume - np.asarray(exact.volume(p))) / np.asarray(p.volume_scale)
    assert error.max() < 1e-9
    # Beside the cusp tan α = k/2 the two ends are one.
    beside = np.abs(np.tan(p.alpha) / (p.k / 2) - 1) > 1e-9
    np.testing.assert_array_equal(found.ended_by[beside], exact.ended_by(p)[beside])


@pytest.mark.parametrize("alpha", [1e-6, np.pi / 2])
@pytest.mark.parametrize(("length", "speed"), [(1e-6, 1e4), (1.0, 1.0)])
def test_simulations_reach_their_end(length, speed, alpha):
    p = similar(length, speed, alpha)
    cut = erosion.simulate("linearized", p)
    assert abs(cut.volume - float(LinearizedCut().volume(p))) < 1e-12 * float(p.volume_scale)
    assert cut.ended_by == ("rebound" if alpha < 1 else "no-cut")  # cos(π/2) is rounding
    assert np.isfinite(cut.depth).all()
    assert cut.max_depth >= 0


def test_the_best_angle_does_not_depend_on_the_scale():
    best = erosion.alpha_max("linearized", similar(LENGTHS[..., 0], SPEEDS[:, 0], 0.3))
    np.testing.assert_allclose(best.alpha, np.arctan(2.0) / 2, rtol=1e-8)
    assert (best.kind == "interior").all()
    assert best.certified.all()
