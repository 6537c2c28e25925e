"""What a question is given and what it answers with."""

import functools
import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from erosion.model import ClosedForm
from erosion.models import Linearized
from erosion.parameters import Parameters
from erosion.trajectory import Trajectory, TurnWarning, simulate
from erosion.units import System


class Illustration(NamedTuple):
    """A figure of the report.

    Args:
        name: of its files, without suffix.
        figure: what to draw.
        caption: HTML below it.
        description: plain text for those who cannot see it.
    """

    name: str
    figure: Figure
    caption: Markup
    description: str


@dataclass(frozen=True)
class Answer:
    """The answer to one question.

    Args:
        key: "q1", as in `only` and in numbers.json.
        title: the question in a few words.
        sentence: the answer in one sentence (HTML).
        figures: what shows it.
        derivation: why it is so (HTML).
        numbers: everything computed, by name, for numbers.json.
    """

    key: str
    title: str
    sentence: Markup
    figures: tuple[Illustration, ...]
    derivation: Markup
    numbers: dict[str, Any] = field(default_factory=dict)


def question(key: str) -> str:
    """What the scenario calls it: "q4" is Question 4, "a2" is Additional question 2."""
    return f"{'Additional question' if key[0] == 'a' else 'Question'} {key[1:]}"


@dataclass(frozen=True)
class Case:
    """One set of parameters, with what several questions need computed once.

    Questions 1 to 8 are asked of the linearized model, whose solution is known exactly.
    """

    p: Parameters
    name: str

    @property
    def units(self) -> System:
        """The unit system of every number."""
        return self.p.units

    @functools.cached_property
    def model(self) -> Linearized:
        """The model that the questions are asked of."""
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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TurnWarning)  # the page says it in words
            return simulate(self.model, self.p)

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
        """When the cut ends, exactly [s]."""
        return float(self.closed.t_c(self.p))

    @functools.cached_property
    def volume(self) -> float:
        """The volume removed, exactly."""
        return float(self.closed.volume(self.p))

    @functools.cached_property
    def ended_by(self) -> str:
        """How the cut ends: "rebound", "stop" or "no-cut"."""
        return str(self.closed.ended_by(self.p))

    @functools.cached_property
    def cusp(self) -> float:
        """arctan(k/2) [rad]: cuts rebound up to this angle and stop above it."""
        return float(np.arctan(self.p.k / 2))

    @functools.cached_property
    def angles(self) -> np.ndarray:
        """α in (0, 90°] [rad], ascending, close together where curves bend at the cusp."""
        # The last is short of 90° by less than any curve shows, for at 90° itself nothing is cut.
        even = np.deg2rad(np.append(np.linspace(0, 90, 361)[1:-1], 90 - 1e-7))
        below = self.cusp * np.linspace(0, 1, 101)[1:]
        above = self.cusp + (np.pi / 2 - self.cusp) * np.geomspace(1e-6, 1, 81)[:-1]
        return np.unique(np.concatenate([even, below, above]))

    def over_angles(self) -> Parameters:
        """The case at every one of `angles`."""
        return self.p.replace(alpha=self.angles)
