"""Answers computed for a state: those that the page needs at once, and those that take longer."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import wait
from typing import Any, NamedTuple

import numpy as np

from erosion.engine.impact import Impact
from erosion.explorer.answers import Answer, Answers, Spins
from erosion.explorer.preparation import Preparation, sentence
from erosion.explorer.state import Case, State
from erosion.explorer.threads import in_thread
from erosion.optimum.alpha_max import Optimum
from erosion.trajectory.trajectory import Trajectory

# s; a model that has no answer then is left out until it has one.
PATIENCE_AT_ONCE = 5.0
PATIENCE_LATER = 60.0


@dataclasses.dataclass
class Computed:
    """Answers about one state, by model; answers that are not computed yet are missing.

    Args:
        state: asked about.
        cut: of the model shown.
        points: at the state's angle.
        curves: over all angles.
        best: angles of greatest removal.
        ends: of the model shown, when each event alone would end the cut, over all angles.
        spins: angles of greatest removal over the spin.
        sensitivities: of the angle of greatest removal of the model shown.
        errors: what could not be computed, as sentences.
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
    """One more thing to find out.

    Args:
        answer, model, case: what is asked.
        keep: puts the answer where it belongs.
        compiled: the answer whose program this one runs.
        views: names of those to draw again; none where all wait for it.
    """

    answer: Answer
    model: str
    case: Case
    keep: Callable[[Any], None]
    compiled: Answer
    views: tuple[str, ...]


class Stage(NamedTuple):
    """Part of what is needed at once.

    Args:
        steps: the steps to compute.
        views: names of those that can then be drawn.
    """

    steps: Sequence[Step]
    views: tuple[str, ...]


def stages(answers: Answers, computed: Computed) -> Sequence[Stage]:
    """What takes milliseconds, in parts: the browser draws the first while the next is computed."""
    curves = Stage([*_curves(answers, computed), *_second(answers, computed)], ("volumes", "end_times"))
    return curves, Stage([_cut(answers, computed)], ("cut", "histories", "numbers", "spins", "sensitivities"))


def at_once(computed: Computed, stage: Stage, preparation: Preparation) -> None:
    """Find out a stage, of models that are compiled; of what takes longer, what is known already."""
    unknown = []
    for step in stage.steps:
        known = step.answer.known(step.model, step.case)
        if known is not None:
            step.keep(known)
        elif not step.views and preparation.ready(step.compiled, step.model):
            unknown.append(step)
    take(computed, unknown, preparation, PATIENCE_AT_ONCE)


def later(answers: Answers, computed: Computed, preparation: Preparation) -> Iterator[Step]:
    """What takes longer and is not known yet, the nearest at hand first."""
    for step in _second(answers, computed):
        if step.answer.known(step.model, step.case) is None and preparation.ready(step.compiled, step.model):
            yield step


def all_ready(answers: Answers, state: State, preparation: Preparation) -> bool:
    """Whether everything that moves with a slider is compiled."""
    computed = Computed(state)
    steps = _cut(answers, computed), *_curves(answers, computed)
    # A list, for asking begins the compiling of each.
    compiled = [preparation.ready(step.compiled, step.model) for step in steps]
    return all(compiled)


def take(computed: Computed, steps: Sequence[Step], preparation: Preparation, patience: float) -> None:
    """Take steps, the models side by side; an error becomes a sentence, and a model that is late is left out."""
    # One after another for a model: an answer that never comes keeps a thread, and a core, busy.
    asked = {
        model: in_thread(functools.partial(_answer, [step for step in steps if step.model == model]))
        for model in dict.fromkeys(step.model for step in steps)
    }
    wait(asked.values(), timeout=patience)
    for model, answers in asked.items():
        if not answers.done():
            preparation.leave_out(model, answers, f"no answer in {patience:g} s; left out until it comes")
            continue
        for step, said in answers.result():
            if isinstance(said, Exception):
                computed.errors.append(f"{model}: {sentence(said)}")
            else:
                step.keep(said)


def _answer(steps: Sequence[Step]) -> list[tuple[Step, Any]]:
    """The steps with their answers, or with the errors that came instead."""
    said: list[tuple[Step, Any]] = []
    for step in steps:
        try:
            said.append((step, step.answer(step.model, step.case)))
        # A plug-in's own code may raise anything; the page says so and goes on.
        except Exception as error:  # noqa: BLE001
            said.append((step, error))
    return said


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
