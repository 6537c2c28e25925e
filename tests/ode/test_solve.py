"""What `ode.solve` gives: each number against a closed form, or scipy's DOP853 at 1e-12."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from erosion import ode
from erosion.ode.batch import integrate

CLOSE: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-12}
SLOPES: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10}
CURVES: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-8}


def oscillator(*directions: int, **more: Any) -> ode.Problem:
    """x = x0 cos(t - t0) + v0 sin(t - t0); an event for each direction where x is zero."""
    return ode.Problem(
        y0=lambda args: {"x": args["x0"], "v": args["v0"]},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -y["x"]},
        events={f"zero{way:+d}": ode.Event(lambda t, y, args: y["x"], way) for way in directions},
        **more,
    )


FALLS, RISES, EITHER = (oscillator(way) for way in (-1, 1, 0))
STARTS = {"x0": np.array([0.0, 0.0, np.sin(np.pi), -np.sin(np.pi), -1.0, 1.0]), "v0": np.array([1.0, -1, 1, -1, 0, 0])}

# x = s (t - t0): an event function of any speed, exact in floating point.
LINE = ode.Problem(
    y0={"x": 0.0},
    vector_field=lambda t, y, args: {"x": args["speed"]},
    events={
        "one": ode.Event(lambda t, y, args: y["x"] - 1, 1),
        "other": ode.Event(lambda t, y, args: args["other"] - y["x"], -1),
    },
    integrals={"area": lambda t, y, args: y["x"]},
)

# dx/dt = -x t, so that x = x0 exp(-(t² - t0²)/2); it falls to c at t = √(t0² + 2 ln(x0/c)).
TIMED = ode.Problem(
    y0=lambda args: args["x0"],
    vector_field=lambda t, y, args: -t * y,
    events={"low": ode.Event(lambda t, y, args: y - args["c"], -1)},
    integrals={"moment": lambda t, y, args: t * y},
)


@pytest.mark.parametrize(
    ("problem", "times"),
    [
        (FALLS, [np.pi, 2 * np.pi, np.pi, 2 * np.pi, 1.5 * np.pi, np.pi / 2]),
        (RISES, [2 * np.pi, np.pi, 2 * np.pi, np.pi, np.pi / 2, 1.5 * np.pi]),
        (EITHER, [np.pi, np.pi, np.pi, np.pi, np.pi / 2, np.pi / 2]),
    ],
)
def test_an_event_waits_until_its_function_has_returned(problem, times):
    end = ode.solve(problem, STARTS, t1=10.0)
    assert set(end.ended_by) == set(problem.events)
    np.testing.assert_allclose(end.t, times, **CLOSE)
    np.testing.assert_array_equal(end.count, 1)


@pytest.mark.parametrize(
    ("problem", "starts"),
    [
        (FALLS, [False, True, False, True, True, False]),
        (RISES, [True, False, True, False, False, True]),
        (EITHER, [False] * 6),
    ],
)
def test_a_lane_at_or_beyond_its_event_may_end_at_its_start(problem, starts):
    end = ode.solve(problem, STARTS, t1=10.0, start="end")
    np.testing.assert_array_equal(end.ended_by == "start", starts)
    np.testing.assert_array_equal(end.t[starts], 0.0)
    np.testing.assert_array_equal(end.y["x"][starts], STARTS["x0"][starts])
    np.testing.assert_allclose(end.t[~np.array(starts)], ode.solve(problem, STARTS, t1=10.0).t[~np.array(starts)])


def test_a_lane_that_rests_on_its_event_waits_for_ever():
    end = ode.solve(EITHER, {"x0": 0.0, "v0": 0.0}, t1=10.0)
    assert end.ended_by == "t1"
    assert ode.solve(EITHER, {"x0": 0.0, "v0": 0.0}, t1=10.0, start="end").ended_by == "start"


@pytest.mark.parametrize("start", ["wait", "end"])
def test_lanes_that_fail_leave_the_others_as_they_are(start):
    bad = np.array([np.nan, np.inf, -np.inf, 1e300])
    x0 = np.concatenate([np.linspace(0.5, 1.5, 20), bad, np.linspace(1.5, 2, 9)])
    good = x0[np.abs(x0) < 1e100]
    wrt: dict[str, Any] = {"wrt": "x0", "derivatives": 1, "start": start}
    alone = ode.solve(FALLS, {"x0": good, "v0": 0.3}, t1=10.0, **wrt)
    mixed = ode.solve(FALLS, {"x0": x0, "v0": 0.3}, t1=10.0, **wrt)
    np.testing.assert_array_equal(mixed.ended_by[20:23], "failed")
    assert np.isnan(mixed.t[20:23]).all()
    kept = np.abs(x0) < 1e100
    for one, other in ((alone, mixed), (alone.along("x0"), mixed.along("x0"))):
        np.testing.assert_array_equal(one.t, other.t[kept])
        np.testing.assert_array_equal(one.y["v"], other.y["v"][kept])


def test_an_event_function_that_is_no_number_at_the_start_fails_its_lane_alone():
    """Where it is none later the motion ends before that."""
    logarithm = ode.Problem(
        lambda args: {"x": args["x0"]},
        lambda t, y, args: {"x": -1.0},
        {"low": ode.Event(lambda t, y, args: jnp.log(y["x"]) + 2.0)},
    )
    end = ode.solve(logarithm, {"x0": np.array([1.0, -1.0, 2.0])}, t1=5.0)
    np.testing.assert_array_equal(end.ended_by, ["low", "failed", "low"])
    np.testing.assert_allclose(end.t, [1 - np.exp(-2), np.nan, 2 - np.exp(-2)], rtol=1e-9)


@pytest.mark.parametrize("t1", [6.0, 1e7])
def test_a_motion_at_rest_is_pushed_at_a_time(t1):
    """The step response of an oscillator: 4x = 1 - e^-st (cos wt + s/w sin wt), w² = 4 - s²."""
    s, on = 0.2, np.linspace(0.3, 3.0, 7)
    pushed = ode.Problem(
        {"x": 0.0, "v": 0.0},
        lambda t, y, args: {
            "x": y["v"],
            "v": jnp.where(t < args["on"], 0.0, 1.0) - 4 * y["x"] - 2 * s * y["v"],
        },
        {"up": ode.Event(lambda t, y, args: y["x"] - 0.1, direction=1)},
    )
    end = ode.solve(pushed, {"on": on}, t1=t1)
    w, t = np.sqrt(4 - s**2), end.t - on
    np.testing.assert_array_equal(end.ended_by, "up")
    np.testing.assert_allclose((1 - np.exp(-s * t) * (np.cos(w * t) + s / w * np.sin(w * t))) / 4, 0.1, rtol=1e-9)


def test_a_fast_part_after_a_slow_start_is_exact_where_rates_may_have_kinks():
    """A comet from its aphelion past the sun and back, in 2 π; `maximum` counts as a kink, and is none."""
    e = 0.99999

    def rates(t, y, args):
        cube = jnp.maximum(y["x"] ** 2 + y["y"] ** 2, 1e-30) ** 1.5
        return {"x": y["u"], "y": y["v"], "u": -y["x"] / cube, "v": -y["y"] / cube}

    comet = ode.Problem({"x": 1 + e, "y": 0.0, "u": 0.0, "v": np.sqrt((1 - e) / (1 + e))}, rates)
    end = ode.solve(comet, t1=2 * np.pi)
    np.testing.assert_allclose([end.y["x"], end.y["y"]], [1 + e, 0.0], rtol=0, atol=1e-8)


def test_of_events_at_once_the_first_by_order_counts_and_all_are_told():
    end = ode.solve(LINE, {"speed": 1.0, "other": np.array([1.0, 0.5, 2.0])}, t1=10.0)
    assert list(end.ended_by) == ["one", "other", "one"]
    np.testing.assert_array_equal(end.at_once["one"], [True, False, True])
    np.testing.assert_array_equal(end.at_once["other"], [True, True, False])
    turned = ode.Problem(LINE.y0, LINE.vector_field, dict(reversed(list(LINE.events.items()))))
    other = ode.solve(turned, {"speed": 1.0, "other": 1.0}, t1=10.0)
    assert other.ended_by == "other"
    assert other.at_once == {"other": True, "one": True}
    never = ode.solve(LINE, {"speed": 0.1, "other": 3.0}, t1=2.0)
    assert (never.ended_by, never.at_once) == ("t1", {"one": False, "other": False})


def test_an_event_at_the_very_end_counts():
    end = ode.solve(LINE, {"speed": np.array([1.0, 0.25, 0.2, 1 / 3]), "other": 9.0}, t1=np.array([1.0, 4, 4, 3]))
    assert list(end.ended_by) == ["one", "one", "t1", "one"]
    np.testing.assert_allclose(end.t, [1, 4, 4, 3], rtol=1e-15)


def test_a_lane_may_have_no_time():
    t1 = np.array([0.0, 1.0])
    end = ode.solve(FALLS, {"x0": 1.0, "v0": 0.5}, t1=t1, wrt=("t1", "x0"), derivatives=2)
    np.testing.assert_array_equal(end.ended_by, "t1")
    np.testing.assert_allclose(end.y["x"], np.cos(t1) + 0.5 * np.sin(t1), **CLOSE)
    np.testing.assert_allclose(end.along("t1").y["x"], -np.sin(t1) + 0.5 * np.cos(t1), **SLOPES)
    np.testing.assert_allclose(end.along("x0").y["x"], np.cos(t1), **SLOPES)
    np.testing.assert_allclose(end.along("t1", "x0").y["x"], -np.sin(t1), **CURVES)


def test_a_lane_whose_time_scale_is_known_may_take_any_time():
    problem = oscillator(-1, time_scale=lambda args: 0.3)
    end = ode.solve(problem, {"x0": 1.0, "v0": 0.0}, wrt=("x0", "t0"))
    assert end.ended_by == "zero-1"
    assert end.t == pytest.approx(np.pi / 2, rel=1e-9)
    assert end.along("t0").t == pytest.approx(1.0, rel=1e-9)
    with pytest.raises(ValueError, match="t1"):
        ode.solve(FALLS, {"x0": 1.0, "v0": 0.0})


class Oscillation(NamedTuple):
    """A state."""

    x: Any
    v: Any


class Body(eqx.Module):
    """A state."""

    place: Any
    name: str = eqx.field(static=True, default="body")


@pytest.mark.parametrize(
    ("y0", "rate", "x"),
    [
        (lambda a: Oscillation(a, 0), lambda y: Oscillation(y.v, -y.x), lambda y: y.x),
        (lambda a: [{"x": a}, (0.0, [])], lambda y: [{"x": y[1][0]}, (-y[0]["x"], [])], lambda y: y[0]["x"]),
        (lambda a: jnp.stack([a, 0.0]), lambda y: jnp.stack([y[1], -y[0]]), lambda y: y[..., 0]),
        (
            lambda a: Body(jnp.stack([a, 0.0])),
            lambda y: Body(jnp.stack([y.place[1], -y.place[0]])),
            lambda y: y.place[..., 0],
        ),
    ],
    ids=["named", "nested", "array", "module"],
)
def test_a_state_is_any_pytree(y0, rate, x):
    problem = ode.Problem(y0, lambda t, y, args: rate(y), {"low": ode.Event(lambda t, y, args: x(y) + 0.5, -1)})
    end = ode.solve(problem, np.array([1.0, 2.0]), t1=np.array([9.0, 1.0]), wrt="", ts=np.array([0.0, 0.5, 8.0]))
    times = np.array([2 * np.pi / 3, 1.0])
    assert jax.tree.structure(end.y) == jax.tree.structure(y0(1.0)) == jax.tree.structure(end.along("").y)
    np.testing.assert_allclose(end.t, times, **CLOSE)
    np.testing.assert_allclose(x(end.y), [-0.5, 2 * np.cos(1)], **CLOSE)
    np.testing.assert_allclose(x(end.ys), np.outer([1, 2], [1, np.cos(0.5), np.nan]), **CLOSE)


@pytest.mark.parametrize(
    ("rate", "t0", "y"),
    [
        pytest.param(lambda t, y, p: p * jnp.where(t > 0, 1.0, 5.0), 0.0, 3.0, id="at a time"),
        pytest.param(lambda t, y, p: p * jnp.where(t > 1e6, 1.0, 5.0), 1e6, 2.0, id="at a late time"),
        pytest.param(lambda t, y, p: p * jnp.where((t > 0) & (t < 4), 1.0, 0.0), 0.0, 3.0, id="pulse"),
        pytest.param(lambda t, y, p: p * (1 + jnp.where(y > 0, 1.0, -0.5)), 0.0, 6.0, id="at a state"),
        pytest.param(lambda t, y, p: p * (2 - 0.5 * jnp.sign(y)), 0.0, 4.5, id="friction"),
    ],
)
def test_a_rate_that_jumps_at_the_start_is_that_after_it(rate, t0, y):
    problem = ode.Problem(y0=0.0, vector_field=lambda t, y, args: rate(t, y, args["p"]))
    end = ode.solve(problem, {"p": np.array([1.0, 2.0])}, t0=t0, t1=max(3.0, t0 + 2.0), wrt="p")
    np.testing.assert_allclose(end.y, [y, 2 * y], rtol=1e-9)
    np.testing.assert_allclose(end.along("p").y, [y, y], rtol=1e-8)


def test_states_at_times_go_up_to_the_event_and_the_end():
    ts = np.array([0.5, 1.0, 1.0 + 1e-9, 5.0])
    end = ode.solve(LINE, {"speed": np.array([1.0, 0.1]), "other": 9.0}, t1=5.0, ts=ts)
    np.testing.assert_allclose(end.ys["x"], [[0.5, 1.0, np.nan, np.nan], [0.05, 0.1, 0.1 + 1e-10, 0.5]], rtol=1e-12)
    np.testing.assert_array_equal(end.ts, ts)
    assert end.times is not None
    np.testing.assert_allclose(end.times.integrals["area"][1], ts**2 / 20, **CLOSE)
    assert ode.solve(LINE, {"speed": 1.0, "other": 9.0}, t1=0.5).ys is None


@pytest.mark.parametrize(
    ("rate", "exact"),
    [
        (lambda t, y, _: jnp.sqrt(t), lambda t: 1 + 2 / 3 * t**1.5),
        (lambda t, y, _: jnp.abs(t - 0.4), lambda t: 1 + 0.08 + 0.5 * (t - 0.4) * np.abs(t - 0.4)),
        (
            lambda t, y, _: -jnp.maximum(y, 0.5),
            lambda t: np.where(t < np.log(2), np.exp(-t), 0.5 + np.log(2) / 2 - t / 2),
        ),
    ],
)
def test_states_at_times_are_exact_beside_kinks_and_infinite_rates(rate, exact):
    ts = np.linspace(0, 2, 301)
    end = ode.solve(ode.Problem(1.0, rate), 0.0, t1=2.0, ts=ts)
    np.testing.assert_allclose(end.ys, exact(ts), rtol=0, atol=2e-9)
    assert end.ys[0] == 1


def test_a_pulse_narrower_than_a_step_is_seen_with_max_step():
    problem = ode.Problem(
        0.0,
        lambda t, y, args: 1.0,
        {"pulse": ode.Event(lambda t, y, args: 0.5 - jnp.exp(-(((y - 5.1) / args["width"]) ** 2)), -1)},
    )
    end = ode.solve(problem, {"width": 0.01}, t1=10.0, max_step=np.array([np.inf, 0.005]))
    assert end.ended_by[1] == "pulse"
    assert end.t[1] == pytest.approx(5.1 - 0.01 * np.sqrt(np.log(2)), rel=1e-9)
    assert end.trials[1] > 1000


def test_sizes_spare_steps_where_a_state_starts_at_zero():
    def chain(t, y, args):
        left, right = jnp.concatenate([jnp.zeros(1), y["x"][:-1]]), jnp.concatenate([y["x"][1:], jnp.zeros(1)])
        return {"x": y["v"], "v": left - 2 * y["x"] + right}

    start = {"x": np.eye(8)[0], "v": np.zeros(8)}
    problem = ode.Problem(start, chain)
    exact = ode.solve(problem, t1=5.0)
    spared = ode.solve(problem, t1=5.0, state_scale=1.0)
    each = ode.solve(problem, t1=5.0, state_scale={"x": np.ones(8), "v": 1.0})
    assert spared.trials < exact.trials
    assert each.trials == spared.trials
    matrix = np.diag(np.full(8, 2.0)) - np.diag(np.ones(7), 1) - np.diag(np.ones(7), -1)
    squares, modes = np.linalg.eigh(matrix)
    closed = modes @ (np.cos(np.sqrt(squares) * 5) * modes[0])
    np.testing.assert_allclose(exact.y["x"], closed, rtol=1e-8)
    np.testing.assert_allclose(spared.y["x"], closed, atol=1e-9)


def test_smooth_spares_what_kinks_cost():
    """The rates have a root of a square, which is not zero on the way."""
    root = lambda v: jnp.sqrt(1 + v**2)  # noqa: E731
    problem = ode.Problem(
        lambda args: {"y": 1.0, "v": args["v"]},
        lambda t, y, args: {"y": y["v"], "v": -y["v"] * root(jnp.sqrt(y["v"] ** 2))},
        {"slow": ode.Event(lambda t, y, args: y["v"] - 0.1, -1)},
    )
    rough, smooth = (ode.solve(problem, {"v": 3.0}, t1=20.0, wrt="v", smooth=smooth) for smooth in (None, True))
    assert smooth.trials <= rough.trials
    # dv/dt = -v √(1+v²) has the solution arsinh(1/v) = t + arsinh(1/v0).
    exact = np.arcsinh(10) - np.arcsinh(1 / 3)
    slope = 1 / (3 * np.sqrt(10))
    for end in (rough, smooth):
        assert end.t == pytest.approx(exact, rel=1e-9)
        assert end.along("v").t == pytest.approx(slope, rel=1e-8)


def test_a_square_wave_from_rest_returns_to_zero_where_it_jumps():
    """Relative to a state that is exactly zero no step across the jump would be short enough."""
    rng = np.random.default_rng(0)
    period, rate = 10 ** rng.uniform(-6, 6, (2, 256))
    t1 = period * rng.uniform(0.5, 6, 256)
    wave = ode.Problem(
        y0=lambda args: {"x": 0.0},
        vector_field=lambda t, y, args: {
            "x": args["rate"] * jnp.where(jnp.sin(2 * jnp.pi * t / args["period"]) > 0, 1.0, -1.0)
        },
        events={"high": ode.Event(lambda t, y, args: y["x"] - args["rate"] * args["period"], 1)},
    )
    end = ode.solve(wave, {"period": period, "rate": rate}, t1=t1)
    assert set(end.ended_by) == {"t1"}
    share = t1 / period % 1
    assert end.y["x"] / (rate * period) == pytest.approx(np.minimum(share, 1 - share), abs=1e-9)


def test_what_moves_within_the_digits_of_its_clock_is_followed_or_fails():
    """Steps that short are taken as they are only where nothing moves in them."""
    late = 1.7e9
    wave = ode.Problem(
        {"x": 1.0, "v": 0.0},
        lambda t, y, args: {
            "x": args["w"] * y["v"],
            "v": -args["w"] * y["x"] + 1e-12 * jnp.abs(jnp.sin(t / 1e7)),
        },
    )
    end = ode.solve(wave, {"w": np.array([1e6, 3e6, 1e7])}, t0=late, t1=late + 1e-4)
    assert end.y["x"] == pytest.approx(np.cos(np.array([1e6, 3e6, 1e7]) * ((late + 1e-4) - late)), abs=1e-7)
    fall = ode.Problem(
        {"x": 1.0, "v": 0.0},
        lambda t, y, args: {"x": y["v"], "v": -1 / y["x"] ** 2 + args["push"] * jnp.abs(jnp.sin(3 * t))},
    )
    assert ode.solve(fall, {"push": 1e-3}, t1=3.0).ended_by == "failed"


@pytest.mark.parametrize("size", [1.0, -1e-2, 1e-4, 0.0])
@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_a_jump_in_time_has_derivatives_however_small_it_is(size, rtol):
    """What its time changes is (p - q) exp(tj - 1); that of the jump itself may be zero by chance."""
    problem = ode.Problem(0.5, lambda t, y, args: -y + jnp.where(t < args["tj"], args["p"], args["q"]))
    tj = np.linspace(0.05, 0.95, 40)
    end = ode.solve(problem, {"tj": tj, "p": 0.3 + size, "q": 0.3}, t1=1.0, wrt=("tj", "p"), derivatives=2, rtol=rtol)
    rest = np.exp(tj - 1)
    exact = {("tj",): size * rest, ("p",): rest - np.exp(-1), ("tj", "p"): rest, ("tj", "tj"): size * rest}
    for names, derivative in exact.items():
        np.testing.assert_allclose(end.along(*names).y, derivative, rtol=100 * rtol, atol=100 * rtol)
    np.testing.assert_allclose(end.along("p", "p").y, 0.0, atol=1e-9)


_X = np.linspace(0.0, 1.2, 7)
CONTINUOUS = {
    "a table": lambda t, y: jnp.interp(y, _X, _X**2 / 2),
    "a series": lambda t, y: jnp.where(jnp.abs(y - 0.5) < 1e-4, 1 - (y - 0.5) / 2, (y - 0.5) / jnp.expm1(y - 0.5)),
    "pieces": lambda t, y: jnp.where(y > 0.6, y, jnp.where(y > 0.3, 0.3 + y / 2, 1.5 * y)),
    "a branch": lambda t, y: jax.lax.cond(y > 0.5, lambda: y, lambda: 0.5 + 0 * y),
    "a triangle in time": lambda t, y: y * jnp.abs(jnp.mod(3 * t, 2.0) - 1),
    "steps in time that are joined": lambda t, y: y * (jnp.floor(3 * t) + jnp.mod(3 * t, 1.0)),
}


def test_cases_that_change_without_a_jump_keep_derivatives():
    """All in one problem, a part of the state for each."""
    problem = ode.Problem(
        dict.fromkeys(CONTINUOUS, 1.0),
        lambda t, y, args: {name: -args["k"] * rate(t, y[name]) for name, rate in CONTINUOUS.items()},
    )
    h = 1e-4
    end = ode.solve(problem, {"k": 1.1}, t1=0.9, wrt="k", derivatives=2)
    near = ode.solve(problem, {"k": 1.1 + h * np.array([-1.0, 1.0])}, t1=0.9, rtol=1e-12, wrt="k", derivatives=2)
    for name in CONTINUOUS:
        slope, curve = (np.diff(part.y[name])[0] / (2 * h) for part in (near, near.along("k")))
        assert end.along("k").y[name] == pytest.approx(slope, rel=1e-6), name
        assert end.along("k", "k").y[name] == pytest.approx(curve, rel=1e-3, abs=1e-3), name


def test_a_lane_with_too_many_steps_tells_what_it_reached():
    full = ode.solve(FALLS, {"x0": 1.0, "v0": 0.0}, t1=1e4)
    problem = oscillator()
    end = ode.solve(problem, {"x0": 1.0, "v0": 0.0}, t1=1e4, max_steps=50, wrt="x0")
    assert (full.ended_by, end.ended_by) == ("zero-1", "unfinished")
    assert 1 < end.t < 1e3
    assert end.y["x"] == pytest.approx(np.cos(end.t), abs=1e-7)
    assert np.isnan(end.along("x0").y["x"])


def test_arguments_broadcast_and_each_lane_is_its_own():
    c = np.array([[0.1], [0.2]])
    x0 = np.array([1.0, 2.0, 3.0])
    end = ode.solve(TIMED, {"x0": x0, "c": c}, t1=9.0)
    assert end.t.shape == (2, 3)
    np.testing.assert_allclose(end.t, np.sqrt(2 * np.log(x0 / c)), **CLOSE)
    one = ode.solve(TIMED, {"x0": 2.0, "c": np.array([[0.2]])}, t1=9.0)
    assert one.t.shape == (1, 1)
    assert one.t[0, 0] == end.t[1, 1]
    none = ode.solve(TIMED, {"x0": np.zeros(0), "c": 0.1}, t1=9.0)
    assert none.t.shape == (0,)


def test_arrays_may_be_shared_by_all_lanes():
    def rate(t, y, args):
        return -args["net"]["rates"] @ jnp.stack([y, 1.0]) * args["order"]

    problem = ode.Problem(lambda args: args["y0"], rate, {"low": ode.Event(lambda t, y, args: y - 0.5, -1)})
    args = {"net": {"rates": np.array([2.0, 0.0])}, "y0": np.array([1.0, 2.0, 4.0]), "order": 1}
    end = ode.solve(problem, args, t1=9.0, shared=("net",), wrt="y0")
    np.testing.assert_allclose(end.t, np.log([2, 4, 8]) / 2, **CLOSE)
    np.testing.assert_allclose(end.along("y0").t, 1 / (2 * args["y0"]), **SLOPES)
    again = ode.solve(problem, args, t1=9.0, shared=("net.rates",))
    np.testing.assert_allclose(again.t, end.t, **CLOSE)  # without derivatives other steps


def test_arguments_may_hold_functions_words_whole_numbers_and_truth():
    def rate(t, y, args):
        speed = jnp.where(args["fast"], 2.0, 1.0) * args["n"]
        return -args["law"](y) * speed if args["kind"] == "decay" else speed

    problem = ode.Problem(1.0, rate, {"low": ode.Event(lambda t, y, args: y - 0.5, -1)})
    args = {"law": jnp.square, "kind": "decay", "fast": np.array([True, False]), "n": 2}
    # 1/y = 1 + s t
    np.testing.assert_allclose(ode.solve(problem, args, t1=9.0).t, [1 / 4, 1 / 2], **CLOSE)
    other = ode.solve(problem, args | {"law": lambda y: y, "n": np.array([1, 3])}, t1=9.0, wrt="n")
    np.testing.assert_allclose(other.t, np.log(2) / np.array([2, 3]), **CLOSE)
    grows = ode.solve(problem, args | {"kind": "growth"}, t1=1.0)
    np.testing.assert_allclose(grows.y, [5, 3], **CLOSE)


def test_random_problems_end_as_dop853_says():
    """A nonlinear oscillator with damping: the first of three events, its time and state."""
    problem = ode.Problem(
        lambda args: {"x": args["x0"], "v": 0.0},
        lambda t, y, args: {"x": y["v"], "v": -jnp.sin(y["x"]) - args["d"] * y["v"] + 0.2 * jnp.cos(args["w"] * t)},
        {
            "slow": ode.Event(lambda t, y, args: y["v"] - 0.5),
            "wall": ode.Event(lambda t, y, args: y["x"] + 0.4 * jnp.cos(t), -1),
            "line": ode.Event(lambda t, y, args: y["x"] - y["v"] - 0.2, 1),
        },
        {"work": lambda t, y, args: args["d"] * y["v"] ** 2},
    )
    draw = np.random.default_rng(1)
    args = {"x0": draw.uniform(-1.5, 1.5, 40), "d": draw.uniform(0, 0.3, 40), "w": draw.uniform(0.3, 2, 40)}
    end = ode.solve(problem, args, t1=6.0)
    assert len(set(end.ended_by)) >= 3
    for i in range(40):
        x0, d, w = (args[name][i] for name in ("x0", "d", "w"))

        def rate(t, y, d=d, w=w):
            return y[1], -np.sin(y[0]) - d * y[1] + 0.2 * np.cos(w * t), d * y[1] ** 2

        events = [lambda t, y: y[1] - 0.5, lambda t, y: y[0] + 0.4 * np.cos(t), lambda t, y: y[0] - y[1] - 0.2]
        for event, direction in zip(events, (0, -1, 1), strict=True):
            vars(event).update(terminal=True, direction=direction)
        judge = solve_ivp(rate, (0, 6), (x0, 0, 0), "DOP853", rtol=1e-12, atol=1e-14, events=events, max_step=0.2)
        by = [name for name, times in zip(problem.events, judge.t_events, strict=True) if times.size]
        assert end.ended_by[i] == (by[0] if by else "t1")
        np.testing.assert_allclose(
            [end.t[i], end.y["x"][i], end.y["v"][i], end.integrals["work"][i]],
            [judge.t[-1], *judge.y[:, -1]],
            atol=2e-9,
        )


def test_what_an_event_fixes_asks_for_no_second_integration() -> None:
    """Ten bounces: the height at each is zero by definition, and the terms of its second derivative cancel."""
    ball = ode.Problem(
        {"y": 1.0, "v": 0.0},
        lambda t, y, args: {"y": y["v"], "v": -9.81 + 0 * y["y"]},
        {"ground": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -args["e"] * y["v"]})},
    )
    lanes = ode.solve(ball, {"e": 0.9}, t1=1e3, max_events=10, wrt="e", derivatives=2).lanes
    results = integrate(lanes.signature, lanes.parameters, 1, 2, (0,), 1e-9, refines=False)
    assert results.rtol_used == 1e-9


def test_a_part_that_has_decayed_costs_no_digits() -> None:
    """e^-1000 to nine digits of its own takes 3,839 trials; the method's stability takes some 200."""
    fast = ode.Problem(
        {"fast": 1.0, "slow": 0.0}, lambda t, y, args: {"fast": -args * y["fast"], "slow": 1.0 + 0 * y["slow"]}
    )
    assert ode.solve(fast, 10.0, t1=100.0).trials < 600


