"""10⁵ random impacts of every model: each ends, ends rightly, and has a number.

By the scaling laws V/V* depends on α, k, rω/v₀, s and β alone (docs/physics.md), so these
are drawn, and the sizes from micrometres to metres and speeds from 1 m/s to 10 km/s beside them.
"""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.parameters.parameters import QUANTITIES
from tests.fine_steps import wrong_ends

pytestmark = pytest.mark.slow

COUNT = 100_000
PLUG_INS = [str(path) for path in sorted((Path(__file__).parents[2] / "models").glob("*.py"))]


def random_impacts(count: int) -> erosion.Parameters:
    rng = np.random.default_rng(9)

    def between(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), count))

    r, v0, k, psi = between(1e-6, 1), between(1, 1e4), between(0.1, 10), between(0.01, 1)
    b = r * between(0.3, 3)
    m = between(1e3, 2e4) * r**2 * b
    sigma = (between(0.1, 30) * v0 / r) ** 2 * m / (k * b * psi)  # from rω/v₀
    alpha = np.where(rng.random(count) < 0.2, between(1e-6, np.pi / 2), rng.uniform(1e-6, np.pi / 2, count))
    return erosion.Parameters(
        k=k, psi=psi, r=r, b=b, m=m, v0=v0, sigma=sigma, alpha=alpha, phidot0=rng.uniform(-1, 1, count) * v0 / r,
        inertia=between(0.1, 2), units="si",
    )  # fmt: skip


P = random_impacts(COUNT)


@pytest.mark.parametrize("name", [*erosion.available_models(), *PLUG_INS])
def test_random_impacts_all_end(name):
    found = erosion.impact(name, P)
    assert set(np.unique(found.ended_by)) <= {"no-cut", "rebound", "stop"}
    assert np.isfinite(found.volume).all()
    assert np.isfinite(found.t_c).all()
    assert (found.t_c[found.ended_by != "no-cut"] > 0).all()
    if name != "as-printed":  # whose volume is of the centre of mass, which may move back
        assert (found.volume >= 0).all()
    # The same at a thousandth of the tolerance: other steps, the same ends.
    some = P.replace(**{q: getattr(P, q)[::20] for q in QUANTITIES})
    tight = erosion.impact(name, some, rtol=1e-12)
    # Rounding may be above that tolerance, as for a tip that grazes the surface with no width.
    met = tight.ended_by != "failed"
    assert np.mean(met) > 0.998
    np.testing.assert_array_equal(found.ended_by[::20][met], tight.ended_by[met])
    # Volumes of an impact are as exact as V* or themselves, whichever is larger.
    size = np.maximum(np.asarray(some.volume_scale), np.abs(tight.volume))
    assert np.max((np.abs(found.volume[::20] - tight.volume) / size)[met]) < 1e-8


@pytest.mark.parametrize("name", ["rotating", "rotating-full-torque"])
def test_random_ends_are_those_of_small_steps(name):
    few = P.replace(**{q: getattr(P, q)[::200] for q in QUANTITIES})
    wrong, near = wrong_ends(erosion.load_model(name), few, erosion.impact(name, few).ended_by)
    assert wrong == 0
    assert near <= 2
