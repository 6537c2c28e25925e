"""Many lanes through the integrator: similar lanes side by side, one thread a core, doubtful lanes again."""

import concurrent.futures
import functools
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import Number, PerLane, Scalar
from erosion.lanes.engines import blocks_for_threads, compile_lanes, threads
from erosion.lanes.flatten import NotForLanesError
from erosion.lanes.lanewise import WIDTH, Lanewise, alike_together, number
from erosion.ode.integrator import LaneEnd, integrate_lane
from erosion.ode.methods import METHODS
from erosion.ode.methods.base import TIGHTEST
from erosion.ode.signature import Signature
from erosion.ode.switches import require_derivatives
from erosion.ode.tape import row_width
from erosion.ode.variational import Derivatives, Direction
from erosion.ode.verification import AccuracyCheck, Reached, of_lanes

_REPEATED = 4  # times at most
_BLOCK = 2**16  # lanes that are ordered together: their numbers fit the second-level cache
ROWS, _RECORDED = 64, 2**12  # of the tape of a lane that is recorded, and how many lanes are at most
_FEW = 2048  # lanes: fewer are computed sooner by one thread than by several


class _Batch(NamedTuple):
    """A program, its arguments, and the arrays that it fills.

    Where states at times are wanted there are two tapes, see `tape`: the times, and what is wanted there. Where the
    steps are recorded, or events, there is one for them.
    """

    signature: Signature
    program: Lanewise
    leaves: list[np.ndarray]
    results: LaneEnd
    used: np.ndarray  # tolerances of the results
    errors: np.ndarray  # of values, by their greatest sizes
    accuracy: AccuracyCheck
    tapes: Sequence[np.ndarray] = ()

    def run(self, lanes: np.ndarray, rtol: np.ndarray) -> None:
        """Integrate some lanes with their tolerances."""
        self.used[lanes] = rtol
        self._compute([*self.leaves, rtol], lanes)

    def _compute(self, leaves: list[np.ndarray], lanes: np.ndarray, *, ordered: bool = False) -> None:
        """Integrate some lanes, and write their results; unless they are `ordered`, similar ones side by side."""

        def block(lanes: np.ndarray, stop: np.ndarray | None) -> None:
            if lanes.size > WIDTH and not ordered:
                inputs = zip(leaves, self.program.inputs, strict=True)
                varying = [leaf[lanes] for leaf, shape in inputs if shape == () and leaf.ndim and leaf.strides != (0,)]
                if varying:
                    lanes = lanes[alike_together(varying, WIDTH)]
            self.program.run(leaves, lanes, self.outputs, stop, self.tapes)

        in_threads(block, lanes, _BLOCK, _FEW)

    @property
    def is_known(self) -> np.ndarray:
        """Whether all numbers of the arguments of a lane are finite, shape (lanes,)."""
        known = np.ones(self.used.size, bool)
        for leaf, shape in zip(self.leaves[: self.signature.arguments], self.program.inputs, strict=False):
            known &= np.isfinite(leaf).all(axis=tuple(range(leaf.ndim - len(shape), leaf.ndim)))
        return known

    def reached(self, lanes: np.ndarray) -> Reached:
        """The results of some lanes; they stay as they are whatever follows."""
        return jax.tree.map(lambda part: part[lanes], self._arrays)

    def put(self, lanes: np.ndarray, reached: Reached) -> None:
        """Write the results of some lanes."""
        _put(self._arrays, reached, lanes)

    def refine(self, lanes: np.ndarray, rtol: np.ndarray) -> Reached:
        """Integrate some lanes again, each with its tolerance; their results before that."""
        before = self.reached(lanes)
        # The longest lanes come first: none is left alone at the end.
        order = np.argsort(-self.results.trials[lanes], kind="stable")
        self.used[lanes] = rtol[lanes]
        self._compute([*self.leaves, rtol], lanes[order], ordered=True)
        return before

    def adopt(self, found: LaneEnd, lanes: np.ndarray, better: np.ndarray | slice = slice(None)) -> None:
        """Write the results of another program into some lanes, where they are better."""
        those, results = lanes[better], self.results
        for name in ("outcome", "time", "outputs", "trials", "count", "at_once", "least", "reached", "slides"):
            part = jax.tree.map(lambda each: each[better], getattr(found, name))
            _put(getattr(results, name), part, those)
        if found.saved is not None:
            self.saved[those] = np.asarray(found.saved)[better]
        if results.recorded is not None:
            results.recorded.rows[those] = 0
        self.used[those], self.errors[those] = np.asarray(found.rtol_used)[better], np.asarray(found.error)[better]

    def times(self, lanes: np.ndarray) -> np.ndarray | None:
        """The times at which states of some lanes are wanted, shape (lanes, n)."""
        return self.tapes[0][lanes, :-1] if self.timed else None

    @property
    def timed(self) -> bool:
        """Whether states at times are wanted."""
        return len(self.tapes) > 1

    @property
    def saved(self) -> np.ndarray:
        """Numbers at times, or of events, and their derivatives, see `LaneEnd`."""
        return self.tapes[-1]

    def check(self, lanes: np.ndarray, rtol: float) -> None:
        """Integrate lanes with a greater tolerance, to know which of them need a smaller one; the results stay."""
        if not lanes.size:
            return
        tolerances = np.array(self.results.rtol_next)
        before = self.refine(lanes, tolerances)
        errors = self.accuracy.compare(lanes, before, self.reached(lanes), rtol / tolerances[lanes])
        self.errors[lanes] = errors.greatest
        self.put(lanes, before)
        with np.errstate(divide="ignore"):
            self.results.rtol_next[lanes] = np.maximum(np.minimum(rtol * rtol / errors.own, rtol), TIGHTEST)

    def refine_until_two_agree(self, lanes: np.ndarray, rtol: float) -> None:
        """Integrate doubtful lanes, each with its own tolerance, until two integrations agree.

        An integration that fails, by rounding, changes no result.
        """
        used, following = np.full(lanes.size, rtol), self.results.rtol_next[lanes]
        tolerances = np.array(self.results.rtol_next)
        for _ in range(_REPEATED):
            if not lanes.size:
                break
            tolerances[lanes] = following
            before = self.refine(lanes, tolerances)
            after = self.reached(lanes)
            lost, had = (self.signature.has_no_result(each.results.outcome) for each in (after, before))
            lost &= ~had
            errors = self.accuracy.compare(lanes, before, after, following / used)
            self.errors[lanes[~lost]] = errors.greatest[~lost]
            self.put(lanes[lost], jax.tree.map(lambda part, lost=lost: part[lost], before))
            with np.errstate(all="ignore"):
                wanted = np.maximum(following * rtol / errors.own, TIGHTEST)
                wanted = np.where(lost, np.sqrt(used * following), wanted)
            goes_on = lost | (wanted < following / 2)
            used, following, lanes = np.where(lost, used, following)[goes_on], wanted[goes_on], lanes[goes_on]

    @property
    def outputs(self) -> list[np.ndarray]:
        """The arrays in the order of the program's results."""
        return jax.tree.leaves(self.results)

    @property
    def _arrays(self) -> Reached:
        """The arrays of all lanes that stay where an integration after the first is not taken."""
        return Reached(self.results, self.used, self.tapes[-1:])


