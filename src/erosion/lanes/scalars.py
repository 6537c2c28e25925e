"""What JAX's primitives mean for scalars, in operations of a graph."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jax.core import ShapedArray
from jax.extend.core import JaxprEqn, Literal, Var
from jax.typing import DTypeLike

from erosion.lanes.graph import BOOL, DOUBLE, CannotCompileError, Graph, GraphValue

_TYPES = {
    "float64": DOUBLE, "float32": "float", "bool": BOOL,
    "int8": "i8", "int16": "i16", "int32": "i32", "int64": "i64",
    "uint8": "i8", "uint16": "i16", "uint32": "i32", "uint64": "i64",
}  # fmt: skip


Equation = JaxprEqn
"""One operation of a function that JAX has traced."""

Atom = Var | Literal
"""A value in a traced function: a variable or a number."""

Params = Mapping[str, Any]
"""The parameters of an equation, by their names in JAX."""


class Kind(NamedTuple):
    """What a rule needs to know about an equation, beside its inputs: parameters, types of inputs and output."""

    params: Params
    inputs: tuple[np.dtype, ...]
    output: np.dtype


def aval_of(atom: Atom) -> ShapedArray:
    """Shape and type of a value."""
    assert isinstance(atom.aval, ShapedArray)
    return atom.aval


def type_of(dtype: DTypeLike) -> str:
    """LLVM's name of a type."""
    try:
        return _TYPES[np.dtype(dtype).name]
    except (KeyError, TypeError):
        what = f"numbers of type {dtype}"
        if str(dtype).startswith("complex"):
            raise CannotCompileError(what, "write it by real ones, such as cos and sin for exp(1j·x)") from None
        raise CannotCompileError(what) from None


Rule = Callable[..., GraphValue]
"""A function of (graph, kind, *inputs)."""


