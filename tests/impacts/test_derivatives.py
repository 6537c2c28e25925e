import numpy as np
import pytest

import erosion
from erosion.impacts.impact import pair_derivatives
from erosion.ode import batch
from erosion.parameters.parameters import QUANTITIES

P = erosion.TABLE_1


@pytest.mark.slow
# Every model's are compared with coarser differences in its contract.
@pytest.mark.parametrize("name", ["rotating-full-torque", "rotating-velocity-aligned"])
def test_derivatives_equal_differences(name):
    # Away from jumps: one angle, one spin; steps that balance rounding and truncation.
    p = P.replace(phidot0=0.1 * P.v0 / P.r)
    h = 1e-3
    hit = erosion.impact(name, p.replace(alpha=0.3 + h * np.arange(-4, 5)), derivatives=2, rtol=1e-12)
    v = hit.volume
    first = np.dot([3, -32, 168, -672, 0, 672, -168, 32, -3], v) / (840 * h)
    second = np.dot([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9], v) / (5040 * h**2)
    assert hit.dvolume[4] == pytest.approx(first, rel=1e-8, abs=0)
    assert hit.d2volume[4] == pytest.approx(second, rel=1e-5, abs=0)


def test_several_parameters_make_a_symmetric_hessian():
    names = ("alpha", "k", "r")
    hit = erosion.impact("rotating", P, derivatives=2, wrt=names)
    assert hit.dvolume.shape == (3,)
    assert hit.d2volume.shape == (3, 3)
    assert np.array_equal(hit.d2volume, hit.d2volume.T)
    h = 1e-4
    up, down = (erosion.impact("rotating", P.replace(k=2 + d), derivatives=1, wrt=names, rtol=1e-12) for d in (h, -h))
    assert hit.d2volume[1] == pytest.approx((up.dvolume - down.dvolume) / (2 * h), rel=1e-6, abs=0)


def test_any_parameters_share_one_program():
    erosion.impact("rotating", P, derivatives=2, wrt=("alpha", "k", "r"))
    programs = batch._compiled.cache_info().currsize
    hit = erosion.impact("rotating", P, derivatives=2, wrt=("phidot0", "alpha"))
    assert batch._compiled.cache_info().currsize == programs
    assert hit.d2volume[1, 1] == pytest.approx(
        float(erosion.impact("rotating", P, derivatives=2).d2volume), rel=1e-9, abs=0
    )


def test_pairs_give_the_derivatives_of_volume_and_end_time():
    p = P.replace(alpha=np.array([0.2, 0.7]), phidot0=1000.0)
    pairs = [("alpha", name) for name in QUANTITIES]
    found = pair_derivatives(erosion.load_model("rotating"), p, pairs)
    hit = erosion.impact("rotating", p, derivatives=2, wrt=("alpha", "v0", "phidot0"))
    column = [list(QUANTITIES).index(name) for name in hit.wrt]
    assert found.volume.second.shape == (2, len(QUANTITIES))
    assert found.volume.second[:, column] == pytest.approx(hit.d2volume[:, 0], rel=1e-9, abs=0)
    assert found.volume.other[:, column] == pytest.approx(hit.dvolume, rel=1e-9, abs=0)
    h = 1e-4
    near = [pair_derivatives(erosion.load_model("rotating"), p.replace(k=2 + d), pairs).t_c for d in (-h, h)]
    at = list(QUANTITIES).index("k")
    assert found.t_c.other[:, at] == pytest.approx((near[1].value - near[0].value) / (2 * h), rel=1e-5, abs=0)
    assert found.t_c.second[:, at] == pytest.approx(
        (near[1].first[:, 0] - near[0].first[:, 0]) / (2 * h), rel=1e-5, abs=0
    )


def test_a_lane_that_fails_along_one_pair_fails():
    p = P.replace(alpha=np.array([0.2, np.nan, 0.4]))
    hit = erosion.impact("rotating", p, derivatives=2, wrt=("alpha", "k", "r"))
    assert list(hit.ended_by) == ["rebound", "failed", "rebound"]
    for field in ("volume", "t_c", "dvolume", "d2volume"):
        assert np.all(np.isnan(getattr(hit, field)[1]))
        assert np.all(np.isfinite(getattr(hit, field)[::2]))


@pytest.mark.parametrize("name", ["linearized", "rotating", "rotating-tan-alpha-full-torque"])
def test_gradient_obeys_the_scaling_law(name):
    # V has the dimensions of length³; with V = V* f(α, k, rω/v₀, rφ̇₀/v₀, β), scaling any base
    # unit scales V as its dimension says (Euler's theorem for homogeneous functions).
    p = P.replace(phidot0=5000.0)
    names = tuple(QUANTITIES)
    hit = erosion.impact(name, p, derivatives=1, wrt=names)
    scaled = {n: g * float(getattr(p, n)) for n, g in zip(names, hit.dvolume, strict=True)}
    length = scaled["r"] + scaled["b"] + scaled["v0"] - scaled["sigma"]
    time = -scaled["v0"] - scaled["phidot0"] - 2 * scaled["sigma"]
    mass = scaled["m"] + scaled["sigma"]
    assert length == pytest.approx(3 * hit.volume, rel=1e-8, abs=0)
    assert time == pytest.approx(0, abs=1e-8 * hit.volume)
    assert mass == pytest.approx(0, abs=1e-8 * hit.volume)
