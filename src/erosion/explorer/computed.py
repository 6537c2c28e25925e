"""The answers that the page needs: computed once, in the background, the latest request first."""

import ctypes
import dataclasses
import functools
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.explorer.state import PageCase, PageState, sentence
from erosion.impacts.alpha_max import Optimum, alpha_max
from erosion.impacts.impact import OTHER_ENDS, Impact, end_names, impact
from erosion.impacts.simulate import Trajectory, path
from erosion.models.base import CuttingModel, Scales, Tip
from erosion.parameters.parameters import Parameters

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
    return {name: _alone(model, name, p) for name in end_names(model) if name not in OTHER_ENDS}


def _alone(model: CuttingModel, event: str, p: Parameters) -> np.ndarray:
    hits = impact(SingleEvent(model=model, event=event), p)
    return np.where(np.asarray(hits.ended_by) == event, hits.t_c, np.nan)


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


class ModelProgram:
    """One kind of answer, for any model and case; the latest answers are remembered.

    Args:
        compute: computes the answer from a model's name and a case.
    """

    def __init__(self, compute: Callable[[str, PageCase], Any]) -> None:
        self._compute = compute
        self._kept: dict[tuple[str, PageCase], Any] = {}
        self._lock = threading.Lock()

    def __call__(self, model: str, case: PageCase) -> Any:
        """The answer; it is computed if it is not remembered."""
        case = case.of_model(model)
        answer = self.remembered(model, case)
        if answer is None:
            answer = self._compute(model, case)
            with self._lock:
                self._kept[model, case] = answer
                if len(self._kept) > _KEPT:
                    del self._kept[next(iter(self._kept))]
        return answer

    def remembered(self, model: str, case: PageCase) -> Any:
        """The answer if it is remembered, else None."""
        return self._kept.get((model, case.of_model(model)))


class Answers:
    """All kinds of answers, about models that are given by name.

    Args:
        models: by name, in the order of the page's list.
    """

    def __init__(self, models: Mapping[str, CuttingModel]) -> None:
        self.models = models
        self.cut = ModelProgram(self._cut)
        self.point = ModelProgram(self._point)
        self.curve = ModelProgram(self._curve)
        self.best = ModelProgram(self._best)
        self.ends = ModelProgram(self._ends)
        self.sensitivities = ModelProgram(self._sensitivities)
        self.spins = ModelProgram(self._spins)

    def model(self, name: str, case: PageCase) -> CuttingModel:
        """The model with the own parameters of the case."""
        return self.models[name].replace(**case.own_values(name))

    def _cut(self, model: str, case: PageCase) -> Trajectory:
        """The motion of one impact, at many times."""
        return path(self.model(model, case), case.parameters())

    def _point(self, model: str, case: PageCase) -> Impact:
        """End, volume and derivatives of the same impact."""
        return impact(self.model(model, case), case.parameters(), derivatives=2)

    def _curve(self, model: str, case: PageCase) -> Impact:
        """Impacts at all `ANGLES`."""
        # With second derivatives, as `alpha_max` computes V: so the best angle lies on the curve to the last bit.
        return impact(self.model(model, case), case.parameters().replace(alpha=ANGLES), derivatives=2)

    def _best(self, model: str, case: PageCase) -> Optimum:
        """The angle of greatest removal."""
        return alpha_max(self.model(model, case), case.parameters())

    def _ends(self, model: str, case: PageCase) -> dict[str, np.ndarray]:
        """The times at which each event alone would end the cut, at all `ANGLES`."""
        return end_times(self.model(model, case), case.parameters().replace(alpha=ANGLES))

    def _sensitivities(self, model: str, case: PageCase) -> Mapping[str, Any]:
        """dα_max/dq for every parameter q of the case and of the model."""
        return self.best(model, case).sensitivities

    def _spins(self, model: str, case: PageCase) -> SpinCurves:
        """The angle of greatest removal at all `SPINS`."""
        p = case.parameters()
        best = alpha_max(self.model(model, case), p.replace(phidot0=SPINS * float(p.v0 / p.r)))
        return SpinCurves(best.alpha, best.volume, best.kind)


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

    def __init__(self, case: PageCase) -> None:
        self._case = case
        self._turns = threading.Semaphore(_IN_PARALLEL)
        self._lock = threading.Lock()
        self._begun: dict[tuple[ModelProgram, str], Future] = {}
        self._late: dict[str, tuple[Future, str]] = {}
        self.listeners: set[Callable[[], None]] = set()

    def ready(self, answer: ModelProgram, model: str) -> bool:
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

    def _compile(self, answer: ModelProgram, model: str) -> None:
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


# s; a model that has given no answer by then is left out until its answer comes.
PATIENCE_AT_ONCE = 5.0
PATIENCE_LATER = 60.0


@dataclasses.dataclass
class Computed:
    """Answers about one state, by model; answers that are not computed yet are missing.

    Args:
        state: the state that the answers are about.
        cut: the cut of the model shown.
        points: the impacts at the state's angle.
        curves: the impacts over all angles.
        best: the angles of greatest removal.
        ends: for the model shown, the times at which each event alone would end the cut, over all angles.
        spins: the angles of greatest removal over the spin.
        sensitivities: how far the angle of greatest removal of the model shown moves with each parameter.
        errors: one sentence for each answer that could not be computed.
    """

    state: PageState
    cut: Trajectory | None = None
    points: dict[str, Impact] = dataclasses.field(default_factory=dict)
    curves: dict[str, Impact] = dataclasses.field(default_factory=dict)
    best: dict[str, Optimum] = dataclasses.field(default_factory=dict)
    ends: Mapping[str, np.ndarray] | None = None
    spins: dict[str, SpinCurves] = dataclasses.field(default_factory=dict)
    sensitivities: Mapping[str, Any] | None = None
    errors: list[str] = dataclasses.field(default_factory=list)

    def in_order(self, answers: Mapping[str, Any]) -> list[tuple[str, Any]]:
        """Answers in the order of the state's models."""
        return [(model, answers[model]) for model in self.state.models if model in answers]


