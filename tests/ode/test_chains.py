"""Motions that go on after an event, against closed forms; JAX differentiates these."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from erosion import ode
from erosion.ode.ensemble import lanes_of
from erosion.ode.kinks import may_have_kinks
from erosion.ode.outputs import StateOutputs
from erosion.ode.signature import Clock, Options
from tests.ode.closed_forms import BALL, derivative


def place(t: Any, y: Any, args: Any) -> Any:
    return y["y"]


def impact(args: dict[str, Any], n: int) -> tuple[Any, Any, Any]:
    """Time and speed of the n-th impact of a ball that starts at rest, and ∫ v² dt up to it."""
    h, g, e = args["h"], args["g"], args["e"]
    speeds = [np.sqrt(2 * g * h) * e**i for i in range(n)]
    times = [(1 if i == 0 else 2) * speed / g for i, speed in enumerate(speeds)]
    return sum(times), -speeds[-1], sum(speed**2 * time / 3 for speed, time in zip(speeds, times, strict=True))


def with_derivatives(exact: Any, args: Any) -> Any:
    """A function's value, its Jacobian and its Hessian."""
    return jax.jit(lambda args: (exact(args), jax.jacfwd(exact)(args), jax.hessian(exact)(args)))(args)


def agrees(end: ode.Solution, given: Any, exact: Any, args: dict[str, Any]) -> None:
    """Compare what `given` takes of an end and its derivatives with a function of the arguments and its own."""
    names = end.wrt
    value, slopes, curves = with_derivatives(exact, args)
    np.testing.assert_allclose(given(end), value, rtol=1e-9, atol=1e-11)
    for one in names:
        np.testing.assert_allclose(given(end.along(one)), slopes[one], rtol=1e-8, atol=1e-9)
        for other in names:
            np.testing.assert_allclose(given(end.along(one, other)), curves[one][other], rtol=1e-6, atol=1e-7)


def test_the_events_of_a_chain_are_listed():
    args = {"h": np.array([2.0, 0.1, 5.0]), "g": 9.81, "e": 0.8}
    end = ode.solve(BALL, args, t1=2.3, t0=np.array([0.5, 1.0, 1.4]), max_events=np.array([9, 3, 9]))
    np.testing.assert_array_equal(end.count, [2, 3, 0])
    assert list(end.ended_by) == ["t1", "floor", "t1"]
    assert [list(row) for row in end.events.name] == [["floor", "floor", ""], ["floor"] * 3, [""] * 3]
    for i, t0 in enumerate((0.5, 1.0)):
        for n in range(int(end.count[i])):
            t, v, _ = impact({"h": args["h"][i], "g": 9.81, "e": 0.8}, n + 1)
            np.testing.assert_allclose(end.events.t[i, n], t0 + t, rtol=1e-9)
            np.testing.assert_allclose(end.events.y["v"][i, n], v, rtol=1e-9)
    assert np.isnan(end.events.t[2]).all()
    np.testing.assert_array_equal(end.events.at_once["floor"], end.events.name == "floor")
    moving = ode.solve(BALL, {"h": 2.0, "g": 9.81, "e": 0.8}, t1=9.0, max_events=3, wrt="h")
    assert moving.events.t[-1] == pytest.approx(float(moving.t), rel=1e-12)
    np.testing.assert_allclose(moving.events.y["v"][-1], moving.y["v"], rtol=1e-12)
    assert ode.solve(BALL, {"h": 2.0, "g": 9.81, "e": 0.8}, t1=0.1).events.t.shape == (0,)
    # At the very time of an event the state is that before its reset.
    there = ode.solve(BALL, {"h": 2.0, "g": 9.81, "e": 0.8}, t1=2.3, t0=0.5, ts=end.events.t[0, :2])
    np.testing.assert_allclose(there.ys["v"], end.events.y["v"][0, :2], rtol=1e-9)


