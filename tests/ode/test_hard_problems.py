"""Small problems on which an integrator with events easily errs without a word, each with its closed form.

A test with a mark states what a user may rely on and does not have today; its mark goes with the mend.
"""

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from erosion import ode
from erosion.lanes.lanewise import Lanewise, number

CLOSE: dict[str, Any] = {"rtol": 1e-7, "atol": 1e-10}


def fault(reason: str) -> pytest.MarkDecorator:
    """A test that fails today."""
    return pytest.mark.xfail(strict=True, reason=reason)


def silently_wrong(end: ode.Solution, found: Any, exact: Any, tolerance: float = 1e-6) -> np.ndarray:
    """Lanes that end as if all were well, with another number than the exact one."""
    honest = np.isin(end.ended_by, ("failed", "unfinished")) | np.asarray(end.inexact)
    return ~honest & ~(np.abs(np.asarray(found) - exact) <= tolerance)


def growth(rate: Any, events: Any = None, y0: Any = 0.0, **more: Any) -> ode.Problem:
    """u′ = rate(t, u, args)."""
    return ode.Problem({"u": y0}, lambda t, y, args: {"u": rate(t, y["u"], args)}, events or {}, **more)


# Events whose functions move faster than the state.
OSCILLATOR = ({"x": 1.0, "v": 0.0}, lambda t, y, args: {"x": y["v"], "v": -y["x"]})


def crossings(direction: int, phase0: Any, w: Any, n: Any) -> Any:
    """When sin(w t + phase0) passes 0.8 for the n-th time."""
    up = np.arcsin(0.8)
    at = {1: [up], -1: [np.pi - up], 0: [up, np.pi - up]}[direction]
    turns = 2 * np.pi * np.arange(-20, 200)[:, None]
    phases = np.sort(np.ravel(np.asarray(at) + turns))[:, None]
    times = (phases - phase0) / w
    return np.sort(np.where(times > 0, times, np.inf), axis=0)[n - 1]


@pytest.mark.parametrize("direction", [-1, 1, 0])
def test_a_fast_event_function_is_not_missed(direction):
    fast = ode.Event(lambda t, y, args: jnp.sin(args["w"] * t - args["s"]) - 0.8, direction)
    rng = np.random.default_rng(0)
    w, s = rng.uniform(8, 15, 400), rng.uniform(30, 60, 400)
    end = ode.solve(ode.Problem(*OSCILLATOR, {"fast": fast}), {"w": w, "s": s}, t1=40.0)
    assert not silently_wrong(end, end.t, crossings(direction, -s, w, 1)).any()


@pytest.mark.parametrize("direction", [-1, 1, 0])
def test_no_event_of_a_fast_chain_is_missed(direction):
    fast = ode.Event(lambda t, y, args: jnp.sin(args["w"] * t - 0.2) - 0.8, direction, lambda t, y, args: y)
    w = np.linspace(1.0, 15.0, 200)
    end = ode.solve(ode.Problem(*OSCILLATOR, {"fast": fast}), {"w": w}, t1=20.0)
    times = np.stack([crossings(direction, -0.2, w, n) for n in range(1, 110)])
    np.testing.assert_array_equal(end.count, np.sum(times < 20.0, axis=0))


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_fast_part_of_the_state_is_not_missed(direction):
    """The event sees the sine of a phase that is itself a state."""
    phase = ode.Problem(
        {"p": 0.0, "x": 1.0},
        lambda t, y, args: {"p": args["w"], "x": -1e-3 * y["x"]},
        {"fast": ode.Event(lambda t, y, args: jnp.sin(y["p"] - args["s"]) - 0.8, direction)},
    )
    rng = np.random.default_rng(1)
    w, s = rng.uniform(8, 15, 400), rng.uniform(30, 60, 400)
    end = ode.solve(phase, {"w": w, "s": s}, t1=40.0)
    assert not silently_wrong(end, end.t, crossings(direction, -s, w, 1)).any()


# Events at once.
TIMES = ("ta", "tb")


def doses(after_a: Any, after_b: Any) -> ode.Problem:
    """u′ = -u and w′ = -w from 1; one event at ta, another at tb."""
    return ode.Problem(
        {"u": 1.0, "w": 1.0},
        lambda t, y, args: {"u": -y["u"], "w": -y["w"]},
        {
            "a": ode.Event(lambda t, y, args: t - args["ta"], 1, lambda t, y, args: y | after_a(y)),
            "b": ode.Event(lambda t, y, args: t - args["tb"], 1, lambda t, y, args: y | after_b(y)),
        },
    )


TWO_DOSES = doses(lambda y: {"u": y["u"] + 1}, lambda y: {"w": y["w"] + 1})


@pytest.mark.parametrize("apart", [0.0, 1e-13, -1e-13])
def test_events_at_once_keep_the_derivatives_of_their_own_times(apart):
    end = ode.solve(TWO_DOSES, {"ta": 1.0, "tb": 1.0 + apart}, t1=2.0, wrt=TIMES, derivatives=2)
    first = {(name, part): end.along(name).y[part] for name in TIMES for part in "uw"}
    exact = {("ta", "u"): np.exp(-1), ("ta", "w"): 0.0, ("tb", "u"): 0.0, ("tb", "w"): np.exp(-1)}
    assert first == pytest.approx(exact, rel=1e-7, abs=1e-9)
    second = {(one, other, part): end.along(one, other).y[part] for one in TIMES for other in TIMES for part in "uw"}
    exact = {key: np.exp(-1) if key in {("ta", "ta", "u"), ("tb", "tb", "w")} else 0.0 for key in second}
    assert second == pytest.approx(exact, rel=1e-5, abs=1e-7)


def test_events_at_once_have_a_gradient():
    found = ode.solve(TWO_DOSES, {"ta": 1.0, "tb": 1.0}, t1=2.0).gradient(y={"u": 1.0, "w": 10.0})
    assert (found["ta"], found["tb"]) == pytest.approx((np.exp(-1), 10 * np.exp(-1)), rel=1e-7)


def test_jax_knows_the_derivatives_of_events_at_once():
    found = jax.jit(jax.jacfwd(lambda args: ode.solve(TWO_DOSES, args, t1=2.0).y))({"ta": 1.0, "tb": 1.0})
    np.testing.assert_allclose([found["u"]["ta"], found["w"]["tb"]], np.exp(-1), **CLOSE)
    np.testing.assert_allclose([found["u"]["tb"], found["w"]["ta"]], 0.0, **CLOSE)


def test_an_event_at_once_happens_if_its_function_still_passes_zero():
    """A floor that is written twice is one bounce: after the first the ball rises."""
    bounce = ode.Event(lambda t, y, args: y["x"], -1, lambda t, y, args: y | {"v": -y["v"]})
    again = ode.Event(lambda t, y, args: 2.0 * y["x"], -1, lambda t, y, args: y | {"v": -y["v"]})
    ball = ode.Problem(
        {"x": 1.0, "v": -1.0}, lambda t, y, args: {"x": y["v"], "v": 0.0}, {"floor": bounce, "same": again}
    )
    end = ode.solve(ball, t1=3.0)
    assert (end.count, end.y["x"]) == (1, pytest.approx(2.0))


def test_a_billiard_ball_in_a_corner_has_derivatives():
    """Both walls are hit at t = 1: x = p until 1 - x0, then back."""
    away = lambda name: lambda t, y, args: y | {name: -y[name]}  # noqa: E731
    corner = ode.Problem(
        lambda args: {"x": args["x"], "z": args["z"], "u": args["u"], "w": args["w"]},
        lambda t, y, args: {"x": y["u"], "z": y["w"], "u": 0.0 * y["u"], "w": 0.0 * y["w"]},
        {
            "wall": ode.Event(lambda t, y, args: y["x"] - 1, 1, away("u")),
            "top": ode.Event(lambda t, y, args: y["z"] - 1, 1, away("w")),
        },
    )
    args = {"x": 0.5, "z": 0.25, "u": 0.5, "w": 0.75}
    end = ode.solve(corner, args, t1=1.5, wrt=tuple(args))
    assert (end.count, end.y["x"], end.y["z"]) == (2, pytest.approx(0.75), pytest.approx(0.625))
    exact = {("x", "x"): -1.0, ("u", "x"): -1.5, ("z", "z"): -1.0, ("w", "z"): -1.5}  # x = 2 - x0 - u t
    for name in args:
        for part in "xz":
            assert end.along(name).y[part] == pytest.approx(exact.get((name, part), 0.0), abs=1e-8)


