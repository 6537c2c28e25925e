"""Case and model as plain numbers, which may differ from impact to impact, and the rest, which all share.

The numbers are the parameters of the case, then those leaves of the model that are floats, whole
numbers or arrays. Everything else in a model (functions, strings) is part of the program.
"""

import functools
import math
from collections.abc import Sequence

import jax
import numpy as np
from jax import Array
from jax.core import Tracer

from erosion.array_types import Indices, Number, PerImpact, PerLane, Structure
from erosion.models.base import CuttingModel, units_within
from erosion.models.equations import Equations, equations_of
from erosion.models.own_parameters import is_number, own_parameters
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.parameters.units import System

_NAMES = tuple(QUANTITIES)


def numbers_of(model: CuttingModel, p: Parameters) -> list[Number]:
    """The numbers, in their order."""
    return [*(getattr(p, name) for name in _NAMES), *filter(is_number, jax.tree.leaves(model))]


class Layout:
    """What programs need to know of a model beside its numbers. Equal layouts share a program.

    Layouts are equal where the models compute the same from numbers of the same shapes, however they are written.

    Args:
        structure: of the model.
        leaves: the model's leaves that are no numbers; `None` in the place of a number.
        shapes: of each number, for one impact.
        dtypes: of each number.
        units: the unit system that the model's methods see; any, but for a model with numbers in fixed units.
        equations: of the model.
    """

    units: System

    def __init__(
        self,
        structure: Structure,
        leaves: tuple[object, ...],
        shapes: tuple[tuple[int, ...], ...],
        dtypes: tuple[str, ...],
        units: System,
        equations: Equations,
    ) -> None:
        self.structure, self.leaves, self.shapes, self.dtypes, self.units = structure, leaves, shapes, dtypes, units
        self.equations = equations
        self._key = equations.digest, shapes, dtypes, units

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def renewed(self) -> "Layout":
        """The layout of the same model as its code is now; a program of JAX may keep a layout for long."""
        if self.equations.surroundings.unchanged():
            return self
        model, _ = self.joined([np.zeros(struct.shape, struct.dtype) for struct in self.structs()])
        equations = equations_of(model, self.units)
        return Layout(self.structure, self.leaves, self.shapes, self.dtypes, self.units, equations)

    @functools.cached_property
    def offsets(self) -> list[int]:
        """The place of each number's first element among the elements of all numbers; last, how many there are."""
        return [0, *np.cumsum([math.prod(shape) for shape in self.shapes]).tolist()]

    def joined(self, numbers: Sequence[Number]) -> tuple[CuttingModel, Parameters]:
        """Model and case with these numbers."""
        rest = iter(numbers[len(_NAMES) :])
        leaves = [next(rest) if leaf is None else leaf for leaf in self.leaves]
        p = Parameters(**dict(zip(_NAMES, numbers, strict=False)), units=self.units)
        return jax.tree.unflatten(self.structure, leaves), p

    def of_lanes(self, numbers: Sequence[PerLane], lanes: Indices | slice) -> list[PerLane]:
        """The numbers of some lanes, given by indices or a slice; those that all lanes share stay as they are."""
        return [
            number[lanes] if number.ndim > len(shape) else number
            for number, shape in zip(numbers, self.shapes, strict=True)
        ]

    def structs(self) -> list[jax.ShapeDtypeStruct]:
        """Shape and type of one impact's numbers."""
        return [jax.ShapeDtypeStruct(*struct) for struct in zip(self.shapes, self.dtypes, strict=True)]


def _array(leaf: Number) -> Array | np.ndarray:
    """As a numpy array, unless JAX is tracing it."""
    return leaf if isinstance(leaf, Tracer) else np.asarray(leaf)


def split(model: CuttingModel, p: Parameters) -> tuple[Layout, list[PerImpact]]:
    """Layout and numbers of many impacts.

    The parameters of the case and the model's own may be arrays, with one number for each impact.
    Any other array is part of the model, the same for all impacts.
    """
    units = units_within(model, p)
    equations = equations_of(model, units)
    leaves, structure = jax.tree.flatten(model)
    fields = vars(p)
    numbers = [_array(fields[name]) for name in _NAMES]
    numbers += [_array(leaf) for leaf in leaves if is_number(leaf)]
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    shapes = (((),) * len(_NAMES)) + tuple(number.shape for number in equations.numbers)
    dtypes = ("float64",) * len(_NAMES) + tuple(number.dtype.name for number in equations.numbers)
    return Layout(structure, rest, shapes, dtypes, units, equations), numbers


def element_of(model: CuttingModel, name: str) -> int:
    """The place of a parameter among the elements of all numbers."""
    if name in QUANTITIES:
        return _NAMES.index(name)
    own = own_parameters(model)
    scalars = {parameter.leaf for parameter in own.values()}
    before = jax.tree.leaves(model)[: own[name].leaf]
    return len(_NAMES) + sum(1 if i in scalars else np.size(leaf) for i, leaf in enumerate(before) if is_number(leaf))
