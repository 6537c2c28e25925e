"""Problems whose motion is known in closed form: one list for accuracy, derivatives, times, chains, JAX and maxima.

Closed forms are functions of NumPy; their derivatives are differences of fourth order, which err by some 1e-10.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from erosion import ode

Values = Mapping[str, Any]
"""The numbers by name: those of `args`, and "t0" and "t1"; each an array, one number for each lane."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A problem with its closed form.

    Args:
        name: of the case.
        problem: to solve.
        args: its numbers by name; arrays are one number for each lane.
        state: of (t, values), the state at a time; where a reset happens that before it.
        end: of the values, when the lane ends.
        t0, t1: of each lane.
        wrt: the numbers by which derivatives are taken; all of `args` by default.
        ended_by: the event that ends each lane, or "t1".
        at_end: of the values, state and integrals at the end; by default those at the time `end`.
        integrals: of (t, values), by name.
        count: of events.
        ts: times, of which some lanes do not reach all.
        options: of `ode.solve`.
        methods: by which it is solved; for the method of stiff motions second derivatives may be NaN.
        kinks: whether the rates have kinks; then there is no reverse mode.
    """

    name: str
    problem: ode.Problem
    args: dict[str, Any]
    state: Callable[[Any, Values], Any]
    end: Callable[[Values], Any]
    t0: Any = 0.0
    t1: Any = 50.0
    wrt: tuple[str, ...] = ()
    ended_by: str = "t1"
    at_end: Callable[[Values], tuple[Any, dict[str, Any]]] | None = None
    integrals: Callable[[Any, Values], dict[str, Any]] = lambda t, values: {}
    count: int = 0
    ts: tuple[float, ...] = (0.1, 0.35, 0.8)
    options: dict[str, Any] = dataclasses.field(default_factory=dict)
    methods: tuple[str, ...] = ("explicit", "rosenbrock")
    kinks: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers by which derivatives are taken."""
        return self.wrt or tuple(self.args)

    @property
    def values(self) -> dict[str, Any]:
        """All numbers, each with an axis of lanes."""
        every = self.args | {"t0": self.t0, "t1": self.t1}
        lanes = np.broadcast_shapes((1,), *map(np.shape, every.values()))
        return {name: np.broadcast_to(np.asarray(value, float), lanes) for name, value in every.items()}

    def solve(self, args: Any = None, **options: Any) -> ode.Solution:
        """Solve it, with other arguments or options."""
        settings: dict[str, Any] = {"t0": self.t0, "t1": self.t1, **self.options, **options}
        return ode.solve(self.problem, self.args if args is None else args, **settings)

    def ends(self, values: Values) -> tuple[Any, Any, dict[str, Any]]:
        """Time, state and integrals at the end of each lane."""
        t = self.end(values)
        return t, *(self.at_end(values) if self.at_end else (self.state(t, values), self.integrals(t, values)))

    @property
    def reached(self) -> np.ndarray:
        """Which of `ts` each lane reaches, of shape (lanes, times)."""
        return np.array(self.ts) <= np.asarray(self.end(self.values))[:, None]


Quantity = Callable[[Values], Any]
"""A pytree of the values."""


def derivative(quantity: Quantity, name: str) -> Quantity:
    """The derivative of a quantity by one of the values."""

    def of(values: Values) -> Any:
        step = 1e-3 * np.maximum(np.abs(values[name]), 0.1)
        far = [quantity({**values, name: values[name] + k * step}) for k in (-2, -1, 1, 2)]
        return jax.tree.map(lambda a, b, c, d: (a - 8 * b + 8 * c - d) / (12 * step), *far)

    return of


def everything(part: Any) -> tuple[Any, Any, Any]:
    """Time, state and integrals of a solution or a derivative."""
    return part.t, part.y, part.integrals


def close(found: Any, exact: Any, rtol: float, atol: float = 0.0, *, or_nan: bool = False) -> None:
    """Compare two trees, relative to the largest number of each leaf; `or_nan` where a result may be withheld."""
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True):
        one, other = np.broadcast_arrays(np.asarray(one, float), np.asarray(other, float))
        known = ~np.isnan(one) if or_nan else np.full(one.shape, True)
        size = np.max(np.abs(other), initial=0.0, where=np.isfinite(other))
        np.testing.assert_allclose(one[known], other[known], rtol=rtol, atol=atol + rtol * size)