def test_events_at_once_whose_order_matters_have_no_derivative():
    """Doubling before adding gives 2 e⁻¹ + 1, after it 2 e⁻¹ + 2."""
    either = doses(lambda y: {"u": 2 * y["u"]}, lambda y: {"u": y["u"] + 1})
    end = ode.solve(either, {"ta": 1.0, "tb": 1.0}, t1=2.0, wrt=TIMES)
    assert end.y["u"] == pytest.approx((2 * np.exp(-1) + 1) * np.exp(-1), rel=1e-8)
    assert np.isnan(end.along("ta").y["u"])
    assert np.isnan(end.along("tb").y["u"])
    assert end.warnings


def beside_a_break(reset: Any) -> ode.Problem:
    """The rate of z breaks at b; x = t reaches c."""
    return ode.Problem(
        {"x": 0.0, "z": 0.0},
        lambda t, y, args: {"x": 1.0, "z": jnp.where(t < args["b"], 1.0, 2.0)},
        {"c": ode.Event(lambda t, y, args: y["x"] - args["c"], 1, reset)},
    )


def test_a_break_and_a_reset_at_once_keep_their_own_times():
    """z = b + 2 (5 - b) + 3 c."""
    problem = beside_a_break(lambda t, y, args: y | {"z": y["z"] + 3 * args["c"]})
    end = ode.solve(problem, {"b": 1.0, "c": 1.0}, t1=5.0, wrt=("b", "c"), derivatives=2)
    assert end.y["z"] == pytest.approx(12.0)
    assert (end.along("b").y["z"], end.along("c").y["z"]) == pytest.approx((-1.0, 3.0))
    seconds = [end.along(*pair).y["z"] for pair in (("b", "b"), ("b", "c"), ("c", "c"))]
    assert seconds == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_break_by_chance_at_the_event_that_ends_a_lane_leaves_no_derivatives():
    """∂z/∂c is 1 before the break, and 2 after it."""
    args = {"b": 1.0, "c": 1.0 + np.array([-1e-9, 0.0, 1e-9])}
    end = ode.solve(beside_a_break(None), args, t1=5.0, wrt=("b", "c"), derivatives=2)
    np.testing.assert_allclose(end.t, args["c"])
    np.testing.assert_allclose(end.along("c").y["z"], [1.0, np.nan, 2.0])
    np.testing.assert_allclose(end.along("b").y["z"], [0.0, np.nan, -1.0], atol=1e-12)


def test_a_break_of_the_function_that_ends_a_lane_counts_on_its_side():
    """v′ = -b sign(v) ends at v = 0, t = v₀/b, x = v₀²/2b."""
    stop = ode.Problem(
        lambda args: {"x": 0.0, "v": args["v"]},
        lambda t, y, args: {"x": y["v"], "v": -args["b"] * jnp.sign(y["v"])},
        {"stop": ode.Event(lambda t, y, args: y["v"], -1)},
    )
    end = ode.solve(stop, {"v": 3.0, "b": 2.0}, t1=5.0, wrt=("v", "b"), derivatives=2)
    found = [end.along(*names).y["x"] for names in (("v",), ("b",), ("v", "v"), ("v", "b"), ("b", "b"))]
    assert found == pytest.approx([1.5, -1.125, 0.5, -0.75, 1.125], rel=1e-7)


def test_a_power_that_is_guarded_at_its_event_has_derivatives():
    def fall(guarded: Any) -> ode.Problem:
        return ode.Problem(
            lambda args: {"y": 0.3, "v": args["v"]},
            lambda t, y, args: {"y": y["v"], "v": -args["g"] - guarded(y["y"])},
            {"ground": ode.Event(lambda t, y, args: y["y"], -1)},
        )

    args = {"v": np.linspace(0.3, 2.0, 40), "g": np.linspace(2.0, 0.5, 40)}
    plain, *others = (
        ode.solve(fall(each), args, t1=50.0, wrt="v", derivatives=2)
        for each in (
            lambda y: y**1.5,
            lambda y: jnp.maximum(y, 0.0) ** 1.5,
            lambda y: jnp.where(y > 0, y**1.5, 0.0),
        )
    )
    for other in others:
        for names in ((), ("v",), ("v", "v")):
            one, two = (end.along(*names).t if names else end.t for end in (plain, other))
            np.testing.assert_allclose(two, one, rtol=1e-6)


# Resets that make other events happen.
NEVER = 1e9


def test_an_event_between_two_at_once_whose_order_matters_has_no_derivative():
    """The first and the third have the same time; the second may be before both or after them."""
    add = lambda amount: lambda t, y, args: {"u": y["u"] + amount}  # noqa: E731
    three = growth(
        lambda t, u, args: -u,
        {
            "first": ode.Event(lambda t, y, args: t - args["ta"], 1, add(1.0)),
            "second": ode.Event(lambda t, y, args: t - args["tb"], 1, lambda t, y, args: {"u": 2 * y["u"]}),
            "third": ode.Event(lambda t, y, args: t - args["ta"], 1, add(3.0)),
        },
        y0=1.0,
    )
    end = ode.solve(three, {"ta": 1.0, "tb": 1.0}, t1=2.0, wrt=TIMES)
    assert end.y["u"] == pytest.approx((2 * (np.exp(-1) + 1) + 3) * np.exp(-1), rel=1e-8)
    assert all(np.isnan(end.along(name).y["u"]) for name in TIMES)
    apart = ode.solve(three, {"ta": 1.0, "tb": 1.5}, t1=2.0, wrt=TIMES)
    assert apart.along("tb").y["u"] == pytest.approx(0.0, abs=1e-9)


def test_a_reset_takes_another_event_through_zero():
    """A concentration falls from 1 to e⁻¹ in 5; a dose of 1 takes it above 0.9."""
    dosed = growth(
        lambda t, u, args: -0.2 * u,
        {
            "dose": ode.Event(lambda t, y, args: t - 5.0, 1, lambda t, y, args: {"u": y["u"] + 1}),
            "high": ode.Event(lambda t, y, args: y["u"] - 0.9, 1),
        },
        y0=1.0,
    )
    end = ode.solve(dosed, t1=10.0)
    assert (end.ended_by, end.count) == ("high", 2)
    assert (end.t, end.y["u"]) == (pytest.approx(5.0), pytest.approx(np.exp(-1) + 1))


@pytest.mark.parametrize("rest", [0.0, 0.25])
def test_a_neuron_may_rest_for_any_time(rest):
    """v′ = 1 up to 1; then it rests, and starts again from 0."""
    neuron = ode.Problem(
        {"v": 0.0, "on": 1.0, "until": NEVER},
        lambda t, y, args: {"v": y["on"], "on": 0.0 * y["on"], "until": 0.0 * y["until"]},
        {
            "spike": ode.Event(
                lambda t, y, args: y["v"] - 1, 1, lambda t, y, args: {"v": 0.0, "on": 0.0, "until": t + args["rest"]}
            ),
            "again": ode.Event(
                lambda t, y, args: t - y["until"], 1, lambda t, y, args: y | {"on": 1.0, "until": NEVER}
            ),
        },
    )
    end = ode.solve(neuron, {"rest": rest}, t1=5.5 + 5 * rest)
    assert (end.ended_by, end.count) == ("t1", 10)
    assert end.y["v"] == pytest.approx(0.5, rel=1e-8)


def test_an_event_at_the_start_has_derivatives():
    """u(1) = a - 2 a b + 1: the reset takes 2 a b from a, which is above 1."""
    overfull = ode.Problem(
        lambda args: {"u": args["a"]},
        lambda t, y, args: {"u": 1.0 + 0 * y["u"]},
        {"full": ode.Event(lambda t, y, args: y["u"] - 1, 1, lambda t, y, args: {"u": y["u"] * (1 - 2 * args["b"])})},
    )
    end = ode.solve(overfull, {"a": 1.5, "b": 1.0}, t1=1.0, start="fire", wrt=("a", "b"), derivatives=2)
    assert (end.count, end.y["u"]) == (1, pytest.approx(-0.5))
    assert [end.along(name).y["u"] for name in ("a", "b")] == pytest.approx([-1.0, -3.0])
    assert end.along("a", "b").y["u"] == pytest.approx(-2.0)
    found = ode.solve(overfull, {"a": 1.5, "b": 1.0}, t1=1.0, start="fire").gradient(y={"u": 1.0})
    assert (found["a"], found["b"]) == pytest.approx((-1.0, -3.0))


