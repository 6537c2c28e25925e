"""Everything the page asks about a model and a case, each answered once and kept."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from erosion.engine.impact import Impact, impact
from erosion.explorer.single_events import end_times
from erosion.explorer.state import Case
from erosion.models.base import CuttingModel
from erosion.optimum.alpha_max import Optimum, alpha_max
from erosion.trajectory.path import path
from erosion.trajectory.trajectory import Trajectory

# Every 0.375°. At 90° itself an impact without spin cuts nothing; the last is short of it by less than
# any curve shows.
ANGLES = np.deg2rad(np.append(np.linspace(0, 90, 241)[1:-1], 90 - 1e-7))
SPINS = np.linspace(-0.9, 0.9, 61)  # s = r φ̇₀/v₀

_KEPT = 128


class Spins(NamedTuple):
    """Angles of greatest removal over `SPINS`; arrays of shape (spins,)."""

    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray


class Answer:
    """One question that may be asked of any model and case; what was said last is remembered.

    Args:
        ask: computes the answer, from a model's name and a case.
    """

    def __init__(self, ask: Callable[[str, Case], Any]) -> None:
        self._ask = ask
        self._said: dict[tuple[str, Case], Any] = {}
        self._lock = threading.Lock()

    def __call__(self, model: str, case: Case) -> Any:
        """The answer, computed where it is not remembered."""
        case = case.of_model(model)
        said = self.known(model, case)
        if said is None:
            said = self._ask(model, case)
            with self._lock:
                self._said[model, case] = said
                if len(self._said) > _KEPT:
                    del self._said[next(iter(self._said))]
        return said

    def known(self, model: str, case: Case) -> Any:
        """The answer if it is remembered, else None."""
        return self._said.get((model, case.of_model(model)))


class Answers:
    """The package's verbs on models by name, remembering what they said last.

    Args:
        models: by name, as the page lists them.
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
        """A model with its own parameters as the case has them."""
        return self.models[name].replace(**case.own_values(name))

    def _cut(self, model: str, case: Case) -> Trajectory:
        """One impact, dense in time."""
        return path(self.model(model, case), case.parameters())

    def _point(self, model: str, case: Case) -> Impact:
        """The same impact's end, volume and derivative."""
        return impact(self.model(model, case), case.parameters(), derivatives=2)

    def _curve(self, model: str, case: Case) -> Impact:
        """Impacts at all `ANGLES`."""
        # To second order, as `alpha_max` computes V: the best angle lies on the curve to the bit.
        return impact(self.model(model, case), case.parameters().replace(alpha=ANGLES), derivatives=2)

    def _best(self, model: str, case: Case) -> Optimum:
        """The angle of greatest removal."""
        return alpha_max(self.model(model, case), case.parameters())

    def _ends(self, model: str, case: Case) -> dict[str, np.ndarray]:
        """When each event alone would end the cut, at all `ANGLES`."""
        return end_times(self.model(model, case), case.parameters().replace(alpha=ANGLES))

    def _sensitivities(self, model: str, case: Case) -> Mapping[str, Any]:
        """dα_max/dq for every parameter q, the model's own too."""
        return self.best(model, case).sensitivities

    def _spins(self, model: str, case: Case) -> Spins:
        """The angle of greatest removal at all `SPINS`."""
        p = case.parameters()
        best = alpha_max(self.model(model, case), p.replace(phidot0=SPINS * float(p.v0 / p.r)))
        return Spins(best.alpha, best.volume, best.kind)