@pytest.mark.parametrize("t1", [50.0, 5e3, 5e9])
def test_a_span_far_longer_than_the_motion_changes_nothing(t1: float) -> None:
    """Lorenz's section, with lanes that begin on either side of it; a first step of the span overflows."""
    lanes = 100
    rng = np.random.default_rng(3)
    args = {"rho": rng.uniform(24, 32, lanes), "y0": rng.uniform((-15, -20, 10), (15, 20, 40), (lanes, 3)).T}
    args = {"rho": args["rho"], "x": args["y0"][0], "y": args["y0"][1], "z": args["y0"][2]}
    lorenz = ode.Problem(
        y0=lambda args: {name: args[name] for name in "xyz"},
        vector_field=lambda t, y, args: {
            "x": 10.0 * (y["y"] - y["x"]),
            "y": y["x"] * (args["rho"] - y["z"]) - y["y"],
            "z": y["x"] * y["y"] - 8 / 3 * y["z"],
        },
        events={"down": ode.Event(lambda t, y, args: y["z"] - (args["rho"] - 1), -1)},
    )
    near, far = (ode.solve(lorenz, args, t1=span) for span in (5.0, t1))
    assert set(near.ended_by) == {"down"}
    np.testing.assert_array_equal(far.ended_by, near.ended_by)
    np.testing.assert_allclose(far.t, near.t, rtol=2e-9)