def test_a_reset_that_meets_another_event_has_derivatives_unless_it_meets_its_edge():
    """A dose of d at 5 takes u to e⁻¹ + d; where that is above the limit, half of it is lost at once."""
    dosed = growth(
        lambda t, u, args: -0.2 * u,
        {
            "dose": ode.Event(lambda t, y, args: t - 5.0, 1, lambda t, y, args: {"u": y["u"] + args["d"]}),
            "high": ode.Event(lambda t, y, args: y["u"] - args["limit"], 1, lambda t, y, args: {"u": y["u"] / 2}),
        },
        y0=1.0,
    )
    end = ode.solve(dosed, {"d": 1.0, "limit": 1.1}, t1=10.0, wrt=("d", "limit"))
    assert (end.count, end.y["u"]) == (2, pytest.approx((np.exp(-1) + 1) / 2 * np.exp(-1), rel=1e-8))
    assert end.along("d").y["u"] == pytest.approx(np.exp(-1) / 2, rel=1e-7)
    assert end.along("limit").y["u"] == 0
    assert ode.solve(dosed, {"d": 1.0, "limit": 1.1}, t1=10.0).gradient(y={"u": 1.0})["d"] == pytest.approx(
        np.exp(-1) / 2, rel=1e-7
    )


def test_events_without_end_are_an_outcome():
    endless = growth(
        lambda t, u, args: 1.0 + 0 * u,
        {
            "up": ode.Event(lambda t, y, args: y["u"] - 1, 1, lambda t, y, args: {"u": 0.0 * y["u"] - 1}),
            "down": ode.Event(lambda t, y, args: y["u"], -1, lambda t, y, args: {"u": 0.0 * y["u"] + 2}),
        },
    )
    end = ode.solve(endless, t1=5.0)
    assert (end.ended_by, end.t) == ("unfinished", pytest.approx(1.0))


# Rates that break.
KNOTS = np.array([0.0, 1.0, 1.005, 1.01, 3.0])


def relaxed(breaks: Any, *, y0: float = 1.0, t1: float = 2.0) -> float:
    """u(t1) of u′ = -u + forcing; the forcing is c0 + c1 (t - start) on each interval (start, stop, c0, c1)."""

    def part(start: float, stop: float, c0: float, c1: float) -> float:
        whole = lambda s: (c0 + c1 * (s - start) - c1) * np.exp(s - t1)  # noqa: E731
        return whole(stop) - whole(start)

    return y0 * np.exp(-t1) + sum(part(*one) for one in breaks)


SAWTOOTH = [(float(i), min(i + 1.0, 5.5), 0.0, 1.0) for i in range(6)]
STAIRS = [(float(i), min(i + 1.0, 5.5), float(i), 0.0) for i in range(6)]
PULSES = [(float(i), i + 0.01, 100.0, 0.0) for i in range(6)]
TENT = [(1.0, 1.005, 0.0, 2e4), (1.005, 1.01, 100.0, -2e4)]


@pytest.mark.parametrize(
    ("forcing", "exact", "t1"),
    [
        pytest.param(
            lambda t: 100.0 * ((t > 1) & (t < 1.01)),
            relaxed([(1.0, 1.01, 100.0, 0.0)]),
            2.0,
            id="pulse",
        ),
        pytest.param(
            lambda t: jnp.interp(t, KNOTS, jnp.array([0.0, 0.0, 100.0, 0.0, 0.0])),
            relaxed(TENT),
            2.0,
            id="table",
        ),
        pytest.param(
            lambda t: 100.0 * (jnp.mod(t, 1.0) < 0.01),
            relaxed(PULSES, t1=5.5),
            5.5,
            id="pulses",
        ),
        pytest.param(lambda t: jnp.mod(t, 1.0), relaxed(SAWTOOTH, t1=5.5), 5.5, id="sawtooth"),
        pytest.param(jnp.floor, relaxed(STAIRS, t1=5.5), 5.5, id="stairs"),
    ],
)
def test_no_break_in_time_is_missed(forcing, exact, t1):
    end = ode.solve(growth(lambda t, u, args: -u + forcing(t), y0=1.0), t1=t1)
    assert end.ended_by == "t1"
    assert end.y["u"] == pytest.approx(exact, rel=1e-7)


def test_the_time_of_a_break_has_derivatives():
    """u = t until a, then a exp(a - t)."""
    end = ode.solve(growth(lambda t, u, args: jnp.where(t < args["a"], 1.0, -u)), {"a": 1.0}, t1=2.0, wrt="a")
    assert end.y["u"] == pytest.approx(np.exp(-1), rel=1e-8)
    assert end.along("a").y["u"] == pytest.approx(2 * np.exp(-1), rel=1e-7)


def test_dry_friction_sticks():
    """v rests at 0 from t = 1 until the drive exceeds the friction at 1.05."""
    end = ode.solve(growth(lambda t, u, args: 10 * (t - 1) - 0.5 * jnp.sign(u), y0=5.5), t1=2.0)
    assert not silently_wrong(end, end.y["u"], 4.5125)


def test_sliding_is_an_outcome():
    end = ode.solve(growth(lambda t, u, args: jnp.where(u > 0.5, -1.0, 1.0)), t1=2.0)
    assert end.trials < 2000
    assert not silently_wrong(end, end.y["u"], 0.5)


@pytest.mark.parametrize("drive", [0.0, 0.3, -0.4])
def test_a_body_at_rest_that_friction_holds_is_an_outcome(drive):
    end = ode.solve(growth(lambda t, u, args: args - 0.5 * jnp.sign(u)), drive, t1=2.0)
    assert (end.ended_by, end.t, end.y["u"]) == ("unfinished", 0.0, 0.0)
    assert "both sides" in end.warnings[0]


def test_a_body_at_rest_starts_where_its_drive_is_greater_than_friction():
    end = ode.solve(growth(lambda t, u, args: args - 0.5 * jnp.sign(u)), np.array([0.75, -0.75]), t1=2.0)
    np.testing.assert_allclose(end.y["u"], [0.5, -0.5], **CLOSE)


def test_a_motion_leaves_a_switch_on_which_its_rate_is_zero():
    """From u = 1/2 the rate is zero on both sides at first: u = 1/2 - t²."""
    end = ode.solve(growth(lambda t, u, args: jnp.where(u >= 0.5, -t, -2 * t), y0=0.5), t1=1.0)
    assert (end.ended_by, end.y["u"]) == ("t1", pytest.approx(-0.5, rel=1e-9))


def test_a_reset_may_put_a_body_at_rest_on_a_switch():
    """It falls from there by the rate beyond: x = -(t - 1)²."""
    drop = ode.Problem(
        {"x": 1.0, "v": 0.0},
        lambda t, y, args: {"x": y["v"], "v": jnp.where(y["x"] >= 0, -1.0, -2.0)},
        {"put": ode.Event(lambda t, y, args: t - 1.0, 1, lambda t, y, args: {"x": 0 * t, "v": 0 * t})},
    )
    assert ode.solve(drop, t1=2.0).y["x"] == pytest.approx(-1.0, rel=1e-8)


def test_a_motion_that_leaves_a_switch_as_a_high_power_is_right_or_given_up():
    """u = 1/2 - 2 t³/3."""
    end = ode.solve(growth(lambda t, u, args: jnp.where(u >= 0.5, -(t**2), -2 * t**2), y0=0.5), t1=1.0)
    assert not silently_wrong(end, end.y["u"], 0.5 - 2 / 3)


@pytest.mark.parametrize(("pulses", "limit"), [(10, {}), (40, {}), (40, {"max_step": 0.002}), (40, {"smooth": True})])
def test_more_switches_than_are_located_are_a_warning(pulses, limit):
    centres = np.linspace(1, 2, pulses)
    push = lambda t: sum(jnp.where(jnp.abs(t - centre) < 0.01, 1.0, 0.0) for centre in centres)  # noqa: E731
    end = ode.solve(growth(lambda t, u, args: -u + push(t)), t1=3.0, **limit)
    assert any("switches" in warning for warning in end.warnings) == (pulses == 40 and not limit)


