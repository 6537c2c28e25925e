"""What is written in terms of other primitives: what newer versions of JAX have, and linear algebra."""

import functools
import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.extend.core import ClosedJaxpr, Jaxpr
from jax.typing import ArrayLike

from erosion.lanes.matrices import MATRICES
from erosion.lanes.scalars import Equation, Params, aval_of


def _polynomial(x: Array, *coefficients: Array, **_: Any) -> Array:
    """Horner's rule; the constant comes first."""
    return functools.reduce(lambda higher, coefficient: higher * x + coefficient, reversed(coefficients))


def _sliced(array: Array, *starts: Array, slice_sizes: tuple[int, ...]) -> Array:
    if not starts:
        return array
    axes = tuple(range(array.ndim))
    return lax.gather(array, jnp.stack(starts), lax.GatherDimensionNumbers(axes, (), axes), slice_sizes, mode="clip")


def _with_slice(array: Array, update: Array, *starts: Array) -> Array:
    if not starts:
        return update
    axes = tuple(range(array.ndim))
    return lax.scatter(array, jnp.stack(starts), update, lax.ScatterDimensionNumbers(axes, (), axes), mode="clip")


_EXPANSIONS: Mapping[str, Callable[..., Any]] = {
    **MATRICES,
    "dynamic_slice": _sliced,
    "dynamic_update_slice": _with_slice,
    "empty2": lambda *, dtype, **_: jnp.zeros((), dtype),  # what a branch leaves to the derivative of another
    "log2": lambda x, **_: jnp.log(x) / jnp.log(jnp.asarray(2.0, x.dtype)),
    "one_minus_square": lambda x: (1 + x) * (1 - x),
    "platform_index": lambda *, platforms: jnp.int32(
        [names is None or "cpu" in names for names in platforms].index(True)
    ),
    "polynomial": _polynomial,
}
"""Primitives, by their name, in plain JAX."""


def expansion(equation: Equation) -> ClosedJaxpr | None:
    """A primitive as a function of others; None where it is none."""
    primitive = equation.primitive
    # Since JAX 0.12 some functions (`searchsorted`, and so `interp`) are such primitives until JAX compiles them.
    is_high = primitive.name == "call_hi_primitive"
    function = primitive.to_lojax if is_high else _EXPANSIONS.get(primitive.name)
    if function is None:
        return None
    inputs = [jax.ShapeDtypeStruct(aval_of(atom).shape, aval_of(atom).dtype) for atom in equation.invars]
    return jax.make_jaxpr(functools.partial(function, **equation.params))(*inputs)


def forget_traces() -> None:
    """Have JAX trace all functions anew. What it has compiled stays, unlike after `jax.clear_caches`.

    JAX has no public function for this. A version without the private one forgets what it has compiled, too.
    """
    try:
        forget = importlib.import_module("jax._src.util").clear_all_caches
    except (ImportError, AttributeError):
        forget = jax.clear_caches
    forget()


CALLS = frozenset({
    "closed_call", "composite", "core_call", "custom_jvp_call", "custom_vjp_call", "eval_jaxpr", "jit", "pjit", "remat",
    "checkpoint", "remat2",
})  # fmt: skip
"""Primitives that call another traced function, which `called` gives."""


def called(equation: Equation) -> tuple[Jaxpr, Sequence[ArrayLike]]:
    """The function that a primitive of `CALLS` calls, and its constants."""
    inner = equation.params["jaxpr" if "jaxpr" in equation.params else "call_jaxpr"]
    return getattr(inner, "jaxpr", inner), getattr(inner, "consts", ())


def carried_by_scan(params: Params) -> tuple[int, int]:
    """How many constants a scan has, and how many values it carries."""
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    constants, carried, _ = params["ft_in"].unpack()  # since JAX 0.12
    return len(constants), len(carried)