def test_the_events_of_a_chain_have_derivatives():
    args = {"h": np.array([2.0, 0.5]), "g": 9.81, "e": 0.8}
    end = ode.solve(BALL, args, t0=1.0, t1=3.3, wrt=("h", "e", "t0"), derivatives=2)
    np.testing.assert_array_equal(end.count, [2, 7])

    def given(part: Any, i: int, n: int) -> np.ndarray:
        return np.array([part.t[i, n], part.y["v"][i, n], part.integrals["path"][i, n]])

    for i, n in [(0, 0), (0, 1), (1, 3), (1, 6)]:
        exact = lambda args, n=n: np.array([args["t0"], 0.0, 0.0]) + np.array(impact(args, n + 1))  # noqa: E731
        own = args | {"h": args["h"][i], "t0": 1.0}
        np.testing.assert_allclose(given(end.events, i, n), exact(own), rtol=1e-9)
        for one in end.wrt:
            slope = derivative(exact, one)
            np.testing.assert_allclose(given(end.events.along(one), i, n), slope(own), rtol=1e-8, atol=1e-9)
            for other in end.wrt:
                found = given(end.events.along(one, other), i, n)
                np.testing.assert_allclose(found, derivative(slope, other)(own), rtol=1e-6, atol=1e-7)
    assert np.isnan(end.events.along("h").t[0, 2:]).all()
    first = ode.solve(ode.Problem(BALL.y0, BALL.vector_field, {"floor": ode.Event(place)}), args, t1=9.0, wrt="h")
    np.testing.assert_array_equal(first.events.along("h").y["v"][:, 0], first.along("h").y["v"])
    with pytest.raises(ValueError, match="derivatives"):
        end.events.along("g")


def test_the_events_of_a_stiff_chain_have_derivatives():
    """y follows cos t within 1e-4; a switch of the state counts the zeros."""
    follows = ode.Problem(
        {"y": 1.0, "n": 0.0},
        lambda t, y, args: {"y": 1e4 * (args["a"] * jnp.cos(args["w"] * t) - y["y"]), "n": 0.0},
        {"zero": ode.Event(place, reset=lambda t, y, args: y | {"n": y["n"] + 1.0})},
    )
    end = ode.solve(follows, {"a": 1.0, "w": np.array([1.0, 2.0])}, t1=9.0, wrt="w")
    assert np.all(end.stiff)
    zeros = ((np.arange(3) + 0.5) * np.pi + np.arctan([[1e-4], [2e-4]])) / np.array([[1.0], [2.0]])
    np.testing.assert_allclose(end.events.t[:, :3], zeros, rtol=1e-8)
    w = np.array([[1.0], [2.0]])
    np.testing.assert_allclose(end.events.along("w").t[:, :3], (1e-4 / (1 + (w / 1e4) ** 2) - zeros) / w, rtol=1e-6)


def test_the_longest_chain_may_differ_from_lane_to_lane():
    n = np.array([[1, 4], [2, 30]])
    args = {"h": 1.0, "g": 9.81, "e": np.array([0.5, 0.9])}
    end = ode.solve(BALL, args, t1=1e3, max_events=n)
    np.testing.assert_array_equal(end.count, n)
    times = [[impact(args | {"e": args["e"][j]}, n[i, j])[0] for j in range(2)] for i in range(2)]
    np.testing.assert_allclose(end.t, times, rtol=1e-9)


@pytest.mark.parametrize("direction", [-1, 0])
@pytest.mark.parametrize("rest", [0.0, None])
def test_bounces_that_accumulate_end_unfinished(direction, rest):
    def reset(t, y, args):
        return {"y": y["y"] if rest is None else rest, "v": -args["e"] * y["v"]}

    ball = ode.Problem(BALL.y0, BALL.vector_field, {"floor": ode.Event(lambda t, y, args: y["y"], direction, reset)})
    e = np.array([0.1, 0.5, 0.8])
    end = ode.solve(ball, {"h": 1.0, "g": 9.81, "e": e}, t1=1e3, wrt="e")
    assert list(end.ended_by) == ["unfinished"] * 3
    np.testing.assert_allclose(end.t, np.sqrt(2 / 9.81) * (1 + e) / (1 - e), rtol=1e-8)
    np.testing.assert_allclose(end.y["y"], 0.0, atol=1e-10)
    assert (end.count < 200).all()


@pytest.mark.parametrize("direction", [-1, 0])
def test_a_reset_that_leaves_the_body_beyond_its_event_waits_until_it_returns(direction):
    """From y = -0.2 the body rises through the floor, and counts as it falls again (or, either way, as it rises)."""
    ball = ode.Problem(
        BALL.y0,
        BALL.vector_field,
        {"floor": ode.Event(lambda t, y, args: y["y"], direction, lambda t, y, args: {"y": -args["d"], "v": 3.0})},
    )
    args = {"h": 1.0, "g": 10.0, "d": 0.2}
    end = ode.solve(ball, args, t1=9.0, max_events=2, wrt=("d", "g"), derivatives=2)

    def second(args: dict[str, Any]) -> Any:
        root = jnp.sqrt(9 - 2 * args["g"] * args["d"])
        return jnp.sqrt(2 / args["g"]) + (3 + (root if direction else -root)) / args["g"]

    agrees(end, lambda part: part.t, second, args)


