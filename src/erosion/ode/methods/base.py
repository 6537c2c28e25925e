"""The interface of a method. It is chosen once, where a program is traced, and costs nothing at run time."""

import abc
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.crossings import Ending
from erosion.ode.cubics import Ends
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import Control
from erosion.ode.variational import EndTimeDependence

if TYPE_CHECKING:
    from erosion.ode.event_location import Lane, Segment
    from erosion.ode.lane_equations import LaneEquations
    from erosion.ode.tape import Entry

APART = 1e-6  # of a row's size is the least size of its derivatives, by a change of a number by its own size
NOISE = 1e-15  # of a row's size: what rounding leaves in its derivatives
LEAST = 1e-8  # of the greatest size that a row has had: a smaller one need not be known relative to itself

_REST, _POWER = 1e-9, 20.0
"""Of the time scale, a step in which a row leaves an exact rest; the power of time as which it may grow at most."""

TIGHTEST = 1e-13  # tolerance of a second integration: rounding is near


class Step(NamedTuple):
    """A trial.

    Args:
        state, slope: at its end.
        stages: what the method has computed on its way; of an explicit one the slopes of each row.
        events: the event functions at its end.
        interior_samples: and at some shares of it.
        error: over the tolerance, as the step control wants it.
    """

    state: FlatState
    slope: FlatState
    stages: Any
    events: list[Ends]
    interior_samples: list[tuple[float, list[Scalar]]]
    error: Scalar


class Reverse(abc.ABC):
    """The steps of a lane, gone back through.

    Args:
        share: a cotangent counts as so much of the greatest effect of a row by its own size, at least.
    """

    share: ClassVar[float]

    @abc.abstractmethod
    def most(self, rtol: Scalar) -> Scalar:
        """By how much a cotangent may err."""

    @abc.abstractmethod
    def flow(self, flat_state: FlatState, before: Callable[[], "Entry"]) -> FlatState:
        """What the state at an event changes by with its time; `before` is the last step."""

    @abc.abstractmethod
    def step(self, row: "Entry") -> "BackStep":
        """A step of the tape."""


class BackStep(NamedTuple):
    """A step that is gone back through.

    Args:
        end: the state there; nothing of a stiff motion.
        slope: the rates where it began.
        back: from cotangents at its end those at its start, what those of the numbers gain, and errors of the former.
    """

    end: FlatState
    slope: FlatState
    back: Callable[[FlatState], tuple[FlatState, list[Number], FlatState]]


class Method(abc.ABC):
    """Steps of a lane's rows.

    Args:
        problem: the equations.
        derivatives: the highest order of derivatives that it computes.
        foresees: whether steps that get shorter may be expected to go on so.
        ending: how a lane's last step is found.
    """

    derivatives: ClassVar[int] = 2
    foresees: ClassVar[bool]
    ending: Ending

    def __init__(self, problem: "LaneEquations") -> None:
        self.problem = problem

    # A trial

    @abc.abstractmethod
    def first_step(self, initial: FlatState, slope: FlatState, scale: Scalar, asked: Scalar) -> Scalar:
        """The length of the first step, where the step control asks for one."""

    @abc.abstractmethod
    def tried(self, lane: "Lane", scale: Scalar, rtol: Scalar) -> Step:
        """A trial; `scale` is the time scale."""

    def sizes(self, before: FlatState, state: FlatState) -> FlatState:
        """The greatest sizes of the rows of the motion itself that the error's measure remembers."""
        return [jnp.maximum(size, jnp.abs(row)) for size, row in zip(before, state[: self.problem.width], strict=False)]

    def sizes_at_start(self, initial: FlatState, before: "Segment | None") -> FlatState:
        """The same where a motion begins, after another one or none."""
        return self.sizes([0.0 * row for row in initial], initial)

    # The end

    def arrives(self, before: Control, after: Control, moved: Flag) -> tuple[Control, Flag]:
        """What is left where a trial ends a lane, and whether the lane moves to its end."""
        return after, moved

    @abc.abstractmethod
    def finish_step(self, lane: "Lane", time_to_end: Scalar | None) -> "tuple[Segment, EndTimeDependence]":
        """The motion to where its last step found its end."""

    def is_known(self, ended: Flag, amplification: Scalar) -> Flag:
        """Whether the time of an end has digits."""
        return ended

    # Between steps

    @abc.abstractmethod
    def interpolate(self, before: "Lane", after: "Lane", rtol: Scalar) -> Callable[[Scalar], EndTimeDependence]:
        """The state at a time within a step."""

    @abc.abstractmethod
    def beyond(self, lane: "Lane", motion: "Segment") -> Callable[[Scalar], EndTimeDependence]:
        """The same between the last step and the end."""

    # Reverse mode

    @abc.abstractmethod
    def reverse(
        self, rate: Callable[[list[Number], FlatState], FlatState], parameters: list[Number], every: Any
    ) -> Reverse:
        """Steps back, for rates as functions of the real numbers; `every` brings these back among the others."""


def leaves_rest(row: tuple[Scalar, Scalar], slopes: tuple[Scalar, Scalar], h: Scalar, scale: Scalar) -> Flag:
    """Whether a row at zero, of rate zero, begins to grow as a power of time in a short step.

    Such a step has the same relative error at any length, which a shorter one does not mend and a longer way forgets.
    A row that grows faster than a power is stiff.

    Args:
        row: before and after the step.
        slopes: there.
        h: its length.
        scale: the time scale of the problem.
    """
    rests = (row[0] == 0) & (slopes[0] == 0) & (h < _REST * scale)
    return rests & (jnp.abs(h * slopes[1]) <= _POWER * jnp.abs(row[1]))


def sizes_or_least(sizes: Sequence[float], greatest: FlatState) -> list[Scalar]:
    """Sizes of rows below which these need not be known: as given, or of their greatest so far."""
    found: list[Scalar] = [np.float64(size) for size in sizes]
    for i, size in enumerate(greatest):
        found[i] = jnp.maximum(found[i], LEAST * size)
    return found
