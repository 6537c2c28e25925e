"""Kinked force laws: the volume of every impact is right; derivatives are right or said to be missing."""

import jax
import numpy as np
import pytest

import erosion
from erosion.impacts.impact import split
from erosion.ode.reduction import may_have_kinks
from tests.fine_steps import scipy_cut
from tests.kinked_laws import KNOTS_OF, Breaking, Cond, KinkedTable, Power, Where, model_of, random_impacts

CONTINUOUS = [KinkedTable, Where, Cond, Power]


def _case(p: erosion.Parameters, i: int) -> erosion.Parameters:
    return p.replace(**{q: float(getattr(p, q)[i]) for q in ("alpha", "k", "phidot0", "v0")})


@pytest.mark.slow
@pytest.mark.parametrize("law", [KinkedTable, Where, Cond, Breaking], ids=lambda law: law.__name__)
def test_volumes_are_scipys_started_anew_at_the_kinks(law):
    p = random_impacts(3, seed=3)
    hits = [erosion.impact(model_of(law), p, derivatives=order) for order in (0, 1, 2)]
    for i in range(3):
        volume, ended_by, _ = scipy_cut(model_of(law), _case(p, i), KNOTS_OF[law])
        for hit in hits:
            assert hit.ended_by[i] == ended_by
            assert hit.volume[i] == pytest.approx(volume, rel=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize("law", [*CONTINUOUS, Breaking], ids=lambda law: law.__name__)
def test_every_impact_has_its_volume_to_every_order(law):
    p = random_impacts(500 if law is KinkedTable else 2000, seed=1)  # each knot takes as long as another impact
    exact = erosion.impact(model_of(law), p, rtol=1e-12)
    assert set(exact.ended_by) == {"rebound", "stop", "no-cut"}
    for order in (0, 1, 2):
        hit = erosion.impact(model_of(law), p, derivatives=order)
        assert np.array_equal(hit.ended_by, exact.ended_by)
        error = np.abs(hit.volume - exact.volume) / np.maximum(exact.volume, 1e-12)
        # A step's error estimates may miss a kink by chance: of 600,000 impacts of `Where` one was off by 2.4e-7.
        assert np.sum(error > 1e-8) <= (law is Where and order == 1)
        assert np.max(error) < 5e-8


@pytest.mark.slow
def test_a_power_without_a_value_above_the_surface_is_the_guarded_one():
    class Guarded(Power):
        def factor(self, u):
            positive = jax.numpy.where(u > 0, u, 1.0)
            return jax.numpy.where(u > 0, positive**1.5, 0.0)

    p = random_impacts(2000, seed=1)
    plain, guarded = (erosion.impact(model_of(law), p, derivatives=2) for law in (Power, Guarded))
    assert np.array_equal(plain.ended_by, guarded.ended_by)
    for name in ("volume", "dvolume", "d2volume"):
        assert getattr(plain, name) == pytest.approx(getattr(guarded, name), rel=1e-7, abs=1e-9)
    volume, ended_by, _ = scipy_cut(model_of(Guarded), _case(p, 0))
    assert (plain.ended_by[0], plain.volume[0]) == (ended_by, pytest.approx(volume, rel=1e-8))


def _differences(model, p, step=1e-5):
    """V' and V'' by central differences of V and V', and where both ends are alike."""
    low, high = (erosion.impact(model, p.replace(alpha=p.alpha + way * step), derivatives=1, rtol=1e-12)
                 for way in (-1, 1))  # fmt: skip
    alike = (low.ended_by == high.ended_by) & (low.ended_by != "no-cut")
    return (high.volume - low.volume) / (2 * step), (high.dvolume - low.dvolume) / (2 * step), alike


@pytest.mark.slow
@pytest.mark.parametrize("law", CONTINUOUS, ids=lambda law: law.__name__)
def test_derivatives_across_kinks_are_differences(law):
    model, p = model_of(law), random_impacts(500, seed=1)
    hit = erosion.impact(model, p, derivatives=2)
    first, second, alike = _differences(model, p)
    # Where V'' is infinite nearby two integrations may differ by more than 1e-6 of it.
    assert np.sum(hit.no_derivatives) <= 1
    alike &= ~hit.no_derivatives
    size = np.abs(first) + hit.volume
    slopes = np.abs(hit.dvolume - first)[alike] / size[alike]
    curves = np.abs(hit.d2volume - second)[alike] / (np.abs(second) + size)[alike]
    # A difference near an angle at which the tip just reaches a kink is wrong itself: V'' is infinite there.
    assert np.quantile(slopes, 0.98) < 1e-6
    assert np.quantile(curves, 0.98) < 1e-4
    assert np.median(curves) < 1e-7


@pytest.mark.slow
def test_mixed_derivatives_across_kinks_are_differences():
    model, p, step = model_of(Where), erosion.TABLE_1.replace(alpha=0.7), 1e-4
    hit = erosion.impact(model, p, derivatives=2, wrt=("alpha", "k"))
    low, high = (erosion.impact(model, p.replace(k=p.k + way * step), derivatives=1, rtol=1e-12) for way in (-1, 1))
    assert (
        hit.d2volume[0, 1] == hit.d2volume[1, 0] == pytest.approx((high.dvolume - low.dvolume) / (2 * step), rel=1e-5)
    )


@pytest.mark.slow
def test_where_the_force_jumps_there_is_a_volume_and_a_reason():
    model, p = model_of(Breaking), random_impacts(1000, seed=1)
    hit = erosion.impact(model, p, derivatives=2)
    first, _, alike = _differences(model, p)
    assert not np.any(np.isnan(hit.volume))
    assert np.array_equal(np.isnan(hit.dvolume), hit.no_derivatives)
    # A cut that stays above the jump has its derivatives. One that crosses it has none, rather than wrong ones.
    assert 100 < np.sum(hit.no_derivatives) < 900
    known = alike & ~hit.no_derivatives
    errors = np.abs(hit.dvolume - first)[known] / (np.abs(first) + hit.volume)[known]
    assert np.quantile(errors, 0.99) < 1e-6
    assert f"{np.sum(hit.no_derivatives)} of 1,000" in str(hit)
    assert "a jump or an infinite rate of the force" in " ".join(str(hit).split())
    assert "no_derivatives" not in str(erosion.impact("rotating", p, derivatives=2))


@pytest.mark.slow
def test_first_derivatives_remain_where_only_the_second_fails():
    class Rooted(erosion.models.RigidErodent):
        """`linearized` with an end that moves as |α - 0.2|^1.5."""

        kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
        force: erosion.models.ForceLaw = erosion.models.ConstantRatio()
        torque: erosion.models.Torque = erosion.models.NoTorque()

        def events(self, state, p):
            shift = jax.numpy.sqrt(jax.numpy.abs(p.alpha - 0.2)) ** 3
            return {"rebound": state.y / self.scales(p).length + shift * state.vx / p.v0}

    hit = erosion.impact(Rooted(), erosion.TABLE_1.replace(alpha=[0.2, 0.3]), derivatives=2)
    assert list(hit.ended_by) == ["rebound", "rebound"]
    assert list(np.atleast_1d(hit.no_derivatives)) == [True, False]
    assert list(np.isnan(hit.d2volume)) == [True, False]


@pytest.mark.parametrize("name", [name for name in erosion.available_models() if "/" not in name])
def test_only_rough_motions_pay_for_kinks(name):
    assert not may_have_kinks(split(erosion.load_model(name), erosion.TABLE_1)[0])


@pytest.mark.parametrize("law", [*CONTINUOUS, Breaking], ids=lambda law: law.__name__)
def test_rough_motions_are_known(law):
    assert may_have_kinks(split(model_of(law), erosion.TABLE_1)[0])
