"""Passes over a complete graph of scalars, and elements of small arrays at places that lanes compute."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np
from jax.extend.core import Jaxpr
from jax.typing import ArrayLike

from erosion.lanes.arrays import ArrayRule, Elements, Part, kind_of, part, whole
from erosion.lanes.graph import (
    ARRAY,
    BOOL,
    DOUBLE,
    LONG,
    Branch,
    Call,
    CannotCompileError,
    Counted,
    Function,
    Graph,
    GraphValue,
    Loop,
    Region,
    Step,
)
from erosion.lanes.large import array_of
from erosion.lanes.scalars import SCALARS, Equation, Kind, aval_of, converted, type_of


def finish(graph: Graph, outputs: Sequence[GraphValue]) -> None:
    """Set a graph's outputs: drop what they do not need, count uses, and contract products and sums."""
    graph.outputs = list(outputs)
    needed = live(graph.outputs)
    for function in graph.functions:
        _prune_calls(function, needed)
    graph.functions = [function for function in graph.functions if function.outputs]
    for region in graph.regions:
        _prune(region, needed)
    for region in graph.regions:
        _count_uses(region)
    for value in (*graph.outputs, *(value for function in graph.functions for value in function.outputs)):
        value.uses += 1
    for region in graph.regions:
        _contract(region)
    for function in graph.functions:
        function.room = graph.rows
        graph.rows += len(function.arguments) + len(function.outputs)
        for value in (*_read_in(function.body), *function.outputs):
            if value.region is graph.root:
                function.reads |= dict.fromkeys(_sources(value))
        for value in function.reads:
            if value.op not in _REPEATABLE_OPS and value.type != ARRAY and value not in graph.kept:
                graph.kept[value] = graph.rows
                graph.rows += 1


def live(outputs: Iterable[GraphValue]) -> set[GraphValue]:
    """What the outputs depend on."""
    found: set[GraphValue] = set()
    waiting = list(outputs)
    while waiting:
        value = waiting.pop()
        if value in found:
            continue
        found.add(value)
        waiting += value.inputs
        if isinstance(value.extra, Loop | Counted) and value.op != "index":
            loop = value.extra
            i = (loop.arguments if value.op == "argument" else loop.results).index(value)
            waiting += (loop.initial[i], loop.updates[i], loop.arguments[i])
            waiting.append(loop.condition if isinstance(loop, Loop) else loop.index)
        elif isinstance(value.extra, Branch):
            branch = value.extra
            i = branch.results.index(value)
            waiting += (branch.selector, *(outputs[i] for outputs in branch.outputs))
        elif isinstance(value.extra, Call):
            call = value.extra
            waiting.append(call.function.outputs[call.results.index(value)])
        elif isinstance(value.extra, Function):
            # At each call: a function has its arguments wherever it is called.
            i = value.extra.arguments.index(value)
            waiting += [call.inputs[i] for call in value.extra.calls]
    return found


def _prune_calls(function: Function, live: set[GraphValue]) -> None:
    """Leave out calls without a live result, and what no call needs of the others."""
    calls = function.calls = [call for call in function.calls if not live.isdisjoint(call.results)]
    arguments = [i for i, argument in enumerate(function.arguments) if argument in live]
    outputs = [i for i in range(len(function.outputs)) if any(call.results[i] in live for call in calls)]
    function.arguments = [function.arguments[i] for i in arguments]
    function.outputs = [function.outputs[i] for i in outputs]
    for call in calls:
        call.inputs = tuple(call.inputs[i] for i in arguments)
        call.results = [call.results[i] for i in outputs]


_REPEATABLE_OPS = ("input", "room", "filled", "table")  # operations on memory, which a function may repeat


def _sources(value: GraphValue) -> Iterator[GraphValue]:
    """A value of the outermost region, after what it is found by where it is an operation on memory."""
    if value.is_constant:
        return
    before = value.inputs[:1] if value.op == "filled" else value.inputs if value.op == "table" else ()
    if value.type == ARRAY and isinstance(value.extra, Loop):
        before = (value.extra.initial[value.extra.results.index(value)],)
    for each in before:
        yield from _sources(each)
    yield value


def _read_in(region: Region) -> Iterator[GraphValue]:
    """What the steps of a region read, and of those within it."""
    for step in region.steps:
        yield from step.inputs
        for inner in step.regions:
            yield from _read_in(inner)


