"""A function's arithmetic, taken apart into operations on scalars."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

_CALLS = {"jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint"}


class NotScalarArithmeticError(Exception):
    """The function does something else."""


class Constant(NamedTuple):
    """A number known when the function is taken apart."""

    dtype: str
    data: bytes

    @property
    def array(self) -> Any:
        """It, as numpy has it."""
        return np.frombuffer(self.data, self.dtype)[0]


Value = int | Constant


class Operation(NamedTuple):
    """What makes a value out of others."""

    primitive: Any
    params: dict[str, Any]
    inputs: tuple[Value, ...]
    dtype: Any

    def numbers(self) -> list[int]:
        """Its inputs that are no constants."""
        return [value for value in self.inputs if isinstance(value, int)]


class Graph:
    """A function's operations on scalars, calls opened up, each distinct one once.

    Values are numbered: the arguments, then results in an order in which they can be computed.
    """

    def __init__(self, closed: ClosedJaxpr) -> None:
        self.operations: dict[int, Operation] = {}
        self._count = len(closed.jaxpr.invars)
        self._seen: dict[Any, int] = {}
        self.outputs = self._open(closed.jaxpr, closed.consts, list(range(self._count)))

    def add(self, operation: Operation) -> int:
        """The number of an operation's result."""
        key = (operation.primitive.name, repr(operation.params), operation.inputs)
        if key not in self._seen:
            self._seen[key] = self.new()
            self.operations[self._seen[key]] = operation
        return self._seen[key]

    def new(self) -> int:
        """A number for one more value."""
        self._count += 1
        return self._count - 1

    def _open(self, jaxpr: Jaxpr, constants: Sequence[Any], arguments: Sequence[Value]) -> list[Value]:
        values = dict(zip(jaxpr.constvars, map(constant, constants), strict=True))
        values |= dict(zip(jaxpr.invars, arguments, strict=True))

        def read(atom: Any) -> Value:
            return constant(np.asarray(atom.val, _dtype(atom))) if isinstance(atom, Literal) else values[atom]

        for equation in jaxpr.eqns:
            inputs, inner = [read(atom) for atom in equation.invars], _called(equation)
            if inner is not None:
                results = self._open(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), inputs)
            else:
                _check_scalar(equation)
                dtype = _dtype(equation.outvars[0])
                results = [self.add(Operation(equation.primitive, equation.params, tuple(inputs), dtype))]
            values |= dict(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]


def _dtype(atom: Any) -> Any:
    return atom.aval.dtype


def constant(value: Any) -> Constant:
    """A number, for an operation's input."""
    if isinstance(value, Tracer) or np.shape(value) != ():
        raise NotScalarArithmeticError
    array = np.asarray(value)
    return Constant(array.dtype.str, array.tobytes())


def _called(equation: Any) -> Any:
    if equation.primitive.name not in _CALLS:
        return None
    return equation.params.get("jaxpr") or equation.params.get("call_jaxpr")


def _check_scalar(equation: Any) -> None:
    inside = jax.tree.leaves(
        list(equation.params.values()), is_leaf=lambda leaf: isinstance(leaf, (Jaxpr, ClosedJaxpr))
    )
    if (
        any(atom.aval.shape != () for atom in (*equation.invars, *equation.outvars))
        or any(isinstance(part, (Jaxpr, ClosedJaxpr)) for part in inside)
        or len(equation.outvars) != 1
        or equation.effects
    ):
        raise NotScalarArithmeticError


def run(operations: dict[int, Operation], values: dict[int, Any], results: Iterable[Value]) -> list[Any]:
    """The results, from the values of what the operations do not compute; traceable."""

    def read(value: Value) -> Any:
        return values[value] if isinstance(value, int) else value.array

    for number, (primitive, params, inputs, _) in operations.items():
        values[number] = primitive.bind(*map(read, inputs), **params)
    return [jnp.asarray(read(value)) for value in results]


def hoisted(graph: Graph, fixed: Iterable[int]) -> tuple[list[Value], dict[int, Operation], dict[int, Operation]]:
    """The graph's outputs, and its operations before and within the loop.

    A quotient by something known is made a product with its reciprocal, which the rules for
    zeros, infinities and NaN allow.
    """
    known, constants = set(fixed), set()
    settled = set(known)  # known or constant
    before: dict[int, Operation] = {}
    within: dict[int, Operation] = {}
    for number, operation in list(graph.operations.items()):
        numbers = operation.numbers()
        if constants.issuperset(numbers):
            # XLA folds constants, and what they multiply, where it sees them.
            constants.add(number)
            settled.add(number)
            before[number] = within[number] = operation
        elif settled.issuperset(numbers):
            known.add(number)
            settled.add(number)
            before[number] = operation
        elif operation.primitive is lax.div_p and isinstance(by := operation.inputs[1], int) and by in known:
            one = constant(np.ones((), operation.dtype))
            inverse = graph.add(operation._replace(inputs=(one, by)))
            known.add(inverse)
            settled.add(inverse)
            before[inverse] = graph.operations[inverse]
            within[number] = Operation(lax.mul_p, {}, (operation.inputs[0], inverse), operation.dtype)
        else:
            within[number] = operation
    return graph.outputs, before, within
