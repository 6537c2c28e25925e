"""The answers that the page needs: computed once, in the background, the latest request first."""

import ctypes
import dataclasses
import functools
import sys
import threading
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.explorer.state import PageCase, PageState, sentence
from erosion.impacts import OTHER_ENDS, Impact, alpha_max, end_names, impact, path
from erosion.models import CuttingModel, Scales, Tip
from erosion.parameters import QUANTITIES, CaseFile, Parameters

T = TypeVar("T")

_ARENA_MAX = -8  # of glibc's mallopt
_ARENAS = 2


def share_memory() -> None:
    """Let all threads take their memory from two arenas; to be called before threads are started.

    By default glibc gives new threads arenas of their own, up to eight for each core, and never returns what is free
    in the middle of one. A thread for each answer left the explorer with 150 MB of free memory after some minutes.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_ARENA_MAX, _ARENAS)


def in_thread(work: Callable[[], T]) -> Future[T]:
    """Do the work in a new thread.

    A plug-in's own code may never return. In a pool this code would occupy a thread for ever, and
    the interpreter would wait for the thread before it ends.
    """
    future: Future[T] = Future()

    def run() -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(work())
        # The caller of `result` decides what to do about an error.
        except BaseException as error:  # noqa: BLE001
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


Item = TypeVar("Item")


class LatestWins(Generic[Item]):
    """Works on one item at a time, and lets only the newest item wait.

    Args:
        work: works on an item. It may look at `waiting` and stop early.
        start: starts a coroutine on the event loop.
    """

    def __init__(self, work: Callable[[Item], Awaitable[None]], start: Callable[[Awaitable[None]], object]) -> None:
        self._work, self._start = work, start
        self._next: list[Item] = []
        self._busy = False

    @property
    def waiting(self) -> bool:
        """Whether a newer item waits."""
        return bool(self._next)

    def offer(self, item: Item) -> None:
        """Work on this item next; it replaces an item that waits."""
        self._next = [item]
        if not self._busy:
            self._busy = True
            self._start(self._drain())

    async def _drain(self) -> None:
        try:
            while self._next:
                await self._work(self._next.pop())
        finally:
            self._busy = False


_PATIENCE = 12.0  # time scales; the page says that a later event never happens
_NEVER = "never"


class SingleEvent(CuttingModel):
    """A model whose cut is ended by one event alone, or by a clock if this event does not happen.

    The motion after the other events continues under the same forces.
    """

    model: CuttingModel
    event: str = eqx.field(static=True)

    def initial_state(self, p: Parameters) -> Any:
        """The model's own state, and a clock that counts time scales."""
        return self.model.initial_state(p), jnp.zeros_like(self.model.scales(p).time)

    def derivative(self, state: Any, p: Parameters) -> Any:
        """The model's own motion, and the rate of the clock."""
        return self.model.derivative(state[0], p), 1 / self.model.scales(p).time

    def tip(self, state: Any, p: Parameters) -> Tip:
        """The model's own tip."""
        return self.model.tip(state[0], p)

    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        """The one event, and the end of the clock."""
        return {self.event: self.model.events(state[0], p)[self.event], _NEVER: 1 - state[1] / _PATIENCE}

    def scales(self, p: Parameters) -> Scales:
        """The model's own scales."""
        return self.model.scales(p)


def end_times(model: CuttingModel, p: Parameters) -> dict[str, np.ndarray]:
    """The times at which each event alone would end the cut.

    Args:
        model: any model.
        p: parameters whose leaves are scalars or arrays that broadcast.

    Returns:
        By event name, times of the broadcast shape [s]; NaN where the event never happens.
    """
    closed = model.closed_form()
    if closed is not None:
        return {name: np.asarray(times) for name, times in closed.end_times(p).items()}
    events = [name for name in end_names(model) if name not in OTHER_ENDS]
    hits = {event: impact(SingleEvent(model=model, event=event), p) for event in events}
    return {event: np.where(np.asarray(hit.ended_by) == event, hit.t_c, np.nan) for event, hit in hits.items()}


# Every 0.375°. At exactly 90° an impact without spin cuts nothing, so the last angle is smaller than 90°,
# by less than a curve can show.
ANGLES = np.deg2rad(np.append(np.linspace(0, 90, 241)[1:-1], 90 - 1e-7))
SPINS = np.linspace(-0.9, 0.9, 61)  # s = r φ̇₀/v₀

_KEPT = 128


class SpinCurves(NamedTuple):
    """Angles of greatest removal over `SPINS`; arrays of shape (spins,)."""

    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray


class AnswerKind(NamedTuple):
    """One kind of answer.

    Args:
        compute: the answer, from the `Answers`, a model's name and a case.
        fixed: parameters that the answer does not depend on, and the numbers that stand for them.
        program: the kind whose compiled program computes it, if that is another one.
    """

    compute: Callable[["Answers", str, PageCase], Any]
    fixed: Mapping[str, float] = {}
    program: str = ""


