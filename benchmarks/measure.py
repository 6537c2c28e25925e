"""Run the contenders in rotation and collect what the report says."""

import contextlib
import dataclasses
import functools
import statistics
from collections.abc import Callable

from benchmarks.contenders import LIMIT, V2, Contender, contenders
from benchmarks.pool import Pool
from benchmarks.reference import Reference, reference
from benchmarks.timing import by_turns, seconds_of
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

    def times(self, name: str) -> float | None:
        """By which factor the engine is faster than a contender, for the same quantities; None without it."""
        rows = {row.name: row for row in self.rows}
        if name not in rows or rows[name].group == LIMIT:
            return None
        return rows[f"erosion.impact, {rows[name].group}"].rate / rows[name].rate


def tables(gpu: bool, quick: bool, repeats: int, only: list[str], say: Callable[[str], None]) -> list[Table]:
    """The random work and the ordered work."""
    with contextlib.ExitStack() as stack:
        pool = functools.cache(lambda: stack.enter_context(contextlib.closing(Pool())))
        rows = contenders(gpu, quick, pool, only)
        most = max(row.lanes for row in rows if row.group != LIMIT)
        kinds = [("Random angles and spins", random_work(most))]
        if not quick:
            kinds.append(("Ordered angles, no spin", ordered_work(most)))
        return [_table(title, work, rows, repeats, 50 if quick else 300, say) for title, work in kinds]


def _table(
    title: str, work: Work, rows: list[Contender], repeats: int, fine_lanes: int, say: Callable[[str], None]
) -> Table:
    say(f"{title}: reference of {len(work):,} impacts")
    true = reference(work, fine_lanes, say)
    for row in rows:
        say(f"  prepare {row.name}")
        row.prepare(random_work(row.lanes) if row.group == LIMIT else work.first(row.lanes))
    seconds = by_turns({row.name: functools.partial(seconds_of, row.run) for row in rows}, repeats, say)
    results = []
    for row in rows:
        verdict = None
        if row.group != LIMIT:
            part = true.answers.part(row.lanes)
            verdict = judge(row.answers(), part if row.group == V2 else part._replace(first=None, second=None))
        results.append(Row(row.name, row.group, row.lanes, [row.lanes / s for s in seconds[row.name]], verdict))
    return Table(title, true, results)
