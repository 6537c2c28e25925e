"""What kind of place the best angle is, how it moves, and that neighbours in an array change nothing of it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.impacts.alpha_max import OBJECTIVES
from erosion.models import Linearized
from erosion.models.base import Broadcast
from erosion.models.parts import Deformation, sincos
from tests.kinked_laws import Breaking, model_of

P = erosion.TABLE_1


class Roof(Deformation):
    """Two slopes that meet where tan α = 1/steepness, many times what is cut."""

    steepness: float = erosion.own_parameter(0.6, "s", "steepness")

    def removed_at_contact(self, p: erosion.Parameters) -> Broadcast:
        sine, cosine = sincos(p.alpha)
        return 10 * p.volume_scale * jnp.minimum(sine * self.steepness, cosine)


class Ridge(Deformation):
    """A ridge at an angle that grows with the root of k."""

    angle: float = erosion.own_parameter(0.6, "α_r", "angle of the ridge", "angle")

    def removed_at_contact(self, p: erosion.Parameters) -> Broadcast:
        return p.volume_scale * (2 - jnp.abs(p.alpha - self.angle * jnp.sqrt(p.k / 2)))


class Cliff(Deformation):
    """A jump that neither the end time nor the outcome shows."""

    angle: float = erosion.own_parameter(0.6, "α_c", "angle of the cliff", "angle")

    def removed_at_contact(self, p: erosion.Parameters) -> Broadcast:
        return p.volume_scale * jnp.where(p.alpha < self.angle, 2 + p.alpha, 1.0)


@pytest.mark.slow
def test_a_kink_moves_with_the_parameters_that_move_it():
    best = erosion.alpha_max(Linearized(deformation=Roof()), P)
    assert best.kind == "kink"
    assert best.alpha == pytest.approx(np.arctan(1 / 0.6), abs=1e-11)
    rates = dict(best.sensitivities)
    # α = arctan(1/s): dα/ds = -1/(1 + s²).
    assert rates.pop("steepness") == pytest.approx(-1 / 1.36, rel=1e-9)
    assert all(rate == 0 for rate in rates.values())
    ridges = erosion.alpha_max(Linearized(deformation=Ridge()), P.replace(k=[0.5, 2.0]))
    assert ridges.kind.tolist() == ["kink", "kink"]
    assert ridges.sensitivities["k"] == pytest.approx([0.3, 0.15], rel=1e-9)
    assert ridges.sensitivities["angle"] == pytest.approx([0.5, 1.0], rel=1e-9)


def test_a_jump_of_the_volume_alone_is_a_jump_and_its_motion_is_not_known():
    best = erosion.alpha_max(Linearized(deformation=Cliff()), P)
    assert (best.kind, best.side, best.certified) == ("jump", "below", True)
    assert [jump.alpha for jump in best.jumps] == pytest.approx([0.6], abs=1e-11)
    assert all(np.isnan(rate) for rate in best.sensitivities.values())
    assert "jump" in best.without_sensitivities


@pytest.mark.parametrize(
    ("model", "objective", "kind"), [(model_of(Breaking), "volume", "unresolved"), ("linearized", "t_c", "plateau")]
)
def test_where_the_motion_is_not_known_it_is_not_given_as_zero(model, objective, kind):
    best = erosion.alpha_max(model, P, objective=objective)
    assert best.kind == kind
    assert all(np.isnan(rate) for rate in best.sensitivities.values())
    assert best.without_sensitivities


@pytest.mark.parametrize("k", [0.3, 1.0, 2.0, 3.0, 5.0, 20.0])
def test_the_plateau_of_the_end_time_is_every_rebound(k):
    # A rebound takes π/ω at every angle; from tan α = k/2 on the cut stops, and sooner.
    p = P.replace(k=k)
    best = erosion.alpha_max("linearized", p, objective="t_c")
    assert (best.kind, best.low, best.ended_by, best.attained) == ("plateau", 0.0, "rebound", True)
    assert best.high == pytest.approx(np.arctan(k / 2), abs=1e-10)
    assert best.value == pytest.approx(float(np.pi / p.rate), rel=1e-11)
    assert best.low < best.alpha < best.high
    assert best.volume == pytest.approx(erosion.impact("linearized", p.replace(alpha=best.alpha)).volume, rel=1e-9)
    assert len(best.candidates) == 1
    assert "from 0°" in str(best)
    inner = erosion.alpha_max("linearized", p, objective="t_c", alpha_range=(best.high / 3, best.high / 2))
    assert (inner.kind, inner.low, inner.high) == ("plateau", best.high / 3, best.high / 2)


def test_the_least_volume_is_that_of_every_angle_that_cuts_nothing():
    p = P.replace(phidot0=-0.5 * P.v0 / P.r)
    least = erosion.alpha_min("finnie", p)
    assert (least.kind, least.value, least.high, least.ended_by) == ("plateau", 0.0, np.pi / 2, "no-cut")
    # Beside it V/V* = (P/2k) u², which is 1e-9 of the greatest some 1e-5 before u = cos α - 0.5 = 0.
    assert least.low == pytest.approx(np.arccos(0.5), abs=1e-4)


def test_the_volume_where_another_objective_is_greatest_as_alpha_falls_is_a_limit():
    longest = erosion.alpha_max("tan-alpha", P, objective="t_c")
    assert (longest.alpha, longest.value) == (0.0, np.inf)
    assert longest.volume == pytest.approx(float(P.volume_scale) / 2, rel=1e-9)


# Found among random cases: the maximum lies within 3e-8 rad of a change of outcome.
STEEP = [
    ("rotating-full-torque", 0.2872763492614587, 0.2784730265520582, 0.3359531065672799, 0.6793991231232899),
    ("rotating-tan-alpha-full-torque", 2.9926173735163353, 0.24848209531467672, 0.521630129478968, 0.5568405347351897),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "k", "r", "inertia", "s"), STEEP)
def test_a_steep_smooth_maximum_beside_a_change_of_outcome_is_interior(name, k, r, inertia, s):
    p = P.replace(k=k, r=r, inertia=inertia, phidot0=s * P.v0 / r)
    best = erosion.alpha_max(name, p)
    assert (best.kind, best.certified) == ("interior", True)
    angles = best.alpha + np.linspace(-1e-7, 1e-7, 2001)
    assert np.max(erosion.impact(name, p.replace(alpha=angles)).volume) <= best.volume * (1 + 1e-8)


def test_a_case_is_the_same_alone_and_among_others():
    rng, n = np.random.default_rng(11), 120
    p = P.replace(k=np.exp(rng.uniform(-1.5, 2, n)), inertia=rng.uniform(0.3, 0.6, n))
    p = p.replace(phidot0=rng.uniform(-1.2, 1.2, n) * P.v0 / P.r)
    together = erosion.alpha_max("rotating", p)
    for i in (0, 17, 44, 119):
        alone = erosion.alpha_max("rotating", p.replace(k=p.k[i], inertia=p.inertia[i], phidot0=p.phidot0[i]))
        for field in dataclasses.fields(alone):
            if field.name not in ("model", "p", "objective", "least", "integrand"):
                # The text of a float is its bits, and NaN is NaN.
                assert repr(getattr(alone, field.name)) == repr(getattr(together, field.name)[i]), field.name


def test_a_kink_is_one_also_where_the_kept_side_bends_upward():
    random, cases = np.random.default_rng(0), 24
    p = P.replace(k=np.exp(random.uniform(-3, 2, cases)), phidot0=random.uniform(-1, 1, cases) * P.v0 / P.r)
    best = erosion.alpha_max("rotating-full-torque", p, objective="t_c")
    assert {*best.kind} == {"jump", "interior", "kink"}
    kinks = best.kind == "kink"
    assert kinks.sum() == 5
    assert np.isfinite(best.sensitivities["k"][kinks]).all()
    at = p.replace(k=p.k[kinks], phidot0=p.phidot0[kinks])
    end_time = OBJECTIVES["t_c"](erosion.load_model("rotating-full-torque"))
    below, above = (
        erosion.impact(end_time, at.replace(alpha=best.alpha[kinks] + aside), derivatives=1, rtol=1e-11).dvolume
        for aside in (-1e-7, 1e-7)
    )
    assert (below > 1e-3 * best.value[kinks]).all()
    assert (above < -1e-3 * best.value[kinks]).all()


def test_the_motion_of_such_a_kink_is_its_difference():
    p = P.replace(k=4.777 * np.array([1, 1 - 1e-5, 1 + 1e-5]), phidot0=0.301 * P.v0 / P.r)
    best = erosion.alpha_max("rotating-full-torque", p, objective="t_c")
    assert best.kind[0] == "kink"
    assert best.sensitivities["k"][0] == pytest.approx((best.alpha[2] - best.alpha[1]) / (2e-5 * 4.777), rel=1e-5)
