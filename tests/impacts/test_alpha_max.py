import dataclasses
import json

import numpy as np
import pytest

import erosion
from erosion.impacts.impact import split
from erosion.impacts.maxima import over_angles
from erosion.ode.resolve import Cells, Scan, joined
from erosion.output.tables import to_json
from tests.reference import closed_form

P = erosion.TABLE_1


def spun(s, **changes):
    return P.replace(phidot0=np.asarray(s) * P.v0 / P.r, **changes)


def test_linearized_optimum_depends_on_the_force_ratio_alone():
    best = erosion.alpha_max("linearized", P)
    assert best.alpha == pytest.approx(np.arctan(2) / 2, abs=1e-12)
    rates = best.sensitivities
    # α_max = ½ arctan k, so that dα_max/dk = ½/(1 + k²) = 0.1 at k = 2.
    assert rates["k"] == pytest.approx(0.1, abs=1e-10)
    for name in ("v0", "m", "r", "sigma", "b", "psi", "phidot0", "inertia"):
        assert abs(rates[name]) < 1e-10


def test_sensitivity_of_a_jump_is_how_the_jump_moves():
    p = spun(-0.2)
    best = erosion.alpha_max("rotating", p)
    h = 1e-4
    for name in ("k", "r", "inertia"):
        q = getattr(p, name)
        ends = erosion.alpha_max("rotating", p.replace(**{name: q * np.array([1 - h, 1 + h])})).alpha
        # Central differences err by h², and by the 1e-11 rad of a jump over 2h.
        assert best.sensitivities[name] * q == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-6, abs=0)


def test_sensitivity_of_an_interior_maximum_is_how_it_moves():
    best = erosion.alpha_max("rotating", P)
    h = 1e-3
    for name in ("k", "v0", "inertia"):
        q = getattr(P, name)
        ends = erosion.alpha_max("rotating", P.replace(**{name: q * np.array([1 - h, 1 + h])})).alpha
        assert best.sensitivities[name] * q == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-4, abs=0)


def test_a_supremum_that_is_never_reached_is_a_boundary():
    best = erosion.alpha_max("tan-alpha", P)
    assert (best.kind, best.alpha, best.attained) == ("boundary", 0.0, False)
    assert best.volume == pytest.approx(float(P.volume_scale) / 2, rel=1e-9, abs=0)
    assert len(best.candidates) == 1
    assert all(rate == 0 for rate in best.sensitivities.values())


def test_no_angle_cuts():
    best = erosion.alpha_max("finnie", spun(-1.1))
    assert (best.kind, best.volume, best.ended_by) == ("none", 0.0, "no-cut")
    assert np.isnan(best.alpha)


def test_certified_optimum_is_never_below_a_brute_force_scan():
    rng = np.random.default_rng(7)
    n = 24
    p = P.replace(k=rng.uniform(0.3, 5, n), r=P.r * np.exp(rng.uniform(-2, 2, n)), inertia=rng.uniform(0.3, 0.6, n))
    p = p.replace(phidot0=rng.uniform(-0.9, 0.9, n) * p.v0 / p.r)
    best = erosion.alpha_max("rotating", p)
    angles = np.linspace(0, np.pi / 2, 4001)[1:, None]
    brute = erosion.impact("rotating", p.replace(alpha=angles)).volume.max(axis=0)
    assert np.all(best.volume >= brute * (1 - 1e-8))


def test_a_range_has_ends_that_are_reached():
    low, high = np.deg2rad([35.0, 60.0])
    most = erosion.alpha_max("linearized", P, alpha_range=(low, high))
    least = erosion.alpha_min("linearized", P, alpha_range=(low, high))
    assert (most.kind, most.attained) == (least.kind, least.attained) == ("boundary", True)
    assert (most.alpha, least.alpha) == (low, high)
    exact = closed_form("linearized").volume(P.replace(alpha=low))
    assert most.volume == pytest.approx(float(exact), rel=1e-9, abs=0)


def test_least_within_a_band_may_be_a_jump():
    low, high = np.deg2rad([30.0, 60.0])
    p = P.replace(k=1.0)
    least = erosion.alpha_min("rotating", p, alpha_range=(low, high))
    angles = np.linspace(low, high, 2001)
    assert least.volume <= erosion.impact("rotating", p.replace(alpha=angles)).volume.min()