def within_a_loop(t, start, stop):
    """1 between two times; no switch that is located."""
    return jax.lax.fori_loop(0, 1, lambda i, so_far: so_far + jnp.where((t >= start) & (t < stop), 1.0, 0.0), 0 * t)


PULSE = dataclasses.replace(
    growth(lambda t, u, args: -u + 100 * within_a_loop(t, args["a"], args["b"]), y0=1.0),
    breaks=lambda args: jnp.stack([args["b"], jnp.inf, args["a"]]),
)


def test_a_break_within_a_loop_is_a_warning():
    end = ode.solve(dataclasses.replace(PULSE, breaks=None), {"a": 1.0, "b": 1.01}, t1=2.0)
    assert any("`Problem.breaks`" in warning for warning in end.warnings)
    smooth_loop = growth(lambda t, u, args: jax.lax.fori_loop(0, 3, lambda i, s: s * jnp.cos(u), -u), y0=1.0)
    assert not ode.solve(smooth_loop, t1=2.0).warnings


LEVELS = np.array([1.0, *[2.0] * 8])


@pytest.mark.parametrize(
    "index",
    [
        lambda u: u.astype(int),
        lambda u: jnp.argmax(jnp.stack([1 + 0 * u, u])),
        lambda u: jax.lax.cond(u == 7.0, lambda u: 3, lambda u: u.astype(int), u),
    ],
)
def test_derivatives_across_a_whole_number_within_a_loop_are_refused(index):
    climb = growth(lambda t, u, args: jax.lax.fori_loop(0, 1, lambda i, s: s + jnp.array(LEVELS)[index(u)], 0 * u))
    climb = dataclasses.replace(climb, y0=lambda args: {"u": args["u0"]})
    with pytest.raises(ValueError, match="loop"):
        ode.solve(climb, {"u0": 0.2}, t1=1.5, wrt="u0")
    assert any("loop" in warning for warning in ode.solve(climb, {"u0": 0.2}, t1=1.5).warnings)
    end = ode.solve(climb, {"u0": 0.2}, t1=1.5, gradient=True)
    assert any("no gradient" in warning for warning in end.warnings)
    assert not any("one integration" in warning for warning in end.warnings)
    with pytest.raises(ValueError, match="loop"):
        end.gradient(y={"u": 1.0})


@pytest.mark.parametrize("smooth", [None, True])
@pytest.mark.parametrize("t0", [0.0, 100.0])
def test_breaks_by_hand_are_met_and_have_derivatives(smooth, t0):
    args = {"a": t0 + 1.0, "b": t0 + np.array([1.01, 1.5])}
    end = ode.solve(PULSE, args, t0=t0, t1=t0 + 2, wrt=("a", "b"), derivatives=2, smooth=smooth)
    rise, fall = np.exp(-1), np.exp(args["b"] - t0 - 2)
    np.testing.assert_allclose(end.y["u"], np.exp(-2) + 100 * (fall - rise), rtol=1e-9)
    exact = {("a",): -100 * rise, ("b",): 100 * fall, ("a", "a"): -100 * rise, ("b", "b"): 100 * fall, ("a", "b"): 0}
    scale = 1e-6 if t0 else 1e-9
    for names, derivative in exact.items():
        np.testing.assert_allclose(end.along(*names).y["u"], np.broadcast_to(derivative, 2), rtol=scale, atol=scale)


@pytest.mark.parametrize(
    "rate",
    [
        lambda u: jax.lax.fori_loop(0, 1, lambda i, s: s + jnp.where(u > 1, 2.0, 1.0), 0 * u),
        lambda u: sum(jnp.where(u > 1 + 0.01 * i, 2.0, 1.0) for i in range(40)) / 40,
    ],
)
@pytest.mark.parametrize("drive", [0.0, 0.1])
def test_breaks_by_hand_do_not_answer_for_those_of_the_state(rate, drive):
    climb = ode.Problem(
        lambda args: {"u": args["u0"]},
        lambda t, y, args: {"u": rate(y["u"]) + (drive * t if drive else 0.0)},
        breaks=[5.0],
    )
    with pytest.raises(ValueError, match="breaks of time alone"):
        ode.solve(climb, {"u0": 0.2}, t1=1.5, wrt="u0")
    end = ode.solve(climb, {"u0": 0.2}, t1=1.5)
    assert end.ended_by == "t1"
    assert any("not located" in warning for warning in end.warnings)


def test_breaks_by_hand_are_met_back_in_time():
    problem = dataclasses.replace(PULSE, breaks=(1.0, 1.01))
    end = ode.solve(problem, {"a": 1.0, "b": 1.01}, t0=2.0, t1=0.0)
    assert end.y["u"] == pytest.approx((1 - 100 * (np.exp(-0.99) - np.exp(-1))) * np.exp(2), rel=1e-9)


def test_breaks_have_a_gradient():
    found = ode.solve(PULSE, {"a": 1.0, "b": 1.5}, t1=2.0).gradient(y={"u": 1.0})
    assert (found["a"], found["b"]) == pytest.approx((-100 * np.exp(-1), 100 * np.exp(-0.5)), rel=1e-7)


@pytest.mark.parametrize("breaks", ["noon", lambda args: "noon", lambda args: None, lambda args: args["no"]])
def test_breaks_must_be_times(breaks):
    with pytest.raises((TypeError, ValueError), match="breaks"):
        ode.solve(dataclasses.replace(PULSE, breaks=breaks), {"a": 1.0, "b": 1.01}, t1=2.0)


def test_no_peak_of_a_table_is_missed():
    """Shots against each piece of a terrain of 200 pieces, by hand."""
    rng = np.random.default_rng(0)
    x, height = np.linspace(0, 100, 201), rng.uniform(0, 10, 201)
    speed, angle = rng.uniform(3, 28, 4000), rng.uniform(-0.5, 1.4, 4000)
    u, w = speed * np.cos(angle), speed * np.sin(angle)
    shot = ode.Problem(
        lambda args: {"x": 0.0, "y": 11.0, "w": args["w"]},
        lambda t, y, args: {"x": args["u"], "y": y["w"], "w": -9.81},
        {"ground": ode.Event(lambda t, y, args: y["y"] - jnp.interp(y["x"], x, height), -1)},
    )
    rise = np.diff(height) / np.diff(x)
    climb = w[:, None] - rise * u[:, None]
    root = climb**2 + 2 * 9.81 * (11.0 - height[:-1] + rise * x[:-1])
    hit = (climb + np.sqrt(np.maximum(root, 0.0))) / 9.81
    at = u[:, None] * hit
    first = np.min(np.where((root > 0) & (at >= x[:-1]) & (at < x[1:]), hit, np.inf), axis=1)
    end = ode.solve(shot, {"u": u, "w": w}, t1=20.0)
    np.testing.assert_allclose(end.t, np.minimum(first, 20.0), **CLOSE)


# Starts from rest.


@pytest.mark.parametrize(
    ("rate", "exact", "t1"),
    [
        pytest.param(lambda t, u: t**3 - u, 2 + 6 * np.exp(-2), 2.0, id="power"),
        pytest.param(lambda t, u: t**6 - u, 112 - 720 * np.exp(-2), 2.0, id="high power"),
        pytest.param(lambda t, u: jnp.maximum(t - 3, 0.0) - u, 1 + np.exp(-2), 5.0, id="ramp"),
        pytest.param(lambda t, u: jnp.maximum(t - 3, 0.0) ** 2 - u, 2 - 2 * np.exp(-2), 5.0, id="bend"),
        pytest.param(lambda t, u: jnp.where(t > 1, t - 1, 0.0) - u, np.exp(-1), 2.0, id="switched ramp"),
    ],
)
def test_a_motion_starts_from_exact_rest(rate, exact, t1):
    end = ode.solve(growth(lambda t, u, args: rate(t, u)), t1=t1)
    assert end.ended_by == "t1"
    assert end.y["u"] == pytest.approx(exact, rel=1e-7)
    assert end.trials < 1000


