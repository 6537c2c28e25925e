"""The answers that the page needs about a model and a case; each is computed once and remembered."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from erosion.explorer.single_events import end_times
from erosion.explorer.state import Case
from erosion.impacts.impact import Impact, impact
from erosion.models.base import CuttingModel
from erosion.optimum.alpha_max import Optimum, alpha_max
from erosion.trajectory.path import path
from erosion.trajectory.trajectory import Trajectory

# Every 0.375°. At exactly 90° an impact without spin cuts nothing, so the last angle is smaller than 90°,
# by less than a curve can show.
ANGLES = np.deg2rad(np.append(np.linspace(0, 90, 241)[1:-1], 90 - 1e-7))
SPINS = np.linspace(-0.9, 0.9, 61)  # s = r φ̇₀/v₀

_KEPT = 128


class Spins(NamedTuple):
    """Angles of greatest removal over `SPINS`; arrays of shape (spins,)."""

    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray


class Answer:
    """One kind of answer, for any model and case; the latest answers are remembered.

    Args:
        compute: computes the answer from a model's name and a case.
    """

    def __init__(self, compute: Callable[[str, Case], Any]) -> None:
        self._compute = compute
        self._kept: dict[tuple[str, Case], Any] = {}
        self._lock = threading.Lock()

    def __call__(self, model: str, case: Case) -> Any:
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

    def remembered(self, model: str, case: Case) -> Any:
        """The answer if it is remembered, else None."""
        return self._kept.get((model, case.of_model(model)))


class Answers:
    """All kinds of answers, about models that are given by name.

    Args:
        models: by name, in the order of the page's list.
    """

    def __init__(self, models: Mapping[str, CuttingModel]) -> None:
        self.models = models
        self.cut = Answer(self._cut)
        self.point = Answer(self._point)
        self.curve = Answer(self._curve)
        self.best = Answer(self._best)
        self.ends = Answer(self._ends)
        self.sensitivities = Answer(self._sensitivities)
        self.spins = Answer(self._spins)

    def model(self, name: str, case: Case) -> CuttingModel:
        """The model with the own parameters of the case."""
        return self.models[name].replace(**case.own_values(name))

    def _cut(self, model: str, case: Case) -> Trajectory:
        """The motion of one impact, at many times."""
        return path(self.model(model, case), case.parameters())

    def _point(self, model: str, case: Case) -> Impact:
        """End, volume and derivatives of the same impact."""
        return impact(self.model(model, case), case.parameters(), derivatives=2)

    def _curve(self, model: str, case: Case) -> Impact:
        """Impacts at all `ANGLES`."""
        # With second derivatives, as `alpha_max` computes V: so the best angle lies on the curve to the last bit.
        return impact(self.model(model, case), case.parameters().replace(alpha=ANGLES), derivatives=2)

    def _best(self, model: str, case: Case) -> Optimum:
        """The angle of greatest removal."""
        return alpha_max(self.model(model, case), case.parameters())

    def _ends(self, model: str, case: Case) -> dict[str, np.ndarray]:
        """The times at which each event alone would end the cut, at all `ANGLES`."""
        return end_times(self.model(model, case), case.parameters().replace(alpha=ANGLES))

    def _sensitivities(self, model: str, case: Case) -> Mapping[str, Any]:
        """dα_max/dq for every parameter q of the case and of the model."""
        return self.best(model, case).sensitivities

    def _spins(self, model: str, case: Case) -> Spins:
        """The angle of greatest removal at all `SPINS`."""
        p = case.parameters()
        best = alpha_max(self.model(model, case), p.replace(phidot0=SPINS * float(p.v0 / p.r)))
        return Spins(best.alpha, best.volume, best.kind)
