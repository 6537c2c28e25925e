"""Ends of lanes as numbers that JAX can trace: a callback into the batch, with rules for its derivatives."""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from erosion.arguments import Number
from erosion.lanes.lanewise import by_xla
from erosion.ode import pushes
from erosion.ode.batch import compile_ahead, integrate, integrate_along
from erosion.ode.gradient import is_worth, keep
from erosion.ode.integrator import LaneEnd, integrate_lane
from erosion.ode.problem import Equations
from erosion.ode.solution import Solution, Times
from erosion.ode.variational import Clock, Layout

if TYPE_CHECKING:
    from erosion.ode.solve import Lanes

# For each derivative the places of one or two elements, see `Variational`.
_Places = tuple[tuple[int, ...], ...]
# What JAX gives to a rule of derivatives: the numbers, or their tangents, of which some are symbols for zero.
_Numbers = tuple[list[PyTree]]


def traced_end(layout: Layout, numbers: Sequence[Number], rtol: float) -> tuple[Array, Array]:
    """Time since the start and outputs of a lane, shape (1 + outputs,), and codes: see `_codes`.

    Args:
        layout: of problem and arguments.
        numbers: of one lane, of which some are traced.
        rtol: relative tolerance.
    """
    arrays = [jnp.asarray(number, dtype) for number, dtype in zip(numbers, layout.dtypes, strict=True)]
    return _end(layout, rtol, arrays)


def traced_solution(lanes: "Lanes", wrt: Sequence[str], order: int, rtol: float, ts: Any) -> Solution:
    """The solution of lanes of which some number is traced.

    Raises:
        ValueError: where it asks for what only numbers have.
    """
    from erosion.ode.solve import named_events, shaped

    if wrt or order:
        raise ValueError("Argument `wrt` must be left out where JAX traces: use `jax.grad` and its like.")
    layout, shape = lanes.layout, lanes.shape
    own = [len(numbers) for numbers in layout.shapes]
    # Where `ts` alone is traced the numbers have one axis of lanes already.
    numbers = [
        jnp.reshape(number, shape) if np.ndim(number) > ndim and np.shape(number) == (lanes.size,) else number
        for number, ndim in zip(lanes.numbers, own, strict=True)
    ]
    lanes = lanes._replace(numbers=numbers)

    def many(numbers: Sequence[Number]) -> tuple[Array, Array]:
        """The ends of all lanes, each with its numbers."""
        flat, axes = [], []
        for number, ndim in zip(numbers, own, strict=True):
            varies = jnp.ndim(number) > ndim
            flat.append(jnp.ravel(jnp.broadcast_to(number, shape)) if varies else number)
            axes.append(0 if varies else None)
        if all(axis is None for axis in axes):
            vector, codes = traced_end(layout, flat, rtol)
            return jnp.broadcast_to(vector, (*shape, vector.size)), jnp.broadcast_to(codes, (*shape, codes.size))
        vectors, codes = jax.vmap(lambda one: traced_end(layout, one, rtol), (axes,))(flat)
        return vectors.reshape(*shape, vectors.shape[-1]), codes.reshape(*shape, codes.shape[-1])

    vector, codes = many(lanes.numbers)
    clock = layout.clock(lanes.numbers)
    t0 = jnp.broadcast_to(jnp.asarray(clock.t0), shape)
    part = shaped(lanes, vector[..., 0], [vector[..., i] for i in range(1, vector.shape[-1])])
    solution = Solution(
        problem=layout.problem, names=layout.end_names, wrt=(), outcome=codes[..., 0], t=part.t + t0, y=part.y,
        integrals=part.integrals, count=codes[..., 1], trials=codes[..., 2],
        at_once=named_events(lanes, [codes[..., i] > 0 for i in range(3, codes.shape[-1])]), derivatives={},
        lanes=lanes, rtol=rtol, digest=layout.equations.digest,
    )  # fmt: skip
    if ts is None:
        return solution
    times = jnp.asarray(ts, float)
    if times.ndim != 1:
        raise ValueError(f"Argument `ts` must be one row of times, but has shape {times.shape}.")
    place = len(lanes.numbers) - len(Clock._fields) + Clock._fields.index("t1")

    def at(time: Array) -> Array:
        numbers: list[Number] = list(lanes.numbers)
        numbers[place] = jnp.where(time < solution.t, time, solution.t)
        vector, codes = many(numbers)
        known = (time <= solution.t) & ~layout.has_no_result(codes[..., 0])
        return jnp.where(known[..., None], vector, jnp.nan)

    vectors = jax.vmap(at, out_axes=-2)(times)
    wide = lanes._replace(shape=(*shape, times.size))
    of_times = shaped(wide, vectors[..., 0], [vectors[..., i] for i in range(1, vectors.shape[-1])])
    return solution.with_times(Times(times, of_times.y, of_times.integrals))


def _rows(end: LaneEnd, kind: str) -> list[Any]:
    time, outputs = (getattr(part, kind) for part in (end.time, end.outputs))
    return [time, *outputs]


def _codes(end: LaneEnd) -> list[Any]:
    """Outcome, number of events, steps tried, and for each event whether it happens at the end."""
    count = 0 * end.trials if end.count is None else end.count
    return [end.outcome, count, end.trials, *end.at_once]


def _kind(order: int) -> str:
    return ("value", "first", "second")[order]


