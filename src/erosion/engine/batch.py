"""Many impacts through the integrator: similar lanes side by side, one thread a core, doubtful lanes again."""

import concurrent.futures
import functools
import threading
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from erosion.array_types import Number, PerLane, Scalar
from erosion.engine.integrator import TIGHTEST, Solution, solve
from erosion.engine.leaves import Layout
from erosion.engine.ordering import alike_together
from erosion.engine.outcomes import has_no_result
from erosion.engine.variational import Derivatives
from erosion.lanes.choice import Compiled, compile_lanes, threads
from erosion.lanes.lanewise import WIDTH, number

_BLOCK = 2**16  # lanes that are ordered together: their numbers fit the second-level cache
_REPEATED = 4  # times at most
_FEW = 2048  # lanes: fewer are computed sooner by one thread than by several


class Results(NamedTuple):
    """The results of impacts; arrays of shape (lanes,).

    Args:
        outcome: an index of `end_names`.
        time, volume: the end of the cut and the volume removed, with the derivatives asked for.
        trials: number of steps tried in the last integration.
    """

    outcome: np.ndarray
    time: Derivatives
    volume: Derivatives
    trials: np.ndarray


class _Batch(NamedTuple):
    """A program, its arguments, and the arrays that it fills."""

    layout: Layout
    program: Compiled
    leaves: list[np.ndarray]
    results: Results
    tolerance: np.ndarray

    def run(self, lanes: np.ndarray, rtol: np.ndarray) -> None:
        """Integrate some lanes with their tolerances."""
        _compute(self.program, [*self.leaves, rtol], lanes, self.outputs)

    @property
    def is_known(self) -> np.ndarray:
        """Whether all numbers of a lane are finite, shape (lanes,)."""
        known = np.ones(self.tolerance.size, bool)
        for leaf, shape in zip(self.leaves, self.program.inputs, strict=False):
            known &= np.isfinite(leaf).all(axis=tuple(range(leaf.ndim - len(shape), leaf.ndim)))
        return known

    @property
    def outputs(self) -> list[np.ndarray]:
        """The arrays in the order of the program's results."""
        results = self.results
        return jax.tree.leaves(Solution(results.outcome, self.tolerance, *results[1:3], None, results.trials))


def integrate(
    layout: Layout,
    numbers: Sequence[PerLane],
    lanes: int,
    order: int,
    directions: tuple[str | PerLane, ...],
    rtol: float,
    *,
    again: bool = True,
) -> Results:
    """Integrate lanes to their ends, and lanes of doubtful accuracy again.

    Where small errors of the motion may be large errors of the results, the lane is integrated
    again with a tolerance that is smaller by the same factor, until two integrations agree.

    Args:
        layout: layout of model and case.
        numbers: each an array (lanes,), or of one lane's shape where all lanes share it.
        lanes: number of lanes.
        order: 0, 1 or 2 derivatives.
        directions: a parameter's name, or one or two arrays of places of elements, see `Variational`.
            Places are numbers, so one program serves all of them.
        rtol: relative tolerance of volume, end time and derivatives.
        again: False leaves doubtful lanes as they are.
    """
    layout = layout.renewed()
    names = tuple(direction for direction in directions if isinstance(direction, str))
    program = _program(layout, order, names, 0 if names else len(directions))
    places = () if names else tuple(np.asarray(direction, float) for direction in directions)
    leaves = [*(np.asarray(number, float) for number in numbers), *places]
    batch = _Batch(layout, program, leaves, _empty(lanes, order, len(directions)), np.empty(lanes))
    batch.run(np.arange(lanes), np.asarray(rtol))
    if again:
        _repeat(batch, np.flatnonzero(batch.tolerance < rtol), rtol)
    if order:
        _with_fewer_derivatives(batch, order, directions, rtol, again=again)
    return batch.results


def _with_fewer_derivatives(
    batch: _Batch, order: int, directions: tuple[str | PerLane, ...], rtol: float, *, again: bool
) -> None:
    """Integrate lanes that failed with derivatives again with fewer: their volume may exist although these do not.

    The derivatives that are not computed are NaN.
    """
    results = batch.results
    lost = np.flatnonzero(has_no_result(batch.layout, results.outcome) & batch.is_known)
    if not lost.size:
        return
    numbers = batch.layout.of_lanes(batch.leaves[: len(batch.layout.shapes)], lost)
    along = tuple(each if isinstance(each, str) or not np.ndim(each) else each[lost] for each in directions)
    # Along two directions the first derivatives are two integrations.
    lower = [
        integrate(batch.layout, numbers, lost.size, order - 1, each, rtol, again=again)
        for each in ([(direction,) for direction in along] if order == 2 else [()])
    ]
    results.outcome[lost], results.trials[lost] = lower[0].outcome, lower[0].trials
    for name in ("time", "volume"):
        parts, (of_first, *of_other) = getattr(results, name), [getattr(each, name) for each in lower]
        parts.value[lost] = of_first.value
        if order == 2:
            parts.first[lost] = of_first.first
            for other in of_other:
                parts.other[lost] = other.first


