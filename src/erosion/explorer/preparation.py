"""Compiling in the background: what is asked of a model for the first time takes seconds, then milliseconds."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from erosion.explorer.answers import Answer
from erosion.explorer.state import Case

_THREADS = 2  # of XLA's compiler, which leaves the interpreter to the page


class Preparation:
    """Which answers about which models are compiled; one of these serves all tabs.

    Args:
        case: any case, about which each answer is asked once to have it compiled.
    """

    def __init__(self, case: Case) -> None:
        self._case = case
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="prepare")
        self._lock = threading.Lock()
        self._begun: dict[tuple[Answer, str], Future] = {}
        self.listeners: set[Callable[[], None]] = set()

    def ready(self, answer: Answer, model: str) -> bool:
        """Whether this is compiled; if not, it will be."""
        with self._lock:
            if (answer, model) not in self._begun:
                self._begun[answer, model] = self._pool.submit(answer, model, self._case)
                self._begun[answer, model].add_done_callback(self._tell)
            return self._begun[answer, model].done()

    def failure(self, model: str) -> str | None:
        """Why a model cannot be computed, if it cannot."""
        for (_, name), future in list(self._begun.items()):
            if name == model and future.done() and (error := future.exception()) is not None:
                return f"{model}: {' '.join(str(error).split()) or type(error).__name__}"
        return None

    def progress(self) -> tuple[int, int]:
        """How many programs are compiled, and how many were asked for."""
        begun = list(self._begun.values())
        return sum(future.done() for future in begun), len(begun)

    def close(self) -> None:
        """Start nothing any more."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _tell(self, _: Future) -> None:
        for listener in list(self.listeners):
            listener()
