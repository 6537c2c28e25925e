"""Cases that others published, against their numbers or closed forms."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from erosion import ode

MOON = 0.012277471


def three_bodies(mu: float) -> Any:
    """The rate of (x, y, u, v) of a light body in the plane of two heavy ones, which rotates with these."""

    def rate(t: Any, s: Any, args: Any) -> Any:
        x, y, u, v = s
        first, second = ((x + mu) ** 2 + y**2) ** -1.5, ((x - 1 + mu) ** 2 + y**2) ** -1.5
        pull, drag = (1 - mu) * first + mu * second, (1 - mu) * mu * (first - second)
        return u, v, x + 2 * v - pull * x - drag, y - 2 * u - pull * y

    return rate


def jacobi(s: Any, mu: float) -> Any:
    """The integral of the motion of three bodies."""
    x, y, u, v = s
    far, near = np.hypot(x + mu, y), np.hypot(x - 1 + mu, y)
    return x**2 + y**2 + 2 * (1 - mu) / far + 2 * mu / near - u**2 - v**2


def test_the_arenstorf_orbit_closes():
    """E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I (1993), section II.0."""
    start, period = (0.994, 0.0, 0.0, -2.00158510637908252240537862224), 17.0652165601579625588917206249
    orbit = ode.Problem(
        start,
        three_bodies(MOON),
        {"axis": ode.Event(lambda t, s, args: s[1], 0, lambda t, s, args: s)},
    )
    end = ode.solve(orbit, t1=period + 0.01, rtol=1e-13, smooth=True)
    # It crosses the axis at half the period as well, at right angles.
    times = end.events.t
    assert times[-1] == pytest.approx(period, abs=1e-7)
    assert np.abs(times - period / 2).min() < 1e-8
    np.testing.assert_allclose([part[-1] for part in end.events.y], start, atol=3e-5)
    np.testing.assert_allclose(jacobi(end.y, MOON), jacobi(start, MOON), rtol=1e-9)


def test_a_plane_section_of_three_bodies():
    """DiffEqGPU.jl #142: many orbits of three bodies with conditions at which they end."""
    section = ode.Problem(
        lambda args: (args["x"], 0.0, 0.0, args["v"]),
        three_bodies(MOON),
        {
            "section": ode.Event(lambda t, s, args: s[1], 1),
            "moon": ode.Event(lambda t, s, args: (s[0] - 1 + MOON) ** 2 + s[1] ** 2 - 0.005**2, -1),
            "away": ode.Event(lambda t, s, args: s[0] ** 2 + s[1] ** 2 - 4, 1),
        },
    )
    draw = np.random.default_rng(3)
    args = {"x": draw.uniform(0.3, 0.9, 10_000), "v": draw.uniform(0.3, 1.6, 10_000)}
    end = ode.solve(section, args, t1=20.0, smooth=True)
    assert {"section", "away"} <= set(end.ended_by) <= {"section", "away", "moon", "t1"}
    np.testing.assert_allclose(end.y[1][end.ended_by == "section"], 0, atol=1e-12)
    before = jacobi((args["x"], 0.0, 0.0, args["v"]), MOON)
    np.testing.assert_allclose(jacobi(end.y, MOON), before, rtol=1e-8)


def test_the_cannon_of_scipy():
    """The documentation of `scipy.integrate.solve_ivp`: a shot upwards hits the ground at 40, its apex is at 20."""
    cannon = ode.Problem(
        jnp.array([0.0, 10.0]),
        lambda t, y, args: jnp.stack([y[1], jnp.float64(-0.5)]),
        {
            "hit_ground": ode.Event(lambda t, y, args: y[0], -1),
            "apex": ode.Event(lambda t, y, args: y[1], 0, lambda t, y, args: y),
        },
    )
    end = ode.solve(cannon, t1=100.0)
    assert (end.ended_by, end.t) == ("hit_ground", pytest.approx(40, rel=1e-12))
    assert list(end.events.name) == ["apex", "hit_ground"]
    np.testing.assert_allclose(end.events.t, [20, 40], rtol=1e-12)
    np.testing.assert_allclose(end.events.y, [[100, 0], [0, -10]], atol=1e-9)