@pytest.mark.parametrize("method", ["auto", "rosenbrock"])
def test_a_row_of_rows_leaves_rest_with_derivatives(method):
    """Each moves by the square of the next: a t³/3, a² t⁷/63, a⁴ t¹⁵/59535."""
    rows = ode.Problem(
        {"x": jnp.zeros(3)},
        lambda t, y, args: {"x": jnp.stack([args["a"] * t**2, y["x"][0] ** 2, y["x"][1] ** 2])},
        {"half": ode.Event(lambda t, y, args: y["x"][2] - 2.0**15 / 59535, 1)},
    )
    end = ode.solve(rows, {"a": np.array([1.0, 1.1])}, t1=20.0, method=method, wrt="a")
    np.testing.assert_allclose(end.t, 2 * np.array([1.0, 1.1]) ** (-4 / 15), rtol=1e-8)
    np.testing.assert_allclose(end.along("a").t, -8 / 15 * np.array([1.0, 1.1]) ** (-19 / 15), rtol=1e-6)


@pytest.mark.parametrize("method", ["auto", "rosenbrock"])
def test_growth_from_the_least_number_is_followed(method):
    end = ode.solve(growth(lambda t, u, args: u, y0=1e-300), t1=20.0, method=method)
    assert end.y["u"] == pytest.approx(1e-300 * np.exp(20), rel=1e-8)


def test_a_fast_motion_from_rest_is_stable():
    """u follows sin² k times as fast: in a step of rest's length a part that is so fast must not grow."""
    k = np.array([1e3, 1e7, 1e12])
    end = ode.solve(growth(lambda t, u, args: -args["k"] * (u - jnp.sin(t) ** 2)), {"k": k}, t1=5.0)
    assert set(end.ended_by) == {"t1"}
    np.testing.assert_allclose(end.y["u"], np.sin(5) ** 2 - np.sin(10) / k + 2 * np.cos(10) / k**2, rtol=1e-8)


# Event functions that are not smooth.


@pytest.mark.parametrize(
    ("function", "u0", "exact"),
    [
        pytest.param(lambda t, u: jnp.where(t < 3.3, -1.0, 1.0), 0.0, 3.3, id="step of time"),
        pytest.param(lambda t, u: jnp.where(u < 1.5, -1.0, 1.0), 0.0, 1.5, id="step of state"),
        pytest.param(lambda t, u: jnp.maximum(u, 0.0), -1.0, 1.0, id="clipped"),
        pytest.param(lambda t, u: jnp.sqrt(u**2), -1.0, 1.0, id="size"),
        pytest.param(lambda t, u: jnp.sqrt(u**2) - 0.5, 0.0, 0.5, id="size from zero"),
        pytest.param(lambda t, u: jnp.linalg.norm(jnp.stack([3 * u, 4 * u])) - 5.0, 0.0, 1.0, id="norm"),
    ],
)
def test_an_event_function_without_a_slope_is_located_or_refused(function, u0, exact):
    problem = growth(lambda t, u, args: 1.0 + 0 * u, {"e": ode.Event(lambda t, y, args: function(t, y["u"]))}, y0=u0)
    try:
        end = ode.solve(problem, t1=5.0)
    except ValueError as error:
        assert "events['e']" in str(error)  # noqa: PT017
    else:
        assert (end.ended_by, end.t) == ("e", pytest.approx(exact, rel=1e-9))


# Verification.
def kepler() -> ode.Problem:
    """From the pericentre, with one unit of the half axis; the n-th passage there is at 2 π n."""

    def rates(t, y, args):
        cube = (y["x"] ** 2 + y["y"] ** 2) ** 1.5
        return {"x": y["u"], "y": y["v"], "u": -y["x"] / cube, "v": -y["y"] / cube}

    return ode.Problem(
        lambda args: {"x": 1 - args["e"], "y": 0.0, "u": 0.0, "v": jnp.sqrt((1 + args["e"]) / (1 - args["e"]))},
        rates,
        {"node": ode.Event(lambda t, y, args: y["y"], 1, lambda t, y, args: y)},
    )


def test_the_derivatives_of_a_chain_are_verified():
    e = np.linspace(0.98, 0.995, 12)
    end = ode.solve(kepler(), {"e": e}, t1=100.0, max_events=10, wrt="e", smooth=True)
    np.testing.assert_allclose(end.t, 20 * np.pi, rtol=1e-7)
    assert not silently_wrong(end, end.along("e").t, 0.0, 1e-7 * 20 * np.pi).any()


CUBES = {
    "power": lambda x, y: (x**2 + y**2) ** 1.5,
    "sqrt": lambda x, y: jnp.sqrt(x**2 + y**2) ** 3,
    "norm": lambda x, y: jnp.linalg.norm(jnp.stack([x, y])) ** 3,
    "where": lambda x, y: jnp.where(x**2 + y**2 > 0, jnp.abs(x**2 + y**2), 1.0) ** 1.5,
}


def test_a_motion_that_stays_away_from_kinks_is_as_cheap_as_a_smooth_one():
    def orbit(cube: Any, smooth: bool | None = None) -> ode.Solution:
        problem = dataclasses.replace(
            kepler(), vector_field=lambda t, y, args: {"x": y["u"], "y": y["v"]} | {
                speed: -y[place] / cube(y["x"], y["y"]) for speed, place in (("u", "x"), ("v", "y"))
            }
        )  # fmt: skip
        return ode.solve(problem, {"e": np.linspace(0.1, 0.7, 8)}, t1=7.0, max_events=1, smooth=smooth)

    trials = np.mean(orbit(CUBES["power"], smooth=True).trials)
    for name, cube in CUBES.items():
        found = orbit(cube)
        np.testing.assert_allclose(found.t, 2 * np.pi, rtol=1e-8, err_msg=name)
        assert np.mean(found.trials) < 1.1 * trials, name


@pytest.mark.parametrize(
    "depth",
    [lambda x: (x + jnp.sqrt(x**2)) / 2, lambda x: jnp.maximum(x, 0.0), lambda x: jnp.max(jnp.stack([0 * x, x]))],
    ids=["root", "maximum", "greatest"],
)
def test_a_kink_is_met_however_it_is_written(depth):
    """A spring with a stop that it reaches only with more than half of its speeds, against a sum of sines."""
    v = np.linspace(0.1, 2.0, 20)
    spring = ode.Problem(
        lambda args: {"x": 0.0, "v": args["v"]},
        lambda t, y, args: {"x": y["v"], "v": -y["x"] - 50 * depth(y["x"] - 1)},
    )
    end = ode.solve(spring, {"v": v}, t1=2.0)
    first = np.arcsin(1 / np.maximum(v, 1))
    speed, w = np.cos(first) * v, np.sqrt(51)
    # Beyond 1 it moves about 50/51 until `gone`, which is before the end.
    gone = first + 2 * np.arctan2(51 * speed, w) / w
    exact = np.where(v > 1, np.cos(2.0 - gone) - speed * np.sin(2.0 - gone), v * np.sin(2.0))
    np.testing.assert_allclose(end.y["x"], exact, rtol=1e-8)


JUMP = growth(lambda t, u, args: jnp.where(t < args["a"], args["p"], 2 * args["p"]))
BEND = growth(lambda t, u, args: args["p"] * jnp.maximum(t - args["a"], 0.0))


@pytest.mark.parametrize(("at", "exact"), [(1.0, 1.0), (0.0, 2.0)], ids=["end", "start"])
def test_a_break_exactly_at_an_end_has_the_derivatives_of_both_sides(at, exact):
    """u(1) is p a + 2 p (1 - a) within, p or 2 p beyond: only the derivative by p is the same on both sides."""
    args = {"a": np.array([at, 0.5]), "p": 1.0}
    by_a, by_p = (ode.solve(JUMP, args, t1=1.0, wrt=name).along(name).y["u"] for name in ("a", "p"))
    np.testing.assert_allclose(by_a, [np.nan, -1.0], rtol=1e-9)
    np.testing.assert_allclose(by_p, [exact, 1.5], rtol=1e-9)
    end = ode.solve(BEND, args, t1=1.0, wrt="a", derivatives=2)
    np.testing.assert_allclose(end.along("a").y["u"], [at - 1, -0.5], rtol=1e-9, atol=1e-15)
    assert any("exactly" in warning for warning in end.warnings)
    # (1 - a)²/2 goes on behind the start, and not behind the end.
    np.testing.assert_allclose(end.along("a", "a").y["u"], [np.nan, 1.0], rtol=1e-9)


