"""Six standard problems with events, each written once for JAX, numpy and heyoka.

A problem's expressions take a namespace `m` of functions (`sin`, `exp`, …), so that all contenders compute the same.
Each starts many lanes at random, and most of them end at an event.
"""

import abc
import functools
import math
import types
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from erosion import ode

Lanes = dict[str, np.ndarray]
_FUNCTIONS = ("sin", "cos", "exp", "expm1", "sqrt")
_BERNOULLI = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600, 1 / 47900160, -691 / 1307674368000, 1 / 74724249600)
_NEAR = 0.25  # below this x/(exp(x) - 1) is summed: its quotient loses the digits of its derivatives


def _bernoulli(m: Any, x: Any) -> Any:
    """x/(exp(x) - 1), with all digits of its derivatives at 0."""
    square, total = x * x, 0.0
    for coefficient in reversed(_BERNOULLI):
        total = (total + coefficient) * square
    return m.where(m.less(square, _NEAR**2), 1.0 - 0.5 * x + total, x / m.expm1(x))


JAX = types.SimpleNamespace(**{name: getattr(jnp, name) for name in _FUNCTIONS}, where=jnp.where, less=jnp.less)
NUMPY = types.SimpleNamespace(**{name: getattr(np, name) for name in _FUNCTIONS}, where=np.where, less=np.less)


@functools.cache
def heyoka_math() -> Any:
    """Heyoka's functions of expressions."""
    import heyoka as hy

    functions = {name: getattr(hy, name) for name in _FUNCTIONS if name != "expm1"}
    return types.SimpleNamespace(**functions, expm1=lambda x: hy.exp(x) - 1.0, where=hy.select, less=hy.lt)