def _solve(layout: Layout, rtol: float, numbers: Sequence[Number], order: int, places: _Places) -> Any:
    """Time and outputs, and codes; or the derivatives along each direction, shape (1 + outputs, directions)."""
    if by_xla():
        if layout.options.method == "auto":
            # No other method could follow there.
            layout = layout.wanting(method="explicit")
        lane = functools.partial(integrate_lane, layout, list(numbers), rtol=rtol, order=order)
        if not places:
            end = lane(directions=())
            return jnp.stack(_rows(end, "value")), jnp.stack([code.astype(np.int32) for code in _codes(end)])
        along = jax.vmap(lambda row: jnp.stack(_rows(lane(directions=tuple(row)), _kind(order))), out_axes=-1)
        return along(jnp.asarray(places, float))
    rows = layout.rows
    codes = len(("outcome", "count", "trials")) + (len(layout.event_names) if layout.options.clock else 0)
    if places:
        shape: Any = jax.ShapeDtypeStruct((rows, len(places)), np.float64)
    else:
        shape = jax.ShapeDtypeStruct((rows,), np.float64), jax.ShapeDtypeStruct((codes,), np.int32)
    compile_ahead(layout, order, len(places[0]) if places else 0)
    on_host = _callback(layout, layout.equations, rtol, order, places)
    return jax.pure_callback(on_host, shape, *numbers, vmap_method="expand_dims")


@functools.lru_cache(maxsize=256)
def _callback(layout: Layout, equations: Equations, rtol: float, order: int, places: _Places) -> Callable[..., Any]:
    """The same object each time, as JAX compiles a program for each; but each problem follows its own code."""
    return functools.partial(_on_host, layout, rtol, order, places)


def _on_host(layout: Layout, rtol: float, order: int, places: _Places, *given: Number) -> Any:
    """`_solve` by the batch, for numbers that may have axes of `vmap` before their own."""
    arrays = [np.asarray(number) for number in given]
    leading = [array.shape[: array.ndim - len(shape)] for array, shape in zip(arrays, layout.shapes, strict=True)]
    batch = np.broadcast_shapes(*leading)
    lanes = math.prod(batch)
    numbers = [
        array.reshape(shape)
        if math.prod(before) == 1
        else np.broadcast_to(array, (*batch, *shape)).reshape(lanes, *shape)
        for array, before, shape in zip(arrays, leading, layout.shapes, strict=True)
    ]
    if not places:
        end = integrate(layout, numbers, lanes, 0, (), rtol)
        keep(layout, numbers, end, rtol)
        vector = np.stack(_rows(end, "value"), -1).reshape(*batch, -1)
        return vector, np.stack(_codes(end), -1).astype(np.int32).reshape(*batch, -1)
    end = integrate_along(layout, numbers, lanes, order, np.array(places, float).T, rtol)
    return np.stack(_rows(end, _kind(order)), 1).reshape(*batch, -1, len(places))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _end(layout: Layout, rtol: float, numbers: list[Number]) -> tuple[Array, Array]:
    return _solve(layout, rtol, numbers, 0, ())


@functools.partial(_end.defjvp, symbolic_zeros=True)
def _end_jvp(layout: Layout, rtol: float, primals: _Numbers, tangents: _Numbers) -> Any:
    (numbers,), (rates,) = primals, tangents
    moving = _moving(layout, rates)
    elements, moved = _elements(layout, moving), [jnp.asarray(rates[i]) for i in moving]
    goes_back = is_worth(layout, len(elements))
    vector, codes = _end(layout.wanting(records=goes_back), rtol, numbers)
    still = np.zeros(codes.shape, jax.dtypes.float0)
    if goes_back:
        ends = pushes.EndFunction(layout, rtol, moving, vector.size, _slopes)
        return (vector, codes), (pushes.pushed(ends, numbers, moved), still)
    return (vector, codes), (_slopes(layout, rtol, elements, numbers) @ _flat(moved), still)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _slopes(layout: Layout, rtol: float, elements: tuple[int, ...], numbers: list[Number]) -> Array:
    """∂(time, outputs)/∂(element i) for each i of `elements`, shape (1 + outputs, elements)."""
    return _solve(layout, rtol, numbers, 1, tuple((i,) for i in elements))


@functools.partial(_slopes.defjvp, symbolic_zeros=True)
def _slopes_jvp(
    layout: Layout, rtol: float, elements: tuple[int, ...], primals: _Numbers, tangents: _Numbers
) -> tuple[Array, Array]:
    (numbers,), (rates,) = primals, tangents
    moving = _moving(layout, rates)
    others, moved = _elements(layout, moving), _flat([jnp.asarray(rates[i]) for i in moving])
    return _slopes(layout, rtol, elements, numbers), _curvatures(layout, rtol, elements, others, numbers) @ moved


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2, 3))
def _curvatures(
    layout: Layout, rtol: float, elements: tuple[int, ...], others: tuple[int, ...], numbers: list[Number]
) -> Array:
    """∂²/∂(element i)∂(element j), i of `elements` and j of `others`; shape (1 + outputs, elements, others)."""
    # One direction twice is cheaper than a pair.
    alone = elements == others and len(elements) == 1
    pairs = (elements,) if alone else tuple(itertools.product(elements, others))
    return _solve(layout, rtol, numbers, 2, pairs).reshape(-1, len(elements), len(others))


@_curvatures.defjvp
def _curvatures_jvp(*_: Any) -> NoReturn:
    raise NotImplementedError("There are derivatives of ends up to the second; the third is not available.")


def _moving(layout: Layout, rates: list[PyTree]) -> tuple[int, ...]:
    """The numbers whose tangents are not zero by construction."""
    zero = jax.custom_derivatives.SymbolicZero
    return tuple(i for i, rate in enumerate(rates) if not isinstance(rate, zero) and layout.dtypes[i] == "float64")


def _elements(layout: Layout, numbers: Sequence[int]) -> tuple[int, ...]:
    """The elements of some numbers."""
    return tuple(j for i in numbers for j in range(layout.offsets[i], layout.offsets[i + 1]))


def _flat(parts: Sequence[Array]) -> Array:
    return jnp.concatenate([jnp.ravel(part) for part in parts])