def integrate(
    signature: Signature,
    parameters: Sequence[PerLane],
    lanes: int,
    order: int,
    directions: tuple[int | PerLane, ...],
    rtol: float,
    *,
    refines: bool = True,
    times: np.ndarray | None = None,
    events: int = 0,
) -> LaneEnd:
    """Integrate lanes to their ends, and lanes of doubtful accuracy again.

    Where small errors of the motion may be large errors of the results, the lane is integrated
    again with a tolerance that is smaller by the same factor, until two integrations agree.

    Args:
        signature: of problem and arguments.
        parameters: each an array (lanes,), or of one lane's shape where all lanes share it.
        lanes: number of lanes.
        order: 0, 1 or 2 derivatives.
        directions: the place of an element, see `Variational`, or one or two arrays of places.
            Arrays of places are numbers, so one program serves all of them.
        rtol: relative tolerance of outputs, end time and derivatives.
        refines: False leaves doubtful lanes as they are.
        times: at which the outputs are wanted as well; rising, shape (n,), or (lanes, n) of each lane's own.
        events: how many events of lanes with resets are wanted as well, in place of `times`.

    Returns:
        The lanes' results, arrays of shape (lanes,).
    """
    records = signature.options.records and order == 0 and times is None and not events and lanes <= _RECORDED
    signature = signature.renewed().wanting(records=records)
    if times is not None:
        times = np.broadcast_to(times, (lanes, times.shape[-1]))
    if order > METHODS[signature.options.method].derivatives:
        return _by_fewer_derivatives(
            signature, parameters, lanes, order, directions, rtol, refines=refines, times=times, events=events
        )
    signature = signature.wanting(saves=times is not None, logs=events > 0)
    fixed = tuple(direction for direction in directions if isinstance(direction, int))
    program, results = integrator_of(signature, order, fixed, 0 if fixed else len(directions))
    places = () if fixed else tuple(np.asarray(direction, float) for direction in directions)
    leaves = [*(np.asarray(number, float) for number in parameters), *places]
    empty = _empty(results, lanes, len(directions))
    tapes: list[np.ndarray] = []
    if signature.options.records:
        leaves, tapes = [*leaves, np.asarray(float(ROWS))], [np.empty((lanes, ROWS * row_width(signature)))]
    tangents = 4 if len(directions) == 2 else order + 1
    if events:
        leaves.append(np.asarray(float(events + 1)))
        numbers = 1 + len(signature.event_names) + 1 + len(empty.outputs.value)
        tapes = [np.full((lanes, events + 1, tangents, numbers), np.nan)]
    if times is not None:
        rising = np.full((lanes, times.shape[1] + 1), np.inf)
        rising[:, :-1] = times
        tapes = [rising, np.full((*times.shape, tangents, len(empty.outputs.value)), np.nan)]
    accuracy = AccuracyCheck(signature, leaves[: len(signature.shapes)], directions)
    batch = _Batch(signature, program, leaves, empty, np.empty(lanes), np.zeros(lanes), accuracy, tapes)
    batch.run(np.arange(lanes), np.asarray(rtol))
    if signature.options.method == "auto":
        _by_other_methods(batch, order, directions, rtol, refines=refines, events=events)
    if refines and (np.asarray(batch.results.rtol_next) != rtol).any():
        batch.check(np.flatnonzero(batch.results.rtol_next > rtol), rtol)
        batch.refine_until_two_agree(np.flatnonzero(batch.results.rtol_next < rtol), rtol)
    if order:
        _with_fewer_derivatives(batch, order, directions, rtol, refines=refines, events=events)
    results = batch.results._replace(rtol_used=batch.used, error=batch.errors)
    if results.recorded is not None:
        return results._replace(recorded=results.recorded._replace(tapes=batch.tapes[0]))
    return results._replace(saved=batch.saved) if times is not None or events else results


