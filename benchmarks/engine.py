"""This package's engine, through its public functions alone."""

from collections.abc import Callable

import erosion
from benchmarks.work import Answers, Work, from_impact


def prepare(work: Work, order: int = 0, rtol: float = 1e-9) -> Callable[[], erosion.Impact]:
    """`erosion.impact`, which uses all cores by itself."""
    p = work.parameters()

    def run() -> erosion.Impact:
        return erosion.impact("rotating", p, derivatives=order, rtol=rtol)

    return run


def answers(work: Work, order: int = 0, rtol: float = 1e-9) -> Answers:
    """The engine's answers."""
    return from_impact(prepare(work, order, rtol)())
