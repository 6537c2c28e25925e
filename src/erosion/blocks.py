"""Many lanes through the integrator: in blocks that stay in a core's cache, one thread a core."""

import concurrent.futures
import functools
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.clock import ENDED, NO_CUT
from erosion.compiler import for_speed
from erosion.integrator import Solution, solve
from erosion.jets import Derivatives
from erosion.model import CuttingModel
from erosion.own_parameters import own_parameters
from erosion.parameters import QUANTITIES, Parameters
from erosion.programs import Program
from erosion.tiling import alike_together

BLOCK = 64  # lanes of a block on a CPU; docs/performance.md
CALL = 2**13  # lanes of one call, whose blocks are walked one after another
_SHELF = 2**16  # lanes among which to look for neighbours: their parameters fit the second-level cache
_DOUBT = 100.0  # errors are mostly so much smaller than the tolerance
_GRAZE = 1e4  # likewise larger, over many turns of a fast spin
_TIGHTEST = 1e-13  # tolerance of the second time: rounding is near


def leaf_index(model: CuttingModel, name: str) -> int:
    """Which leaf of (model, p) a parameter is: a direction that need not be compiled in."""
    if name not in QUANTITIES:
        return own_parameters(model)[name].leaf
    return len(jax.tree.leaves(model)) + list(QUANTITIES).index(name)