def _by_other_methods(
    batch: _Batch, order: int, directions: tuple[int | PerLane, ...], rtol: float, *, refines: bool, events: int
) -> None:
    """Integrate lanes that turned out to be stiff, or took too many steps, by the method for stiff motions.

    Where that has no result either, or cannot be compiled, a stiff lane is integrated as if it were not. A lane that
    ends by neither shows the farther one.
    """
    results, signature = batch.results, batch.signature
    if results.stiff is None:
        return
    given_up = results.stiff > 0
    lanes = np.flatnonzero(given_up | (results.trials > signature.options.max_steps))
    for method in ("rosenbrock", "explicit"):
        if not lanes.size:
            return
        parameters = signature.of_lanes(batch.leaves[: len(signature.shapes)], lanes)
        try:
            found = integrate(
                signature.wanting(method=method, records=False),
                parameters, lanes.size, order, of_lanes(directions, lanes), rtol, refines=refines,
                times=batch.times(lanes), events=events,
            )  # fmt: skip
        except NotForLanesError:
            lanes = lanes[given_up[lanes]]
            continue
        lost = signature.has_no_result(found.outcome)
        reached = results.time.value[lanes]
        farther = (found.time.value > reached) | np.isnan(reached)
        better = ~lost | farther | (given_up[lanes] & (method == "rosenbrock"))
        batch.adopt(found, lanes, better)
        results.rtol_next[lanes[better]], results.stiff[lanes[better]] = rtol, method == "rosenbrock"
        lanes = lanes[lost & given_up[lanes]]


