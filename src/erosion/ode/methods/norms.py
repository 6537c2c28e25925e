"""By what sizes the errors of a step's rows count: for integrals alone, or for the whole state."""

import abc
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp

from erosion.arguments import Scalar
from erosion.ode.methods.base import APART, NOISE, leaves_rest
from erosion.ode.outputs import IntegralOutputs, LaneOutputs, StateOutputs
from erosion.ode.reduction import FlatState

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations


class Norm(abc.ABC):
    """The sizes by which errors are measured.

    Args:
        problem: the equations.

    Attributes:
        remembers: whether the greatest size that a row has had counts. Where nothing but integrals is wanted, their
            sizes are those that they have.
        late: the place of a late slope among those of a step. A step far too long may end in a slope that is far
            greater than all within it, which the estimate knows.
    """

    remembers: ClassVar[bool]
    late: ClassVar[int]

    def __init__(self, problem: "LaneEquations") -> None:
        self.problem = problem

    @abc.abstractmethod
    def slack(self, of_integral: float, of_state: tuple[float, float, float]) -> float:
        """The tolerances that the embedded estimate may be."""

    def of_tangent(self, sizes: list[Scalar], of_motion: list[Scalar], rtol: Scalar) -> list[Scalar]:
        """The least sizes of the derivatives of rows, from those of the rows before them."""
        return sizes

    def measures(
        self, sizes: list[Scalar], states: Sequence[FlatState], stages: Sequence[FlatState], h: Scalar
    ) -> list[Scalar]:
        """The sizes that a step's errors are compared with."""
        return list(sizes)

    @property
    @abc.abstractmethod
    def checked(self) -> range:
        """The rows for which a second estimate counts.

        The estimate of what is wanted is mostly the largest by far. Where it passes through zero by chance it hides an
        error, but a second estimate is not zero at the same place.
        """


class _IntegralNorm(Norm):
    remembers, late = False, -1

    def slack(self, of_integral: float, of_state: tuple[float, float, float]) -> float:
        """See `Norm`."""
        return of_integral

    @property
    def checked(self) -> range:
        """See `Norm`."""
        return range(self.problem.width - self.problem.integrals, self.problem.width)


class _StateNorm(Norm):
    remembers, late = True, -2

    def slack(self, of_integral: float, of_state: tuple[float, float, float]) -> float:
        """See `Norm`."""
        return of_state[self.problem.order]

    def of_tangent(self, sizes: list[Scalar], of_motion: list[Scalar], rtol: Scalar) -> list[Scalar]:
        """See `Norm`: a number may matter far less than by its own size, and its derivatives are wanted too."""
        if self.problem.signature.problem.parameter_scale is not None:
            return sizes
        return [jnp.maximum(APART, NOISE / rtol) * size for size in of_motion]

    def measures(
        self, sizes: list[Scalar], states: Sequence[FlatState], stages: Sequence[FlatState], h: Scalar
    ) -> list[Scalar]:
        """See `Norm`."""
        if self.problem.nonsmooth:
            return list(sizes)
        ends = zip(sizes, *states, stages, strict=True)
        return [
            jnp.where(leaves_rest((before, after), (ks[0], ks[-1]), h, self.problem.time_scale), jnp.inf, size)
            for size, before, after, ks in ends
        ]

    @property
    def checked(self) -> range:
        """See `Norm`."""
        return range(self.problem.width)


NORMS: Mapping[type[LaneOutputs], type[Norm]] = {IntegralOutputs: _IntegralNorm, StateOutputs: _StateNorm}