@pytest.mark.parametrize("p", [0.0, 1.0, 1e-3, 1e-6])
def test_a_number_that_matters_little_has_its_derivative(p: float) -> None:
    problem = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -y["x"] + args["p"] * jnp.sin(200 * t)})
    slope = ode.solve(problem, {"p": p}, t1=1.0, wrt="p").along("p").y["x"]
    assert slope == pytest.approx((np.sin(200) - 200 * np.cos(200) + 200 / np.e) / (1 + 200**2), rel=1e-8)


@pytest.mark.parametrize("radius", [5.0, 1.0, 0.1])
def test_a_distance_is_seen_in_a_long_step(radius: float) -> None:
    """A straight line needs few steps, and the distance to a point bends in a small part of one."""
    line = ode.Problem(
        {"x": 0.0},
        lambda t, y, args: {"x": 1.0},
        {"disc": ode.Event(lambda t, y, args: jnp.hypot(y["x"] - args["at"], args["r"] / 2) - args["r"], -1)},
    )
    at = np.linspace(6, 95, 500)
    end = ode.solve(line, {"at": at, "r": radius}, t1=100.0)
    assert set(end.ended_by) == {"disc"}
    np.testing.assert_allclose(end.t, at - radius * np.sqrt(0.75), rtol=1e-9)


