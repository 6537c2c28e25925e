"""Ends of lanes as numbers that JAX can trace: a callback into the batch, with rules for derivatives both ways."""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import PyTree

from erosion.arguments import Number
from erosion.ode.batch import compile_ahead, integrate, integrate_along
from erosion.ode.ensemble import Lanes, named_events, shaped
from erosion.ode.gradient import AtTimes, ends_of, gradient, is_worth, keep, summed
from erosion.ode.integrator import LaneEnd
from erosion.ode.problem import TracedProblem
from erosion.ode.solution import Solution, Times
from erosion.ode.variational import Clock, Layout

# For each derivative the places of one or two elements, see `Variational`.
_Places = tuple[tuple[int, ...], ...]


class Wanted(NamedTuple):
    """What is wanted of lanes.

    Args:
        layout: of problem and arguments.
        rtol: relative tolerance.
        times: at how many times outputs are wanted as well; these follow the numbers of a lane, rising.
        moving: which numbers have tangents, where derivatives go back.
    """

    layout: Layout
    rtol: float
    times: int = 0
    moving: tuple[int, ...] = ()

    @property
    def rows(self) -> int:
        """The time at the end, the outputs there, and those at times."""
        return self.layout.rows + self.times * (self.layout.rows - 1)

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of the numbers of a lane, and of its times."""
        return (*self.layout.shapes, *([(self.times,)] if self.times else []))


_KINDS = ("value", "first", "second")  # of `Derivatives`, by their order
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


def traced_solution(lanes: Lanes, wrt: Sequence[str], order: int, rtol: float, ts: Any) -> Solution:
    """The solution of lanes of which some number is traced.

    Raises:
        ValueError: where it asks for what only numbers have.
    """
    if wrt or order:
        raise ValueError("Argument `wrt` must be left out where JAX traces: use `jax.grad` and its like.")
    layout, shape = lanes.layout, lanes.shape
    if ts is not None:
        ts = jnp.asarray(ts, float)
        if ts.ndim != 1:
            raise ValueError(f"Argument `ts` must be one row of times, but has shape {ts.shape}.")
    wanted = Wanted(layout, rtol, 0 if ts is None else ts.size)
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
    t = layout.end_times(lanes.numbers, codes[..., 0], part.t)
    solution = Solution(
        problem=layout.problem, names=layout.end_names, wrt=(), outcome=codes[..., 0], t=t, y=part.y,
        integrals=part.integrals, count=codes[..., 1], trials=codes[..., 2],
        at_once=named_events(lanes, [codes[..., i] > 0 for i in range(3, codes.shape[-1])]), derivatives={},
        lanes=lanes, rtol=rtol, digest=layout.equations.digest,
    )  # fmt: skip
    if ts is None:
        return solution
    rows = at_times.reshape(*shape, ts.size, layout.rows - 1)[..., jnp.argsort(jnp.argsort(ts)), :]
    is_within = (ts >= t0[..., None]) & (ts <= t[..., None])
    vectors = jnp.where(is_within[..., None], rows, jnp.nan)
    return solution.with_times(_times_of(lanes, ts, vectors))


def _times_of(lanes: Lanes, times: Any, vectors: Array) -> Times:
    """States at times from the outputs there, shape (…, times, outputs)."""
    wide = lanes._replace(shape=(*lanes.shape, len(times)))
    of_times = shaped(wide, vectors[..., 0], [vectors[..., i] for i in range(vectors.shape[-1])])
    return Times(times, of_times.y, of_times.integrals)


def _codes(end: LaneEnd) -> list[Any]:
    """Outcome, number of events, steps tried, and for each event whether it happens at the end."""
    count = 0 * end.trials if end.count is None else end.count
    return [end.outcome, count, end.trials, *end.at_once]


def _solve(wanted: Wanted, numbers: Sequence[Number], order: int, places: _Places) -> Any:
    """The row of numbers, and codes; or the derivatives along each direction, shape (rows, directions)."""
    layout, rows = wanted.layout, wanted.rows
    codes = len(("outcome", "count", "trials")) + (len(layout.event_names) if layout.options.clock else 0)
    if places:
        shape: Any = jax.ShapeDtypeStruct((rows, len(places)), np.float64)
    else:
        shape = jax.ShapeDtypeStruct((rows,), np.float64), jax.ShapeDtypeStruct((codes,), np.int32)
    compile_ahead(layout, order, len(places[0]) if places else 0, timed=wanted.times > 0)
    on_host = _callback(_on_host, layout.equations, wanted, order, places)
    return jax.pure_callback(on_host, shape, *numbers, vmap_method="expand_dims")


@functools.lru_cache(maxsize=512)
def _callback(function: Callable[..., Any], equations: TracedProblem, *key: Any) -> Callable[..., Any]:
    """The same object each time, as JAX compiles a program for each; but each problem follows its own code."""
    return functools.partial(function, *key)


def _on_host(wanted: Wanted, order: int, places: _Places, *given: Number) -> Any:
    """`_solve` by the batch, for numbers that may have axes of `vmap` before their own."""
    layout, rtol, *_ = wanted
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
        vector = np.stack(end.quantities.value, -1)
        if end.saved is not None:
            vector = np.concatenate([vector, end.saved[:, :, 0].reshape(lanes, -1)], -1)
        return vector.reshape(*batch, -1), np.stack(_codes(end), -1).astype(np.int32).reshape(*batch, -1)
    end = integrate_along(layout, numbers, lanes, order, np.array(places, float).T, rtol, times=times)
    slopes = np.stack(getattr(end.quantities, _KINDS[order]), 1)
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
        along = _push.bind(*numbers, *moved, wanted=wanted._replace(moving=moving), axes=0)
    elif elements:
        along = _slopes(wanted, elements, numbers) @ _flat(0, moved)
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
        others, moved = _elements(wanted.layout, moving), _flat(0, [jnp.asarray(rates[i]) for i in moving])
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


# `_push` gives the tangents of time and outputs. It is linear in those of the numbers, and `_pull` is its transpose: so
# JAX goes forwards in `jvp`, `jacfwd` and `hessian`, and backwards in `grad`, `vjp` and `jacrev`. Both take numbers
# with axes of `vmap` before their own, each of length 1 where they are the same along it, and `_pull` sums along them.
_push, _pull = Primitive("erosion_push"), Primitive("erosion_pull")
_pull.multiple_results = True


def _leading(axes: int, arrays: Sequence[Any]) -> tuple[int, ...]:
    """The axes of `vmap` before those of the numbers and what follows them."""
    return np.broadcast_shapes(*(np.shape(array)[:axes] for array in arrays))


def _slopes_along(wanted: Wanted, axes: int, numbers: Sequence[Any]) -> Array:
    """The derivatives forwards, shape (…, rows, elements), of the numbers' own axes of `vmap`."""
    if axes == 0:
        return _slopes(wanted._replace(moving=()), _elements(wanted.layout, wanted.moving), list(numbers))
    varies = [array.shape[0] != 1 for array in numbers]
    within = functools.partial(_slopes_along, wanted, axes - 1)
    if not any(varies):
        return within([array[0] for array in numbers])[None]
    given = [array if many else array[0] for array, many in zip(numbers, varies, strict=True)]
    return jax.vmap(within, ([0 if many else None for many in varies],))(given)