def _throw() -> Case:
    def end(values: Values) -> Any:
        v, g, h = values["v"], values["g"], values["h"]
        return values["t0"] + (v + np.sqrt(v**2 + 2 * g * h)) / g

    def state(t: Any, values: Values) -> Any:
        since = t - values["t0"]
        return {
            "v": values["v"] - values["g"] * since,
            "y": values["h"] + values["v"] * since - values["g"] * since**2 / 2,
        }

    return Case(
        "throw",
        ode.Problem(
            lambda args: {"y": args["h"], "v": args["v"]},
            lambda t, y, args: {"y": y["v"], "v": -args["g"]},
            {"ground": ode.Event(lambda t, y, args: y["y"], -1)},
            {"path": lambda t, y, args: y["v"]},
            integrals0=lambda args: {"path": args["h"] ** 2},
        ),
        {"h": np.array([0.5, 1.0, 3.0]), "v": np.array([2.0, 0.0, -1.0]), "g": 9.81},
        state,
        end,
        t0=0.25,
        wrt=("h", "v", "g", "t0"),
        ended_by="ground",
        integrals=lambda t, values: {"path": values["h"] ** 2 + state(t, values)["y"] - values["h"]},
        ts=(0.25, 0.3, 0.5, 0.75),
    )


def _driven() -> Case:
    """dx/dt = -x t: x = x0 exp(-(t² - t0²)/2), which falls to c at t = √(t0² + 2 ln(x0/c))."""

    def state(t: Any, values: Values) -> Any:
        return {"x": values["x0"] * np.exp(-(t**2 - values["t0"] ** 2) / 2)}

    return Case(
        "driven",
        ode.Problem(
            lambda args: {"x": args["x0"]},
            lambda t, y, args: {"x": -t * y["x"]},
            {"low": ode.Event(lambda t, y, args: y["x"] - args["c"], -1)},
            {"moment": lambda t, y, args: t * y["x"]},
        ),
        {"x0": np.array([2.0, 1.0, 5.0]), "c": 0.1},
        state,
        lambda values: np.sqrt(values["t0"] ** 2 + 2 * np.log(values["x0"] / values["c"])),
        t0=np.array([0.3, 0.5, -2.0]),  # from -2 the function rises first
        wrt=("x0", "c", "t0"),
        ended_by="low",
        integrals=lambda t, values: {"moment": values["x0"] - state(t, values)["x"]},
        ts=(0.6, 1.0, 2.2),
    )


def _spring() -> Case:
    """An oscillator to a time."""

    def state(t: Any, values: Values) -> Any:
        w, since = np.sqrt(values["k"]), t - values["t0"]
        x, v = values["x"], values["v"]
        return {
            "v": v * np.cos(w * since) - x * w * np.sin(w * since),
            "x": x * np.cos(w * since) + v / w * np.sin(w * since),
        }

    return Case(
        "spring to a time",
        ode.Problem(
            lambda args: {"x": args["x"], "v": args["v"]},
            lambda t, y, args: {"x": y["v"], "v": -args["k"] * y["x"]},
            integrals={"way": lambda t, y, args: y["v"]},
        ),
        {"x": np.array([1.0, 0.3, -2.0]), "v": 0.5, "k": np.array([1.0, 2.0, 0.7])},
        state,
        lambda values: values["t1"],
        t0=np.array([0.0, -1.0, 0.1]),
        t1=np.array([0.7, 2.0, 1.5]),
        wrt=("k", "t0", "t1"),
        integrals=lambda t, values: {"way": state(t, values)["x"] - values["x"]},
        ts=(0.1, 0.35, 0.7),
    )


def _drag() -> Case:
    """dv/dt = -v √(1 + v²): arsinh(1/v) = t + arsinh(1/v0). The root is never zero, but may be one of a kink."""

    def state(t: Any, values: Values) -> Any:
        return {"v": 1 / np.sinh(t + np.arcsinh(1 / values["v0"]))}

    return Case(
        "drag",
        ode.Problem(
            lambda args: {"v": args["v0"]},
            lambda t, y, args: {"v": -y["v"] * jnp.sqrt(1 + y["v"] ** 2)},
            {"slow": ode.Event(lambda t, y, args: y["v"] - args["c"], -1)},
        ),
        {"v0": np.array([3.0, 1.0]), "c": 0.1},
        state,
        lambda values: np.arcsinh(1 / values["c"]) - np.arcsinh(1 / values["v0"]),
        ended_by="slow",
        methods=("explicit",),
        kinks=True,
    )


def _kinked() -> Case:
    """du/dt = -a max(u, b), from above b to c below it."""

    def bend(values: Values) -> Any:
        return np.log(values["u0"] / values["b"]) / values["a"]

    def state(t: Any, values: Values) -> Any:
        a, b = values["a"], values["b"]
        return {"u": np.where(t < bend(values), values["u0"] * np.exp(-a * t), b - a * b * (t - bend(values)))}

    return Case(
        "kinked",
        ode.Problem(
            lambda args: {"u": args["u0"]},
            lambda t, y, args: {"u": -args["a"] * jnp.maximum(y["u"], args["b"])},
            {"low": ode.Event(lambda t, y, args: y["u"] - args["c"], -1)},
        ),
        {"u0": np.array([1.0, 2.0]), "a": np.array([1.0, 0.8]), "b": 0.5, "c": 0.1},
        state,
        lambda values: bend(values) + (values["b"] - values["c"]) / (values["a"] * values["b"]),
        ended_by="low",
        methods=("explicit",),
        kinks=True,
    )