def test_sizes_belong_to_the_state_and_not_to_what_is_left_of_it() -> None:
    problem = ode.Problem(
        {"x": 1e-3, "z": 1.0}, lambda t, y, args: {"x": -y["x"] * y["z"] + 1e-3 * jnp.cos(20 * t), "z": 0.0}
    )
    exact = ode.solve(problem, t1=5.0).y["x"]
    assert ode.solve(problem, t1=5.0, state_scale={"x": 1e-3, "z": 1e6}).y["x"] == pytest.approx(exact, rel=1e-8)


def test_a_start_at_rounding_below_the_event_is_at_it() -> None:
    ball = ode.Problem(
        {"y": 0.3 - 0.1 - 0.2, "v": 10.0},
        lambda t, y, args: {"y": y["v"], "v": -9.81},
        {"ground": ode.Event(lambda t, y, args: y["y"])},
    )
    assert ode.solve(ball, t1=10.0).t == pytest.approx(20 / 9.81, rel=1e-12)


CLOCK = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": 1.0})  # an event function of x is one of time


@pytest.mark.parametrize("apart", [1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("direction", [-1, 0])
def test_two_near_zeros_in_a_very_long_step(apart: float, direction: int) -> None:
    """A trial that lands between them is past the event, but its slope there says nothing."""
    pair = ode.Event(lambda t, y, args: (y["x"] - args["middle"]) ** 2 - args["apart"] ** 2, direction)
    middle = np.random.default_rng(3).uniform(1, 99, 300)
    found = ode.solve(replace(CLOCK, events={"pair": pair}), {"middle": middle, "apart": apart}, t1=100.0)
    assert set(found.ended_by) == {"pair"}
    np.testing.assert_allclose(found.t, middle - apart, rtol=1e-12)
    assert found.trials.max() <= 20


@pytest.mark.parametrize(("direction", "which"), [(-1, 0), (0, -1), (1, -1)])
@pytest.mark.parametrize("apart", [0.1, 1e-2, 1e-3])
def test_the_first_of_three_zeros_in_a_very_long_step(apart: float, direction: int, which: int) -> None:
    """It rises, falls and rises again: what has fallen at a trial's end, or risen, may have done so before."""

    def product(t: Any, y: Any, args: Any) -> Any:
        x = y["x"] - args["middle"]
        return (x - args["apart"]) * x * (x + args["apart"])

    middle = np.random.default_rng(3).uniform(1, 99, 300)
    problem = replace(CLOCK, events={"zero": ode.Event(product, direction)})
    found = ode.solve(problem, {"middle": middle, "apart": apart}, t1=100.0)
    assert set(found.ended_by) == {"zero"}
    np.testing.assert_allclose(found.t, middle + which * apart, rtol=1e-12)
    assert found.trials.max() <= 20


@pytest.mark.parametrize("order", [3, 21])
def test_a_zero_of_higher_order_is_met_where_it_is(order: int) -> None:
    """Newton's method leaves a share of the way to it at each step; second derivatives have no digits there."""
    decay = ode.Problem(1.0, lambda t, y, args: -args["k"] * y)
    problem = replace(decay, events={"zero": ode.Event(lambda t, y, args: (y - args["at"]) ** order, -1)})
    k = np.linspace(0.5, 2.0, 20)
    end = ode.solve(problem, {"k": k, "at": 0.5}, t1=10.0, wrt=("k", "at"), derivatives=2)
    np.testing.assert_allclose(end.t, np.log(2) / k, rtol=1e-11)
    np.testing.assert_allclose(end.along("k").t, -np.log(2) / k**2, rtol=1e-9)
    np.testing.assert_allclose(end.along("at").t, -2 / k, rtol=1e-9)
    assert not end.inexact.any()
    assert np.isnan(end.along("k", "k").t).all()


def test_a_zero_beside_others_that_it_all_but_has_is_met_where_it_is() -> None:
    """Newton's method converges slowly to a zero beside complex ones: 9,108 of 20,000 were wrong without a word."""
    random = np.random.default_rng(5)
    close, closer, k = (
        10 ** random.uniform(-18, -0.5, (2, 2000)),
        10 ** random.uniform(-9, -0.5, 2000),
        random.uniform(0.3, 3, 2000),
    )

    def quintic(t: Any, y: Any, args: Any) -> Any:
        u = y - 0.5
        return u * (u * u + args["close"][0]) * (u * u + args["close"][1])

    def cubic(t: Any, y: Any, args: Any) -> Any:
        return (y - 0.5) * ((y - 0.5 - args["closer"]) ** 2 + args["close"][0])

    for function in (quintic, cubic):
        problem = ode.Problem(1.0, lambda t, y, args: -args["k"] * y, {"zero": ode.Event(function, -1)})
        end = ode.solve(problem, {"k": k, "close": tuple(close), "closer": closer}, t1=10.0)
        np.testing.assert_allclose(end.t, np.log(2) / k, rtol=1e-9)


def test_a_zero_behind_a_kink_of_the_function_is_met_where_it_is() -> None:
    def kinked(t: Any, y: Any, args: Any) -> Any:
        u = y - 0.5
        return jnp.where(u > args["c"], 10 * (u - args["c"]) + args["c"], u)

    problem = ode.Problem(1.0, lambda t, y, args: -args["k"] * y, {"zero": ode.Event(kinked, -1)})
    k = np.linspace(0.3, 3, 100)
    for c in (1e-4, 1e-3, 3e-3, 1e-2):
        end = ode.solve(problem, {"k": k, "c": c}, t1=10.0, wrt="k", derivatives=1)
        np.testing.assert_allclose(end.t, np.log(2) / k, rtol=1e-10)
        np.testing.assert_allclose(end.along("k").t, -np.log(2) / k**2, rtol=1e-9)


def test_a_zero_that_rounding_hides_is_no_result() -> None:
    """(y - 0.5)⁵ multiplied out is rounding in 4e-4 around its zero."""
    event = ode.Event(
        lambda t, y, args: ((((y["x"] - 2.5) * y["x"] + 2.5) * y["x"] - 1.25) * y["x"] + 0.3125) * y["x"] - 0.03125
    )
    end = ode.solve(replace(CLOCK, events={"zero": event}), t1=2.0)
    assert end.ended_by == "failed"
    assert "rounding hides the event" in end.warnings[0]


@pytest.mark.parametrize("apart", [0.1, 1e-3])
def test_a_visit_above_zero_near_the_end_of_a_step_is_seen(apart: float) -> None:
    """The function begins below zero and counts from its crest on, wherever the step ends."""
    visit = ode.Event(lambda t, y, args: (y["x"] - args["middle"]) ** 2 - args["apart"] ** 2, 1)
    # Steps end at 3.06, 15.81 and 79.56.
    middle = np.concatenate([end + np.linspace(-1.1, -0.9, 51) * apart for end in (3.06, 15.81, 79.56)])
    found = ode.solve(replace(CLOCK, events={"visit": visit}), {"middle": middle, "apart": apart}, t1=100.0)
    assert set(found.ended_by) == {"visit"}
    np.testing.assert_allclose(found.t, middle + apart, rtol=1e-12)


def test_a_motion_that_dies_away_is_not_integrated_again_for_digits_that_do_not_matter():
    """An oscillator at rest: 1e-19 of where it began need not be known relative to itself."""
    damping = np.array([0.5, 1.0, 2.0])
    oscillator = ode.Problem(
        y0=lambda args: {"x": 1.0 + 0.0 * args, "v": 0.0 * args},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -2 * args * y["v"] - (1 + args**2) * y["x"]},
    )
    end = ode.solve(oscillator, damping, t1=100.0)
    # Integrations with a tolerance of 1e-13 took 300 to 500 trials.
    assert np.all(end.trials < 200)
    assert np.all(np.abs(end.y["x"] - np.exp(-damping * 100) * (np.cos(100) + damping * np.sin(100))) < 1e-16)
    early = ode.solve(oscillator, damping, t1=5.0)
    assert early.y["x"] == pytest.approx(np.exp(-damping * 5) * (np.cos(5) + damping * np.sin(5)), rel=2e-9)


@pytest.mark.parametrize(
    ("force", "work", "infinite"),
    [
        (lambda x: x**1.5, lambda x: x**2.5 / 2.5, False),
        (jnp.sqrt, lambda x: x**1.5 / 1.5, False),
        (lambda x: x**-0.5, lambda x: 2 * x**0.5, True),
    ],
)
def test_no_lane_fails_where_the_motion_is_not_defined_beyond_its_event(force, work, infinite):
    fall = ode.Problem(
        y0=lambda args: {"x": args["height"], "v": 0.0},
        vector_field=lambda t, y, args: {"x": y["v"], "v": force(y["x"]) - 9.81},
        events={"ground": ode.Event(lambda t, y, args: y["x"], direction=-1)},
    )
    height = np.linspace(0.5, 3, 40)
    speed = np.sqrt(2 * (9.81 * height - work(height)))
    end = ode.solve(fall, {"height": height}, t1=50.0, wrt="height", derivatives=2)
    assert (end.ended_by == "ground").all()
    np.testing.assert_allclose(-end.y["v"], speed, rtol=1e-9)
    found = end.along("height").y["v"]
    assert (np.isclose(-found, (9.81 - force(height)) / speed, rtol=1e-7) | (infinite & np.isnan(found))).all()


PATHS = {
    "abs": jnp.abs,
    "maximum": lambda v: jnp.maximum(v, 0.0),
    "where": lambda v: jnp.where(v <= 0, -v, v),
    "sqrt": lambda v: jnp.sqrt(v * v),
}


def test_of_a_kink_at_the_event_only_the_side_before_it_counts():
    """A throw up to its apex, the path by integrals."""
    problem = ode.Problem(
        y0=lambda args: {"v": args["v0"]},
        vector_field=lambda t, y, args: {"v": -args["g"]},
        events={"apex": ode.Event(lambda t, y, args: y["v"], direction=-1)},
        integrals={name: lambda t, y, args, path=path: path(y["v"]) for name, path in PATHS.items()},
    )
    v0, g = np.linspace(5.0, 15.0, 5), 9.81  # the path is v0²/(2 g)
    end = ode.solve(problem, {"v0": v0, "g": g}, t1=50.0, wrt=("v0", "g"), derivatives=2)
    for by, exact in {
        ("v0",): v0 / g,
        ("g",): -(v0**2) / (2 * g**2),
        ("v0", "v0"): 1 / g + 0 * v0,
        ("v0", "g"): -v0 / g**2,
        ("g", "g"): v0**2 / g**3,
    }.items():
        for name in PATHS:
            np.testing.assert_allclose(end.along(*by).integrals[name], exact, rtol=1e-10, err_msg=name)
    np.testing.assert_allclose(end.along("g").t, -v0 / g**2, rtol=1e-10)


@pytest.mark.parametrize(
    "path",
    [
        lambda v: jnp.hypot(v, 2 * v),  # its second derivative is rounding
        jnp.cbrt,  # its derivatives are infinite
        lambda v: jnp.arctan2(v, v * v),  # not defined at 0
    ],
    ids=["hypot", "cbrt", "atan2"],
)
def test_derivatives_through_a_singular_rate_at_the_event_are_right_or_nan(path):
    problem = ode.Problem(
        y0=lambda args: {"v": args["v0"]},
        vector_field=lambda t, y, args: {"v": -args["g"]},
        events={"apex": ode.Event(lambda t, y, args: y["v"], direction=-1)},
        integrals={"path": lambda t, y, args: path(y["v"])},
    )
    v0 = np.array([0.7, 1.0, 1.3, 1.9, 2.2, 2.45, 2.7, 2.9])
    g = np.array([9.81, 3, 1.7, 5, 2.2, 8, 1.1, 4.4])
    end = ode.solve(problem, {"v0": v0, "g": g}, t1=50.0, wrt=("v0", "g"), derivatives=2)
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(path)))(v0)
    whole = end.integrals["path"]  # F(v0)/g
    np.testing.assert_allclose(end.t, v0 / g, rtol=1e-12)
    for by, exact in {
        ("v0",): value / g,
        ("g",): -whole / g,
        ("v0", "v0"): slope / g,
        ("v0", "g"): -value / g**2,
        ("g", "g"): 2 * whole / g**2,
    }.items():
        found = end.along(*by).integrals["path"]
        known = np.isfinite(found)
        np.testing.assert_allclose(found[known], exact[known], rtol=1e-6)