def _repeat(batch: _Batch, lanes: np.ndarray, rtol: float) -> None:
    """Integrate doubtful lanes again, each with its own tolerance, until two integrations agree.

    The error is proportional to the tolerance. So the error of the last integration is the change it
    made, times the ratio of both tolerances. An integration that fails, by rounding, changes no result.
    """
    results, outputs = batch.results, batch.outputs
    used, following = np.full(lanes.size, rtol), batch.tolerance[lanes]
    tolerances = np.array(batch.tolerance)
    for _ in range(_REPEATED):
        if not lanes.size:
            return
        previous = [output[lanes] for output in outputs]
        old = np.array(results.outcome[lanes]), results.time.value[lanes], results.volume.value[lanes]
        tolerances[lanes] = following
        batch.run(lanes, tolerances)
        outcome, time, volume = results.outcome[lanes], results.time.value[lanes], results.volume.value[lanes]
        lost = has_no_result(batch.layout, outcome) & ~has_no_result(batch.layout, old[0])
        for output, old_output in zip(outputs, previous, strict=True):
            output[lanes[lost]] = old_output[lost]
        with np.errstate(all="ignore"):
            change = np.maximum(np.abs(time - old[1]) / np.abs(time), np.abs(volume - old[2]) / np.abs(volume))
            change = np.where(outcome == old[0], np.nan_to_num(change, posinf=1.0), 1.0)
            wanted = np.maximum(following * rtol / (change * following / used), TIGHTEST)
            wanted = np.where(lost, np.sqrt(used * following), wanted)
        again = lost | (wanted < following / 2)
        used, following, lanes = np.where(lost, used, following)[again], wanted[again], lanes[again]


def integrate_along(
    layout: Layout, numbers: Sequence[PerLane], lanes: int, order: int, places: np.ndarray, rtol: float
) -> Results:
    """Derivatives along several directions.

    Args:
        layout: as in `integrate`, and so are `numbers`, `lanes` and `rtol`.
        numbers: of the lanes.
        lanes: number of lanes.
        order: 1 or 2 derivatives.
        places: places of elements, see `Variational`; shape (1 or 2, n).
        rtol: relative tolerance.

    Returns:
        Arrays of shape (lanes, n).
    """
    count = places.shape[1]
    repeated = layout.of_lanes(numbers, np.repeat(np.arange(lanes), count))
    directions = tuple(np.tile(row.astype(float), lanes) for row in places)
    results = integrate(layout, repeated, lanes * count, order, directions, rtol)
    return jax.tree.map(lambda part: part.reshape(lanes, count), results)


def _compute(program: Compiled, leaves: list[np.ndarray], lanes: np.ndarray, outputs: list[np.ndarray]) -> None:
    """Integrate some lanes, and write their results."""
    count = threads()
    if lanes.size <= _FEW or count == 1:
        for begin in range(0, lanes.size, _BLOCK):
            _compute_block(program, leaves, lanes[begin : begin + _BLOCK], outputs)
        return
    # Neighbours go to the threads in turn: they are similar, and so are their costs.
    tables = np.array_split(lanes, -(-lanes.size // (_BLOCK * count)))
    blocks = [table[i::count] for table in tables for i in range(count)]
    # Not kept for the next batch: a plug-in's own code may never return a thread.
    stop = np.zeros(1, np.int64)
    with concurrent.futures.ThreadPoolExecutor(count) as pool:
        try:
            list(pool.map(lambda block: _compute_block(program, leaves, block, outputs, stop), blocks))
        except BaseException:
            # Signals reach the main thread alone. The others would go on, for ever in a loop that never ends.
            stop[0] = 1
            raise


def _compute_block(
    program: Compiled,
    leaves: list[np.ndarray],
    lanes: np.ndarray,
    outputs: list[np.ndarray],
    stop: np.ndarray | None = None,
) -> None:
    if lanes.size > WIDTH:
        inputs = zip(leaves, program.inputs, strict=True)
        varying = [leaf[lanes] for leaf, shape in inputs if shape == () and leaf.ndim and leaf.strides != (0,)]
        if varying:
            lanes = lanes[alike_together(varying, WIDTH)]
    program.run(leaves, lanes, outputs, stop)


def _empty(lanes: int, order: int, directions: int) -> Results:
    """Arrays to fill, as small as possible: memory that is new to a process is slow to get."""

    def derivatives() -> Derivatives:
        value, *parts = (np.empty(lanes) for _ in range(order + 1))
        first, second = [*parts, None, None][:2]
        # Along one direction both first derivatives are the same, in the same place.
        other = np.empty(lanes) if directions == 2 else first
        return Derivatives(value, first, other, second)

    return Results(np.empty(lanes, np.int8), derivatives(), derivatives(), np.empty(lanes, np.int16))


compiling = threading.RLock()
"""While one thread compiles, others wait: each program is compiled once."""


def _program(layout: Layout, order: int, names: tuple[str, ...], directions: int) -> Compiled:
    """The compiled integrator."""
    with compiling:
        return _compiled(layout, order, names, directions)


@functools.lru_cache(maxsize=256)
def _compiled(layout: Layout, order: int, names: tuple[str, ...], directions: int) -> Compiled:
    def lane(numbers: list[Number], places: tuple[Scalar, ...], rtol: Scalar) -> Solution:
        return solve(layout, numbers, names or places, rtol, order=order)

    return compile_lanes(lane, (layout.structs(), (number,) * directions, number))
