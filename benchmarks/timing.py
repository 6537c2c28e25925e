"""Measuring by turns, and seconds and rates as text."""

import math
import statistics
import time
from collections.abc import Callable, Collection, Hashable, Mapping
from typing import Any, TypeVar

_Key = TypeVar("_Key", bound=Hashable)


def seconds_of(run: Callable[[], Any], calls: int = 1) -> float:
    """Seconds of a call, the mean of several."""
    begin = time.perf_counter()
    for _ in range(calls):
        run()
    return (time.perf_counter() - begin) / calls


def by_turns(
    measures: Mapping[_Key, Callable[[], float]],
    rounds: int,
    say: Callable[[str], None] = lambda _: None,
    seldom: Collection[_Key] = (),
) -> dict[_Key, list[float]]:
    """Take each measure once a round (A B C A B C …), so that other work of the machine hits all alike.

    Args:
        measures: each gives seconds.
        rounds: how many.
        say: gets a line a round.
        seldom: measures of every third round.
    """
    seconds: dict[_Key, list[float]] = {key: [] for key in measures}
    for i in range(rounds):
        say(f"  round {i + 1} of {rounds}")
        for key, measure in measures.items():
            if i % 3 == 0 or key not in seldom:
                seconds[key].append(measure())
    return seconds


def rate_text(rate: float) -> str:
    """Three digits: 7,120,000."""
    return f"{float(f'{rate:.3g}'):,.0f}" if rate >= 100 else f"{rate:.3g}"


def time_text(seconds: float) -> str:
    """Three digits: 0.152 ms, 23.4 ms, 1.46 s."""
    value, unit = (seconds, "s") if seconds >= 1 else (1e3 * seconds, "ms")
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f} {unit}" if value > 0 else f"0 {unit}"


def spread_text(seconds: list[float]) -> str:
    """Seconds: the median, with the least and the greatest."""
    return f"{statistics.median(seconds):.2f} ({min(seconds):.2f}–{max(seconds):.2f})"


def table_text(head: str, rows: list[list[str]]) -> str:
    """A table; all columns but the first are numbers. `head` is "contender | impacts | …"."""
    columns = head.count("|")
    lines = [f"| {head} |", "|---|" + "--:|" * columns]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])