def test_a_looser_tolerance_takes_no_more_trials() -> None:
    """Local minima of an event function that are far from zero are no grazes, whatever the tolerance."""
    driven = ode.Problem(
        {"x": 0.3, "v": 0.0},
        lambda t, y, args: {"x": y["v"], "v": -0.5 * y["v"] - jnp.sin(y["x"]) + args["a"] * jnp.cos(2 * t / 3)},
        {"far": ode.Event(lambda t, y, args: 1.5 - y["x"], -1)},
    )
    amplitudes = {"a": np.linspace(0.3, 0.6, 8)}
    trials = [ode.solve(driven, amplitudes, t1=40.0, rtol=rtol).trials.sum() for rtol in (1e-3, 1e-4, 1e-5, 1e-6)]
    assert trials == sorted(trials)


def test_a_body_thrown_straight_up_has_derivatives_by_the_angle() -> None:
    """Its speed is zero at the apex, where `hypot` would choose another operand."""
    c, v0 = 0.1, 2.0

    def rates(t, y, args):
        speed = jnp.hypot(y["vx"], y["vy"])
        return {"vx": -c * speed * y["vx"], "vy": -1.0 - c * speed * y["vy"], "y": y["vy"]}

    thrown = ode.Problem(
        lambda args: {"vx": v0 * jnp.cos(args["angle"]), "vy": v0 * jnp.sin(args["angle"]), "y": 0.0},
        rates,
        {"ground": ode.Event(lambda t, y, args: y["y"], -1)},
    )
    end = ode.solve(thrown, {"angle": np.pi / 2}, t1=9.0, wrt="angle")
    # The ways up and down are as long: ln(1 + c v0²)/(2 c) each.
    assert end.along("angle").y["vx"] == pytest.approx(-v0 / (1 + c * v0**2), rel=1e-8)
    assert end.along("angle").t == pytest.approx(0, abs=1e-8)


