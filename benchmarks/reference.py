"""The reference at 1e-13: the engine's own, checked against two independent solutions first."""

import dataclasses
from collections.abc import Callable

from benchmarks import engine, heyoka_batch, scipy_dop853
from benchmarks.work import Answers, Verdict, Work, judge

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
