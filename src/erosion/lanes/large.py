"""Large arrays of one lane: numbers in memory, and loops over them that stay loops in the graph.

A small array is taken apart into scalars. A large one would make a large program, so it is what gives its element at
given indices: a place in memory, or arithmetic on other arrays. It is computed in a loop where it is stored, summed or
multiplied with another array. Where an operation knows only small arrays, `whole` takes a large one apart as well.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from erosion.lanes.graph import DOUBLE, PLACE, CannotCompileError, Graph, GraphValue, Region

LARGE = 16
"""Elements from which on an argument is large, and so what is computed from it."""

_TILE = 4  # sums side by side: each has to wait for its last term

Index = Sequence[GraphValue]
"""An index along each axis, the same in all lanes."""


class Carried:
    """Memory that a loop changes: the array that it holds now."""

    def __init__(self, array: GraphValue) -> None:
        self.now = array


class View(NamedTuple):
    """Where elements lie in memory: an array, and by how many places an index moves along each axis."""

    array: GraphValue
    offset: int
    strides: tuple[int, ...]
    carried: Carried | None = None


class Large:
    """A large array.

    Args:
        graph: of its elements.
        shape: of the array.
        type_: of an element.
        given: its element at an index, or where elements lie.
        reads: the memory of loops that it depends on, and whether its element depends only on that at the same place.
    """

    def __init__(
        self,
        graph: Graph,
        shape: Sequence[int],
        type_: str,
        given: Callable[[Index], GraphValue] | View,
        reads: dict[Carried, bool] | None = None,
    ) -> None:
        self.graph, self.shape, self.type, self._given = graph, tuple(shape), type_, given
        self.view = given if isinstance(given, View) else None
        self.reads = reads or {}
        if self.view is not None and self.view.carried is not None:
            self.reads = {self.view.carried: self.is_contiguous and self.view.offset == 0}
        self._stored: Large | None = None
        self._known: dict[tuple[GraphValue, ...], GraphValue] = {}

    @property
    def size(self) -> int:
        """How many elements there are."""
        return math.prod(self.shape)

    @property
    def ndim(self) -> int:
        """How many axes."""
        return len(self.shape)

    @property
    def is_contiguous(self) -> bool:
        """Whether elements lie one after another in memory."""
        if self.view is None:
            return False
        pairs = zip(self.shape, self.view.strides, _strides(self.shape), strict=True)
        return all(length == 1 or stride == usual for length, stride, usual in pairs)

    def at(self, index: Index) -> GraphValue:
        """The element at an index."""
        if not isinstance(self._given, View):
            known = self._known.get(tuple(index))
            if known is None or not _encloses(known.region, self.graph.region):
                known = self._known[tuple(index)] = self._given(index)
            return known
        array, offset, strides, carried = self._given
        if carried is not None and carried.now is not array:
            raise CannotCompileError("a large array after a loop has changed it")
        return self.graph.op("row", DOUBLE, array, self.graph.place(zip(index, strides, strict=True), offset))

    def apart(self) -> np.ndarray:
        """The elements one by one."""
        return array_of(self.shape, lambda index: self.at([self.graph.constant(i, PLACE) for i in index]))

    def stored(self) -> "Large":
        """The same array in memory."""
        if self.view is not None:
            return self
        if self._stored is None or not _encloses(self._stored.view.array.region, self.graph.region):  # pyrefly: ignore
            room = self.graph.room(self.size)
            self._stored = Large(self.graph, self.shape, self.type, View(_fill(self, room), 0, _strides(self.shape)))
        return self._stored

    def copied(self) -> GraphValue:
        """A copy in new memory, one element after another."""
        return _fill(self, self.graph.room(self.size))

    def moved(
        self, shape: Sequence[int], axes: Sequence[int | None], begins: Sequence[int], steps: Sequence[int]
    ) -> "Large":
        """The elements at other places.

        Args:
            shape: of the result.
            axes: for each axis of this array that of the result along which it runs, or None where it stays.
            begins: for each axis of this array its index where that of the result is zero.
            steps: by how many it moves from there on.
        """
        if self.view is not None:
            strides, offset = [0] * len(shape), self.view.offset
            for axis, begin, step, stride in zip(axes, begins, steps, self.view.strides, strict=True):
                offset += begin * stride
                if axis is not None:
                    strides[axis] += step * stride
            return Large(self.graph, shape, self.type, self.view._replace(offset=offset, strides=tuple(strides)))

        def at(index: Index) -> GraphValue:
            return self.at(
                [
                    self.graph.place([(index[axis], step)] if axis is not None else [], begin)
                    for axis, begin, step in zip(axes, begins, steps, strict=True)
                ]
            )

        return Large(self.graph, shape, self.type, at, dict.fromkeys(self.reads, False))

    def reshaped(self, shape: Sequence[int]) -> "Large":
        """The elements in another shape."""
        if self.view is not None and self.is_contiguous:
            return Large(self.graph, shape, self.type, self.view._replace(strides=_strides(shape)))
        of, to = ([i for i, length in enumerate(s) if length > 1] for s in (self.shape, shape))
        if [self.shape[i] for i in of] == [shape[i] for i in to]:
            axes = dict(zip(of, to, strict=True))
            return self.moved(
                shape, [axes.get(i) for i in range(len(self.shape))], [0] * len(self.shape), [1] * len(self.shape)
            )
        stored = self.stored()
        if not stored.is_contiguous:
            stored = memory(self.graph, stored.copied(), self.shape)
        return stored.reshaped(shape)


def array_of(shape: Sequence[int], element: Callable[[tuple[int, ...]], GraphValue]) -> np.ndarray:
    """An array of values, each from its index."""
    made = np.empty(shape, object)
    for index in np.ndindex(made.shape):
        made[index] = element(index)
    return made


def _strides(shape: Sequence[int]) -> tuple[int, ...]:
    return tuple(math.prod(shape[i + 1 :]) for i in range(len(shape)))


def _encloses(region: Region, inner: Region | None) -> bool:
    while inner is not None:
        if inner is region:
            return True
        inner = inner.parent
    return False


def memory(graph: Graph, array: GraphValue, shape: Sequence[int], carried: Carried | None = None) -> Large:
    """An array whose elements lie one after another."""
    return Large(graph, shape, DOUBLE, View(array, 0, _strides(shape), carried))


def each(graph: Graph, shape: Sequence[int], body: Callable[[list[GraphValue]], None]) -> None:
    """Do something for each index of a shape, in nested loops."""
    zero = graph.constant(0, PLACE)

    def along(axis: int, index: list[GraphValue]) -> None:
        if axis == len(shape):
            body(index)
        elif shape[axis] == 1:
            along(axis + 1, [*index, zero])
        else:

            def again(i: GraphValue, _: list[GraphValue]) -> list[GraphValue]:
                along(axis + 1, [*index, i])
                return []

            graph.counted(shape[axis], [], again)

    along(0, [])


def _fill(source: Large, room: GraphValue, *, masked: bool = False) -> GraphValue:
    """The memory with an array in it."""
    graph, strides, stores = source.graph, _strides(source.shape), []
    if source.type != DOUBLE:
        raise CannotCompileError(f"a large array of type {source.type}")

    def store(index: list[GraphValue]) -> None:
        place = graph.place(zip(index, strides, strict=True))
        stores.append(graph.store(room, place, source.at(index), masked=masked))

    each(graph, source.shape, store)
    return graph.filled(room, stores)


def large(graph: Graph, part: Any, shape: Sequence[int] | None = None) -> Large | None:
    """A part as a large array; None where it cannot be one."""
    if isinstance(part, Large):
        return part
    if isinstance(part, GraphValue):
        return Large(graph, shape or (), part.type, lambda _: part)
    values = list(part.ravel())
    if values and all(value is values[0] for value in values):
        return Large(graph, part.shape, values[0].type, lambda _: values[0])
    if not values or values[0].type != DOUBLE:
        return None
    return memory(graph, graph.rows_of(values), part.shape)


def sums(
    graph: Graph,
    shape: Sequence[int],
    along: Sequence[int],
    term: Callable[[Index, Index], tuple[GraphValue, GraphValue | None]],
) -> GraphValue | np.ndarray | Large:
    """Sums of terms, a product of two numbers or one number, for each index of a shape; in the order of the terms.

    Args:
        graph: of the terms.
        shape: of the result.
        along: the shape over which a sum runs.
        term: of an index of the result, and one along the sum.
    """
    zero = graph.constant(0.0, DOUBLE)

    def summed(indices: list[list[GraphValue]]) -> list[GraphValue]:
        """The sums at some indices, side by side."""

        def inner(axis: int, place: list[GraphValue], totals: Sequence[GraphValue]) -> Sequence[GraphValue]:
            if axis < len(along):
                return graph.counted(along[axis], totals, lambda i, carried: inner(axis + 1, [*place, i], carried))
            after = []
            for index, total in zip(indices, totals, strict=True):
                x, y = term(index, place)
                after.append(graph.op("fadd", DOUBLE, x if y is None else graph.op("fmul", DOUBLE, x, y), total))
            return after

        return list(inner(0, [], [zero] * len(indices)))

    size = math.prod(shape)
    constants = [graph.constant(i, PLACE) for i in range(_TILE)]
    if size < LARGE:
        made = np.empty(shape, object)
        places = list(np.ndindex(*shape))
        for first in range(0, size, _TILE):
            some = places[first : first + _TILE]
            found = summed([[graph.constant(i, PLACE) for i in place] for place in some])
            for place, value in zip(some, found, strict=True):
                made[place] = value
        return made if made.shape else made[()]
    # In tiles along the last axis that is longer than one.
    last = max(i for i, length in enumerate(shape) if length > 1)
    room, strides, stores = graph.room(size), _strides(shape), []

    def tile(index: list[GraphValue], width: int, first: int, factor: int) -> None:
        """Some sums from `first` on."""
        begin = graph.place([(index[last], factor)], first)
        own = [[*index[:last], graph.place([(begin, 1), (constants[i], 1)]), *index[last + 1 :]] for i in range(width)]
        for place, value in zip(own, summed(own), strict=True):
            stores.append(graph.store(room, graph.place(zip(place, strides, strict=True)), value))

    tiles, rest = divmod(shape[last], _TILE)
    if tiles:
        each(graph, [*shape[:last], tiles, *shape[last + 1 :]], lambda index: tile(index, _TILE, 0, _TILE))
    if rest:
        each(graph, [*shape[:last], 1, *shape[last + 1 :]], lambda index: tile(index, rest, tiles * _TILE, 1))
    return memory(graph, graph.filled(room, stores), shape)


# What a loop of the lane carries.


def begin_carrying(part: Large) -> Carried:
    """The memory that a loop may change: that of a loop around it, or a copy."""
    view = part.view
    if view is not None and view.carried is not None and part.is_contiguous and view.carried.now is view.array:
        return view.carried
    return Carried(part.copied())


def as_memory(graph: Graph, part: Any) -> Large:
    """A part as a large array."""
    array = large(graph, part)
    if array is None:
        raise CannotCompileError("a large array of another type")
    return array


def parted(held: Large, new: Large) -> Large:
    """What a loop carries on, where that may be written: copied, if it depends on what others carry, or elsewhere."""
    assert held.view is not None
    own = held.view.carried
    alone = all(carried is own and same_place for carried, same_place in new.reads.items())
    return new if alone else memory(new.graph, new.copied(), new.shape)


def carry_on(held: Large, new: Large) -> GraphValue:
    """The memory of a loop with what it holds after a round, for the lanes that have another."""
    own = held.view
    assert own is not None
    assert own.carried is not None
    if new.view is not None and new.view.carried is own.carried and new.is_contiguous and new.view.offset == 0:
        return new.view.array
    return _fill(new, own.array, masked=True)
