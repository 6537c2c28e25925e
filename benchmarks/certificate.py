"""Certified optima against brute force: random sets of parameters, 20,000 angles each.

`python -m benchmarks.certificate [SETS] [ANGLES]` counts, for every rotating model, the sets
whose certified V_max is below the best of the scan by more than 1e-8 relative.
"""

import sys
import time

import numpy as np

import erosion

_MODELS = [name for name in erosion.available_models() if name.startswith("rotating")]
_P = erosion.TABLE_1


def random_sets(count: int, seed: int) -> erosion.Parameters:
    """Parameters around Table 1, a fifth of them without spin; s = rφ̇0/v0 within ±0.9."""
    rng = np.random.default_rng(seed)
    v0, r = rng.uniform(1000, 10_000, count), float(_P.r) * np.exp(rng.uniform(-2, 2, count))
    spin = np.where(rng.random(count) < 0.2, 0.0, rng.uniform(-0.9, 0.9, count))
    return _P.replace(
        k=np.exp(rng.uniform(np.log(0.3), np.log(5), count)),
        v0=v0,
        r=r,
        phidot0=spin * v0 / r,
        inertia=rng.uniform(0.3, 0.6, count),
    )


def main(count: int = 200, angles: int = 20_000) -> int:
    """Print a line for each model; returns how many sets fell short."""
    total = 0
    for seed, model in enumerate(_MODELS):
        p = random_sets(count, seed)
        begun = time.perf_counter()
        best = erosion.alpha_max(model, p)
        took = time.perf_counter() - begun
        scanned = np.zeros(count)
        for alpha in np.array_split(np.linspace(0, np.pi / 2, angles + 1)[1:, None], 20):
            volume = erosion.impact(model, p.replace(alpha=alpha)).volume
            scanned = np.fmax(scanned, np.nanmax(volume, axis=0))
        short = np.flatnonzero(best.volume < scanned * (1 - 1e-8))
        kinds = ", ".join(f"{n} {kind}" for kind, n in zip(*np.unique(best.kind, return_counts=True), strict=True))
        worst = np.max(scanned / np.where(best.volume > 0, best.volume, np.inf) - 1)
        print(f"{model:40s} {len(short)} of {count} below; worst {worst:+.1e}; {kinds}; {np.sum(~best.certified)} not "
              f"certified; {took:.1f} s", flush=True)  # fmt: skip
        for i in short:
            print("   set", i, "seed", seed, "short by", scanned[i] / best.volume[i] - 1)
        total += len(short)
    return total


if __name__ == "__main__":
    sys.exit(1 if main(*map(int, sys.argv[1:])) else 0)
