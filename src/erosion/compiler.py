"""Options of XLA's CPU compiler, for programs that run often and for those that run seldom."""

import functools
from typing import Any

import jax

# Vectors as wide as the machine has them, and no splitting of one small loop over threads: together a
# fifth of the time. Moving reshapes about gains nothing, but has the program simplified 25 times over.
# The older code generator needs no MLIR. A part for each of two threads: of few kernels more are no quicker.
_FAST = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner,reshape-mover",
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 2,
}
# The older one again, and LLVM does not optimise: two thirds of the time to compile.
_QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def for_speed() -> dict[str, Any]:
    """Options for a program that runs often."""
    return _accepted(tuple(_FAST.items()))


def for_few_runs() -> dict[str, Any]:
    """Options for a program that takes longer to compile than to run, and, an impact at a time, runs no slower."""
    return _accepted(tuple(_QUICK.items()))


@functools.cache
def _accepted(options: tuple[tuple[str, Any], ...]) -> dict[str, Any]:
    """Those of the options that this version of XLA knows, on a CPU; elsewhere none."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=dict(options))(1.0)
    except jax.errors.JaxRuntimeError:
        alone = [_accepted((option,)) for option in options] if len(options) > 1 else []
        return {name: value for option in alone for name, value in option.items()}
    return dict(options)
