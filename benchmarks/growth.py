"""How the cost grows with the number of impacts: `python -m benchmarks.growth [--most 1e7]`.

From one impact to ten million, the old engine by turns with the new one, each in a process of its own.
"""

import argparse
import statistics
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from benchmarks.old_engine import NEW, OLD, both, unpacked
from benchmarks.timing import Process, by_turns, rate_text, seconds_of, table_text, time_text
from benchmarks.work import random_work

# More impacts are left out: with derivatives for their results' memory, of the old engine for its time.
MOST_WITH_DERIVATIVES = 10**6
MOST_OF_OLD = 10**6

_TURN = 0.1  # seconds of calls in a turn


class Growth(NamedTuple):
    """One number of impacts.

    Args:
        lanes: how many.
        seconds: the median of a call, by engine (`NEW`, `OLD`) and order of derivatives (0, 2).
    """

    lanes: int
    seconds: dict[tuple[str, int], float]


def growth(engines: Mapping[str, Process], most: int, rounds: int, say: Callable[[str], None]) -> list[Growth]:
    """Medians for 1, 10, … and `most` impacts."""
    results = []
    lanes = 1
    while lanes <= most:
        say(f"  {lanes:,} impacts")
        measures = {
            (name, order): partial(process.call, _turn, lanes, order)
            for name, process in engines.items()
            for order in (0, 2)
            if lanes <= (MOST_OF_OLD if name == OLD else most) and lanes <= (MOST_WITH_DERIVATIVES if order else most)
        }
        seconds = by_turns(measures, rounds)
        results.append(Growth(lanes, {key: statistics.median(each) for key, each in seconds.items()}))
        for process in engines.values():
            process.call(_forget)
        lanes *= 10
    return results


# Of an engine's process: what to call, and how often in a turn.
_runs: dict[tuple[int, int], tuple[Callable[[], Any], int]] = {}


def _turn(lanes: int, order: int) -> float:
    """Seconds of a call, warm."""
    if (lanes, order) not in _runs:
        from benchmarks import engine

        run = engine.prepare(random_work(lanes), order)
        run()
        _runs[lanes, order] = run, max(1, min(500, int(_TURN / seconds_of(run))))
    return seconds_of(*_runs[lanes, order])


def _forget() -> None:
    _runs.clear()


def growth_text(results: list[Growth]) -> str:
    """A table, one row a number of impacts."""
    rows = []
    for lanes, seconds in results:
        cells = [f"{lanes:,}"]
        for order in (0, 2):
            new, old = seconds.get((NEW, order)), seconds.get((OLD, order))
            cells += [time_text(new), rate_text(lanes / new)] if new else ["", ""]
            cells += [time_text(old), f"{old / new:.3g}"] if new and old else ["", ""]
        rows.append(cells)
    return "\n".join(
        [
            "## From one impact to ten million",
            "",
            "A call's time and rate, random angles and spins, everything compiled; the old engine's time, and by which",
            "factor it is longer. Both in processes of their own, by turns.",
            "",
            table_text("impacts | V | impacts/s | old engine | × | V, V′, V″ | impacts/s | old engine | ×", rows),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--most", type=lambda text: int(float(text)), default=10**7, help="impacts")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-old", action="store_true", help="without the old engine")
    arguments = parser.parse_args()
    with unpacked(not arguments.no_old) as source, both(source) as engines:
        print(growth_text(growth(engines, arguments.most, arguments.rounds, print)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
