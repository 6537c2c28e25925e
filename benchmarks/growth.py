"""How the cost grows with the number of impacts: `python -m benchmarks.growth [--most 1e7]`.

From one impact to ten million.
"""

import argparse
import statistics
import sys
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from benchmarks import engine
from benchmarks.timing import by_turns, rate_text, seconds_of, table_text, time_text
from benchmarks.work import random_work

MOST_WITH_DERIVATIVES = 10**6  # more results would take too much memory

_TURN = 0.1  # seconds of calls in a turn


class Growth(NamedTuple):
    """One number of impacts.

    Args:
        lanes: how many.
        seconds: the median of a call, by order of derivatives (0, 2).
    """

    lanes: int
    seconds: dict[int, float]


def growth(most: int, rounds: int, say: Callable[[str], None]) -> list[Growth]:
    """Medians for 1, 10, … and `most` impacts."""
    results = []
    lanes = 1
    while lanes <= most:
        say(f"  {lanes:,} impacts")
        orders = (0, 2) if lanes <= MOST_WITH_DERIVATIVES else (0,)
        seconds = by_turns({order: _turn(lanes, order) for order in orders}, rounds)
        results.append(Growth(lanes, {order: statistics.median(each) for order, each in seconds.items()}))
        lanes *= 10
    return results


def _turn(lanes: int, order: int) -> Callable[[], float]:
    """Measures the seconds of a call, warm."""
    run = engine.prepare(random_work(lanes), order)
    run()
    return partial(seconds_of, run, max(1, min(500, int(_TURN / seconds_of(run)))))


def growth_text(results: list[Growth]) -> str:
    """A table, one row a number of impacts."""
    rows = []
    for lanes, seconds in results:
        cells = [f"{lanes:,}"]
        for order in (0, 2):
            cells += [time_text(seconds[order]), rate_text(lanes / seconds[order])] if order in seconds else ["", ""]
        rows.append(cells)
    return "\n".join(
        [
            "## From one impact to ten million",
            "",
            "A call's time and rate, random angles and spins, everything compiled.",
            "",
            table_text("impacts | V | impacts/s | V, V′, V″ | impacts/s", rows),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--most", type=lambda text: int(float(text)), default=10**7, help="impacts")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(growth_text(growth(arguments.most, arguments.rounds, print)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