BALL = ode.Problem(
    lambda args: {"y": args["h"], "v": 0.0},
    lambda t, y, args: {"y": y["v"], "v": -args["g"]},
    {"floor": ode.Event(lambda t, y, args: y["y"], -1, reset=lambda t, y, args: {"y": 0.0, "v": -args["e"] * y["v"]})},
    {"path": lambda t, y, args: y["v"] ** 2},
)
"""A ball that falls from rest and keeps a share e of its speed at each bounce."""


def bounces(values: Values, n: int) -> tuple[Any, Any]:
    """Times of the first n bounces, and the speeds before them; each of shape (n, lanes)."""
    i = np.arange(n)[:, None]
    speeds = np.sqrt(2 * values["g"] * values["h"]) * values["e"] ** i
    return values["t0"] + np.cumsum(np.where(i == 0, 1, 2) * speeds / values["g"], axis=0), speeds


def _ball_at(t: Any, values: Values) -> Any:
    up, start, since = values["h"] * 0.0, values["h"], t - values["t0"]
    for time, speed in zip(*bounces(values, 6), strict=True):
        up, start, since = (
            np.where(time < t, after, before)
            for after, before in ((values["e"] * speed, up), (0.0, start), (t - time, since))
        )
    return {"v": up - values["g"] * since, "y": start + up * since - values["g"] * since**2 / 2}


def _path(t: Any, values: Values) -> dict[str, Any]:
    """∫ v² dt: of each flight the difference of v³ / 3 g at its ends."""
    cubes, up = 0.0, 0.0
    for time, speed in zip(*bounces(values, 6), strict=True):
        cubes, up = cubes + np.where(time < t, speed**3 + up**3, 0.0), np.where(time < t, values["e"] * speed, up)
    return {"path": (cubes + up**3 - _ball_at(t, values)["v"] ** 3) / (3 * values["g"])}


_BALLS: dict[str, Any] = {"h": np.array([2.0, 1.0, 2.5]), "g": 9.81, "e": np.array([0.8, 0.7, 0.9])}


def _bounces(n: int) -> Case:
    def at_end(values: Values) -> tuple[Any, dict[str, Any]]:
        speeds = bounces(values, n)[1]
        cubes = speeds[0] ** 3 + 2 * np.sum(speeds[1:] ** 3, axis=0)
        return {"v": -speeds[-1], "y": 0.0 * values["h"]}, {"path": cubes / (3 * values["g"])}

    return Case(
        f"{n} bounces",
        BALL,
        _BALLS,
        _ball_at,
        lambda values: bounces(values, n)[0][-1],
        t0=0.3,
        t1=100.0,
        wrt=("h", "g", "e", "t0"),
        ended_by="floor",
        at_end=at_end,
        integrals=_path,
        count=n,
        ts=(0.3, 0.6, 1.4, 1.9),
        options={"max_events": n},
    )


def _bounces_to_a_time() -> Case:
    return Case(
        "bounces to a time",
        BALL,
        _BALLS | {"h": np.array([2.0, 1.9, 2.5])},
        _ball_at,
        lambda values: values["t1"],
        t0=np.array([0.0, 0.3, 0.1]),
        t1=np.array([2.0, 1.9, 2.2]),
        wrt=("h", "e", "t0", "t1"),
        integrals=_path,
        count=2,
        ts=(0.3, 1.0, 1.8),
    )


def _doses() -> Case:
    """An amount decays by k; every τ a dose is added, an event in time."""

    def times(t: Any, values: Values) -> tuple[Any, Any]:
        each = values["tau"] * np.arange(1, 10)[:, None]
        return each, each < t

    def taken(t: Any, values: Values) -> Any:
        each, past = times(t, values)
        return np.sum(past * values["dose"] * np.exp(-values["k"] * (t - np.minimum(each, t))), axis=0)

    def state(t: Any, values: Values) -> Any:
        return {"next": values["tau"] * np.sum(times(t, values)[1], axis=0), "x": taken(t, values)}

    def exposure(t: Any, values: Values) -> dict[str, Any]:
        given = values["dose"] * np.sum(times(t, values)[1], axis=0)
        return {"exposure": (given - taken(t, values)) / values["k"]}

    return Case(
        "doses",
        ode.Problem(
            {"x": 0.0, "next": 0.0},
            lambda t, y, args: {"x": -args["k"] * y["x"], "next": 0.0},
            {
                "dose": ode.Event(
                    lambda t, y, args: t - y["next"] - args["tau"],
                    1,
                    lambda t, y, args: {"x": y["x"] + args["dose"], "next": t},
                )
            },
            {"exposure": lambda t, y, args: y["x"]},
        ),
        {"k": np.array([0.3, 1.0]), "tau": 2.0, "dose": np.array([5.0, 2.0])},
        state,
        lambda values: values["t1"],
        t1=9.5,
        integrals=exposure,
        count=4,
        ts=(1.0, 2.5, 5.0, 9.5),
    )


