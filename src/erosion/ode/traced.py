"""Ends of lanes as numbers that JAX can trace: a callback into the batch, with rules for its derivatives."""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
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


class Wanted(NamedTuple):
    """What is wanted of lanes.

    Args:
        layout: of problem and arguments.
        rtol: relative tolerance.
        times: at how many times outputs are wanted as well; these follow the numbers of a lane, rising.
    """

    layout: Layout
    rtol: float
    times: int = 0

    @property
    def rows(self) -> int:
        """The time at the end, the outputs there, and those at times."""
        return self.layout.rows + self.times * (self.layout.rows - 1)

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of the numbers of a lane, and of its times."""
        return (*self.layout.shapes, *([(self.times,)] if self.times else []))


_zero = jax.custom_derivatives.SymbolicZero

# What JAX gives to a rule of derivatives: the numbers, or their tangents, of which some are symbols for zero.
_Numbers = tuple[list[PyTree]]


def traced_end(wanted: Wanted, numbers: Sequence[Number]) -> tuple[Array, Array]:
    """Time since the start and outputs of a lane, and those at times, in one row, and codes: see `_codes`.

    Args:
        wanted: what of it.
        numbers: of one lane, of which some are traced, and its times.
    """
    dtypes = (*wanted.layout.dtypes, "float64")
    return _end(wanted, [jnp.asarray(number, dtype) for number, dtype in zip(numbers, dtypes, strict=False)])


def traced_solution(lanes: "Lanes", wrt: Sequence[str], order: int, rtol: float, ts: Any) -> Solution:
    """The solution of lanes of which some number is traced.

    Raises:
        ValueError: where it asks for what only numbers have.
    """
    from erosion.ode.solve import checked_times, named_events, shaped

    if wrt or order:
        raise ValueError("Argument `wrt` must be left out where JAX traces: use `jax.grad` and its like.")
    layout, shape = lanes.layout, lanes.shape
    if ts is not None:
        ts = jnp.asarray(ts if _is_traced(ts) else checked_times(lanes, ts), float)
        if ts.ndim != 1:
            raise ValueError(f"Argument `ts` must be one row of times, but has shape {ts.shape}.")
    wanted = Wanted(layout, rtol, 0 if ts is None or by_xla() else ts.size)
    own = [len(numbers) for numbers in wanted.shapes]
    # Where `ts` alone is traced the numbers have one axis of lanes already.
    numbers = [
        jnp.reshape(number, shape) if np.ndim(number) > ndim and np.shape(number) == (lanes.size,) else number
        for number, ndim in zip(lanes.numbers, own, strict=False)
    ]
    lanes = lanes._replace(numbers=numbers)

    def many(wanted: Wanted, numbers: Sequence[Number]) -> tuple[Array, Array]:
        """The ends of all lanes, each with its numbers."""
        flat, axes = [], []
        for number, ndim in zip(numbers, own, strict=False):
            varies = jnp.ndim(number) > ndim
            flat.append(jnp.ravel(jnp.broadcast_to(number, shape)) if varies else number)
            axes.append(0 if varies else None)
        if all(axis is None for axis in axes):
            vector, codes = traced_end(wanted, flat)
            return jnp.broadcast_to(vector, (*shape, vector.size)), jnp.broadcast_to(codes, (*shape, codes.size))
        vectors, codes = jax.vmap(lambda one: traced_end(wanted, one), (axes,))(flat)
        return vectors.reshape(*shape, vectors.shape[-1]), codes.reshape(*shape, codes.shape[-1])

    rising = [] if ts is None or not wanted.times else [ts[jnp.argsort(ts)]]
    vector, codes = many(wanted, [*lanes.numbers, *rising])
    clock = layout.clock(lanes.numbers)
    t0 = jnp.broadcast_to(jnp.asarray(clock.t0), shape)
    vector, at_times = vector[..., : layout.rows], vector[..., layout.rows :]
    part = shaped(lanes, vector[..., 0], [vector[..., i] for i in range(1, layout.rows)])
    # To the last digit: t0 + (t1 - t0) may be another number.
    t = jnp.where(codes[..., 0] == layout.end_names.index("t1"), clock.t1, part.t + t0)
    solution = Solution(
        problem=layout.problem, names=layout.end_names, wrt=(), outcome=codes[..., 0], t=t, y=part.y,
        integrals=part.integrals, count=codes[..., 1], trials=codes[..., 2],
        at_once=named_events(lanes, [codes[..., i] > 0 for i in range(3, codes.shape[-1])]), derivatives={},
        lanes=lanes, rtol=rtol, digest=layout.equations.digest,
    )  # fmt: skip
    if ts is None:
        return solution
    if wanted.times or not ts.size:
        rows = at_times.reshape(*shape, ts.size, layout.rows - 1)[..., jnp.argsort(jnp.argsort(ts)), :]
        is_within = (ts >= t0[..., None]) & (ts <= t[..., None])
        vectors = jnp.where(is_within[..., None], rows, jnp.nan)
        return solution.with_times(_times_of(lanes, ts, vectors))
    place = len(lanes.numbers) - len(Clock._fields) + Clock._fields.index("t1")

    def at(time: Array) -> Array:
        numbers: list[Number] = list(lanes.numbers)
        numbers[place] = jnp.clip(time, t0, t)
        vector, codes = many(wanted, numbers)
        known = (time >= t0) & (time <= t) & ~layout.has_no_result(codes[..., 0])
        return jnp.where(known[..., None], vector[..., 1:], jnp.nan)

    return solution.with_times(_times_of(lanes, ts, jax.vmap(at, out_axes=-2)(ts)))


def _is_traced(ts: Any) -> bool:
    return any(isinstance(each, Tracer) for each in jax.tree.leaves(ts))


def _times_of(lanes: "Lanes", times: Any, vectors: Array) -> Times:
    """States at times from the outputs there, shape (…, times, outputs)."""
    from erosion.ode.solve import shaped

    wide = lanes._replace(shape=(*lanes.shape, len(times)))
    of_times = shaped(wide, vectors[..., 0], [vectors[..., i] for i in range(vectors.shape[-1])])
    return Times(times, of_times.y, of_times.integrals)


def _rows(end: LaneEnd, kind: str) -> list[Any]:
    time, outputs = (getattr(part, kind) for part in (end.time, end.outputs))
    return [time, *outputs]


def _codes(end: LaneEnd) -> list[Any]:
    """Outcome, number of events, steps tried, and for each event whether it happens at the end."""
    count = 0 * end.trials if end.count is None else end.count
    return [end.outcome, count, end.trials, *end.at_once]


def _kind(order: int) -> str:
    return ("value", "first", "second")[order]


def _solve(wanted: Wanted, numbers: Sequence[Number], order: int, places: _Places) -> Any:
    """The row of numbers, and codes; or the derivatives along each direction, shape (rows, directions)."""
    layout, rtol, _ = wanted
    # XLA has no states at times.
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
    rows = wanted.rows
    codes = len(("outcome", "count", "trials")) + (len(layout.event_names) if layout.options.clock else 0)
    if places:
        shape: Any = jax.ShapeDtypeStruct((rows, len(places)), np.float64)
    else:
        shape = jax.ShapeDtypeStruct((rows,), np.float64), jax.ShapeDtypeStruct((codes,), np.int32)
    compile_ahead(layout, order, len(places[0]) if places else 0, timed=wanted.times > 0)
    on_host = _callback(wanted, layout.equations, order, places)
    return jax.pure_callback(on_host, shape, *numbers, vmap_method="expand_dims")


@functools.lru_cache(maxsize=256)
def _callback(wanted: Wanted, equations: Equations, order: int, places: _Places) -> Callable[..., Any]:
    """The same object each time, as JAX compiles a program for each; but each problem follows its own code."""
    return functools.partial(_on_host, wanted, order, places)


def _on_host(wanted: Wanted, order: int, places: _Places, *given: Number) -> Any:
    """`_solve` by the batch, for numbers that may have axes of `vmap` before their own."""
    layout, rtol, _ = wanted
    arrays = [np.asarray(number) for number in given]
    leading = [array.shape[: array.ndim - len(shape)] for array, shape in zip(arrays, wanted.shapes, strict=True)]
    batch = np.broadcast_shapes(*leading)
    lanes = math.prod(batch)
    numbers = [
        array.reshape(shape)
        if math.prod(before) == 1
        else np.broadcast_to(array, (*batch, *shape)).reshape(lanes, *shape)
        for array, before, shape in zip(arrays, leading, wanted.shapes, strict=True)
    ]
    times = numbers.pop() if wanted.times else None
    if not places:
        end = integrate(layout, numbers, lanes, 0, (), rtol, times=times)
        keep(layout, numbers, end, rtol)
        vector = np.stack(_rows(end, "value"), -1)
        if end.saved is not None:
            vector = np.concatenate([vector, end.saved[:, :, 0].reshape(lanes, -1)], -1)
        return vector.reshape(*batch, -1), np.stack(_codes(end), -1).astype(np.int32).reshape(*batch, -1)
    end = integrate_along(layout, numbers, lanes, order, np.array(places, float).T, rtol, times=times)
    slopes = np.stack(_rows(end, _kind(order)), 1)
    if times is not None and end.saved is not None:
        # What comes before a lane's start or after its end is no number, and has no cotangents.
        t0 = np.reshape(layout.clock(numbers).t0, (-1, 1, 1))
        outside = (times.reshape(-1, 1, wanted.times) < t0) | ~np.isfinite(end.saved[:, :, :, 0]).all(-1)
        saved = np.where(outside[..., None], 0.0, end.saved[:, :, :, -1])
        slopes = np.concatenate([slopes, np.moveaxis(saved, 1, -1).reshape(lanes, -1, len(places))], 1)
    return slopes.reshape(*batch, -1, len(places))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _end(wanted: Wanted, numbers: list[Number]) -> tuple[Array, Array]:
    return _solve(wanted, numbers, 0, ())


@functools.partial(_end.defjvp, symbolic_zeros=True)
def _end_jvp(wanted: Wanted, primals: _Numbers, tangents: _Numbers) -> Any:
    (numbers,), (rates,), layout = primals, tangents, wanted.layout
    moving = _moving(layout, rates)
    elements, moved = _elements(layout, moving), [jnp.asarray(rates[i]) for i in moving]
    goes_back = is_worth(layout, len(elements))
    vector, codes = _end(wanted._replace(layout=layout.wanting(records=goes_back)), numbers)
    still = np.zeros(codes.shape, jax.dtypes.float0)
    along = jnp.zeros(wanted.rows)
    if goes_back:
        along = pushes.pushed(pushes.EndFunction(wanted, moving, _slopes), numbers, moved)
    elif elements:
        along = _slopes(wanted, elements, numbers) @ _flat(moved)
    if _times_move(wanted, rates):
        along = along + _ending_at_times(wanted, numbers, ())[:, 0] * _of_rows(wanted, rates[-1])
    return (vector, codes), (along, still)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _slopes(wanted: Wanted, elements: tuple[int, ...], numbers: list[Number]) -> Array:
    """The row's derivatives by element i for each i of `elements`, shape (rows, elements)."""
    return _solve(wanted, numbers, 1, tuple((i,) for i in elements))


