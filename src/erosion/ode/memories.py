"""What an event remembers until it happens again: numbers of the state that change with it alone."""

import abc
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.problem import Problem

NEVER = 1e300  # instead of an infinite time


class Memory(abc.ABC):
    """Numbers of the state that change only where an event happens.

    Args:
        event: whose memory it is.
    """

    def __init__(self, event: int) -> None:
        self.event = event

    @abc.abstractmethod
    def first(self, t0: Number) -> list[Scalar]:
        """The numbers where a lane begins."""

    @abc.abstractmethod
    def following(self, numbers: Sequence[Scalar]) -> list[Scalar]:
        """The numbers after the event."""


class Schedule(Memory):
    """The time of the next event, and its place among all times.

    Args:
        event: see `Memory`.
        times: all times.
    """

    def __init__(self, event: int, times: Any) -> None:
        super().__init__(event)
        self.times = times

    def first(self, t0: Number) -> list[Scalar]:
        """See `Memory`: a time at `t0` counts."""
        return self.following([t0, -1.0])

    def following(self, numbers: Sequence[Scalar]) -> list[Scalar]:
        """See `Memory`: of equal times the first comes first."""
        time, place = numbers
        places = np.arange(self.times.size, dtype=float)
        later = (self.times > time) | ((self.times == time) & (places > place))
        following = jnp.min(jnp.where(later, self.times, NEVER))
        is_it = later & (self.times == following)
        place = jnp.min(jnp.where(is_it, places, self.times.size))
        # A sum has derivatives both ways, and those by the one that counts alone; a NaN among the times stays.
        following = jnp.sum(jnp.where(places == place, self.times, 0.0 * self.times))
        return [jnp.where(place < self.times.size, following, NEVER), place]


class Count(Memory):
    """How many times the event has happened.

    Args:
        event: see `Memory`.
        most: the one that ends the motion.
    """

    def __init__(self, event: int, most: int) -> None:
        super().__init__(event)
        self.most = most

    def first(self, t0: Number) -> list[Scalar]:
        """See `Memory`."""
        return [jnp.zeros(())]

    def following(self, numbers: Sequence[Scalar]) -> list[Scalar]:
        """See `Memory`."""
        return [numbers[0] + 1.0]

    def ends(self, numbers: Sequence[Scalar]) -> Flag:
        """Whether the next one ends the motion."""
        return numbers[0] + 1.0 >= self.most


def memories_of(problem: Problem, args: Any) -> list[Memory]:
    """The memories of all events, in their order."""
    memories: list[Memory] = []
    for i, event in enumerate(problem.events.values()):
        if event.times is not None:
            memories.append(Schedule(i, finite_times(event.times_of(args))))
        if event.last > 1:
            memories.append(Count(i, event.last))
    return memories


def finite_times(times: PyTree) -> Any:
    """Times in a row, those that never come finite: their distance would be no number."""
    row = jnp.concatenate([jnp.ravel(jnp.asarray(leaf, float)) for leaf in jax.tree.leaves(times)])
    return jnp.nan_to_num(row, nan=jnp.nan, posinf=NEVER, neginf=-NEVER)
