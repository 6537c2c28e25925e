"""Times to a first answer in fresh processes, and of warm calls."""

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import erosion
from benchmarks.impacts import P
from benchmarks.page import Table
from benchmarks.timing import by_turns

TITLE = "What an answer costs"
TEXT = """Table 1, `rotating`, wall time. A process is fresh, with an empty home and cache."""

_ROOT = Path(__file__).parents[1]
_VOLUME, _ANGLE = "0.00010140", "25.57"  # in³, °: what the answers begin with
_IMPACT = "import erosion; print(erosion.impact('rotating', erosion.TABLE_1, derivatives={}).volume)"
PROCESSES = {
    "process: import jax": (("-c", "import jax; print()"), ""),
    "process: impact": (("-c", _IMPACT.format(0)), _VOLUME),
    "process: impact, two derivatives": (("-c", _IMPACT.format(2)), _VOLUME),
    "process: erosion run --json": (("-m", "erosion", "run", "--model", "rotating", "--json"), _VOLUME),
    "process: erosion optimum": (("-m", "erosion", "optimum", "--model", "rotating"), _ANGLE),
}
"""Arguments of Python, and what they print."""

_SPINS, _ANGLES = np.linspace(-0.5, 0.5, 2000), np.linspace(0.05, 1.5, 10**6)


def calls() -> dict[str, Any]:
    """Functions of a warm process."""
    return {
        "call: impact": partial(erosion.impact, "rotating", P),
        "call: impact, two derivatives": partial(erosion.impact, "rotating", P, derivatives=2),
        "call: a million impacts": partial(erosion.impact, "rotating", P.replace(alpha=_ANGLES)),
        "call: a million, two derivatives": partial(
            erosion.impact, "rotating", P.replace(alpha=_ANGLES), derivatives=2
        ),
        "call: 2,000 angles of greatest removal": partial(
            erosion.alpha_max, "rotating", P.replace(phidot0=_SPINS * P.v0 / P.r)
        ),
    }


def fresh(arguments: tuple[str, ...], answer: str) -> float:
    """Seconds of a process from its start to its end."""
    with tempfile.TemporaryDirectory() as home:
        environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
        environment |= {"HOME": home, "XDG_CACHE_HOME": str(Path(home, ".cache"))}
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, *arguments], cwd=_ROOT, env=environment, capture_output=True, text=True, check=True
        )
        seconds = time.perf_counter() - begin
    if answer not in done.stdout:
        raise RuntimeError(f"{arguments}: no answer {answer}, but\n{done.stdout}")
    return seconds


def wall_time(run: Any) -> float:
    """Seconds of a call, the mean of a tenth of a second of calls."""
    begin, count = time.perf_counter(), 0
    while count == 0 or time.perf_counter() - begin < 0.1:
        run()
        count += 1
    return (time.perf_counter() - begin) / count


def measure(quick: bool) -> Table:
    """A row a process or call."""
    rounds = 1 if quick else 3
    warm = calls()
    for run in warm.values():
        run()
        wall_time(run)
    measures = {name: partial(fresh, *process) for name, process in PROCESSES.items()}
    times = {**by_turns(measures, rounds), **by_turns({name: partial(wall_time, run) for name, run in warm.items()}, 5)}
    return Table(["", "median, s"], [[name, each.median] for name, each in times.items()])
