"""The answers that the page needs: computed once, in threads.

A thread computes one stage for one model. While it runs, no other case of this stage and model begins; the page asks
again when it is done, for the case that is the newest then.
"""

import contextlib
import dataclasses
import functools
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import numpy as np

from erosion.arguments import Broadcast, ModelState
from erosion.explorer.state import PageCase, PageState, sentence
from erosion.impacts import OTHER_ENDS, Impact, alpha_max, end_names, impact, path, turn_of, turned_beyond
from erosion.models import CuttingModel, Events, SameMotion
from erosion.parameters import QUANTITIES, CaseFile, Parameters

T = TypeVar("T")


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


class SingleEvent(SameMotion):
    """A model whose cut is ended by one event alone; the motion after the other events continues under its forces."""

    motion: CuttingModel
    event: str = eqx.field(static=True)

    def events(self, state: ModelState, p: Parameters) -> Events:
        """The one event."""
        return {self.event: self.motion.events(state, p)[self.event]}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        """The model's own."""
        return self.motion.removal_rate(state, p)


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
    hits = {event: impact(SingleEvent(model, event), p) for event in events}
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


class Turned(NamedTuple):
    """How far the body turns in the cuts at all `ANGLES`, and after them at the case's own; shape (angles + 1,).

    Args:
        turn: [rad], NaN of a model without an orientation.
        beyond: whether it is more than 90°, where the model does not hold.
    """

    turn: np.ndarray
    beyond: np.ndarray


class AnswerKind(NamedTuple):
    """One kind of answer.

    Args:
        compute: the answer, from the `Answers`, a model's name and a case.
        fixed: parameters that the answer does not depend on, and the numbers that stand for them.
    """

    compute: Callable[["Answers", str, PageCase], Any]
    fixed: Mapping[str, float] = {}


def _curve(answers: "Answers", name: str, case: PageCase) -> Impact:
    # With second derivatives, as `alpha_max` computes V: so the best angle lies on the curve to the last bit.
    return impact(answers.model(name, case), case.parameters().replace(alpha=ANGLES), derivatives=2)


def _turned(answers: "Answers", name: str, case: PageCase) -> Turned:
    p = case.parameters()
    p = p.replace(alpha=np.append(ANGLES, p.alpha))
    return Turned(turn_of(answers.model(name, case), p), turned_beyond(answers.model(name, case), p))


def _spins(answers: "Answers", name: str, case: PageCase) -> SpinCurves:
    p = case.parameters()
    best = alpha_max(answers.model(name, case), p.replace(phidot0=SPINS * float(p.v0 / p.r)))
    return SpinCurves(best.alpha, best.volume, best.kind)


_ANY_ANGLE = {"alpha": 1.0}
KINDS: Mapping[str, AnswerKind] = {
    "cut": AnswerKind(lambda answers, name, case: path(answers.model(name, case), case.parameters())),
    "point": AnswerKind(lambda answers, name, case: impact(answers.model(name, case), case.parameters(),
                                                           derivatives=2)),
    "curve": AnswerKind(_curve, _ANY_ANGLE),
    "turned": AnswerKind(_turned),
    "best": AnswerKind(lambda answers, name, case: alpha_max(answers.model(name, case), case.parameters()), _ANY_ANGLE),
    "ends": AnswerKind(lambda answers, name, case: end_times(answers.model(name, case),
                                                       case.parameters().replace(alpha=ANGLES)), _ANY_ANGLE),
    "sensitivities": AnswerKind(lambda answers, name, case: answers("best", name, case).sensitivities, _ANY_ANGLE),
    "spins": AnswerKind(_spins, _ANY_ANGLE | {"phidot0": 0.0}),
}  # fmt: skip
"""The motion of one impact; its end, volume and derivatives; impacts at all `ANGLES`; how far the body turns; the angle
of greatest removal; when each event alone would end the cut, at all `ANGLES`; dα_max/dq for each q; the best angle at
all `SPINS`."""


class Stage(NamedTuple):
    """Kinds of answers that are computed together, and the views that are drawn then."""

    kinds: tuple[str, ...]
    views: tuple[str, ...]


class Work(NamedTuple):
    """The computation of a stage for one model and this case; the future is done when all answers are remembered."""

    case: PageCase
    future: Future[None]


AT_ONCE = (
    Stage(("curve", "point", "turned"), ("volumes", "end_times")),
    Stage(("cut",), ("cut", "histories", "numbers", "spins", "sensitivities")),
)
"""What takes milliseconds: the browser draws one stage while the next is computed."""

