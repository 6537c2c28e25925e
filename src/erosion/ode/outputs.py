"""What is wanted of a lane's end: integrals alone, as of an impact, or its whole state at a time on a clock."""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import jax.numpy as jnp

from erosion.arguments import Flag, Scalar


@dataclasses.dataclass(frozen=True)
class LaneOutputs(abc.ABC):
    """What is wanted of a lane's end. It is chosen with the program, and costs nothing at run time.

    Attributes:
        are_clocked: whether a lane has the numbers of `Clock` beside its arguments.
        check_derivatives: whether errors of derivatives count where two integrations are compared.
    """

    are_clocked: ClassVar[bool]
    check_derivatives: ClassVar[bool]

    @abc.abstractmethod
    def of(self, state: Callable[[], Sequence[Any]], integrals: Sequence[Any]) -> list[Any]:
        """The numbers that are wanted, from the elements of the state and the integrals."""

    @abc.abstractmethod
    def of_events(self, count: Any, at_once: Sequence[Any], reached: Any) -> tuple[Any, Sequence[Any], Any]:
        """How many events there were, of each whether it happens at the end, and when that is; None if not wanted."""

    @abc.abstractmethod
    def keeps_values(self, finite: Flag, unfinished: Flag) -> Flag:
        """Whether a lane's values are given, and are not NaN: those that are finite, or what it has reached."""

    @abc.abstractmethod
    def after_many_steps(self, factor: Scalar, smaller: float, greater: Scalar) -> Scalar:
        """By how much the tolerance of a second integration is smaller or greater after many steps.

        Args:
            factor: after few steps; 1 where no other integration is needed.
            smaller: a factor at which the errors of many steps are small.
            greater: a factor of a cheap integration, which tells whether errors grow.
        """


class IntegralOutputs(LaneOutputs):
    """Integrals from the start to the first event, and its time."""

    are_clocked = check_derivatives = False

    def of(self, state: Callable[[], Sequence[Any]], integrals: Sequence[Any]) -> list[Any]:
        """See `LaneOutputs`."""
        return list(integrals)

    def of_events(self, count: Any, at_once: Sequence[Any], reached: Any) -> tuple[Any, Sequence[Any], Any]:
        """See `LaneOutputs`."""
        return None, [], None

    def keeps_values(self, finite: Flag, unfinished: Flag) -> Flag:
        """See `LaneOutputs`."""
        return finite

    def after_many_steps(self, factor: Scalar, smaller: float, greater: Scalar) -> Scalar:
        """See `LaneOutputs`."""
        return jnp.minimum(factor, smaller)


class StateOutputs(LaneOutputs):
    """State and integrals where the lane ends, by an event or at `t1`."""

    are_clocked = check_derivatives = True

    def of(self, state: Callable[[], Sequence[Any]], integrals: Sequence[Any]) -> list[Any]:
        """See `LaneOutputs`."""
        return [*state(), *integrals]

    def of_events(self, count: Any, at_once: Sequence[Any], reached: Any) -> tuple[Any, Sequence[Any], Any]:
        """See `LaneOutputs`."""
        return count, at_once, reached

    def keeps_values(self, finite: Flag, unfinished: Flag) -> Flag:
        """See `LaneOutputs`."""
        return finite | unfinished

    def after_many_steps(self, factor: Scalar, smaller: float, greater: Scalar) -> Scalar:
        """See `LaneOutputs`: most motions forget their errors."""
        return jnp.where(factor < 1, jnp.minimum(factor, smaller), greater)