def _relay() -> Case:
    """A switch with hysteresis, part of the state: x runs towards ±b/a, and the field turns at ±c."""

    def times(values: Values) -> Any:
        a, b, c = values["a"], values["b"], values["c"]
        first, each = np.log(b / (b - a * c)) / a, np.log((b + a * c) / (b - a * c)) / a
        return first + each * np.arange(12)[:, None]

    def state(t: Any, values: Values) -> Any:
        on, start, since = 1.0 + 0.0 * values["b"], 0.0, t
        for time in times(values):
            on, start, since = (
                np.where(time < t, after, before)
                for after, before in ((-on, on), (on * values["c"], start), (t - time, since))
            )
        rest = on * values["b"] / values["a"]
        return {"on": on, "x": rest + (start - rest) * np.exp(-values["a"] * since)}

    return Case(
        "relay",
        ode.Problem(
            {"x": 0.0, "on": 1.0},
            lambda t, y, args: {"x": -args["a"] * y["x"] + args["b"] * y["on"], "on": 0.0},
            {
                "high": ode.Event(lambda t, y, args: y["x"] - args["c"], 1, lambda t, y, args: {**y, "on": -1.0}),
                "low": ode.Event(lambda t, y, args: y["x"] + args["c"], -1, lambda t, y, args: {**y, "on": 1.0}),
            },
        ),
        {"a": np.array([0.5, 1.0]), "b": 1.3, "c": np.array([0.8, 0.6])},
        state,
        lambda values: times(values)[5],
        t1=100.0,
        ended_by="low",
        at_end=lambda values: ({"on": -1.0 + 0.0 * values["c"], "x": -values["c"]}, {}),
        count=6,
        ts=(0.3, 1.0, 3.0),
        options={"max_events": 6},
    )


def _follows(t: Any, values: Values) -> Any:
    """y′ = -k (y - cos t) from s: a slow motion, and a fast part that dies away."""
    k = values.get("k", 1e4)
    slow = lambda t: (k**2 * np.cos(t) + k * np.sin(t)) / (k**2 + 1)  # noqa: E731
    return {"y": slow(t) + (values["s"] - slow(0.0)) * np.exp(-k * t)}


def _falls_to_level(values: Values, n: int = 0) -> Any:
    k = values.get("k", 1e4)
    return np.arctan2(1.0, k) + np.arccos(values["level"] * np.sqrt(k**2 + 1) / k) + 2 * np.pi * n


def _stiff(reset: Any, n: int, **k: Any) -> Case:
    return Case(
        f"stiff chain of {n}" if reset else "stiff",
        ode.Problem(
            lambda args: {"y": args["s"]},
            lambda t, y, args: {"y": -args.get("k", 1e4) * (y["y"] - jnp.cos(t))},
            {"low": ode.Event(lambda t, y, args: y["y"] - args["level"], -1, reset)},
        ),
        {"s": 1.5, "level": np.array([0.3, 0.5]), **k},
        _follows,
        lambda values: _falls_to_level(values, n - 1),
        t1=20.0,
        wrt=("level", *k),
        ended_by="low",
        at_end=lambda values: ({"y": values["level"]}, {}),
        count=n,
        ts=(0.5, 1.0),
        options={"max_events": n} if reset else {},
        methods=("rosenbrock", "auto"),
    )


def _stiff_to_a_time() -> Case:
    return dataclasses.replace(
        _stiff(None, 1),
        name="stiff to a time",
        args={"s": 1.5, "k": np.array([1e5, 1e4]), "level": -5.0},
        end=lambda values: values["t1"],
        t1=1.5,
        wrt=("k", "t1"),
        ended_by="t1",
        at_end=None,
        count=0,
    )


CASES = {
    case.name: case
    for case in (
        _throw(),
        _driven(),
        _spring(),
        _drag(),
        _kinked(),
        _bounces(5),
        _bounces_to_a_time(),
        _doses(),
        _relay(),
        _stiff(None, 1, k=np.array([1e5, 1e4])),
        _stiff(lambda t, y, args: {"y": y["y"] - 0.2}, 2),
        _stiff_to_a_time(),
    )
}
