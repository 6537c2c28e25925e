"""The contenders, and how many impacts each computes."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

from benchmarks import diffrax_vmap, heyoka_batch, heyoka_taylor, scipy_dop853
from benchmarks.engine import prepare as engine
from benchmarks.pool import Pool
from benchmarks.work import Answers, Work, as_answers

V, V2 = "V", "V, V′, V″"


@dataclasses.dataclass(frozen=True)
class Contender:
    """One row of the table.

    Args:
        name: in the table; `--only` selects by a part of it.
        group: `V` or `V2`: rows of one group are compared.
        lanes: how many impacts a run has.
        prepare: gets the work; compiles and warms up.
        run: is timed.
        answers: those of the last run.
    """

    name: str
    group: str
    lanes: int
    prepare: Callable[[Work], None]
    run: Callable[[], None]
    answers: Callable[[], Answers]


def _here(name: str, group: str, lanes: int, factory: Callable[..., Any], **options: Any) -> Contender:
    """A contender of this process."""
    runner: list[Callable[[], Any]] = []
    results: list[Any] = []

    def prepare(work: Work) -> None:
        runner[:] = [factory(work, **options)]
        runner[0]()

    def run() -> None:
        results[:] = [runner[0]()]

    def answers() -> Answers:
        return as_answers(results[0])

    return Contender(name, group, lanes, prepare, run, answers)


def _pooled(pool: Pool, name: str, group: str, lanes: int, factory: Callable[..., Any], **options: Any) -> Contender:
    """A contender in processes of its own."""

    def prepare(work: Work) -> None:
        pool.prepare(name, factory, work, **options)

    return Contender(name, group, lanes, prepare, lambda: pool.run(name), lambda: pool.answers(name))


def contenders(quick: bool, pool: Callable[[], Pool], only: list[str]) -> list[Contender]:
    """Those that `only` selects (all if empty); the engine's rows come first of their group, and always.

    Args:
        quick: fewer impacts.
        pool: makes one process per core, or gives those there are.
        only: parts of names.
    """
    scale = 8 if quick else 1
    big = [2**16, 2**16] if quick else [2**20, 2**19]
    rows = [
        _here(f"erosion.impact, {group}", group, lanes, engine, order=order)
        for group, lanes, order in ((V, big[0], 0), (V2, big[1], 2))
    ]
    peers: list[tuple[str, str, int, Any, dict[str, Any]]] = []
    for group, order in ((V, 0), (V2, 2)):
        peers.append((f"heyoka scalar, {group}", group, 2**16, heyoka_taylor.prepare, {"order": order}))
        peers.append((f"heyoka batch refilled, {group}", group, 2**18, heyoka_batch.prepare, {"order": order}))
    peers.append(("scipy DOP853, V", V, 800, scipy_dop853.prepare, {}))
    for solver, rtol in diffrax_vmap.TOLERANCES.items():
        peers.append((f"diffrax {solver}, V", V, 2**14, diffrax_vmap.prepare, {"solver": solver, "rtol": rtol}))
    for name, group, lanes, factory, options in peers:
        if not only or any(word.lower() in name.lower() for word in only):
            pooled = factory is not diffrax_vmap.prepare
            make = functools.partial(_pooled, pool()) if pooled else _here
            rows.append(make(name, group, lanes // scale, factory, **options))
    return rows
