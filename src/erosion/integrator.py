"""A block of impacts: an error-controlled Runge-Kutta loop whose lanes end exactly at an event.

There is one trace of the Runge-Kutta step in the loop. A lane is advancing, or locating. A step
is cut short to end at an event that is foreseen. A lane whose step went past one is locating: it
tries again **from the same start** with the length at which it expects the event. The state at
the event thus has the full order of the method, not an interpolant's.

Arrays run over lanes in their last axis, so that one instruction serves several lanes: a jet
is a tuple of (rows, lanes) arrays; event functions and their rates are (events, lanes).
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.clock import (
    ADVANCING,
    ENDED,
    FAILED,
    LOCATING,
    NO_CUT,
    Clock,
    Record,
    bracket,
    decide,
    eighth_root,
    first_fall,
    go_on,
)
from erosion.crossings import Ends, dip_in_step, expected_fall
from erosion.jets import Derivatives, Direction
from erosion.kernels import Kernel, one_function
from erosion.model import CuttingModel
from erosion.motion import Motion
from erosion.parameters import Parameters
from erosion.plan import planned
from erosion.tableau import B_CHECK, B_ERROR, A, B

_SLACK = 4.0  # the embedded estimate is of 7th order, the solution of 8th; docs/performance.md
_TINY = 1e-200  # keeps 0/0 away
_CHECK = 0.1  # of the second estimate, brought to the first one's order; docs/performance.md
_SOON = 2.0  # trials, at the rate of now: an event that near is worth to be looked for
_EARLY = 9  # stages of a trial's first part: then both take as long to compile
_FIRST_STEP = 0.17  # of the model's time scale


class Lanes(NamedTuple):
    """What the loop carries: few whole arrays, taken apart only inside kernels."""

    clock: Any  # a `Clock`
    record: Any  # a `Record`
    start: Any  # the event functions, then their rates
    jet: tuple[Any, ...]
    rate: tuple[Any, ...]


class Solution(NamedTuple):
    """Lanes' results, each of shape (lanes,); `which` is the event's index, or `NO_CUT`."""

    mode: Any
    which: Any
    trials: Any
    margin: Any  # the least value that an event function dipped to before the end; else infinity
    doubt: Any  # see `at_event`
    time: Derivatives
    volume: Derivatives

    @classmethod
    def of(cls, outcome: Any, numbers: Any) -> "Solution":
        """From what `solve` gives."""
        mode, which, trials, margin, doubt = outcome
        half = len(numbers) // 2
        absent = [None] * (len(Derivatives._fields) - half)
        time, volume = (Derivatives(*part, *absent) for part in (numbers[:half], numbers[half:]))
        return cls(mode, which, trials, margin, doubt, time, volume)


def solve(
    model: CuttingModel,
    p: Parameters,
    order: int,
    directions: tuple[Direction, ...],
    rtol: Any,
    *,
    few_functions: bool = False,
) -> tuple[Any, Any]:
    """Integrate a block of impacts to their ends.

    Args:
        model: its own leaves are shared by all lanes.
        p: leaves of shape (lanes,).
        order: 0, 1 or 2 derivatives.
        directions: see `Jets`; traced ones have shape (lanes,).
        rtol: of volume, end time and derivatives; a scalar, or for each lane its own.
        few_functions: see `one_function`; where the model's arithmetic allows it.

    Returns:
        The rows of a `Solution` in two arrays (rows, lanes): each array costs the compiler dear.
    """
    motion = Motion(model, p, order, directions)
    one = one_function if few_functions and motion.is_arithmetic else _as_it_is
    # One of the whole loop would with derivatives compile 1.4 s longer: then two of each trial.
    of_all, of_parts = (_as_it_is, one) if order else (one, _as_it_is)

    def begin() -> tuple[Any, Lanes]:
        contact, jet = motion.at_contact()
        return contact[0], _begin(motion, contact, jet)

    def integrate(scale: Any, rtol: Any, lanes: Lanes) -> Lanes:
        return lax.while_loop(
            lambda lanes: jnp.any(lanes.clock[0] <= LOCATING),
            lambda lanes: _advance(motion, scale, rtol, lanes, of_parts),
            lanes,
        )

    scale, lanes = one(begin)()
    return _finish(motion, of_all(integrate)(scale, rtol, lanes))


def _as_it_is(function: Callable[..., Any]) -> Callable[..., Any]:
    return function


def _begin(motion: Motion, contact: Any, jet: tuple[Any, ...]) -> Lanes:
    rate, start = motion.rate_and_events(jet)

    def clock(contact: Any, *arrays: Any) -> Any:
        scale, begins = contact
        # 0·NaN and 0·∞ are NaN.
        finite = jnp.isfinite(sum(0.0 * row for array in arrays for row in array) + scale) & (scale > 0)
        mode = jnp.where(finite, jnp.where(begins > 0, float(ADVANCING), ENDED), FAILED)
        zero, first = jnp.zeros_like(scale), _FIRST_STEP * scale
        which = jnp.where(begins > 0, 0.0, NO_CUT)
        return jnp.stack(Clock(mode, zero, first, first, high=zero, which=which, left=zero, moved=zero))

    def rising(start: Any) -> Any:
        half = start.shape[0] // 2
        return jnp.stack([*(jnp.maximum(value, 0.0) for value in start[:half]), *start[half:]])

    # Where an event function is zero at contact it rises, or nothing is cut.
    nothing = jnp.zeros_like(contact[0])
    record = jnp.stack(Record(trials=nothing, rejected=nothing, margin=nothing + jnp.inf))
    return Lanes(Kernel(clock)(contact, start, *jet, *rate), record, Kernel(rising)(start), jet, rate)


def _move_on(motion: Motion, lanes: Lanes) -> tuple[Any, ...]:
    """The jet a short time after the last trial: the classical method of fourth order."""
    jet, rate = lanes.jet, lanes.rate

    def after(*weights: float) -> Callable[..., tuple[Any, ...]]:
        combine = Kernel(lambda clock, u, *ks: u + Clock(*clock).left * _combine(np.array(weights), ks))
        return lambda *rates: tuple(combine(lanes.clock, *each) for each in zip(jet, *rates, strict=True))

    second = motion.rate(after(1 / 2)(rate))
    third = motion.rate(after(1 / 2)(second))
    fourth = motion.rate(after(1.0)(third))
    return after(1 / 6, 1 / 3, 1 / 3, 1 / 6)(rate, second, third, fourth)


def _finish(motion: Motion, lanes: Lanes) -> tuple[Any, Any]:
    """The rows of a `Solution`: zeros where nothing is cut; NaN, said to be failed, where a number is not finite."""
    jet = _move_on(motion, lanes)
    rate, events = motion.rate_and_events(jet)
    half = events.shape[0] // 2

    def lane(
        model: CuttingModel, known: Any, clock: Any, record: Any, events: Any, *rows: Any
    ) -> tuple[list[Any], list[Any]]:
        clock, record = Clock(*clock), Record(*record)
        cut = (clock.mode == ENDED) & (clock.which != NO_CUT)
        which, remaining = first_fall(clock, [Ends(events[i], events[half + i]) for i in range(half)])
        remaining = jnp.where(cut, remaining, 0.0)
        moved = [
            [u + remaining * k for u, k in zip(member, its_rate, strict=True)]
            for member, its_rate in zip(rows[: len(jet)], rows[len(jet) :], strict=True)
        ]
        end = motion.at_event(model, known, moved, which, clock.time + clock.left + remaining)
        numbers = [jnp.where(which == NO_CUT, 0.0, number) for number in jax.tree.leaves((end.time, end.volume))]
        whole = functools.reduce(jnp.logical_and, map(jnp.isfinite, numbers), clock.mode == ENDED)
        mode = jnp.where((clock.mode == ENDED) & ~whole, FAILED, clock.mode)
        numbers = [jnp.where(whole, number, jnp.nan) for number in numbers]
        return [mode, which, record.trials, record.margin, end.doubt], numbers

    arrays = (lanes.clock, lanes.record, events, *jet, *rate)
    return motion.planned(lane, [array.shape[0] for array in arrays])(*arrays)


def _advance(
    motion: Motion, scale: Any, rtol: Any, lanes: Lanes, compiled: Callable[[Callable[..., Any]], Callable[..., Any]]
) -> Lanes:
    """Try one step in every lane, and act on what it was: in two parts, each of which is `compiled`."""

    def early(jet: Any, rate: Any, clock: Any) -> list[list[Any]]:
        stages = _stages(motion, jet, [[k] for k in rate], clock, A[:_EARLY])
        return [ks[1:] for ks in stages]

    def late(scale: Any, rtol: Any, lanes: Lanes, stages: list[list[Any]]) -> Lanes:
        stages = [[k, *ks] for k, ks in zip(lanes.rate, stages, strict=True)]
        stages = _stages(motion, lanes.jet, stages, lanes.clock, A[_EARLY:-1])
        return _act(scale, rtol, lanes, *_step(motion, lanes.jet, lanes.rate, lanes.clock, stages))

    return compiled(late)(scale, rtol, lanes, compiled(early)(lanes.jet, lanes.rate, lanes.clock))


def _act(scale: Any, rtol: Any, lanes: Lanes, jet: Any, rate: Any, ends: Any, error: Any) -> Lanes:
    """What becomes of the lanes, given jet, rate and events at a trial's end, and its error."""
    # Events that are not numbers, of a motion that is, are an error too: 0·NaN is NaN.
    error = Kernel(
        lambda error, ends, rtol: functools.reduce(lambda e, end: e + 0 * end, ends, error / (_SLACK * rtol))
    )(error, ends, rtol)

    def dips(clock: Any, start: Any, ends: Any) -> tuple[list[Any]]:
        found = zip(*(dip_in_step(*event, Clock(*clock).trial) for event in _events(start, ends)), strict=True)
        return ([functools.reduce(jnp.minimum, each) for each in found],)

    def fences(clock: Any, start: Any, ends: Any, error: Any) -> tuple[list[Any]]:
        clock, after = Clock(*clock), [after for _, after in _events(start, ends)]
        past = functools.reduce(jnp.logical_or, [end.value <= 0 for end in after])
        soon = functools.reduce(jnp.logical_or, [end.value < -_SOON * clock.trial * end.rate for end in after])
        return (bracket(clock, error, past, soon),)

    def close(clock: Any, dips: Any, fences: Any) -> Any:
        mode = Clock(*clock).mode
        return (mode == LOCATING) | ((mode == ADVANCING) & ((fences[2] > 0) | (fences[3] > 0) | (dips[0] < 1)))

    def expected(clock: Any, start: Any, ends: Any, fences: Any) -> tuple[list[Any]]:
        low, high, past, soon = fences
        clock = Clock(*clock)
        found = []
        for before, after in _events(start, ends):
            root, steep, off = expected_fall(before, after, clock.trial, low, high)
            # Past the trial's end all may still fall; before it, those that have fallen at it.
            known = (after.value <= 0) | ((past == 0) & (clock.mode == LOCATING))
            foreseen = (clock.mode == ADVANCING) & (past == 0) & (soon > 0) & (after.rate < 0)
            found.append((jnp.where(known | foreseen, root, jnp.inf), known | steep, steep, off))
        first = functools.reduce(jnp.minimum, [root for root, *_ in found])
        sure, steep, off = jnp.array(True), jnp.array(False), jnp.zeros_like(first)
        for root, trusted, its_steep, its_off in found:
            # What is not sure to fall, but would first, may fall after the others.
            sure &= (root > first) | trusted
            steep, off = jnp.where(root == first, its_steep, steep), jnp.where(root == first, its_off, off)
        return ([*(jnp.where(sure, root, jnp.inf) for root, *_ in found), steep.astype(float), off],)

    def near_an_end(dip: Any, fence: Any) -> Any:
        (falls,) = _by_lane(expected, lanes.clock, lanes.start, ends, fence)
        return _by_lane(decide, lanes.clock, lanes.record, error, scale, dip, fence, falls)

    def elsewhere(dip: Any, fence: Any) -> Any:
        return _by_lane(go_on, lanes.clock, lanes.record, error, scale, dip)

    (dip,) = _by_lane(dips, lanes.clock, lanes.start, ends)
    (fence,) = _by_lane(fences, lanes.clock, lanes.start, ends, error)
    # In most trials no lane of the block is close to its end: lanes that are alike end alike.
    clock, record = lax.cond(jnp.any(Kernel(close)(lanes.clock, dip, fence)), near_an_end, elsewhere, dip, fence)
    choose = Kernel(lambda clock, new, old: jnp.where(Clock(*clock).moved > 0, new, old))
    chosen = jax.tree.map(lambda new, old: choose(clock, new, old), (ends, jet, rate), tuple(lanes[2:]))
    return Lanes(clock, record, *chosen)


