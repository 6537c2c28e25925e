"""Programs of XLA that take longer to compile than to run."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
from jaxtyping import PyTree

from erosion.models.base import CuttingModel
from erosion.models.equations import equations_of
from erosion.parameters.parameters import Parameters
from erosion.parameters.units import System

_Function = TypeVar("_Function", bound=Callable[..., PyTree])

# The older code generator, and LLVM does not optimise: two thirds of the time to compile.
_QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def seldom_run(function: _Function) -> _Function:
    """The function as a program that is compiled quickly; for single impacts it runs no slower."""
    jit: Any = eqx.filter_jit  # whose signature does not say that options are passed on to `jax.jit`

    @functools.cache
    def program() -> Callable[..., PyTree]:
        return jit(lambda _, *arguments: function(*arguments), compiler_options=_accepted(tuple(_QUICK.items())))

    @functools.wraps(function)
    def call(*arguments: PyTree) -> PyTree:
        # JAX knows a model by its class and fields. Its code may have been defined anew.
        parts = jax.tree.leaves(arguments, is_leaf=lambda part: isinstance(part, (CuttingModel, Parameters)))
        units: set[System] = {part.units for part in parts if isinstance(part, Parameters)} or {"inch-pound"}
        models = [part for part in parts if isinstance(part, CuttingModel)]
        return program()([equations_of(model, one).digest for model in models for one in units], *arguments)

    return cast(_Function, call)


@functools.cache
def _accepted(options: tuple[tuple[str, bool | int], ...]) -> dict[str, bool | int]:
    """Those of the options that this version of XLA knows, on a CPU; elsewhere none."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=dict(options))(1.0)
    except jax.errors.JaxRuntimeError:
        alone = [_accepted((option,)) for option in options] if len(options) > 1 else []
        return {name: value for option in alone for name, value in option.items()}
    return dict(options)
