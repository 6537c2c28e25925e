"""Compute the answers for a state: first the answers that take milliseconds, then the slower ones."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import wait
from typing import Any, NamedTuple

import numpy as np

from erosion.explorer.answers import Answer, Answers, Spins
from erosion.explorer.preparation import Preparation
from erosion.explorer.state import Case, State
from erosion.explorer.threads import in_thread
from erosion.explorer.wording import sentence
from erosion.impacts.impact import Impact
from erosion.optimum.alpha_max import Optimum
from erosion.trajectory.trajectory import Trajectory

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

    state: State
    cut: Trajectory | None = None
    points: dict[str, Impact] = dataclasses.field(default_factory=dict)
    curves: dict[str, Impact] = dataclasses.field(default_factory=dict)
    best: dict[str, Optimum] = dataclasses.field(default_factory=dict)
    ends: Mapping[str, np.ndarray] | None = None
    spins: dict[str, Spins] = dataclasses.field(default_factory=dict)
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

    answer: Answer
    model: str
    case: Case
    keep: Callable[[Any], None]
    compiled: Answer
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


def all_ready(answers: Answers, state: State, preparation: Preparation) -> bool:
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
