"""Ends of lanes as numbers that JAX can trace: primitives that call the batch, with rules for derivatives both ways.

All of them take numbers with `axes` axes of `vmap` before their own, each of length 1 where they are the same along it.
They are primitives and no functions with rules of derivatives, which JAX forgets within loops. Their programs call
Python directly: `jax.pure_callback` puts each number on a device and takes it back, which takes as long as a lane.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import ShapedArray, Tracer
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from erosion.arguments import Number
from erosion.lanes.flatten import is_large
from erosion.ode.batch import compile_ahead, integrate, integrate_along
from erosion.ode.ensemble import Lanes, named_events, shaped
from erosion.ode.event_log import Passed, passed
from erosion.ode.gradient import AtTimes, ends_of, gradient, is_worth, keep, summed
from erosion.ode.integrator import LaneEnd
from erosion.ode.methods import METHODS
from erosion.ode.problem import TracedProblem
from erosion.ode.prompt import FEW, PromptCalls
from erosion.ode.signature import Clock, Signature
from erosion.ode.solution import INEXACT, Solution, Times

_Along = tuple[tuple[int, ...], ...]
"""The elements by which derivatives are taken: none, some, or some and others for second ones."""


class WantedOutputs(NamedTuple):
    """What is wanted of lanes.

    Args:
        signature: of problem and arguments.
        equations: of the problem; equal signatures of two problems differ by them, as each follows its own code.
        rtol: relative tolerance.
        times: at how many times outputs are wanted as well; these follow the numbers of a lane, rising.
        events: how many events of a lane with resets are wanted as well.
        moving: which numbers have tangents, where derivatives go back.
    """

    signature: Signature
    equations: TracedProblem
    rtol: float
    times: int = 0
    events: int = 0
    moving: tuple[int, ...] = ()

    @property
    def rows(self) -> int:
        """The time at the end, the outputs there, and those at times, or both of events."""
        return self.signature.rows + self.times * (self.signature.rows - 1) + self.events * self.signature.rows

    @property
    def codes(self) -> int:
        """Those of the end, and of each event its index and whether each of all happens there."""
        events = len(self.signature.options.outputs.of_events(0, self.signature.event_names, 0.0)[1])
        return _BESIDE + events + self.events * (1 + events)

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of the numbers of a lane, and of its times."""
        return (*self.signature.shapes, *([(self.times,)] if self.times else []))


_KINDS = ("value", "by_first", "mixed")  # of `Derivatives`, by their order


def traced_solution(lanes: Lanes, wrt: Sequence[str], order: int, rtol: float, ts: Any) -> Solution:
    """The solution of lanes of which some number is traced.

    Raises:
        ValueError: where it asks for what only numbers have.
    """
    if wrt or order:
        raise ValueError("Argument `wrt` must be left out where JAX traces: use `jax.grad` and its like.")
    signature, shape = lanes.signature, lanes.shape
    if ts is not None:
        ts = jnp.asarray(ts, float)
        if ts.ndim != 1:
            raise ValueError(f"Argument `ts` must be one row of times, but has shape {ts.shape}.")
    wanted = WantedOutputs(signature, signature.equations, rtol, 0 if ts is None else ts.size)
    lanes, vector, codes = _computed(lanes, wanted, [] if ts is None or not wanted.times else [ts[jnp.argsort(ts)]])
    clock = signature.clock(lanes.parameters)
    t0 = jnp.broadcast_to(jnp.asarray(clock.t0), shape)
    vector, at_times = vector[..., : signature.rows], vector[..., signature.rows :]
    part = shaped(lanes, vector[..., 0], [vector[..., i] for i in range(1, signature.rows)])
    t = signature.end_times(lanes.parameters, codes[..., 0], part.t)
    solution = Solution(
        problem=signature.problem, names=signature.end_names, wrt=(), outcome=codes[..., 0], t=t, y=part.y,
        integrals=part.integrals, count=codes[..., 1], trials=codes[..., 2],
        at_once=named_events(lanes, [codes[..., i] > 0 for i in range(_BESIDE, codes.shape[-1])]), derivatives={},
        inexact=codes[..., 3] > 0,
        lanes=lanes, rtol=rtol, digest=signature.equations.digest,
    )  # fmt: skip
    if ts is None:
        return solution
    rows = at_times.reshape(*shape, ts.size, signature.rows - 1)[..., jnp.argsort(jnp.argsort(ts)), :]
    is_within = (ts >= t0[..., None]) & (ts <= t[..., None])
    vectors = jnp.where(is_within[..., None], rows, jnp.nan)
    return solution.with_times(_times_of(lanes, ts, vectors))


