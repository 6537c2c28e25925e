"""The case that a question is asked about, with shared results, and the form of an answer."""

import functools
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from erosion.impacts.impact import Impact, impact
from erosion.models import Linearized
from erosion.models.base import ClosedForm
from erosion.optimum.alpha_max import Optimum, alpha_max
from erosion.parameters.parameters import Parameters
from erosion.parameters.per_mass import PerMass
from erosion.parameters.units import System
from erosion.plotting.curves import broken_at
from erosion.plotting.families import Curve
from erosion.report.families import Families, families_of
from erosion.report.spins import Spins, over_spins
from erosion.tables import Record
from erosion.trajectory.path import path
from erosion.trajectory.trajectory import Trajectory

_RTOL = 1e-12  # relative tolerance of the report's impacts, with which its other numbers are compared
Need = tuple[str, str]
"""A kind of result and the model that it is about: ("optimum", "rotating")."""

_ASIDE = {"slips": "On the source", "models": "In closing"}


@dataclass(frozen=True)
class Answer:
    """What is computed for one question; its text, a Markdown file beside the question's module, shows it.

    Args:
        numbers: by name, for numbers.json and as fields of the text.
        figures: by the names of their files, without suffix.
        fields: further values that the text uses, by name.
    """

    numbers: Record
    figures: Mapping[str, Figure]
    fields: Mapping[str, Any] = field(default_factory=dict)


def question(key: str) -> str:
    """The title of a part: "q4" is Question 4, "a2" is Additional question 2; other keys give their subject."""
    if key in _ASIDE:
        return _ASIDE[key]
    return f"{'Additional question' if key[0] == 'a' else 'Question'} {key[1:]}"


