"""Honest timing: contenders by turns, medians, and ratios of the same turn."""

import os
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple


class Timed(NamedTuple):
    """The times of a contender.

    Args:
        seconds: of each turn.
        ratio: the median of its time over that of the first contender in the same turn.
    """

    seconds: list[float]
    ratio: float

    @property
    def median(self) -> float:
        """Of all turns [s]."""
        return statistics.median(self.seconds)

    @property
    def spread(self) -> float:
        """The greatest time over the least: how far other work of the machine moved this one."""
        return max(self.seconds) / min(self.seconds)


def by_turns(measures: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, Timed]:
    """Measure each contender once a round (A B C A B C …), so that other work of the machine slows all alike.

    Args:
        measures: functions that give seconds; the first is the one that all are compared with.
        rounds: how many.
    """
    turns = [{name: measure() for name, measure in measures.items()} for _ in range(rounds)]
    first = next(iter(measures))
    return {
        name: Timed([turn[name] for turn in turns], statistics.median(turn[name] / turn[first] for turn in turns))
        for name in measures
    }


def processor_time(run: Callable[[], Any], calls: int = 1) -> float:
    """Seconds of processor time of a call, the mean of some calls."""
    begin = time.process_time()
    for _ in range(calls):
        run()
    return (time.process_time() - begin) / calls


def warm(run: Callable[[], Any], seconds: float) -> None:
    """Call for as long, until optimised code has taken the place of quickly compiled code."""
    begin = time.process_time()
    while time.process_time() - begin < seconds:
        run()


def cores() -> set[int]:
    """The cores that this process may use; empty where the system does not tell."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