def _by_lane(function: Callable[..., tuple[Sequence[Any], ...]], *arrays: Any) -> tuple[Any, ...]:
    """A function of one lane's scalars, or lists of them, of all lanes; for each list an array (rows, lanes)."""
    rows = [None if array.ndim == 1 else array.shape[0] for array in arrays]
    return planned(lambda _, __, *lane: tuple(map(list, function(*lane))), (), (), rows)(*arrays)


def _events(start: Any, ends: Any) -> list[tuple[Ends, Ends]]:
    # One by one: a reduction over an axis would not be one loop over the lanes.
    half = len(start) // 2
    return [(Ends(start[i], start[half + i]), Ends(ends[i], ends[half + i])) for i in range(half)]


def _stages(motion: Motion, jet: Any, stages: list[list[Any]], clock: Any, rows: Sequence[np.ndarray]) -> Any:
    """The slopes so far of each array of the jet, and those of some stages more."""
    stages = [list(ks) for ks in stages]
    for row in rows:
        for ks, k in zip(stages, motion.rate(_weighted(jet, stages, clock, row)), strict=True):
            ks.append(k)
    return stages


def _weighted(jet: Any, stages: list[list[Any]], clock: Any, weights: np.ndarray) -> tuple[Any, ...]:
    """The jet moved along a weighted sum of slopes."""
    combine = Kernel(lambda u, ks, clock: u + Clock(*clock).trial * _combine(weights, ks))
    return tuple(combine(u, _used(weights, ks), clock) for u, ks in zip(jet, stages, strict=True))