def _computed(lanes: Lanes, wanted: WantedOutputs, rising: Sequence[Array]) -> tuple[Lanes, Array, Array]:
    """The lanes with numbers of their shape, and the row of each and its codes; of times where they are `rising`."""
    signature, shape = lanes.signature, lanes.shape
    # Where `ts` alone is traced the numbers have one axis of lanes already.
    parameters = [
        jnp.reshape(number, shape) if np.shape(number) == (lanes.size,) and own == () else number
        for number, own in zip(lanes.parameters, signature.shapes, strict=True)
    ]
    lanes = lanes._replace(parameters=parameters)  # pyrefly: ignore
    given = []
    for number, own, dtype in zip([*parameters, *rising], wanted.shapes, (*signature.dtypes, "float64"), strict=False):
        array = jnp.asarray(number, dtype)
        given.append(array[None] if array.shape == own else jnp.ravel(jnp.broadcast_to(array, shape)))
    vector, codes = (jnp.broadcast_to(made, (lanes.size, made.shape[-1])) for made in _ends(wanted, 1, (), given))
    vector, codes = (made.reshape(*shape, made.shape[-1]) for made in (vector, codes))
    return lanes, vector, codes


def traced_events(lanes: Lanes, rtol: float) -> Passed:
    """The events on the way of lanes with resets of which some number is traced.

    Raises:
        ValueError: where `max_events` does not say how many rows there are.
    """
    signature, most = lanes.signature, lanes.signature.clock(lanes.parameters).max_events
    if isinstance(most, Tracer) or not np.all(np.isfinite(most)):
        raise ValueError("`events` needs the argument `max_events` where JAX traces, a number: there are as many rows.")
    count = int(np.max(most, initial=1))
    wanted = WantedOutputs(signature, signature.equations, rtol, events=count)
    lanes, vector, codes = _computed(lanes, wanted, [])
    wide = lanes._replace(shape=(*lanes.shape, count))
    there = np.arange(count) < codes[..., 1:2]
    rows = jnp.where(there[..., None], vector[..., signature.rows :].reshape(*wide.shape, signature.rows), jnp.nan)
    t0 = jnp.broadcast_to(jnp.asarray(signature.clock(lanes.parameters).t0), lanes.shape)
    part = shaped(wide, rows[..., 0] + t0[..., None], [rows[..., i] for i in range(1, signature.rows)])
    own = codes[..., WantedOutputs(signature, signature.equations, rtol).codes :].reshape(*wide.shape, -1)
    return passed(lanes, there, [own[..., i] for i in range(own.shape[-1])], part, {})


def _times_of(lanes: Lanes, times: Any, vectors: Array) -> Times:
    """States at times from the outputs there, shape (…, times, outputs)."""
    wide = lanes._replace(shape=(*lanes.shape, len(times)))
    of_times = shaped(wide, vectors[..., 0], [vectors[..., i] for i in range(vectors.shape[-1])])
    return Times(times, of_times.y, of_times.integrals)


_BESIDE = 4  # codes before those of the events


def _codes(end: LaneEnd, rtol: float) -> list[Any]:
    """Outcome, number of events, steps tried, whether it is inexact, and whether each event happens at the end."""
    count = 0 * end.trials if end.count is None else end.count
    return [end.outcome, count, end.trials, np.asarray(end.error) > INEXACT * rtol, *end.at_once]


def traced_end(signature: Signature, rtol: float, parameters: Sequence[Number]) -> Array:
    """Time since the start and outputs of one lane, of whose numbers some may be traced."""
    given = [jnp.asarray(number, dtype) for number, dtype in zip(parameters, signature.dtypes, strict=True)]
    return _ends(WantedOutputs(signature, signature.equations, rtol), 0, (), given)[0]


