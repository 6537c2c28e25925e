"""Compile programs in the background, and say which answers take only milliseconds by now."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

from erosion.explorer.answers import Answer
from erosion.explorer.state import Case
from erosion.explorer.threads import in_thread
from erosion.explorer.wording import sentence

_IN_PARALLEL = 2  # compilations: one of the engine, which does one at a time, and one of XLA for a closed form
_TURN = 60.0  # s; a program waits at most this long for others, whose compilation may never end


class Progress(NamedTuple):
    """The number of compiled programs, of requested programs, and the models that still wait for a program."""

    done: int
    begun: int
    models: tuple[str, ...]


class Preparation:
    """Compiles the program of each answer and model; all tabs share one preparation.

    Args:
        case: any case; to compile a program, its answer is computed once for this case.
    """

    def __init__(self, case: Case) -> None:
        self._case = case
        self._turns = threading.Semaphore(_IN_PARALLEL)
        self._lock = threading.Lock()
        self._begun: dict[tuple[Answer, str], Future] = {}
        self._late: dict[str, tuple[Future, str]] = {}
        self.listeners: set[Callable[[], None]] = set()

    def ready(self, answer: Answer, model: str) -> bool:
        """Whether the program is compiled and the model answers; the first call starts the compilation."""
        with self._lock:
            if (answer, model) not in self._begun:
                self._begun[answer, model] = in_thread(lambda: self._compile(answer, model))
                self._begun[answer, model].add_done_callback(self._tell)
            return self._begun[answer, model].done() and not self._is_late(model)

    def leave_out(self, model: str, late: Future, why: str) -> None:
        """Treat a model as not ready until its late answer comes."""
        self._late[model] = late, why
        late.add_done_callback(self._tell)

    def failure(self, model: str) -> str | None:
        """A sentence that says why a model cannot be computed, or None."""
        if self._is_late(model):
            return f"{model}: {self._late[model][1]}"
        for (_, name), future in list(self._begun.items()):
            if name == model and future.done() and (error := future.exception()) is not None:
                return f"{model}: {sentence(error)}"
        return None

    def progress(self) -> Progress:
        """How many programs are compiled by now."""
        begun = list(self._begun.items())
        waiting = [model for (_, model), future in begun if not future.done()]
        return Progress(len(begun) - len(waiting), len(begun), tuple(dict.fromkeys(waiting)))

    def _compile(self, answer: Answer, model: str) -> None:
        in_turn = self._turns.acquire(timeout=_TURN)
        try:
            answer(model, self._case)
        finally:
            if in_turn:
                self._turns.release()

    def _is_late(self, model: str) -> bool:
        return model in self._late and not self._late[model][0].done()

    def _tell(self, _: Future) -> None:
        for listener in list(self.listeners):
            listener()