class Case(abc.ABC):
    """A problem, and where its lanes begin.

    Args:
        name: in tables.
        state: names of the unknowns.
        directions: of the events, by name: +1, -1 or 0.
        wrt: the number by which derivatives are taken.
        only_at_start: numbers on which the start alone depends.
        t1: where a lane without an event ends.
        judged: the result by which contenders are compared, the time of the event or a part of the state.
        at_start: an event before this time is the section on which a lane begins.
        absolute: the absolute tolerance of scipy and diffrax, of the relative one.
    """

    name: ClassVar[str]
    state: ClassVar[tuple[str, ...]]
    directions: ClassVar[Mapping[str, int]]
    wrt: ClassVar[str]
    only_at_start: ClassVar[tuple[str, ...]]
    t1: ClassVar[float]
    judged: ClassVar[str] = "t"
    at_start: ClassVar[float] = 1e-9
    absolute: ClassVar[float] = 1e-3

    @abc.abstractmethod
    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Random numbers of lanes."""

    @abc.abstractmethod
    def start(self, m: Any, p: Any) -> list[Any]:
        """The unknowns at the start."""

    @abc.abstractmethod
    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Their rates."""

    @abc.abstractmethod
    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The event functions."""

    @abc.abstractmethod
    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """A rate that is integrated along where that is asked for."""

    def problem(self, *, integral: bool = False) -> ode.Problem:
        """The problem for `ode.solve`."""

        def elements(y: Any) -> list[Any]:
            return [y[name] for name in self.state]

        def event(i: int) -> Any:
            return lambda t, y, args: self.events(JAX, t, elements(y), args)[i]

        return ode.Problem(
            y0=lambda args: dict(zip(self.state, self.start(JAX, args), strict=True)),
            vector_field=lambda t, y, args: dict(zip(self.state, self.rates(JAX, t, elements(y), args), strict=True)),
            events={
                name: ode.Event(event(i), direction) for i, (name, direction) in enumerate(self.directions.items())
            },
            integrals={"integral": lambda t, y, args: self.integral(JAX, t, elements(y), args)} if integral else {},
        )


class Lorenz(Case):
    """The way down through z = ρ - 1, a Poincaré section."""

    name, state, directions = "Lorenz, section", ("x", "y", "z"), {"down": -1}
    wrt, only_at_start, t1 = "rho", ("x0", "y0", "z0"), 5.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """About the classical numbers."""
        ranges = {"sigma": (8, 12), "rho": (24, 32), "beta": (2, 3), "x0": (-15, 15), "y0": (-20, 20), "z0": (10, 40)}
        return {name: random.uniform(low, high, lanes) for name, (low, high) in ranges.items()}

    def start(self, m: Any, p: Any) -> list[Any]:
        """Anywhere near the attractor."""
        return [p["x0"], p["y0"], p["z0"]]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Lorenz, J. Atmos. Sci. 20, 1963, 130."""
        x, y, z = s
        return [p["sigma"] * (y - x), x * (p["rho"] - z) - y, x * y - p["beta"] * z]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Of order 1."""
        return [(s[2] - (p["rho"] - 1.0)) / 10.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """Its mean square."""
        return s[0] * s[0]


class ThreeBodies(Case):
    """The circular restricted three-body problem, from the axis to the axis, into a primary, or away."""

    name, state = "three bodies, 5 events", ("x", "y", "vx", "vy")
    directions: ClassVar = {"down": -1, "up": 1, "first": -1, "second": -1, "away": -1}
    wrt, only_at_start, t1 = "vy0", ("x0", "vy0"), 20.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """About earth and moon."""
        return {
            "mu": random.uniform(0.01, 0.02, lanes),
            "x0": random.uniform(0.3, 0.8, lanes),
            "vy0": random.uniform(0.2, 1.6, lanes) * random.choice([-1.0, 1.0], lanes),
        }

    def start(self, m: Any, p: Any) -> list[Any]:
        """On the axis, upright."""
        return [p["x0"], 0.0 * p["x0"], 0.0 * p["x0"], p["vy0"]]

    def _squares(self, s: Sequence[Any], p: Any) -> tuple[Any, Any]:
        """The squares of the distances from the primaries."""
        (x, y), mu = s[:2], p["mu"]
        return (x + mu) * (x + mu) + y * y, (x - 1.0 + mu) * (x - 1.0 + mu) + y * y

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """In the frame that turns with the primaries."""
        (x, y, vx, vy), mu, (one, two) = s, p["mu"], self._squares(s, p)
        pull, other = (1.0 - mu) / (one * m.sqrt(one)), mu / (two * m.sqrt(two))
        ax = 2.0 * vy + x - pull * (x + mu) - other * (x - 1.0 + mu)
        return [vx, vy, ax, -2.0 * vx + y - pull * y - other * y]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The axis down and up; 1 and 0.3 % of the unit of length from the primaries; far away."""
        one, two = self._squares(s, p)
        return [1.0 * s[1], 1.0 * s[1], one / 1e-4 - 1.0, two / 1e-5 - 1.0, 1.0 - (s[0] * s[0] + s[1] * s[1]) / 9.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """Twice the action."""
        return s[2] * s[2] + s[3] * s[3]


class HodgkinHuxley(Case):
    """A nerve from rest to its first spike, or none."""

    name, state, directions = "Hodgkin–Huxley spike", ("v", "m", "h", "n"), {"spike": 1}
    wrt, only_at_start, t1 = "current", (), 50.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Currents that make a spike and that do not."""
        ranges = {"current": (2, 20), "sodium": (90, 150), "potassium": (28, 44), "leak": (0.2, 0.4)}
        return {name: random.uniform(low, high, lanes) for name, (low, high) in ranges.items()}

    def _gates(self, m: Any, v: Any) -> tuple[Any, ...]:
        """How fast the gates m, h, n open and close."""
        return (
            _bernoulli(m, -(v + 40.0) / 10.0),
            4.0 * m.exp(-(v + 65.0) / 18.0),
            0.07 * m.exp(-(v + 65.0) / 20.0),
            1.0 / (1.0 + m.exp(-(v + 35.0) / 10.0)),
            0.1 * _bernoulli(m, -(v + 55.0) / 10.0),
            0.125 * m.exp(-(v + 65.0) / 80.0),
        )

    def start(self, m: Any, p: Any) -> list[Any]:
        """At rest without a current."""
        gates = [float(gate) for gate in self._gates(NUMPY, np.float64(-65.0))]
        return [0.0 * p["current"] + value for value in (-65.0, *(a / (a + b) for a, b in zip(*[iter(gates)] * 2)))]  # noqa: B905

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Hodgkin and Huxley, J. Physiol. 117, 1952, 500."""
        v, am, ah, an = s
        a, b, c, d, e, f = self._gates(m, v)
        current = p["current"] - self._sodium(s, p) - p["potassium"] * an * an * an * an * (v + 77.0)
        return [
            current - p["leak"] * (v + 54.387),
            a * (1.0 - am) - b * am,
            c * (1.0 - ah) - d * ah,
            e * (1.0 - an) - f * an,
        ]

    def _sodium(self, s: Sequence[Any], p: Any) -> Any:
        return p["sodium"] * s[1] * s[1] * s[1] * s[2] * (s[0] - 50.0)

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Up through 0 mV."""
        return [s[0] / 50.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """The charge that sodium carries."""
        return self._sodium(s, p)


class Ballistic(Case):
    """A shell with quadratic drag, to the ground."""

    name, state, directions = "ballistic with drag", ("x", "y", "vx", "vy"), {"ground": -1}
    wrt, only_at_start, t1 = "angle", ("angle", "v0"), 100.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """From hardly any drag to much."""
        return {
            "angle": random.uniform(0.2, 1.3, lanes),
            "v0": random.uniform(20, 300, lanes),
            "c": 10 ** random.uniform(-4, -2, lanes),
        }

    def start(self, m: Any, p: Any) -> list[Any]:
        """On the ground."""
        zero = 0.0 * p["angle"]
        return [zero, zero, p["v0"] * m.cos(p["angle"]), p["v0"] * m.sin(p["angle"])]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Gravity and drag."""
        _, _, vx, vy = s
        speed = m.sqrt(vx * vx + vy * vy)
        return [vx, vy, -p["c"] * speed * vx, -9.81 - p["c"] * speed * vy]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The height."""
        return [s[1] / 100.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """The work of the drag."""
        square = s[2] * s[2] + s[3] * s[3]
        return p["c"] * square * m.sqrt(square)


class MichaelisMenten(Case):
    """An oral dose that is eliminated at a limited rate, until its concentration has fallen below a threshold."""

    name, state, directions = "Michaelis–Menten", ("a", "c"), {"below": -1}
    wrt, only_at_start, t1 = "vmax", ("dose",), 200.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Some thresholds are never reached."""
        ranges = {"dose": (5, 60), "ka": (0.3, 3), "vmax": (0.5, 4), "km": (0.1, 4), "threshold": (0.2, 6)}
        return {name: random.uniform(low, high, lanes) for name, (low, high) in ranges.items()}

    def start(self, m: Any, p: Any) -> list[Any]:
        """All in the gut."""
        return [1.0 * p["dose"], 0.0 * p["dose"]]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Absorbed, and eliminated."""
        a, c = s
        return [-p["ka"] * a, p["ka"] * a - p["vmax"] * c / (p["km"] + c)]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Over the threshold."""
        return [s[1] / p["threshold"] - 1.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """The area under the curve."""
        return s[1]


class Pendulum(Case):
    """A driven damped pendulum, until it swings over the top."""

    name, state, directions = "driven pendulum (t)", ("angle", "speed"), {"left": -1, "right": 1}
    wrt, only_at_start, t1 = "force", (), 100.0

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Some forces are too weak."""
        ranges = {"force": (0.2, 1.5), "frequency": (0.3, 1.5), "damping": (0.05, 0.5)}
        return {name: random.uniform(low, high, lanes) for name, (low, high) in ranges.items()}

    def start(self, m: Any, p: Any) -> list[Any]:
        """At rest."""
        return [0.0 * p["force"], 0.0 * p["force"]]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Gravity, damping and force."""
        angle, speed = s
        return [speed, -m.sin(angle) - p["damping"] * speed + p["force"] * m.cos(p["frequency"] * t)]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Over the top on either side."""
        return [s[0] / math.pi + 1.0, s[0] / math.pi - 1.0]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """What the damping dissipates."""
        return p["damping"] * s[1] * s[1]


CASES: dict[str, Case] = {
    case.__name__: case() for case in (Lorenz, ThreeBodies, HodgkinHuxley, Ballistic, MichaelisMenten, Pendulum)
}


def lanes_of(case: Case, lanes: int, seed: int = 34) -> Lanes:
    """Random lanes, always the same."""
    return case.sample(lanes, np.random.default_rng(seed))
