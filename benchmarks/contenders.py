"""The contenders, and how many impacts each computes."""

import dataclasses
from collections.abc import Callable
from typing import Any

from benchmarks import closed_form, diffrax_vmap, engine, heyoka_batch, heyoka_scalar, scipy_dop853
from benchmarks.pool import Pool
from benchmarks.work import Answers, Work, as_answers

V, V2 = "V", "V, V′, V″"
LIMIT = "closed form"


@dataclasses.dataclass(frozen=True)
class Contender:
    """One row of the table.

    Args:
        name: in the table; `--only` selects by a part of it.
        group: `V`, `V2` or `LIMIT`: rows of one group are compared.
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


def contenders(gpu: bool, quick: bool, pool: Callable[[], Pool], only: list[str]) -> list[Contender]:
    """Those that `only` selects (all if empty); the engine's rows come first of their group, and always.

    Args:
        gpu: the engine and diffrax alone.
        quick: fewer impacts, and not all of diffrax.
        pool: makes one process per core, or gives those there are.
        only: parts of names.
    """
    scale = 8 if quick else 1
    big = [2**16, 2**16] if quick else [2**20, 2**19]
    if gpu:
        big = [10**6, 10**6] if quick else [10**7, 10**7]

    def wanted(name: str) -> bool:
        return not only or any(word.lower() in name.lower() for word in only)

    rows = [
        _here(f"erosion.impact, {group}", group, lanes, engine.prepare, order=order)
        for group, lanes, order in ((V, big[0], 0), (V2, big[1], 2))
    ]
    peers: list[tuple[str, str, int, Any, dict[str, Any], bool]] = []
    if not gpu:
        for group, order in ((V, 0), (V2, 2)):
            options, lanes = {"order": order}, 2**18 // scale
            peers.append((f"heyoka scalar, {group}", group, 2**16 // scale, heyoka_scalar.prepare, options, True))
            peers.append((f"heyoka batch refilled, {group}", group, lanes, heyoka_batch.prepare, options, True))
        peers.append(("scipy DOP853, V", V, 800 // scale, scipy_dop853.prepare, {}, True))
    lanes = 10**6 if gpu else 2**14
    for solver in ("Tsit5", "Dopri8"):
        options = {"solver": solver, "rtol": diffrax_vmap.TOLERANCES[solver]}
        if gpu or not quick:
            peers.append((f"diffrax {solver} flat, V", V, lanes // scale, diffrax_vmap.prepare, options, False))
        if not gpu:
            blocks = {**options, "block": diffrax_vmap.BLOCK}
            peers.append((f"diffrax {solver} blocks, V", V, lanes // scale, diffrax_vmap.prepare, blocks, False))
    if not gpu:
        peers.append(("linearized, numba", LIMIT, 10**7 // scale, closed_form.with_numba, {}, False))
        peers.append(("linearized, numpy", LIMIT, 10**7 // scale, closed_form.with_numpy, {}, False))
    for name, group, lanes, factory, options, pooled in peers:
        if not wanted(name):
            continue
        if pooled:
            rows.append(_pooled(pool(), name, group, lanes, factory, **options))
        else:
            rows.append(_here(name, group, lanes, factory, **options))
    return rows
