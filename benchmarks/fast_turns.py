"""Bodies that turn fast: no end is missed where they turn by radians within a step.

    python -m benchmarks.fast_turns [lanes] [model …]

Random impacts with rω/v₀ from 3e-4 to 0.02 at the default tolerance against `rtol` 1e-12, and some of these
against scipy's DOP853 at 1e-12, as in `benchmarks.extremes`.
"""

import sys
import time

import numpy as np

import erosion
from benchmarks.extremes import ends, motion
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


def by_scipy(p: Parameters, hits: erosion.Impact) -> tuple[np.ndarray, np.ndarray]:
    """How impacts of `rotating` end, and when [s]; `hits` set the scale of what is small."""
    whole = motion("rotating", p, hits.t_c, hits.volume)
    unit = whole.unit / np.sqrt(np.asarray(p.stiffness) / float(p.m))
    found = ends(whole, 3 * hits.t_c / unit + 10)
    return np.array(["rebound", "stop", "none"])[found.event], found.time * unit


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
            parts = [by_scipy(_of(p, group), erosion.impact(model, _of(p, group), rtol=1e-12))
                     for group in np.array_split(sample, min(_GROUPS, len(sample)))]  # fmt: skip
            names, times = map(np.concatenate, zip(*parts, strict=True))
            wrong = np.sum(hits.ended_by[sample] != names)
            worst = np.max(np.abs(hits.t_c[sample] / times - 1))
            print(f"  scipy: {len(sample)} impacts, {wrong} other ends, t_c off by {worst:.1e} at most")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000, sys.argv[2:] or ["rotating", "rotating-full-torque"])
