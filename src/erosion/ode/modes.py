"""Functions in fixed modes: each operation that breaks is replaced by one that does not; see `switches`.

| operation | mode | bounds |
|---|---|---|
| `lt le gt ge max min abs sign clamp`, `sqrt` of a square | whether a ≥ b | the distance a - b, or b - a |
| `reduce_max reduce_min` | the same of each element and the best before it | the same |
| `atan2` | whether y ≥ 0 | y, or -y |
| `floor ceil round rem`, numpy's remainder and quotient, a real number as an integer | that number | to both ends |
| `searchsorted`, and so `interp`, in a table that does not move | the piece | the distances to its two knots |

`hypot` chooses by the sizes of its operands, but is smooth except at the origin: √(x² + y²), which has no mode, takes
its place, or |x| where y is the number 0.

`eq` and `ne` of real numbers stay: they hold, or not, all the way. Equal bounds share a mode. What depends on arguments
alone, or on modes, needs none. Roots, powers and logarithms stay as they are: the error control sees them. Loops, what
sorts, and more than 32 modes are not located; see `unlocated`.
"""

import functools
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun

from erosion.arguments import Scalar
from erosion.lanes.scalars import Equation, aval_of
from erosion.ode.memories import NEVER
from erosion.ode.reduction import beside_breaks

_ULPS = 4e-16  # of a break: two units in its last place, by which a time just before the break is earlier
_TINY = 1e-300  # the same for a break at 0


class Bound(NamedTuple):
    """An end of a mode.

    Args:
        distance: positive within the mode, zero at its end.
        following: the mode beyond it.
        size: of the numbers whose difference it is, for their rounding.
        switch: the index of the mode.
    """

    distance: Any
    following: Any
    size: Any
    switch: int


class _Value(NamedTuple):
    """A value of a function that is rewritten.

    Args:
        number: the value.
        moves: whether it moves between two events.
        key: equal values have equal keys, where that is known.
        root: of what it is the square, where that is known.
    """

    number: Any
    moves: bool
    key: Hashable = None
    root: "_Value | None" = None