def _ends(wanted: WantedOutputs, axes: int, along: _Along, parameters: Sequence[Any]) -> list[Array]:
    """The row of each lane and its codes, and its first derivatives, shape (…, rows, elements); or second ones alone.

    These have one more axis.
    """
    directions = len(_places(along)[0]) if along else 0
    compile_ahead(wanted.signature, len(along), directions, timed=wanted.times > 0, logs=wanted.events > 0)
    return _end.bind(*parameters, wanted=wanted, axes=axes, along=along)


def _places(along: _Along) -> list[tuple[int, ...]]:
    """For each derivative the places of one or two elements, see `Variational`."""
    # One direction twice is cheaper than a pair.
    is_alone = len(along) == 2 and along[0] == along[1] and len(along[0]) == 1
    return [along[0]] if is_alone else list(itertools.product(*along))


def _leading(axes: int, arrays: Sequence[Any]) -> tuple[int, ...]:
    """The axes of `vmap` before those of the numbers and what follows them."""
    shapes = {array.shape[:axes] for array in arrays}
    return shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)


def _shapes_of_ends(*parameters: Any, wanted: WantedOutputs, axes: int, along: _Along) -> list[ShapedArray]:
    leading, real, whole = _leading(axes, parameters), np.dtype(np.float64), np.dtype(np.int32)
    values = [ShapedArray((*leading, wanted.rows), real), ShapedArray((*leading, wanted.codes), whole)]
    slopes = [ShapedArray((*leading, wanted.rows, *map(len, along)), real)] if along else []
    return slopes if len(along) == 2 else values + slopes


class _EndsOnHost:
    """`_ends` by the batch, or for a few lanes by calls that are prepared.

    Args:
        wanted, axes, along: see `_ends`.
    """

    def __init__(self, *, wanted: WantedOutputs, axes: int, along: _Along) -> None:
        self._wanted, self._axes, self._along, self._codes = wanted, axes, along, wanted.codes
        self._places = np.array(_places(along), float).T if along else np.empty((0, 1))
        options = wanted.signature.options
        self._is_plain = not (wanted.times or wanted.events or options.records)
        self._is_plain &= len(along) <= METHODS[options.method].derivatives
        self._is_plain &= not any(is_large(ShapedArray(shape, np.dtype(float))) for shape in wanted.shapes)
        self._prompt: dict[int, PromptCalls] = {}

    def __call__(self, *given: np.ndarray) -> list[np.ndarray]:
        """What `_ends` gives for these numbers."""
        signature, wanted, batch = self._wanted.signature.renewed(), self._wanted, _leading(self._axes, given)
        lanes = math.prod(batch)
        parameters = [
            array.reshape(shape)
            if math.prod(array.shape[: self._axes]) == 1
            else np.broadcast_to(array, (*batch, *shape)).reshape(lanes, *shape)
            for array, shape in zip(given, wanted.shapes, strict=True)
        ]
        made = self._promptly(signature, lanes, parameters) or self._by_batch(signature, lanes, parameters)
        return [part.reshape(*batch, *part.shape[1:]) for part in made]

    def _promptly(self, signature: Signature, lanes: int, parameters: list[np.ndarray]) -> list[np.ndarray] | None:
        """The results of a few lanes, if none is doubtful."""
        if not (self._is_plain and 0 < lanes * self._places.shape[1] <= FEW):
            return None
        calls = self._prompt.get(lanes)
        if calls is None or calls.signature is not signature:
            calls = self._prompt[lanes] = PromptCalls(signature, len(self._along), self._places, lanes)
        return calls.run(parameters, self._wanted.rtol, self._read)

    def _by_batch(self, signature: Signature, lanes: int, parameters: list[np.ndarray]) -> list[np.ndarray]:
        """The results of lanes by `integrate`."""
        wanted, rtol, order = self._wanted, self._wanted.rtol, len(self._along)
        times = parameters.pop() if wanted.times else None
        if not order:
            end = integrate(signature, parameters, lanes, 0, (), rtol, times=times, events=wanted.events)
            keep(signature, parameters, end, rtol)
            return self._read(end, end)
        end = integrate_along(
            signature, parameters, lanes, order, self._places, rtol, times=times, events=wanted.events
        )
        outside: Any = False
        if times is not None:
            outside = times.reshape(-1, 1, wanted.times) < np.reshape(signature.clock(parameters).t0, (-1, 1, 1))
        elif wanted.events:
            outside = np.arange(wanted.events) >= end.count[..., None]
        return self._read(jax.tree.map(lambda part: part[:, 0], end), end, outside)

    def _read(self, first: LaneEnd, end: LaneEnd, outside: Any = False) -> list[np.ndarray]:
        """The rows of lanes and their codes, and derivatives.

        Args:
            first: results, shape (lanes,); of several directions the first.
            end: results, shape (lanes, directions).
            outside: which times, or events, are none of the lane.
        """
        made = [] if len(self._along) == 2 else self._values(first)
        if not self._along:
            return made
        kind = _KINDS[len(self._along)]
        slopes = np.stack([getattr(end.time, kind), *getattr(end.outputs, kind)], 1)
        if end.saved is not None:
            # What comes before a lane's start, after its end or last event is no number, and has no cotangents.
            outside = outside | ~np.isfinite(_parted(self._wanted, end.saved[:, :, :, 0])[1]).all(-1)
            saved = np.where(outside[..., None], 0.0, _parted(self._wanted, end.saved[:, :, :, -1])[1])
            saved = np.moveaxis(saved, 1, -1).reshape(len(slopes), -1, slopes.shape[-1])
            slopes = np.concatenate([slopes, saved], 1)
        return [*made, slopes.reshape(*slopes.shape[:2], *map(len, self._along))]

    def _values(self, end: LaneEnd) -> list[np.ndarray]:
        """The row of each lane and its codes."""
        wanted = self._wanted
        vector = np.array([end.time.value, *end.outputs.value]).T
        codes = np.zeros((len(vector), self._codes), np.int32)
        for i, code in enumerate(_codes(end, wanted.rtol)):
            codes[:, i] = code
        if end.saved is not None:
            of_events, saved = _parted(wanted, end.saved[:, :, 0])
            vector = np.concatenate([vector, saved.reshape(len(vector), -1)], -1)
            codes[:, self._codes - of_events[0].size :] = np.nan_to_num(of_events).reshape(len(vector), -1)
        return [vector, codes]


