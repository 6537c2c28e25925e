"""A function of lanes, cut into few kernels in which little is computed twice.

XLA compiles each row of a kernel's result as an expression of its own, so what rows share is
computed once a row. The plan looks at the function's arithmetic for one lane, stores what is
dear and shared in kernels of its own, and takes what parameters alone determine out of the
loop. It knows scalar arithmetic only: a function that does anything else (arrays, `cond`,
`while`, linear algebra) stays whole, one kernel for each array of its result.
"""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arithmetic import Graph, NotScalarArithmeticError, Operation, Value, constant, hoisted, run
from erosion.kernels import Kernel, narrow

# Measured on AVX-512, in multiplications; what is not listed costs one.
_COSTS = {"convert_element_type": 0, "copy": 0, "neg": 0, "stop_gradient": 0, "div": 6, "rem": 20, "sqrt": 8}
_COSTS |= dict.fromkeys(("acos", "asin", "atan", "atan2", "cos", "cosh", "erf", "exp", "expm1", "log", "log1p"), 20)
_COSTS |= dict.fromkeys(("logistic", "pow", "sin", "sinh", "tan", "tanh", "rsqrt", "cbrt"), 20)
_STORE = 4.0  # likewise: writing a shared value, and reading it once
_LOAD = 0.5
_START = 20.0  # likewise: of a kernel, for each lane of a block
_PRODUCTS = ("mul", "square", "integer_pow")
# Operations: LLVM unrolls a loop of 64 lanes, eight at once, up to 300 instructions, or 38 of its body.
_UNROLLED = 45


def planned(function: Callable[..., Any], shared: Any, known: Any, like: Sequence[int | None]) -> Callable[..., Any]:
    """A function of one lane's scalars, made one of all lanes.

    Args:
        function: of (shared, known, *variables); returns a tuple of lists of scalars.
        shared: a pytree that all lanes have in common.
        known: a pytree of (lanes,) arrays, the first of them of floats.
        like: for each variable how many rows it has, as a list of scalars; None for a scalar.

    Returns:
        A function of the variables as (rows, lanes) or (lanes,) arrays, whose results are
        arrays (rows, lanes), one for each list.
    """
    if jax.default_backend() == "cpu":
        try:
            return Plan(function, shared, known, like)
        except NotScalarArithmeticError:
            pass
    return _whole(function, shared, known, like)


def _whole(function: Callable[..., Any], shared: Any, known: Any, like: Sequence[int | None]) -> Callable[..., Any]:
    scalar = jax.ShapeDtypeStruct((), float)
    one = [scalar if rows is None else [scalar] * rows for rows in like]
    count = len(jax.eval_shape(function, shared, jax.tree.map(lambda leaf: leaf[0], known), *one))

    def group(i: int, *arrays: Any) -> Any:
        rows = [array if count is None else list(array) for count, array in zip(like, arrays, strict=True)]
        axes = (None, 0, *[0] * len(rows))
        return jnp.stack(jax.vmap(lambda *given: function(*given)[i], in_axes=axes)(shared, known, *rows))

    kernels = [Kernel(functools.partial(group, i)) for i in range(count)]
    return lambda *arrays: tuple(kernel(*arrays) for kernel in kernels)