def test_the_cut_of_an_angle_is_located():
    """A point goes round; ∫ of its angle is zero after each turn."""
    circle = ode.Problem(
        {"x": 1.0, "y": 0.0},
        lambda t, y, args: {"x": -args["w"] * y["y"], "y": args["w"] * y["x"]},
        integrals={"angle": lambda t, y, args: jnp.arctan2(y["y"], y["x"])},
    )
    w = np.array([1.0, 1.7, 2.3])
    end = ode.solve(circle, {"w": w}, t1=2 * np.pi, wrt="w")
    angle = 2 * np.pi * w
    turns = np.round(angle / (2 * np.pi))
    np.testing.assert_allclose(end.integrals["angle"], (angle - 2 * np.pi * turns) ** 2 / (2 * w), atol=1e-8)


DRIVEN = (
    lambda args: {"q": args["q"], "w": args["w"]},
    lambda t, y, args: {"q": y["w"], "w": -0.5 * y["w"] - jnp.sin(y["q"]) + 1.2 * jnp.cos(2 * t / 3)},
)


def test_a_chaotic_motion_to_an_event_is_as_exact_as_to_a_time():
    rng = np.random.default_rng(0)
    args, period = {"q": rng.uniform(-3, 3, 64), "w": rng.uniform(-2, 2, 64)}, 3 * np.pi
    at_event = ode.Problem(*DRIVEN, {"tenth": ode.Event(lambda t, y, args: t - 10 * period)})
    exact = ode.solve(ode.Problem(*DRIVEN), args, t1=10 * period, rtol=1e-12)
    end = ode.solve(at_event, args, t1=11 * period, rtol=1e-6)
    assert set(end.ended_by) == {"tenth"}
    assert not silently_wrong(end, end.y["q"], exact.y["q"], 1e-4).any()


def test_the_list_of_events_costs_about_an_integration():
    ball = ode.Problem(
        {"y": 1.0, "v": 0.0},
        lambda t, y, args: {"y": y["v"], "v": -9.81},
        {"floor": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -y["v"]})},
    )
    _ = ode.solve(ball, t1=1e6, max_events=3).events  # compiles
    start = time.process_time()
    end = ode.solve(ball, t1=1e6, max_events=1500)
    solved = time.process_time()
    assert end.events.t.shape == (1500,)
    assert time.process_time() - solved < 10 * (solved - start)


# Stiffness.
def fast_beside_slow(k: float, **more: Any) -> ode.Problem:
    """x oscillates; u follows it, k times as fast."""
    return ode.Problem(
        {"x": 1.0, "v": 0.0, "u": 0.0},
        lambda t, y, args: {"x": y["v"], "v": -y["x"], "u": -k * (y["u"] - y["x"])},
        **more,
    )


@pytest.mark.parametrize("k", [30.0, 1000.0])
def test_of_two_methods_that_run_out_the_better_is_told(k):
    ends = {
        method: ode.solve(fast_beside_slow(k), t1=1e4, max_steps=400, method=method)
        for method in ("explicit", "rosenbrock", "auto")
    }
    assert {str(end.ended_by) for end in ends.values()} == {"unfinished"}
    assert ends["auto"].t == pytest.approx(max(ends["explicit"].t, ends["rosenbrock"].t), rel=1e-6)


STIFF_SUM = fault("rounding in a fast part hides its stiffness: the explicit method goes on to its last trial")


@pytest.mark.parametrize("k", [1e9, 1e13, pytest.param(1e15, marks=STIFF_SUM), pytest.param(1e17, marks=STIFF_SUM)])
def test_an_event_of_a_fast_part_is_located(k):
    """u follows s = exp(-t), k times as fast, to 1/2."""
    problem = ode.Problem(
        {"u": 1.0, "s": 1.0},
        lambda t, y, args: {"u": -args["k"] * (y["u"] - y["s"]), "s": -y["s"]},
        {"half": ode.Event(lambda t, y, args: y["u"] - 0.5, -1)},
    )
    end = ode.solve(problem, {"k": k}, t1=5.0)
    assert (end.ended_by, end.t) == ("half", pytest.approx(np.log(2) + 1 / k, rel=1e-7))


def test_a_stiff_motion_may_follow_a_table():
    t, value = np.linspace(0, 5, 11), np.cos(np.linspace(0, 5, 11))
    end = ode.solve(growth(lambda now, u, args: -1e6 * (u - jnp.interp(now, t, value)), y0=1.0), t1=5.0)
    assert end.ended_by == "t1"
    assert end.y["u"] == pytest.approx(value[-1] - (value[-1] - value[-2]) / 0.5e6, rel=1e-7)


# The clock.
NOISE = fault("rounding of a late time is noise of the rates, which steps of any length show")


@pytest.mark.parametrize("t0", [0.0, 1e5, 1.7e9])
def test_a_jump_at_a_late_time_is_passed(t0):
    switched = growth(lambda t, u, args: jnp.where(t > args["on"], 1.0, 0.0))
    end = ode.solve(switched, {"on": t0 + 0.5}, t0=t0, t1=t0 + 2.0)
    assert (end.ended_by, end.y["u"]) == ("t1", pytest.approx(1.5, rel=1e-6))


@pytest.mark.parametrize("t0", [0.0, pytest.param(1.7e9, marks=NOISE)])
def test_a_forced_motion_at_a_late_time_is_as_cheap(t0):
    """u = (cos + sin)/2 + exp(-t)/2 of the time since the start."""
    end = ode.solve(growth(lambda t, u, args: -u + jnp.cos(t - t0), y0=1.0), t0=t0, t1=t0 + 5.0)
    assert end.y["u"] == pytest.approx((np.cos(5) + np.sin(5) + np.exp(-5)) / 2, abs=1e-6)
    assert end.trials < 200


DECAY = growth(lambda t, u, args: -args["k"] * u, y0=1.0)


@pytest.mark.parametrize("late", [0.0, 1e-15])
def test_one_rule_says_which_time_is_the_end(late):
    """A state is a number where it has derivatives, forwards and backwards, and NaN where it has none."""
    ts = np.array([1.0 + late])
    end = ode.solve(DECAY, {"k": 2.0}, t1=1.0, ts=ts)
    slope = jax.jit(jax.grad(lambda k: jnp.nansum(ode.solve(DECAY, {"k": k}, t1=1.0, ts=ts).ys["u"])))(2.0)
    exact = np.where(np.isnan(end.ys["u"][0]), 0.0, -np.exp(-2))
    np.testing.assert_allclose([slope, end.gradient(ys={"u": 1.0})["k"]], exact, rtol=1e-7)


# u′ = -k u + t: u of the time, the start and the rate, with u(t0) = 1.
FORCED = ode.Problem(
    {"u": 1.0},
    lambda t, y, args: {"u": -args["k"] * y["u"] + t},
    integrals={"w": lambda t, y, args: t * y["u"]},
)
K, T0, T1 = 0.7, 1.5, -0.5


def forced(t, k=K, t0=T0):
    return t / k - 1 / k**2 + (1 - t0 / k + 1 / k**2) * jnp.exp(-k * (t - t0))


def test_a_pole_before_the_start_is_said():
    """y = 1/(1 + t), with a pole at t = -1."""
    end = ode.solve(growth(lambda t, u, args: -u * u, y0=1.0), t1=1.0, ts=[-2.0, -0.5, 0.5])
    np.testing.assert_allclose(end.ys["u"], [np.nan, 2.0, 1 / 1.5], rtol=1e-8)
    assert end.warnings