def _with_fewer_derivatives(
    batch: _Batch, order: int, directions: tuple[int | PerLane, ...], rtol: float, *, refines: bool, events: int
) -> None:
    """Integrate lanes that failed with derivatives again with fewer: their outputs may exist although these do not."""
    lost = np.flatnonzero(batch.signature.has_no_result(batch.results.outcome) & batch.is_known)
    if not lost.size:
        return
    parameters, along = (
        batch.signature.of_lanes(batch.leaves[: len(batch.signature.shapes)], lost),
        of_lanes(directions, lost),
    )
    batch.adopt(
        _by_fewer_derivatives(
            batch.signature,
            parameters,
            lost.size,
            order,
            along,
            rtol,
            refines=refines,
            times=batch.times(lost),
            events=events,
        ),
        lost,
    )


def _by_fewer_derivatives(
    signature: Signature,
    parameters: Sequence[PerLane],
    lanes: int,
    order: int,
    directions: tuple[int | PerLane, ...],
    rtol: float,
    *,
    refines: bool,
    times: np.ndarray | None,
    events: int,
) -> LaneEnd:
    """Results of a program with one derivative less; those of the order are NaN. See `integrate`."""
    # Along two directions the first derivatives are two integrations.
    lower = [
        integrate(signature, parameters, lanes, order - 1, each, rtol, refines=refines, times=times, events=events)
        for each in ([(direction,) for direction in directions] if order == 2 else [()])
    ]
    one, other = lower[0], lower[-1]

    def derivatives(of_one: Derivatives, of_other: Derivatives) -> Derivatives:
        none = jax.tree.map(lambda part: np.full_like(part, np.nan), of_one.value)
        if order == 1:
            return Derivatives(of_one.value, none, none, None)
        return Derivatives(of_one.value, of_one.by_first, of_other.by_first, none)

    time, outputs = (derivatives(getattr(one, name), getattr(other, name)) for name in ("time", "outputs"))
    saved = None
    if one.saved is not None:
        # A value and its first derivatives, one or two; the last is of the order.
        parts = [np.asarray(one.saved), *(np.asarray(each.saved)[:, :, 1:] for each in lower[1:])]
        saved = np.concatenate([*parts, np.full_like(parts[0][:, :, :1], np.nan)], axis=2)
    return one._replace(time=time, outputs=outputs, saved=saved)


def _put(arrays: PyTree, found: PyTree, lanes: np.ndarray) -> None:
    """Write what was found into some lanes."""
    for array, part in zip(jax.tree.leaves(arrays), jax.tree.leaves(found), strict=True):
        array[lanes] = part


def integrate_along(
    signature: Signature,
    parameters: Sequence[PerLane],
    lanes: int,
    order: int,
    places: np.ndarray,
    rtol: float,
    *,
    times: np.ndarray | None = None,
    events: int = 0,
) -> LaneEnd:
    """Derivatives along several directions.

    Args:
        signature: as in `integrate`, and so are `parameters`, `lanes` and `rtol`.
        parameters: of the lanes.
        lanes: number of lanes.
        order: 1 or 2 derivatives.
        places: places of elements, see `Variational`; shape (1 or 2, n).
        rtol: relative tolerance.
        times: as in `integrate`.
        events: as in `integrate`.

    Returns:
        Arrays of shape (lanes, n).
    """
    count = places.shape[1]
    repeated = signature.of_lanes(parameters, np.repeat(np.arange(lanes), count))
    directions = tuple(np.tile(row.astype(float), lanes) for row in places)
    if times is not None and times.ndim == 2:
        times = np.repeat(times, count, axis=0)
    results = integrate(signature, repeated, lanes * count, order, directions, rtol, times=times, events=events)
    return jax.tree.map(lambda part: part.reshape(lanes, count, *part.shape[1:]), results)


