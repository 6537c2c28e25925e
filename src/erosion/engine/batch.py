"""Many impacts through the integrator: alike ones side by side, one thread a core, doubtful ones twice."""

import concurrent.futures
import functools
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from erosion.engine.integrator import TIGHTEST, Solution, solve
from erosion.engine.leaves import Layout
from erosion.engine.ordering import alike_together
from erosion.engine.outcomes import has_no_result
from erosion.engine.variational import Derivatives
from erosion.lanes.choice import Compiled, compile_lanes, threads
from erosion.lanes.lanewise import WIDTH, number

_SHELF = 2**16  # lanes among which to look for neighbours: their numbers fit the second-level cache
_REPEATED = 4  # times at most
_FEW = 2048  # lanes; so few are computed sooner than shared among threads


class Results(NamedTuple):
    """What came of impacts; arrays of shape (lanes,).

    Args:
        outcome: an index of `end_names`.
        time, volume: the end of the cut and the volume removed; their derivatives as far as asked for.
        trials: steps that were tried the last time.
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
        _walk(self.program, [*self.leaves, rtol], lanes, self.outputs)

    @property
    def outputs(self) -> list[np.ndarray]:
        """The arrays in the order of the program's results."""
        results = self.results
        return jax.tree.leaves(Solution(results.outcome, self.tolerance, *results[1:3], None, results.trials))


def integrate(
    layout: Layout,
    numbers: Sequence[np.ndarray],
    lanes: int,
    order: int,
    directions: tuple[Any, ...],
    rtol: float,
    *,
    again: bool = True,
) -> Results:
    """Integrate lanes to their ends; those of doubtful accuracy again.

    Where small errors of the motion may be large ones of the results, the lane is integrated
    again with a tolerance that is smaller by as much, until two integrations agree.

    Args:
        layout: of model and case.
        numbers: each an array (lanes,), or of one lane's shape where all lanes share it.
        lanes: how many there are.
        order: 0, 1 or 2 derivatives.
        directions: a parameter's name, or one or two arrays of the places of elements, see `Variational`:
            numbers like the others, so that one program serves all.
        rtol: of volume, end time and derivatives.
        again: False leaves doubtful lanes as they are.
    """
    names = tuple(one for one in directions if isinstance(one, str))
    program = _program(layout, order, names, 0 if names else len(directions))
    places = () if names else tuple(np.asarray(one, float) for one in directions)
    leaves = [*(np.asarray(one, float) for one in numbers), *places]
    batch = _Batch(layout, program, leaves, _empty(lanes, order, len(directions)), np.empty(lanes))
    batch.run(np.arange(lanes), np.asarray(rtol))
    if again:
        _repeat(batch, np.flatnonzero(batch.tolerance < rtol), rtol)
    return batch.results


def _repeat(batch: _Batch, lanes: np.ndarray, rtol: float) -> None:
    """Integrate doubtful lanes again, each with its own tolerance, until two integrations agree.

    The error is in proportion to the tolerance, so that of the last integration is what it changed, times
    the ratio of both tolerances. One that fails, for rounding, leaves what was known before.
    """
    results, outputs = batch.results, batch.outputs
    used, following = np.full(lanes.size, rtol), batch.tolerance[lanes]
    tolerances = np.array(batch.tolerance)
    for _ in range(_REPEATED):
        if not lanes.size:
            return
        before = [output[lanes] for output in outputs]
        old = np.array(results.outcome[lanes]), results.time.value[lanes], results.volume.value[lanes]
        tolerances[lanes] = following
        batch.run(lanes, tolerances)
        outcome, time, volume = results.outcome[lanes], results.time.value[lanes], results.volume.value[lanes]
        lost = has_no_result(batch.layout, outcome) & ~has_no_result(batch.layout, old[0])
        for output, was in zip(outputs, before, strict=True):
            output[lanes[lost]] = was[lost]
        with np.errstate(all="ignore"):
            change = np.maximum(np.abs(time - old[1]) / np.abs(time), np.abs(volume - old[2]) / np.abs(volume))
            change = np.where(outcome == old[0], np.nan_to_num(change, posinf=1.0), 1.0)
            wanted = np.maximum(following * rtol / (change * following / used), TIGHTEST)
            wanted = np.where(lost, np.sqrt(used * following), wanted)
        more = lost | (wanted < following / 2)
        used, following, lanes = np.where(lost, used, following)[more], wanted[more], lanes[more]