@pytest.mark.parametrize("direction", [-1, 0])
def test_a_reset_need_not_put_the_body_on_its_event(direction):
    """The body is where rounding has left it, and 1e-12 lower: that is no event of its own."""

    def reset(t, y, args):
        return {"y": y["y"] - 1e-12, "v": -0.9 * y["v"]}

    floor = ode.Event(lambda t, y, args: y["y"] - args["f"], direction, reset)
    ball = ode.Problem(BALL.y0, BALL.vector_field, {"floor": floor})
    f = np.linspace(-3, 0.9, 20)
    end = ode.solve(ball, {"h": 1.0, "g": 9.81, "f": f}, t1=99.0, max_events=4)
    np.testing.assert_allclose(end.t, np.sqrt(2 * (1 - f) / 9.81) * (1 + 2 * (0.9 + 0.81 + 0.729)), rtol=1e-9)


def test_a_lane_that_is_beyond_its_event_after_a_reset_goes_on():
    """Only the start of the lane is a start."""
    floor = ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": -0.2, "v": 3.0})
    ball = ode.Problem(BALL.y0, BALL.vector_field, {"floor": floor})
    one, other = (
        ode.solve(ball, {"h": 1.0, "g": 10.0}, t1=9.0, max_events=3, start=start) for start in ("wait", "end")
    )
    assert (one.ended_by, one.count, one.t) == (other.ended_by, other.count, other.t)
    assert other.count == 3


def relay(drive: float) -> ode.Problem:
    """A switch with hysteresis: x runs to +b or -b, and the field turns at ±1. The switch is part of the state."""
    return ode.Problem(
        {"x": 0.0, "on": 1.0},
        lambda t, y, args: {"x": -args["a"] * y["x"] + args["b"] * y["on"] + drive * jnp.sin(t), "on": 0.0},
        {
            "high": ode.Event(lambda t, y, args: y["x"] - args["c"], 1, lambda t, y, args: {**y, "on": -1.0}),
            "low": ode.Event(lambda t, y, args: y["x"] + args["c"], -1, lambda t, y, args: {**y, "on": 1.0}),
        },
    )


def test_a_driven_relay_has_the_derivatives_of_differences():
    args = {"a": 0.5, "b": 1.3, "c": 0.8}
    end = ode.solve(relay(0.4), args, t1=12.0, wrt=("a", "b", "c"), derivatives=2)

    @functools.cache
    def x(a: float, b: float, c: float) -> float:
        """At t = 12, by DOP853, one flight after the other."""
        t, y, on = 0.0, 0.0, 1.0
        for _ in range(int(end.count) + 1):

            def event(t: float, y: np.ndarray, on: float = on) -> float:
                return y[0] - on * c

            vars(event).update(terminal=True, direction=on)
            flight = solve_ivp(
                lambda t, y, on=on: -a * y + b * on + 0.4 * np.sin(t),
                (t, 12.0),
                [y],
                "DOP853",
                rtol=1e-12,
                atol=1e-13,
                events=event,
            )
            t, y, on = flight.t[-1], flight.y[0, -1], -on
        assert t == 12.0
        return y

    at = np.array([0.5, 1.3, 0.8])
    assert end.count >= 3
    assert end.y["x"] == pytest.approx(x(*at), abs=1e-10)
    steps = 1e-3 * np.eye(3)
    for i, name in enumerate(args):
        far = [x(*(at + k * steps[i])) for k in (-2, -1, 1, 2)]
        slope = (8 * (far[2] - far[1]) - (far[3] - far[0])) / 12e-3
        assert end.along(name).y["x"] == pytest.approx(slope, rel=1e-7)
        curve = (16 * (far[1] + far[2]) - far[0] - far[3] - 30 * x(*at)) / 12e-6
        assert end.along(name, name).y["x"] == pytest.approx(curve, rel=1e-3, abs=1e-3)


BOX = ode.Problem(
    lambda args: {"x": args["x"], "y": 0.5, "u": 1.0, "w": 1.0},
    lambda t, y, args: {"x": y["u"], "y": y["w"], "u": 0.0, "w": 0.0},
    {
        "wall": ode.Event(lambda t, y, args: 1 - y["x"], -1, lambda t, y, args: {**y, "u": -y["u"]}),
        "left": ode.Event(lambda t, y, args: y["x"], 0, lambda t, y, args: {**y, "u": -y["u"]}),
        "top": ode.Event(lambda t, y, args: y["y"] - 1, 1, lambda t, y, args: {**y, "w": -y["w"]}),
        "floor": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {**y, "w": -y["w"]}),
        "late": ode.Event(lambda t, y, args: t - 3.25, 1),
    },
)


def fold(place: Any) -> Any:
    """Where a body that bounces between 0 and 1 is."""
    return 1 - np.abs(1 - np.mod(place, 2))


