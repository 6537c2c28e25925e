"""Two things end a motion at one time: a derivative is a number where both agree on it, and NaN where they do not."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

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


NAN = float("nan")
METHODS = ["explicit", "rosenbrock"]


def thrown(**more: Any) -> ode.Problem:
    """A ball that rebounds at `place`, which it reaches at 1; a tank fills, one rests and one decays beside it."""
    return ode.Problem(
        lambda args: {"x": 0.0, "v": args["v"], "fill": 0.0, "rest": args["rest"], "decay": 1.0},
        lambda t, y, args: {
            "x": y["v"],
            "v": 0.0 * y["v"],
            "fill": args["c"],
            "rest": 0.0 * y["rest"],
            "decay": -args["c"] * y["decay"],
        },
        events={
            "wall": ode.Event(lambda t, y, args: y["x"] - args["place"], 1, lambda t, y, args: y | {"v": -y["v"] / 2}),
            **more,
        },
    )


THROW = {"v": 2.0, "place": 2.0, "rest": 3.0, "c": 1.5}


def agrees(end: ode.Solution, name: str, t: float, y: dict[str, float]) -> None:
    """Derivatives by a number, NaN included."""
    part = end.along(name)
    np.testing.assert_allclose([part.t, *(part.y[key] for key in y)], [t, *y.values()], rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_of_a_rebound_exactly_at_t1_what_does_not_rebound_keeps_its_derivatives(method):
    end = ode.solve(thrown(), THROW, t1=1.0, wrt=(*THROW, "t1"), method=method)
    assert (end.ended_by, end.count, end.y["v"]) == ("t1", 1, -1.0)
    e = np.exp(-1.5)
    for name in ("v", "place"):
        agrees(end, name, 0.0, {"x": NAN, "v": NAN, "fill": 0.0, "rest": 0.0, "decay": 0.0})
    agrees(end, "t1", 1.0, {"x": NAN, "v": NAN, "fill": 1.5, "rest": 0.0, "decay": -1.5 * e})
    agrees(end, "c", 0.0, {"x": 0.0, "v": 0.0, "fill": 1.0, "rest": 0.0, "decay": -e})
    agrees(end, "rest", 0.0, {"x": 0.0, "v": 0.0, "fill": 0.0, "rest": 1.0, "decay": 0.0})
    assert len(end.warnings) == 3


def test_second_derivatives_of_a_rebound_exactly_at_t1():
    end = ode.solve(thrown(), THROW, t1=1.0, wrt=("v", "c"), derivatives=2)
    for names, decay in [(("v", "v"), 0.0), (("v", "c"), 0.0), (("c", "c"), np.exp(-1.5))]:
        part = end.along(*names)
        assert np.isnan(part.y["x"]) == ("v" in names)
        np.testing.assert_allclose([part.t, part.y["fill"], part.y["decay"]], [0.0, 0.0, decay], atol=1e-9)


def test_gradients_of_a_rebound_exactly_at_t1():
    def of(key: str) -> Any:
        return jax.grad(lambda args: ode.solve(thrown(), args, t1=1.0).y[key])(THROW)

    fill, x = of("fill"), of("x")
    np.testing.assert_allclose([fill[name] for name in THROW], [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose([x[name] for name in THROW], [NAN, NAN, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_rebound_and_a_dose_exactly_at_t1_have_no_derivatives_by_the_rebounds_time(method):
    dose = ode.Event(times=lambda args: [args["when"]], reset=lambda t, y, args: y | {"rest": y["rest"] + 1})
    args = THROW | {"when": 1.0}
    end = ode.solve(thrown(dose=dose), args, t1=1.0, wrt=("v", "place", "when"), method=method)
    assert (end.count, end.y["v"], end.y["rest"]) == (2, -1.0, 4.0)
    assert np.isnan([end.along(name).y[key] for name in ("v", "place") for key in ("x", "v")]).all()
    assert np.isnan(end.along("when").y["rest"])
    assert all(end.along(name).y["fill"] == pytest.approx(0.0, abs=1e-12) for name in ("v", "place", "when"))


@pytest.mark.parametrize("method", METHODS)
def test_of_two_terminal_events_outputs_that_rest_keep_their_derivatives(method):
    runners = race()
    problem = ode.Problem(
        lambda args: {"x": 0.0, "y": 0.0, "rest": args["both"]},
        lambda t, y, args: {**runners.vector_field(t, y, args), "rest": 0.0 * y["rest"]},
        events=runners.events,
    )
    end = ode.solve(problem, ARGS, t1=9.0, wrt=("a", "both"), method=method)
    agrees(end, "a", NAN, {"x": NAN, "y": NAN, "rest": 0.0})
    agrees(end, "both", -1.0, {"x": 0.0, "y": 0.0, "rest": 1.0})
    by = jax.grad(lambda args: ode.solve(problem, args, t1=9.0, method=method).y["rest"])(ARGS)
    assert (by["a"], by["b"], by["both"]) == (0.0, 0.0, 1.0)
    if method == "explicit":
        curved = ode.solve(problem, ARGS, t1=9.0, wrt=("a", "both"), derivatives=2)
        found = [curved.along(*names).y for names in (("a", "a"), ("a", "both"), ("both", "both"))]
        assert [float(y["rest"]) for y in found] == [0.0, 0.0, 0.0]
        assert np.isnan([y["x"] for y in found[:2]]).all()


def dosed_twice() -> ode.Problem:
    """At `one` u gains 1, at `other` it doubles; a depends on u, b does not, and "late" comes where b reaches 2."""
    return ode.Problem(
        {"u": 1.0, "a": 0.0, "b": 0.0, "n": 0.0},
        lambda t, y, args: {"u": -y["u"], "a": y["u"], "b": args["rate"], "n": 0.0},
        events={
            "one": ode.Event(times=lambda args: [args["one"]], reset=lambda t, y, args: y | {"u": y["u"] + 1}),
            "other": ode.Event(times=lambda args: [args["other"]], reset=lambda t, y, args: y | {"u": 2 * y["u"]}),
            "late": ode.Event(lambda t, y, args: y["b"] - 2, 1, lambda t, y, args: y | {"n": y["n"] + y["b"]}),
        },
    )


@pytest.mark.parametrize("method", METHODS)
def test_of_resets_whose_order_matters_what_does_not_depend_on_it_keeps_its_derivatives(method):
    args = {"one": 1.0, "other": 1.0, "rate": 1.0}
    end = ode.solve(dosed_twice(), args, t1=3.0, wrt=(*args, "t1"), ts=[0.5, 1.5, 2.5], method=method)
    u = 2 * (np.exp(-1) + 1) * np.exp(-2)
    assert end.y["u"] == pytest.approx(u)
    assert end.times is not None
    for name in ("one", "other"):
        agrees(end, name, 0.0, {"u": NAN, "a": NAN, "b": 0.0, "n": 0.0})
        ys = end.times.along(name).ys
        np.testing.assert_allclose(ys["u"], [0.0, NAN, NAN])
        np.testing.assert_allclose(ys["b"], [0.0] * 3, atol=1e-9)
    agrees(end, "rate", 0.0, {"u": 0.0, "a": 0.0, "b": 3.0, "n": 0.0})
    agrees(end, "t1", 1.0, {"u": -u, "a": u, "b": 1.0, "n": 0.0})
    assert len(end.warnings) == 2
    events = end.events.along("one")
    np.testing.assert_allclose(events.t, [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(events.y["u"][[0, 2]], [-np.exp(-1), NAN])
    np.testing.assert_allclose(events.y["b"], [1.0, 0.0, 0.0], atol=1e-9)


def test_an_event_whose_time_depends_on_the_order_of_resets_has_no_derivatives():
    problem = dosed_twice()
    full = ode.Event(lambda t, y, args: y["a"] - 2, 1, lambda t, y, args: y | {"n": 1.0})
    problem = ode.Problem(problem.y0, problem.vector_field, {**problem.events, "full": full})
    args = {"one": 1.0, "other": 1.0, "rate": 1.0}
    end = ode.solve(problem, args, t1=1.5, wrt="one", derivatives=2)
    agrees(end, "one", 0.0, {"u": NAN, "a": NAN, "b": 0.0, "n": 0.0})
    np.testing.assert_allclose(end.along("one", "one").y["b"], 0.0, atol=1e-9)
    assert np.isnan(end.along("one", "one").y["a"])
    later = ode.solve(problem, args, t1=1.8, wrt=("one", "rate"))
    assert list(later.events.name) == ["one", "other", "full"]
    np.testing.assert_allclose(later.events.along("one").t, [1.0, 0.0, NAN], atol=1e-9)
    np.testing.assert_allclose(later.events.along("rate").t, [0.0, 0.0, 0.0], atol=1e-9)
    assert np.isnan(later.along("one").y["u"])


def test_gradients_of_resets_whose_order_matters():
    args = {"one": 1.0, "other": 1.0, "rate": 1.0}

    def of(key: str) -> Any:
        by = jax.grad(lambda args: ode.solve(dosed_twice(), args, t1=3.0).y[key])(args)
        return [by[name] for name in args]

    np.testing.assert_allclose(of("b"), [0.0, 0.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(of("a"), [NAN, NAN, 0.0], atol=1e-9)


KEYS = ("u", "w", "a")
RATES = np.array([[-1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [1.0, 0.0, 0.0]])
"""Of u, w and a: u decays, w grows, a is fed by u."""
REACHED = np.linalg.inv(np.eye(3) - RATES) != 0
"""Which numbers a change of each number reaches later."""
EVENTS = 4
LINEAR = {
    "u + 1": {"u": 1.0}, "2 u": {"uu": 2.0}, "w + 1": {"w": 1.0}, "3 w": {"ww": 3.0}, "w + u": {"wu": 1.0},
    "a + 1": {"a": 1.0}, "u + w": {"uw": 1.0}, "u to 0": {"uu": 0.0}, "none": {},
}  # fmt: skip
"""What differs in a reset from the one that changes nothing."""
NOTHING = {"uu": 1.0, "uw": 0.0, "wu": 0.0, "ww": 1.0, "u": 0.0, "w": 0.0, "a": 0.0}


def linear_resets(by_times: bool) -> ode.Problem:
    def event(i: int) -> ode.Event:
        def reset(t: Any, y: Any, args: Any) -> Any:
            (a, b, c, d), (u, w) = (args[f"{name}_{i}"] for name in ("uu", "uw", "wu", "ww")), (y["u"], y["w"])
            more = [args[f"{key}_{i}"] for key in KEYS]
            return {"u": a * u + b * w + more[0], "w": c * u + d * w + more[1], "a": y["a"] + more[2]}

        if by_times:
            return ode.Event(times=lambda args: [args[f"at{i}"]], reset=reset)
        return ode.Event(lambda t, y, args: t - args[f"at{i}"], 1, reset)

    return ode.Problem(
        {"u": 1.0, "w": 2.0, "a": 0.5},
        lambda t, y, args: {"u": -y["u"], "w": 0.5 * y["w"], "a": y["u"]},
        events={f"e{i}": event(i) for i in range(EVENTS)},
    )


def random_resets(lanes: int, seed: int) -> tuple[dict[str, np.ndarray], list[list[int]]]:
    """Numbers of lanes, and of each the events at once: two to four of the four, at 1; the others come before."""
    random = np.random.default_rng(seed)
    columns: dict[str, list[float]] = {}
    groups = []
    for lane in range(lanes):
        # Most of the groups have resets whose order matters, and often the reverse order alone does not show it.
        names = random.choice(list(LINEAR), EVENTS) if lane % 3 else random.choice(["u + 1", "2 u", "u + w"], EVENTS)
        kinds = [LINEAR[name] for name in names]
        groups.append(sorted(random.choice(EVENTS, 2 + lane % 3, replace=False).tolist()))
        for i, kind in enumerate(kinds):
            columns.setdefault(f"at{i}", []).append(1.0 if i in groups[-1] else 0.2 + 0.1 * i)
            for name, number in (NOTHING | kind).items():
                columns.setdefault(f"{name}_{i}", []).append(number)
    return {name: np.array(column) for name, column in columns.items()}, groups


def by_all_orders(args: dict[str, float], group: list[int], t1: float) -> np.ndarray:
    """∂y/∂tᵢ at t1, shape (3, 4), by brute force: NaN where two orders of the events at 1 differ."""
    m, b = [np.eye(3) for _ in range(EVENTS)], [np.array([args[f"{key}_{i}"] for key in KEYS]) for i in range(EVENTS)]
    for i in range(EVENTS):
        m[i][:2, :2] = [[args[f"{row}{column}_{i}"] for column in "uw"] for row in "uw"]
    before = sorted((i for i in range(EVENTS) if i not in group), key=lambda i: args[f"at{i}"])
    states, changes = [], []
    for order in itertools.permutations(group):
        y, change, now = np.array([1.0, 2.0, 0.5]), np.zeros((3, EVENTS)), 0.0
        for i in (*before, *order):
            flow = expm(RATES * (args[f"at{i}"] - now))
            y, change, now = flow @ y, flow @ change, args[f"at{i}"]
            change = m[i] @ change
            change[:, i] += m[i] @ RATES @ y - RATES @ (m[i] @ y + b[i])
            y = m[i] @ y + b[i]
        states.append(y)
        changes.append(change)
    jumps = np.ptp(states, axis=0) > 1e-9
    lost = (np.ptp(changes, axis=0) > 1e-9) | jumps[:, None]
    lost[:, before] = False  # these move alone
    later = expm(RATES * (t1 - 1.0))
    return np.where((REACHED @ lost) > 0, np.nan, later @ changes[0])


@pytest.mark.parametrize(("by_times", "method"), [(True, "explicit"), (False, "explicit"), (True, "rosenbrock")])
def test_derivatives_of_random_resets_at_once_are_those_of_all_orders(by_times, method):
    args, groups = random_resets(60, 5 + by_times)
    wrt = [f"at{i}" for i in range(EVENTS)]
    end = ode.solve(linear_resets(by_times), args, t1=1.5, wrt=wrt, method=method)
    found = np.array([[end.along(name).y[key] for name in wrt] for key in KEYS])
    expected = np.stack(
        [by_all_orders({name: each[k] for name, each in args.items()}, groups[k], 1.5) for k in range(60)], axis=-1
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    assert 0.1 < np.isnan(found).mean() < 0.9


def test_a_gradient_of_three_resets_of_which_the_reverse_order_gives_the_same():
    kinds = enumerate(("u + 1", "2 u", "u + 1", "none"))
    args = {f"{name}_{i}": number for i, kind in kinds for name, number in (NOTHING | LINEAR[kind]).items()}
    times = {"at0": 1.0, "at1": 1.0, "at2": 1.0, "at3": 0.5}
    by = jax.grad(lambda times: ode.solve(linear_resets(by_times=True), args | times, t1=1.5).y["a"])(times)
    np.testing.assert_allclose([by[name] for name in times], [NAN, NAN, NAN, 0.0], atol=1e-7)


def test_of_seven_events_at_once_derivatives_by_the_time_of_one_are_nan():
    reset = lambda t, y, args: {"u": y["u"] + args["dose"]}  # noqa: E731
    events = {f"e{i}": ode.Event(times=lambda args, i=i: [args[f"at{i}"]], reset=reset) for i in range(7)}
    problem = ode.Problem({"u": 0.0}, lambda t, y, args: {"u": 0.0}, events=events)
    args = {f"at{i}": 1.0 for i in range(7)} | {"dose": 2.0}
    end = ode.solve(problem, args, t1=2.0, wrt=("at3", "dose"))
    assert np.isnan(end.along("at3").y["u"])
    assert end.along("dose").y["u"] == 7.0
    six = ode.solve(problem, args | {"at0": 0.5}, t1=2.0, wrt=("at3", "dose"))
    assert (six.along("at3").y["u"], six.along("dose").y["u"]) == (0.0, 7.0)
    # The first ends the lane: it would be another one if that came sooner.
    first = ode.solve(problem, args, t1=2.0, wrt=("at0", "at6"), max_events=1)
    assert np.isnan([first.along(name).t for name in ("at0", "at6")]).all()


def test_of_six_resets_in_two_orders_derivatives_are_nan_where_the_order_matters():
    kinds = ("u + 1", "a + 1", "a + 1", "a + 1", "a + 1", "2 u")

    def event(i: int) -> ode.Event:
        up, twice = float(kinds[i] == "u + 1"), 1.0 + (kinds[i] == "2 u")
        return ode.Event(
            times=lambda args: [args[f"at{i}"]],
            reset=lambda t, y, args: {"u": twice * y["u"] + up, "a": y["a"] + (kinds[i] == "a + 1"), "w": y["w"]},
        )

    problem = ode.Problem(
        {"u": 1.0, "a": 0.0, "w": 1.0}, lambda t, y, args: {"u": 0.0, "a": 0.0, "w": -args["rate"] * y["w"]},
        events={f"e{i}": event(i) for i in range(6)},
    )  # fmt: skip
    args = {f"at{i}": 1.0 for i in range(6)} | {"rate": 0.5}
    end = ode.solve(problem, args, t1=2.0, wrt=("at0", "at1", "rate"))
    assert np.isnan(end.along("at0").y["u"])
    np.testing.assert_allclose([end.along("at0").y[name] for name in "aw"], 0.0, atol=1e-12)
    np.testing.assert_allclose([end.along("rate").y[name] for name in "uaw"], [0, 0, -2 * np.exp(-1)], rtol=1e-9)


def test_beside_a_switch_that_is_one_too_many_the_time_of_a_lane_that_goes_on_has_derivatives():
    events = {
        f"e{i}": ode.Event(times=lambda args: [args["at"]], reset=lambda t, y, args: {"u": y["u"] + 1.0})
        for i in range(6)
    }
    problem = ode.Problem({"u": 0.0}, lambda t, y, args: {"u": jnp.where(t < args["c"], 1.0, 2.0)}, events=events)
    end = ode.solve(problem, {"at": 1.0, "c": 1.0}, t1=2.0, wrt=("at", "c"))
    assert (end.along("at").t, end.along("c").t) == (0.0, 0.0)
    assert np.isnan(end.along("c").y["u"])
