"""Functions of arrays that XLA keeps as they are: one loop over the lanes, or one function."""

import platform
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import eval_jaxpr
from jax.experimental.xla_metadata import set_xla_metadata

_COMPILES_WHOLE = {"0.9.0", "0.10.2", "0.12.0.1"}  # versions of jaxlib; see `one_function`

_Value = TypeVar("_Value")
WIDTH = 8  # rows of a kernel's result: of a longer stack XLA makes one loop a row, and a copy


class Kernel:
    """A function whose result is one array, kept whole as one loop over the lanes.

    Left alone, XLA's CPU compiler fuses each Runge-Kutta stage with all before it and
    computes the vector field hundreds of times over; it ignores optimization barriers there.
    A call that is not inlined is respected. On a GPU fusion does no such harm.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        def inlined(*arguments: Any) -> Any:
            # What the function itself calls (`jnp.where` is a call) is inlined into it.
            with set_xla_metadata(inlineable=None):
                return function(*arguments)

        self.function = jax.jit(inlined)

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        if jax.default_backend() != "cpu":
            return self.function(*arguments)
        with set_xla_metadata(inlineable="false"):
            return self.function(*arguments)


def narrow(values: list[_Value]) -> list[list[_Value]]:
    """Values in even parts of at most `WIDTH`."""
    parts = -(-len(values) // WIDTH)
    return [values[len(values) * i // parts : len(values) * (i + 1) // parts] for i in range(parts)]


def one_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of kernels that are compiled into one.

    XLA's CPU runtime starts each kernel by itself, in some 50 ns, which for a block of lanes
    is nearly as long as what it then does. It compiles small loops into one function, though,
    and takes larger ones where it is told that they are small. That is no promise of its
    interface, and where XLA cannot do it the process ends: it is asked for where it was tried, and
    of scalar arithmetic and control flow alone. The time to compile grows faster than the function.
    """
    tried = platform.system() == "Linux" and platform.machine() == "x86_64" and version("jaxlib") in _COMPILES_WHOLE
    if jax.default_backend() != "cpu" or not tried:
        return function

    def call(*arguments: Any) -> Any:
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        known = len(closed.consts)

        def opened(given: list[Any]) -> tuple[list[Any], list[Any]]:
            with set_xla_metadata(xla_cpu_small_call=None, inlineable=None):
                results = eval_jaxpr(closed.jaxpr, given[:known], *given[known:])
                # XLA has no place for an argument that nothing uses, and ends the process.
                return results, [jnp.ravel(argument)[:1] for argument in given]

        with set_xla_metadata(xla_cpu_small_call="true", inlineable="false"):
            results, _ = jax.jit(opened)([*closed.consts, *jax.tree.leaves(arguments)])
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return call
