"""Bodies that turn fast: no end is missed where they turn by radians within a step.

    python -m benchmarks.fast_turns [lanes] [model …]

Random impacts with rω/v₀ from 3e-4 to 0.02 at the default tolerance against `rtol` 1e-12, and some of these
against scipy's DOP853 at 1e-12, whose steps are a tenth of a radian at most.
"""

import sys
import time

import numpy as np
from scipy.integrate import solve_ivp

import erosion
from erosion.parameters.parameters import Parameters

_BY_SCIPY = 2000


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


def by_scipy(p: Parameters, i: int) -> tuple[str, float]:
    """How the impact of `rotating` ends, and when."""
    k, psi, alpha, spin, beta = (float(getattr(p, name)[i]) for name in ("k", "psi", "alpha", "phidot0", "inertia"))
    m, r, c = float(p.m), float(p.r), float(p.sigma * p.b) * psi

    def rate(_, state):
        depth = state[0] - r * (1 - np.sin(state[1]))
        force = -c * depth
        return [state[3], state[4], force / m, k * force / m, r * force / (beta * m * r**2)]

    def rebound(_, state):
        return state[0] - r * (1 - np.sin(state[1]))

    def stop(_, state):
        return state[2] + r * np.sin(state[1]) * state[4]

    # y, φ, ẋ, ẏ, φ̇
    start = [0.0, np.pi / 2, float(p.v0) * np.cos(alpha), float(p.v0) * np.sin(alpha), spin]
    scale = 1 / np.sqrt(k * c / m)
    first = 1e-6 * scale  # away from contact, where the depth is zero
    begun = solve_ivp(rate, (0, first), start, "DOP853", rtol=1e-13, atol=1e-18).y[:, -1]
    for event in (rebound, stop):
        event.terminal, event.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    # Radians: what the spin may become is bounded by its change (ẋ - v₀ cos α)/(β r).
    fastest = abs(spin) + 2 * float(p.v0) / (beta * r)
    solution = solve_ivp(
        rate, (first, 1e4 * scale), begun, "DOP853", rtol=1e-12, atol=1e-16, events=(rebound, stop),
        max_step=0.3 / fastest,
    )  # fmt: skip
    ends = {name: times[0] for name, times in zip(("rebound", "stop"), solution.t_events, strict=True) if len(times)}
    name = min(ends, key=ends.__getitem__)
    return name, ends[name]


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
            some = np.flatnonzero(cut)[: min(_BY_SCIPY, lanes)]
            ends = [by_scipy(p, i) for i in some]
            wrong = sum(hits.ended_by[i] != name for i, (name, _) in zip(some, ends, strict=True))
            worst = max(abs(hits.t_c[i] / t - 1) for i, (_, t) in zip(some, ends, strict=True))
            print(f"  scipy: {len(some)} impacts, {wrong} other ends, t_c off by {worst:.1e} at most")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, sys.argv[2:] or ["rotating", "rotating-full-torque"])