def test_a_chain_of_several_kinds_of_events():
    x = np.array([0.25, 0.4, 0.9])
    end = ode.solve(BOX, {"x": x}, t1=9.0, wrt="x")
    np.testing.assert_array_equal(end.ended_by, "late")
    np.testing.assert_allclose(end.t, 3.25, rtol=1e-12)
    np.testing.assert_allclose(end.y["x"], fold(x + 3.25), rtol=1e-9)
    np.testing.assert_allclose(end.y["y"], fold(3.75), rtol=1e-9)
    np.testing.assert_allclose(end.along("x").y["x"], end.y["u"], rtol=1e-9)
    assert list(end.events.name[0]) == ["top", "wall", "floor", "left", "top", "wall", "late", ""]


@pytest.mark.parametrize("miss", [0.0, 1e-15, -1e-15, 3e-14, -3e-14, 1e-13, -1e-13, 1e-12, -1e-12, 1e-9])
def test_events_at_once_happen_in_turn(miss):
    """A ball that flies into corners, four times: no bounce may be lost, however the rounding falls."""
    end = ode.solve(BOX, {"x": 0.5 + miss}, t1=9.0)
    assert (end.ended_by, end.count) == ("late", 7)
    assert end.y["x"] == pytest.approx(fold(3.75 + miss), abs=1e-9)
    assert end.y["y"] == pytest.approx(fold(3.75), abs=1e-9)
    if miss == 0:
        names = ["wall", "top", "left", "floor", "wall", "top", "late"]
        assert list(end.events.name) == names
        assert all(end.events.at_once["wall"] == [True, True, False, False, True, True, False])
        np.testing.assert_array_equal(end.events.y["w"][:2], 1.0)
        np.testing.assert_array_equal(end.events.y["u"][:2], [1.0, -1.0])


def test_an_end_at_once_with_a_reset_ends_the_lane():
    def problem(*names: str) -> ode.Problem:
        events = {
            "bounce": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -y["v"]}),
            "end": ode.Event(lambda t, y, args: t - args, 1),
            "again": ode.Event(lambda t, y, args: y["y"], -1),
        }
        return ode.Problem(
            {"y": 5.0, "v": 0.0}, lambda t, y, args: {"y": y["v"], "v": -10.0}, {name: events[name] for name in names}
        )

    after = ode.solve(problem("bounce", "end"), 1.0, t1=9.0)
    assert (after.ended_by, after.count, after.y["v"]) == ("end", 2, pytest.approx(10))
    before = ode.solve(problem("end", "bounce"), 1.0, t1=9.0)
    assert (before.ended_by, before.count, before.y["v"]) == ("end", 1, pytest.approx(-10))
    assert before.at_once == after.at_once == {"end": True, "bounce": True}
    # The function of the second rises after the first.
    passed = ode.solve(problem("bounce", "again"), 1.0, t1=2.0, start="end")
    assert (passed.ended_by, passed.count) == ("t1", 1)


def test_a_chain_may_end_at_its_start_only():
    """With start="end" a body on the floor ends there; after its bounce it is on the floor as well, and goes on."""
    args = {"h": np.array([0.0, 1.0, -1.0]), "g": 9.81, "e": 0.8}
    end = ode.solve(BALL, args, t1=2.0, start="end")
    assert list(end.ended_by) == ["start", "t1", "start"]
    assert list(end.count) == [0, 3, 0]


@pytest.mark.parametrize(
    ("rate", "rough"),
    [
        (lambda y: jnp.where(y["on"] > 0.5, 1.0 - y["x"], -y["x"]), False),
        (lambda y: jnp.where(y["x"] > 0.5, 1.0, -y["x"]), True),
        (lambda y: jnp.abs(y["on"] - 0.5) - y["x"], False),
        (lambda y: jnp.abs(y["x"]), True),
        (lambda y: y["x"].astype(int) - y["x"], True),
        (lambda y: 1.0 - y["x"] * (y["x"] > 0.5), True),
    ],
)
@pytest.mark.parametrize("still", [lambda y: 0.0, lambda y: 0.0 * y["x"], lambda y: jnp.zeros(())])
def test_a_switch_that_only_resets_change_is_no_kink(rate, rough: bool, still) -> None:
    problem = ode.Problem(
        {"x": 0.0, "on": 1.0},
        lambda t, y, args: {"x": rate(y), "on": still(y)},
        {"high": ode.Event(lambda t, y, args: y["x"] - 0.6, +1, reset=lambda t, y, args: y | {"on": 0.0})},
    )
    signature = lanes_of(
        problem, None, Clock(0.0, 1.0, np.inf, np.inf), Options(arm_on_return=True, outputs=StateOutputs())
    ).signature
    assert may_have_kinks(signature) == rough
