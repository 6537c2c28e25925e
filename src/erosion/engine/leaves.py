"""Case and model as plain numbers, which may differ from impact to impact, and the rest, which all share.

The numbers are the parameters of the case, then those leaves of the model that are floats, whole
numbers or arrays. Everything else in a model (functions, strings) is part of the program.
"""

import functools
import math
from collections.abc import Sequence
from typing import TypeGuard

import jax
import numpy as np
from jax import Array
from jax.core import Tracer

from erosion.array_types import Indices, Number, PerImpact, PerLane, Structure
from erosion.models.base import CuttingModel, units_within
from erosion.models.own_parameters import own_parameters
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.parameters.units import System

_NAMES = tuple(QUANTITIES)


def is_number(leaf: object) -> TypeGuard[Number]:
    """Whether a leaf is a number or an array of numbers."""
    if isinstance(leaf, (float, int)):
        return True
    return isinstance(leaf, (np.ndarray, np.generic, jax.Array, Tracer)) and np.dtype(leaf.dtype).kind in "fiub"


def numbers_of(model: CuttingModel, p: Parameters) -> list[Number]:
    """The numbers, in their order."""
    return [*(getattr(p, name) for name in _NAMES), *filter(is_number, jax.tree.leaves(model))]


class Layout:
    """The shapes and types of the numbers, and everything else of the model. Equal layouts share a program.

    Args:
        structure: of the model.
        leaves: the model's leaves that are no numbers; `None` in the place of a number.
        shapes: of each number, for one impact.
        dtypes: of each number.
        units: the unit system that the model's methods see; any, but for a model with numbers in fixed units.
    """

    def __init__(
        self,
        structure: Structure,
        leaves: tuple[object, ...],
        shapes: tuple[tuple[int, ...], ...],
        dtypes: tuple[str, ...],
        units: System,
    ) -> None:
        self.structure, self.leaves, self.shapes, self.dtypes, self.units = structure, leaves, shapes, dtypes, units

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self._key == other._key

    def __hash__(self) -> int:
        # Without the structure, whose hash is slow, and the functions, of which some have none.
        return hash((self.shapes, self.dtypes))

    @property
    def _key(self) -> tuple[object, ...]:
        return self.structure, self.leaves, self.shapes, self.dtypes, self.units

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
    leaves, structure = jax.tree.flatten(model)
    own = {parameter.leaf for parameter in own_parameters(model).values()} if leaves else ()
    fields = vars(p)
    numbers = [_array(fields[name]) for name in _NAMES]
    rest: list[object] = []
    shapes: list[tuple[int, ...]] = [()] * len(_NAMES)
    dtypes = ["float64"] * len(_NAMES)
    for i, leaf in enumerate(leaves):
        if not is_number(leaf):
            rest.append(leaf)
            continue
        array = _array(leaf)
        rest.append(None)
        numbers.append(array)
        # A whole number in a parameter's place is a number like others.
        dtypes.append("float64" if i in own or array.dtype.kind == "f" else array.dtype.name)
        shapes.append(() if i in own else array.shape)
    return Layout(structure, tuple(rest), tuple(shapes), tuple(dtypes), units_within(model, p)), numbers


def element_of(model: CuttingModel, name: str) -> int:
    """The place of a parameter among the elements of all numbers."""
    if name in QUANTITIES:
        return _NAMES.index(name)
    own = own_parameters(model)
    scalars = {parameter.leaf for parameter in own.values()}
    before = jax.tree.leaves(model)[: own[name].leaf]
    return len(_NAMES) + sum(1 if i in scalars else np.size(leaf) for i, leaf in enumerate(before) if is_number(leaf))
