"""Derivatives of ends inside JAX: forwards along tangents, and backwards from cotangents.

`pushed` is linear in the tangents of the numbers, and `_pull` is its transpose: so JAX goes forwards in `jvp`, `jacfwd`
and `hessian`, and backwards in `grad`, `vjp` and `jacrev`. Both take numbers with axes of `vmap` before their own, each
of length 1 where they are the same along it, and `_pull` sums along these.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.typing import ArrayLike

from erosion.ode.gradient import AtTimes, ends_of, gradient, summed
from erosion.ode.variational import Layout

if TYPE_CHECKING:
    from erosion.ode.traced import Wanted


class EndFunction(NamedTuple):
    """What ends depend on.

    Args:
        wanted: of the lanes, and the layout of their numbers.
        moving: which numbers have tangents.
        slopes: of (wanted, elements, numbers), derivatives of all rows by elements, shape (rows, elements).
    """

    wanted: "Wanted"
    moving: tuple[int, ...]
    slopes: Callable[..., Array]

    @property
    def layout(self) -> Layout:
        """Of the numbers."""
        return self.wanted.layout

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of the numbers of a lane, and of its times."""
        return self.wanted.shapes

    @property
    def rows(self) -> int:
        """How many numbers depend on them."""
        return self.wanted.rows

    @property
    def elements(self) -> tuple[int, ...]:
        """The elements that move."""
        offsets = self.layout.offsets
        return tuple(j for i in self.moving for j in range(offsets[i], offsets[i + 1]))


def pushed(ends: EndFunction, numbers: Sequence[ArrayLike], tangents: Sequence[ArrayLike]) -> Any:
    """The tangents of time and outputs."""
    return _push.bind(*numbers, *tangents, ends=ends, axes=0)


_push, _pull = Primitive("erosion_push"), Primitive("erosion_pull")
_pull.multiple_results = True


def _leading(ends: EndFunction, axes: int, arrays: Sequence[Any]) -> tuple[int, ...]:
    """The axes of `vmap` before those of the numbers and what follows them."""
    return np.broadcast_shapes(*(np.shape(array)[:axes] for array in arrays))


def _slopes(ends: EndFunction, axes: int, numbers: Sequence[Any]) -> Array:
    """The derivatives forwards, shape (…, rows, elements), of the numbers' own axes of `vmap`."""
    if axes == 0:
        return ends.slopes(ends.wanted, ends.elements, list(numbers))
    varies = [array.shape[0] != 1 for array in numbers]
    within = functools.partial(_slopes, ends, axes - 1)
    if not any(varies):
        return within([array[0] for array in numbers])[None]
    given = [array if many else array[0] for array, many in zip(numbers, varies, strict=True)]
    return jax.vmap(within, ([0 if many else None for many in varies],))(given)


def _flat(ends: EndFunction, axes: int, parts: Sequence[Any]) -> Array:
    """Tangents of numbers as those of elements, shape (…, elements)."""
    leading = _leading(ends, axes, parts)
    flat = []
    for part in parts:
        size = math.prod(part.shape[axes:])
        flat.append(jnp.broadcast_to(part.reshape(*part.shape[:axes], size), (*leading, size)))
    return jnp.concatenate(flat, axis=-1)


def _push_forwards(*arrays: Any, ends: EndFunction, axes: int) -> Array:
    numbers, tangents = arrays[: len(ends.shapes)], arrays[len(ends.shapes) :]
    slopes, flat = _slopes(ends, axes, numbers), _flat(ends, axes, tangents)
    made = jnp.einsum("...re,...e->...r", slopes, flat)
    return jnp.broadcast_to(made, (*_leading(ends, axes, arrays), ends.rows))


