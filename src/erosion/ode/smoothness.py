"""Whether a motion may have kinks or singular points, read from its own arithmetic.

Most motions have none, and their programs need not look for any.
"""

import functools
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np
from jax.extend.core import Jaxpr, Literal, Var

from erosion.lanes.scalars import Atom, Equation
from erosion.ode.layout import Layout
from erosion.ode.reduction import WholeMotion
from erosion.ode.variational import Augmented

# What is smooth wherever it is finite. `sqrt`, `log` and `pow` are not: at 0 they are NaN or their rates infinite.
_SMOOTH = frozenset({
    "add", "add_any", "sub", "mul", "neg", "div", "integer_pow", "square", "exp", "exp2", "expm1", "log1p", "tanh",
    "logistic", "sin", "cos", "tan", "atan", "atan2", "sinh", "cosh", "asinh", "erf", "erfc", "dot_general",
    "reduce_sum", "cumsum", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "concatenate",
    "slice", "stack", "rev", "copy", "convert_element_type", "stop_gradient", "split", "pad",
})  # fmt: skip
# Of the package: smooth, although its arithmetic has steps.
_SMOOTH_FUNCTIONS = frozenset({"sincos"})


@functools.lru_cache(maxsize=256)
def may_have_kinks(layout: Layout) -> bool:
    """Whether the rates of state and integrals have an operation on the state that is not smooth everywhere.

    A part of the state whose rate is zero, such as a switch that resets change, is constant between two events.
    """
    if layout.options.smooth is not None:
        return not layout.options.smooth
    start = jax.eval_shape(lambda numbers: WholeMotion(layout, numbers).start(), layout.structs())

    def rate(elements: list[Any], numbers: list[Any]) -> Any:
        return WholeMotion(layout, numbers).rate(Augmented(tuple(elements), ()))

    jaxpr = jax.make_jaxpr(rate)(start, layout.structs()).jaxpr
    made_by = {made: equation for equation in jaxpr.eqns for made in equation.outvars}
    varies = [not _is_zero(value, made_by) for value in jaxpr.outvars[: len(start)]]
    return _is_rough(jaxpr, varies + [False] * (len(jaxpr.invars) - len(start)))


def _is_zero(value: Atom, made_by: Mapping[Var, Equation]) -> bool:
    """Whether a value is zero by its arithmetic: 0, or 0 times anything."""
    if isinstance(value, Literal):
        return bool(np.all(value.val == 0))
    equation = made_by.get(value)
    if equation is None or equation.primitive.name not in ("mul", "neg", "convert_element_type", "copy"):
        return False
    return any(_is_zero(atom, made_by) for atom in equation.invars)


def _is_rough(jaxpr: Jaxpr, varies: list[bool]) -> bool:
    """Whether an operation on the arguments that vary is not smooth."""
    varying = {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves}
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom in varying for atom in equation.invars]
        if not any(moves):
            continue
        varying |= set(equation.outvars)
        if equation.params.get("name") in _SMOOTH_FUNCTIONS or equation.primitive.name in _SMOOTH:
            continue
        if equation.primitive.name == "select_n" and not moves[0]:
            continue  # the same case all the way
        inner = list(_inner(equation.params))
        # A loop or a branch chooses by the state: only plain calls are looked into.
        if len(inner) != 1 or len(inner[0].invars) != len(moves) or equation.primitive.name in ("while", "scan"):
            return True
        if _is_rough(inner[0], moves):
            return True
    return False


def _inner(parameters: dict[str, Any]) -> Iterator[Jaxpr]:
    """The functions that an operation calls."""
    for value in parameters.values():
        for part in value if isinstance(value, (tuple, list)) else (value,):
            if hasattr(part, "eqns"):
                yield getattr(part, "jaxpr", part)
