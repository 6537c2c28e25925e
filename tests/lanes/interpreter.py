"""What a traced function means: NumPy, one equation after another, for one lane.

Each product and each sum is rounded. Where XLA defines what C leaves open (division by zero, shifts by too much,
numbers that no integer holds) the definition is written out here, independently of the compiler.
"""

import functools
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from erosion.lanes.functions import FUNCTIONS
from erosion.lanes.jax_versions import carried_by_scan

_ROUNDS = 100_000


def evaluate(closed: ClosedJaxpr, arguments: list[Any]) -> list[np.ndarray]:
    """The function's results for one lane; arguments are numpy arrays of its types."""
    with np.errstate(all="ignore"):
        return _evaluate(closed.jaxpr, closed.consts, arguments)


def _evaluate(jaxpr: Jaxpr, constants: Any, arguments: list[Any]) -> list[Any]:
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], map(np.asarray, [*constants, *arguments]), strict=True))

    def read(atom: Any) -> np.ndarray:
        aval: Any = atom.aval
        return np.asarray(atom.val, aval.dtype) if isinstance(atom, Literal) else values[atom]

    for equation in jaxpr.eqns:
        given = [read(atom) for atom in equation.invars]
        results = _equation(equation, given)
        variables: list[Any] = list(equation.outvars)
        for variable, result in zip(variables, results, strict=True):
            result = np.asarray(result)
            assert result.dtype == variable.aval.dtype, (equation, result.dtype)
            assert result.shape == variable.aval.shape, (equation, result.shape)
            values[variable] = result
    return [read(atom) for atom in jaxpr.outvars]


def _equation(equation: Any, given: list[np.ndarray]) -> list[Any]:
    name, params = equation.primitive.name, equation.params
    if name in ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint"):
        inner = params["jaxpr" if "jaxpr" in params else "call_jaxpr"]
        return _evaluate(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), given)
    if name in _CONTROL:
        return _CONTROL[name](params, given)
    kind = equation.outvars[0].aval.dtype
    if name in FUNCTIONS:
        exact = [np.asarray(x, float) for x in given]
        results = [np.empty(np.broadcast_shapes(*(x.shape for x in exact)))]
        for index in np.ndindex(results[0].shape):
            points = [np.float64(x[index] if x.shape else x) for x in exact]
            (results[0][index],) = _evaluate(
                _traced(name, len(points)).jaxpr, _traced(name, len(points)).consts, points
            )
        return [results[0].astype(kind)]
    if name in _NUMPY:
        return [np.asarray(_NUMPY[name](*given)).astype(kind, copy=False)]
    if name in _OTHER:
        return [_OTHER[name](params, kind, *given)]
    # What only moves elements, at places that are computed, is JAX's own.
    assert name in _MOVES, name
    results = equation.primitive.bind(*given, **params)
    return list(map(np.asarray, results)) if equation.primitive.multiple_results else [np.asarray(results)]


@functools.cache
def _traced(name: str, inputs: int) -> ClosedJaxpr:
    return jax.make_jaxpr(FUNCTIONS[name])(*[0.5] * inputs)


def _while(params: Any, given: list[np.ndarray]) -> list[Any]:
    ends = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    for_condition, for_body, carried = given[: ends[0]], given[ends[0] : ends[1]], given[ends[1] :]
    condition, body = params["cond_jaxpr"], params["body_jaxpr"]
    for _ in range(_ROUNDS):
        if not _evaluate(condition.jaxpr, condition.consts, [*for_condition, *carried])[0]:
            return carried
        carried = _evaluate(body.jaxpr, body.consts, [*for_body, *carried])
    raise AssertionError("a loop that does not end")


def _cond(params: Any, given: list[np.ndarray]) -> list[Any]:
    branches = params["branches"]
    closed = branches[int(np.clip(given[0], 0, len(branches) - 1))]
    return _evaluate(closed.jaxpr, closed.consts, given[1:])


def _scan(params: Any, given: list[np.ndarray]) -> list[Any]:
    constants, carries = carried_by_scan(params)
    fixed, carried, rows = given[:constants], given[constants : constants + carries], given[constants + carries :]
    closed, made = params["jaxpr"], []
    order = range(params["length"])
    for i in reversed(order) if params["reverse"] else order:
        results = _evaluate(closed.jaxpr, closed.consts, [*fixed, *carried, *(row[i] for row in rows)])
        carried = results[: len(carried)]
        made.append(results[len(carried) :])
    if params["reverse"]:
        made.reverse()
    return [*carried, *(np.stack(column) for column in zip(*made, strict=True))]


