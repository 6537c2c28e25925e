"""Run the contenders in rotation and collect what the report says."""

import contextlib
import dataclasses
import functools
import statistics
from collections.abc import Callable

from benchmarks import engine, heyoka_batch, scipy_dop853
from benchmarks.contenders import V2, Contender, contenders
from benchmarks.pool import Pool
from benchmarks.timing import by_turns, seconds_of
from benchmarks.work import Answers, Verdict, Work, judge, ordered_work, random_work

TAYLOR_LANES = 20_000


@dataclasses.dataclass(frozen=True)
class Reference:
    """The answers that count as true for a piece of work.

    Args:
        answers: `erosion.impact(rtol=1e-13)` on all lanes.
        taylor: the reference judged by heyoka's variational integrator at 1e-15.
        fine: the reference judged by scipy's DOP853 at 1e-13 with steps of at most 0.02/ω.
    """

    answers: Answers
    taylor: Verdict
    fine: Verdict


def reference(work: Work, fine_lanes: int, say: Callable[[str], None]) -> Reference:
    """Compute the reference of `work` and check it.

    The two checks share no code with the engine: heyoka isolates all roots of the events'
    Taylor polynomials within a step; scipy's steps are so short that no event hides in one.
    """
    true = engine.answers(work, 2, 1e-13)
    some = work.first(TAYLOR_LANES)
    taylor = judge(true.part(TAYLOR_LANES), heyoka_batch.prepare(some, order=2, tol=1e-15)())
    few = work.first(fine_lanes)
    fine = judge(
        true.part(fine_lanes)._replace(first=None, second=None),
        scipy_dop853.prepare(few, rtol=1e-13, atol=1e-15, max_step=0.02)(),
    )
    for name, lanes, verdict in (("heyoka at 1e-15", len(some), taylor), ("scipy at 1e-13", len(few), fine)):
        worst = ", ".join(f"{error[2]:.1e}" for error in verdict.errors)
        say(f"  reference against {name}: {verdict.wrong} of {lanes:,} ends differ; greatest errors {worst}")
    return Reference(true, taylor, fine)


@dataclasses.dataclass(frozen=True)
class Row:
    """A contender's result.

    Args:
        rates: impacts per second of each repeat.
        verdict: its errors.
    """

    name: str
    group: str
    lanes: int
    rates: list[float]
    verdict: Verdict

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
        if name not in rows:
            return None
        return rows[f"erosion.impact, {rows[name].group}"].rate / rows[name].rate


def tables(quick: bool, repeats: int, only: list[str], say: Callable[[str], None]) -> list[Table]:
    """The random work and the ordered work."""
    with contextlib.ExitStack() as stack:
        pool = functools.cache(lambda: stack.enter_context(contextlib.closing(Pool())))
        rows = contenders(quick, pool, only)
        most = max(row.lanes for row in rows)
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
        row.prepare(work.first(row.lanes))
    seconds = by_turns({row.name: functools.partial(seconds_of, row.run) for row in rows}, repeats, say)
    results = []
    for row in rows:
        part = true.answers.part(row.lanes)
        verdict = judge(row.answers(), part if row.group == V2 else part._replace(first=None, second=None))
        results.append(Row(row.name, row.group, row.lanes, [row.lanes / s for s in seconds[row.name]], verdict))
    return Table(title, true, results)
