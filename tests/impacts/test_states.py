"""One impact's motion at given times against the closed form of `linearized`."""

import jax
import numpy as np
import pytest

import erosion
from erosion.impacts.impact import States, end_names, states_at
from tests.reference import closed_form

P = erosion.TABLE_1.replace(phidot0=1000.0)
MODEL = erosion.load_model("linearized")
EXACT = closed_form("linearized")
END = float(EXACT.t_c(P))
WITHIN = END * np.array([0.0, 1e-6, 0.3, 0.8, 1 - 1e-9])


@pytest.fixture(scope="module")
def motion() -> States:
    """Within the cut, after its end, and at its end."""
    return states_at(MODEL, P, np.array([*WITHIN, 2 * END, np.inf]), 1e-12)


def removed(t, alpha):
    """The kinetic energy along x that was lost, over the flow stress."""
    vx = EXACT.state(t, P.replace(alpha=alpha)).vx
    return P.m / (2 * P.sigma * P.psi) * ((P.v0 * jax.numpy.cos(alpha)) ** 2 - vx**2)


def test_the_state_is_that_of_the_time(motion: States) -> None:
    assert np.array_equal(motion.time[:5], WITHIN)
    exact = EXACT.state(np.array([*WITHIN, END, END]), P)
    for name, values in vars(exact).items():
        # Against the greatest value: depth and speeds pass through zero.
        assert np.abs(getattr(motion.state, name) - values).max() <= 1e-11 * np.abs(values).max(), name
    assert motion.tip.depth == pytest.approx(motion.state.y, abs=0)
    assert motion.removal_rate == pytest.approx(P.b * motion.state.y * motion.state.vx, rel=1e-14)


def test_the_volume_removed_so_far_is_the_energy_lost(motion: States) -> None:
    # The closed form is a difference of squares, which rounding leaves 15 digits of the whole.
    whole = motion.volume[-1]
    exact, slopes = (np.array([one(t, P.alpha) for t in WITHIN]) for one in (removed, jax.grad(removed, argnums=1)))
    assert np.allclose(motion.volume[:5], exact, rtol=1e-11, atol=1e-15 * whole)
    assert np.allclose(motion.dvolume[:5], slopes, rtol=1e-11, atol=1e-14 * whole)


def test_beyond_its_end_an_impact_stays_there(motion: States) -> None:
    assert motion.time[5:] == pytest.approx([END, END], rel=1e-11)
    assert motion.volume[5:] == pytest.approx([float(EXACT.volume(P))] * 2, rel=1e-11)
    # Of the volume removed in all, whose end moves with the angle.
    assert motion.dvolume[5:] == pytest.approx([float(EXACT.dvolume(P))] * 2, rel=1e-10)


def test_an_impact_that_has_not_ended_has_no_outcome(motion: States) -> None:
    names = end_names(MODEL)
    assert np.all(motion.outcome[:5] == len(names))
    assert [names[code] for code in motion.outcome[5:]] == ["rebound", "rebound"]
