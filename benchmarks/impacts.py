"""Impacts of rotating bodies without units, as a problem for every contender, and random impacts for the engine."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

import erosion
from benchmarks.ode_problems import Case, Lanes

P = erosion.TABLE_1.to("si")


class RotatingImpact(Case):
    """An impact of `rotating`, or of a model that differs by its force ratio or its torque.

    Time is in 1/ω and length in v₀/ω, with ω = √(c/m). Neither the events nor the volume need x, and q is φ - π/2. The
    body starts 1e-300 deep: contenders find an event at depth 0, or lose the one that follows within a step.

    Args:
        full_torque: whether the vertical force turns the body, too.
    """

    name, state = "impact", ("y", "q", "vx", "vy", "omega", "volume")
    directions: ClassVar = {"rebound": -1, "stop": -1}
    wrt, only_at_start, t1, judged, at_start = "alpha", ("alpha", "s"), 1e3, "volume", 0.0

    def __init__(self, full_torque: bool = False) -> None:
        self.full_torque = full_torque

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Angles and spins of Table 1's particle at which it cuts."""
        alpha = random.uniform(0.05, 1.5, lanes)
        spin = random.uniform(np.maximum(-0.5, -0.95 * np.cos(alpha)), 0.5)
        return without_units("rotating", P.replace(alpha=alpha, phidot0=spin * P.v0 / P.r))

    def start(self, m: Any, p: Any) -> list[Any]:
        """At contact."""
        zero = 0.0 * p["alpha"]
        return [zero + 1e-300, zero, m.cos(p["alpha"]), m.sin(p["alpha"]), p["s"] / p["rho"], zero]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Newton's law; the force is proportional to the depth."""
        _, q, _, vy, omega, _ = s
        depth, speed = self.events(m, t, s, p)
        arm = m.cos(q) - p["ratio"] * m.sin(q) if self.full_torque else 1.0
        return [vy, omega, -depth, -p["ratio"] * depth, -depth * arm / (p["beta"] * p["rho"]), depth * speed]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Depth and horizontal speed of the tip."""
        y, q, vx, _, omega, _ = s
        half = m.sin(0.5 * q)
        lost = 2.0 * half * half  # 1 - cos q, with all its digits
        return [y - p["rho"] * lost, vx + p["rho"] * omega * (1.0 - lost)]

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """The depth."""
        return self.events(m, t, s, p)[0]


def without_units(model: str, p: erosion.Parameters) -> Lanes:
    """The numbers of impacts for `RotatingImpact`, from a model's name and parameters."""
    rate, alpha = np.sqrt(np.asarray(p.stiffness) / float(p.m)), np.asarray(p.alpha)
    steep = "tan-alpha" in model or "velocity-aligned" in model
    ratio = np.tan(alpha) if steep else p.k
    numbers = {"ratio": ratio, "rho": p.r * rate / p.v0, "beta": p.inertia, "alpha": alpha, "s": p.phidot0 * p.r / p.v0}
    return {name: np.broadcast_to(np.asarray(values, float), alpha.shape).copy() for name, values in numbers.items()}


def with_units(lanes: Lanes) -> erosion.Parameters:
    """Impacts of Table 1's particle, from what `RotatingImpact.sample` gives."""
    return P.replace(alpha=lanes["alpha"], phidot0=lanes["s"] * P.v0 / P.r)


def volume_unit(p: erosion.Parameters) -> np.ndarray:
    """The unit of volume of `RotatingImpact`, b (v₀/ω)²."""
    return np.asarray(p.b * p.v0**2 * p.m / p.stiffness)


def usual(count: int, seed: int) -> erosion.Parameters:
    """Random impacts about Table 1, a fifth of them without spin."""
    random = np.random.default_rng(seed)
    v0, r = random.uniform(25, 250, count), float(P.r) * np.exp(random.uniform(-2, 2, count))
    spin = np.where(random.random(count) < 0.2, 0.0, random.uniform(-0.9, 0.9, count))
    return P.replace(
        k=np.exp(random.uniform(np.log(0.3), np.log(5), count)),
        v0=v0,
        r=r,
        phidot0=spin * v0 / r,
        inertia=random.uniform(0.3, 0.6, count),
        alpha=random.uniform(0.01, 1.56, count),
    )


def fast_turns(count: int, seed: int) -> erosion.Parameters:
    """Random impacts of Table 1's particle on targets so soft that it turns many times."""
    random = np.random.default_rng(seed)
    ratio = np.exp(random.uniform(np.log(3e-4), np.log(0.02), count))  # rω/v₀
    k = random.uniform(0.3, 5, count)
    spin = random.uniform(-0.9, 0.9, count) * random.choice([1, 0.1, 0.02], count)
    return P.replace(
        k=k,
        psi=(ratio * P.v0 / P.r) ** 2 * P.m / (k * P.sigma * P.b),
        alpha=np.deg2rad(random.uniform(0.5, 89.5, count)),
        phidot0=spin * P.v0 / P.r,
        inertia=random.uniform(0.3, 0.6, count),
    )


def extreme(count: int, seed: int) -> erosion.Parameters:
    """Random impacts at the limits of what is legal: flat, steep, soft, with rims 100 times as fast as the impact."""
    random = np.random.default_rng(seed)

    def spread(low: float, high: float) -> np.ndarray:
        return np.exp(random.uniform(np.log(low), np.log(high), count))

    r = P.r * spread(0.1, 10)
    flat, steep = np.deg2rad(spread(0.01, 45)), np.pi / 2 - np.deg2rad(spread(0.01, 45))
    kind = random.random(count)
    fast = random.choice([-1, 1], count) * spread(0.01, 100)
    spin = np.where(kind < 0.2, 0, np.where(kind < 0.6, random.uniform(-0.95, 0.95, count), fast))
    return P.replace(
        k=spread(1e-3, 1e3),
        psi=spread(1e-6, 1),
        r=r,
        alpha=np.where(random.random(count) < 0.5, flat, steep),
        phidot0=spin * P.v0 / r,
        inertia=spread(0.05, 5),
    )