class Plan:
    """The kernels of a function, and which arrays each of them reads."""

    def __init__(self, function: Callable[..., Any], shared: Any, known: Any, like: Sequence[int | None]) -> None:
        scalar = jax.ShapeDtypeStruct((), float)
        variables = [scalar if rows is None else [scalar] * rows for rows in like]
        lane = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), known)
        closed, shapes = jax.make_jaxpr(function, return_shape=True)(shared, lane, *variables)
        graph = Graph(closed)
        fixed = len(jax.tree.leaves((shared, known)))
        outputs, before, within = hoisted(graph, range(fixed))
        groups = [len(group) for group in shapes]
        splits = [outputs[sum(groups[:i]) : sum(groups[: i + 1])] for i in range(len(groups))]
        stored = _stored(within, outputs)
        results = [*_waves(within, stored), *splits]
        if jax.tree.leaves(known):
            number = np.dtype(float)
            sign = graph.add(Operation(lax.sign_p, {}, (len(jax.tree.leaves(shared)),), number))
            zero = graph.add(Operation(lax.mul_p, {}, (constant(0.0), sign), number))
            before |= {value: graph.operations[value] for value in (sign, zero)}
            within = _rounded(graph, within, results, zero)
        self.kernels: list[tuple[Kernel, list[int]]] = []

        # Where values are found: (index among the arrays, row of it).
        places: dict[int, tuple[int, int | None]] = {}
        count = fixed
        for i, rows in enumerate(like):
            for row in [None] if rows is None else range(rows):
                places[count] = (i, row)
                count += 1
        used = {v for operation in within.values() for v in operation.numbers()}
        used |= {v for v in outputs if isinstance(v, int)}
        taken = sorted(used - {*within} - {*places})
        if not places and not taken:
            taken = [fixed - 1]  # results of constants alone still have lanes
        # Few arrays, each of one type: many small ones cost the compiler dear.
        types: dict[Any, list[int]] = {}
        for value in taken:
            dtype = before[value].dtype if value in before else closed.in_avals[value].dtype
            types.setdefault(dtype, []).append(value)
        alike = [part for values in types.values() for part in narrow(values)]
        for i, values in enumerate(alike):
            places |= {value: (len(like) + i, row) for row, value in enumerate(values)}
        self.hoisted = [self._hoist(before, values, shared, known) for values in alike]

        for made, rows in enumerate(results, len(like) + len(alike)):
            self._add(within, places, rows)
            places |= {v: (made, row) for row, v in enumerate(rows) if isinstance(v, int) and v not in places}
        self.groups = len(groups)

    def __call__(self, *arrays: Any) -> tuple[Any, ...]:
        """The function's arrays."""
        sources = [*arrays, *self.hoisted]
        for kernel, reads in self.kernels:
            sources.append(kernel(*[sources[i] for i in reads]))
        return tuple(sources[-self.groups :])

    @staticmethod
    def _hoist(before: dict[int, Operation], taken: list[int], shared: Any, known: Any) -> Any:
        """Some of what parameters alone determine, an array (taken, lanes)."""
        common, each = jax.tree.leaves(shared), jax.tree.leaves(known)
        cone, _ = _cone(before, range(len(common) + len(each)), taken)
        steps = {value: before[value] for value in sorted(cone)}

        def lane(common: list[Any], each: list[Any]) -> list[Any]:
            return run(steps, dict(enumerate([*common, *each])), taken)

        return Kernel(lambda *given: jnp.stack(jax.vmap(lane, in_axes=(None, 0))(*given)))(common, each)

    def _add(self, within: dict[int, Operation], places: dict[int, tuple[int, int | None]], results: list[Any]) -> None:
        """Add the kernel of some results, given where what is stored so far is found."""
        cone, inputs = _cone(within, places, results)
        inputs = inputs or [next(iter(places))]
        reads = sorted({places[value][0] for value in inputs})
        rows = [(reads.index(places[value][0]), places[value][1]) for value in inputs]
        steps = {value: operation for value, operation in within.items() if value in cone}

        def lane(*given: Any) -> list[Any]:
            return run(steps, dict(zip(inputs, given, strict=True)), results)

        def lanes(*arrays: Any) -> Any:
            return jnp.stack(jax.vmap(lane)(*[arrays[i] if row is None else arrays[i][row] for i, row in rows]))

        self.kernels.append((Kernel(lanes), reads))


def _rounded(
    graph: Graph, operations: dict[int, Operation], results: Sequence[Sequence[Any]], zero: int
) -> dict[int, Operation]:
    """The operations, but products of float64 in small loops are rounded by themselves.

    LLVM computes a product and a sum as one operation with one rounding where it sees them side by side.
    It unrolls small loops, and then moves and shares what some of the lanes compute and others not: results
    would differ by where in a block a lane lies. A zero that it does not know to be one is added to such
    products: that is one operation as well, and the sum another. (-0.0 becomes 0.0.)
    """
    small: set[int] = set()
    done: set[int] = set()
    for group in results:
        for value in group:
            cone, _ = _cone(operations, done, [value])
            if len(cone) < _UNROLLED:
                small |= cone
            small |= _products(operations, value)
        done |= {value for value in group if isinstance(value, int)}
    rounded: dict[int, Operation] = {}
    for value, operation in operations.items():
        if value in small and _is_product(operation):
            product = graph.new()
            rounded[product] = operation
            rounded[value] = Operation(lax.add_p, {}, (product, zero), operation.dtype)
        else:
            rounded[value] = operation
    return rounded


def _is_product(operation: Operation) -> bool:
    return operation.primitive.name in _PRODUCTS and operation.dtype == np.float64


