"""Events at times, events that are recorded, and those of which the n-th ends the motion, against closed forms."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode


def decay(t: Any, y: Any, args: Any) -> Any:
    return {"c": -args["k"] * y["c"]}


def give(t: Any, y: Any, args: Any, index: Any) -> Any:
    return {"c": y["c"] + args["amounts"][index]}


TABLE = ode.Problem(
    lambda args: {"c": args["c0"]}, decay, {"dose": ode.Event(times=lambda args: args["times"], reset=give)}
)
DOSES: dict[str, Any] = {
    "k": 0.3, "c0": 1.0, "times": np.array([4.0, -1.0, 1.0, 2.5, 1e9]), "amounts": np.array([3.0, 5.0, 1.0, 2.0, 9.0]),
}  # fmt: skip
COUNTS = (0, 2, 3)
solved = functools.partial(ode.solve, TABLE, t1=6.0, shared=("times", "amounts"))


def amount(args: Any, t: float = 6.0, counts: Any = COUNTS) -> Any:
    """What is left at t of the start and of the doses that count."""
    given = [(0.0, args["c0"]), *((args["times"][i], args["amounts"][i]) for i in counts)]
    return sum(dose * jnp.exp(-args["k"] * (t - at)) for at, dose in given)


slopes_of_amount = jax.jit(jax.grad(amount), static_argnames="counts")


def alike(found: Any, exact: Any, rtol: float = 1e-9) -> None:
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=1e-11)


@pytest.mark.parametrize("method", ["explicit", "rosenbrock"])
def test_doses_from_a_table(method):
    end = solved(DOSES, wrt="k", method=method)
    alike(end.y["c"], amount(DOSES))
    slopes = slopes_of_amount(DOSES)
    alike(end.along("k").y["c"], slopes["k"], 1e-7)
    alike(end.gradient(y={"c": 1.0}), slopes, 1e-7)
    np.testing.assert_allclose(end.events.t, [1.0, 2.5, 4.0], rtol=1e-12)
    assert list(end.events.name) == ["dose"] * 3


def test_doses_have_derivatives_by_times_in_jax():
    end = lambda args: solved(args).y["c"]  # noqa: E731
    forwards, backwards = jax.jit(lambda args: (jax.jacfwd(end)(args), jax.grad(end)(args)))(DOSES)
    alike([forwards, backwards], [slopes_of_amount(DOSES)] * 2)

    def both(at):
        return DOSES | {"times": jnp.asarray(DOSES["times"]).at[2].set(at), "k": 0.1 + 0.2 * at}

    found, exact = jax.jit(lambda at: [jax.hessian(lambda at, of=of: of(both(at)))(at) for of in (end, amount)])(1.0)
    alike(found, exact, 1e-7)


def test_equal_times_count_in_their_order_and_one_at_the_start_counts():
    """Assignments in place of additions: the last of equal times is what remains."""
    args = DOSES | {"times": np.array([2.0, 0.0, 2.0, 0.0, 2.0])}
    end, exact = solved(args, wrt=("k", "t0")), slopes_of_amount(args, counts=tuple(range(5)))
    alike(end.y["c"], amount(args, counts=range(5)))
    assert end.count == 5
    np.testing.assert_allclose(end.events.t, [0, 0, 2, 2, 2], atol=1e-15)
    alike(end.along("k").y["c"], exact["k"])
    assert np.isnan(end.along("t0").y["c"])  # a moment later two doses are left out
    slopes = end.gradient(y={"c": 1.0})
    np.testing.assert_array_equal(np.isnan(slopes["times"]), args["times"] == 0)
    alike(slopes["times"][::2], exact["times"][::2])
    last = ode.Problem(
        {"c": 0.0}, decay, {"set": ode.Event(times=[2.0, 1.0, 2.0], reset=lambda t, y, args, index: {"c": 1.0 + index})}
    )
    assert ode.solve(last, {"k": 0.0}, t1=3.0).y["c"] == 3.0


def test_doses_are_taken_back_in_time():
    taken = ode.Event(times=[1.0, 4.0], reset=lambda t, y, args, index: {"c": y["c"] - 10.0 * t - index})
    end = ode.solve(ode.Problem({"c": 200.0}, decay, {"dose": taken}), {"k": 0.3}, t0=5.0, t1=0.0, wrt="k")
    exact = lambda k: (200.0 * jnp.exp(k) - 41.0) * jnp.exp(4 * k) - 10 * jnp.exp(k)  # noqa: E731
    alike([end.y["c"], end.along("k").y["c"]], jax.jit(jax.value_and_grad(exact))(0.3))
    np.testing.assert_allclose(end.events.t, [4.0, 1.0], rtol=1e-12)


def test_times_may_differ_from_lane_to_lane_and_the_third_may_end_the_motion():
    at = lambda args: [args["a"] + 2 * args["d"], args["a"], args["a"] + args["d"], jnp.inf]  # noqa: E731
    driven = ode.Problem(
        {"c": 1.0},
        lambda t, y, args: {"c": -args["k"] * y["c"] + jnp.where(t > args["on"], 1.0, 0.0)},
        {"dose": ode.Event(times=at, reset=lambda t, y, args: {"c": y["c"] + 1.0}, terminal=3)},
    )
    args = {"k": 0.3, "on": 1.7, "a": np.array([1.0, 1.5, 3.0]), "d": 2.0}
    end = ode.solve(driven, args, t1=99.0, wrt=("on", "a", "d"), derivatives=2)

    def exact(args):
        t = args["a"] + 2 * args["d"]
        given = [1.0 * jnp.exp(-args["k"] * (t - since)) for since in (0.0, args["a"], args["a"] + args["d"])]
        return sum(given) + (1 - jnp.exp(-args["k"] * (t - args["on"]))) / args["k"]

    assert list(end.ended_by) == ["dose"] * 3
    alike(end.t, args["a"] + 4.0)
    every = jax.jit(lambda own: (exact(own), jax.grad(exact)(own), jax.hessian(exact)(own)))
    for i, a in enumerate(args["a"]):
        value, slopes, curves = every(args | {"a": a})
        alike(end.y["c"][i], value)
        for one in end.wrt:
            alike(end.along(one).y["c"][i], slopes[one])
            for other in end.wrt:
                alike(end.along(one, other).y["c"][i], curves[one][other], 1e-7)
    np.testing.assert_allclose(end.along("d").t, 2.0)


def test_a_time_that_is_no_number_fails_and_one_that_never_comes_does_not():
    late = ode.Problem({"c": 1.0}, decay, {"dose": ode.Event(times=lambda args: [jnp.log(args["a"]), jnp.inf])})
    end = ode.solve(late, {"k": 0.3, "a": np.array([-1.0, 0.5, 2.0])}, t1=2.0)
    assert list(end.ended_by) == ["failed", "t1", "dose"]
    assert any("events['dose'].times" in warning for warning in end.warnings)


def test_a_time_may_end_the_motion_also_at_its_start():
    stop = ode.Problem({"c": 1.0}, decay, {"stop": ode.Event(times=lambda args: args["t"])})
    end = ode.solve(stop, {"k": 0.3, "t": np.array([0.0, 1.0, 9.0])}, t1=2.0, wrt=("t", "k"))
    assert list(end.ended_by) == ["stop", "stop", "t1"]
    alike([end.t, end.y["c"]], [np.array([0, 1, 2]), np.exp(-0.3 * np.array([0, 1, 2]))])
    alike(end.along("t").t, np.array([np.nan, 1, 0]))
    alike(end.gradient(t=1.0)["t"], np.array([np.nan, 1, 0]))
    alike(end.along("k").y["c"], -end.t * end.y["c"])


@pytest.mark.parametrize("times", [[], lambda args: np.zeros(0)])
def test_there_may_be_no_times(times):
    end = ode.solve(ode.Problem({"c": 1.0}, decay, {"dose": ode.Event(times=times)}), {"k": 1.0}, t1=1.0)
    assert (end.ended_by, end.y["c"]) == ("t1", pytest.approx(np.exp(-1.0), rel=1e-9))


@pytest.mark.parametrize("times", ["noon", lambda args: "noon", lambda args: None, lambda args: args["no"]])
def test_times_must_be_numbers(times):
    with pytest.raises((TypeError, ValueError), match="times"):
        ode.solve(ode.Problem({"c": 1.0}, decay, {"dose": ode.Event(times=times)}), {"k": 1.0}, t1=1.0)


def oscillator(**events: ode.Event) -> ode.Problem:
    """x = sin(ω t)."""
    field = lambda t, y, args: {"x": y["v"], "v": -(args["w"] ** 2) * y["x"]}  # noqa: E731
    return ode.Problem(lambda args: {"x": 0.0, "v": args["w"]}, field, events)


def place(t: Any, y: Any, args: Any) -> Any:
    return y["x"]


def test_events_that_do_not_end_the_motion_are_recorded():
    w, ways = np.array([1.0, 2.0]), {"both": (0, [1, 2, 3, 4]), "falls": (-1, [1, 3]), "rises": (1, [2, 4])}
    events = {name: ode.Event(place, direction, terminal=False) for name, (direction, _) in ways.items()}
    end = ode.solve(oscillator(**events), {"w": w}, t1=4.5 * np.pi / w, wrt="w")
    np.testing.assert_array_equal(end.count, 8)
    assert list(end.ended_by) == ["t1", "t1"]
    for name, (_, zeros) in ways.items():
        times = end.events.t[end.events.name == name].reshape(2, -1)
        np.testing.assert_allclose(times, np.pi * np.array(zeros) / w[:, None], rtol=1e-9)
    np.testing.assert_allclose(end.y["x"], 1.0, rtol=1e-9)
    np.testing.assert_allclose(end.along("w").y["v"], -end.t * w, rtol=1e-8)
    slopes = end.gradient(y={"x": 0.0, "v": 1.0})
    np.testing.assert_allclose(slopes["w"], -end.t * w, rtol=1e-7)


@pytest.mark.parametrize("terminal", [False, 2])
def test_states_before_the_start_go_through_events_that_go_on(terminal):
    """At ω = 2 the second zero before the start, at -π, ends the motion back, if it is to end it."""
    ts = np.array([-4.0, -3.0, -1.0, 0.5])
    end = ode.solve(oscillator(zero=ode.Event(place, terminal=terminal)), {"w": 2.0}, t1=1.0, ts=ts, wrt="w")
    there = ts > (-np.pi if terminal else -np.inf)
    alike(end.ys["x"], np.where(there, np.sin(2 * ts), np.nan))
    assert end.times is not None
    alike(end.times.along("w").ys["x"], np.where(there, ts * np.cos(2 * ts), np.nan))


@pytest.mark.parametrize(("n", "t1"), [(np.int64(3), 99.0), (2, -99.0)])
def test_the_nth_of_an_event_may_end_the_motion(n, t1):
    both = oscillator(zero=ode.Event(place, terminal=n), all=ode.Event(place, terminal=False))
    end = ode.solve(both, {"w": 2.0}, t1=t1, wrt="w", derivatives=2)
    exact = np.sign(t1) * n * np.pi / 2.0
    assert end.ended_by == "zero"
    alike([end.t, end.along("w").t, end.along("w", "w").t], [exact, -exact / 2, exact / 2], 1e-8)
    assert end.count == 2 * n - 1  # at the last the first of the dictionary ends the motion
    assert end.at_once["all"]
    alike(end.gradient(t=1.0)["w"], -exact / 2, 1e-7)


def test_the_last_of_an_event_has_no_reset():
    """Of bounces with half the speed the third ends the motion as it comes."""
    bounce = ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -y["v"] / 2}, terminal=3)
    ball = ode.Problem({"y": 1.0, "v": 0.0}, lambda t, y, args: {"y": y["v"], "v": -2.0}, {"bounce": bounce})
    end = ode.solve(ball, t1=99.0)
    alike([end.t, end.y["v"], end.count], [1.0 + 1.0 + 0.5, -0.5, 3])
    assert ode.solve(ball, t1=99.0, max_events=2).t == pytest.approx(2.0)


def test_a_scale_is_that_of_the_states_own_numbers():
    """What events and switches add to the state has no size; u oscillates at a millionth, and need not be known."""
    field = lambda t, y, args: {"u": 1e-6 * 50 * jnp.cos(50 * t) + 0 * y["w"], "w": -y["w"]}  # noqa: E731
    push = lambda t, y, args: field(t, y, args) | {"w": jnp.where(t > 50.0, 1.0, -y["w"])}  # noqa: E731
    never = {"a": ode.Event(lambda t, y, args: t - 99.0, terminal=False)}
    at_times = {"a": ode.Event(times=[99.0], terminal=False), "b": ode.Event(lambda t, y, args: t - 99.0, terminal=2)}
    trials = [
        ode.solve(ode.Problem({"u": 0.0, "w": 1.0}, rates, events), t1=9.0, state_scale={"u": 1e3, "w": 1e-3}).trials
        for rates, events in ((field, never), (field, at_times), (push, never))
    ]
    assert trials[0] < 60
    assert max(trials) <= 1.1 * min(trials)


COUNTED = ode.Problem(
    {"x": 0.0},
    lambda t, y, args: {"x": 0.0},
    {"dose": ode.Event(times=lambda args: args["times"], reset=lambda t, y, args: {"x": y["x"] + 1.0})},
)
GAPS = [0.0, *10.0 ** np.arange(-16, -5.5, 0.5)]


def doses(times: Any, t0: float, t1: float) -> None:
    """All doses that are due, and no other."""
    ahead = np.sign(t1 - t0)
    due = np.sum((ahead * (times - t0) >= 0) & (ahead * (t1 - times) >= 0), axis=-1)
    args = {"times": list(np.moveaxis(times, -1, 0)) if times.ndim > 1 else times}
    end = ode.solve(COUNTED, args, t0=t0, t1=t1, max_events=1000, shared=("times",) * (times.ndim == 1))
    np.testing.assert_array_equal(end.count, due)
    np.testing.assert_array_equal(end.y["x"], due)
    assert np.all(np.asarray(end.ended_by) == "t1")


@pytest.mark.parametrize("t0", [0.3, 0.6, 0.7, 1.2, 1.4])
def test_the_first_dose_may_be_an_ulp_behind_the_start(t0):
    doses(np.arange(201) * 0.1, t0, 30.0)
    doses(np.array([0.1 * 3, 1.0, 2.0]), t0, 20.0)


@pytest.mark.parametrize(("t0", "t1"), [(0.0, 5.0), (0.0, 1e6), (1.0, 5.0), (1000.0, 1001.0), (0.0, -5.0), (4.0, -1.0)])
def test_the_first_dose_may_be_close_behind_the_start(t0, t1):
    ahead = np.sign(t1 - t0)
    rows = [[t0 + ahead * gap, t0 + ahead * 0.4, t0 + ahead * 0.7] for gap in GAPS]
    doses(np.array(rows), t0, t1)


@pytest.mark.parametrize("b", [1.0, 3.0, 100.0, 1000.0])
@pytest.mark.parametrize("ahead", [1, -1])
def test_a_dose_may_be_close_behind_another(b, ahead):
    rows = ahead * b * np.array([[1.0, 1.0 + gap, 1.0 + 2 * gap, 1.2, 1.3, 1.4] for gap in GAPS])
    doses(rows, 0.0, ahead * 1.5 * b)
    doses(rows, ahead * 0.9 * b, ahead * 1e4 * b)


@pytest.mark.parametrize("t1", [3.0, -3.0])
def test_a_dose_may_be_close_to_the_end(t1):
    """One later than the end counts if rounding may hide it."""
    doses(t1 * np.array([[0.5, 0.7, 1.0 - gap] for gap in GAPS]), 0.0, t1)
    doses(t1 * np.array([[0.5, 0.7, 1.0 + gap] for gap in GAPS if gap > 1e-13]), 0.0, t1)


def test_doses_of_two_schedules_that_round_differently():
    doses(np.concatenate([np.arange(1.0, 101.0), np.cumsum(np.full(101001, 0.001))[999::1000]]), 0.0, 100.5)
    third = ode.Problem({"c": 1.0}, decay, {"dose": ode.Event(times=[1, 1 + 1e-11, 2, 3], terminal=3)})
    assert ode.solve(third, {"k": 1.0}, t1=9.0).t == 2.0


@pytest.mark.parametrize("at", [0.0, 1.0])
def test_many_doses_may_have_one_time(at):
    doses(np.full(201, at), 0.0, 2.0)


@pytest.mark.parametrize("gap", [1e-13, 1e-9])
def test_doses_close_together_have_derivatives_of_their_own(gap):
    args = DOSES | {"times": np.array([gap, -1.0, 1.0, 1.0 + gap, 1e9])}
    end = solved(args, wrt=("k", "t0"))
    slopes = slopes_of_amount(args)
    alike([end.y["c"], end.along("k").y["c"]], [amount(args), slopes["k"]])
    alike(end.along("t0").y["c"], 0.3 * np.exp(-0.3 * 6.0))
    alike(end.gradient(y={"c": 1.0}), slopes, 1e-7)