def test_second_derivatives_through_a_zero_of_a_hypotenuse_are_right() -> None:
    c, v0 = 0.1, np.array([1.0, 2.0, 3.0])
    thrown = ode.Problem(
        lambda args: {"y": 0.0, "v": args["v0"]},
        lambda t, y, args: {"y": y["v"], "v": -1.0 - c * y["v"] * jnp.abs(y["v"])},
        {"ground": ode.Event(lambda t, y, args: y["y"], -1)},
        {"path": lambda t, y, args: jnp.hypot(y["v"], 2 * y["v"])},
    )
    end = ode.solve(thrown, {"v0": v0}, t1=9.0, wrt="v0", derivatives=2)
    root = 1 + c * v0**2
    np.testing.assert_allclose(end.integrals["path"], np.sqrt(5) * np.log(root) / c, rtol=1e-8)
    np.testing.assert_allclose(end.along("v0").integrals["path"], np.sqrt(5) * 2 * v0 / root, rtol=1e-7)
    found, exact = end.along("v0", "v0").integrals["path"], np.sqrt(5) * 2 * (1 - c * v0**2) / root**2
    np.testing.assert_allclose(found, exact, rtol=1e-6)


@pytest.mark.parametrize("size", [1e-170, 1e-120, 1.0, 1e120, 1e160])
def test_a_hypotenuse_has_the_range_of_all_floats(size: float) -> None:
    """x' = -√(x² + y²), y' = -y: both are in proportion to the start."""
    problem = ode.Problem(
        lambda args: {"x": args, "y": args}, lambda t, y, args: {"x": -jnp.hypot(y["x"], y["y"]), "y": -y["y"]}
    )
    end = ode.solve(problem, size, t1=0.5, wrt="")
    assert end.y["x"] / size == pytest.approx(0.470274887117536, rel=1e-9)
    assert end.along("").y["x"] == pytest.approx(0.470274887117536, rel=1e-9)