def _curve(answers: "Answers", name: str, case: PageCase) -> Impact:
    # With second derivatives, as `alpha_max` computes V: so the best angle lies on the curve to the last bit.
    return impact(answers.model(name, case), case.parameters().replace(alpha=ANGLES), derivatives=2)


def _spins(answers: "Answers", name: str, case: PageCase) -> SpinCurves:
    p = case.parameters()
    best = alpha_max(answers.model(name, case), p.replace(phidot0=SPINS * float(p.v0 / p.r)))
    return SpinCurves(best.alpha, best.volume, best.kind)


_ANY_ANGLE = {"alpha": 1.0}
KINDS: Mapping[str, AnswerKind] = {
    "cut": AnswerKind(lambda answers, name, case: path(answers.model(name, case), case.parameters())),
    "point": AnswerKind(lambda answers, name, case: impact(answers.model(name, case), case.parameters(), derivatives=2),
                        program="curve"),
    "curve": AnswerKind(_curve, _ANY_ANGLE),
    "best": AnswerKind(lambda answers, name, case: alpha_max(answers.model(name, case), case.parameters()), _ANY_ANGLE,
                 "curve"),
    "ends": AnswerKind(lambda answers, name, case: end_times(answers.model(name, case),
                                                       case.parameters().replace(alpha=ANGLES)), _ANY_ANGLE),
    "sensitivities": AnswerKind(lambda answers, name, case: answers("best", name, case).sensitivities, _ANY_ANGLE),
    "spins": AnswerKind(_spins, _ANY_ANGLE | {"phidot0": 0.0}, "curve"),
}  # fmt: skip
"""The motion of one impact; its end, volume and derivatives; impacts at all `ANGLES`; the angle of greatest removal;
when each event alone would end the cut, at all `ANGLES`; dα_max/dq for each q; the best angle at all `SPINS`."""


class Answers:
    """All kinds of answers, about models that are given by name; the latest answers are remembered.

    Args:
        models: by name, in the order of the page's list.
        kinds: of answers, by name.
    """

    def __init__(self, models: Mapping[str, CuttingModel], kinds: Mapping[str, AnswerKind] = KINDS) -> None:
        self.models, self.kinds = models, kinds
        self._kept: dict[str, dict[tuple[str, PageCase], Any]] = {kind: {} for kind in kinds}
        self._lock = threading.Lock()

    def __call__(self, kind: str, model: str, case: PageCase) -> Any:
        """The answer; it is computed if it is not remembered."""
        answer = self.remembered(kind, model, case)
        if answer is None:
            case, kept = self._about(kind, model, case), self._kept[kind]
            answer = self.kinds[kind].compute(self, model, case)
            with self._lock:
                kept[model, case] = answer
                if len(kept) > _KEPT:
                    del kept[next(iter(kept))]
        return answer

    def remembered(self, kind: str, model: str, case: PageCase) -> Any:
        """The answer if it is remembered, else None."""
        return self._kept[kind].get((model, self._about(kind, model, case)))

    def model(self, name: str, case: PageCase) -> CuttingModel:
        """The model with the own parameters of the case."""
        return self.models[name].replace(**case.own_values(name))

    def _about(self, kind: str, model: str, case: PageCase) -> PageCase:
        """The case without what does not matter to the answer."""
        numbers = zip(QUANTITIES, case.values, strict=True)
        values = tuple(self.kinds[kind].fixed.get(name, number) for name, number in numbers)
        return case.of_model(model)._replace(values=values)


_IN_PARALLEL = 2  # compilations: one of the engine, which does one at a time, and one of XLA for a closed form
_TURN = 60.0  # s; a program waits at most this long for others, whose compilation may never end


class Preparation:
    """Compiles the program of each kind of answer and model; all tabs share one preparation.

    Args:
        answers: of which the programs are.
        case: any case; to compile a program, its answer is computed once for this case.
    """

    def __init__(self, answers: Answers, case: PageCase) -> None:
        self._answers, self._case = answers, case
        self._turns = threading.Semaphore(_IN_PARALLEL)
        self._lock = threading.Lock()
        self._begun: dict[tuple[str, str], Future] = {}
        self._late: dict[str, tuple[Future, str]] = {}
        self.listeners: set[Callable[[], None]] = set()

    def ready(self, kind: str, model: str) -> bool:
        """Whether the program is compiled and the model answers; the first call starts the compilation."""
        kind = self._answers.kinds[kind].program or kind
        with self._lock:
            if (kind, model) not in self._begun:
                self._begun[kind, model] = in_thread(lambda: self._compile(kind, model))
                self._begun[kind, model].add_done_callback(self._tell)
            return self._begun[kind, model].done() and not self._is_late(model)

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

    def progress(self) -> tuple[int, int, list[str]]:
        """How many programs are compiled, how many were asked for, and the models that still wait for one."""
        begun = list(self._begun.items())
        waiting = [model for (_, model), future in begun if not future.done()]
        return len(begun) - len(waiting), len(begun), list(dict.fromkeys(waiting))

    def _compile(self, kind: str, model: str) -> None:
        in_turn = self._turns.acquire(timeout=_TURN)
        try:
            self._answers(kind, model, self._case)
        finally:
            if in_turn:
                self._turns.release()

    def _is_late(self, model: str) -> bool:
        return model in self._late and not self._late[model][0].done()

    def _tell(self, _: Future) -> None:
        for listener in list(self.listeners):
            listener()


