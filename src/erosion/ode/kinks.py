"""What arithmetic tells of a motion: whether it is smooth once its switches are located, and what its rates divide by.

Roots, powers and logarithms have an infinite rate, or no value, where their argument is zero. The error control sees
that, but a step must not end beyond it.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from erosion.arguments import Flag, Scalar
from erosion.lanes.scalars import Atom, Equation
from erosion.ode.modes import SMOOTH_FUNCTIONS, is_always_zero, shifts_of
from erosion.ode.motion import Augmented
from erosion.ode.reduction import FlatState, WholeMotion, elements_of, evaluate, known_values
from erosion.ode.signature import Signature
from erosion.ode.switches import SwitchedMotion, switches_of

_MOMENT = 1e-8  # of the time scale: so soon before and after an event a smooth rate is the same
_OTHER = 1e-6  # of its size, and of what it does within the time scale: a rate so different has a kink


def is_kinked(rate: Callable[[FlatState], FlatState], event: FlatState, slope: FlatState, scale: Scalar) -> Flag:
    """Whether a rate, of the motion or of its derivatives, is another one after an event than before it.

    Args:
        rate: of the state with its derivatives.
        event: the state at the event.
        slope: its rate near the event.
        scale: the time scale.
    """
    moment = _MOMENT * scale
    before, after = (rate([u + time * k for u, k in zip(event, slope, strict=True)]) for time in (-moment, moment))
    kinked: Flag = jnp.asarray(False)
    for u, one, other in zip(event, before, after, strict=True):
        size = jnp.maximum(jnp.maximum(jnp.abs(one), jnp.abs(other)), jnp.abs(u) / scale)
        kinked = kinked | (jnp.abs(other - one) > _OTHER * size)
    return kinked


def divisors(equation: Equation, moves: Sequence[bool]) -> list[Atom]:
    """What an operation divides by, if it moves."""
    name = equation.primitive.name
    if name == "div" and moves[1]:
        return [equation.invars[1]]
    return [equation.invars[0]] if name == "integer_pow" and equation.params["y"] < 0 else []


def radicands(equation: Equation, moves: Sequence[bool]) -> list[Atom]:
    """Of what an operation takes a root, or a power that is no whole number."""
    return [equation.invars[0]] if equation.primitive.name in ("sqrt", "rsqrt", "pow") and moves[0] else []


def square_roots(equation: Equation, moves: Sequence[bool]) -> list[Atom]:
    """Of what an operation takes a square root, or a power as low: it has a kink where that touches zero."""
    if equation.primitive.name != "pow":
        return [equation.invars[0]] if equation.primitive.name == "sqrt" else []
    base, exponent = equation.invars
    low = not isinstance(exponent, Literal) or np.any(exponent.val <= 0.5)
    return [base] if moves[0] and low else []


OfOperation = Callable[[Equation, Sequence[bool]], list[Atom]]
"""Some of the operands of an operation, by which of them move."""


def operands_of(
    which: OfOperation, closed: ClosedJaxpr, operands: Sequence[Scalar], varies: Sequence[bool]
) -> list[Scalar]:
    """Operands of some operations within a function, where they depend on its own operands that vary."""
    jaxpr, found, parts = closed.jaxpr, [], []
    known = known_values(jaxpr, {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves})
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom not in known for atom in equation.invars]
        inner = equation.params.get("jaxpr")
        if any(moves) and isinstance(inner, ClosedJaxpr) and equation.primitive.name in ("jit", "pjit"):
            parts += operands_of(which, inner, evaluate(closed, list(equation.invars))(*operands), moves)
        elif any(moves):
            found += which(equation, moves)
    return elements_of(evaluate(closed, found)(*operands)) + parts


# What is smooth wherever it is finite. `sqrt`, `log` and `pow` are not: at 0 they are NaN or their rates infinite.
_SMOOTH = frozenset({
    "add", "add_any", "sub", "mul", "neg", "div", "integer_pow", "square", "exp", "exp2", "expm1", "log1p", "tanh",
    "logistic", "sin", "cos", "tan", "atan", "sinh", "cosh", "asinh", "erf", "erfc", "dot_general",
    "reduce_sum", "cumsum", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "concatenate",
    "slice", "stack", "rev", "copy", "convert_element_type", "stop_gradient", "split", "pad",
    "cholesky", "custom_linear_solve", "triangular_solve",
})  # fmt: skip


@functools.lru_cache(maxsize=256)
def may_have_kinks(signature: Signature) -> bool:
    """Whether the rates of state and integrals have an operation on the state that is not smooth everywhere.

    A part of the state whose rate is zero, such as a switch that resets change, is constant between two events.
    """
    if signature.options.smooth is not None:
        return not signature.options.smooth
    switches = switches_of(signature)
    whole = WholeMotion if switches is None else functools.partial(SwitchedMotion, switches)
    start = jax.eval_shape(lambda parameters: whole(signature, parameters).start(), signature.structs())

    def rate(elements: list[Any], parameters: list[Any]) -> Any:
        return whole(signature, parameters).rate(Augmented(tuple(elements), (0.0,) * len(signature.problem.integrals)))

    jaxpr = jax.make_jaxpr(rate)(start, signature.structs()).jaxpr
    made_by = {made: equation for equation in jaxpr.eqns for made in equation.outvars}
    varies = [not is_always_zero(value, made_by) for value in jaxpr.outvars[: len(start)]]
    return is_nonsmooth(jaxpr, varies + [False] * (len(jaxpr.invars) - len(start)))


def is_nonsmooth(jaxpr: Jaxpr, varies: list[bool]) -> bool:
    """Whether an operation on the arguments that vary is not smooth."""
    varying = {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves}
    pivoted: set[Atom] = set()  # jumps where rows are exchanged; a solution of the system does not
    shifts = shifts_of(jaxpr)
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom in varying for atom in equation.invars]
        if not any(moves) or not shifts.isdisjoint(equation.outvars):
            continue
        if equation.primitive.name in ("eq", "ne"):
            continue  # it holds, or not, all the way
        varying |= set(equation.outvars)
        if equation.primitive.name == "lu":
            pivoted |= set(equation.outvars)
            continue
        if equation.primitive.name != "custom_linear_solve" and not pivoted.isdisjoint(
            atom for atom in equation.invars if not isinstance(atom, Literal)
        ):
            return True
        if not all(np.issubdtype(getattr(made.aval, "dtype", float), np.floating) for made in equation.outvars):
            return True  # whole numbers and truths jump
        if equation.params.get("name") in SMOOTH_FUNCTIONS or equation.primitive.name in _SMOOTH:
            continue
        if equation.primitive.name == "select_n" and not moves[0]:
            continue  # the same case all the way
        inner = list(_inner(equation.params))
        # A loop or a branch chooses by the state: only plain calls are looked into.
        if len(inner) != 1 or len(inner[0].invars) != len(moves) or equation.primitive.name in ("while", "scan"):
            return True
        if is_nonsmooth(inner[0], moves):
            return True
    return not pivoted.isdisjoint(atom for atom in jaxpr.outvars if not isinstance(atom, Literal))


def _inner(parameters: dict[str, Any]) -> Iterator[Jaxpr]:
    """The functions that an operation calls."""
    for value in parameters.values():
        for part in value if isinstance(value, (tuple, list)) else (value,):
            if hasattr(part, "eqns"):
                yield getattr(part, "jaxpr", part)
