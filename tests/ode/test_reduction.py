"""A motion with fewer unknowns: which are integrated, and what they keep.

Functions of a number whose jumps are known, resolved.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion.ode.outputs import StateOutputs
from erosion.ode.problem import Event, Problem
from erosion.ode.reduction import WholeMotion, are_affine, reduced_motion_of
from erosion.ode.resolve import Nodes, Ruler, Scan, is_jump, scan
from erosion.ode.signature import Options
from erosion.ode.solve import solve
from tests.ode.problems import ended, lanes_of


def unknowns(problem, args) -> int:
    signature, parameters = lanes_of(problem, args)
    return len(reduced_motion_of(signature)(parameters).initial().state)


def _odd_rate(t, y, args):
    force = -args["stiffness"] * jnp.sum(jnp.stack([y["y"], jnp.zeros_like(y["y"])]))
    return {
        "x": y["vx"],
        "y": y["vy"],
        "phi": 3.0 + 0.0 * y["y"],
        "vx": -args["drag"] * force,
        "vy": force,
        "omega": jnp.zeros_like(force),
    }


# What the search must not stumble over: arrays, zeros, a factor of zero, a rate without state.
ODD = Problem(
    lambda args: {"x": 0.0, "y": 0.0, "phi": 0.0, "vx": args["v"][0], "vy": args["v"][1], "omega": 1.0},
    _odd_rate,
    {
        "rebound": Event(lambda t, y, args: y["y"] + 0 * y["phi"], -1),
        "stop": Event(lambda t, y, args: y["vx"] * y["omega"], -1),
    },
    {"volume": lambda t, y, args: y["y"] * y["vx"]},
    time_scale=lambda args: 1 / jnp.sqrt(args["stiffness"]),
)


def test_odd_arithmetic_is_left_as_it_is():
    args = {"drag": 0.0, "stiffness": 4.0, "v": np.array([3.0, 0.5])}
    # y, φ with a rate of arguments alone, ∫ force.
    assert unknowns(ODD, args) == 3
    # Without drag ẋ stays, and the closed form is half a period of y.
    exact = 3.0 * 2 * 0.5 / 4.0
    for place, slope in ((2, exact / 3.0), (3, exact / 0.5)):
        ended_by, results = ended(ODD, args, (place,))
        assert ended_by == "rebound"
        assert np.isclose(results.outputs.value[0][0], exact, rtol=1e-9)
        assert np.isclose(results.outputs.by_first[0][0], slope, rtol=1e-8)


def _looks(motion, scale, steps=4):
    """Rates of events and integrals along the motion, at its start and after steps."""
    at, rows = motion.initial(), []
    for _ in range(steps):
        rate = motion.rate(at)
        rows.append(jax.tree.leaves((jax.jvp(motion.events, (at,), (rate,)), rate.integrals)))
        at = jax.tree.map(lambda s, k: s + 0.1 * scale * k, at, rate)
    return np.array(rows)


def test_the_motion_is_the_same() -> None:
    signature, parameters = lanes_of(ODD, {"drag": 0.2, "stiffness": 4.0, "v": np.array([3.0, 0.5])})
    expected = _looks(WholeMotion(signature, parameters), 0.5)
    assert np.allclose(_looks(reduced_motion_of(signature)(parameters), 0.5), expected, rtol=1e-12, atol=1e-15)


def test_a_state_that_is_wanted_is_integrated_or_follows() -> None:
    signature, parameters = lanes_of(
        ODD, {"drag": 0.2, "stiffness": 4.0, "v": np.array([3.0, 0.5])}, Options(outputs=StateOutputs())
    )
    parameters = [*parameters, 0.0, 9.0, np.inf, np.inf]
    motion = reduced_motion_of(signature)(parameters)
    # x as well; ẋ and ẏ follow from one integral, and the spin stays.
    assert len(motion.initial().state) == 4
    whole = WholeMotion(signature, parameters)
    assert np.allclose(np.array(motion.outputs(motion.initial())), np.array(whole.outputs(whole.initial())), rtol=1e-15)


def test_a_problem_that_depends_on_time_has_time_as_an_unknown() -> None:
    driven = Problem(0.5, lambda t, y, args: jnp.cos(t) * args, {"end": Event(lambda t, y, args: y - 1)})
    signature, parameters = lanes_of(driven, 2.0, Options(outputs=StateOutputs()))
    motion = reduced_motion_of(signature)([*parameters, 0.7, 9.0, np.inf, np.inf])
    at = motion.initial()
    assert list(at.state) == [0.0, 0.5]
    assert motion.rate(at).state == (1.0, pytest.approx(2 * np.cos(0.7)))


def _odometer(args):
    return {"a": 1e6, "y": 0.0, "vx": jnp.cos(args["alpha"]), "vy": jnp.sin(args["alpha"])}


def _odometer_rate(t, y, args):
    force = -y["y"]
    moved = 0 * y["a"]
    return {"a": y["vy"], "y": 1.0 * y["vy"], "vx": force + moved, "vy": 2.0 * force}


@pytest.mark.parametrize("alpha", [1e-8, 1e-4, 0.1])
def test_a_part_that_starts_far_from_zero_costs_no_digits(alpha):
    """`a` moves as y does: y = (sin α/ω) sin ωt for ω² = 2, and ẋ changes by half of what ẏ does."""
    problem = Problem(
        _odometer,
        _odometer_rate,
        {"rebound": Event(lambda t, y, args: y["y"], -1)},
        {"volume": lambda t, y, args: y["y"] * y["vx"]},
        time_scale=lambda args: 1.0,
    )
    _, results = ended(problem, {"alpha": alpha})
    exact = np.sin(alpha) * (np.cos(alpha) - np.sin(alpha) / 2)
    assert np.isclose(results.outputs.value[0][0], exact, rtol=1e-9, atol=0)


PLOUGHING = Problem(
    lambda args: {"x": 0.0, "u": 1.0},
    lambda t, y, args: {"x": y["u"], "u": -y["u"]},
    {"rest": Event(lambda t, y, args: y["u"] - args, -1)},
    {"volume": lambda t, y, args: y["u"] + 1e-3 * y["x"]},
    time_scale=lambda args: 1.0,
)
"""Linear drag until hardly anything of the speed is left: t = ln(1/args)."""


@pytest.mark.parametrize("left", [1e-2, 1e-8])
def test_a_part_that_relaxes_keeps_its_digits(left):
    _, results = ended(PLOUGHING, left)
    assert np.isclose(results.time.value[0], np.log(1 / left), rtol=1e-9)


def test_nothing_left_to_integrate():
    resting = Problem(
        lambda args: {"x": 0.0, "u": 1.0},
        lambda t, y, args: {"x": y["u"], "u": 0.0},
        {"rest": Event(lambda t, y, args: -args + 0 * y["u"], -1)},
        {"volume": lambda t, y, args: y["u"]},
        time_scale=lambda args: 1.0,
    )
    assert unknowns(resting, 0.5) == 0
    ended_by, results = ended(resting, 0.5, (0,))
    assert (ended_by, results.outputs.value[0][0]) == ("start", 0.0)


def test_a_chain_keeps_the_whole_state() -> None:
    bouncing = Problem(
        lambda args: {"x": 0.0, "y": 1.0, "u": 0.0},
        lambda t, y, args: {"x": 1.0, "y": y["u"], "u": -args},
        {"bounce": Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {**y, "u": -0.5 * y["u"]})},
    )
    signature, parameters = lanes_of(bouncing, 9.81, Options(arm_on_return=True, outputs=StateOutputs()))
    motion = reduced_motion_of(signature)([*parameters, 0.0, 9.0, np.inf, np.inf])
    assert isinstance(motion, WholeMotion)
    at = motion.initial()._replace(state=(-3.0, 0.25, 0.0))
    assert motion.after(0, at).state == (1.5, 0.25, 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_argument_that_is_not_finite_fails_whether_it_matters_or_not(bad):
    args = {"drag": 0.2, "stiffness": 4.0, "unused": bad, "v": np.array([3.0, 0.5])}
    ended_by, results = ended(ODD, args)
    assert ended_by == "failed"
    assert np.isnan(results.outputs.value[0][0])


def test_a_state_at_rest_stays_where_it_is():
    rest = Problem(
        lambda args: {"x": args}, lambda t, y, args: {"x": 0.0}, {"late": Event(lambda t, y, args: y["x"] - 2, 1)}
    )
    end = solve(rest, np.array([1.0, 3.0]), t1=5.0, wrt="")
    np.testing.assert_array_equal([end.t, end.y["x"], end.along("").y["x"]], [[5.0, 5.0], [1.0, 3.0], [1.0, 1.0]])


GRID = np.linspace(0.1, 1.5, 40)
PLACES = np.array([0.3, 0.7000123, 1.2])


@dataclasses.dataclass(frozen=True)
class Broken:
    """sin x, and from each case's place on cos x / 2; in a band beside it the lanes fail."""

    outcome_changes: bool  # else only the time changes
    band: float = 0.0

    def __call__(self, case: np.ndarray, at: np.ndarray) -> Nodes:
        after, failed = self._after(case, at)
        value, slope, curve = (
            np.where(failed, np.nan, np.where(after, above, below))
            for below, above in (
                (np.sin(at), np.cos(at) / 2),
                (np.cos(at), -np.sin(at) / 2),
                (-np.sin(at), -np.cos(at) / 2),
            )
        )
        outcomes, times, _ = self.outcomes(case, at)
        return Nodes(case, at, value, slope, curve, times, outcomes)

    def outcomes(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        after, failed = self._after(case, at)
        codes = np.where(failed, 2, (after & self.outcome_changes).astype(int))
        times = np.where(failed, np.nan, np.where(after, 1.0, 2.0) + at / 10)
        return codes, times, np.where(failed, np.nan, np.where(after, np.cos(at) / 2, np.sin(at)))

    def _after(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        beyond = at - PLACES[case]
        return beyond > 0, np.abs(beyond - self.band) < self.band


def _scan(function: Broken) -> Scan:
    return scan(function, function, PLACES.size, GRID, Ruler(1.0))


@pytest.mark.parametrize("outcome_changes", [True, False])
def test_a_jump_is_bracketed_whether_or_not_the_outcome_changes(outcome_changes: bool) -> None:
    scanned = _scan(Broken(outcome_changes))
    assert not scanned.unresolved.any()
    jumps = scanned.narrow.middle[is_jump(scanned.narrow, scanned.size[scanned.narrow.low.case])]
    # Bracketed to 1e-11, of which the middle is at most half off; and rounding.
    assert np.sort(jumps) == pytest.approx(PLACES, abs=6e-12)
    # All the rest is smooth.
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert covered == pytest.approx(np.full(3, np.ptp(GRID)), abs=1e-7)


def test_failed_lanes_are_counted_and_hide_only_their_neighbours() -> None:
    scanned = _scan(Broken(outcome_changes=True, band=1e-4))
    assert np.all(scanned.unresolved > 0)
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert np.all(covered > np.ptp(GRID) - 1e-3)


def test_a_change_of_outcome_that_a_tighter_tolerance_does_not_confirm_is_kept_and_counted() -> None:
    scanned = scan(Broken(outcome_changes=True), Broken(outcome_changes=False), PLACES.size, GRID, Ruler(1.0))
    assert np.array_equal(scanned.unresolved, [1, 1, 1])
    changes = scanned.narrow.outcome_changes
    assert np.sort(scanned.narrow.middle[changes]) == pytest.approx(PLACES, abs=3e-8)


@pytest.mark.parametrize(("moves", "affine"), [([True, False], True), ([True, True], False)])
def test_a_choice_by_what_does_not_move_is_affine(moves, affine):
    jaxpr = jax.make_jaxpr(lambda x, mode: jnp.where(mode > 0.5, 3.0 - x, x - 3.0))(1.0, 1.0).jaxpr
    assert are_affine(jaxpr, moves) == [affine]
