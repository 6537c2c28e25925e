"""What operations of JAX do with large arrays: a rule for each, beside that for small ones."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from erosion.lanes.arrays import ARRAYS, Part, part, whole
from erosion.lanes.graph import DOUBLE, Graph, GraphValue
from erosion.lanes.large import LARGE, Index, Large, large, sums
from erosion.lanes.scalars import Equation, aval_of

_MANY = 512  # products of two small arrays from which on they are taken in loops

Rule = Callable[[Equation, Graph, list[Any]], Part | None]
"""The result of an operation, of which an input is large or which is better taken in loops; None where it is not."""


def of_arrays(equation: Equation, graph: Graph, inputs: list[Part]) -> Sequence[Part]:
    """What an operation of `ARRAYS` gives: in loops where its arrays are large."""
    name, made = equation.primitive.name, None
    worth = _products(equation) >= _MANY if name == "dot_general" else name == "broadcast_in_dim"
    if name in _LARGE and (worth or any(isinstance(given, Large) for given in inputs)):
        made = _LARGE[name](equation, graph, inputs)
    return ARRAYS[name](equation, graph, inputs) if made is None else [made]


def _products(equation: Equation) -> int:
    (contracted, _), _ = equation.params["dimension_numbers"]
    x = aval_of(equation.invars[0])
    return int(np.prod(aval_of(equation.outvars[0]).shape)) * int(np.prod([x.shape[axis] for axis in contracted]))


def _broadcast(equation: Equation, graph: Graph, inputs: list[Any]) -> Part | None:
    shape, dimensions = equation.params["shape"], equation.params["broadcast_dimensions"]
    (given,) = inputs
    if not isinstance(given, Large) and (np.prod(shape, dtype=int) < LARGE or np.size(whole(given)) > 1):
        return None
    array = large(graph, given)
    if array is None:
        return None
    axes = [axis if length == shape[axis] else None for axis, length in zip(dimensions, array.shape, strict=True)]
    return array.moved(shape, axes, [0] * len(axes), [1] * len(axes))


def _reshape(equation: Equation, _: Graph, inputs: list[Any]) -> Part | None:
    return inputs[0].reshaped(aval_of(equation.outvars[0]).shape)


def _transpose(equation: Equation, _: Graph, inputs: list[Any]) -> Part | None:
    array, order = inputs[0], equation.params["permutation"]
    axes = [order.index(axis) for axis in range(len(order))]
    return array.moved([array.shape[axis] for axis in order], axes, [0] * len(axes), [1] * len(axes))


def _slice(equation: Equation, _: Graph, inputs: list[Any]) -> Part | None:
    array, params = inputs[0], equation.params
    axes = range(len(array.shape))
    moved = array.moved(
        aval_of(equation.outvars[0]).shape, list(axes), params["start_indices"], params["strides"] or [1] * len(axes)
    )
    return moved if moved.size >= LARGE else part(moved.apart())


def _reduce_sum(equation: Equation, graph: Graph, inputs: list[Any]) -> Part | None:
    array, axes = inputs[0], equation.params["axes"]
    if array.type != DOUBLE:
        return None
    free = [axis for axis in range(len(array.shape)) if axis not in axes]

    def term(index: Index, along: Index) -> tuple[GraphValue, None]:
        return array.at(_joined(len(array.shape), (free, index), (axes, along))), None

    return sums(graph, [array.shape[axis] for axis in free], [array.shape[axis] for axis in axes], term)


def _dot_general(equation: Equation, graph: Graph, inputs: list[Any]) -> Part | None:
    (left, right), (batch_left, batch_right) = equation.params["dimension_numbers"]
    x, y = (large(graph, whole(given) if isinstance(given, GraphValue) else given) for given in inputs)
    if x is None or y is None or {x.type, y.type} != {DOUBLE}:
        return None
    free_x, free_y = (
        [axis for axis in range(len(array.shape)) if axis not in (*contracted, *batch)]
        for array, contracted, batch in ((x, left, batch_left), (y, right, batch_right))
    )
    # What is read again and again is computed once.
    x, y = (array if not contracted else array.stored() for array, contracted in ((x, left), (y, right)))
    batches = len(batch_left)

    def term(index: Index, along: Index) -> tuple[GraphValue, GraphValue]:
        batch, of_x, of_y = index[:batches], index[batches : batches + len(free_x)], index[batches + len(free_x) :]
        return (
            x.at(_joined(len(x.shape), (batch_left, batch), (free_x, of_x), (left, along))),
            y.at(_joined(len(y.shape), (batch_right, batch), (free_y, of_y), (right, along))),
        )

    shape = aval_of(equation.outvars[0]).shape
    if left:
        return sums(graph, shape, [x.shape[axis] for axis in left], term)
    product = Large(graph, shape, DOUBLE, lambda index: graph.op("fmul", DOUBLE, *term(index, ())))
    product.reads = dict.fromkeys({**x.reads, **y.reads}, False)
    return product if product.size >= LARGE else part(product.apart())


def _joined(ndim: int, *parts: tuple[Sequence[int], Index]) -> list[GraphValue]:
    """An index of which some axes are given here and others there."""
    by_axis = {axis: value for axes, index in parts for axis, value in zip(axes, index, strict=True)}
    return [by_axis[axis] for axis in range(ndim)]


_LARGE: Mapping[str, Rule] = {
    "broadcast_in_dim": _broadcast,
    "dot_general": _dot_general,
    "expand_dims": _reshape,
    "reduce_sum": _reduce_sum,
    "reshape": _reshape,
    "slice": _slice,
    "squeeze": _reshape,
    "transpose": _transpose,
}
"""The rules for large arrays, by the names of operations."""
