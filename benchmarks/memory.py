"""Many impacts in bounded memory: `python -m benchmarks.memory [N]`, 10⁸ by default.

A loop of blocks through `erosion.impact`; prints the rate and the peak of resident memory, that of each minute too. A
peak that grows with the minutes is a leak; on two cores 2e9 impacts hold the load for about ten of them.
"""

import argparse
import resource
import sys
import time

import numpy as np

import erosion
from benchmarks.work import ALPHAS, SPINS, Work

LIMIT = 1000.0  # MB


def main() -> int:
    """Run, print, and fail if memory passes the limit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("n", type=lambda text: int(float(text)), nargs="?", default=10**8)
    parser.add_argument("--block", type=lambda text: int(float(text)), default=10**6, help="impacts of one call")
    parser.add_argument("--derivatives", type=int, choices=(0, 1, 2), default=0)
    arguments = parser.parse_args()
    generator = np.random.default_rng(1958)
    total, done, failed, minutes, begin = 0.0, 0, 0, 0, time.perf_counter()
    print(f"before: {_peak():,.0f} MB")
    while done < arguments.n:
        n = min(arguments.block, arguments.n - done)
        work = Work(generator.uniform(*ALPHAS, n), generator.uniform(*SPINS, n))
        result = erosion.impact("rotating", work.parameters(), derivatives=arguments.derivatives)
        total += float(np.nansum(result.volume))
        failed += int(np.count_nonzero(np.isnan(result.volume)))
        done += n
        if time.perf_counter() - begin > 60 * (minutes + 1):
            minutes += 1
            print(f"after {minutes} min: {done:,} impacts, {_peak():,.0f} MB", flush=True)
    seconds = time.perf_counter() - begin
    print(f"{done:,} impacts, {failed} failed, mean volume {total / done:.9e} in³")
    print(f"{done / seconds:,.0f} impacts/s with compiling; peak memory {_peak():,.0f} MB")
    return 0 if _peak() < LIMIT else 1


def _peak() -> float:
    """The peak of the process's resident memory [MB]."""
    # Linux counts kilobytes, macOS bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


if __name__ == "__main__":
    sys.exit(main())