@pytest.mark.parametrize(("direction", "times"), [(0, 3), (1, 2), (-1, 1)])
def test_the_events_of_scipys_tests(direction, times):
    """`scipy/integrate/_ivp/tests/test_ivp.py`, test_events: a rational problem whose solution is known."""
    rational = ode.Problem(
        jnp.array([1 / 3, 2 / 9]),
        lambda t, y, args: jnp.stack([y[1] / t, y[1] * (y[0] + 2 * y[1] - 1) / (t * (y[0] - 1))]),
        {
            "one": ode.Event(lambda t, y, args: y[0] - y[1] ** 0.7, direction, lambda t, y, args: y),
            "two": ode.Event(lambda t, y, args: y[1] ** 0.6 - y[0], direction, lambda t, y, args: y),
            "three": ode.Event(lambda t, y, args: t - 7.4, direction, lambda t, y, args: y),
        },
    )
    end = ode.solve(rational, t0=5.0, t1=8.0)

    def exact(t: float) -> np.ndarray:
        return np.array([t / (t + 10), 10 * t / (t + 10) ** 2])

    roots: dict[str, Any] = {
        "one": brentq(lambda t: exact(t)[0] - exact(t)[1] ** 0.7, 5, 8, xtol=1e-14),
        "two": brentq(lambda t: exact(t)[1] ** 0.6 - exact(t)[0], 5, 8, xtol=1e-14),
        "three": 7.4,
    }
    assert 5.3 < roots["one"] < 5.7
    assert 7.3 < roots["two"] < 7.7
    names = {0: ["one", "three", "two"], 1: ["one", "three"], -1: ["two"]}[direction]
    assert list(end.events.name) == names
    assert end.count == times
    np.testing.assert_allclose(end.events.t, [roots[name] for name in names], rtol=1e-9)
    np.testing.assert_allclose(end.y, exact(8.0), rtol=1e-9)


def test_the_sensitivity_of_heyokas_notebook():
    """heyoka.py, doc/notebooks/ev_sensitivity.ipynb: when an oscillator is at its maximum, and f = (x - A)²."""
    spring = ode.Problem(
        {"x": 0.0, "v": 1.0},
        lambda t, y, args: {"x": y["v"], "v": -args["k"] * y["x"]},
        {"maximum": ode.Event(lambda t, y, args: y["v"])},
    )
    end = ode.solve(spring, {"k": np.array([0.456, 7.23])}, t1=100.0, wrt="k", derivatives=2)
    k = np.array([0.456, 7.23])
    np.testing.assert_allclose(end.t, np.pi / (2 * np.sqrt(k)), rtol=1e-10)
    assert end.along("k").t[0] == pytest.approx(-2.550601538829664, rel=1e-9)
    np.testing.assert_allclose(end.along("k", "k").t, 3 * np.pi / (8 * k**2.5), rtol=1e-7)
    slope = 2 * (end.y["x"] - 10.123) * end.along("k").y["x"]
    assert slope[1] == pytest.approx(0.5015866697490922, rel=1e-8)


