"""Tangents that do not exist: those that the order of events at one time decides. They are NaN in the state after that.

No step takes NaN. So a segment goes on with zeros in their place, and at its end they are NaN again, with those that
depend on them.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from erosion.ode.event_location import Segment
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.reduction import FlatState
from erosion.ode.variational import EndTimeDependence


class LostTangents:
    """Which tangents of a segment are lost: numbers that are NaN where they are, and else zero.

    Args:
        problem: the equations.
        initial: the state with tangents where the segment begins.

    Attributes:
        any: whether some are lost.
        start: the state where the segment begins, with zeros in their place.
    """

    def __init__(self, problem: LaneEquations, initial: FlatState) -> None:
        self._problem = problem
        values, tangents = initial[: problem.width], initial[problem.width :]
        exist = list(map(jnp.isfinite, tangents))
        self.any = ~functools.reduce(jnp.logical_and, exist)
        self.start: FlatState = [*values, *(jnp.where(*each, 0.0) for each in zip(exist, tangents, strict=True))]
        lost: FlatState = [jnp.where(flag, 0.0, jnp.nan) for flag in exist]
        none = [jnp.zeros(())] * problem.width
        self._at_start, self._later = (
            problem.value_and_tangents([*none, *each]) for each in (lost, self._spread(lost))
        )

    def later(self, along: EndTimeDependence) -> EndTimeDependence:
        """What depends on time within the segment, without them."""
        return along.lacking(self._later)

    def at_end(self, segment: Segment, along: EndTimeDependence) -> tuple[Segment, EndTimeDependence]:
        """A segment, which may have taken no time, and what depends on the time of its end, without them."""
        lost = jax.tree.map(lambda *each: jnp.where(segment.time > 0, *each), self._later, self._at_start)
        state = jax.tree.map(jnp.add, segment.value_and_tangents, lost)
        return segment._replace(value_and_tangents=state, lacks=self.any), along.lacking(lost)

    def _spread(self, tangents: FlatState) -> FlatState:
        """Once the motion has gone on."""
        width = self._problem.width
        members = [tangents[i : i + width] for i in range(0, len(tangents), width)]
        if self._problem.order == 2:
            # The rate of a second derivative depends on all first ones.
            members[-1] = [sum(parts[1:], parts[0]) for parts in zip(*members, strict=True)]
        depends = [np.flatnonzero(row) for row in _depends(self._problem.pattern)]
        return [sum((member[j] for j in row[1:]), member[row[0]]) for member in members for row in depends]


def _depends(pattern: np.ndarray) -> np.ndarray:
    """Which rows depend on which, also by way of others and on themselves."""
    depends = pattern | np.eye(len(pattern), dtype=bool)
    for k in range(len(pattern)):
        depends |= np.outer(depends[:, k], depends[k])
    return depends