def _products(operations: dict[int, Operation], value: Any) -> set[int]:
    """The products that a result is, but for its sign or a choice."""
    operation = operations.get(value) if isinstance(value, int) else None
    if operation is None:
        return set()
    if _is_product(operation):
        return {value}
    if operation.primitive.name in ("neg", "copy", "select_n", "stop_gradient"):
        return {product for each in operation.inputs for product in _products(operations, each)}
    return set()


class _Work:
    """What it takes to compute every result of a function, each by itself, from the values stored."""

    def __init__(self, operations: dict[int, Operation], outputs: list[Value]) -> None:
        self.operations = operations
        self.inputs = {n: [v for v in operation.numbers() if v in operations] for n, operation in operations.items()}
        self.bit = {n: 1 << i for i, n in enumerate(operations)}
        self.outputs = [value for value in outputs if isinstance(value, int) and value in operations]
        self._of_cost: dict[int, int] = {}  # which operations have a cost, as bits
        for n, operation in operations.items():
            cost = _COSTS.get(operation.primitive.name, 1)
            self._of_cost[cost] = self._of_cost.get(cost, 0) | self.bit[n]

    def cones(self, stored: set[int]) -> dict[int, int]:
        """What each value is computed from and is not stored, as bits."""
        cones: dict[int, int] = {}
        for n, inputs in self.inputs.items():
            cones[n] = self.bit[n]
            for v in inputs:
                if v not in stored:
                    cones[n] |= cones[v]
        return cones

    def cost(self, cone: int) -> int:
        """To compute a value from that."""
        return sum(cost * (cone & bits).bit_count() for cost, bits in self._of_cost.items())

    def whole(self, stored: set[int]) -> float:
        """The cost to compute and store what is stored, and the outputs from that."""
        cones = self.cones(stored)
        return _STORE * len(stored) + sum(self.cost(cones[n]) for n in [*stored, *self.outputs])

    def readers(self, stored: set[int]) -> dict[int, int]:
        """How many results read a value, directly or by what is not stored."""
        sinks = dict.fromkeys(self.inputs, 0)
        for row, n in enumerate(self.outputs):
            sinks[n] |= 1 << (len(self.inputs) + row)
        for n in reversed(self.inputs):
            for v in self.inputs[n]:
                sinks[v] |= self.bit[n] if n in stored else sinks[n]
        return {n: bits.bit_count() for n, bits in sinks.items()}


def _stored(operations: dict[int, Operation], outputs: list[Value]) -> set[int]:
    """Which values to store: greedily what saves most recomputation, then less what is not worth a kernel."""
    work = _Work(operations, outputs)
    stored: set[int] = set()
    while True:
        cones, readers = work.cones(stored), work.readers(stored)
        saved = {
            n: (readers[n] - 1) * work.cost(cones[n]) - _STORE - _LOAD * readers[n]
            for n, operation in operations.items()
            if n not in stored and readers[n] > 1 and operation.dtype == np.float64
        }
        best = max(saved, key=lambda n: saved[n], default=None)
        if best is None or saved[best] <= 0:
            break
        stored.add(best)
    while True:
        fewer = [stored.difference(wave) for wave in _waves(operations, stored)]
        cheapest = min(fewer, key=work.whole, default=stored)
        if not fewer or work.whole(cheapest) >= work.whole(stored) + _START:
            return stored
        stored = cheapest


def _cone(operations: dict[int, Operation], known: Iterable[int], results: Iterable[Any]) -> tuple[set[int], list[int]]:
    """What must be computed for some results, and from which of the known values."""
    cone: set[int] = set()
    inputs: set[int] = set()
    waiting = [value for value in results if isinstance(value, int)]
    while waiting:
        value = waiting.pop()
        if value in known or value not in operations:
            inputs.add(value)
        elif value not in cone:
            cone.add(value)
            waiting += operations[value].numbers()
    return cone, sorted(inputs)


def _waves(operations: dict[int, Operation], stored: set[int]) -> list[list[int]]:
    """The stored values, some to a kernel, each after those that it is computed from."""
    level: dict[int, int] = {}
    for number, operation in operations.items():
        level[number] = max((level[v] + (v in stored) for v in operation.numbers() if v in level), default=0)
    waves = []
    for depth in sorted({level[n] for n in stored}):
        wave = [n for n in operations if n in stored and level[n] == depth]
        waves += narrow(wave)
    return waves