def test_matlabs_ballode():
    """MATLAB, `ballode`: ten bounces of a ball thrown up at 20 m/s, which keeps 0.9 of its speed at each."""
    ball = ode.Problem(
        lambda args: {"y": 0.0, "v": args["v"]},
        lambda t, y, args: {"y": y["v"], "v": -9.8},
        {"bounce": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -args["e"] * y["v"]})},
    )
    args = {"v": 20.0, "e": 0.9}
    end = ode.solve(ball, args, t1=30.0, max_events=10, wrt=("v", "e"), derivatives=2)

    def tenth(v: Any, e: Any) -> Any:
        return 2 * v / 9.8 * (1 - e**10) / (1 - e)

    assert (end.ended_by, end.count) == ("bounce", 10)
    np.testing.assert_allclose(end.events.t, 40 / 9.8 * np.cumsum(0.9 ** np.arange(10)), rtol=1e-9)
    slopes, curves = (jax.jit(of(tenth, (0, 1)))(20.0, 0.9) for of in (jax.jacfwd, jax.hessian))
    np.testing.assert_allclose([end.along("v").t, end.along("e").t], slopes, rtol=1e-8)
    given = [[end.along(one, other).t for other in args] for one in args]
    np.testing.assert_allclose(given, curves, rtol=1e-6, atol=1e-9)


def test_petscs_switched_linear_system():
    """PETSc, src/ts/tutorials/hybrid/ex1.c, after I. A. Hiskens and M. A. Pai (IEEE Trans. CAS I 47, 2000, 204-220).

    The derivatives by the switching parameters are those of differences of matrix exponentials.
    """
    matrices = np.array([[[1.0, -100], [10, 1]], [[1, 10], [-100, 1]]])

    def switch(args: Any, y: Any) -> Any:
        return y["u"][1] - jnp.where(y["mode"] > 0, args["high"], args["low"]) * y["u"][0]

    system = ode.Problem(
        {"u": np.array([0.0, 1.0]), "mode": 1.0},
        lambda t, y, args: {
            "u": (jnp.array(matrices[0]) * (1 + y["mode"]) / 2 + jnp.array(matrices[1]) * (1 - y["mode"]) / 2) @ y["u"],
            "mode": 0.0,
        },
        {
            "to 2": ode.Event(
                lambda t, y, args: y["u"][1] - args["high"] * y["u"][0] + 1e9 * (1 - y["mode"]),
                -1,
                lambda t, y, args: {**y, "mode": -1.0},
            ),
            "to 1": ode.Event(
                lambda t, y, args: y["u"][1] - args["low"] * y["u"][0] + 1e9 * (1 + y["mode"]),
                1,
                lambda t, y, args: {**y, "mode": 1.0},
            ),
        },
    )
    args = {"high": 2.75, "low": 0.36}
    end = ode.solve(system, args, t1=0.125, wrt=("high", "low"))

    def exact(high: float, low: float) -> tuple[np.ndarray, list[float]]:
        t, u, mode, times = 0.0, np.array([0.0, 1.0]), 0, []
        while True:
            slope = (high, low)[mode]

            def function(dt: float, u: np.ndarray = u, mode: int = mode, slope: float = slope) -> float:
                there = expm(matrices[mode] * dt) @ u
                return there[1] - slope * there[0]

            grid = np.arange(1e-9, 0.126 - t, 5e-4)
            values = np.array([function(dt) for dt in grid])
            turns = np.flatnonzero(values[1:] * values[:-1] < 0)
            if not turns.size or t + grid[turns[0]] > 0.125:
                return expm(matrices[mode] * (0.125 - t)) @ u, times
            dt: Any = brentq(function, grid[turns[0]], grid[turns[0] + 1], xtol=1e-16)
            if t + dt > 0.125:
                return expm(matrices[mode] * (0.125 - t)) @ u, times
            t, u, mode = t + dt, expm(matrices[mode] * dt) @ u, 1 - mode  # pyrefly: ignore
            times.append(t)

    u, times = exact(2.75, 0.36)
    assert len(times) == 2
    np.testing.assert_allclose(end.events.t, times, rtol=1e-9)
    np.testing.assert_allclose(end.y["u"], u, rtol=1e-8)
    for name, step in {"high": (1e-4, 0.0), "low": (0.0, 1e-4)}.items():
        ends = [exact(2.75 + k * step[0], 0.36 + k * step[1])[0] for k in (-1, 1)]
        np.testing.assert_allclose(end.along(name).y["u"], (ends[1] - ends[0]) / 2e-4, rtol=1e-5)


