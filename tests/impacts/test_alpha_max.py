"""The answer lies within the range that was asked for, whatever its size and place.

The best angle of kinked force laws: brute force's, or said to be unresolved.

What kind of place the best angle is, how it moves, and that neighbours in an array change nothing of it.
"""

import dataclasses
import functools
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.impacts.maxima import limit_at_zero
from erosion.impacts.optimum import OBJECTIVES
from erosion.models import Linearized
from erosion.models.base import Broadcast
from erosion.models.parts import Deformation, sincos
from erosion.output.tables import to_json
from erosion.plotting.curves import pieces, plot_optimum
from tests.kinked_laws import Breaking, KinkedTable, Opaque, Where, model_of
from tests.reference import best_angle, closed_form

P = erosion.TABLE_1.to("si")

# The search itself, of all angles: jumps and kinks are where the body turns far.
alpha_max = functools.partial(erosion.alpha_max, max_turn=None)
alpha_min = functools.partial(erosion.alpha_min, max_turn=None)


def spun(s, **changes):
    return P.replace(phidot0=np.asarray(s) * P.v0 / P.r, **changes)


def test_linearized_optimum_depends_on_the_force_ratio_alone():
    best = alpha_max("linearized", P)
    assert best.alpha == pytest.approx(best_angle(2.0), abs=1e-12)
    rates = best.sensitivities
    # α_max = ½ arctan k, so that dα_max/dk = ½/(1 + k²) = 0.1 at k = 2.
    assert rates["k"] == pytest.approx(0.1, abs=1e-10)
    for name in ("v0", "m", "r", "sigma", "b", "psi", "phidot0", "inertia"):
        assert abs(rates[name]) < 1e-10


# Central differences err by h², and by the 1e-11 rad of a jump over 2h.
@pytest.mark.parametrize(("spin", "kind", "h", "rel"), [(-0.2, "jump", 1e-4, 1e-6), (0.0, "interior", 1e-3, 1e-4)])
def test_the_sensitivity_of_the_best_angle_is_how_it_moves(spin, kind, h, rel):
    p = spun(spin)
    best = alpha_max("rotating", p)
    assert best.kind == kind
    for name in ("k", "v0", "r", "inertia"):
        q = getattr(p, name)
        below, above = alpha_max("rotating", p.replace(**{name: q * np.array([1 - h, 1 + h])})).alpha
        assert best.sensitivities[name] * q == pytest.approx((above - below) / (2 * h), rel=rel, abs=1e-9)