def test_other_objectives():
    # Linearized: the deepest point v₀ sin α/ω √(1 - …) grows until the stop cuts it short, and
    # the longest cut is every rebound, π/ω.
    per_mass = erosion.alpha_max("linearized", P, objective="volume per mass")
    assert per_mass.value == pytest.approx(per_mass.volume / float(P.m), rel=1e-9, abs=0)
    assert per_mass.alpha == pytest.approx(np.arctan(2) / 2, abs=1e-10)
    deepest = erosion.alpha_max("linearized", P, objective="depth")
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
    deepest = erosion.alpha_max("tan-alpha", P, objective="depth")
    assert (deepest.certified, deepest.ended_by) == (True, "stop")
    assert deepest.alpha == pytest.approx(np.pi / 4, abs=1e-8)


def test_the_end_time_grows_without_bound_as_alpha_falls():
    longest = erosion.alpha_max("tan-alpha", P, objective="t_c")
    assert (longest.kind, longest.value, longest.attained) == ("boundary", np.inf, False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"objective": "weight"}, "Argument `objective` must be one of volume, .*, but is 'weight'"),
        ({"alpha_range": (0.5, 0.4)}, "Argument `alpha_range` must be two ascending angles"),
        ({"alpha_range": (0.5, 30.0)}, "Argument `alpha_range` must be two ascending angles"),
        ({"alpha_range": (np.nan, 0.4)}, "Argument `alpha_range` must be two ascending angles"),
    ],
)
def test_bad_arguments_get_one_sentence(arguments, message):
    with pytest.raises(ValueError, match=message):
        erosion.alpha_max("linearized", P, **arguments)


def test_an_optimum_is_printed_in_degrees():
    text = str(erosion.alpha_max("linearized", P))
    assert "31.717   °" in text
    assert "interior" in text


def test_a_jump_known_only_to_a_wide_cell_is_looked_at_from_outside_the_cell():
    search = over_angles(*split(erosion.load_model("rotating"), P.replace(k=1.0)), 1, 0.0, np.pi / 2, least=False)
    evaluate = search.loose
    jump = erosion.alpha_max("rotating", P.replace(k=1.0)).jumps[-1].alpha
    # As where cutting begins: 3e-8 wide, and the jump not in its middle.
    cells = Cells(*(evaluate(np.zeros(1, int), np.array([jump + aside])) for aside in (-2.5e-8, 5e-9)))
    scanned = Scan(joined(*cells), cells, cells, cells.low.value, np.zeros(1, int), np.ones(1, int))
    ((case, candidate),) = search.at_jumps(scanned, np.array([True]))
    assert (case, candidate.kind, candidate.side) == (0, "jump", "below")
    assert candidate.at == pytest.approx(jump - 2.5e-8, abs=1e-11)
    assert candidate.value == pytest.approx(1.77719894e-4, rel=1e-4, abs=0)  # V rises like a root towards the jump


def test_an_optimum_is_numbers_by_name():
    p = spun([-0.2, 0.0])
    best = erosion.alpha_max("rotating", p)
    numbers = best.to_dict()
    assert json.loads(to_json(numbers)) == numbers
    assert (numbers["model"], numbers["own_parameters"], numbers["kind"]) == ("rotating", {}, ["jump", "interior"])
    assert numbers["parameters"]["alpha"] == numbers["alpha"] == best.alpha.tolist()
    assert numbers["candidates"][0][0] == dataclasses.asdict(best.candidates[0][0])
    described = {"own_parameters", "parameters", "units"}
    assert set(numbers) - described == set(vars(best)) - {"p", "integrand", "sensitivities"}


def test_candidates_and_jumps_of_a_minimum_have_the_sign_of_the_objective():
    p, (low, high) = P.replace(k=1.0), np.deg2rad([30.0, 60.0])
    least = erosion.alpha_min("rotating", p, alpha_range=(low, high))
    most = erosion.alpha_max("rotating", p, alpha_range=(low, high))
    assert all(0 <= candidate.value <= most.value for candidate in least.candidates)
    assert [jump.below for jump in least.jumps] == pytest.approx([jump.below for jump in most.jumps], rel=1e-6, abs=0)


def test_a_jump_whose_sides_differ_by_rounding_is_one():
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("copper").replace(k=1.5, psi=2.0, v0=110.0)
    best = erosion.alpha_max("rotating", p.replace(phidot0=586666.6666666667))
    assert [(jump.ended_below, jump.ended_above) for jump in best.jumps] == [("rebound", "stop")]
    assert [regime.ended_by for regime in best.regimes] == ["rebound", "stop"]
    assert best.kind == "jump"
    assert len(best.candidates) == 1