# s; a model that has given no answer by then is left out until its answer comes.
PATIENCE_AT_ONCE = 5.0
PATIENCE_LATER = 60.0

STAGES = (
    (("curve", "point"), ("volumes", "end_times")),
    (("cut",), ("cut", "histories", "numbers", "spins", "sensitivities")),
)
"""The kinds of answers that take milliseconds, in parts: the browser draws one part while the next is computed."""

LATER: Mapping[str, tuple[str, ...]] = {
    "best": ("volumes", "numbers"),
    "ends": ("end_times",),
    "sensitivities": ("sensitivities",),
    "spins": ("spins",),
}
"""The slower kinds in the order in which the reader needs them, and the views to draw again afterwards."""

_OF_MODEL_SHOWN = ("cut", "ends", "sensitivities")
Step = tuple[str, str]
"""A kind of answer and the model that it is about."""


def steps(kinds: Iterable[str], state: PageState) -> list[Step]:
    """The answers of these kinds that a state needs; the model shown comes first."""
    models = sorted(state.models, key=lambda name: name != state.shown)
    return [(kind, model) for kind in kinds for model in ([state.shown] if kind in _OF_MODEL_SHOWN else models)]


@dataclasses.dataclass
class Computed:
    """Answers about one state; answers that are not computed yet are missing.

    Args:
        state: the state of the page.
        answers: by their step.
        errors: one line for each answer that could not be computed.
        file: the case file.
    """

    state: PageState
    answers: dict[Step, Any] = dataclasses.field(default_factory=dict)
    errors: list[str] = dataclasses.field(default_factory=list)
    file: CaseFile | None = None

    def of_shown(self, kind: str) -> Any:
        """The answer about the model shown, or None."""
        return self.answers.get((kind, self.state.shown))

    def of_all(self, kind: str) -> dict[str, Any]:
        """The answers by model, in the order of the state's models."""
        return {model: self.answers[kind, model] for model in self.state.models if (kind, model) in self.answers}

    def take_remembered(self, answers: Answers, kinds: Iterable[str]) -> list[Step]:
        """Take what is remembered of these kinds, and return the other steps."""
        wanted = steps(kinds, self.state)
        remembered = {step: answers.remembered(*step, self.state.case) for step in wanted}
        self.answers |= {step: answer for step, answer in remembered.items() if answer is not None}
        return [step for step in wanted if step not in self.answers]


def at_once(computed: Computed, kinds: Iterable[str], answers: Answers, preparation: Preparation) -> None:
    """Compute these kinds for the models that are compiled."""
    missing = computed.take_remembered(answers, kinds)
    take(computed, [step for step in missing if preparation.ready(*step)], answers, preparation, PATIENCE_AT_ONCE)


def all_ready(state: PageState, preparation: Preparation) -> bool:
    """Whether all programs are compiled whose answers follow a slider."""
    wanted = [step for kinds, _ in reversed(STAGES) for step in steps(kinds, state)]
    # A list: `ready` starts the compilation, and `all` alone would stop at the first program that is not ready.
    ready = [preparation.ready(*step) for step in wanted]
    return all(ready)


def take(
    computed: Computed, wanted: Sequence[Step], answers: Answers, preparation: Preparation, patience: float
) -> None:
    """Compute steps, all models in parallel. An error becomes a sentence; a model that is late is left out."""

    def answered(own: Sequence[Step]) -> list[tuple[Step, Any]]:
        done: list[tuple[Step, Any]] = []
        for step in own:
            try:
                done.append((step, answers(*step, computed.state.case)))
            # A plug-in's own code may raise any error; the page shows the error and goes on.
            except Exception as error:  # noqa: BLE001
                done.append((step, error))
        return done

    # The steps of one model run in one thread: an answer that never comes keeps one thread and one core busy.
    futures = {
        model: in_thread(functools.partial(answered, [step for step in wanted if step[1] == model]))
        for model in dict.fromkeys(model for _, model in wanted)
    }
    wait(futures.values(), timeout=patience)
    for model, future in futures.items():
        if not future.done():
            preparation.leave_out(model, future, f"no answer in {patience:g} s; left out until it comes")
            continue
        for step, answer in future.result():
            if isinstance(answer, Exception):
                computed.errors.append(f"{model}: {sentence(answer)}")
            else:
                computed.answers[step] = answer