def integrate_along(
    layout: Layout, numbers: Sequence[np.ndarray], lanes: int, order: int, places: np.ndarray, rtol: float
) -> Results:
    """Derivatives along several directions.

    Args:
        layout: as in `integrate`; so are the other arguments but `places`.
        numbers: of the lanes.
        lanes: how many there are.
        order: 1 or 2 derivatives.
        places: of elements, see `Variational`; shape (1 or 2, n).
        rtol: of the results.

    Returns:
        Arrays of shape (lanes, n).
    """
    count = places.shape[1]
    repeated = layout.of_lanes(numbers, np.repeat(np.arange(lanes), count))
    along = tuple(np.tile(one.astype(float), lanes) for one in places)
    each = integrate(layout, repeated, lanes * count, order, along, rtol)
    return jax.tree.map(lambda part: part.reshape(lanes, count), each)


def _walk(program: Compiled, leaves: list[np.ndarray], lanes: np.ndarray, outputs: list[np.ndarray]) -> None:
    """Integrate some lanes, and write their results."""
    count = threads()
    if lanes.size <= _FEW or count == 1:
        for begin in range(0, lanes.size, _SHELF):
            _shelf(program, leaves, lanes[begin : begin + _SHELF], outputs)
        return
    # Neighbours in turn to one thread and the other: they are alike, and so is what they cost.
    tables = np.array_split(lanes, -(-lanes.size // (_SHELF * count)))
    shelves = [table[i::count] for table in tables for i in range(count)]
    # Not kept for the next batch: a plug-in's own code may never give a thread back.
    with concurrent.futures.ThreadPoolExecutor(count) as pool:
        list(pool.map(lambda some: _shelf(program, leaves, some, outputs), shelves))


def _shelf(program: Compiled, leaves: list[np.ndarray], lanes: np.ndarray, outputs: list[np.ndarray]) -> None:
    if lanes.size > WIDTH:
        own = zip(leaves, program.inputs, strict=True)
        varying = [leaf[lanes] for leaf, shape in own if shape == () and leaf.ndim and leaf.strides != (0,)]
        if varying:
            lanes = lanes[alike_together(varying, WIDTH)]
    program.run(leaves, lanes, outputs)


def _empty(lanes: int, order: int, directions: int) -> Results:
    """Arrays to fill; as small as can be, for memory that is new to a process is slow to get."""

    def derivatives() -> Derivatives:
        value, *parts = (np.empty(lanes) for _ in range(order + 1))
        first, second = [*parts, None, None][:2]
        # Along one direction both first derivatives are the same, in the same place.
        other = np.empty(lanes) if directions == 2 else first
        return Derivatives(value, first, other, second)

    return Results(np.empty(lanes, np.int8), derivatives(), derivatives(), np.empty(lanes, np.int16))


compiling = threading.RLock()
"""What two threads ask for at once is compiled once."""


def _program(layout: Layout, order: int, names: tuple[str, ...], directions: int) -> Compiled:
    """The compiled integrator."""
    with compiling:
        return _compiled(layout, order, names, directions)


@functools.lru_cache(maxsize=256)
def _compiled(layout: Layout, order: int, names: tuple[str, ...], directions: int) -> Compiled:
    def lane(numbers: list[Any], places: tuple[Any, ...], rtol: Any) -> Solution:
        return solve(layout, numbers, names or places, rtol, order=order)

    return compile_lanes(lane, (layout.like(), (number,) * directions, number))
