"""Bodies that turn fast: no end is missed where they turn by radians within a step.

    python -m benchmarks.fast_turns [lanes] [model …]

Random impacts with rω/v₀ from 3e-4 to 0.02 at the default tolerance against `rtol` 1e-12, and some of these
against scipy's DOP853 at 1e-13.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

import erosion
from erosion.parameters.parameters import Parameters

_BY_SCIPY = 2000
_GROUPS = 20


def fast_turns(lanes: int, seed: int) -> Parameters:
    """Random impacts of Table 1's particle on targets so soft that it turns many times."""
    generator = np.random.default_rng(seed)
    p = erosion.TABLE_1
    ratio = np.exp(generator.uniform(np.log(3e-4), np.log(0.02), lanes))  # rω/v₀
    k = generator.uniform(0.3, 5, lanes)
    spin = generator.uniform(-0.9, 0.9, lanes) * generator.choice([1, 0.1, 0.02], lanes)
    return p.replace(
        k=k,
        psi=(ratio * p.v0 / p.r) ** 2 * p.m / (k * p.sigma * p.b),
        alpha=np.deg2rad(generator.uniform(0.5, 89.5, lanes)),
        phidot0=spin * p.v0 / p.r,
        inertia=generator.uniform(0.3, 0.6, lanes),
    )


def by_scipy(p: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """How impacts of `rotating` end, and when: integrated together, in steps of 0.3 rad at most of any body."""
    k, c, m, r = p.k, p.sigma * p.b * p.psi, float(p.m), float(p.r)
    turned = p.inertia * m * r
    number = len(k)

    def rate(_: float, flat: np.ndarray) -> np.ndarray:
        y, q, _, vy, spin = flat.reshape(5, number)
        force = -c * (y - r * (1 - np.cos(q)))
        return np.concatenate([vy, spin, force / m, k * force / m, force / turned])

    def events(flat: np.ndarray) -> np.ndarray:
        """Depth (rebound) and horizontal speed (stop) of the tip, shape (2, n)."""
        y, q, vx, _, spin = flat.reshape(5, number)
        return np.stack([y - r * (1 - np.cos(q)), vx + r * np.cos(q) * spin])

    v0 = float(p.v0)
    start = np.concatenate([0 * k, 0 * k, v0 * np.cos(p.alpha), v0 * np.sin(p.alpha), p.phidot0])
    scales = np.repeat([r, 1.0, v0, v0, v0 / r], number)
    # What a spin may become is bounded by its change, (ẋ - v₀ cos α)/(β r).
    fastest = np.max(np.abs(p.phidot0) + 2 * v0 / (p.inertia * r))
    first = 1e-9 * r / v0  # away from contact, where the depth is zero
    solver = DOP853(lambda t, z: rate(t, z * scales) / scales, 0, start / scales, np.inf, rtol=1e-13, atol=1e-15,
                    max_step=0.3 / fastest, first_step=first)  # fmt: skip
    names, times = np.full(number, "", dtype=object), np.full(number, np.inf)
    solver.step()
    before = events(solver.y * scales)
    while not np.isfinite(times).all():
        solver.step()
        after = events(solver.y * scales)
        # Within a step an event may dip by ½ A (0.3/2)² of its amplitude A, and return.
        amplitude = np.stack([r + 0 * k, r * np.abs(solver.y[-number:]) * v0 / r])
        near = (np.minimum(before, after) < 0.02 * amplitude) & (before > 0) & ~np.isfinite(times)
        if near.any():
            dense = solver.dense_output()  # of this step
            for j, i in zip(*np.nonzero(near), strict=True):
                time = _first_fall(
                    lambda t, at=(j, i), dense=dense: events(dense(t) * scales)[at], solver.t_old, solver.t
                )
                if time < times[i]:
                    names[i], times[i] = ("rebound", "stop")[j], time
        before = after
    return names, times


def _first_fall(event: Callable[[float], float], low: float, high: float) -> float:
    """Where an event, positive at first, falls through zero within a step; infinity if nowhere."""
    lowest = high
    if event(high) >= 0:
        lowest = minimize_scalar(event, bounds=(low, high), method="bounded", options={"xatol": 1e-6 * (high - low)}).x
    return brentq(event, low, lowest, xtol=1e-30) if event(lowest) < 0 else np.inf


def _of(p: Parameters, lanes: np.ndarray) -> Parameters:
    """Some of the impacts."""
    return p.replace(**{name: getattr(p, name)[lanes] for name in ("k", "psi", "alpha", "phidot0", "inertia")})


def main(lanes: int, models: list[str]) -> None:
    """Print how many ends differ, and by how much results do."""
    p = fast_turns(lanes, seed=5)
    for model in models:
        begun = time.perf_counter()
        hits = erosion.impact(model, p)
        took = time.perf_counter() - begun
        exact = erosion.impact(model, p, rtol=1e-12)
        cut = exact.t_c > 0
        with np.errstate(all="ignore"):
            t, v = (np.abs(a / b - 1)[cut] for a, b in ((hits.t_c, exact.t_c), (hits.volume, exact.volume)))
        failed = int(np.sum(hits.ended_by == "failed"))
        print(f"{model}: {lanes:,} impacts in {took:.1f} s; {failed} failed, {np.sum(hits.outcome != exact.outcome)} "
              f"other ends, {np.sum(t > 1e-7)} with t_c off by 1e-7")  # fmt: skip
        for name, error in (("t_c", t), ("V", v)):
            quantiles = ", ".join(f"{q:.1e}" for q in np.quantile(error, [0.5, 0.99, 0.9999, 1]))
            print(f"  {name}: median, 99 %, 99.99 %, worst {quantiles}")
        if model == "rotating":
            sample = np.flatnonzero(cut)[:_BY_SCIPY]
            # Those of similar length together.
            sample = sample[np.argsort(exact.t_c[sample])]
            groups = np.array_split(sample, min(_GROUPS, len(sample)))
            names, times = map(np.concatenate, zip(*(by_scipy(_of(p, group)) for group in groups), strict=True))
            wrong = np.sum(hits.ended_by[sample] != names)
            worst = np.max(np.abs(hits.t_c[sample] / times - 1))
            print(f"  scipy: {len(sample)} impacts, {wrong} other ends, t_c off by {worst:.1e} at most")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, sys.argv[2:] or ["rotating", "rotating-full-torque"])