def test_derivatives_of_a_motion_back_in_time():
    names = ("k", "t0", "t1")
    end = ode.solve(FORCED, {"k": K}, t0=T0, t1=T1, wrt=names, derivatives=2, ts=[1.0, 0.0, -0.7], rtol=1e-11)
    of = lambda k, t0, t1: forced(t1, k, t0)  # noqa: E731
    slopes, curves = (np.array(jax.jit(each(of, (0, 1, 2)))(K, T0, T1)) for each in (jax.grad, jax.hessian))
    at = np.array([*jax.jit(jax.grad(lambda k, t0: forced(0.0, k, t0), (0, 1)))(K, T0), 0.0])
    for i, name in enumerate(names):
        assert end.along(name).y["u"] == pytest.approx(slopes[i], rel=1e-8)
        assert end.along(name).t == (name == "t1")
        assert end.times is not None
        assert end.times.along(name).ys["u"][1] == pytest.approx(at[i], rel=1e-8)
        for j, other in enumerate(names[: i + 1]):
            assert end.along(name, other).y["u"] == pytest.approx(curves[i][j], rel=1e-7)
    np.testing.assert_array_equal(end.ts, [1.0, 0.0, -0.7])
    np.testing.assert_allclose(end.ys["u"], [float(forced(1.0)), float(forced(0.0)), np.nan], rtol=1e-9)
    ahead = ode.solve(FORCED, {"k": K}, t0=T0, t1=4.0, ts=[1.0, 0.0, 3.0])
    np.testing.assert_allclose(ahead.ys["u"], forced(np.array([1.0, 0.0, 3.0])), rtol=1e-8)
    there = ode.solve(
        ode.Problem({"u": forced(T1)}, FORCED.vector_field, integrals=FORCED.integrals), {"k": K}, t0=T1, t1=T0
    )
    assert end.integrals["w"] == pytest.approx(-there.integrals["w"], rel=1e-8)


@pytest.mark.parametrize(("t1", "ts"), [(T1, [1.0, 2.0, 0.0]), (4.0, [1.0, 2.0, 0.0]), (4.0, [1.0, 0.0])])
def test_gradients_at_times_on_both_sides_of_the_start(t1, ts):
    ts = np.array(ts)
    exact = float(jax.jit(jax.grad(lambda k: jnp.sum(forced(ts, k) ** 2)))(K))
    end = ode.solve(FORCED, {"k": K}, t0=T0, t1=t1, ts=ts)
    assert end.gradient(ys={"u": 2 * end.ys["u"]})["k"] == pytest.approx(exact, rel=1e-7)
    inside = jax.grad(lambda k: jnp.sum(ode.solve(FORCED, {"k": k}, t0=T0, t1=t1, ts=ts).ys["u"] ** 2))
    assert float(jax.jit(inside)(K)) == pytest.approx(exact, rel=1e-7)


def test_a_dataset_of_a_motion_back_in_time_has_arguments_as_they_are():
    """One has the name of a number of the clock."""
    problem = growth(lambda t, u, args: -args["t1"] * u, y0=1.0)
    k, t1 = np.array([1.0, 2.0]), np.array([-1.0, -2.0])
    dataset = ode.solve(problem, {"t1": k}, t0=0.0, t1=t1).to_dataset()
    np.testing.assert_array_equal([dataset["t1"], dataset["t1_"]], [k, t1])
    end = ode.solve(problem, {"t1": np.array([1.0, np.inf])}, t1=1.0)
    assert end.ended_by.tolist() == ["t1", "failed"]
    assert "`t1` is NaN or infinite" in end.warnings[0]


@pytest.mark.parametrize("back", [False, True])
def test_jax_compiles_lanes_with_starts_and_arguments_on_two_axes(back):
    t0, k, ts = np.array([0.0, 0.1, 0.2]), np.array([[1.0], [2.0]]), np.array([0.05, 0.5])
    if back:
        t0, ts = 2 + t0, 2 - ts

    def states(k):
        return ode.solve(DECAY, {"k": k}, t0=t0, t1=0.0 if back else 3.0, ts=ts).ys["u"]

    exact = np.exp(-k[..., None] * (ts - t0[:, None]))
    np.testing.assert_allclose(states(k), exact, rtol=1e-8)
    np.testing.assert_allclose(jax.jit(states)(k), exact, rtol=1e-8)


def test_events_back_in_time_are_passed_in_their_order():
    ball = ode.Problem(
        {"y": 1.0, "v": 0.0},
        lambda t, y, args: {"y": y["v"], "v": -2.0},
        {"floor": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -y["v"]})},
    )
    end = ode.solve(ball, t0=np.array([0.0, 10.0]), t1=np.array([-6.0, 4.0]))
    np.testing.assert_allclose(end.events.t, [[-1, -3, -5], [9, 7, 5]], **CLOSE)
    np.testing.assert_allclose(end.events.y["v"], 2.0, **CLOSE)
    assert end.count.tolist() == [3, 3]
    with pytest.raises(ValueError, match="resets"):
        ode.solve(ball, t0=0.0, t1=1.0, ts=[-1.0])
    with pytest.raises(ValueError, match="apart"):
        ode.solve(ball, t0=0.0, t1=np.array([-1.0, 1.0]))


# Starts on an event, and bodies that come to rest.


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_start_within_rounding_of_an_event_is_a_start(direction):
    """x = sin(p + t) from multiples of π: the next zero in either direction is at π or 2 π."""
    sine = ode.Problem(
        lambda args: {"x": jnp.sin(args["p"]), "v": jnp.cos(args["p"])},
        OSCILLATOR[1],
        {"zero": ode.Event(lambda t, y, args: y["x"], direction)},
    )
    n = np.arange(3, 11)
    end = ode.solve(sine, {"p": n * np.pi}, t1=10.0)
    rises_at_start = n % 2 == 0
    np.testing.assert_allclose(end.t, np.where(rises_at_start == (direction == 1), 2, 1) * np.pi, rtol=1e-8)


@pytest.mark.parametrize("start", ["wait", "end", "fire"])
@pytest.mark.parametrize("direction", [-1, 1])
def test_every_start_has_one_rule_for_zero(start, direction):
    """x = sin(p + t) from multiples of π: where it falls through zero the fall happens, and no rise does."""
    sine = ode.Problem(
        lambda args: {"x": jnp.sin(args["p"]), "v": jnp.cos(args["p"])},
        OSCILLATOR[1],
        {"zero": ode.Event(lambda t, y, args: y["x"], direction, lambda t, y, args: y | {"v": 2 * y["v"]})},
    )
    n = np.arange(1, 11)
    end = ode.solve(sine, {"p": n * np.pi}, t1=1.0, start=start)
    happens = (n % 2 == 1) == (direction == -1)
    np.testing.assert_array_equal(end.count, happens & (start == "fire"))
    np.testing.assert_array_equal(end.ended_by, np.where(happens & (start == "end"), "start", "t1"))
    size = np.where(end.ended_by == "start", 0.0, np.sin(1) * (1 + end.count))
    np.testing.assert_allclose(np.abs(end.y["x"]), size, rtol=1e-8, atol=1e-14)


def on_table(reset: Any, direction: int) -> ode.Problem:
    """A ball over a table that moves as a sin(w t), and a mass that slides."""
    return ode.Problem(
        lambda args: {"x": 0.0, "u": 1.0, "y": args["h"], "v": args["v"]},
        lambda t, y, args: {"x": y["u"], "u": args["tilt"] - 0.1 * y["u"], "y": y["v"], "v": -9.81},
        {"hit": ode.Event(lambda t, y, args: y["y"] - args["a"] * jnp.sin(args["w"] * t), direction, reset)},
    )


@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("exact", [False, True])
def test_no_body_at_rest_falls_through(exact, direction):
    """It is unfinished, with a sentence, however the reset writes that the body keeps a part of its speed, or none."""

    def reset(t, y, args):
        speed = args["a"] * args["w"] * jnp.cos(args["w"] * t)
        height = args["a"] * jnp.sin(args["w"] * t) if exact else y["y"]
        return y | {"y": height, "v": speed - args["e"] * (y["v"] - speed)}

    every = np.meshgrid([0.0, 0.5, 2.0], [0.0, 0.1, 0.3], [1.0, 4.0], [0.0, 3.0], [0.0, 0.3])
    h, a, w, tilt, e = (each.ravel() for each in every)
    for start in ("wait", "fire"):
        falls = start == "fire" and direction == -1
        v = np.where(h == 0, -1.0 if falls else 1.0, 0.0) + a * w
        args = {"h": h, "v": v, "a": a, "w": w, "tilt": tilt, "e": e}
        end = ode.solve(on_table(reset, direction), args, t1=10.0, start=start)
        through = (end.ended_by == "t1") & (end.y["y"] < a * np.sin(w * end.t) - 1e-6)
        assert not through.any()
        assert (end.ended_by[a == 0] == "unfinished").all()
        assert not np.any(end.ended_by == "failed")
        assert any("rest" in warning for warning in end.warnings)