def _div(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    if x.dtype.kind == "f":
        return x / y
    zero, least = y == 0, np.iinfo(x.dtype).min
    over = (x == least) & (y.astype(np.int64) == -1) & (x.dtype.kind == "i")
    safe = np.where(zero | over, 1, y).astype(x.dtype)
    quotient = x // safe
    if x.dtype.kind == "i":  # numpy rounds down, XLA to zero
        quotient = quotient + ((x % safe != 0) & ((x < 0) != (safe < 0)))
    return np.where(zero, np.array(-1).astype(x.dtype), quotient)


def _rem(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    if x.dtype.kind == "f":
        return np.fmod(x, y)
    over = (y.astype(np.int64) == -1) & (x.dtype.kind == "i")
    safe = np.where((y == 0) | over, 1, y).astype(x.dtype)
    return np.where(y == 0, x, np.where(over, 0, np.fmod(x, safe)))


def _shift(name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    bits = 8 * x.dtype.itemsize
    unsigned = np.dtype(f"u{x.dtype.itemsize}")
    by = y.astype(unsigned)
    inside = by < bits
    safe = np.where(inside, by, 0).astype(unsigned)
    if name == "left":
        return np.where(inside, x.astype(unsigned) << safe, 0).astype(unsigned).astype(x.dtype)
    if name == "logical":
        return np.where(inside, x.astype(unsigned) >> safe, 0).astype(unsigned).astype(x.dtype)
    signed = np.dtype(f"i{x.dtype.itemsize}")
    return (x.astype(signed) >> np.where(inside, by, bits - 1).astype(signed)).astype(x.dtype)


def _convert(params: Any, kind: Any, x: np.ndarray) -> np.ndarray:
    if x.dtype.kind == "f" and kind.kind in "iu":
        limits = np.iinfo(kind)
        made = np.empty(x.shape, kind)
        for index in np.ndindex(x.shape):
            number = float(x[index])
            made[index] = (
                0 if number != number else limits.max if number >= limits.max else limits.min
                if number <= limits.min else int(number)
            )  # fmt: skip
        return made
    return x.astype(kind)


def _power(x: np.ndarray, y: int) -> np.ndarray:
    if y == 0:
        return np.ones_like(x)
    if y == 1:
        return x
    half = _power(x, y // 2)
    square = half * half
    return square * x if y % 2 else square


def _extreme(more: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # Of two zeros the second is taken.
    return np.where(x != x, x, np.where(more(x, y), x, y))


_max, _min = functools.partial(_extreme, np.greater), functools.partial(_extreme, np.less)


def _reduced(rule: Any, params: Any, _: Any, x: np.ndarray) -> np.ndarray:
    axes = params["axes"]
    rows = np.moveaxis(x, axes, range(len(axes))).reshape(-1, *(n for i, n in enumerate(x.shape) if i not in axes))
    return functools.reduce(lambda total, row: np.asarray(rule(total, row)).astype(x.dtype), rows)


def _cumulated(rule: Any, params: Any, _: Any, x: np.ndarray) -> np.ndarray:
    rows = np.moveaxis(x, params["axis"], 0)
    rows = np.array(rows[::-1] if params["reverse"] else rows)
    for i in range(1, len(rows)):
        rows[i] = rule(rows[i - 1], rows[i])
    return np.moveaxis(rows[::-1] if params["reverse"] else rows, 0, params["axis"])


def _dot_general(params: Any, kind: Any, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    (left, right), (batch_left, batch_right) = params["dimension_numbers"]

    def folded(array: np.ndarray, contracted: Any, batch: Any) -> tuple[np.ndarray, list[int]]:
        free = [axis for axis in range(array.ndim) if axis not in (*contracted, *batch)]
        lengths = [int(np.prod([array.shape[a] for a in axes], dtype=int)) for axes in (batch, free, contracted)]
        return array.transpose(*batch, *free, *contracted).reshape(lengths), [array.shape[a] for a in free]

    shape = [x.shape[axis] for axis in batch_left]
    (x, of_x), (y, of_y) = folded(x.astype(kind), left, batch_left), folded(y.astype(kind), right, batch_right)
    made = np.zeros((len(x), x.shape[1], y.shape[1]), kind)
    for b, i, j in np.ndindex(made.shape):
        for n, (u, v) in enumerate(zip(x[b, i], y[b, j], strict=True)):
            made[b, i, j] = u * v if n == 0 else made[b, i, j] + u * v
    return made.reshape([*shape, *of_x, *of_y])


def _select_n(selector: np.ndarray, *cases: np.ndarray) -> np.ndarray:
    return np.choose(np.broadcast_to(np.clip(selector.astype(int), 0, len(cases) - 1), cases[0].shape), cases)


def _logic(floating: Any, logical: Any) -> Any:
    return lambda x, y: logical(x, y) if x.dtype == bool else floating(x, y)


def _broadcast(params: Any, _: Any, x: np.ndarray) -> np.ndarray:
    lengths = [1] * len(params["shape"])
    for axis, dimension in enumerate(params["broadcast_dimensions"]):
        lengths[dimension] = x.shape[axis]
    return np.broadcast_to(x.reshape(lengths), params["shape"])


_ADD, _MUL = _logic(np.add, np.logical_or), _logic(np.multiply, np.logical_and)
_CONTROL: dict[str, Any] = {"while": _while, "cond": _cond, "scan": _scan}
_NUMPY: dict[str, Any] = {
    "abs": np.abs, "add": _ADD, "add_any": _ADD, "sub": _logic(np.subtract, np.logical_xor), "mul": _MUL, "div": _div,
    "rem": _rem, "neg": np.negative, "max": _max, "min": _min, "sqrt": np.sqrt, "floor": np.floor, "ceil": np.ceil,
    "square": lambda x: x * x, "sign": lambda x: np.where((x == 0) | (x != x), x, np.sign(x)),
    "eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert, "is_finite": np.isfinite,
    "select_n": _select_n, "clamp": lambda low, x, high: _min(_max(low, x), high),
    "shift_left": functools.partial(_shift, "left"), "shift_right_logical": functools.partial(_shift, "logical"),
    "shift_right_arithmetic": functools.partial(_shift, "arithmetic"), "copy": np.asarray, "copy_p": np.asarray,
    "stop_gradient": np.asarray,
}  # fmt: skip
_OTHER: dict[str, Any] = {
    "integer_pow": lambda params, _, x: 1 / _power(x, -params["y"]) if params["y"] < 0 else _power(x, params["y"]),
    "round": lambda params, _, x: np.rint(x) if int(params["rounding_method"]) else np.copysign(
        np.trunc(x) + np.where(np.abs(x - np.trunc(x)) >= 0.5, np.sign(x), 0), x).astype(x.dtype),
    "convert_element_type": _convert,
    "bitcast_convert_type": lambda params, kind, x: x.view(kind),
    "broadcast_in_dim": _broadcast,
    "reshape": lambda params, _, x: x.reshape(params["new_sizes"]),
    "squeeze": lambda params, _, x: np.squeeze(x, params["dimensions"]),
    "expand_dims": lambda params, _, x: np.expand_dims(x, params["dimensions"]),
    "transpose": lambda params, _, x: x.transpose(params["permutation"]),
    "rev": lambda params, _, x: np.flip(x, params["dimensions"]),
    "concatenate": lambda params, _, *arrays: np.concatenate(arrays, axis=params["dimension"]),
    "slice": lambda params, _, x: x[
        tuple(map(slice, params["start_indices"], params["limit_indices"], params["strides"] or [1] * x.ndim))],
    "reduce_sum": functools.partial(_reduced, _ADD), "reduce_prod": functools.partial(_reduced, _MUL),
    "reduce_max": functools.partial(_reduced, _max), "reduce_min": functools.partial(_reduced, _min),
    "reduce_and": functools.partial(_reduced, np.bitwise_and), "reduce_or": functools.partial(_reduced, np.bitwise_or),
    "cumsum": functools.partial(_cumulated, _ADD), "cumprod": functools.partial(_cumulated, _MUL),
    "cummax": functools.partial(_cumulated, _max), "cummin": functools.partial(_cumulated, _min),
    "argmax": lambda params, kind, x: np.argmax(x, axis=params["axes"][0]).astype(kind),
    "argmin": lambda params, kind, x: np.argmin(x, axis=params["axes"][0]).astype(kind),
    "dot_general": _dot_general,
}  # fmt: skip
_MOVES = {
    "gather", "scatter", "dynamic_slice", "dynamic_update_slice", "pad", "iota", "split", "stack", "unstack", "tile",
}  # fmt: skip