@dataclass(frozen=True)
class Case:
    """One set of parameters. Results that several questions need are computed once.

    Questions 1 to 8 are asked of the linearized model, whose solution is known exactly.
    Results about models that are given by name come from the engine, also if a closed form exists.
    """

    p: Parameters
    name: str
    per_mass: PerMass = field(default_factory=PerMass)

    @property
    def units(self) -> System:
        """The unit system of every number."""
        return self.p.units

    @functools.cached_property
    def model(self) -> Linearized:
        """The model of questions 1 to 8."""
        return Linearized()

    @functools.cached_property
    def closed(self) -> ClosedForm:
        """Its exact solution."""
        closed = self.model.closed_form()
        assert closed is not None, "the linearized model is solved in closed form"
        return closed

    @functools.cached_property
    def trajectory(self) -> Trajectory:
        """Its numerical solution."""
        return path(self.model, self.p)

    @functools.cached_property
    def alpha(self) -> float:
        """The angle of attack [rad]."""
        return float(self.p.alpha)

    @functools.cached_property
    def omega(self) -> float:
        """ω = √(k c/m) [1/s]."""
        return float(self.p.rate)

    @functools.cached_property
    def t_c(self) -> float:
        """The exact time of the end of the cut [s]."""
        return float(self.closed.t_c(self.p))

    @functools.cached_property
    def volume(self) -> float:
        """The exact removed volume [volume]."""
        return float(self.closed.volume(self.p))

    def weighed(self, volume: float) -> Record:
        """A volume per mass of abrasive, in SI units: `specific_volume`, and `erosion_ratio` with a density."""
        return {name: float(value) for name, value in self.per_mass.to_dict(volume, self.p).items()}

    @functools.cached_property
    def ended_by(self) -> str:
        """How the cut ends: "rebound", "stop" or "no-cut"."""
        return str(self.closed.ended_by(self.p))

    @functools.cached_property
    def _results(self) -> dict[tuple[str, str], Future[Any]]:
        """Results that are computed or being computed, by their kind and the model's name."""
        return {}

    def prepare(self, pool: Executor, needs: Iterable[Need]) -> None:
        """Compute in the background the results that questions need, in an order in which each uses only earlier ones.

        Compiling and integrating release the interpreter, so that a second core has work.
        """
        for kind, model in dict.fromkeys(needs):
            self._results[kind, model] = pool.submit(_COMPUTE[kind], self, model)

    def _once(self, kind: str, model: str) -> Any:
        if (kind, model) not in self._results:
            computed = _COMPUTE[kind](self, model)
            self._results[kind, model] = Future()
            self._results[kind, model].set_result(computed)
        return self._results[kind, model].result()

    def optimum(self, model: str) -> Optimum:
        """A model's angle of greatest removal in this case."""
        return self._once("optimum", model)

    def hits(self, model: str) -> Impact:
        """A model's impacts at the `looks`, and after them at the case's own angle."""
        return self._once("hits", model)

    def impact_and_optimum(self, model: str) -> Record:
        """A model's impact at the case's own angle, and its angle of greatest removal, as a row of numbers.json."""
        hits, optimum = self.hits(model), self.optimum(model)
        return {
            "volume": float(hits.volume[-1]),
            "t_c": float(hits.t_c[-1]),
            "ended_by": str(hits.ended_by[-1]),
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "kind": str(optimum.kind),
        }

    def curve(self, model: str, label: str | None = None) -> Curve:
        """A model's V(α) with its maximum, and with gaps at its jumps."""
        optimum = self.optimum(model)
        angles, volume = broken_at(optimum.jumps, self.looks, self.hits(model).volume[:-1])
        best = None if optimum.kind == "none" else (float(optimum.alpha), float(optimum.volume))
        return Curve(label or model, angles, volume, best, bool(optimum.attained))

    def spins(self, model: str) -> Spins:
        """A model's angles of greatest removal over the spin."""
        return self._once("spins", model)

    def families(self, model: str) -> Families:
        """A model with other speeds, erodents, materials and modelling parameters."""
        return self._once("families", model)

    def sensitivity(self, model: str, name: str) -> float:
        """The change of α_max for a change of q by its own size: q dα_max/dq [rad]."""
        return float(self._once("sensitivities", model)[name]) * float(getattr(self.p, name))

    @functools.cached_property
    def looks(self) -> np.ndarray:
        """α in (0, 90°] [rad] for curves of the engine; fewer than `angles`, because each angle is integrated."""
        near_zero, even = [0.02, 0.1, 0.25], np.linspace(0, 90, 181)[1:-1]
        return np.deg2rad([*near_zero, *even, 90 - 1e-7])

    @functools.cached_property
    def cusp(self) -> float:
        """arctan(k/2) [rad]: cuts rebound up to this angle and stop above it."""
        return float(np.arctan(self.p.k / 2))

    @functools.cached_property
    def angles(self) -> np.ndarray:
        """α in (0, 90°] [rad], ascending, closer together where curves bend at the cusp."""
        # The last is short of 90° by less than any curve shows, for at 90° itself nothing is cut.
        even = np.deg2rad(np.append(np.linspace(0, 90, 361)[1:-1], 90 - 1e-7))
        below = self.cusp * np.linspace(0, 1, 101)[1:]
        above = self.cusp + (np.pi / 2 - self.cusp) * np.geomspace(1e-6, 1, 81)[:-1]
        return np.unique(np.concatenate([even, below, above]))

    def over_angles(self) -> Parameters:
        """The case at every one of `angles`."""
        return self.p.replace(alpha=self.angles)


def _hits(case: Case, model: str) -> Impact:
    # To second order, as `alpha_max` computes V: the page's numbers are the same to the bit.
    p = case.p.replace(alpha=np.append(case.looks, case.alpha))
    return impact(model, p, derivatives=2, rtol=_RTOL)


_COMPUTE: Mapping[str, Callable[[Case, str], Any]] = {
    "optimum": lambda case, model: alpha_max(model, case.p),
    "sensitivities": lambda case, model: case.optimum(model).sensitivities,
    "hits": _hits,
    "spins": lambda case, model: over_spins(model, case.p),
    "families": lambda case, model: families_of(model, case.p, case.looks),
}
