"""A long stream in bounded memory: `python -m benchmarks.stream_memory [N]`, 10⁸ by default.

Prints the rate and the peak of resident memory; then, of 100 seeds, how many intervals of 95 %
cover the mean of a run ten times as long.
"""

import argparse
import os
import resource
import sys
import time
from typing import Any

import numpy as np

import erosion
from erosion.distributions import LogNormal, Normal

LIMIT = 1e9  # bytes
LAWS: dict[str, Any] = {
    "alpha": Normal(np.deg2rad(25), np.deg2rad(4)),
    "v0": LogNormal(4400.0, 0.1),
    "phidot0": Normal(0.0, 10_000.0),
}


def main() -> int:
    """Run, print, and fail if memory or coverage is not what is promised."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stream_memory", description=__doc__)
    parser.add_argument("n", type=lambda text: int(float(text)), nargs="?", default=10**8)
    parser.add_argument("--model", default="rotating")
    parser.add_argument(
        "--of-seed", type=lambda text: int(float(text)), default=2**12, help="particles of a seed's run"
    )
    arguments = parser.parse_args()
    few: dict[str, Any] = {"best_angle": False, "sensitivities": False}
    begin, used = time.perf_counter(), time.process_time()
    stream = erosion.stream(arguments.model, erosion.TABLE_1, n=arguments.n, **few, **LAWS)
    seconds, processor = time.perf_counter() - begin, time.process_time() - used
    # Linux counts kilobytes, macOS bytes.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    print(stream)
    print(f"{stream.n / seconds:,.0f} particles/s with compiling: {seconds:,.0f} s, processor {processor:,.0f} s")
    print(f"load average {os.getloadavg()[0]:.1f}; peak memory {peak / 1e6:,.0f} MB", flush=True)
    n = arguments.of_seed
    long = erosion.stream(arguments.model, erosion.TABLE_1, n=10 * n, seed=10**6, **few, **LAWS).mean_volume.value
    intervals = [
        erosion.stream(arguments.model, erosion.TABLE_1, n=n, seed=seed, **few, **LAWS).mean_volume
        for seed in range(100)
    ]
    covered = sum(one.low < long < one.high for one in intervals)
    print(f"{covered} of 100 intervals of {n:,} particles cover the mean of {10 * n:,} others")
    return 0 if peak < LIMIT and covered >= 90 else 1


if __name__ == "__main__":
    sys.exit(main())