def some_lanes(leaf: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Of a leaf (lanes,), those; one number in memory, where all lanes share it, stays one."""
    return np.broadcast_to(leaf[0], positions.shape) if leaf.strides == (0,) else leaf[positions]


def integrate(
    model: CuttingModel,
    lanes: list[np.ndarray],
    order: int,
    directions: tuple[str, ...] | np.ndarray,
    rtol: float,
    *,
    twice: bool = True,
) -> Solution:
    """Integrate lanes to their ends; those of doubtful accuracy twice.

    Where small errors of the motion may be large ones of the results, the lane is integrated
    again with a tolerance that is smaller by as much.

    Args:
        model: its own leaves are shared by all lanes.
        lanes: for each of `QUANTITIES` an array (lanes,); see `some_lanes`.
        order: 0, 1 or 2 derivatives.
        directions: names of parameters, each set of which is a program of its own; or leaf
            indices, shape (1 or 2, n), all of which one program serves: n times the lanes.
        rtol: of volume, end time and derivatives.
        twice: False leaves doubtful lanes as they are.

    Returns:
        Arrays of shape (lanes,), or (lanes · n,), those of one lane side by side; no `margin`, no `doubt`.
    """
    # A plain number of the model's would be part of the program's name.
    model = jax.tree.map(lambda leaf: np.float64(leaf) if isinstance(leaf, float) else leaf, model)
    names, indices = ((), directions) if isinstance(directions, np.ndarray) else (directions, np.zeros((0, 1), int))
    copies = indices.shape[1]
    block, call = _sizes()
    threads = _threads()

    def lane(positions: np.ndarray) -> np.ndarray:
        return positions // copies if copies > 1 else positions

    def walk(positions: np.ndarray, tolerance: np.ndarray, results: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Integrate some lanes, and note their results; returns those to repeat, and the tolerance of each."""

        def chunk(some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            # The last block is filled up with copies of its last lane.
            all_ = np.pad(some, (0, call - some.size), mode="edge") if some.size < call else some
            shape = (call // block, block)
            given = [_filled(leaf, lane(all_), shape) for leaf in lanes]
            along = [index[all_ % copies].reshape(shape) for index in indices]
            blocks = -(-some.size // block)
            found = _program(model, given, along, _filled(tolerance, all_, shape), np.int64(blocks), order, names)
            found = Solution.of(*(np.asarray(part).reshape(len(part), -1)[:, : some.size] for part in found))
            kept = jax.tree.leaves(found._replace(margin=None, doubt=None))
            for whole, part in zip(jax.tree.leaves(results), kept, strict=True):
                whole[some] = part
            smaller = _tighter(found, rtol)
            again = smaller < tolerance[some]
            return some[again], smaller[again]

        def shelf(some: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
            leaves = [leaf[lane(some)] for leaf in lanes if leaf.strides != (0,)]
            some = some[alike_together([some % copies, *leaves], block)]
            share = min(call, block * -(-some.size // block))
            return [chunk(part) for part in np.split(some, range(share, some.size, share))]

        if positions.size <= block:
            return chunk(positions)
        # Neighbours in turn to one thread and the other: they are alike, and so is what they cost.
        tables = np.array_split(positions, -(-positions.size // (max(_SHELF, call) * threads)))
        shelves = [table[i::threads] for table in tables for i in range(threads)]
        # Not kept for the next batch: a plug-in's own code may never give a thread back.
        with concurrent.futures.ThreadPoolExecutor(threads) as pool:
            parts = [part for some in pool.map(shelf, shelves) for part in some]
        again, smaller = (np.concatenate(part) for part in zip(*parts, strict=True))
        return again, smaller

    count = lanes[0].size * copies
    found = _empty(count, order)
    if not count:
        return found
    again, smaller = walk(np.arange(count), np.broadcast_to(rtol, count), found)
    if twice and again.size:
        tolerance = np.full(count, rtol)
        tolerance[again] = smaller
        walk(again, tolerance, found)
    return found


def _filled(leaf: np.ndarray, positions: np.ndarray, shape: tuple[int, int]) -> Any:
    """Some lanes of a leaf, as blocks; the same array again where all lanes share a number."""
    return _of_one(float(leaf[0]), shape) if leaf.strides == (0,) else leaf[positions].reshape(shape)


@functools.lru_cache(maxsize=64)
def _of_one(number: float, shape: tuple[int, int]) -> Any:
    # Without its type it would be a weak one, for which JAX compiles another program.
    return jnp.full(shape, number, float)


def _tighter(found: Solution, rtol: float) -> np.ndarray:
    """The tolerance that each lane needs."""
    cut = (found.mode == ENDED) & (found.which != NO_CUT)
    factor = np.where(cut & (found.doubt > _DOUBT), _DOUBT / np.where(cut, found.doubt, 1.0), 1.0)
    factor = np.where(found.margin < _GRAZE * rtol, np.minimum(factor, 1 / _GRAZE), factor)
    return np.maximum(factor * rtol, min(_TIGHTEST, rtol))


def _empty(count: int, order: int) -> Solution:
    """Arrays to fill; small ones, for memory that is new to a process is slow to get."""

    def derivatives() -> Derivatives:
        parts = (1, 3, 4)[order]
        return Derivatives(*(np.empty(count) for _ in range(parts)), *[None] * (4 - parts))

    mode, which, trials = (np.empty(count, kind) for kind in (np.int8, np.int8, np.int16))
    return Solution(mode, which, trials, None, None, derivatives(), derivatives())


# A function of its own to JAX, which traces it once for the shapes of its results and the loop.
@functools.partial(jax.jit, static_argnames=("order", "names"), inline=True)
def _block(
    model: CuttingModel, lanes: list[Any], along: list[Any], rtol: Any, order: int, names: tuple[str, ...]
) -> Any:
    """One block; arrays are (block,)."""
    # The physics does not depend on the unit system: one program serves all.
    p = Parameters(**dict(zip(QUANTITIES, lanes, strict=True)))
    return solve(model, p, order, names or tuple(along), rtol, few_functions=True)


def _chunk(
    model: CuttingModel,
    lanes: list[Any],
    along: list[Any],
    rtol: Any,
    blocks: Any,
    order: int,
    names: tuple[str, ...],
) -> Any:
    """The first `blocks` blocks of a chunk, one after another.

    Lanes are (blocks, block), the results (rows, blocks, block).
    """

    def run(i: Any) -> Any:
        return _block(model, *jax.tree.map(lambda leaf: leaf[i], (lanes, along, rtol)), order, names)

    def block(i: Any, done: Any) -> Any:
        return jax.tree.map(lambda all_, some: lax.dynamic_update_index_in_dim(all_, some, i, 1), done, run(i))

    shapes = jax.eval_shape(run, 0)
    empty = jax.tree.map(lambda part: jnp.zeros((part.shape[0], *rtol.shape)), shapes)
    return lax.fori_loop(0, blocks, block, empty)


@functools.cache
def _compiled_chunk() -> Any:
    return jax.jit(_chunk, static_argnames=("order", "names"), compiler_options=for_speed())


_program = Program(_chunk, for_speed, _compiled_chunk)


def _sizes() -> tuple[int, int]:
    """Lanes of a block, and of a call."""
    return (BLOCK, CALL) if jax.default_backend() == "cpu" else (2**14, 2**19)


def _threads() -> int:
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