def _prune(region: Region, live: set[GraphValue]) -> None:
    kept: list[Step] = []
    for step in region.steps:
        if isinstance(step, GraphValue):
            if step in live:
                kept.append(step)
            continue
        if isinstance(step, Call):
            if not live.isdisjoint(step.results):
                kept.append(step)
            continue
        if isinstance(step, Branch):
            indices = [i for i, result in enumerate(step.results) if result in live]
            step.results = [step.results[i] for i in indices]
            step.outputs = [[outputs[i] for i in indices] for outputs in step.outputs]
        else:
            # A value of a loop may be needed only inside the loop.
            indices = [i for i, argument in enumerate(step.arguments) if argument in live]
            for name in ("arguments", "initial", "updates", "results"):
                setattr(step, name, [getattr(step, name)[i] for i in indices])
        if indices or (isinstance(step, Counted) and step.index in live):
            kept.append(step)
            for inner in step.regions:
                _prune(inner, live)
    region.steps = kept


def _count_uses(region: Region) -> None:
    for step in region.steps:
        for value in step.inputs:
            value.uses += 1
        for inner in step.regions:
            _count_uses(inner)


def _contract(region: Region) -> None:
    """Make a sum and the product that it alone reads one operation with one rounding, the first of two products.

    The choice depends on the graph alone, so the bits of a result do too.
    """
    taken: set[GraphValue] = set()

    def is_product(value: GraphValue) -> bool:
        return value.op == "fmul" and value.uses == 1 and value.region is region and value.type == DOUBLE

    for step in region.steps:
        for inner in step.regions:
            _contract(inner)
        if isinstance(step, GraphValue) and step.op in ("fadd", "fsub"):
            x, y = step.inputs
            minus = step.op == "fsub"
            if is_product(x):
                taken.add(x)
                step.op, step.inputs = ("fms" if minus else "fma"), (*x.inputs, y)
            elif is_product(y):
                taken.add(y)
                step.op, step.inputs = ("fnma" if minus else "fma"), (*y.inputs, x)
    region.steps = [step for step in region.steps if step not in taken]


_LONG = np.dtype(np.int64)
_OF_LONGS = Kind({}, (_LONG, _LONG), _LONG)


def _start(graph: Graph, value: GraphValue, dtype: np.dtype) -> GraphValue:
    """Where a slice starts, as an int64; the largest where an unsigned number is larger still."""
    start = converted(graph, value, dtype, _LONG)
    if dtype != np.uint64:
        return start
    beyond = graph.compare("icmp slt", start, graph.constant(0, LONG))
    return graph.select(beyond, graph.constant(np.iinfo(np.int64).max, LONG), start)


def _clamped(graph: Graph, start: GraphValue, most: int) -> GraphValue:
    """A start from 0 to `most`."""
    low, high = graph.constant(0, LONG), graph.constant(most, LONG)
    return SCALARS["clamp"](graph, _OF_LONGS, low, start, high)


def _within(graph: Graph, starts: Sequence[GraphValue], most: Sequence[int]) -> GraphValue:
    """Whether every start is from 0 to its `most`."""
    inside = graph.constant(True, BOOL)
    for start, highest in zip(starts, most, strict=True):
        # One unsigned comparison does for both limits: read without its sign, a negative start is large.
        good = graph.compare("icmp ule", start, graph.constant(highest, LONG))
        if start.is_constant:
            good = graph.constant(0 <= start.extra <= highest, BOOL)
        inside = graph.op("and", BOOL, inside, good)
    return inside


def _element(graph: Graph, array: Elements, starts: Sequence[GraphValue], offset: Sequence[int]) -> GraphValue:
    """The element at starts + offset, which lies within the array."""
    flat = graph.constant(0, LONG)
    for axis, (start, by) in enumerate(zip(starts, offset, strict=True)):
        stride = graph.constant(math.prod(array.shape[axis + 1 :]), LONG)
        index = graph.op("add", LONG, start, graph.constant(by, LONG))
        flat = graph.op("add", LONG, flat, graph.op("mul", LONG, index, stride))
    if flat.is_constant:
        return array.ravel()[flat.extra]
    if array.size == 1:
        return array.ravel()[0]
    return graph.op("lookup", array.ravel()[0].type, flat, graph.op("table", "ptr", *array.ravel()))


def _changed(
    graph: Graph,
    array: Elements,
    starts: Sequence[GraphValue],
    offset: Sequence[int],
    new: Callable[[GraphValue], GraphValue],
) -> None:
    """Replace the element at starts + offset by `new` of it; outside the array nothing changes."""
    for index in np.ndindex(array.shape):
        here = graph.constant(True, BOOL)
        for start, by, i in zip(starts, offset, index, strict=True):
            here = graph.op("and", BOOL, here, graph.compare("icmp eq", start, graph.constant(i - by, LONG)))
        if not (here.is_constant and not here.extra):
            array[index] = graph.select(here, new(array[index]), array[index])