def in_threads(each: Callable[[np.ndarray, np.ndarray | None], None], lanes: np.ndarray, block: int, few: int) -> None:
    """Do something for blocks of lanes, by several threads where there are more than a few.

    Args:
        each: takes a block of lanes, and where it sees that it is to stop; see `Lanewise.run`.
        lanes: all of them.
        block: lanes of a block at most.
        few: lanes that one thread computes sooner.
    """
    if lanes.size <= few or (count := threads()) == 1:
        for begin in range(0, lanes.size, block):
            each(lanes[begin : begin + block], None)
        return
    blocks = blocks_for_threads(lanes, block, count)
    # Not kept for the next batch: a plug-in's own code may never return a thread.
    stop = np.zeros(1, np.int64)
    with concurrent.futures.ThreadPoolExecutor(count) as pool:
        try:
            list(pool.map(lambda block: each(block, stop), blocks))
        except BaseException:
            # Signals reach the main thread alone. The others would go on, for ever in a loop that never ends.
            stop[0] = 1
            raise


def _empty(results: LaneEnd, lanes: int, directions: int) -> LaneEnd:
    """Arrays to fill, as small as possible: memory that is new to a process is slow to get."""
    leaves, structure = jax.tree.flatten(results)
    empty = jax.tree.unflatten(structure, [np.empty(lanes, leaf.dtype) for leaf in leaves])
    if directions != 1:
        return empty
    # Along one direction both first derivatives are the same, in the same place.
    time, outputs = (part._replace(by_second=part.by_first) for part in (empty.time, empty.outputs))
    return empty._replace(time=time, outputs=outputs)


compiling = threading.RLock()
"""While one thread compiles, others wait: each program is compiled once."""


def integrator_of(
    signature: Signature, order: int, fixed: tuple[int, ...], directions: int
) -> tuple[Lanewise, LaneEnd]:
    """The compiled integrator, and shapes and types of a lane's results."""
    with compiling:
        return _compiled(signature, order, fixed, directions)


def compile_ahead(
    signature: Signature, order: int, directions: int, *, timed: bool = False, logs: bool = False
) -> None:
    """Compile what `integrate` will need; `timed` where states at times are wanted, `logs` where events are.

    Raises:
        NotForLanesError: for a problem that cannot be compiled; a callback would bury it under JAX's own words.
    """
    order = min(order, METHODS[signature.options.method].derivatives)
    records = signature.options.records and not (timed or logs)
    signature = signature.renewed().wanting(saves=timed, logs=logs, records=records)
    integrator_of(signature, order, (), directions)


@functools.lru_cache(maxsize=256)
def _compiled(signature: Signature, order: int, fixed: tuple[int, ...], directions: int) -> tuple[Lanewise, LaneEnd]:
    if order:
        require_derivatives(signature)

    def lane(parameters: list[Number], places: tuple[Direction, ...], rows: list[Scalar], rtol: Scalar) -> LaneEnd:
        return integrate_lane(signature, parameters, fixed or places, rtol, order=order, rows=rows[0] if rows else 0)

    saves, records, logs = signature.options.saves, signature.options.records, signature.options.logs
    arguments = (signature.structs(), (number,) * directions, [number] if records or logs else [], number)
    program = compile_lanes(
        lane,
        arguments,
        tapes=2 if saves else int(records or logs),
        what=signature.name("lane", order, fixed, directions),
    )
    return program, program.results
