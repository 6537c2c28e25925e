"""What can be had in milliseconds: programs compiled in the background, of models that answer."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

from erosion.explorer.answers import Answer
from erosion.explorer.state import Case
from erosion.explorer.threads import in_thread

_SIDE_BY_SIDE = 2  # at once: the engine compiles one program at a time, XLA a closed form's meanwhile
_TURN = 60.0  # s; so long a program waits for others to be compiled, which may never be


class Progress(NamedTuple):
    """How many programs are compiled, how many were asked for, and the models still without one."""

    done: int
    begun: int
    models: tuple[str, ...]


class Preparation:
    """Which answers about which models are compiled; one of these serves all tabs.

    Args:
        case: any case, about which each answer is asked once to have it compiled.
    """

    def __init__(self, case: Case) -> None:
        self._case = case
        self._turns = threading.Semaphore(_SIDE_BY_SIDE)
        self._lock = threading.Lock()
        self._begun: dict[tuple[Answer, str], Future] = {}
        self._late: dict[str, tuple[Future, str]] = {}
        self.listeners: set[Callable[[], None]] = set()

    def ready(self, answer: Answer, model: str) -> bool:
        """Whether this is compiled and the model answers; if it is not compiled, it will be."""
        with self._lock:
            if (answer, model) not in self._begun:
                self._begun[answer, model] = in_thread(lambda: self._compile(answer, model))
                self._begun[answer, model].add_done_callback(self._tell)
            return self._begun[answer, model].done() and not self._is_late(model)

    def leave_out(self, model: str, late: Future, why: str) -> None:
        """Count a model as not ready until a late answer comes."""
        self._late[model] = late, why
        late.add_done_callback(self._tell)

    def failure(self, model: str) -> str | None:
        """Why a model cannot be computed, if it cannot."""
        if self._is_late(model):
            return f"{model}: {self._late[model][1]}"
        for (_, name), future in list(self._begun.items()):
            if name == model and future.done() and (error := future.exception()) is not None:
                return f"{model}: {sentence(error)}"
        return None

    def progress(self) -> Progress:
        """How far compiling is."""
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


def sentence(error: BaseException) -> str:
    """An error in one line."""
    return " ".join(str(error).split()) or type(error).__name__