def _gather(equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
    params, kind = equation.params, kind_of(equation)
    numbers, array, indices = params["dimension_numbers"], whole(inputs[0]), whole(inputs[1])
    most = [n - size for n, size in zip(array.shape, params["slice_sizes"], strict=True)]
    gone = (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)
    kept = [axis for axis in range(array.ndim) if axis not in gone]

    def element(index: tuple[int, ...]) -> GraphValue:
        batch = [i for axis, i in enumerate(index) if axis not in numbers.offset_dims]
        offset = [0] * array.ndim
        for axis, to in zip(numbers.offset_dims, kept, strict=True):
            offset[to] = index[axis]
        starts = _starts(graph, numbers.start_index_map, array.ndim, indices[tuple(batch)], kind.inputs[1])
        for axis, of_batch in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True):
            starts[axis] = graph.constant(batch[of_batch], LONG)
        safe = [_clamped(graph, start, highest) for start, highest in zip(starts, most, strict=True)]
        value = _element(graph, array, safe, offset)
        if params["mode"].name != "FILL_OR_DROP":
            return value
        outside = graph.constant(_fill(params["fill_value"], kind.output), type_of(kind.output))
        return graph.select(_within(graph, starts, most), value, outside)

    return [part(array_of(aval_of(equation.outvars[0]).shape, element))]


def _starts(graph: Graph, axes: Sequence[int], ndim: int, vector: np.ndarray, dtype: np.dtype) -> list[GraphValue]:
    """Where a slice starts, for each axis of the array."""
    starts = [graph.constant(0, LONG)] * ndim
    for axis, value in zip(axes, vector, strict=True):
        starts[axis] = _start(graph, value, dtype)
    return starts


def _fill(fill: float | None, dtype: np.dtype) -> float:
    """What JAX gives for a place outside the array."""
    if fill is not None:
        return fill
    if dtype.kind == "f":
        return np.nan
    return True if dtype.kind == "b" else np.iinfo(dtype).min if dtype.kind == "i" else np.iinfo(dtype).max


def scatter(
    call: Callable[[Jaxpr, Sequence[ArrayLike], Sequence[Part]], list[Part]],
    equation: Equation,
    graph: Graph,
    inputs: list[Part],
) -> list[Part]:
    """Change elements of an array: each becomes what a function makes of it and of its update.

    Args:
        call: gives a function's results.
        equation: of one of `SCATTERS`.
        graph: of the elements.
        inputs: array, places and updates.
    """
    params, kind = equation.params, kind_of(equation)
    numbers, function = params["dimension_numbers"], params["update_jaxpr"]
    if numbers.operand_batching_dims:
        raise CannotCompileError(f"`{equation.primitive.name}` in a batch")
    array, indices, updates = whole(inputs[0]).copy(), whole(inputs[1]), whole(inputs[2])
    kept = [axis for axis in range(array.ndim) if axis not in numbers.inserted_window_dims]
    for index in np.ndindex(updates.shape):
        batch = tuple(i for axis, i in enumerate(index) if axis not in numbers.update_window_dims)
        offset, sizes = [0] * array.ndim, [1] * array.ndim
        for axis, to in zip(numbers.update_window_dims, kept, strict=True):
            offset[to], sizes[to] = index[axis], updates.shape[axis]
        starts = _starts(graph, numbers.scatter_dims_to_operand_dims, array.ndim, indices[batch], kind.inputs[1])
        most = [n - size for n, size in zip(array.shape, sizes, strict=True)]
        if params["mode"].name == "CLIP":
            starts = [_clamped(graph, start, highest) for start, highest in zip(starts, most, strict=True)]
        inside, update = _within(graph, starts, most), updates[index]

        def new(old: GraphValue, inside: GraphValue = inside, update: GraphValue = update) -> GraphValue:
            value = whole(call(function, params["update_consts"], [old, update])[0])[()] if function else update
            return graph.select(inside, value, old)

        _changed(graph, array, starts, offset, new)
    return [part(array)]


PLACES: Mapping[str, ArrayRule] = {
    "gather": _gather,
}
"""The rule of each primitive that reads or changes a slice at a computed place, by its name."""

SCATTERS = {"scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-min", "scatter-max"}
"""Names of the primitives that `scatter` computes."""
