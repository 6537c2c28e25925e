"""Small arrays of one lane: numpy arrays of a graph's values, element by element."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jax.typing import ArrayLike, DTypeLike

from erosion.lanes.graph import BOOL, CannotCompileError, Graph, GraphValue
from erosion.lanes.large import Large, array_of, large
from erosion.lanes.scalars import SCALARS, Equation, Kind, Params, Rule, aval_of, converted, type_of

Elements = Any
"""An array of values. numpy's types do not say that an index gives one element of it."""

Part = GraphValue | np.ndarray | Large
"""A scalar, or an array of values, or a large array."""

Work = Callable[[Graph, list[Elements]], Sequence[Part]]
"""Computes an equation's outputs from its inputs, scalars and arrays."""


def whole(part: Part) -> Elements:
    """An array of values, of no dimension for a scalar."""
    if isinstance(part, np.ndarray):
        return part
    if isinstance(part, Large):
        return part.apart()
    array = np.empty((), object)
    array[()] = part
    return array


def part(array: np.ndarray) -> Part:
    """The scalar in an array of no dimension; else the array."""
    return array if array.shape else array[()]


def constant(graph: Graph, number: ArrayLike, dtype: DTypeLike) -> Part:
    """A number, or an array of them."""
    type_, numbers = type_of(dtype), np.asarray(number)
    return part(array_of(numbers.shape, lambda index: graph.constant(numbers[index].item(), type_)))


def of_each(function: Callable[..., GraphValue], *arrays: Elements) -> Elements:
    """What a function of scalars makes of each element of arrays, which broadcast."""
    spread = np.broadcast_arrays(*arrays)
    return array_of(spread[0].shape, lambda index: function(*(array[index] for array in spread)))


def elementwise(rule: Rule, equation: Equation, *, stored: bool = False) -> Work:
    """A rule of scalars for every element; large arrays of results that are dear to compute are `stored`."""
    kind, shape = kind_of(equation), aval_of(equation.outvars[0]).shape
    if shape == ():
        return lambda graph, inputs: [rule(graph, kind, *inputs)]

    def in_loops(graph: Graph, inputs: list[Part]) -> Large | None:
        arrays = [large(graph, given) for given in inputs]
        if any(array is None for array in arrays):
            return None
        # An axis of length one goes with any other.
        known = [_spread(array, shape) for array in arrays if array is not None]

        def at(index: Sequence[GraphValue]) -> GraphValue:
            return rule(graph, kind, *(array.at(index if array.shape else ()) for array in known))

        reads = [item for array in known for item in array.reads.items()]
        both = {carried: all(same for other, same in reads if other is carried) for carried, _ in reads}
        made = Large(graph, shape, type_of(kind.output), at, both)
        return made.stored() if stored else made

    def work(graph: Graph, inputs: list[Part]) -> list[Part]:
        if any(isinstance(given, Large) for given in inputs):
            computed = in_loops(graph, inputs)
            if computed is not None:
                return [computed]
        return [of_each(functools.partial(rule, graph, kind), *map(whole, inputs))]

    return work


def _spread(array: Large, shape: Sequence[int]) -> Large:
    """The array as one of this shape, or a number as it is."""
    if array.shape in ((), tuple(shape)):
        return array
    axes = [axis if length > 1 else None for axis, length in enumerate(array.shape)]
    return array.moved(shape, axes, [0] * len(axes), [1] * len(axes))


def kind_of(equation: Equation) -> Kind:
    """What a rule needs to know about an equation."""
    inputs = tuple(np.dtype(aval_of(atom).dtype) for atom in equation.invars)
    return Kind(equation.params, inputs, np.dtype(aval_of(equation.outvars[0]).dtype))


ArrayRule = Callable[[Equation, Graph, list[Part]], Sequence[Part]]
"""Gives an equation's outputs from its inputs, scalars and arrays."""


def _moved(move: Callable[..., np.ndarray]) -> ArrayRule:
    """An operation that only moves elements: `move` takes the equation's parameters and its inputs, as arrays."""
    return lambda equation, _, inputs: [part(move(equation.params, *map(whole, inputs)))]


def _broadcast(params: Params, x: np.ndarray) -> np.ndarray:
    shape, dimensions = params["shape"], params["broadcast_dimensions"]
    lengths = [1] * len(shape)
    for axis, dimension in enumerate(dimensions):
        lengths[dimension] = x.shape[axis]
    return np.broadcast_to(x.reshape(lengths), shape)


def _slice(params: Params, x: np.ndarray) -> np.ndarray:
    strides = params["strides"] or (1,) * x.ndim
    return x[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]


def _pad(params: Params, x: np.ndarray, padding: np.ndarray) -> np.ndarray:
    config = params["padding_config"]
    shape = [low + high + n + max(n - 1, 0) * between for n, (low, high, between) in zip(x.shape, config, strict=True)]
    made = np.full(shape, padding[()], object)
    for index in np.ndindex(x.shape):
        place = tuple(low + i * (between + 1) for i, (low, _, between) in zip(index, config, strict=True))
        if all(0 <= i < n for i, n in zip(place, shape, strict=True)):
            made[place] = x[index]
    return made


def _split(equation: Equation, _: Graph, inputs: list[Part]) -> list[Part]:
    ends = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(whole(inputs[0]), ends, axis=equation.params["axis"]))