@pytest.mark.parametrize(
    "ratio",
    [lambda v: jnp.sin(v) / v, lambda v: jax.jit(lambda u: u**-2 * (u * jnp.expm1(u)))(v)],
    ids=["quotient", "power"],
)
def test_derivatives_are_nan_where_a_rate_divides_by_what_vanishes_at_the_event(ratio):
    problem = ode.Problem(
        y0=lambda args: {"v": args["v0"]},
        vector_field=lambda t, y, args: {"v": -args["g"]},
        events={"low": ode.Event(lambda t, y, args: y["v"] - args["at"], direction=-1)},
        integrals={"path": lambda t, y, args: ratio(y["v"])},
    )
    args = {"v0": np.linspace(0.5, 3.0, 8), "g": 9.81, "at": 0.0}
    end = ode.solve(problem, args, t1=50.0, wrt=("v0", "g"), derivatives=2)
    assert np.all(end.ended_by == "low")
    assert np.all(np.isfinite(end.integrals["path"]))
    assert all(np.all(np.isnan(end.along(*by).integrals["path"])) for by in [("v0",), ("g",), ("v0", "g")])
    backwards = jax.jit(jax.grad(lambda g: ode.solve(problem, {**args, "g": g}, t1=50.0).integrals["path"].sum()))(9.81)
    assert np.isnan(backwards)
    # A little above it they are right.
    above = ode.solve(problem, {**args, "at": 0.1}, t1=50.0, wrt=("v0", "g"), derivatives=2)
    np.testing.assert_allclose(above.along("v0").integrals["path"], ratio(args["v0"]) / 9.81, rtol=1e-9)


