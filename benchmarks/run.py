"""Measure, write benchmarks/results.json and docs/performance.md: `make bench`, or `python -m benchmarks.run`."""

import argparse
import datetime as dt
import importlib.metadata
import json
import multiprocessing
import os
import platform
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks import accuracy, first_answers, fits, gradient, maps, page, random_ends, speed, stiff
from benchmarks.page import Table
from benchmarks.timing import cores

SECTIONS = {
    "first_answers": first_answers,
    "speed": speed,
    "accuracy": accuracy,
    "random_ends": random_ends,
    "stiff": stiff,
    "gradient": gradient,
    "maps": maps,
    "fits": fits,
}
"""By name, in the order of the page."""

NIGHTLY = ("random_ends", "fits")
ALL_CORES = ("first_answers", "maps", *NIGHTLY)
_PACKAGES = ("particle-erosion", "jax", "diffrax", "heyoka", "scipy", "numpy")


def machine() -> str:
    """Processor, cores, load and versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES)
    return (
        f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; "
        f"Python {platform.python_version()}, {versions}"
    )


def measured(name: str, quick: bool) -> Table:
    """A section, measured in a process of its own, on one core where contenders use one."""
    allowed = cores()
    if allowed and name not in ALL_CORES:
        os.sched_setaffinity(0, {max(allowed)})
    ignored = "ignore", "m does not fit r and b"
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), warnings.filterwarnings, ignored) as pool:
        future = pool.submit(SECTIONS[name].measure, quick)  # starts the process, which inherits the core
        if allowed:
            os.sched_setaffinity(0, allowed)
        return future.result()


def main() -> int:
    """Run sections; 1 if a result failed its check."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.run", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a look at small samples; writes nothing")
    parser.add_argument(
        "--only", nargs="+", choices=SECTIONS, default=[name for name in SECTIONS if name not in NIGHTLY]
    )
    parser.add_argument("--page", action="store_true", help="make the page of the results again, measure nothing")
    given = parser.parse_args()
    wrong = 0
    for name in [] if given.page else given.only:
        where, begin = machine(), time.perf_counter()
        table = measured(name, given.quick)
        seconds = time.perf_counter() - begin
        wrong += table.wrong
        print(f"{SECTIONS[name].TITLE}, {seconds:.0f} s\n\n{page.markdown(table)}\n", flush=True)
        if not given.quick:
            results = json.loads(page.RESULTS.read_text(encoding="utf-8")) if page.RESULTS.exists() else {}
            results[name] = {
                "date": dt.date.today().isoformat(), "machine": where, "seconds": round(seconds), "table": table
            }  # fmt: skip
            page.RESULTS.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if not given.quick:
        page.write(SECTIONS)
    if wrong:
        print(f"{wrong} results failed their check.", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