def _parted(wanted: WantedOutputs, saved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is saved as codes and numbers; of events without the last row, which is none of those wanted."""
    codes = 1 + len(wanted.signature.event_names) if wanted.events else 0
    rows = saved[..., : wanted.events, :] if wanted.events else saved
    return rows[..., :codes], rows[..., codes:]


def _ends_jvp(
    parameters: Sequence[Any], rates: Sequence[Any], *, wanted: WantedOutputs, axes: int, along: _Along
) -> tuple[list[Any], list[Any]]:
    """The derivatives forwards, or by `_push` where JAX may go backwards."""
    if len(along) == 2:
        raise NotImplementedError("There are derivatives of ends up to the second; the third is not available.")
    pairs = enumerate(zip(rates, wanted.signature.dtypes, strict=False))
    moving = tuple(i for i, (rate, dtype) in pairs if dtype == "float64" and type(rate) is not ad.Zero)
    elements, moved = _elements(wanted.signature, moving), [rates[i] for i in moving]
    back = not along and not wanted.events and is_worth(wanted.signature, len(elements))
    changes = []
    if back:
        made = _ends(wanted._replace(signature=wanted.signature.wanting(records=True)), axes, along, parameters)
        changes = [_push.bind(*parameters, *moved, wanted=wanted._replace(moving=moving), axes=axes)]
    elif elements:
        # One program has values and first derivatives.
        made = _ends(wanted, axes, along or (elements,), parameters)
        of_values = made if along in ((), (elements,)) else _ends(wanted, axes, (elements,), parameters)
        slopes = [of_values[-1], *(_ends(wanted, axes, (*along, elements), parameters) if along else [])]
        made, changes = made[: 2 + len(along)], [_product(each, _flat(axes, moved), axes) for each in slopes]
    else:
        made = _ends(wanted, axes, along, parameters)
        changes = [jnp.zeros(each.shape) for each in (made[0], *made[2:])]
    if wanted.times and type(rates[-1]) is not ad.Zero:
        changes = [
            change + _along_times(wanted, axes, along[:i], parameters, rates[-1], change.shape)
            for i, change in enumerate(changes)
        ]
    return made, [changes[0], ad.Zero(ShapedArray(made[1].shape, jax.dtypes.float0)), *changes[1:]]


def _along_times(
    wanted: WantedOutputs, axes: int, along: _Along, parameters: Sequence[Any], rates: Any, shape: tuple[int, ...]
) -> Array:
    """The tangents of outputs at times, or of their derivatives, with the times alone; of this shape."""
    leading, (rows, *rest) = shape[:axes], shape[axes:]
    of_rows = jnp.repeat(jnp.broadcast_to(rates, (*leading, wanted.times)), wanted.signature.rows - 1, axis=-1)
    of_rows = jnp.concatenate([jnp.zeros((*leading, wanted.signature.rows)), of_rows], axis=-1)
    slopes = jnp.broadcast_to(_ending_at_times(wanted, axes, along, parameters), (*leading, rows, *rest))
    return _product(slopes[..., None], of_rows[..., None], axes + 1)


def _ending_at_times(wanted: WantedOutputs, axes: int, along: _Along, parameters: Sequence[Any]) -> Array:
    """The derivatives of the outputs at times by these, or those of their derivatives; zero for the end.

    They are taken from lanes that end there: a rate at a state of a stiff motion has few digits.

    Args:
        wanted: of a lane, with times.
        axes: of the numbers.
        along: see `_ends`.
        parameters: of the lane, and its times.

    Returns:
        Shape (…, rows) and one axis for each of `along`.
    """
    signature, (*own, times) = wanted.signature, [jnp.asarray(number) for number in parameters]
    place = len(own) - len(Clock._fields) + Clock._fields.index("t1")
    of_t1 = signature.offsets[place]
    ending = [jnp.expand_dims(number, axes) for number in own]
    clock = signature.clock(ending)
    within = (times >= clock.t0) & (times <= clock.t1)
    ending[place] = jnp.where(within, times, clock.t1)
    *_, slopes = _ends(wanted._replace(times=0), axes + 1, (*along, (of_t1,)), ending)
    slopes = lax.slice_in_dim(slopes[..., 0], 1, None, axis=axes + 1)
    if along:
        # A given time does not change with the lane's own end.
        slopes = jnp.where(np.array([element == of_t1 for element in along[0]]), 0.0, slopes)
    leading, rest = slopes.shape[:axes], slopes.shape[axes + 2 :]
    slopes = jnp.where(within.reshape(*within.shape, *[1] * (1 + len(rest))), slopes, 0.0)
    beginning = jnp.zeros((*leading, signature.rows, *rest))
    return jnp.concatenate([beginning, slopes.reshape(*leading, -1, *rest)], axis=axes)


def _elements(signature: Signature, numbers: Sequence[int]) -> tuple[int, ...]:
    """The elements of some numbers."""
    return tuple(j for i in numbers for j in range(signature.offsets[i], signature.offsets[i + 1]))


def _flat(axes: int, parts: Sequence[Any]) -> Array:
    """Tangents of numbers as those of elements, shape (…, elements)."""
    leading = _leading(axes, parts)
    flat = []
    for part in parts:
        size = math.prod(part.shape[axes:])
        flat.append(jnp.broadcast_to(part.reshape(*part.shape[:axes], size), (*leading, size)))
    return jnp.concatenate(flat, axis=-1)


def _product(matrix: Array, vector: Array, axes: int) -> Array:
    """The product along the last axis: what is times zero counts nothing, even where it is NaN, forwards or backwards.

    So a lane without derivatives that a loss leaves out does not spoil the loss's gradient.

    Args:
        matrix: shape (…, rest, n).
        vector: shape (…, n).
        axes: of …, which broadcast.
    """
    leading = np.broadcast_shapes(matrix.shape[:axes], vector.shape[:axes])
    rest, n = matrix.shape[axes:-1], vector.shape[-1]
    wide = jnp.broadcast_to(matrix, (*leading, *rest, n)).reshape(math.prod(leading), math.prod(rest), n)
    made = _times.bind(wide, jnp.broadcast_to(vector, (*leading, n)).reshape(math.prod(leading), n))
    return made.reshape(*leading, *rest)


# `_end` integrates. `_push` gives the tangents of time and outputs. It is linear in those of the numbers, and `_pull`
# is its transpose: so JAX goes forwards in `jvp`, `jacfwd` and `hessian`, and backwards in `grad`, `vjp` and `jacrev`.
# `_pull` sums along axes of `vmap`. `_times` multiplies matrices (lanes, m, n) by vectors (lanes, n), see `_product`.
_end, _push, _pull, _times = (Primitive(f"erosion_{name}") for name in ("end", "push", "pull", "times"))
_end.multiple_results = _pull.multiple_results = True


def _multiplied(matrix: Array, vector: Array) -> Array:
    return jnp.sum(jnp.where(vector[:, None] == 0, 0.0, matrix * vector[:, None]), axis=-1)


def _times_jvp(primals: Sequence[Any], rates: Sequence[Any]) -> tuple[Array, Any]:
    (matrix, vector), (of_matrix, of_vector) = primals, rates
    change = [] if type(of_matrix) is ad.Zero else [_times.bind(of_matrix, vector)]
    if type(of_vector) is not ad.Zero:
        change.append(_times.bind(matrix, of_vector))
    return _times.bind(matrix, vector), functools.reduce(jnp.add, change)


def _times_transposed(cotangent: Any, matrix: Any, vector: Any) -> list[Any]:
    if ad.is_undefined_primal(matrix):
        return [cotangent[:, :, None] * vector[:, None], None]
    return [None, _times.bind(jnp.swapaxes(matrix, 1, 2), cotangent)]


def _times_batched(arrays: Sequence[Any], dims: Sequence[Any]) -> tuple[Array, int]:
    matrix, vector = _batched(arrays, dims)
    return _product(matrix, vector, 2), 0


def _push_forwards(*arrays: Any, wanted: WantedOutputs, axes: int) -> Array:
    parameters, tangents = arrays[: len(wanted.shapes)], arrays[len(wanted.shapes) :]
    made = _product(_slopes_of(wanted, axes, parameters), _flat(axes, tangents), axes)
    return jnp.broadcast_to(made, (*_leading(axes, arrays), wanted.rows))


def _slopes_of(wanted: WantedOutputs, axes: int, parameters: Sequence[Any]) -> Array:
    """The derivatives forwards by what moves, shape (…, rows, elements)."""
    return _ends(wanted._replace(moving=()), axes, (_elements(wanted.signature, wanted.moving),), parameters)[-1]


def _pull_forwards(*arrays: Any, wanted: WantedOutputs, axes: int, shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """The transpose of `_push_forwards`."""
    *parameters, cotangents = arrays
    flat = _product(jnp.swapaxes(_slopes_of(wanted, axes, parameters), -1, -2), cotangents, axes)
    leading, made, first = flat.shape[:-1], [], 0
    for shape in shapes:
        size = math.prod(shape[axes:])
        part, first = flat[..., first : first + size], first + size
        same = tuple(i for i, (length, all_) in enumerate(zip(shape, leading, strict=False)) if length != all_)
        made.append(part.sum(same, keepdims=True).reshape(shape))
    return made


def _pulled_on_host(
    *given: np.ndarray, wanted: WantedOutputs, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> list[np.ndarray]:
    signature = wanted.signature.renewed()
    *parameters, cotangents = given
    leading = _leading(axes, [*parameters, cotangents])
    lanes, asked = math.prod(leading), dict(zip(wanted.moving, shapes, strict=True))
    flat = []
    for i, (array, own) in enumerate(zip(parameters, wanted.shapes, strict=True)):
        # A number that all lanes share, and whose derivative is the sum over them.
        together = math.prod(array.shape[:axes]) == 1 == math.prod(asked.get(i, ())[:axes])
        flat.append(array.reshape(own) if together else np.broadcast_to(array, (*leading, *own)).reshape(lanes, *own))
    of_lanes = np.broadcast_to(cotangents, (*leading, wanted.rows)).reshape(lanes, wanted.rows).T
    # A row of `jacrev` counts in one lane of all.
    some = np.flatnonzero(np.any(of_lanes != 0, axis=0))
    times = np.broadcast_to(flat.pop(), (lanes, wanted.times))[some] if wanted.times else None
    given_some, cotangents = signature.of_lanes(flat, some), of_lanes[:, some]
    ended, at = ends_of(signature, given_some, some.size, wanted.rtol, times), None
    if times is not None:
        cotangents, of_times = (
            cotangents[: signature.rows],
            cotangents[signature.rows :].T.reshape(some.size, times.shape[1], signature.rows - 1),
        )
        at = AtTimes.of(times, of_times, ended)
    found = gradient(signature, given_some, some.size, ended, cotangents, spoils=True, at=at)
    made = []
    for i, shape in asked.items():
        part, own = found[i], signature.shapes[i]
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


def _ends_batched(
    arrays: Sequence[Any], dims: Sequence[Any], *, wanted: WantedOutputs, axes: int, along: _Along
) -> tuple[list[Any], list[int]]:
    made = _end.bind(*_batched(arrays, dims), wanted=wanted, axes=axes + 1, along=along)
    return made, [0] * len(made)


def _push_batched(arrays: Sequence[Any], dims: Sequence[Any], *, wanted: WantedOutputs, axes: int) -> tuple[Any, int]:
    return _push.bind(*_batched(arrays, dims), wanted=wanted, axes=axes + 1), 0


def _pull_batched(
    arrays: Sequence[Any], dims: Sequence[Any], *, wanted: WantedOutputs, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> tuple[Any, list[int]]:
    given = _batched(arrays, dims)
    (length,) = np.broadcast_shapes(*(array.shape[:1] for array in given))
    wide = tuple((length, *shape) for shape in shapes)
    return _pull.bind(*given, wanted=wanted, axes=axes + 1, shapes=wide), [0] * len(shapes)


def _moved(forwards: Callable[..., Any], parameters: Sequence[Any], rates: Sequence[Any], rest: Any) -> Any:
    """What changes with the numbers alone, by derivatives forwards; None where none moves."""
    moving = [i for i, rate in enumerate(rates) if type(rate) is not ad.Zero and rate.dtype == np.float64]
    if not moving:
        return None

    def of(*some: Any) -> Any:
        given = list(parameters)
        for i, one in zip(moving, some, strict=True):
            given[i] = one
        return forwards(*given, *rest)

    return jax.jvp(of, [parameters[i] for i in moving], [rates[i] for i in moving])[1]


def _push_jvp(primals: Sequence[Any], rates: Sequence[Any], **params: Any) -> tuple[Any, Any]:
    count = len(params["wanted"].shapes)
    parameters, tangents = primals[:count], primals[count:]
    made = _push.bind(*primals, **params)
    change = _moved(functools.partial(_push_forwards, **params), parameters, rates[:count], tangents)
    if any(type(rate) is not ad.Zero for rate in rates[count:]):
        along = _push.bind(*parameters, *map(ad.instantiate_zeros, rates[count:]), **params)
        change = along if change is None else change + along
    return made, jnp.zeros_like(made) if change is None else change


def _pull_jvp(primals: Sequence[Any], rates: Sequence[Any], **params: Any) -> tuple[Any, Any]:
    *parameters, cotangents = primals
    made = _pull.bind(*primals, **params)
    changes = _moved(functools.partial(_pull_forwards, **params), parameters, rates[:-1], [cotangents])
    if type(rates[-1]) is not ad.Zero:
        along = _pull.bind(*parameters, rates[-1], **params)
        changes = along if changes is None else [one + other for one, other in zip(changes, along, strict=True)]
    return made, [jnp.zeros_like(each) for each in made] if changes is None else changes


def _push_transposed(cotangents: Any, *arrays: Any, wanted: WantedOutputs, axes: int) -> list[Any]:
    parameters, tangents = arrays[: len(wanted.shapes)], arrays[len(wanted.shapes) :]
    unknown = [ad.is_undefined_primal(each) for each in tangents]
    shapes = tuple(
        each.aval.shape if undefined else each.shape for each, undefined in zip(tangents, unknown, strict=True)
    )
    found = _pull.bind(*parameters, cotangents, wanted=wanted, axes=axes, shapes=shapes)
    return [None] * len(parameters) + [
        part if undefined else None for part, undefined in zip(found, unknown, strict=True)
    ]


def _pull_transposed(
    tangents: Sequence[Any], *arrays: Any, wanted: WantedOutputs, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> list[Any]:
    *parameters, cotangents = arrays
    made = _push.bind(*parameters, *map(ad.instantiate_zeros, tangents), wanted=wanted, axes=axes)
    same = tuple(i for i in range(axes) if cotangents.aval.shape[i] != made.shape[i])
    return [None] * len(parameters) + [made.sum(same, keepdims=True)]


_host = Primitive("erosion_host")
_host.def_abstract_eval(lambda numbers, *, call, size: ShapedArray((size,), np.dtype(np.float64)))


def _host_lowered(ctx: mlir.LoweringRuleContext, numbers: Any, *, call: Callable[..., Any], size: int) -> Sequence[Any]:
    takes, gives = cast("list[list[ShapedArray]]", [ctx.avals_in, ctx.avals_out])
    return mlir.emit_python_callback(ctx, call, None, [numbers], takes, gives, has_side_effect=False)[0]


mlir.register_lowering(_host, _host_lowered)


def _emitted(
    primitive: Primitive,
    shapes: Callable[..., Sequence[ShapedArray]],
    on_host: Callable[..., Callable[..., list[np.ndarray]]],
) -> None:
    """Let a primitive be computed by a function of arrays, which `on_host` makes of the primitive's parameters.

    Within a program there is one array of all numbers each way: each costs as much time as ten steps of a lane.
    """

    def now(*arrays: Any, **params: Any) -> list[Array]:
        return [jnp.asarray(made) for made in on_host(**params)(*map(np.asarray, arrays))]

    def together(*arrays: Any, **params: Any) -> list[Array]:
        function, made = on_host(**params), shapes(*arrays, **params)
        taken = [(array.shape, np.dtype(array.dtype)) for array in arrays]
        where, _ = _slices(shape for shape, _ in taken)

        def call(numbers: np.ndarray) -> list[np.ndarray]:
            given = [
                numbers[place].reshape(shape).astype(dtype, copy=False)
                for place, (shape, dtype) in zip(where, taken, strict=True)
            ]
            return [np.concatenate([part.ravel() for part in function(*given)], dtype=float)]

        flat = jnp.concatenate([jnp.ravel(array).astype(float) for array in arrays])
        parts, size = _slices(each.shape for each in made)
        found = _host.bind(flat, call=call, size=size)
        return [found[part].reshape(each.shape).astype(each.dtype) for part, each in zip(parts, made, strict=True)]

    primitive.def_impl(now)
    primitive.def_abstract_eval(shapes)
    mlir.register_lowering(primitive, mlir.lower_fun(together, multiple_results=True))


def _slices(shapes: Iterable[tuple[int, ...]]) -> tuple[list[slice], int]:
    """Where arrays of these shapes are that follow each other, and where the last ends."""
    ends = [0, *itertools.accumulate(map(math.prod, shapes))]
    return [slice(*both) for both in itertools.pairwise(ends)], ends[-1]


def _composed(primitive: Primitive, function: Callable[..., Any]) -> None:
    """Let a primitive be computed by others."""
    primitive.def_impl(function)
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=primitive.multiple_results))


_emitted(_end, _shapes_of_ends, _EndsOnHost)
_emitted(
    _pull,
    lambda *arrays, wanted, axes, shapes: [ShapedArray(shape, np.dtype(np.float64)) for shape in shapes],
    functools.partial(functools.partial, _pulled_on_host),
)
_composed(_push, _push_forwards)
_composed(_times, _multiplied)
_push.def_abstract_eval(
    lambda *arrays, wanted, axes: ShapedArray((*_leading(axes, arrays), wanted.rows), np.dtype(np.float64))
)
_times.def_abstract_eval(lambda matrix, vector: ShapedArray(matrix.shape[:-1], np.dtype(np.float64)))
for primitive, batched in (
    (_end, _ends_batched),
    (_push, _push_batched),
    (_pull, _pull_batched),
    (_times, _times_batched),
):
    batching.primitive_batchers[primitive] = batched
for primitive, jvp in ((_end, _ends_jvp), (_push, _push_jvp), (_pull, _pull_jvp), (_times, _times_jvp)):
    ad.primitive_jvps[primitive] = jvp
for primitive, transposed in ((_push, _push_transposed), (_pull, _pull_transposed), (_times, _times_transposed)):
    ad.primitive_transposes[primitive] = transposed