LATER = (
    Stage(("best",), ("volumes", "numbers")),
    Stage(("ends",), ("end_times",)),
    Stage(("sensitivities",), ("sensitivities",)),
    Stage(("spins",), ("spins",)),
)
"""The slower answers, in the order in which the reader needs them."""

_OF_MODEL_SHOWN = ("cut", "ends", "sensitivities")


class Answers:
    """All kinds of answers, about models that are given by name; the latest answers are remembered, errors too.

    Args:
        models: by name, in the order of the page's list.
        kinds: of answers, by name.
    """

    def __init__(self, models: Mapping[str, CuttingModel], kinds: Mapping[str, AnswerKind] = KINDS) -> None:
        self.models, self.kinds = models, kinds
        self._kept: dict[str, dict[tuple[str, PageCase], Any]] = {kind: {} for kind in kinds}
        self._lock = threading.Lock()
        self._work: dict[tuple[Stage, str], Work] = {}

    def __call__(self, kind: str, model: str, case: PageCase) -> Any:
        """The answer; it is computed if it is not remembered."""
        answer = self.remembered(kind, model, case)
        if answer is None:
            case, kept = self._about(kind, model, case), self._kept[kind]
            try:
                answer = self.kinds[kind].compute(self, model, case)
            # A plug-in's own code may raise any error; the page shows the error and goes on.
            except Exception as error:  # noqa: BLE001
                answer = error
            with self._lock:
                kept[model, case] = answer
                if len(kept) > _KEPT:
                    del kept[next(iter(kept))]
        if isinstance(answer, Exception):
            raise answer
        return answer

    def remembered(self, kind: str, model: str, case: PageCase) -> Any:
        """The answer or its error if it is remembered, else None."""
        return self._kept[kind].get((model, self._about(kind, model, case)))

    def model(self, name: str, case: PageCase) -> CuttingModel:
        """The model with the own parameters of the case."""
        return self.models[name].replace(**case.own_values(name))

    def start(self, stage: Stage, state: PageState) -> dict[str, Work]:
        """Compute a stage of a state, each model in a thread of its own.

        Returns:
            By model, the running work; that of another case if a model still computes the same stage of it. Then
            nothing begins for this state.
        """
        work = {}
        for model in state.models:
            kinds = [kind for kind in stage.kinds if model == state.shown or kind not in _OF_MODEL_SHOWN]
            if all(self.remembered(kind, model, state.case) is not None for kind in kinds):
                continue
            if (stage, model) not in self._work or self._work[stage, model].future.done():
                future = in_thread(functools.partial(self._compute, kinds, model, state.case))
                self._work[stage, model] = Work(state.case, future)
            work[model] = self._work[stage, model]
        return work

    def _compute(self, kinds: Iterable[str], model: str, case: PageCase) -> None:
        for kind in kinds:
            with contextlib.suppress(Exception):  # it is remembered
                self(kind, model, case)

    def _about(self, kind: str, model: str, case: PageCase) -> PageCase:
        """The case without what does not matter to the answer."""
        numbers = zip(QUANTITIES, case.values, strict=True)
        values = tuple(self.kinds[kind].fixed.get(name, number) for name, number in numbers)
        return case.of_model(model)._replace(values=values)


@dataclasses.dataclass
class Computed:
    """Answers about one state; answers that are not computed yet are missing.

    Args:
        state: the state of the page.
        answers: by their kind and model.
        file: the case file.
    """

    state: PageState
    answers: Mapping[tuple[str, str], Any] = dataclasses.field(default_factory=dict)
    file: CaseFile | None = None

    @classmethod
    def of(cls, answers: Answers, state: PageState, file: CaseFile | None) -> "Computed":
        """What is remembered about a state; while the reader predicts the best angles, they are left out."""
        kinds = [kind for kind in answers.kinds if not (state.predict and kind == "best")]
        asked = [(kind, model) for kind in kinds for model in state.models]
        known = {step: answers.remembered(*step, state.case) for step in asked}
        return cls(state, {step: answer for step, answer in known.items() if answer is not None}, file)

    @property
    def errors(self) -> list[str]:
        """One line for each model that could not be computed."""
        failed = ((model, answer) for (_, model), answer in self.answers.items() if isinstance(answer, Exception))
        return list(dict.fromkeys(f"{model}: {sentence(error)}" for model, error in failed))

    def of_shown(self, kind: str) -> Any:
        """The answer about the model shown, or None."""
        return self.of_all(kind).get(self.state.shown)

    def of_all(self, kind: str) -> dict[str, Any]:
        """The answers by model, in the order of the state's models."""
        answers = {model: self.answers.get((kind, model)) for model in self.state.models}
        return {model: of for model, of in answers.items() if of is not None and not isinstance(of, Exception)}