# Access.
@pytest.mark.parametrize("of", [jax.grad, jax.jit])
def test_a_traced_number_in_a_closure_is_refused(of):
    def last(k):
        return ode.solve(growth(lambda t, u, args: -k * u, y0=1.0), t1=1.0).y["u"]

    with pytest.raises(ValueError, match="args"):
        of(last)(2.0)


def test_a_custom_derivative_is_computed_or_refused():
    square = jax.custom_vjp(lambda u: u**2)
    square.defvjp(lambda u: (u**2, u), lambda u, bar: (2 * u * bar,))
    problem = growth(lambda t, u, args: -args["k"] * square(u), y0=1.0)
    try:
        end = ode.solve(problem, {"k": 2.0}, t1=1.0)
    except (ValueError, TypeError) as error:
        assert "use `custom_jvp`" in str(error)  # noqa: PT017
    else:
        assert end.y["u"] == pytest.approx(1 / 3, rel=1e-8)


def test_a_number_of_the_clock_and_an_argument_may_have_one_name():
    problem = growth(lambda t, u, args: -args["t1"] * u, y0=1.0)
    with pytest.raises(ValueError, match=r"'args\.t1' or 'solve\.t1'"):
        ode.solve(problem, {"t1": 2.0}, t1=1.0, wrt="t1")
    end = ode.solve(problem, {"t1": 2.0}, t1=1.0, wrt=("args.t1", "solve.t1", "t0"))
    slopes = [end.along(name).y["u"] * np.exp(2) for name in ("args.t1", "solve.t1", "t0")]
    np.testing.assert_allclose(slopes, [-1, -2, 2], rtol=1e-8)
    assert [end.along(name).t for name in ("args.t1", "solve.t1", "t0")] == [0, 1, 0]


def test_the_advice_on_a_custom_derivative_works():
    square = jax.custom_jvp(lambda u: u**2)
    square.defjvps(lambda dot, _, u: 2 * u * dot)
    problem = growth(lambda t, u, args: -args["k"] * square(u), y0=1.0)
    end = ode.solve(problem, {"k": 2.0}, t1=1.0, wrt="k")
    assert end.along("k").y["u"] == pytest.approx(-1 / 9, rel=1e-8)
    assert end.gradient(y={"u": 1.0})["k"] == pytest.approx(-1 / 9, rel=1e-8)


def test_complex_numbers_within_rates_are_refused_with_their_line():
    problem = growth(lambda t, u, args: jnp.abs(jnp.exp(1j * u)), y0=1.0)
    with pytest.raises((ValueError, TypeError), match=r"test_hard_problems\.py"):
        ode.solve(problem, t1=1.0)


@pytest.mark.parametrize(
    ("rate", "said"),
    [(lambda k, x: -k * x, ["shared='k'"]), (lambda k, x: jnp.stack([-k * x[0], x[0], x[1]]), [])],
    ids=["of each lane or of each part", "of each lane"],
)
def test_an_array_of_the_states_length_is_doubted(rate, said):
    problem = ode.Problem({"x": jnp.ones(3)}, lambda t, y, args: {"x": rate(args["k"], y["x"])})
    args = {"k": np.array([1.0, 2.0, 3.0])}
    end = ode.solve(problem, args, t1=1.0)
    assert end.t.shape == (3,)
    assert len(end.warnings) == len(said)
    assert all(words in warning for words, warning in zip(said, end.warnings, strict=True))
    if said:
        whole = ode.solve(problem, args, t1=1.0, shared="k")
        np.testing.assert_allclose(whole.y["x"], np.exp(-args["k"]), rtol=1e-8)
        assert not whole.warnings


def test_a_changed_problem_keeps_what_the_user_compiled():
    traces, rate = [], [2.0]
    users = jax.jit(lambda x: traces.append(x) or x + 1)
    problem = growth(lambda t, u, args: -rate[0] * u, y0=1.0)
    for value in (2.0, 3.0):
        rate[0] = value
        assert ode.solve(problem, t1=1.0).y["u"] == pytest.approx(np.exp(-value), rel=1e-8)
        users(1.0)
    assert len(traces) == 1


# The compiler.
def test_a_quotient_in_a_loop_is_a_quotient():
    def equals(y):
        """How many of 1, 2, …, 200 are y."""
        body = lambda at: (at[0] + 1.0, at[1] + jnp.where((at[0] / y >= 1.0) & (at[0] <= y), 1.0, 0.0))  # noqa: E731
        return jax.lax.while_loop(lambda at: at[0] < 200, body, (jnp.ones(()), jnp.zeros(())))[1]

    y = np.arange(1.0, 100.0)
    np.testing.assert_array_equal(Lanewise(equals, (number,))(y), 1.0)


@pytest.mark.parametrize("power", [lambda square: jnp.sqrt(square), lambda square: square**0.5])
def test_second_derivatives_across_a_double_zero_of_a_root_are_nan_or_right(power):
    """∫ √(5 x² + ε²) dt with x = t - p; of ε = 0 the second derivative is that of a kink."""
    p, small = 1.0, np.array([0.0, 1e-4, 1e-2])
    path = growth(lambda t, u, args: power(5 * (t - args["p"]) ** 2 + args["small"] ** 2))
    end = ode.solve(path, {"p": p, "small": small}, t1=3.0, wrt="p", derivatives=2)
    first = np.sqrt(5 * p**2 + small**2) - np.sqrt(5 * (3 - p) ** 2 + small**2)
    np.testing.assert_allclose(end.along("p").y["u"], first, rtol=1e-7)
    second = [5 * x / np.sqrt(5 * x**2 + small[1:] ** 2) for x in (3 - p, p)]
    found = end.along("p", "p").y["u"]
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], sum(second), rtol=1e-6)
    assert any("root" in warning for warning in end.warnings)


@pytest.mark.parametrize("norm", [jnp.hypot, lambda u, v: jnp.linalg.norm(jnp.stack([u, v]))])
def test_a_norm_through_zero_has_no_second_derivative(norm):
    """∫ √(a² s² + b² (s - c)²) ds from -1 to 1: its second derivative by c is infinite at c = 0."""
    path = ode.Problem(
        lambda args: {"x": -args["a"], "z": -args["b"] * (1 + args["c"]), "path": 0.0},
        lambda t, y, args: {"x": args["a"], "z": args["b"], "path": norm(y["x"], y["z"])},
    )
    a, b = np.random.default_rng(1).uniform(0.5, 2.0, (2, 7))
    end = ode.solve(path, {"a": a, "b": b, "c": np.array([[0.0], [1e-2]])}, t1=2.0, wrt=("a", "c"), derivatives=2)
    found = end.along("c", "c").y["path"]
    assert np.isnan(found[0]).all()
    bent = lambda s, a, b: (a * b * s) ** 2 / np.hypot(a * s, b * (s - 1e-2)) ** 3  # noqa: E731
    exact = [quad(bent, -1, 1, each, epsabs=0.0, limit=200, points=[0.0, 1e-2])[0] for each in zip(a, b, strict=True)]
    np.testing.assert_allclose(found[1], exact, rtol=1e-6)


def test_a_softmax_of_many_has_derivatives():
    """Its shift by the greatest number is no break: u' = Σ wᵢ softmax(cᵢ u)ᵢ, against differences."""
    slopes = np.linspace(-1, 1, 40)
    mixed = lambda t, u, args: jnp.sum(jnp.array(slopes) * jax.nn.softmax(jnp.array(slopes) * (u - args["c"])))  # noqa: E731
    path = growth(mixed, y0=0.5)
    end = ode.solve(path, {"c": 0.2}, t1=3.0, wrt="c", derivatives=2)
    near = ode.solve(path, {"c": 0.2 + np.array([-1e-4, 1e-4])}, t1=3.0, wrt="c")
    assert end.along("c").y["u"] == pytest.approx(np.diff(near.y["u"])[0] / 2e-4, rel=1e-6)
    assert end.along("c", "c").y["u"] == pytest.approx(np.diff(near.along("c").y["u"])[0] / 2e-4, rel=1e-5)
    assert not end.warnings