@functools.partial(_slopes.defjvp, symbolic_zeros=True)
def _slopes_jvp(
    wanted: Wanted, elements: tuple[int, ...], primals: _Numbers, tangents: _Numbers
) -> tuple[Array, Array]:
    (numbers,), (rates,) = primals, tangents
    moving, slopes = _moving(wanted.layout, rates), _slopes(wanted, elements, numbers)
    along = jnp.zeros(slopes.shape)
    if moving:
        others, moved = _elements(wanted.layout, moving), _flat([jnp.asarray(rates[i]) for i in moving])
        along = _curvatures(wanted, elements, others, numbers) @ moved
    if _times_move(wanted, rates):
        along = along + _ending_at_times(wanted, numbers, elements) * _of_rows(wanted, rates[-1])[:, None]
    return slopes, along


def _times_move(wanted: Wanted, rates: list[PyTree]) -> bool:
    """Whether the times at which outputs are wanted have tangents."""
    return wanted.times > 0 and not isinstance(rates[-1], _zero)


def _of_rows(wanted: Wanted, rates: Array) -> Array:
    """What times change by, for each number of a row."""
    return jnp.concatenate([jnp.zeros(wanted.layout.rows), jnp.repeat(rates, wanted.layout.rows - 1)])


def _ending_at_times(wanted: Wanted, numbers: Sequence[Number], elements: tuple[int, ...]) -> Array:
    """The derivatives of the outputs at times by these, or those of their derivatives by elements; zero for the end.

    They are taken from lanes that end there: a rate at a state of a stiff motion has few digits.

    Args:
        wanted: of a lane, with times.
        numbers: of the lane, and its times.
        elements: none for the outputs themselves.

    Returns:
        Shape (rows, elements), or (rows, 1) for none.
    """
    layout, (*own, times), alone = wanted.layout, numbers, wanted._replace(times=0)
    clock = layout.clock(own)
    place = len(own) - len(Clock._fields) + Clock._fields.index("t1")
    of_t1 = layout.offsets[place]

    def at(time: Array) -> Array:
        within = (time >= clock.t0) & (time <= clock.t1)
        ending = [*own[:place], jnp.where(within, time, clock.t1), *own[place + 1 :]]
        if not elements:
            slopes = _slopes(alone, (of_t1,), ending)[1:]
        else:
            # A given time does not change with the lane's own end.
            still = np.array([element == of_t1 for element in elements])
            slopes = jnp.where(still, 0.0, _curvatures(alone, elements, (of_t1,), ending)[1:, :, 0])
        return jnp.where(within, slopes, 0.0)

    along = jax.vmap(at)(jnp.asarray(times))
    along = along.reshape(-1, along.shape[-1])
    return jnp.concatenate([jnp.zeros((layout.rows, along.shape[1])), along])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _curvatures(wanted: Wanted, elements: tuple[int, ...], others: tuple[int, ...], numbers: list[Number]) -> Array:
    """∂²/∂(element i)∂(element j), i of `elements` and j of `others`; shape (rows, elements, others)."""
    # One direction twice is cheaper than a pair.
    alone = elements == others and len(elements) == 1
    pairs = (elements,) if alone else tuple(itertools.product(elements, others))
    return _solve(wanted, numbers, 2, pairs).reshape(-1, len(elements), len(others))


@_curvatures.defjvp
def _curvatures_jvp(*_: Any) -> NoReturn:
    raise NotImplementedError("There are derivatives of ends up to the second; the third is not available.")


def _moving(layout: Layout, rates: list[PyTree]) -> tuple[int, ...]:
    """The numbers whose tangents are not zero by construction."""
    pairs = enumerate(zip(rates, layout.dtypes, strict=False))
    return tuple(i for i, (rate, dtype) in pairs if dtype == "float64" and not isinstance(rate, _zero))


def _elements(layout: Layout, numbers: Sequence[int]) -> tuple[int, ...]:
    """The elements of some numbers."""
    return tuple(j for i in numbers for j in range(layout.offsets[i], layout.offsets[i + 1]))


def _flat(parts: Sequence[Array]) -> Array:
    return jnp.concatenate([jnp.ravel(part) for part in parts])