class Rewriting:
    """Evaluates a function in given modes.

    Args:
        modes: in their order; None for those of the function's own arguments.
        by_hand: whether nothing but the problem's `breaks` has modes.

    Attributes:
        values: the modes that the operations themselves would choose.
        bounds: of all modes.
        others: names of operations that break and have no modes: within loops, and those that sort.
        has_replaced: whether a function was replaced by one that needs no mode.
    """

    def __init__(self, modes: Sequence[Scalar] | None, *, by_hand: bool) -> None:
        self._modes, self._by_hand = modes, by_hand
        self.values: list[Scalar] = []
        self.bounds: list[Bound] = []
        self.others: set[str] = set()
        self.has_replaced = False
        self._known: dict[Hashable, Any] = {}
        self._numbered: dict[Hashable, int] = {}

    def results(self, closed: ClosedJaxpr, numbers: Sequence[Any], moves: Sequence[bool]) -> list[Any]:
        """The results of a function of numbers, of each of which is known whether it moves between two events."""
        operands = [_Value(*pair) for pair in zip(numbers, moves, strict=True)]
        return [value.number for value in self.of(closed.jaxpr, closed.consts, operands)]

    def of(self, jaxpr: Jaxpr, consts: Sequence[Any], operands: Sequence[_Value]) -> list[_Value]:
        """The results of a function."""
        values: dict[Var, _Value] = {}
        for variable, const in zip(jaxpr.constvars, consts, strict=True):
            values[variable] = _Value(const, False, self.key_of("constant", id(const)))
        for i, (variable, operand) in enumerate(zip(jaxpr.invars, operands, strict=True)):
            key = operand.key if operand.key is not None else self.key_of("operand", id(jaxpr), i)
            values[variable] = operand._replace(key=key)

        def read(atom: Any) -> _Value:
            if not isinstance(atom, Literal):
                return values[atom]
            number = np.asarray(atom.val)
            return _Value(atom.val, False, self.key_of(str(number.dtype), number.tobytes()))

        shifts = shifts_of(jaxpr)
        for equation in jaxpr.eqns:
            operands = [read(atom) for atom in equation.invars]
            made = self._made(jaxpr, equation, operands, is_shift=not shifts.isdisjoint(equation.outvars))
            values.update(zip(equation.outvars, made, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def key_of(self, *parts: Hashable) -> int:
        """A number for these parts, the same for equal ones."""
        return self._numbered.setdefault(parts, len(self._numbered))

    def _made(self, jaxpr: Jaxpr, equation: Equation, operands: list[_Value], *, is_shift: bool) -> list[_Value]:
        """The results of an operation."""
        name, numbers = equation.primitive.name, [operand.number for operand in operands]
        keys = tuple(operand.key for operand in operands)
        if any(operand.moves for operand in operands):
            types = [np.dtype(getattr(atom.aval, "dtype", float)) for atom in equation.invars]
            real, moving = [np.issubdtype(each, np.floating) for each in types], [each.moves for each in operands]
            if name in _BREAKING and real[-1] and not self._by_hand and not is_shift:
                key = self.key_of(name, str(equation.params), keys)
                number, moves = _BREAKING[name](self, equation, operands)
                return [_Value(number, moves, key)]
            inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
            is_call = name in ("jit", "pjit", "custom_jvp_call") and equation.params.get("name") not in SMOOTH_FUNCTIONS
            if is_call and isinstance(inner, ClosedJaxpr):
                library = _library_function(equation, inner)
                if library is not None and not (library in _OF_TABLES and operands[0].moves) and self._sees(library):
                    number, moves = library(self, operands)
                    return [_Value(number, moves, self.key_of(str(equation.params.get("name")), keys))]
                # A loop with a derivative of its own is smooth: its author says so.
                looks = name != "custom_jvp_call" or (_breaks(equation, moving) and not _has_loop(inner.jaxpr))
                if looks and not self._by_hand:
                    return self.of(inner.jaxpr, inner.consts, operands)
            if name == "cond" and not operands[0].moves and not self._by_hand:
                return self._of_cases(equation, operands)
            if (name in LOOPS and _breaks(equation, moving)) or name in _SORTING:
                self.others.add(name)
        made = _result(jaxpr, equation)(
            *(x for x, atom in zip(numbers, equation.invars, strict=True) if not isinstance(atom, Literal))
        )
        moves = any(operand.moves for operand in operands) and name not in _STEADY
        key = self.key_of(name, _described(equation), keys)
        is_square = name == "square" or (name == "integer_pow" and equation.params["y"] == 2)
        is_square |= name == "mul" and keys[0] == keys[1]
        root = operands[0] if is_square else None
        return [_Value(number, moves, self.key_of(key, i), root) for i, number in enumerate(made)]

    def _sees(self, library: Callable[..., "_Made"]) -> bool:
        return library is _beside_breaks or not self._by_hand

    def _of_cases(self, equation: Equation, operands: list[_Value]) -> list[_Value]:
        """The results of a branch that a mode chooses."""
        index, *rest = operands
        branches = [self.of(branch.jaxpr, branch.consts, rest) for branch in equation.params["branches"]]
        made = []
        for cases in zip(*branches, strict=True):
            numbers = [jnp.asarray(case.number) for case in cases]
            number = jax.lax.select_n(jnp.clip(index.number, 0, len(numbers) - 1).astype(np.int32), *numbers)
            made.append(_Value(number, any(case.moves for case in cases), self.key_of("cases", id(number))))
        return made

    def _mode(self, key: Hashable, value: Callable[[], Scalar], bounds: Callable[[Scalar], Sequence[Any]]) -> Scalar:
        """A mode, new or known.

        Args:
            key: of what it is the mode.
            value: the mode that the operation itself would choose.
            bounds: for a mode, distance, following mode and size of each.
        """
        if key not in self._known:
            index = len(self.values)
            chosen = jnp.asarray(value(), float)
            self.values.append(chosen)
            mode = chosen if self._modes is None else self._modes[index]
            for each in bounds(mode):
                distance, following, size = map(jnp.asarray, each)
                self.bounds.append(Bound(distance, following, size, index))
            self._known[key] = mode
        return self._known[key]

    def is_above(self, a: _Value, b: _Value) -> Any:
        """Whether a ≥ b in the mode, for numbers or arrays."""
        shape = jnp.broadcast_shapes(jnp.shape(a.number), jnp.shape(b.number))
        turned = not a.key < b.key  # pyrefly: ignore
        first, second = (b, a) if turned else (a, b)
        ones, others = (jnp.broadcast_to(each.number, shape) for each in (first, second))

        def element(index: tuple[int, ...]) -> Scalar:
            one, other = ones[index], others[index]
            return self._mode(
                ("above", first.key, second.key, index),
                lambda: one >= other,
                lambda mode: [(jnp.where(mode > 0.5, one - other, other - one), 1.0 - mode, abs(one) + abs(other))],
            )

        modes = _array_of(shape, element)
        return modes < 0.5 if turned else modes > 0.5

    def whole(self, kind: str, x: Any, key: Hashable) -> Any:
        """The whole number of a real one, or of an array, in the mode."""
        rule = _WHOLE[kind]

        def element(index: tuple[int, ...]) -> Scalar:
            one = x[index]

            def bounds(mode: Scalar) -> list[Any]:
                low, high = rule.ends(mode)
                size = abs(one) + abs(mode)
                return [(one - low, mode - 1.0, size), (high - one, mode + 1.0, size)]

            return self._mode((kind, key, index), lambda: rule.value(one), bounds)

        x = jnp.asarray(x)
        return _array_of(x.shape, element)

    def piece(self, table: _Value, x: _Value, side: str) -> Any:
        """How many knots of a table are below a number, in the mode."""
        knots, size = jnp.asarray(table.number), int(np.shape(table.number)[0])

        def element(index: tuple[int, ...]) -> Scalar:
            one = jnp.asarray(x.number)[index]

            def bounds(mode: Scalar) -> list[Any]:
                place = lax.convert_element_type(mode, np.int32)
                low, high = knots[jnp.maximum(place - 1, 0)], knots[jnp.minimum(place, size - 1)]
                below = jnp.where(mode > 0.5, one - low, 1.0), mode - 1.0, abs(one) + abs(low)
                above = jnp.where(mode < size - 0.5, high - one, 1.0), mode + 1.0, abs(one) + abs(high)
                return [below, above]

            return self._mode(
                ("piece", table.key, x.key, side, index), lambda: jnp.searchsorted(knots, one, side=side), bounds
            )

        return _array_of(np.shape(x.number), element)


def _array_of(shape: tuple[int, ...], element: Callable[[tuple[int, ...]], Scalar]) -> Any:
    elements = [element(index) for index in np.ndindex(shape)]
    return jnp.stack(elements).reshape(shape) if shape else elements[0]


class _Whole(NamedTuple):
    """A way to a whole number: which one, and between which ends it is the same."""

    value: Callable[[Scalar], Scalar]
    ends: Callable[[Scalar], tuple[Scalar, Scalar]]


_WHOLE = {
    "floor": _Whole(jnp.floor, lambda mode: (mode, mode + 1.0)),
    "ceil": _Whole(jnp.ceil, lambda mode: (mode - 1.0, mode)),
    "trunc": _Whole(
        jnp.trunc, lambda mode: (mode - jnp.where(mode > 0.5, 0.0, 1.0), mode + jnp.where(mode < -0.5, 0.0, 1.0))
    ),
}

_Made = tuple[Any, bool]
"""What an operation gives in a mode, and whether it moves between two events."""


def _compared(is_positive: bool) -> Callable[..., _Made]:
    def compared(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
        above = rewriting.is_above(*operands)
        return above if is_positive else jnp.logical_not(above), False

    return compared


def _greater(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    a, b = operands
    return jnp.where(rewriting.is_above(a, b), a.number, b.number), True


def _less(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    a, b = operands
    return jnp.where(rewriting.is_above(a, b), b.number, a.number), True


def _extreme(is_greatest: bool) -> Callable[..., _Made]:
    def extreme(rewriting: Rewriting, equation: Equation, operands: list[_Value]) -> _Made:
        (x,), axes = operands, equation.params["axes"]
        kept = [i for i in range(np.ndim(x.number)) if i not in axes]
        rows = jnp.transpose(x.number, (*axes, *kept)).reshape(-1, *(np.shape(x.number)[i] for i in kept))
        best = _Value(rows[0], True, rewriting.key_of("row", x.key, axes, 0))
        for i in range(1, rows.shape[0]):
            row = _Value(rows[i], True, rewriting.key_of("row", x.key, axes, i))
            above = rewriting.is_above(best, row)
            number = (
                jnp.where(above, best.number, row.number) if is_greatest else jnp.where(above, row.number, best.number)
            )
            best = _Value(number, True, rewriting.key_of("best", best.key, row.key, is_greatest))
        return best.number, True

    return extreme


def _angle(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    """The angle of (x, y) in a half plane, y above zero or below, at whose edge it is smooth but at the origin."""
    y, x = operands
    sign = jnp.where(rewriting.is_above(y, _zero(rewriting, y)), 1.0, -1.0)
    return sign * (np.pi / 2 - jnp.arctan2(x.number, sign * y.number)), True


def _zero(rewriting: Rewriting, like: _Value) -> _Value:
    number = np.zeros((), np.float64)
    return _Value(
        jnp.zeros(np.shape(like.number), jnp.result_type(like.number)),
        False,
        rewriting.key_of("float64", number.tobytes()),
    )


def _absolute(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    (x,) = operands
    return jnp.where(rewriting.is_above(x, _zero(rewriting, x)), x.number, -x.number), True


def _root(rewriting: Rewriting, equation: Equation, operands: list[_Value]) -> _Made:
    """√x, of a square as |x|."""
    (x,) = operands
    if x.root is None:
        return jnp.sqrt(x.number), True
    return _absolute(rewriting, equation, [x.root])


def _signed(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    (x,) = operands
    return jnp.where(rewriting.is_above(x, _zero(rewriting, x)), 1.0, -1.0).astype(jnp.result_type(x.number)), False


def _clamped(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    low, x, high = operands
    below = jnp.where(rewriting.is_above(x, high), high.number, x.number)
    return jnp.where(rewriting.is_above(x, low), below, low.number), True


def _rounded(kind: str) -> Callable[..., _Made]:
    def rounded(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
        (x,) = operands
        return rewriting.whole(kind, x.number, x.key), False

    return rounded


def _nearest(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    (x,) = operands
    return rewriting.whole("floor", x.number + 0.5, rewriting.key_of("half", x.key)), False


def _remainder(rewriting: Rewriting, _: Equation, operands: list[_Value]) -> _Made:
    x, y = operands
    quotient = rewriting.whole("trunc", x.number / y.number, rewriting.key_of("quotient", x.key, y.key))
    return x.number - quotient * y.number, True


def _converted(rewriting: Rewriting, equation: Equation, operands: list[_Value]) -> _Made:
    (x,), new = operands, np.dtype(equation.params["new_dtype"])
    if np.issubdtype(new, np.integer):
        return rewriting.whole("trunc", x.number, x.key).astype(new), False
    return lax.convert_element_type(x.number, new), new.kind == "f"


_BREAKING: dict[str, Callable[..., _Made]] = {
    "lt": _compared(False), "le": _compared(False), "gt": _compared(True), "ge": _compared(True), "max": _greater,
    "min": _less, "abs": _absolute, "sign": _signed, "clamp": _clamped, "floor": _rounded("floor"),
    "ceil": _rounded("ceil"), "round": _nearest, "rem": _remainder, "convert_element_type": _converted,
    "sqrt": _root, "reduce_max": _extreme(True), "reduce_min": _extreme(False), "atan2": _angle,
}  # fmt: skip

SMOOTH_FUNCTIONS = frozenset({"sincos", "between"})
"""Of the package: smooth, although their arithmetic has steps."""

LOOPS = frozenset({"while", "scan"})
_SORTING = frozenset({"sort", "argmax", "argmin", "cummax", "cummin", "top_k", "approx_top_k"})

_EXTREMES = frozenset({"max", "min", "reduce_max", "reduce_min"})

_STEADY = frozenset({"eq", "ne", "is_finite"})
"""What is the same all the way, but at single moments."""


def _floor_remainder(rewriting: Rewriting, operands: list[_Value]) -> _Made:
    x, y = operands
    quotient = rewriting.whole("floor", x.number / y.number, rewriting.key_of("quotient", x.key, y.key))
    return x.number - quotient * y.number, True


def _floor_quotient(rewriting: Rewriting, operands: list[_Value]) -> _Made:
    x, y = operands
    return rewriting.whole("floor", x.number / y.number, rewriting.key_of("quotient", x.key, y.key)), False


def _hypotenuse(rewriting: Rewriting, operands: list[_Value]) -> _Made:
    x, y = operands
    zero = _zero(rewriting, x).key
    if zero in (x.key, y.key):
        moving = y if x.key == zero else x
        above = rewriting.is_above(moving, _zero(rewriting, moving))
        return jnp.where(above, moving.number, -moving.number), True
    rewriting.has_replaced = True
    size = lax.stop_gradient(jnp.maximum(jnp.abs(x.number), jnp.abs(y.number)))
    # Neither squares nor the root's second derivative leave the floats.
    is_extreme = (size > 0) & ((size < 1e-100) | (size > 1e100))
    scale = jnp.where(is_extreme, size, 1.0)
    a, b = x.number / scale, y.number / scale
    return scale * jnp.sqrt(a * a + b * b), True


def _searched(side: str) -> Callable[..., _Made]:
    def searched(rewriting: Rewriting, operands: list[_Value]) -> _Made:
        table, x = operands
        return rewriting.piece(table, x, side).astype(np.int32), False

    return searched


@jax.custom_jvp
def _clipped(t: Scalar, low: Scalar, high: Scalar) -> Scalar:
    return jnp.clip(t, low, high)


@_clipped.defjvp
def _(primals: tuple[Scalar, Scalar, Scalar], tangents: tuple[Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    return _clipped(*primals), tangents[0]


@jax.jit
def between(t: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """A time that is not before the one, and before the other; its rate is one at both."""
    return _clipped(t, low, high - (_ULPS * jnp.abs(high) + _TINY))


def _beside_breaks(rewriting: Rewriting, operands: list[_Value]) -> _Made:
    breaks, t = operands
    mode, size = rewriting.piece(breaks, t, "right"), int(np.shape(breaks.number)[0])
    place, times = lax.convert_element_type(mode, np.int32), jnp.asarray(breaks.number)
    low = jnp.where(mode > 0.5, times[jnp.maximum(place - 1, 0)], -NEVER)
    high = jnp.where(mode < size - 0.5, times[jnp.minimum(place, size - 1)], NEVER)
    return between(t.number, low, high), True


def _library_function(equation: Equation, inner: ClosedJaxpr) -> Callable[..., _Made] | None:
    """The rule for a function of numpy that breaks, as JAX traces it; None for any other."""
    name, avals = equation.params.get("name"), [aval_of(atom) for atom in equation.invars]
    if name not in _LIBRARY:
        return None
    if not np.issubdtype(avals[0].dtype, np.floating):
        return None
    if name == "searchsorted" and (len(avals) != 2 or len(avals[0].shape) != 1):
        return None
    text, structs = str(inner.jaxpr), [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in avals]
    for function, rule in _LIBRARY[name]:
        try:
            traced = jax.make_jaxpr(function)(*structs)
        except TypeError:
            continue
        ours = [each for each in traced.jaxpr.eqns if each.params.get("name") == name]
        if ours and str(ours[0].params["jaxpr"].jaxpr) == text:
            return rule
    return None


_OF_TABLES = (_searched("left"), _searched("right"))

_LIBRARY: dict[str, list[tuple[Callable[..., Any], Callable[..., _Made]]]] = {
    "remainder": [(jnp.remainder, _floor_remainder)],
    "floor_divide": [(jnp.floor_divide, _floor_quotient)],
    "hypot": [(jnp.hypot, _hypotenuse)],
    "searchsorted": [
        (functools.partial(jnp.searchsorted, side=side), rule)
        for side, rule in zip(("left", "right"), _OF_TABLES, strict=True)
    ],
    "beside_breaks": [(beside_breaks, _beside_breaks)],
}


def _result(jaxpr: Jaxpr, equation: Equation) -> Callable[..., list[Any]]:
    """An operation, as a function of its inputs that are no literals."""
    variables = [atom for atom in equation.invars if not isinstance(atom, Literal)]
    unnamed = jaxpr.debug_info._replace(arg_names=None, result_paths=None)
    alone = jaxpr.replace(
        constvars=[], invars=list(dict.fromkeys(variables)), outvars=equation.outvars, eqns=[equation],
        debug_info=unnamed,
    )  # fmt: skip
    function = jaxpr_as_fun(ClosedJaxpr(alone, []))
    return lambda *inputs: function(*dict(zip(variables, inputs, strict=True)).values())


def _breaks(equation: Equation, moves: Sequence[bool]) -> bool:
    """Whether an operation, or a function that it calls, breaks as those of its operands move that do."""
    if not any(moves):
        return False
    name, types = equation.primitive.name, [np.dtype(aval_of(atom).dtype) for atom in equation.invars]
    if name in _SORTING:
        return True
    if np.issubdtype(types[-1], np.floating):
        if name == "convert_element_type":
            return np.issubdtype(np.dtype(equation.params["new_dtype"]), np.integer)
        if name in _BREAKING.keys() - {"sqrt"}:
            return True
    return any(_breaks_within(inner, each) for inner, each in _called(equation, moves))


def _breaks_within(jaxpr: Jaxpr, moves: Sequence[bool]) -> bool:
    """Whether a function breaks as those of its arguments move that do."""
    return any(_breaks(equation, each) for equation, each in zip(jaxpr.eqns, _moving(jaxpr, moves)[1], strict=True))


def _moving(jaxpr: Jaxpr, moves: Sequence[bool]) -> tuple[list[bool], list[list[bool]]]:
    """Which results of a function move, and of each of its operations which operands do."""
    varying = {variable for variable, moving in zip(jaxpr.invars, moves, strict=True) if moving}

    def flags(atoms: Sequence[Any]) -> list[bool]:
        return [not isinstance(atom, Literal) and atom in varying for atom in atoms]

    operands = []
    for equation in jaxpr.eqns:
        operands.append(flags(equation.invars))
        if any(operands[-1]) and equation.primitive.name not in _STEADY:
            varying |= set(equation.outvars)
    return flags(jaxpr.outvars), operands


def _called(equation: Equation, moves: Sequence[bool]) -> Iterator[tuple[Jaxpr, Sequence[bool]]]:
    """The functions that an operation calls, each with which of its arguments move."""
    name, params = equation.primitive.name, equation.params
    functions = [
        getattr(part, "jaxpr", part)
        for value in params.values()
        for part in (value if isinstance(value, (tuple, list)) else (value,))
        if hasattr(part, "eqns")
    ]
    if name == "while":
        of_condition, of_body = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        body = params["body_jaxpr"].jaxpr
        carried = _carried(body, moves[of_condition:of_body], moves[of_body:])
        yield params["cond_jaxpr"].jaxpr, [*moves[:of_condition], *carried]
        yield body, [*moves[of_condition:of_body], *carried]
    elif name == "scan":
        first, beyond = params["num_consts"], params["num_consts"] + params["num_carry"]
        body = params["jaxpr"].jaxpr
        carried = _carried(body, moves[:first], moves[first:beyond], moves[beyond:])
        yield body, [*moves[:first], *carried, *moves[beyond:]]
    elif name == "cond":
        for function in functions:
            yield function, moves[1:]
    else:
        for function in functions:
            yield function, moves if len(function.invars) == len(moves) else [True] * len(function.invars)


def _carried(
    body: Jaxpr, consts: Sequence[bool], carried: Sequence[bool], elements: Sequence[bool] = ()
) -> Sequence[bool]:
    """Which of the numbers that a loop carries move, after any number of rounds."""
    while True:
        after = _moving(body, [*consts, *carried, *elements])[0][: len(carried)]
        if not any(new and not old for new, old in zip(after, carried, strict=True)):
            return carried
        carried = [new or old for new, old in zip(after, carried, strict=True)]


def _has_loop(jaxpr: Jaxpr) -> bool:
    """Whether a function has a loop in which something breaks."""
    return any(
        (each.primitive.name in LOOPS and _breaks(each, [True] * len(each.invars)))
        or any(_has_loop(inner) for inner, _ in _called(each, [True] * len(each.invars)))
        for each in jaxpr.eqns
    )


def shifts_of(jaxpr: Jaxpr) -> set[Var]:
    """The greatest and least numbers of a function that only pass `stop_gradient`, as the shift of a softmax does.

    A function that is shifted by them is smooth all the same: its author says so.
    """
    counts, shifts = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}, set()
    for equation in reversed(jaxpr.eqns):
        name = equation.primitive.name
        if counts.isdisjoint(equation.outvars):
            shifts |= set(equation.outvars) if name in _EXTREMES else set()
        elif name != "stop_gradient":
            counts |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return shifts


def _described(equation: Equation) -> Hashable:
    """What an operation is beside its inputs."""
    plain = (int, float, str, bool, tuple, np.dtype, type(None))
    return str(equation.params) if all(isinstance(part, plain) for part in equation.params.values()) else id(equation)


def is_always_zero(value: Any, made_by: Any) -> bool:
    """Whether a value is zero by its arithmetic: 0, or 0 times anything."""
    if isinstance(value, Literal):
        return bool(np.all(value.val == 0))
    equation = made_by.get(value)
    if equation is None or equation.primitive.name not in ("mul", "neg", "convert_element_type", "copy"):
        return False
    return any(is_always_zero(atom, made_by) for atom in equation.invars)
