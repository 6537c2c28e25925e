"""Small arrays of one lane: numpy arrays of a graph's values, element by element."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jax.typing import ArrayLike, DTypeLike

from erosion.lanes.graph import BOOL, CannotCompileError, Graph, Value
from erosion.lanes.large import Large, large
from erosion.lanes.scalars import SCALARS, Equation, Kind, Params, Rule, aval_of, converted, type_of

Elements = Any
"""An array of values. numpy's types do not say that an index gives one element of it."""

Part = Value | np.ndarray | Large
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
    type_ = type_of(dtype)
    numbers = np.asarray(number)
    made = np.empty(numbers.shape, object)
    for index in np.ndindex(numbers.shape):
        made[index] = graph.constant(numbers[index].item(), type_)
    return part(made)


def elementwise(rule: Rule, equation: Equation, *, stored: bool = False) -> Work:
    """A rule of scalars for every element; large arrays of results that are dear to compute are `stored`."""
    kind, shape = kind_of(equation), aval_of(equation.outvars[0]).shape
    if shape == ():
        return lambda graph, inputs: [rule(graph, kind, *inputs)]

    def in_loops(graph: Graph, inputs: list[Part]) -> Large | None:
        arrays = [large(graph, given) for given in inputs]
        if any(array is None for array in arrays):
            return None
        known = [array for array in arrays if array is not None]

        def at(index: Sequence[Value]) -> Value:
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
        made = np.empty(shape, object)
        arrays = [np.broadcast_to(whole(given), shape) for given in inputs]
        for index in np.ndindex(shape):
            made[index] = rule(graph, kind, *(array[index] for array in arrays))
        return [made]

    return work


def kind_of(equation: Equation) -> Kind:
    """What a rule needs to know about an equation."""
    inputs = tuple(np.dtype(aval_of(atom).dtype) for atom in equation.invars)
    return Kind(equation.params, inputs, np.dtype(aval_of(equation.outvars[0]).dtype))


def _moved(move: Callable[..., np.ndarray]) -> Callable[[Equation], Work]:
    """An operation that only moves elements: `move` takes the equation's parameters and its inputs, as arrays."""
    return lambda equation: lambda _, inputs: [part(move(equation.params, *map(whole, inputs)))]


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


def _split(equation: Equation) -> Work:
    ends = np.cumsum(equation.params["sizes"])[:-1]
    return lambda _, inputs: list(np.split(whole(inputs[0]), ends, axis=equation.params["axis"]))


def _unstack(equation: Equation) -> Work:
    return lambda _, inputs: list(np.moveaxis(whole(inputs[0]), equation.params["axis"], 0))


def _iota(equation: Equation) -> Work:
    aval, dimension = aval_of(equation.outvars[0]), equation.params["dimension"]
    numbers = np.broadcast_to(
        np.arange(aval.shape[dimension]).reshape([-1] + [1] * (aval.ndim - 1 - dimension)), aval.shape
    )
    return lambda graph, _: [constant(graph, numbers, aval.dtype)]


def _reduction(name: str) -> Callable[[Equation], Work]:
    rule = SCALARS[name]

    def of(equation: Equation) -> Work:
        axes, kind = equation.params["axes"], kind_of(equation)

        def work(graph: Graph, inputs: list[Part]) -> list[Part]:
            array = np.moveaxis(whole(inputs[0]), axes, range(len(axes)))
            rest = array.shape[len(axes) :]
            rows = array.reshape(-1, *rest)
            if not len(rows):
                raise CannotCompileError(f"`{equation.primitive.name}` of an empty array")
            made = np.empty(rest, object)
            for index in np.ndindex(rest):
                total, *others = rows[(slice(None), *index)]
                for other in others:
                    total = rule(graph, kind, total, other)
                made[index] = total
            return [part(made)]

        return work

    return of


def _cumulative(name: str) -> Callable[[Equation], Work]:
    rule = SCALARS[name]

    def of(equation: Equation) -> Work:
        axis, reverse, kind = equation.params["axis"], equation.params["reverse"], kind_of(equation)

        def work(graph: Graph, inputs: list[np.ndarray]) -> list[Part]:
            rows = np.moveaxis(whole(inputs[0]), axis, 0)
            made = np.array(rows[::-1] if reverse else rows, object)
            for i in range(1, len(made)):
                for index in np.ndindex(made.shape[1:]):
                    made[(i, *index)] = rule(graph, kind, made[(i - 1, *index)], made[(i, *index)])
            return [np.moveaxis(made[::-1] if reverse else made, 0, axis)]

        return work

    return of


def _index_of_extreme(name: str) -> Callable[[Equation], Work]:
    """The index of the first largest (or smallest) element. A NaN comes before every number, as in numpy."""
    better = SCALARS["gt" if name == "argmax" else "lt"]

    def of(equation: Equation) -> Work:
        (axis,), kind = equation.params["axes"], kind_of(equation)
        type_ = type_of(equation.params["index_dtype"])

        def work(graph: Graph, inputs: list[np.ndarray]) -> list[Part]:
            rows = np.moveaxis(whole(inputs[0]), axis, 0)
            made = np.empty(rows.shape[1:], object)
            for index in np.ndindex(made.shape):
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
                made[index] = where
            return [part(made)]

        return work

    return of


def _dot_general(equation: Equation) -> Work:
    (left, right), (batch_left, batch_right) = equation.params["dimension_numbers"]
    kind = kind_of(equation)
    product, total = SCALARS["mul"], SCALARS["add"]

    def folded(
        graph: Graph, array: Elements, dtype: np.dtype, contracted: Sequence[int], batch: Sequence[int]
    ) -> Elements:
        """The array with elements of the output's type, reshaped to (batch, free, contracted)."""
        free = [axis for axis in range(array.ndim) if axis not in (*contracted, *batch)]
        lengths = [math.prod(array.shape[axis] for axis in axes) for axes in (batch, free, contracted)]
        elements = np.empty(array.shape, object)
        for index in np.ndindex(array.shape):
            elements[index] = converted(graph, array[index], dtype, kind.output)
        return elements.transpose(*batch, *free, *contracted).reshape(lengths)

    def work(graph: Graph, inputs: list[Part]) -> list[Part]:
        x = folded(graph, whole(inputs[0]), kind.inputs[0], left, batch_left)
        y = folded(graph, whole(inputs[1]), kind.inputs[1], right, batch_right)
        made = np.empty((len(x), x.shape[1], y.shape[1]), object)
        for b, i, j in np.ndindex(made.shape):
            terms = [product(graph, kind, u, v) for u, v in zip(x[b, i], y[b, j], strict=True)]
            value = terms[0] if terms else graph.constant(0, type_of(kind.output))
            for term in terms[1:]:
                value = total(graph, kind, value, term)
            made[b, i, j] = value
        return [part(made.reshape(aval_of(equation.outvars[0]).shape))]

    return work


ARRAYS: Mapping[str, Callable[[Equation], Work]] = {
    "argmax": _index_of_extreme("argmax"),
    "argmin": _index_of_extreme("argmin"),
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
    "unstack": _unstack,
}
"""What computes each primitive of arrays, by its name."""
