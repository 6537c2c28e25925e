"""Many lanes through the integrator: in blocks that stay in a core's cache, one thread a core."""

import concurrent.futures
import functools
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.integrator import Solution, solve
from erosion.jets import Derivatives
from erosion.model import CuttingModel
from erosion.parameters import QUANTITIES, Parameters

BLOCK = 256  # lanes of a block on a CPU: their stages fit the second-level cache
CHUNK = 256  # blocks of one call, walked one after another


def leaf_index(model: CuttingModel, name: str) -> int:
    """Which leaf of (model, p) a parameter is: a direction that need not be compiled in."""
    return len(jax.tree.leaves(model)) + list(QUANTITIES).index(name)


def integrate(
    model: CuttingModel, lanes: list[np.ndarray], order: int, directions: tuple[str, ...] | np.ndarray, rtol: float
) -> Solution:
    """Integrate lanes to their ends.

    Args:
        model: its own leaves are shared by all lanes.
        lanes: for each of `QUANTITIES` an array (lanes,).
        order: 0, 1 or 2 derivatives.
        directions: names of parameters, each set of which is a program of its own; or leaf
            indices, shape (1 or 2, n), all of which one program serves: n times the lanes.
        rtol: of volume, end time and derivatives.

    Returns:
        Arrays of shape (lanes,), or (lanes · n,), those of one lane side by side.
    """
    names, indices = ((), directions) if isinstance(directions, np.ndarray) else (directions, np.zeros((0, 1), int))
    count, copies = lanes[0].size * indices.shape[1], indices.shape[1]
    results = _empty(count, order)
    if not count:
        return results
    block = _block_size()
    capacity = block if count <= block else block * CHUNK

    def work(begin: int) -> None:
        end = min(begin + capacity, count)
        # The last block is filled up with copies of its last lane.
        lane, copy = np.divmod(np.minimum(np.arange(begin, begin + capacity), end - 1), copies)
        blocks = -(-(end - begin) // block)
        chunk = [leaf[lane].reshape(-1, block) for leaf in lanes]
        along = [index[copy].reshape(-1, block) for index in indices]
        found = _compiled_chunk()(model, chunk, along, blocks, order, names, rtol)
        for all_, some in zip(jax.tree.leaves(results), jax.tree.leaves(found), strict=True):
            all_[begin:end] = np.asarray(some).reshape(-1)[: end - begin]

    begins = range(0, count, capacity)
    if len(begins) == 1:
        work(0)
    else:
        with concurrent.futures.ThreadPoolExecutor(_threads()) as pool:
            list(pool.map(work, begins))
    return results


def _empty(count: int, order: int) -> Solution:
    def derivatives() -> Derivatives:
        parts = (1, 3, 4)[order]
        return Derivatives(*(np.empty(count) for _ in range(parts)), *[None] * (4 - parts))

    return Solution(np.empty(count), np.empty(count), derivatives(), derivatives(), np.empty(count))


# A function of its own to JAX, so that it is traced once for chunks of all sizes.
@functools.partial(jax.jit, static_argnames=("order", "names"), inline=True)
def _block(
    model: CuttingModel, lanes: list[Any], along: list[Any], order: int, names: tuple[str, ...], rtol: Any
) -> Solution:
    """One block; lanes are (block,)."""
    # The physics does not depend on the unit system: one program serves all.
    p = Parameters(**dict(zip(QUANTITIES, lanes, strict=True)))
    return solve(model, p, order, names or tuple(along), rtol)


def _chunk(
    model: CuttingModel, lanes: list[Any], along: list[Any], blocks: Any, order: int, names: tuple[str, ...], rtol: Any
) -> Solution:
    """The first `blocks` blocks of a chunk, one after another; lanes are (blocks, block)."""

    def run(i: Any) -> Solution:
        return _block(model, *jax.tree.map(lambda leaf: leaf[i], (lanes, along)), order, names, rtol)

    def block(i: Any, done: Solution) -> Solution:
        return jax.tree.map(lambda all_, some: lax.dynamic_update_index_in_dim(all_, some, i, 0), done, run(i))

    shapes = jax.eval_shape(run, 0)
    empty = jax.tree.map(lambda leaf: jnp.zeros((lanes[0].shape[0], *leaf.shape), leaf.dtype), shapes)
    return lax.fori_loop(0, blocks, block, empty)


@functools.cache
def _compiled_chunk() -> Any:
    return jax.jit(_chunk, static_argnames=("order", "names"), compiler_options=_compiler_options())


def _compiler_options() -> dict[str, Any]:
    """Options worth a fifth of the time on a CPU, where this version of XLA knows them."""
    if jax.default_backend() != "cpu":
        return {}
    # Vectors as wide as the machine has them, and no splitting of one small loop over threads.
    options = {"xla_cpu_prefer_vector_width": 512, "xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=options)(1.0)
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def _block_size() -> int:
    return BLOCK if jax.default_backend() == "cpu" else BLOCK * CHUNK


def _threads() -> int:
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