class Step(NamedTuple):
    """One answer to compute.

    Args:
        answer, model, case: the kind of answer, and the model and case that it is about.
        keep: a function that stores the answer in `Computed`.
        compiled: the kind of answer whose compiled program this step runs.
        views: names of the views to draw again afterwards; empty if the whole stage waits for the step.
    """

    answer: ModelProgram
    model: str
    case: PageCase
    keep: Callable[[Any], None]
    compiled: ModelProgram
    views: tuple[str, ...]


class Stage(NamedTuple):
    """A part of the answers that the page needs at once.

    Args:
        steps: the steps to compute.
        views: names of the views that can be drawn afterwards.
    """

    steps: Sequence[Step]
    views: tuple[str, ...]


def stages(answers: Answers, computed: Computed) -> Sequence[Stage]:
    """The answers that take milliseconds, in parts: the browser draws one part while the next is computed."""
    curves = Stage([*_curves(answers, computed), *_second(answers, computed)], ("volumes", "end_times"))
    return curves, Stage([_cut(answers, computed)], ("cut", "histories", "numbers", "spins", "sensitivities"))


def at_once(computed: Computed, stage: Stage, preparation: Preparation) -> None:
    """Compute a stage for the models that are compiled. Of slower answers only the remembered ones are taken."""
    missing = []
    for step in stage.steps:
        remembered = step.answer.remembered(step.model, step.case)
        if remembered is not None:
            step.keep(remembered)
        elif not step.views and preparation.ready(step.compiled, step.model):
            missing.append(step)
    take(computed, missing, preparation, PATIENCE_AT_ONCE)


def later(answers: Answers, computed: Computed, preparation: Preparation) -> Iterator[Step]:
    """The slower steps whose answers are not remembered, in the order in which the reader needs them."""
    for step in _second(answers, computed):
        if step.answer.remembered(step.model, step.case) is None and preparation.ready(step.compiled, step.model):
            yield step


def all_ready(answers: Answers, state: PageState, preparation: Preparation) -> bool:
    """Whether all programs are compiled whose answers follow a slider."""
    computed = Computed(state)
    steps = _cut(answers, computed), *_curves(answers, computed)
    # A list: `ready` starts the compilation, and `all` alone would stop at the first program that is not ready.
    compiled = [preparation.ready(step.compiled, step.model) for step in steps]
    return all(compiled)


def take(computed: Computed, steps: Sequence[Step], preparation: Preparation, patience: float) -> None:
    """Compute steps, all models in parallel. An error becomes a sentence; a model that is late is left out."""
    # The steps of one model run in one thread: an answer that never comes keeps one thread and one core busy.
    futures = {
        model: in_thread(functools.partial(_answer, [step for step in steps if step.model == model]))
        for model in dict.fromkeys(step.model for step in steps)
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
                step.keep(answer)


def _answer(steps: Sequence[Step]) -> list[tuple[Step, Any]]:
    """Each step with its answer, or with the error that was raised instead."""
    answers: list[tuple[Step, Any]] = []
    for step in steps:
        try:
            answers.append((step, step.answer(step.model, step.case)))
        # A plug-in's own code may raise any error; the page shows the error and goes on.
        except Exception as error:  # noqa: BLE001
            answers.append((step, error))
    return answers


def _cut(answers: Answers, computed: Computed) -> Step:
    return Step(answers.cut, computed.state.shown, computed.state.case, _as(computed, "cut"), answers.cut, ())


def _curves(answers: Answers, computed: Computed) -> Iterator[Step]:
    state = computed.state
    over_angles = state.case.at_any_angle()
    for model in sorted(state.models, key=lambda name: name != state.shown):
        yield Step(answers.curve, model, over_angles, _into(computed.curves, model), answers.curve, ())
        yield Step(answers.point, model, state.case, _into(computed.points, model), answers.curve, ())


def _second(answers: Answers, computed: Computed) -> Iterator[Step]:
    state, shown = computed.state, computed.state.shown
    over_angles, over_spins = state.case.at_any_angle(), state.case.at_any_spin()
    order = sorted(state.models, key=lambda name: name != shown)
    for model in order:
        yield Step(answers.best, model, over_angles, _into(computed.best, model), answers.curve, ("volumes", "numbers"))
    yield Step(answers.ends, shown, over_angles, _as(computed, "ends"), answers.ends, ("end_times",))
    yield Step(answers.sensitivities, shown, over_angles, _as(computed, "sensitivities"), answers.sensitivities,
               ("sensitivities",))  # fmt: skip
    for model in order:
        yield Step(answers.spins, model, over_spins, _into(computed.spins, model), answers.curve, ("spins",))


def _into(kept: dict[str, Any], model: str) -> Callable[[Any], None]:
    return lambda answer: kept.update({model: answer})


def _as(computed: Computed, name: str) -> Callable[[Any], None]:
    return lambda answer: setattr(computed, name, answer)