def test_a_mass_matrix_is_solved_in_the_rates():
    """A double pendulum from its Lagrangian, M(q) q″ = -C(q, q′) - G(q), against M inverted by hand."""

    def pieces(y, args):
        (a, b), (u, v) = y["q"], y["v"]
        mass = jnp.array([[1 + args["m"], args["m"] * jnp.cos(a - b)], [args["m"] * jnp.cos(a - b), args["m"]]])
        bend = args["m"] * jnp.sin(a - b)
        return mass, -jnp.array([bend * v**2 + (1 + args["m"]) * jnp.sin(a), -bend * u**2 + args["m"] * jnp.sin(b)])

    def by_hand(mass, force):
        determinant = mass[0, 0] * mass[1, 1] - mass[0, 1] ** 2
        return jnp.array([
            mass[1, 1] * force[0] - mass[0, 1] * force[1],
            mass[0, 0] * force[1] - mass[0, 1] * force[0],
        ]) / determinant  # fmt: skip

    def end(solver):
        problem = ode.Problem(
            y0=lambda args: {"q": jnp.array([args["a"], 0.3]), "v": jnp.zeros(2)},
            vector_field=lambda t, y, args: {"q": y["v"], "v": solver(*pieces(y, args))},
            events={"upright": ode.Event(lambda t, y, args: y["q"][1], -1)},
        )
        return ode.solve(problem, {"a": np.linspace(0.2, 1.5, 9), "m": 0.7}, t1=9.0, wrt=("a", "m"))

    expected, solved = end(by_hand), end(jnp.linalg.solve)
    assert (solved.ended_by == "upright").all()
    # The exchange of rows is no kink.
    assert solved.trials == pytest.approx(expected.trials, abs=1)
    assert solved.t == pytest.approx(expected.t, rel=1e-9)
    for names in ("a",), ("m",):
        for part in "qv":
            scale = np.abs(expected.along(*names).y[part]).max()
            assert solved.along(*names).y[part] == pytest.approx(expected.along(*names).y[part], abs=1e-7 * scale)


def test_no_time_up_to_the_end_is_missed_whatever_the_start():
    """As exact as a lane that ends at the time; by t0 the time since the start changes."""
    k = np.linspace(1.0, 3.0, 60)
    spring = ode.Problem(
        {"x": 1.0, "v": 0.0},
        lambda t, y, k: {"x": y["v"], "v": -k * y["x"]},
        {"low": ode.Event(lambda t, y, k: y["x"], -1)},
    )
    t = np.asarray(ode.solve(spring, k, t0=123.4, t1=130.0).t)
    ts = np.sort(np.concatenate([t, np.linspace(123.4, 125.1, 200)]))
    end = ode.solve(spring, k, t0=123.4, t1=130.0, ts=ts, wrt="t0", derivatives=2)
    root, since = np.sqrt(k)[:, None], ts - 123.4
    there = ts <= t[:, None]
    assert end.times is not None
    for ys, exact in (
        (end.ys, np.cos(root * since)),
        (end.times.along("t0").ys, root * np.sin(root * since)),
        (end.times.along("t0", "t0").ys, -k[:, None] * np.cos(root * since)),
    ):
        np.testing.assert_allclose(ys["x"], np.where(there, exact, np.nan), rtol=0, atol=1e-9)


def test_results_that_rounding_spoils_are_told() -> None:
    """Lorenz's motion from starts one unit in the last place apart, whose distance no method can avoid."""
    lorenz = ode.Problem(
        y0=lambda args: {"x": args, "y": 1.0, "z": 1.0},
        vector_field=lambda t, y, args: {
            "x": 10 * (y["y"] - y["x"]),
            "y": y["x"] * (28 - y["z"]) - y["y"],
            "z": y["x"] * y["y"] - 8 / 3 * y["z"],
        },
    )
    end, other = (
        ode.solve(lorenz, start, t1=np.array([15.0, 20.0, 40.0, 45.0])) for start in (1.0, np.nextafter(1, 2))
    )
    apart = np.abs(end.y["x"] - other.y["x"]) / 17
    assert list(end.inexact) == list(other.inexact) == list(apart > 1e-7) == [False, False, True, True]
    assert "2 of 4 lanes err by more than 1e-07" in end.warnings[0]
    assert list(end.to_dataset()["inexact"].values) == end.to_dict()["inexact"] == [False, False, True, True]


def test_the_end_is_a_time_among_others():
    """t0 + (t1 - t0) is another number for one pair in twelve."""
    still = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -y["x"]})
    for t0, t1 in ((-0.7, 2.4), (0.1, 0.7), (-1.3, 0.2), (0.3, 2.9)):
        end = ode.solve(still, t0=t0, t1=t1, ts=[t0, t1])
        assert end.t == t1
        np.testing.assert_allclose(end.ys["x"], [1.0, np.exp(t0 - t1)], rtol=1e-9)
        inside = jax.jit(lambda t1, t0=t0: ode.solve(still, t0=t0, t1=t1, ts=[t0, t1]).ys["x"])(t1)
        np.testing.assert_allclose(inside, end.ys["x"], rtol=1e-9)


def test_no_times_of_a_motion_with_kinks():
    problem = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -args["c"] * jnp.abs(y["x"])})
    for ts in ([], [np.nan]):
        end = ode.solve(problem, {"c": 1.0}, t1=1.0, wrt="c", ts=ts)
        assert end.times is not None
        assert end.times.ys["x"].shape == (len(ts),)
        assert end.along("c").t.shape == ()
    none = ode.solve(problem, {"c": np.zeros(0)}, t1=1.0, wrt="c", ts=[0.5])
    assert none.times is not None
    assert none.times.ys["x"].shape == (0, 1)


def test_arrays_of_the_caller_may_change_afterwards():
    args, ts = {"c": np.array([1.0, 2.0])}, np.array([0.5, 1.0])
    problem = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -args["c"] * y["x"]})
    end = ode.solve(problem, args, t1=1.0, ts=ts)
    assert end.times is not None
    before = end.gradient(y={"x": 1.0})["c"]
    args["c"] *= 10
    ts *= 1000
    np.testing.assert_array_equal(end.times.ts, [0.5, 1.0])
    np.testing.assert_array_equal(end.gradient(y={"x": 1.0})["c"], before)
