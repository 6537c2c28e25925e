"""The engine that computes lanes: the processor, or a GPU where the environment asks for it."""

import functools
import os
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import PyTree

from erosion.lanes.gpu import GpuLanes
from erosion.lanes.lanewise import Lanewise
from erosion.lanes.program_files import ProgramFile

ENGINE = "EROSION_ENGINE"
"""The environment variable: "gpu" has a GPU compute calls of many lanes."""

_FEEDING = 8  # threads at most that order and copy lanes for a GPU
_BLOCK = 2**17  # lanes for a GPU: several for each of its threads


def compile_lanes(
    function: Callable[..., PyTree], examples: Sequence[PyTree], *, tapes: int = 0, what: str = ""
) -> Lanewise:
    """Compile a function of one lane's numbers, or read it from a file of an earlier process; see `Lanewise`.

    Args:
        function: takes and returns pytrees of numbers and small arrays; written in plain JAX.
        examples: examples of its arguments, or `jax.ShapeDtypeStruct` of them.
        tapes: how many tapes the function has; see `erosion.lanes.tapes`.
        what: all that the function computes, the same text in every process; without it the program is not kept.

    Raises:
        NoGpuError: where the environment asks for a GPU that cannot compute.
    """
    if by_gpu():
        return GpuLanes(function, examples, tapes=tapes)
    return Lanewise(function, examples, tapes=tapes, file=ProgramFile(what) if what else None)


@functools.cache
def by_gpu() -> bool:
    """Whether the environment asks for a GPU.

    Raises:
        ValueError: for an unknown value of `EROSION_ENGINE`.
    """
    asked = os.environ.get(ENGINE, "")
    if asked not in ("", "cpu", "gpu"):
        raise ValueError(f"The environment variable {ENGINE} must be `cpu` or `gpu`, but is {asked!r}.")
    return asked == "gpu"


def threads() -> int:
    """How many threads compute lanes at once, or feed a GPU."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, _FEEDING) if by_gpu() else cores


def blocks_for_threads(lanes: np.ndarray, block: int, count: int) -> list[np.ndarray]:
    """Blocks of lanes for several threads; a GPU gets neighbours, which are copied as they are.

    On a processor, neighbours go to the threads in turn: they are similar, and so are their costs.
    """
    if by_gpu():
        return np.array_split(lanes, -(-lanes.size // _BLOCK))
    tables = np.array_split(lanes, -(-lanes.size // (block * count)))
    return [table[i::count] for table in tables for i in range(count)]
