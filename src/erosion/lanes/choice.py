"""The choice of a compiler for lanes: this package's on a CPU, XLA on a GPU."""

import functools
import importlib.util
import os
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.lanes.lanewise import Lanewise
from erosion.lanes.xla import XlaLanes

ENGINE = "EROSION_ENGINE"
"""The environment variable that says "xla" to have XLA compile for a CPU too."""


@runtime_checkable
class Compiled(Protocol):
    """A function of one lane, compiled for many."""

    inputs: list[tuple[int, ...]]
    """Shapes of one lane's arguments."""

    def run(
        self,
        leaves: Sequence[np.ndarray],
        order: np.ndarray,
        results: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
    ) -> None:
        """Compute some lanes; see `Lanewise.run`."""
        ...


def compile_lanes(function: Callable[..., PyTree], examples: Sequence[PyTree]) -> Compiled:
    """Compile a function of one lane's numbers; see `Lanewise`."""
    return XlaLanes(function, examples) if by_xla() else Lanewise(function, examples)


@functools.cache
def by_xla() -> bool:
    """Whether XLA compiles lanes.

    Raises:
        ValueError: for an unknown value of `EROSION_ENGINE`.
    """
    asked = os.environ.get(ENGINE, "")
    if asked not in ("", "lanes", "xla"):
        raise ValueError(f"The environment variable {ENGINE} must be `lanes` or `xla`, but is {asked!r}.")
    # Asking JAX for its devices takes a tenth of a second, so only where a GPU's plug-in is installed.
    plugins = ("jax_cuda12_plugin", "jax_cuda13_plugin", "jax_rocm60_plugin", "jax_rocm7_plugin", "libtpu")
    may_be_gpu = any(importlib.util.find_spec(name) for name in plugins)
    return asked == "xla" or (not asked and may_be_gpu and jax.default_backend() != "cpu")


def threads() -> int:
    """How many threads compute lanes at once."""
    if by_xla():
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
