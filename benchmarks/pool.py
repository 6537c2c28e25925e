"""Worker processes, one to a core, for peers that run on one core at a time."""

import multiprocessing
import os
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks.work import Answers, Work

Runner = Callable[[], Answers]


def cores() -> list[int]:
    """The cores this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


class Pool:
    """Spawned workers (never forked: JAX runs here), each pinned to a core of its own.

    The shares are interleaved, so that every worker gets the same mixture. Preparing (compile,
    copy, warm up) and fetching the answers are not part of `run`, which is what is timed.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes = []
        self._counts: dict[str, int] = {}
        for core in cores():
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, core), daemon=True)
            process.start()
            self._pipes.append(here)
            self._processes.append(process)

    def prepare(self, key: str, factory: Callable[..., Runner], work: Work, **options: Any) -> None:
        """Give each worker its share; `factory(share, **options)` makes the function to run."""
        n = len(self._pipes)
        self._counts[key] = len(work)
        shares = [Work(work.alpha[i::n], work.s[i::n]) for i in range(n)]
        self._ask([("prepare", key, factory, share, options) for share in shares])

    def run(self, key: str) -> None:
        """Run all shares at once and wait for the last."""
        self._ask([("run", key)] * len(self._pipes))

    def answers(self, key: str) -> Answers:
        """The answers of the last run, in the order of the work."""
        parts = self._ask([("fetch", key)] * len(self._pipes))
        n, columns = len(parts), []
        for shares in zip(*parts, strict=True):
            if shares[0] is None:
                columns.append(None)
                continue
            whole = np.empty(self._counts[key], shares[0].dtype)
            for i, share in enumerate(shares):
                whole[i::n] = share
            columns.append(whole)
        return Answers(*columns)

    def close(self) -> None:
        """End the workers."""
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            pipe.send(("end",))
            process.join()

    def _ask(self, messages: list[tuple[Any, ...]]) -> list[Any]:
        for pipe, message in zip(self._pipes, messages, strict=True):
            pipe.send(message)
        replies = [pipe.recv() for pipe in self._pipes]
        for error, _ in replies:
            if error:
                raise RuntimeError(f"A worker failed:\n{error}")
        return [reply for _, reply in replies]


def _serve(pipe: Connection, core: int) -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    runners: dict[str, Runner] = {}
    answers: dict[str, Answers] = {}
    while True:
        verb, *arguments = pipe.recv()
        if verb == "end":
            return
        reply = None
        try:
            if verb == "prepare":
                key, factory, share, options = arguments
                runners[key] = factory(share, **options)
                factory(share.first(200), **options)()
            elif verb == "run":
                answers[arguments[0]] = runners[arguments[0]]()
            else:
                reply = answers[arguments[0]]
        except Exception:  # noqa: BLE001 - whatever it is, the parent raises it
            pipe.send((traceback.format_exc(), None))
        else:
            pipe.send((None, reply))
