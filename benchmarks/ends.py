"""Does any cut end wrongly? The engine against brute force on a dense grid of angles and spins.

    python -m benchmarks.ends [ANGLES] [SPINS]

By default 20,000 angles × 19 spins s = r φ̇₀/v₀ from -0.9 to 0.9 for every rotating model.
"""

import sys
import time

import numpy as np

import erosion
from tests.fine_steps import wrong_ends


def main(angles: int = 20_000, spins: int = 19) -> int:
    """Print a line for each model and spin range; return the number of wrong ends."""
    alphas = (np.arange(angles) + 0.5) / angles * np.pi / 2
    total = 0
    print(f"{angles:,} angles x {spins} spins from -0.9 to 0.9, Table 1", flush=True)
    for name in (name for name in erosion.available_models() if name.startswith("rotating")):
        model = erosion.load_model(name)
        begun, wrong, near, cuts, failed = time.perf_counter(), 0, 0, 0, 0
        for s in np.linspace(-0.9, 0.9, spins):
            p = erosion.TABLE_1.replace(alpha=alphas, phidot0=s * erosion.TABLE_1.v0 / erosion.TABLE_1.r)
            ended_by = erosion.impact(model, p).ended_by
            failed += int(np.isin(ended_by, ["failed", "unfinished"]).sum())
            cuts += int(np.count_nonzero(ended_by != "no-cut"))
            wrong_here, near_here = wrong_ends(model, p, ended_by)
            wrong, near = wrong + wrong_here, near + near_here
        took = time.perf_counter() - begun
        print(
            f"{name:40s} {cuts:8,} cuts  {wrong} wrong  {failed} failed  {near} grazes below 1e-9  {took:.0f} s",
            flush=True,
        )
        total += wrong + failed
    return total


if __name__ == "__main__":
    sys.exit(1 if main(*map(int, sys.argv[1:])) else 0)
