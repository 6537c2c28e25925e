"""Two things end a motion at one time: a derivative is a number where both agree on it, and NaN where they do not."""

from typing import Any

import jax
import numpy as np
import pytest

from erosion import ode

ARGS = {"a": 1.0, "b": 1.0, "both": 1.0}


def race(**more: Any) -> ode.Problem:
    """Two runners who reach 1 together, at 1/(a both) and 1/(b both); the first of them ends the race."""
    return ode.Problem(
        {"x": 0.0, "y": 0.0},
        lambda t, y, args: {"x": args["a"] * args["both"], "y": args["b"] * args["both"]},
        events={
            "x": ode.Event(lambda t, y, args: y["x"] - 1, 1),
            "y": ode.Event(lambda t, y, args: y["y"] - 1, 1),
            **more,
        },
    )


LATER = {"later": ode.Event(lambda t, y, args: y["x"] - 5, 1, lambda t, y, args: y)}
"""Does not happen, but makes a lane a hybrid trajectory."""


@pytest.mark.parametrize("more", [{}, LATER], ids=["one segment", "hybrid"])
@pytest.mark.parametrize("method", ["explicit", "rosenbrock"])
def test_of_two_terminal_events_derivatives_are_those_of_the_earlier_one(more, method):
    end = ode.solve(race(**more), ARGS, t1=9.0, wrt=("a", "b", "both"), method=method)
    assert (end.t, end.ended_by) == (pytest.approx(1.0), "x")
    assert np.isnan([end.along("a").t, end.along("b").t]).all()
    assert end.along("both").t == pytest.approx(-1.0)
    assert end.along("both").y["y"] == pytest.approx(0.0, abs=1e-9)
    assert any("at once" in sentence for sentence in end.warnings)
    apart = ode.solve(race(**more), ARGS | {"a": 1.1}, t1=9.0, wrt=("a", "b"), method=method)
    assert (apart.along("a").t, apart.along("b").t) == (pytest.approx(-1 / 1.21), pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize("more", [{}, LATER], ids=["one segment", "hybrid"])
def test_second_derivatives_of_two_terminal_events(more):
    end = ode.solve(race(**more), ARGS, t1=9.0, wrt=("both", "a"), derivatives=2)
    assert end.along("both", "both").t == pytest.approx(2.0)
    assert np.isnan([end.along("a", "a").t, end.along("a", "both").t]).all()


def test_a_second_derivative_alone_may_differ():
    def ends(bend: float) -> ode.Event:
        return ode.Event(lambda t, y, args: y["x"] - args["p"] - bend * (args["p"] - 1) ** 2, 1)

    problem = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": 1.0}, events={"one": ends(0.0), "other": ends(1.0)})
    end = ode.solve(problem, {"p": 1.0}, t1=9.0, wrt="p", derivatives=2)
    assert end.along("p").t == pytest.approx(1.0)
    assert np.isnan(end.along("p", "p").t)


def test_gradients_by_jax_of_two_terminal_events():
    def time(a: Any, b: Any, both: Any) -> Any:
        return ode.solve(race(), {"a": a, "b": b, "both": both}, t1=9.0).t

    by_a, by_b, by_both = jax.grad(time, (0, 1, 2))(1.0, 1.0, 1.0)
    assert np.isnan([by_a, by_b]).all()
    assert by_both == pytest.approx(-1.0)
    end = ode.solve(race(), ARGS, t1=9.0, gradient=True)
    found = end.gradient(t=1.0)
    assert np.isnan([found["a"], found["b"]]).all()
    assert found["both"] == pytest.approx(-1.0)


def test_states_before_an_end_at_once_keep_their_derivatives():
    end = ode.solve(race(), ARGS, t1=9.0, wrt="a", ts=[0.5])
    assert end.times is not None
    assert end.times.along("a").ys["x"] == pytest.approx(0.5)
    assert np.isnan(end.along("a").t)


def at_place(**more: Any) -> ode.Problem:
    return ode.Problem(
        {"x": 0.0},
        lambda t, y, args: {"x": args["v"]},
        events={"there": ode.Event(lambda t, y, args: y["x"] - args["place"], 1), **more},
    )


@pytest.mark.parametrize("more", [{}, LATER], ids=["one segment", "hybrid"])
def test_an_event_exactly_at_t1(more):
    more = {name: ode.Event(lambda t, y, args: y["x"] - 5, 1, lambda t, y, args: y) for name in more}
    end = ode.solve(at_place(**more), {"place": 2.0, "v": 2.0}, t1=1.0, wrt=("place", "t1", "v"))
    assert end.ended_by == "there"
    assert np.isnan([end.along(name).t for name in ("place", "t1", "v")]).all()
    still = ode.solve(at_place(**more), {"place": 2.0, "v": 2.0, "unused": 3.0}, t1=1.0, wrt="unused")
    assert (still.along("unused").t, still.along("unused").y["x"]) == (0.0, 0.0)


def test_a_gradient_by_jax_of_an_event_exactly_at_t1():
    def time(args: Any) -> Any:
        return ode.solve(at_place(), args, t1=1.0).t

    found = jax.grad(time)({"place": 2.0, "v": 2.0, "unused": 3.0})
    assert np.isnan([found["place"], found["v"]]).all()
    assert found["unused"] == 0.0


def dosed(rate: float) -> ode.Problem:
    reset = lambda t, y, args: {"u": y["u"] + args["dose"]}  # noqa: E731
    return ode.Problem(
        lambda args: {"u": args["u0"]},
        lambda t, y, args: {"u": rate * y["u"]},
        events={"dose": ode.Event(times=lambda args: [args["when"]], reset=reset)},
    )


@pytest.mark.parametrize("rate", [0.0, -1.0])
def test_a_dose_exactly_at_t1_has_no_derivatives_by_its_time(rate):
    args = {"u0": 2.0, "dose": 0.5, "when": 1.0}
    end = ode.solve(dosed(rate), args, t1=1.0, wrt=("when", "t1", "dose", "u0"))
    assert (end.ended_by, end.y["u"]) == ("t1", pytest.approx(2 * np.exp(rate) + 0.5))
    assert np.isnan([end.along("when").y["u"], end.along("t1").y["u"]]).all()
    assert end.along("dose").y["u"] == pytest.approx(1.0)
    assert end.along("u0").y["u"] == pytest.approx(np.exp(rate))


def test_the_last_of_two_events_that_max_events_allows():
    doses = {
        name: ode.Event(times=lambda args, name=name: [args[name]], reset=lambda t, y, args: {"u": y["u"] + 1})
        for name in ("one", "other")
    }
    problem = ode.Problem({"u": 0.0}, lambda t, y, args: {"u": args["rate"]}, events=doses)
    args = {"one": 1.0, "other": 1.0, "rate": 1.0}
    end = ode.solve(problem, args, t1=9.0, max_events=2, wrt=("one", "other", "rate"))
    assert (end.t, end.y["u"]) == (1.0, 2.0)  # before the second reset
    assert np.isnan([end.along("one").t, end.along("other").t]).all()
    assert end.along("rate").y["u"] == pytest.approx(1.0)