def _by_type(floating: str, whole: str, logical: str) -> Rule:
    def rule(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
        name = floating if kind.output.kind == "f" else logical if kind.output.kind == "b" else whole
        return graph.op(name, x.type, x, y)

    return rule


def _comparison(floating: str, signed: str, unsigned: str) -> Rule:
    def rule(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
        of = kind.inputs[0].kind
        name = f"fcmp {floating}" if of == "f" else f"icmp {signed if of == 'i' else unsigned}"
        return graph.compare(name, x, y)

    return rule


def _intrinsic(name: str) -> Rule:
    return lambda graph, _, x: graph.op(name, x.type, x)


def _same(_: Graph, __: Kind, x: GraphValue) -> GraphValue:
    return x


def _zero(graph: Graph, x: GraphValue) -> GraphValue:
    return graph.constant(0, x.type)


def _neg(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    return graph.op("fneg", x.type, x) if kind.output.kind == "f" else graph.op("sub", x.type, _zero(graph, x), x)


def _abs(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    if kind.output.kind == "f":
        return graph.op("llvm.fabs", x.type, x)
    if kind.output.kind == "u":
        return x
    return graph.select(graph.compare("icmp slt", x, _zero(graph, x)), _neg(graph, kind, x), x)


def _sign(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    zero, one = _zero(graph, x), graph.constant(1, x.type)
    if kind.output.kind == "u":
        return graph.select(graph.compare("icmp eq", x, zero), zero, one)
    more, less, minus = ("fcmp ogt", "fcmp olt", "fneg") if kind.output.kind == "f" else ("icmp sgt", "icmp slt", "")
    negative = graph.op("fneg", x.type, one) if minus else graph.constant(-1, x.type)
    # Zero of either sign, and NaN, stay as they are.
    return graph.select(graph.compare(more, x, zero), one, graph.select(graph.compare(less, x, zero), negative, x))


def _extreme(more: str, signed: str, unsigned: str, logical: str) -> Rule:
    def rule(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
        of = kind.output.kind
        if of == "b":
            return graph.op(logical, BOOL, x, y)
        if of != "f":
            return graph.select(graph.compare(f"icmp {signed if of == 'i' else unsigned}", x, y), x, y)
        # The comparison is false if either is NaN, and y is taken: only a NaN in x needs a second look.
        chosen = graph.select(graph.compare(f"fcmp {more}", x, y), x, y)
        return graph.select(graph.compare("fcmp uno", x, x), x, chosen)

    return rule


_max = _extreme("ogt", "sgt", "ugt", "or")
_min = _extreme("olt", "slt", "ult", "and")


def _division(name: str) -> Rule:
    """The quotient ("div") or the remainder ("rem")."""

    def rule(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
        if kind.output.kind == "f":
            # For "frem" LLVM calls the C library for each lane. It is exact, so every library gives the same bits.
            return graph.op(f"f{name}", x.type, x, y)
        zero, one, minus = (graph.constant(number, y.type) for number in (0, 1, -1))
        is_zero = graph.compare("icmp eq", y, zero)
        # The processor accepts no other divisor of integers.
        safe = graph.select(is_zero, one, y)
        if kind.output.kind == "i":
            least = graph.constant(np.iinfo(kind.output).min, x.type)
            overflows = graph.op("and", BOOL, graph.compare("icmp eq", x, least), graph.compare("icmp eq", y, minus))
            safe = graph.select(overflows, one, safe)
        result = graph.op(f"{'s' if kind.output.kind == 'i' else 'u'}{name}", x.type, x, safe)
        # By zero XLA gives all bits set, and all of x for the remainder.
        return graph.select(is_zero, minus if name == "div" else x, result)

    return rule


_mul = _by_type("fmul", "mul", "and")


def _integer_pow(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    y = kind.params["y"]
    if y < 0:
        return graph.op("fdiv", x.type, graph.constant(1.0, x.type), _power(graph, kind, x, -y))
    return _power(graph, kind, x, y)


def _power(graph: Graph, kind: Kind, x: GraphValue, y: int) -> GraphValue:
    """A whole power, by repeated squaring."""
    if y == 0:
        return graph.constant(1, x.type)
    if y == 1:
        return x
    half = _power(graph, kind, x, y // 2)
    square = _mul(graph, kind, half, half)
    return _mul(graph, kind, square, x) if y % 2 else square


def _not(graph: Graph, _: Kind, x: GraphValue) -> GraphValue:
    return graph.op("xor", x.type, x, graph.constant(True if x.type == BOOL else -1, x.type))


def _select_n(graph: Graph, kind: Kind, selector: GraphValue, *cases: GraphValue) -> GraphValue:
    chosen = cases[-1]
    for i in reversed(range(len(cases) - 1)):
        if kind.inputs[0].kind == "b":
            return graph.select(selector, cases[1], cases[0])
        chosen = graph.select(graph.compare("icmp eq", selector, graph.constant(i, selector.type)), cases[i], chosen)
    return chosen


def _is_finite(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    return graph.compare("fcmp olt", graph.op("llvm.fabs", x.type, x), graph.constant(np.inf, x.type))


def _round(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    if kind.params["rounding_method"].name == "TO_NEAREST_EVEN":
        return graph.op("llvm.roundeven", x.type, x)
    return graph.op("llvm.round", x.type, x)  # away from zero


def _shift(name: str, beyond: str) -> Rule:
    """A shift. By the number's width or more it gives 0, or, where `beyond` is "sign", copies of the sign bit."""

    def rule(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
        bits = 8 * kind.output.itemsize
        inside = graph.compare("icmp ult", y, graph.constant(bits, y.type))
        if beyond == "sign":
            return graph.op(name, x.type, x, graph.select(inside, y, graph.constant(bits - 1, y.type)))
        shifted = graph.op(name, x.type, x, graph.select(inside, y, _zero(graph, y)))
        return graph.select(inside, shifted, _zero(graph, x))

    return rule


def _convert(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    from_, to = kind.inputs[0], kind.output
    if from_ == to:
        return x
    type_ = type_of(to)
    if to.kind == "b":
        unlike = "fcmp une" if from_.kind == "f" else "icmp ne"
        return graph.compare(unlike, x, _zero(graph, x))
    if from_.kind == "b":
        return graph.select(x, graph.constant(1, type_), graph.constant(0, type_))
    if from_.kind == "f" and to.kind == "f":
        return graph.op("fpext" if to.itemsize > from_.itemsize else "fptrunc", type_, x)
    if from_.kind == "f":
        # Saturating, NaN to 0, as XLA does.
        return graph.op("llvm.fptosi.sat" if to.kind == "i" else "llvm.fptoui.sat", type_, x)
    if to.kind == "f":
        return graph.op("sitofp" if from_.kind == "i" else "uitofp", type_, x)
    if to.itemsize == from_.itemsize:
        return x
    if to.itemsize < from_.itemsize:
        return graph.op("trunc", type_, x)
    return graph.op("sext" if from_.kind == "i" else "zext", type_, x)


def converted(graph: Graph, value: GraphValue, from_: np.dtype, to: np.dtype) -> GraphValue:
    """The value as another type."""
    return _convert(graph, Kind({}, (from_,), to), value)


def _bitcast(graph: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    type_ = type_of(kind.output)
    if kind.inputs[0].itemsize != kind.output.itemsize:
        raise CannotCompileError("`bitcast_convert_type` between types of other sizes")
    return x if type_ == x.type else graph.op("bitcast", type_, x)


def _total_order(graph: Graph, kind: Kind, x: GraphValue, y: GraphValue) -> GraphValue:
    # JAX first makes both zeros equal, and all NaN; then NaN is the largest.
    if kind.inputs[0].kind != "f":
        return _less(graph, kind, x, y)
    y_nan, x_number = graph.compare("fcmp uno", y, y), graph.compare("fcmp ord", x, x)
    return graph.op("or", BOOL, graph.compare("fcmp olt", x, y), graph.op("and", BOOL, y_nan, x_number))


def _reduce_precision(_: Graph, kind: Kind, x: GraphValue) -> GraphValue:
    if (kind.params["exponent_bits"], kind.params["mantissa_bits"]) != (11, 52) or kind.output.itemsize != 8:
        raise CannotCompileError("numbers of reduced precision (`reduce_precision`)")
    return x


_less = _comparison("olt", "slt", "ult")

SCALARS: Mapping[str, Rule] = {
    "abs": _abs,
    "add": _by_type("fadd", "add", "or"),
    "add_any": _by_type("fadd", "add", "or"),
    "and": lambda graph, _, x, y: graph.op("and", x.type, x, y),
    "bitcast_convert_type": _bitcast,
    "ceil": _intrinsic("llvm.ceil"),
    "clamp": lambda graph, kind, low, x, high: _min(graph, kind, _max(graph, kind, low, x), high),
    "convert_element_type": _convert,
    "copy": _same,
    "copy_p": _same,
    "div": _division("div"),
    "eq": _comparison("oeq", "eq", "eq"),
    "floor": _intrinsic("llvm.floor"),
    "ge": _comparison("oge", "sge", "uge"),
    "gt": _comparison("ogt", "sgt", "ugt"),
    "integer_pow": _integer_pow,
    "is_finite": _is_finite,
    "le": _comparison("ole", "sle", "ule"),
    "le_to": lambda graph, kind, x, y: _not(graph, kind, _total_order(graph, kind, y, x)),
    "lt": _less,
    "lt_to": _total_order,
    "max": _max,
    "min": _min,
    "mul": _mul,
    "ne": _comparison("une", "ne", "ne"),
    "neg": _neg,
    "not": _not,
    "optimization_barrier": _same,
    "or": lambda graph, _, x, y: graph.op("or", x.type, x, y),
    "real": _same,
    "reduce_precision": _reduce_precision,
    "rem": _division("rem"),
    "round": _round,
    "select_n": _select_n,
    "shift_left": _shift("shl", "nothing"),
    "shift_right_arithmetic": _shift("ashr", "sign"),
    "shift_right_logical": _shift("lshr", "nothing"),
    "sign": _sign,
    "sqrt": _intrinsic("llvm.sqrt"),
    "square": lambda graph, kind, x: _mul(graph, kind, x, x),
    "stop_gradient": _same,
    "sub": _by_type("fsub", "sub", "xor"),
    "xor": lambda graph, _, x, y: graph.op("xor", x.type, x, y),
}
"""The rule of each primitive that makes one scalar from scalars, by its name."""
