"""Worker processes: one to a core, for peers that run on one core at a time, or one with all cores."""

import multiprocessing
import os
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.work import Answers, Work, as_answers

Runner = Callable[[], Any]


def cores() -> list[int]:
    """The cores this process may use."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


class Worker:
    """A spawned process (never forked: JAX runs here) that calls functions it is sent, on the given cores."""

    def __init__(self, cores: Sequence[int]) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, there = context.Pipe()
        self._process = context.Process(target=_serve, args=(there, list(cores)), daemon=True)
        self._process.start()
        there.close()

    def begin(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> None:
        """Call a function of a module there; `result` waits for it."""
        self._pipe.send((function, arguments, options))

    def result(self) -> Any:
        """What the function returned."""
        error, value = self._pipe.recv()
        if error:
            raise RuntimeError(f"A worker failed:\n{error}")
        return value

    def call(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call a function there and wait."""
        self.begin(function, *arguments, **options)
        return self.result()

    def close(self) -> None:
        """End the process."""
        self._pipe.send(None)
        self._process.join()


class Pool:
    """Workers that share the work, one to each core, pinned to it.

    The shares are interleaved, so that every worker gets the same mixture. Preparing (compile,
    copy, warm up) and fetching the answers are not part of `run`, which is timed.
    """

    def __init__(self) -> None:
        self._workers = [Worker([core]) for core in cores()]
        self._counts: dict[str, int] = {}

    def prepare(self, key: str, factory: Callable[..., Runner], work: Work, **options: Any) -> None:
        """Give each worker its share; `factory(share, **options)` makes the function to run."""
        n = len(self._workers)
        self._counts[key] = len(work)
        for i, worker in enumerate(self._workers):
            worker.begin(_prepare, key, factory, Work(work.alpha[i::n], work.s[i::n]), options)
        self._results()

    def run(self, key: str) -> None:
        """Run all shares at once and wait for the last."""
        for worker in self._workers:
            worker.begin(_run, key)
        self._results()

    def answers(self, key: str) -> Answers:
        """The answers of the last run, in the order of the work."""
        for worker in self._workers:
            worker.begin(_fetch, key)
        parts, columns = self._results(), []
        for shares in zip(*parts, strict=True):
            if shares[0] is None:
                columns.append(None)
                continue
            whole = np.empty(self._counts[key], shares[0].dtype)
            for i, share in enumerate(shares):
                whole[i :: len(shares)] = share
            columns.append(whole)
        return Answers(*columns)

    def close(self) -> None:
        """End the workers."""
        for worker in self._workers:
            worker.close()

    def _results(self) -> list[Any]:
        return [worker.result() for worker in self._workers]


# Of a worker's process.
_runners: dict[str, Runner] = {}
_answers: dict[str, Any] = {}


def _prepare(key: str, factory: Callable[..., Runner], share: Work, options: dict[str, Any]) -> None:
    _runners[key] = factory(share, **options)
    _runners[key]()


def _run(key: str) -> None:
    _answers[key] = _runners[key]()


def _fetch(key: str) -> Answers:
    return as_answers(_answers[key])


def _serve(pipe: Any, cores: list[int]) -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    while True:
        try:
            request = pipe.recv()  # imports the function's module
            if request is None:
                return
            function, arguments, options = request
            reply = None, function(*arguments, **options)
        except Exception:  # noqa: BLE001 - whatever it is, the parent raises it
            reply = traceback.format_exc(), None
        pipe.send(reply)