def _step(motion: Motion, jet: Any, rate: Any, clock: Any, stages: list[list[Any]]) -> tuple[Any, Any, Any, Any]:
    """A step of the length to try, given the slopes of its stages: jet, rate and events at its end, and its error."""
    at = _weighted(jet, stages, clock, B)
    last, events = motion.rate_and_events(at)
    stages = [[*ks, k] for ks, k in zip(stages, last, strict=True)]

    def worst(before: Any, after: Any, slopes: Any, stages: Any, clock: Any) -> Any:
        length = Clock(*clock).trial
        # Errors count relative to each quantity's size in this step; a derivative's also
        # relative to the size of what it is the derivative of. Row by row, that is one loop.
        split = motion.by_member
        members = zip(split(before), split(after), split(slopes), zip(*map(split, stages), strict=True), strict=True)
        sizes, error = [jnp.full_like(length, _TINY)] * motion.structure.num_leaves, jnp.zeros_like(length)
        for u, v, slope, ks in members:
            for i, size in enumerate(sizes):
                moved = jnp.maximum(jnp.abs(length * slope[i]), size)
                sizes[i] = jnp.maximum(jnp.maximum(jnp.abs(u[i]), jnp.abs(v[i])), moved)
            # Of the volume, what it would gain in as long a time again counts as well: most cuts go on.
            # (The last stage is the rate at the step's end, nearly.)
            sizes[-1] += jnp.abs(length * ks[-1][-1])
            for i, size in enumerate(sizes):
                error = jnp.maximum(error, jnp.abs(length * _combine(B_ERROR, [k[i] for k in ks])) / size)
            # The volume's estimate is mostly the largest by far, so where it passes through zero by
            # chance an error would go unseen. It does not do so together with a second one.
            check = jnp.abs(length * _combine(B_CHECK, [k[-1] for k in ks])) / sizes[-1]
            error = jnp.maximum(error, _CHECK * check * eighth_root(check))
        return error

    error = Kernel(worst)(jet, at, rate, _used(B_ERROR, list(zip(*stages, strict=True))), clock)
    return at, last, events, error


def _used(weights: np.ndarray, stages: Sequence[Any]) -> list[Any]:
    return [stage for weight, stage in zip(weights, stages, strict=False) if weight != 0]


def _combine(weights: np.ndarray, stages: Sequence[Any]) -> Any:
    terms = [float(weight) * stage for weight, stage in zip(weights[weights != 0], stages, strict=True)]
    return sum(terms[1:], terms[0])
