"""A function of one lane, compiled for many.

add = Lanewise(lambda x, y: x + y, (number, number))
add((np.arange(5.0), 2.0))  # -> an array of 5
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import PyTree

from erosion.lanes.flatten import flatten, is_large
from erosion.lanes.machine import MachineCode, ObjectCode, Processor, without_garbage_collection
from erosion.lanes.program_files import KeptProgram, ProgramFile
from erosion.lanes.scalars import aval_of
from erosion.lanes.tapes import READ, WRITE
from erosion.lanes.vector_ir import vector_ir
from erosion.lanes.workers import Interruptible
from erosion.lanes.writer import tapes_with

WIDTH = 8
"""Lanes of a vector: eight float64 fill the widest registers; narrower ones take two or four for each."""

_PORTION = 2**12  # lanes; vectors are as they were

number = jax.ShapeDtypeStruct((), np.float64)
"""Shape and type of a lane's plain number."""


class _Memory:
    """Memory of a call: for one vector of lanes, for numbers that all lanes share, and for the results of one lane.

    Args:
        rows: of the vectors.
        width: lanes of a vector.
        numbers: that all lanes share.
        outputs: shape and type of each result.
        tapes: of the function.

    Attributes:
        inputs: shape (rows, width).
        numbers: that all lanes share.
        results: of one lane.
        places: of these numbers, as `vector_ir` has it; below them rows for the tapes.
    """

    def __init__(
        self, rows: int, width: int, numbers: int, outputs: Sequence[tuple[tuple[int, ...], np.dtype]], tapes: int
    ) -> None:
        line, size = 64, rows * width
        memory = np.empty(size + numbers + line // 8)
        begin = -memory.ctypes.data % line // 8
        self.inputs = memory[begin : begin + size].reshape(-1, width)
        self.numbers = memory[begin + size : begin + size + numbers]
        # A word for each number, whichever lane it is.
        count = sum(math.prod(shape) for shape, _ in outputs)
        self._words = np.empty(count)
        self.places = np.zeros((count + tapes, 2), np.int64)
        self.places[:count, 0] = self._words.ctypes.data + 8 * np.arange(count)
        self.results, rest = [], self._words
        for shape, dtype in outputs:
            own, rest = rest[: math.prod(shape)], rest[math.prod(shape) :]
            self.results.append(own.view(dtype)[:: 8 // dtype.itemsize].reshape(shape))


class _Code(NamedTuple):
    """Code of a function, what memory it needs, whether it may begin again, and memory that no call uses now."""

    code: MachineCode
    rows: int
    numbers: int
    is_repeatable: bool  # not where it reads a tape that it writes
    unused: list[_Memory]


class PreparedCall(NamedTuple):
    """A call of some lanes that is made often: its memory is laid out once. One thread may use it at a time.

    Args:
        inputs: float64, of shape (lanes, …) each, to be filled before it runs.
        results: the pytree of results, arrays of shape (lanes, …), which it fills.
        code: of the function.
        addresses: of the other arguments of the code, see `vector_ir`.
        memory: which the addresses are of.
    """

    inputs: list[np.ndarray]
    results: PyTree
    code: MachineCode
    addresses: tuple[int, ...]
    memory: tuple[Any, ...]

    def run(self) -> None:
        """Compute the results of the inputs; a signal's handler may interrupt it, see `Lanewise.run`."""
        Interruptible(is_long=False).run(functools.partial(self.code.run, *self.addresses), self)


class Lanewise:
    """A function of one lane's numbers, compiled for many lanes.

    Args:
        function: takes and returns pytrees of numbers and small arrays; written in plain JAX.
        examples: examples of its arguments, or `jax.ShapeDtypeStruct` of them.
        width, target: of the vectors, and the processor; for tests.
        tapes: how many tapes the function has; see `erosion.lanes.tapes`.
        file: where an earlier process may have left the program, and where it is left for later ones.

    Raises:
        NotForLanesError: naming what in the function lanes cannot do.
    """

    def __init__(
        self,
        function: Callable[..., PyTree],
        examples: Sequence[PyTree],
        *,
        width: int = WIDTH,
        target: Processor | None = None,
        tapes: int = 0,
        file: ProgramFile | None = None,
    ) -> None:
        self._function, self._examples = function, examples
        self._target, self._tapes, self._width = target, tapes, width
        self._own: _Code | None = None
        program = None if file is None else file.read()
        if program is None:
            with without_garbage_collection():
                self._shared = self._compiled(shared=True)
            closed, self.results = self._traced
            self.large = [is_large(aval_of(variable)) for variable in closed.jaxpr.invars]
            self.inputs = [tuple(aval.shape) for aval in closed.in_avals]
            # Where large arrays differ from lane to lane, the function is compiled once more, from this trace.
            if any(self.large):
                file = None
            else:
                del self._traced  # ten thousand objects that Python's search for garbage would visit each time
            if file is not None:
                self._keep(file, self._shared.code.made)
        else:
            self.inputs, self.large, self.results = program.inputs, [False] * len(program.inputs), program.results
            code = MachineCode(program.text, target, program.made)
            self._shared = _Code(code, program.rows, program.numbers, program.is_repeatable, [])
        if file is not None:
            self._shared.code.keep = functools.partial(self._keep, file)
        leaves, self.structure = jax.tree.flatten(self.results)
        self.outputs = [(tuple(leaf.shape), np.dtype(leaf.dtype)) for leaf in leaves]
        self._places = [0, *itertools.accumulate(map(math.prod, self.inputs))][:-1]

    @functools.cached_property
    def _traced(self) -> tuple[ClosedJaxpr, PyTree]:
        """The function as JAX sees it, and shapes and types of its results."""
        function = self._function
        # JAX keeps what it traced for as long as there is the function: so it gets one of this call.
        return jax.make_jaxpr(lambda *arguments: function(*arguments), return_shape=True)(*self._examples)

    @property
    def closed(self) -> ClosedJaxpr:
        """The function as JAX sees it."""
        return self._traced[0]

    def _compiled(self, *, shared: bool) -> _Code:
        graph = flatten(self.closed, shared=shared)
        is_repeatable = not tapes_with(READ, graph) & tapes_with(WRITE, graph)
        code = MachineCode(vector_ir(graph, self._width, self._tapes), self._target)
        graph.root.clear()
        return _Code(code, graph.rows, graph.numbers, is_repeatable, [])

    def _keep(self, file: ProgramFile, made: ObjectCode) -> None:
        code, rows, numbers, is_repeatable, _ = self._shared
        file.write(KeptProgram(self.inputs, self.results, rows, numbers, is_repeatable, made, code.text))

    def __call__(self, *arguments: PyTree) -> PyTree:
        """The function of all lanes: leaves of shape (lanes, …), or of one lane's shape where all share it."""
        leaves = [np.asarray(leaf, float) for leaf in jax.tree.leaves(arguments)]
        lanes = max(
            (len(leaf) for leaf, shape in zip(leaves, self.inputs, strict=True) if leaf.ndim > len(shape)), default=1
        )
        results = [np.empty((lanes, *shape), dtype) for shape, dtype in self.outputs]
        self.run(leaves, np.arange(lanes), results)
        return jax.tree.unflatten(self.structure, results)

    def run(
        self,
        leaves: Sequence[np.ndarray],
        order: np.ndarray,
        results: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
        tapes: Sequence[np.ndarray] = (),
    ) -> None:
        """Compute some lanes, in an order, and write their results; other threads run meanwhile.

        A signal's handler may interrupt it, also in a loop that never ends.

        Args:
            leaves: float64, of shape (lanes, …), or of one lane's shape where all share it.
            order: which lanes, shape (n,), int64; neighbours share a vector.
            results: for each output an array (lanes, …) of its type, in C's order.
            stop: an int64, not 0 once the results are wanted no more. Without it, a signal's handler stops the work.
            tapes: for each tape an array (lanes, length) of float64, rows in C's order.
        """
        if not len(order):
            return
        order = np.ascontiguousarray(order, np.int64)
        together, is_shared = self.sharing(leaves)
        if not is_shared and self._own is None:
            with without_garbage_collection():
                self._own = self._compiled(shared=False)
        chosen = self._shared if is_shared or self._own is None else self._own
        # Each call has its own: a signal's handler may call the function while it runs, in the same thread.
        try:
            memory = chosen.unused.pop()
        except IndexError:
            memory = _Memory(chosen.rows, self._width, chosen.numbers, self.outputs, self._tapes)
        of_inputs = self._with_inputs(memory, leaves, together, are_large_shared=is_shared)
        of_results = memory.places if len(order) == 1 else self._places_of(results, len(tapes))
        for place, tape in zip(of_results[len(of_results) - len(tapes) :], tapes, strict=True):
            assert tape[:1].flags.c_contiguous, "the numbers of a tape follow each other"
            place[:] = tape.ctypes.data, tape.strides[0]
        interruptible = Interruptible(is_long=not chosen.is_repeatable)
        # In portions: better code may take over between two of them.
        for begin in range(0, len(order), _PORTION):
            if stop is not None and stop[0]:
                return
            portion = functools.partial(
                chosen.code.run,
                memory.inputs.ctypes.data,
                of_inputs.ctypes.data,
                len(of_inputs),
                order[begin:].ctypes.data,
                min(len(order) - begin, _PORTION),
                of_results.ctypes.data,
            )
            if stop is None:
                interruptible.run(portion, memory, of_inputs, order, of_results, *leaves, *results, *tapes)
            else:
                portion(stop.ctypes.data)
        if of_results is memory.places and (stop is None or not stop[0]):
            for result, own in zip(results, memory.results, strict=True):
                result[order[0]] = own
        chosen.unused.append(memory)

    def prepared(self, lanes: int) -> PreparedCall:
        """A call for some lanes of a function without tapes and large arrays, which lanes may share or not."""
        assert not self._tapes
        assert not any(self.large)
        inputs = [np.empty((lanes, *shape)) for shape in self.inputs]
        results, order = [np.empty((lanes, *shape), dtype) for shape, dtype in self.outputs], np.arange(lanes)
        memory = _Memory(self._shared.rows, self._width, self._shared.numbers, self.outputs, 0)
        of_inputs = self._with_inputs(memory, inputs, [False] * len(inputs), are_large_shared=True)
        of_results = self._places_of(results, 0)
        begin, fill, put = memory.inputs.ctypes.data, of_inputs.ctypes.data, of_results.ctypes.data
        addresses = (begin, fill, len(of_inputs), order.ctypes.data, lanes, put)
        made = jax.tree.unflatten(self.structure, results)
        return PreparedCall(inputs, made, self._shared.code, addresses, (memory, of_inputs, of_results, order))

    def _with_inputs(
        self, memory: _Memory, leaves: Sequence[np.ndarray], together: Sequence[bool], *, are_large_shared: bool
    ) -> np.ndarray:
        """Write what all lanes share; of the other numbers, the address of each, the bytes between lanes, its place."""
        inputs, numbers = memory.inputs, memory.numbers
        varying: list[tuple[int, int, int]] = []
        for leaf, shape, place, same, large in zip(
            leaves, self.inputs, self._places, together, self.large, strict=True
        ):
            if same:
                shared = leaf if leaf.ndim == len(shape) else leaf[0]
                if large and are_large_shared:
                    numbers[: shared.size], numbers = shared.ravel(), numbers[shared.size :]
                elif shape:
                    inputs[place : place + shared.size] = shared.reshape(-1, 1)
                else:
                    inputs[place] = shared
                continue
            address, stride = leaf.ctypes.data, leaf.strides[0]
            within = np.zeros(1, int)
            for length, step in zip(leaf.shape[1:], leaf.strides[1:], strict=True):
                within = (within[:, None] + step * np.arange(length)).ravel()
            varying += [(address + offset, stride, place + i) for i, offset in enumerate(within.tolist())]
        return np.array(varying, np.int64)

    def _places_of(self, results: Sequence[np.ndarray], tapes: int) -> np.ndarray:
        """The address of each result, and the bytes between lanes; below them rows for the tapes."""
        places: list[tuple[int, int]] = []
        for result, (shape, _) in zip(results, self.outputs, strict=True):
            address, stride = result.ctypes.data, result.strides[0]
            places += [(address + i * result.itemsize, stride) for i in range(math.prod(shape))]
        return np.array(places + [(0, 0)] * tapes, np.int64)

    def sharing(self, leaves: Sequence[np.ndarray]) -> tuple[list[bool], bool]:
        """Which arguments all lanes share, and whether they share all large ones."""
        together = [
            leaf.ndim == len(shape) or leaf.strides[0] == 0 for leaf, shape in zip(leaves, self.inputs, strict=True)
        ]
        return together, all(same for same, large in zip(together, self.large, strict=True) if large)


_KEYS = 2**16 - 1  # whole numbers of two bytes
_BINS = 2**12
_SAMPLE = 2**13  # lanes whose numbers say where quantiles are
_CROWDED = 1 / 16  # share of the lanes in one bin, above which lanes are ranked instead


def alike_together(numbers: Sequence[np.ndarray], group: int) -> np.ndarray:
    """An order of lanes in which each `group` of neighbours has similar numbers.

    The first number's quantiles cut the lanes into strips. The next number's quantiles cut each strip, in
    alternating direction, so that the next strip begins near the end of this one.

    Args:
        numbers: arrays (lanes,); at least one.
        group: lanes of a vector.

    Returns:
        Indices of lanes, shape (lanes,).
    """
    # Whole numbers of two bytes: numpy sorts them digit by digit, and no array needs fresh pages of memory.
    lanes = numbers[0].size
    spans = [(leaf, low, high) for leaf in numbers if (low := leaf.min()) != (high := leaf.max())]
    key = np.zeros(lanes, np.uint16)
    strips = max(round((lanes / group) ** (1 / max(len(spans), 1))), 1)
    for i, (leaf, low, high) in enumerate(spans):
        # The last one sorts what is left within a strip.
        parts = strips if i < len(spans) - 1 else max(_KEYS // strips**i, 1)
        part = _quantile(leaf, low, high, parts)
        key = key * np.uint16(parts) + part + (key & np.uint16(1)) * (np.uint16(parts - 1) - 2 * part)
    return np.argsort(key, kind="stable")


def _quantile(leaf: np.ndarray, low: float, high: float, parts: int) -> np.ndarray:
    """To which of `parts` quantiles each number belongs, as far as a sample knows; of two bytes."""
    with np.errstate(all="ignore"):
        width = high - low
        scale = (_BINS - 1) / width
        if parts <= _BINS and np.isfinite(width) and np.isfinite(scale):
            bins = ((leaf - low) * scale).astype(np.uint16)
            counts = np.bincount(bins[:: max(leaf.size // _SAMPLE, 1)], minlength=_BINS)
            if counts.max() <= _CROWDED * counts.sum():
                middle = np.cumsum(counts) - counts / 2
                return (middle * (parts / counts.sum())).astype(np.uint16).take(bins)
    # By rank: for numbers that lie close together, and those that are not finite.
    rank = np.empty(leaf.size, np.int64)
    rank[np.argsort(leaf)] = np.arange(leaf.size)
    return (rank * parts // leaf.size).astype(np.uint16)