def _iota(equation: Equation, graph: Graph, _: list[Part]) -> list[Part]:
    aval = aval_of(equation.outvars[0])
    return [constant(graph, np.indices(aval.shape)[equation.params["dimension"]], aval.dtype)]


def _reduction(name: str) -> ArrayRule:
    """The elements along some axes as one, by a rule of scalars."""

    def reduced(equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
        axes = equation.params["axes"]
        array = np.moveaxis(whole(inputs[0]), axes, range(len(axes)))
        rows = array.reshape(-1, *array.shape[len(axes) :])
        if not len(rows):
            raise CannotCompileError(f"`{equation.primitive.name}` of an empty array")
        rule = functools.partial(SCALARS[name], graph, kind_of(equation))
        return [part(functools.reduce(functools.partial(of_each, rule), rows[1:], whole(rows[0])))]

    return reduced


def _cumulative(name: str) -> ArrayRule:
    """The same along an axis, element by element."""

    def accumulated(equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
        axis, array = equation.params["axis"], whole(inputs[0])
        rule = np.frompyfunc(functools.partial(SCALARS[name], graph, kind_of(equation)), 2, 1)
        if equation.params["reverse"]:
            return [np.flip(rule.accumulate(np.flip(array, axis), axis), axis)]
        return [rule.accumulate(array, axis)]

    return accumulated


def _index_of_extreme(equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
    """The index of the first largest (or smallest) element. A NaN comes before every number, as in numpy."""
    (axis,), kind = equation.params["axes"], kind_of(equation)
    better = SCALARS["gt" if equation.primitive.name == "argmax" else "lt"]
    rows, type_ = np.moveaxis(whole(inputs[0]), axis, 0), type_of(equation.params["index_dtype"])

    def first_best(index: tuple[int, ...]) -> GraphValue:
        best, where = rows[(0, *index)], graph.constant(0, type_)
        for i in range(1, len(rows)):
            other = rows[(i, *index)]
            take = better(graph, kind, other, best)
            if kind.inputs[0].kind == "f":
                is_nan, was_nan = (graph.compare("fcmp uno", value, value) for value in (other, best))
                either = graph.op("or", BOOL, take, is_nan)
                take = graph.op("and", BOOL, either, SCALARS["not"](graph, kind, was_nan))
            best = graph.select(take, other, best)
            where = graph.select(take, graph.constant(i, type_), where)
        return where

    return [part(array_of(rows.shape[1:], first_best))]


def _dot_general(equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
    kind, sides = kind_of(equation), []
    for given, dtype, contracted, batch in zip(inputs, kind.inputs, *equation.params["dimension_numbers"], strict=True):
        # Elements of the output's type, in the shape (batch, free, contracted).
        array = of_each(lambda value, dtype=dtype: converted(graph, value, dtype, kind.output), whole(given))
        free = [axis for axis in range(array.ndim) if axis not in (*contracted, *batch)]
        lengths = [math.prod(array.shape[axis] for axis in axes) for axes in (batch, free, contracted)]
        sides.append(array.transpose(*batch, *free, *contracted).reshape(lengths))
    x, y = sides
    product, total = (
        functools.partial(of_each, functools.partial(SCALARS[name], graph, kind)) for name in ("mul", "add")
    )
    terms = np.moveaxis(product(x[:, :, None], y[:, None]), -1, 0)
    zeros = constant(graph, np.zeros(terms.shape[1:]), kind.output)
    made = whole(functools.reduce(total, terms[1:], terms[0]) if len(terms) else zeros)
    return [part(made.reshape(aval_of(equation.outvars[0]).shape))]


ARRAYS: Mapping[str, ArrayRule] = {
    "argmax": _index_of_extreme,
    "argmin": _index_of_extreme,
    "broadcast_in_dim": _moved(_broadcast),
    "concatenate": _moved(lambda params, *arrays: np.concatenate(arrays, axis=params["dimension"])),
    "cummax": _cumulative("max"),
    "cummin": _cumulative("min"),
    "cumprod": _cumulative("mul"),
    "cumsum": _cumulative("add"),
    "dot_general": _dot_general,
    "expand_dims": _moved(lambda params, x: np.expand_dims(x, params["dimensions"])),
    "iota": _iota,
    "pad": _moved(_pad),
    "reduce_and": _reduction("and"),
    "reduce_max": _reduction("max"),
    "reduce_min": _reduction("min"),
    "reduce_or": _reduction("or"),
    "reduce_prod": _reduction("mul"),
    "reduce_sum": _reduction("add"),
    "reshape": _moved(lambda params, x: x.reshape(params["new_sizes"])),
    "rev": _moved(lambda params, x: np.flip(x, params["dimensions"])),
    "slice": _moved(_slice),
    "split": _split,
    "stack": _moved(lambda params, *arrays: np.stack(arrays, axis=params["axis"])),
    "squeeze": _moved(lambda params, x: np.squeeze(x, params["dimensions"])),
    "tile": _moved(lambda params, x: np.tile(x, params["reps"])),
    "transpose": _moved(lambda params, x: x.transpose(params["permutation"])),
    "unstack": lambda equation, _, inputs: list(np.moveaxis(whole(inputs[0]), equation.params["axis"], 0)),
}
"""The rule of each primitive of arrays, by its name."""
