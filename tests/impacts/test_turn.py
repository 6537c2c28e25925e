"""The turn of the body bounds where the best angle is searched, and whatever shows a best angle beyond it says so."""

import json

import jax
import numpy as np
import pytest
from matplotlib.text import Text

import erosion
from erosion.impacts.turn import BEYOND, BEYOND_LABEL, TURNED, TurnLimited, turned_beyond
from erosion.plotting.curves import plot_optimum
from erosion.sweeps.grid import in_words
from tests.reference import closed_form

P = erosion.TABLE_1
CASES = 20
ANGLES = np.linspace(0, np.pi / 2, 4002)[1:]


@pytest.mark.parametrize(
    "name", ["linearized", "finnie", "rotating", "rotating-full-torque", "rotating-tan-alpha-full-torque"]
)
def test_no_scanned_angle_within_the_limit_is_better(name):
    rng = np.random.default_rng(59)
    p = P.replace(k=np.exp(rng.uniform(-1.5, 2, CASES)), inertia=rng.uniform(0.3, 0.6, CASES))
    p = p.replace(phidot0=rng.uniform(-1.2, 1.2, CASES) * P.v0 / P.r)
    best = erosion.alpha_max(name, p)
    limited = TurnLimited(erosion.load_model(name), np.pi / 2)
    hits = erosion.impact(limited, p.replace(alpha=ANGLES[:, None]), rtol=1e-11)
    scanned = np.where(hits.ended_by == TURNED, -np.inf, hits.volume).max(axis=0)
    assert best.certified.all()
    assert ("limit" in best.kind) == (name != "linearized")  # which does not turn
    assert not np.any(best.turned_beyond)
    none = best.kind == "none"
    assert np.all(scanned[none] <= 0)
    assert np.all(best.volume[~none] >= scanned[~none] * (1 - 1e-9))


def test_the_limit_is_where_the_closed_form_turns_by_a_quarter():
    p = P.replace(k=1.0)
    best = erosion.alpha_max("finnie", p, max_turn="20deg")
    assert (best.kind, best.attained, best.certified) == ("limit", True, True)
    exact, at = closed_form("finnie"), p.replace(alpha=best.alpha)
    turn = exact.state(exact.t_c(at), at).phi - np.pi / 2
    assert abs(float(turn)) == pytest.approx(np.deg2rad(20), abs=1e-7)

    def turns(k, alpha):
        there = p.replace(k=k, alpha=alpha)
        return exact.state(exact.t_c(there), there).phi

    by_k, by_alpha = jax.grad(turns, (0, 1))(1.0, float(best.alpha))
    assert best.sensitivities["k"] == pytest.approx(-float(by_k / by_alpha), rel=1e-6)


def test_the_first_example_holds():
    best = erosion.alpha_max("rotating", P.replace(k=1.0))
    assert (best.kind, best.certified, bool(best.turned_beyond)) == ("limit", True, False)
    beside = P.replace(k=1.0, alpha=best.alpha + np.array([-1e-7, 1e-7]))
    assert turned_beyond("rotating", beside).tolist() == [False, True]


def test_where_the_body_always_turns_too_far_no_angle_is_best():
    best = erosion.alpha_max("finnie", P.replace(k=1.0, phidot0=1.1 * P.v0 / P.r))
    assert (best.kind, best.ended_by) == ("none", TURNED)
    assert np.isnan([best.alpha, best.value]).all()


def test_a_least_volume_is_not_one_beyond_the_limit():
    p, low, high = P.replace(k=1.0), np.deg2rad(10), np.deg2rad(60)
    least = erosion.alpha_min("rotating", p, alpha_range=(low, high))
    angles = np.linspace(low, high, 501)
    hits = erosion.impact(TurnLimited(erosion.load_model("rotating"), np.pi / 2), p.replace(alpha=angles))
    assert least.value <= hits.volume[hits.ended_by != TURNED].min() * (1 + 1e-9)
    assert not least.turned_beyond


@pytest.mark.parametrize("max_turn", [0, -1.0, np.inf, np.nan, True, "x", "1 m", [1.0]])
def test_a_turn_is_a_positive_angle(max_turn):
    with pytest.raises(ValueError, match="Argument `max_turn` must be an"):
        erosion.alpha_max("finnie", P, max_turn=max_turn)


def test_what_shows_a_best_angle_beyond_the_limit_says_so():
    p = P.replace(k=1.0)
    within, beyond = (erosion.alpha_max("rotating", p, max_turn=turn) for turn in ("90deg", None))
    for best in (within, beyond):
        said = best is beyond
        assert (BEYOND in str(best)) == said
        assert json.loads(json.dumps(best.to_dict()))["turned_beyond"] == said
        # The curve beyond is drawn in both, so that a reader sees what the limit leaves out.
        assert BEYOND_LABEL in [text.get_text() for text in plot_optimum(best).findobj(Text)]


def test_a_sweep_gives_turns_if_asked():
    angles = np.deg2rad([10.0, 30.0, 60.0])
    found = erosion.sweep(["rotating", "ecrc"], P.to("si"), alpha=angles, turn=True)
    turns = erosion.impact("rotating", P.to("si").replace(alpha=angles)).turn
    np.testing.assert_allclose(found.turn.sel(model="rotating"), turns, rtol=1e-8)
    assert np.isnan(found.turn.sel(model="ecrc")).all()
    assert "turn" not in erosion.sweep("rotating", P, alpha=angles)


@pytest.mark.parametrize("name", ["linearized", "rotating"])
def test_no_impacts_have_no_turns(name):
    assert turned_beyond(name, P.replace(alpha=np.zeros(0))).shape == (0,)


def test_own_parameters_vary_where_nothing_is_cut():
    away = P.replace(alpha=0.5, phidot0=-2 * P.v0 / P.r)
    found = erosion.sweep("rotating-deformation", away, energy_ratio=[1.0, 2.0, 3.0])
    assert (in_words(found.ended_by) == "no-cut").all()
    assert "findings" not in found.attrs


def test_sweeps_keep_the_limit():
    found = erosion.regimes("rotating", P, phidot0=np.array([-0.5, 0.0, 0.5]) * P.v0 / P.r, alpha=[0.1, 0.2])
    assert found.turn.attrs["units"] == "rad"
    last = erosion.impact("rotating", P.replace(alpha=0.2, phidot0=found.phidot0.values[0]))
    assert found.turn.values[0, 1] == pytest.approx(last.turn, rel=1e-8)
    p = P.replace(alpha=found.alpha_max.values, phidot0=found.phidot0.values)
    assert not turned_beyond("rotating", p).any()
    free = erosion.regimes("rotating", P, phidot0=found.phidot0.values, alpha=[0.1, 0.2], max_turn=None)
    assert turned_beyond("rotating", p.replace(alpha=free.alpha_max.values)).any()