def _pull_forwards(*arrays: Any, ends: EndFunction, axes: int, shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    """The transpose of `_push_forwards`."""
    *numbers, bars = arrays
    flat = jnp.einsum("...re,...r->...e", _slopes(ends, axes, numbers), bars)
    leading, made, first = flat.shape[:-1], [], 0
    for shape in shapes:
        size = math.prod(shape[axes:])
        part, first = flat[..., first : first + size], first + size
        same = tuple(i for i, (length, all_) in enumerate(zip(shape, leading, strict=False)) if length != all_)
        made.append(part.sum(same, keepdims=True).reshape(shape))
    return made


def _pull_back(*arrays: Any, ends: EndFunction, axes: int, shapes: tuple[tuple[int, ...], ...]) -> list[Array]:
    results = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
    on_host = _callback(ends, ends.layout.equations, axes, shapes)
    return jax.pure_callback(on_host, results, *arrays)


@functools.lru_cache(maxsize=256)
def _callback(ends: EndFunction, equations: Any, axes: int, shapes: tuple[tuple[int, ...], ...]) -> Callable[..., Any]:
    """The same object each time, as JAX compiles a program for each; but each problem follows its own code."""
    return functools.partial(_on_host, ends, axes, shapes)


def _on_host(ends: EndFunction, axes: int, shapes: tuple[tuple[int, ...], ...], *given: Any) -> list[np.ndarray]:
    layout = ends.layout
    *numbers, bars = (np.asarray(array) for array in given)
    leading = _leading(ends, axes, [*numbers, bars])
    lanes, wanted = math.prod(leading), dict(zip(ends.moving, shapes, strict=True))
    flat = []
    for i, (array, own) in enumerate(zip(numbers, ends.shapes, strict=True)):
        # A number that all lanes share, and whose derivative is the sum over them.
        together = math.prod(array.shape[:axes]) == 1 == math.prod(wanted.get(i, ())[:axes])
        flat.append(array.reshape(own) if together else np.broadcast_to(array, (*leading, *own)).reshape(lanes, *own))
    of_lanes = np.broadcast_to(bars, (*leading, ends.rows)).reshape(lanes, ends.rows).T
    # A row of `jacrev` counts in one lane of all.
    some = np.flatnonzero(np.any(of_lanes != 0, axis=0))
    times = np.broadcast_to(flat.pop(), (lanes, ends.wanted.times))[some] if ends.wanted.times else None
    given_some, bars = layout.of_lanes(flat, some), of_lanes[:, some]
    ended, at = ends_of(layout, given_some, some.size, ends.wanted.rtol, times), None
    if times is not None:
        bars, of_times = bars[: layout.rows], bars[layout.rows :].T.reshape(some.size, times.shape[1], layout.rows - 1)
        at = AtTimes.of(times, of_times, layout.clock(given_some).t0, ended)
    found = gradient(layout, given_some, some.size, ended, bars, spoils=True, at=at)
    made = []
    for i, shape in wanted.items():
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


# The rules of both.


def _batched(arrays: Sequence[Any], dims: Sequence[int | None]) -> list[Any]:
    """Arrays with one axis more in front."""
    return [
        jnp.expand_dims(array, 0) if dim is None else jnp.moveaxis(array, dim, 0)
        for array, dim in zip(arrays, dims, strict=True)
    ]


def _push_batched(arrays: Sequence[Any], dims: Sequence[Any], *, ends: EndFunction, axes: int) -> tuple[Any, int]:
    return _push.bind(*_batched(arrays, dims), ends=ends, axes=axes + 1), 0


def _pull_batched(
    arrays: Sequence[Any], dims: Sequence[Any], *, ends: EndFunction, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> tuple[Any, list[int]]:
    given = _batched(arrays, dims)
    (length,) = np.broadcast_shapes(*(array.shape[:1] for array in given))
    wide = tuple((length, *shape) for shape in shapes)
    return _pull.bind(*given, ends=ends, axes=axes + 1, shapes=wide), [0] * len(shapes)


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
    count = len(params["ends"].shapes)
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


def _push_transposed(bars: Any, *arrays: Any, ends: EndFunction, axes: int) -> list[Any]:
    numbers, tangents = arrays[: len(ends.shapes)], arrays[len(ends.shapes) :]
    unknown = [ad.is_undefined_primal(each) for each in tangents]
    shapes = tuple(
        each.aval.shape if undefined else each.shape for each, undefined in zip(tangents, unknown, strict=True)
    )
    found = _pull.bind(*numbers, bars, ends=ends, axes=axes, shapes=shapes)
    return [None] * len(numbers) + [part if undefined else None for part, undefined in zip(found, unknown, strict=True)]


def _pull_transposed(
    tangents: Sequence[Any], *arrays: Any, ends: EndFunction, axes: int, shapes: tuple[tuple[int, ...], ...]
) -> list[Any]:
    *numbers, bars = arrays
    made = _push.bind(*numbers, *map(ad.instantiate_zeros, tangents), ends=ends, axes=axes)
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
    lambda *arrays, ends, axes: ShapedArray((*_leading(ends, axes, arrays), ends.rows), np.dtype(np.float64)),
    _push_batched,
    _push_jvp,
    _push_transposed,
)
_define(
    _pull,
    _pull_back,
    lambda *arrays, ends, axes, shapes: [ShapedArray(shape, np.dtype(np.float64)) for shape in shapes],
    _pull_batched,
    _pull_jvp,
    _pull_transposed,
)