def test_lorenz_map_of_maxima():
    """E. N. Lorenz, Deterministic nonperiodic flow (J. Atmos. Sci. 20, 1963, 130-141), figure 4: a tent.

    The first maxima are those of DOP853; later ones are chaotic, but lie on one curve with one cusp.
    """

    def rate(t: Any, s: Any, args: Any = None) -> Any:
        x, y, z = s
        return 10 * (y - x), 28 * x - y - x * z, x * y - 8 / 3 * z

    lorenz = ode.Problem(
        (0.0, 1.0, 0.0), rate, {"maximum": ode.Event(lambda t, s, args: rate(t, s)[2], -1, lambda t, s, args: s)}
    )
    end = ode.solve(lorenz, t1=80.0, rtol=1e-11)
    peaks = end.events.y[2]

    def top(t: float, s: np.ndarray) -> float:
        return rate(t, s)[2]

    vars(top).update(direction=-1)
    judge = solve_ivp(rate, (0, 10), (0, 1, 0), "DOP853", rtol=1e-12, atol=1e-13, events=top)
    count = judge.t_events[0].size
    assert count > 8
    np.testing.assert_allclose(end.events.t[:count], judge.t_events[0], rtol=1e-7)
    np.testing.assert_allclose(peaks[:count], judge.y_events[0][:, 2], rtol=1e-6)
    # Without the way to the attractor.
    now, following = peaks[15:-1], peaks[16:]
    order = np.argsort(now)
    now, following = now[order], following[order]
    cusp = now[np.argmax(following)]
    steps, rises = np.diff(now), np.diff(following)
    clear = steps > 0.05
    assert (rises[clear & (now[1:] <= cusp)] > steps[clear & (now[1:] <= cusp)]).mean() > 0.95
    assert (rises[clear & (now[:-1] >= cusp)] < 0).all()


def test_the_peak_of_an_epidemic():
    """W. O. Kermack, A. G. McKendrick (Proc. R. Soc. A 115, 1927, 700-721): at most 1 - (1 + ln R₀ s₀)/R₀ are ill."""
    sir = ode.Problem(
        lambda args: {"s": 1 - args["i"], "i": args["i"]},
        lambda t, y, args: {"s": -args["r"] * y["s"] * y["i"], "i": (args["r"] * y["s"] - 1) * y["i"]},
        {"peak": ode.Event(lambda t, y, args: args["r"] * y["s"] - 1, -1)},
    )
    args = {"i": np.array([1e-3, 1e-2]), "r": np.array([[1.5], [2.5], [12.0]])}
    end = ode.solve(sir, args, t1=200.0, wrt=("i", "r"), derivatives=2)
    i, r = args["i"], args["r"]
    s = 1 - i
    np.testing.assert_allclose(end.y["i"], 1 - (1 + np.log(r * s)) / r, rtol=1e-9)
    np.testing.assert_allclose(end.y["s"], np.broadcast_to(1 / r, (3, 2)), rtol=1e-9)
    np.testing.assert_allclose(end.along("i").y["i"], 1 / (r * s), rtol=1e-7)
    np.testing.assert_allclose(end.along("r").y["i"], np.log(r * s) / r**2, rtol=1e-7)
    # These are what is left of terms that are larger by 1/i²: the error is small beside the terms.
    np.testing.assert_allclose(end.along("i", "i").y["i"] * i**2, i**2 / (r * s**2), atol=1e-9)
    np.testing.assert_allclose(end.along("r", "i").y["i"], -1 / (r**2 * s), rtol=1e-6)
    np.testing.assert_allclose(end.along("r", "r").y["i"], (1 - 2 * np.log(r * s)) / r**3, rtol=1e-6)