# At its end the cut has turned by the limit; where the cut jumps; before the body turns back.
@pytest.mark.parametrize(
    ("k", "spin", "turn"), [(1.0, 0.0, 1.0), (1.61, 0.49, 0.8), (0.45, 0.22, 0.599)], ids=["end", "jump", "graze"]
)
def test_a_limit_of_the_turn_moves_as_its_turn_does(k, spin, turn):
    p, h = spun(spin, k=k), 1e-3
    best = alpha_max("rotating", p, max_turn=1.0)
    assert (best.kind, best.turn) == ("limit", pytest.approx(turn, abs=1e-3))
    for name in ("k", "v0", "r", "inertia"):
        q = getattr(p, name)
        below, above = alpha_max("rotating", p.replace(**{name: q * np.array([1 - h, 1 + h])}), max_turn=1.0).alpha
        assert best.sensitivities[name] * q == pytest.approx((above - below) / (2 * h), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("max_turn", [-1.0, 0.0, np.inf, True, "1.5", "90 in"])
def test_a_limit_that_is_no_turn_is_refused(max_turn):
    with pytest.raises(ValueError, match="Argument `max_turn` must"):
        alpha_max("rotating", P, max_turn=max_turn)


def test_a_supremum_that_is_never_reached_is_a_boundary():
    best = alpha_max("tan-alpha", P)
    assert (best.kind, best.alpha, best.attained) == ("boundary", 0.0, False)
    assert best.volume == pytest.approx(float(P.volume_scale) / 2, rel=1e-9, abs=0)
    assert len(best.candidates) == 1
    assert all(rate == 0 for rate in best.sensitivities.values())


def test_no_angle_cuts():
    best = alpha_max("finnie", spun(-1.1))
    assert (best.kind, best.volume, best.ended_by) == ("none", 0.0, "no-cut")
    assert np.isnan(best.alpha)


def test_certified_optimum_is_never_below_a_brute_force_scan():
    rng = np.random.default_rng(7)
    n = 24
    p = P.replace(k=rng.uniform(0.3, 5, n), r=P.r * np.exp(rng.uniform(-2, 2, n)), inertia=rng.uniform(0.3, 0.6, n))
    p = p.replace(phidot0=rng.uniform(-0.9, 0.9, n) * p.v0 / p.r)
    best = alpha_max("rotating", p)
    angles = np.linspace(0, np.pi / 2, 4001)[1:, None]
    brute = erosion.impact("rotating", p.replace(alpha=angles)).volume.max(axis=0)
    assert np.all(best.volume >= brute * (1 - 1e-8))


def test_least_within_a_band_may_be_a_jump():
    low, high = np.deg2rad([30.0, 60.0])
    p = P.replace(k=1.0)
    least = alpha_min("rotating", p, alpha_range=(low, high))
    angles = np.linspace(low, high, 2001)
    assert least.volume <= erosion.impact("rotating", p.replace(alpha=angles)).volume.min()


def test_other_objectives():
    # Linearized: the deepest point v₀ sin α/ω √(1 - …) grows until the stop cuts it short, and
    # the longest cut is every rebound, π/ω.
    per_mass = alpha_max("linearized", P, objective="volume per mass")
    assert per_mass.value == pytest.approx(per_mass.volume / float(P.m), rel=1e-9, abs=0)
    assert per_mass.alpha == pytest.approx(best_angle(2.0), abs=1e-10)
    deepest = alpha_max("linearized", P, objective="depth")
    # y = (v₀ sin α/ω) sin ωt reaches its crest if cos ωt = 1 - k cot α is 0 later: tan α ≤ k.
    # Above, y² = (v₀/ω)² (2 k sin α cos α - k² cos²α), whose crest is at tan 2α = -2/k.
    crest = (np.pi - np.arctan(2 / float(P.k))) / 2
    depth = np.sqrt(2 * P.k * np.sin(crest) * np.cos(crest) - (P.k * np.cos(crest)) ** 2) * P.v0 / P.rate
    assert deepest.alpha == pytest.approx(max(crest, np.arctan(2)), abs=1e-8)
    assert deepest.value == pytest.approx(float(depth), rel=1e-9, abs=0)
    cut = erosion.simulate("linearized", P.replace(alpha=deepest.alpha))
    assert deepest.value == pytest.approx(cut.max_depth, rel=1e-8, abs=0)
    assert deepest.volume == pytest.approx(cut.volume, rel=1e-8, abs=0)


def test_a_tip_that_stops_where_it_is_deepest_has_a_certified_depth():
    deepest = alpha_max("tan-alpha", P, objective="depth")
    assert (deepest.certified, deepest.ended_by) == (True, "stop")
    assert deepest.alpha == pytest.approx(np.pi / 4, abs=1e-8)


def test_an_optimum_is_numbers_by_name():
    p = spun([-0.2, 0.0])
    best = alpha_max("rotating", p)
    numbers = best.to_dict()
    assert json.loads(to_json(numbers)) == numbers
    assert (numbers["model"], numbers["own_parameters"], numbers["kind"]) == ("rotating", {}, ["jump", "interior"])
    assert numbers["parameters"]["alpha"] == numbers["alpha"] == best.alpha.tolist()
    candidates = numbers["candidates"]
    assert [each["dim_0"] for each in candidates] == [i for i in range(2) for _ in best.candidates[i]]
    assert (candidates[0]["alpha"], numbers["units"]["value"]) == (best.candidates[0][0].alpha, "m^3")
    assert candidates[0]["value"] == pytest.approx(best.candidates[0][0].value, rel=1e-15)
    described = {"own_parameters", "parameters", "units", "findings"}
    assert set(numbers) - described == set(vars(best)) - {"p", "integrand", "sensitivities"}


def test_candidates_and_jumps_of_a_minimum_have_the_sign_of_the_objective():
    p, (low, high) = P.replace(k=1.0), np.deg2rad([30.0, 60.0])
    least = alpha_min("rotating", p, alpha_range=(low, high))
    most = alpha_max("rotating", p, alpha_range=(low, high))
    assert all(0 <= candidate.value <= most.value for candidate in least.candidates)
    assert [jump.below for jump in least.jumps] == pytest.approx([jump.below for jump in most.jumps], rel=1e-6, abs=0)


def test_a_jump_whose_sides_differ_by_rounding_is_one():
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("copper").replace(k=1.5, psi=2.0, v0=110.0)
    best = alpha_max("rotating", p.replace(phidot0=586666.6666666667))
    assert [(jump.ended_below, jump.ended_above) for jump in best.jumps] == [("rebound", "stop")]
    assert [regime.ended_by for regime in best.regimes] == ["rebound", "stop"]
    assert best.kind == "jump"
    assert len(best.candidates) == 1


QUARTER = np.pi / 2
PEAK = {"linearized": best_angle(2.0), "finnie": best_angle(2 / 3), "tan-alpha": 0.0}
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
        (alpha_max(name, P, alpha_range=ends), inside),
        # V rises to its peak and falls from there.
        (alpha_min(name, P, alpha_range=ends), min(ends, key=lambda end: volume_of(name, end))),
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
        best = alpha_max("linearized", P, alpha_range=(low, high))
        assert best.kind in ("interior", "boundary", "plateau")
        assert low <= best.alpha <= high
        assert best.alpha == pytest.approx(peak, abs=1e-9)
        assert best.value == pytest.approx(greatest, rel=1e-11)


def test_a_maximum_at_less_than_a_ten_thousandth_of_a_radian_is_found():
    # sin α ≤ P u/2 is a rebound: V/V* = (2u sin α - 2/P sin²α)/k, greatest near α = P u/2.
    p = P.replace(phidot0=-0.9999 * P.v0 / P.r)
    best = alpha_max("finnie", p)
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


def test_least_removal_over_all_angles_is_nothing():
    best = alpha_min("linearized", P)
    assert best.value == 0
    assert (best.kind, best.alpha) == ("boundary", QUARTER)
    below = alpha_min("rotating-tan-alpha", P, alpha_range=(0.0, 0.5))
    assert (below.value, below.alpha, below.attained) == (0.0, 0.0, False)


@pytest.mark.parametrize("ends", [(0.0, 1e-5), (0.3, 0.3 + 1e-9)])
def test_a_narrow_range_is_drawn(ends):
    best = alpha_max("linearized", P, alpha_range=ends)
    angles = np.concatenate([piece.alpha for piece in pieces(best)])
    assert ends[0] < np.min(angles) < np.max(angles) < ends[1]


def _brute_force(model, p) -> tuple[float, float]:
    angles = np.linspace(0.01, 1.57, 2001)
    volumes = erosion.impact(model, p.replace(alpha=angles)).volume
    best = angles[np.argmax(volumes)]
    angles = np.linspace(best - 1e-3, best + 1e-3, 201)
    volumes = erosion.impact(model, p.replace(alpha=angles)).volume
    return angles[np.argmax(volumes)], np.max(volumes)


@pytest.mark.parametrize("law", [KinkedTable, Where, Breaking], ids=lambda law: law.__name__)
@pytest.mark.parametrize("k", [1.0, 2.0])
def test_the_best_angle_of_a_law_with_kinks_or_a_jump_is_certified(law, k):
    model, p = model_of(law), P.replace(k=k)
    best, (alpha, volume) = alpha_max(model, p), _brute_force(model, p)
    assert best.certified
    assert best.kind in ("interior", "jump")
    assert best.alpha == pytest.approx(alpha, abs=1e-4)
    assert volume * (1 - 1e-9) < best.value < volume * (1 + 1e-5)


def test_where_nothing_has_derivatives_the_best_angle_is_unresolved_and_says_so():
    model, p = model_of(Opaque), P
    best, (alpha, volume) = alpha_max(model, p), _brute_force(model, p)
    assert (best.kind, best.certified) == ("unresolved", False)
    assert best.alpha == pytest.approx(alpha, abs=1e-4)
    assert best.value >= volume * (1 - 1e-9)
    # The figure shows V at every angle all the same.
    assert all(np.all(np.isfinite(piece.value)) for piece in pieces(best))
    assert len(plot_optimum(best).axes) == 1


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


def test_a_kink_moves_with_the_parameters_that_move_it():
    best = alpha_max(Linearized(deformation=Roof()), P)
    assert best.kind == "kink"
    assert best.alpha == pytest.approx(np.arctan(1 / 0.6), abs=1e-11)
    rates = dict(best.sensitivities)
    # α = arctan(1/s): dα/ds = -1/(1 + s²).
    assert rates.pop("steepness") == pytest.approx(-1 / 1.36, rel=1e-9)
    assert all(rate == 0 for rate in rates.values())
    ridges = alpha_max(Linearized(deformation=Ridge()), P.replace(k=[0.5, 2.0]))
    assert ridges.kind.tolist() == ["kink", "kink"]
    assert ridges.sensitivities["k"] == pytest.approx([0.3, 0.15], rel=1e-9)
    assert ridges.sensitivities["angle"] == pytest.approx([0.5, 1.0], rel=1e-9)


def test_a_jump_of_the_volume_alone_is_a_jump_and_its_motion_is_not_known():
    best = alpha_max(Linearized(deformation=Cliff()), P)
    assert (best.kind, best.side, best.certified) == ("jump", "below", True)
    assert [jump.alpha for jump in best.jumps] == pytest.approx([0.6], abs=1e-11)
    assert all(np.isnan(rate) for rate in best.sensitivities.values())
    assert "jump" in best.without_sensitivities


@pytest.mark.parametrize(
    ("model", "objective", "kind"), [(model_of(Opaque), "volume", "unresolved"), ("linearized", "t_c", "plateau")]
)
def test_where_the_motion_is_not_known_it_is_not_given_as_zero(model, objective, kind):
    best = alpha_max(model, P, objective=objective)
    assert best.kind == kind
    assert all(np.isnan(rate) for rate in best.sensitivities.values())
    assert best.without_sensitivities


@pytest.mark.parametrize("k", [0.3, 1.0, 2.0, 3.0, 5.0, 20.0])
def test_the_plateau_of_the_end_time_is_every_rebound(k):
    # A rebound takes π/ω at every angle; from tan α = k/2 on the cut stops, and sooner.
    p = P.replace(k=k)
    best = alpha_max("linearized", p, objective="t_c")
    assert (best.kind, best.low, best.ended_by, best.attained) == ("plateau", 0.0, "rebound", True)
    assert best.high == pytest.approx(np.arctan(k / 2), abs=1e-10)
    assert best.value == pytest.approx(float(np.pi / p.rate), rel=1e-11)
    assert best.low < best.alpha < best.high
    assert best.volume == pytest.approx(erosion.impact("linearized", p.replace(alpha=best.alpha)).volume, rel=1e-9)
    assert len(best.candidates) == 1
    inner = alpha_max("linearized", p, objective="t_c", alpha_range=(best.high / 3, best.high / 2))
    assert (inner.kind, inner.low, inner.high) == ("plateau", best.high / 3, best.high / 2)


def test_the_least_volume_is_that_of_every_angle_that_cuts_nothing():
    p = P.replace(phidot0=-0.5 * P.v0 / P.r)
    least = alpha_min("finnie", p)
    assert (least.kind, least.value, least.high, least.ended_by) == ("plateau", 0.0, np.pi / 2, "no-cut")
    # Beside it V/V* = (P/2k) u², which is 1e-9 of the greatest some 1e-5 before u = cos α - 0.5 = 0.
    assert least.low == pytest.approx(np.arccos(0.5), abs=1e-4)


def test_the_end_time_grows_without_bound_as_alpha_falls_where_the_volume_has_a_limit():
    longest = alpha_max("tan-alpha", P, objective="t_c")
    assert (longest.kind, longest.alpha, longest.value, longest.attained) == ("boundary", 0.0, np.inf, False)
    assert longest.volume == pytest.approx(float(P.volume_scale) / 2, rel=1e-9)


def test_a_steep_smooth_maximum_beside_a_change_of_outcome_is_interior():
    # Found among random cases: the maximum lies within 3e-8 rad of a change of outcome.
    name, r = "rotating-full-torque", 0.2784730265520582 * 0.0254
    spin = 0.6793991231232899 * P.v0 / r
    p = P.replace(k=0.2872763492614587, r=r, inertia=0.3359531065672799, phidot0=spin)
    best = alpha_max(name, p)
    assert (best.kind, best.certified) == ("interior", True)
    angles = best.alpha + np.linspace(-1e-7, 1e-7, 2001)
    assert np.max(erosion.impact(name, p.replace(alpha=angles)).volume) <= best.volume * (1 + 1e-8)


@pytest.mark.parametrize("max_turn", [None, "90deg"])
def test_a_case_is_the_same_alone_and_among_others(max_turn):
    rng, n = np.random.default_rng(11), 120
    p = P.replace(k=np.exp(rng.uniform(-1.5, 2, n)), inertia=rng.uniform(0.3, 0.6, n))
    p = p.replace(phidot0=rng.uniform(-1.2, 1.2, n) * P.v0 / P.r)
    together = alpha_max("rotating", p, max_turn=max_turn)
    for i in (0, 17, 44, 119):
        one = p.replace(k=p.k[i], inertia=p.inertia[i], phidot0=p.phidot0[i])
        alone = alpha_max("rotating", one, max_turn=max_turn)
        for field in dataclasses.fields(alone):
            if field.name not in ("model", "p", "objective", "least", "max_turn", "integrand"):
                # The text of a float is its bits, and NaN is NaN.
                assert repr(getattr(alone, field.name)) == repr(getattr(together, field.name)[i]), field.name


def test_a_kink_is_one_also_where_the_kept_side_bends_upward():
    random, cases = np.random.default_rng(0), 24
    p = P.replace(k=np.exp(random.uniform(-3, 2, cases)), phidot0=random.uniform(-1, 1, cases) * P.v0 / P.r)
    best = alpha_max("rotating-full-torque", p, objective="t_c")
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
    best = alpha_max("rotating-full-torque", p, objective="t_c")
    assert best.kind[0] == "kink"
    assert best.sensitivities["k"][0] == pytest.approx((best.alpha[2] - best.alpha[1]) / (2e-5 * 4.777), rel=1e-5)
