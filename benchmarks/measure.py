"""Run the contenders in rotation and collect what the report says."""

import dataclasses
import statistics
import time
from collections.abc import Callable

import numpy as np

from benchmarks import cold, kernel
from benchmarks.contenders import LIMIT, V2, Contender, contenders
from benchmarks.pool import Pool
from benchmarks.reference import Reference, reference
from benchmarks.work import Verdict, Work, judge, ordered_work, random_work


@dataclasses.dataclass(frozen=True)
class Row:
    """A contender's result.

    Args:
        rates: impacts per second of each repeat.
        verdict: its errors; None where there is nothing to compare (the closed form).
    """

    name: str
    group: str
    lanes: int
    rates: list[float]
    verdict: Verdict | None

    @property
    def rate(self) -> float:
        """The median."""
        return statistics.median(self.rates)


@dataclasses.dataclass(frozen=True)
class Table:
    """All rows of one kind of work."""

    title: str
    reference: Reference
    rows: list[Row]


def tables(gpu: bool, quick: bool, repeats: int, only: list[str], say: Callable[[str], None]) -> list[Table]:
    """The random work and the ordered work."""
    pools: list[Pool] = []

    def pool() -> Pool:
        if not pools:
            pools.append(Pool())
        return pools[0]

    rows = contenders(gpu, quick, pool, only)
    most = max(row.lanes for row in rows if row.group != LIMIT)
    kinds = [("Random angles and spins", random_work(most))]
    if not quick:
        kinds.append(("Ordered angles, no spin", ordered_work(most)))
    try:
        return [_table(title, work, rows, repeats, 50 if quick else 300, say) for title, work in kinds]
    finally:
        for one in pools:
            one.close()


def _table(
    title: str, work: Work, rows: list[Contender], repeats: int, fine_lanes: int, say: Callable[[str], None]
) -> Table:
    say(f"{title}: reference of {len(work):,} impacts")
    true = reference(work, fine_lanes, say)
    for row in rows:
        say(f"  prepare {row.name}")
        row.prepare(random_work(row.lanes) if row.group == LIMIT else work.first(row.lanes))
    seconds: dict[str, list[float]] = {row.name: [] for row in rows}
    for repeat in range(repeats):
        say(f"  repeat {repeat + 1} of {repeats}")
        for row in rows:
            begin = time.perf_counter()
            row.run()
            seconds[row.name].append(time.perf_counter() - begin)
    results = []
    for row in rows:
        verdict = None
        if row.group != LIMIT:
            part = true.answers.part(row.lanes)
            verdict = judge(row.answers(), part if row.group == V2 else part._replace(first=None, second=None))
        results.append(Row(row.name, row.group, row.lanes, [row.lanes / s for s in seconds[row.name]], verdict))
    return Table(title, true, results)


def colds(quick: bool, say: Callable[[str], None]) -> dict[str, tuple[cold.Cold, cold.Cold]]:
    """For each contender a fresh process with one impact, and one with many."""
    names = ["kernel-0"] if quick else list(cold.NAMES)
    results = {}
    for name in names:
        say(f"  fresh process: {cold.NAMES[name]}")
        results[cold.NAMES[name]] = (cold.measure(name, 1), cold.measure(name, 100 if name == "scipy" else 4096))
    return results


def growth(most: int, say: Callable[[str], None]) -> list[tuple[int, float, float]]:
    """Number of impacts, and the median seconds of V and of V, V′, V″."""
    results = []
    for power in range(2, int(np.log10(most)) + 1):
        n = 10**power
        say(f"  {n:,} impacts")
        medians = []
        for order in (0, 2):
            run = kernel.prepare(random_work(n), order)
            run()
            seconds = []
            for _ in range(3 if n >= 10**6 else 7):
                begin = time.perf_counter()
                run()
                seconds.append(time.perf_counter() - begin)
            medians.append(statistics.median(seconds))
        results.append((n, *medians))
    return results