def test_keplers_apsides():
    """From the perihelion of an ellipse of a = 1 the aphelion comes after half a period, at 1 + e."""
    kepler = ode.Problem(
        lambda args: {"x": 1 - args["e"], "y": 0.0, "u": 0.0, "v": jnp.sqrt((1 + args["e"]) / (1 - args["e"]))},
        lambda t, s, args: {
            "x": s["u"],
            "y": s["v"],
            "u": -args["mu"] * s["x"] * (s["x"] ** 2 + s["y"] ** 2) ** -1.5,
            "v": -args["mu"] * s["y"] * (s["x"] ** 2 + s["y"] ** 2) ** -1.5,
        },
        {"apsis": ode.Event(lambda t, s, args: s["x"] * s["u"] + s["y"] * s["v"], 0, lambda t, s, args: s)},
    )
    e = np.array([0.1, 0.5, 0.8])
    end = ode.solve(
        kepler, {"e": e, "mu": 1.0}, t1=100.0, max_events=np.array([[1], [2]]), wrt="e", derivatives=2, smooth=True
    )
    np.testing.assert_allclose(end.t, np.broadcast_to([[np.pi], [2 * np.pi]], (2, 3)), rtol=1e-9)
    np.testing.assert_allclose(end.y["x"], [-(1 + e), 1 - e], rtol=1e-9)
    np.testing.assert_allclose(end.along("e").y["x"], [[-1] * 3] * 2, rtol=1e-7)
    np.testing.assert_allclose(end.along("e").t, 0, atol=1e-7)
    np.testing.assert_allclose(end.along("e", "e").y["x"], 0, atol=1e-5)


def test_an_event_that_is_zero_at_the_start():
    """torchdiffeq #285: a body thrown from the ground must come down, and not end where it starts."""
    ball = ode.Problem(
        lambda args: (0.0, args),
        lambda t, y, args: (y[1], -9.81),
        {"ground": ode.Event(lambda t, y, args: y[0])},
    )
    v = np.array([1e-3, 1.0, 1e3])
    end = ode.solve(ball, v, t1=1e3, wrt="")
    np.testing.assert_allclose(end.t, 2 * v / 9.81, rtol=1e-9)
    np.testing.assert_allclose(end.along("").t, 2 / 9.81, rtol=1e-8)


def test_to_go_on_after_an_event():
    """diffrax #492: a field that changes at an event; here a tank that a valve fills again once it is low."""
    tank = ode.Problem(
        {"level": 1.0, "fills": 0.0},
        lambda t, y, args: {"level": args["in"] * y["fills"] - y["level"], "fills": 0.0},
        {
            "low": ode.Event(lambda t, y, args: y["level"] - 0.2, -1, lambda t, y, args: {**y, "fills": 1.0}),
            "full": ode.Event(lambda t, y, args: y["level"] - 0.9, 1),
        },
    )
    end = ode.solve(tank, {"in": 2.0}, t1=50.0, wrt="in")
    assert (end.ended_by, end.count) == ("full", 2)
    assert end.t == pytest.approx(np.log(5) + np.log(1.8 / 1.1), rel=1e-9)
    assert end.along("in").t == pytest.approx(1 / 1.8 - 1 / 1.1, rel=1e-8)


@pytest.mark.parametrize("waves", [1, 3, 10, 30])
def test_an_event_between_the_ends_of_a_large_step(waves):
    """diffrax #507: the motion is straight, its steps are large, and the event function waves within them."""
    straight = ode.Problem(
        0.0,
        lambda t, y, args: 1.0,
        {"first": ode.Event(lambda t, y, args: jnp.cos(2 * jnp.pi * args["waves"] * y) + args["up"], -1)},
    )
    up = np.array([0.0, 0.5, 0.99, 1.01])
    end = ode.solve(straight, {"waves": float(waves), "up": up}, t1=1.0)
    assert list(end.ended_by) == ["first"] * 3 + ["t1"]
    np.testing.assert_allclose(end.t[:3], np.arccos(-up[:3]) / (2 * np.pi * waves), rtol=1e-8)