def _flat(axes: int, parts: Sequence[Any]) -> Array:
    """Tangents of numbers as those of elements, shape (…, elements)."""
    leading = _leading(axes, parts)
    flat = []
    for part in parts:
        size = math.prod(part.shape[axes:])
        flat.append(jnp.broadcast_to(part.reshape(*part.shape[:axes], size), (*leading, size)))
    return jnp.concatenate(flat, axis=-1)


def _push_forwards(*arrays: Any, wanted: Wanted, axes: int) -> Array:
    numbers, tangents = arrays[: len(wanted.shapes)], arrays[len(wanted.shapes) :]
    slopes, flat = _slopes_along(wanted, axes, numbers), _flat(axes, tangents)
    made = jnp.einsum("...re,...e->...r", slopes, flat)
    return jnp.broadcast_to(made, (*_leading(axes, arrays), wanted.rows))


def _pull_forwards(*arrays: Any, wanted: Wanted, axes: int, shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """The transpose of `_push_forwards`."""
    *numbers, bars = arrays
    flat = jnp.einsum("...re,...r->...e", _slopes_along(wanted, axes, numbers), bars)
    leading, made, first = flat.shape[:-1], [], 0
    for shape in shapes:
        size = math.prod(shape[axes:])
        part, first = flat[..., first : first + size], first + size
        same = tuple(i for i, (length, all_) in enumerate(zip(shape, leading, strict=False)) if length != all_)
        made.append(part.sum(same, keepdims=True).reshape(shape))
    return made


def _pull_back(*arrays: Any, wanted: Wanted, axes: int, shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    results = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
    on_host = _callback(_pulled_on_host, wanted.layout.equations, wanted, axes, shapes)
    return jax.pure_callback(on_host, results, *arrays)


def _pulled_on_host(wanted: Wanted, axes: int, shapes: tuple[tuple[int, ...], ...], *given: Any) -> list[np.ndarray]:
    layout = wanted.layout
    *numbers, bars = (np.asarray(array) for array in given)
    leading = _leading(axes, [*numbers, bars])
    lanes, asked = math.prod(leading), dict(zip(wanted.moving, shapes, strict=True))
    flat = []
    for i, (array, own) in enumerate(zip(numbers, wanted.shapes, strict=True)):
        # A number that all lanes share, and whose derivative is the sum over them.
        together = math.prod(array.shape[:axes]) == 1 == math.prod(asked.get(i, ())[:axes])
        flat.append(array.reshape(own) if together else np.broadcast_to(array, (*leading, *own)).reshape(lanes, *own))
    of_lanes = np.broadcast_to(bars, (*leading, wanted.rows)).reshape(lanes, wanted.rows).T
    # A row of `jacrev` counts in one lane of all.
    some = np.flatnonzero(np.any(of_lanes != 0, axis=0))
    times = np.broadcast_to(flat.pop(), (lanes, wanted.times))[some] if wanted.times else None
    given_some, bars = layout.of_lanes(flat, some), of_lanes[:, some]
    ended, at = ends_of(layout, given_some, some.size, wanted.rtol, times), None
    if times is not None:
        bars, of_times = bars[: layout.rows], bars[layout.rows :].T.reshape(some.size, times.shape[1], layout.rows - 1)
        at = AtTimes.of(times, of_times, ended)
    found = gradient(layout, given_some, some.size, ended, bars, spoils=True, at=at)
    made = []
    for i, shape in asked.items():
        part, own = found[i], layout.shapes[i]
        if part.ndim > len(own):
            part = np.zeros((lanes, *own))
            part[some] = found[i]
            part = part.reshape(*leading, *own)
            for axis, length in enumerate(shape[:axes]):
                if length != leading[axis]:
                    part = np.expand_dims(summed(np.moveaxis(part, axis, 0)), axis)
        made.append(part.reshape(shape))
    return made


def _batched(arrays: Sequence[Any], dims: Sequence[int | None]) -> list[Any]:
    """Arrays with one axis more in front."""
    return [
        jnp.expand_dims(array, 0) if dim is None else jnp.moveaxis(array, dim, 0)
        for array, dim in zip(arrays, dims, strict=True)
    ]


def _push_batched(arrays: Sequence[Any], dims: Sequence[Any], *, wanted: Wanted, axes: int) -> tuple[Any, int]:
    return _push.bind(*_batched(arrays, dims), wanted=wanted, axes=axes + 1), 0


def _pull_batched(
    arrays: Sequence[Any], dims: Sequence[Any], *, wanted: Wanted, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> tuple[Any, list[int]]:
    given = _batched(arrays, dims)
    (length,) = np.broadcast_shapes(*(array.shape[:1] for array in given))
    wide = tuple((length, *shape) for shape in shapes)
    return _pull.bind(*given, wanted=wanted, axes=axes + 1, shapes=wide), [0] * len(shapes)


def _moved(forwards: Callable[..., Any], numbers: Sequence[Any], rates: Sequence[Any], rest: Any) -> Any:
    """What changes with the numbers alone, by derivatives forwards; None where none moves."""
    moving = [i for i, rate in enumerate(rates) if type(rate) is not ad.Zero and rate.dtype == np.float64]
    if not moving:
        return None

    def of(*some: Any) -> Any:
        given = list(numbers)
        for i, one in zip(moving, some, strict=True):
            given[i] = one
        return forwards(*given, *rest)

    return jax.jvp(of, [numbers[i] for i in moving], [rates[i] for i in moving])[1]


def _push_jvp(primals: Sequence[Any], rates: Sequence[Any], **params: Any) -> tuple[Any, Any]:
    count = len(params["wanted"].shapes)
    numbers, tangents = primals[:count], primals[count:]
    made = _push.bind(*primals, **params)
    change = _moved(functools.partial(_push_forwards, **params), numbers, rates[:count], tangents)
    if any(type(rate) is not ad.Zero for rate in rates[count:]):
        along = _push.bind(*numbers, *map(ad.instantiate_zeros, rates[count:]), **params)
        change = along if change is None else change + along
    return made, jnp.zeros_like(made) if change is None else change


def _pull_jvp(primals: Sequence[Any], rates: Sequence[Any], **params: Any) -> tuple[Any, Any]:
    *numbers, bars = primals
    made = _pull.bind(*primals, **params)
    changes = _moved(functools.partial(_pull_forwards, **params), numbers, rates[:-1], [bars])
    if type(rates[-1]) is not ad.Zero:
        along = _pull.bind(*numbers, rates[-1], **params)
        changes = along if changes is None else [one + other for one, other in zip(changes, along, strict=True)]
    return made, [jnp.zeros_like(each) for each in made] if changes is None else changes


def _push_transposed(bars: Any, *arrays: Any, wanted: Wanted, axes: int) -> list[Any]:
    numbers, tangents = arrays[: len(wanted.shapes)], arrays[len(wanted.shapes) :]
    unknown = [ad.is_undefined_primal(each) for each in tangents]
    shapes = tuple(
        each.aval.shape if undefined else each.shape for each, undefined in zip(tangents, unknown, strict=True)
    )
    found = _pull.bind(*numbers, bars, wanted=wanted, axes=axes, shapes=shapes)
    return [None] * len(numbers) + [part if undefined else None for part, undefined in zip(found, unknown, strict=True)]


def _pull_transposed(
    tangents: Sequence[Any], *arrays: Any, wanted: Wanted, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> list[Any]:
    *numbers, bars = arrays
    made = _push.bind(*numbers, *map(ad.instantiate_zeros, tangents), wanted=wanted, axes=axes)
    same = tuple(i for i in range(axes) if bars.aval.shape[i] != made.shape[i])
    return [None] * len(numbers) + [made.sum(same, keepdims=True)]


def _define(
    primitive: Primitive,
    forwards: Callable[..., Any],
    shape: Callable[..., Any],
    batched: Any,
    jvp: Any,
    transposed: Any,
) -> None:
    primitive.def_abstract_eval(shape)
    # JAX compiles it where it is called by itself.
    compiled = functools.lru_cache(256)(lambda params: jax.jit(functools.partial(forwards, **dict(params))))
    primitive.def_impl(lambda *arrays, **params: compiled(tuple(params.items()))(*arrays))
    mlir.register_lowering(primitive, mlir.lower_fun(forwards, multiple_results=primitive.multiple_results))
    batching.primitive_batchers[primitive] = batched
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transposed


_define(
    _push,
    _push_forwards,
    lambda *arrays, wanted, axes: ShapedArray((*_leading(axes, arrays), wanted.rows), np.dtype(np.float64)),
    _push_batched,
    _push_jvp,
    _push_transposed,
)
_define(
    _pull,
    _pull_back,
    lambda *arrays, wanted, axes, shapes: [ShapedArray(shape, np.dtype(np.float64)) for shape in shapes],
    _pull_batched,
    _pull_jvp,
    _pull_transposed,
)
