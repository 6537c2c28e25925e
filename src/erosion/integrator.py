"""A block of impacts: an error-controlled Runge-Kutta loop whose lanes end exactly at an event.

There is one trace of the Runge-Kutta step in the loop. A lane is advancing, or locating: a step
tried went past an event, so the lane tries again **from the same start** with the length at
which it expects the event. The state at the event thus has the full order of the method, not
an interpolant's.

Arrays run over lanes in their last axis, so that one instruction serves several lanes: a jet
is a tuple of (leaves, lanes) arrays; event functions and their rates are (events, lanes).
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.crossings import Ends, dip_in_step, expected_fall
from erosion.jets import AtEvent, Cut, Derivatives, Direction, Jets, at_event
from erosion.model import CuttingModel, cuts_at_all, event_rates
from erosion.parameters import Parameters
from erosion.plan import Kernel, planned

# Prince and Dormand's 8(7) pair, 13 stages, the last of which is the next step's first.
_TABLEAU = diffrax.Dopri8.tableau
_A = [np.asarray(row) for row in _TABLEAU.a_lower]
_B = np.asarray(_TABLEAU.b_sol)
_B_ERROR = np.asarray(_TABLEAU.b_error)
# A second estimate, of 6th order. All differences of two solutions of 6th order are a plane in
# the space of weights; this one is orthogonal to the pair's own, and as long.
_B_CHECK = np.array([
    -0.06546771316990013, 0, 0, 0, 0, -1.182781246546709, 0.2775527180863478, 1.0732487838069504,
    0.7396385533976804, -1.0064401897180706, 0.32273397601182074, -1.3755777404252905, 1.217092858557171,
    0,
])  # fmt: skip

ADVANCING, LOCATING, ENDED, FAILED, UNFINISHED = range(5)

NO_CUT = -1
"""The event index of a lane in which nothing is cut."""

_SLACK = 2.0  # the embedded estimate is of 7th order, the solution of 8th; docs/performance.md
_TINY = 1e-200  # keeps 0/0 away
_CHECK = 0.1  # of the second estimate, brought to the first one's order; docs/performance.md
_FIRST_STEP = 0.2  # of the model's time scale
_LONGEST_CUT = 1e4  # likewise; later is "unfinished"
_MAX_TRIALS = 20_000
_REJECTED = 64  # trials, and one more for each four accepted: then the error must be rounding
_NEAR = 1e-4  # of the time scale, the cut and a good step: this near the event, Heun and Newton do the rest


class Clock(NamedTuple):
    """Where a lane stands: the rows of one array of floats."""

    mode: Any
    time: Any  # from contact to the start of the step
    trial: Any  # the length to try next
    step: Any  # the length the error control would like
    high: Any  # while locating: a length past the event
    which: Any
    left: Any  # from the last trial's end to the event
    trials: Any
    rejected: Any  # of them, those whose error was too large
    margin: Any  # the least value that an event function dipped to so far
    moved: Any  # whether the lane took the last trial


class Lanes(NamedTuple):
    """What the loop carries: few whole arrays, taken apart only inside kernels."""

    clock: Any  # a `Clock`
    start: Any  # the event functions, then their rates
    jet: tuple[Any, ...]
    rate: tuple[Any, ...]


class Solution(NamedTuple):
    """A block's results, each of shape (lanes,); `which` is the event's index, or `NO_CUT`."""

    mode: Any
    which: Any
    time: Derivatives
    volume: Derivatives
    trials: Any
    margin: Any  # the least value that an event function dipped to before the end; else infinity
    doubt: Any  # see `at_event`


def solve(model: CuttingModel, p: Parameters, order: int, directions: tuple[Direction, ...], rtol: Any) -> Solution:
    """Integrate a block of impacts to their ends.

    Args:
        model: its own leaves are shared by all lanes.
        p: leaves of shape (lanes,).
        order: 0, 1 or 2 derivatives.
        directions: see `Jets`; traced ones have shape (lanes,).
        rtol: of volume, end time and derivatives; a scalar, or for each lane its own.
    """
    block = _Block(model, p, order, directions)
    scale = block.time_scale()
    lanes = lax.while_loop(
        lambda lanes: jnp.any(lanes.clock[0] <= LOCATING),
        lambda lanes: _advance(block, scale, rtol, lanes),
        _begin(block, scale),
    )
    clock = Clock(*lanes.clock)
    # Heun's method over the short time left, then Newton's for what is left of that.
    guess = block.move(clock.left, lanes.jet, lanes.rate)
    jet = block.move(clock.left / 2, block.move(clock.left / 2, lanes.jet, lanes.rate), block.rate(guess))
    rate = block.rate(jet)
    value, slope = jnp.split(block.look(jet, rate), 2)
    cut = (clock.mode == ENDED) & (clock.which != NO_CUT)
    remaining = jnp.where(cut, -_pick(value, clock.which) / _pick(slope, clock.which), 0.0)
    end = clock.time + clock.left + remaining
    time, volume, doubt = block.at_event(block.move(remaining, jet, rate), clock.which, end)
    return _finish(clock, time, volume, doubt)


class _Block:
    """Model, parameters and directions of a block; each method is one or a few kernels."""

    def __init__(self, model: CuttingModel, p: Parameters, order: int, directions: tuple[Direction, ...]) -> None:
        self.model, self.order, self.directions = model, order, directions
        self.named = all(isinstance(d, str) for d in directions)
        self.known = (p, () if self.named else directions)
        one = jax.tree.map(lambda leaf: leaf[0], self.known)
        shapes = jax.eval_shape(lambda model, known: self._jets(model, known).initial(), model, one)
        self.structure = jax.tree.structure(shapes[0])
        rows = [self.structure.num_leaves] * len(shapes)
        # Made once, so that JAX traces each of them once for the dozen places it is called at.
        self._rate = self._planned(self._rate_of, rows)
        self._look = self._planned(self._look_at, rows[:1] * 2)
        self._end = self._planned(self._end_at, [None, None, *rows])
        self._move = Kernel(lambda length, u, k: u + length * k)

    def time_scale(self) -> Any:
        return self._planned(lambda model, known: ([model.scales(known[0]).time],), [])()[0][0]

    def begins(self) -> Any:
        return self._planned(lambda model, known: ([cuts_at_all(model, known[0]).astype(float)],), [])()[0][0] > 0

    def initial(self) -> tuple[Any, ...]:
        return self._planned(lambda model, known: self._rows(self._jets(model, known).initial()), [])()

    def rate(self, jet: Sequence[Any]) -> tuple[Any, ...]:
        """The jet's time derivative."""
        return self._rate(*jet)

    def move(self, length: Any, jet: Sequence[Any], rate: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(self._move(length, u, k) for u, k in zip(jet, rate, strict=True))

    def look(self, jet: Sequence[Any], rate: Sequence[Any]) -> Any:
        """The event functions, then their rates."""
        return self._look(jet[0], rate[0])[0]

    def at_event(self, jet: Sequence[Any], which: Any, time: Any) -> AtEvent:
        doubt, *found = self._end(which, time, *jet)[0]
        parts = (1, 3, 4)[self.order]
        absent = [None] * (4 - parts)
        return AtEvent(Derivatives(*found[:parts], *absent), Derivatives(*found[parts:], *absent), doubt)

    def _rate_of(self, model: CuttingModel, known: Any, *rows: Any) -> tuple[list[Any], ...]:
        return self._rows(self._jets(model, known).rate(self._cuts(rows)))

    def _look_at(self, model: CuttingModel, known: Any, row: Any, rate: Any) -> tuple[list[Any]]:
        cut, flow = self._cuts([row, rate])
        values, rates = event_rates(model, cut.state, flow.state, known[0])
        return ([*values.values(), *(rates[name] for name in values)],)

    def _end_at(self, model: CuttingModel, known: Any, which: Any, time: Any, *rows: Any) -> tuple[list[Any]]:
        jets = self._jets(model, known)
        end = at_event(jets, self._cuts(rows), which, time)
        return ([end.doubt, *jax.tree.leaves((jets.per_unit(end.time), jets.per_unit(end.volume)))],)

    def _planned(self, lane: Callable[..., Any], rows: Sequence[int | None]) -> Callable[..., Any]:
        return planned(lane, self.model, self.known, rows)

    def _jets(self, model: CuttingModel, known: Any) -> Jets:
        p, directions = known
        return Jets(model, p, self.order, self.directions if self.named else directions)

    def _rows(self, jet: Sequence[Cut]) -> tuple[list[Any], ...]:
        return tuple(jax.tree.leaves(member) for member in jet)

    def _cuts(self, rows: Sequence[Any]) -> tuple[Cut, ...]:
        return tuple(jax.tree.unflatten(self.structure, row) for row in rows)


def _begin(block: _Block, scale: Any) -> Lanes:
    jet = block.initial()
    rate = block.rate(jet)
    start = block.look(jet, rate)
    finite = jnp.isfinite(scale) & (scale > 0)
    for member in (*jet, *rate, start):
        finite = finite & jnp.all(jnp.isfinite(member), axis=0)
    begins = block.begins()
    zero = jnp.zeros_like(scale)
    first = _FIRST_STEP * scale
    clock = Clock(
        mode=jnp.where(finite, jnp.where(begins, float(ADVANCING), ENDED), FAILED),
        time=zero,
        trial=first,
        step=first,
        high=zero,
        which=jnp.where(begins, 0.0, NO_CUT),
        left=zero,
        trials=zero,
        rejected=zero,
        margin=jnp.full_like(scale, jnp.inf),
        moved=zero,
    )
    half = start.shape[0] // 2
    # Where an event function is zero at contact it rises, or nothing is cut.
    start = start.at[:half].set(jnp.maximum(start[:half], 0.0))
    return Lanes(jnp.stack(clock), start, jet, rate)


def _advance(block: _Block, scale: Any, rtol: Any, lanes: Lanes) -> Lanes:
    """Try one step in every lane, and act on what it was."""
    jet, rate, error = _step(block, lanes.jet, lanes.rate, lanes.clock)
    ends = block.look(jet, rate)
    # Events that are not numbers, of a motion that is, are an error too: 0·NaN is NaN.
    error = Kernel(
        lambda error, ends, rtol: functools.reduce(lambda e, end: e + 0 * end, ends, error / (_SLACK * rtol))
    )(error, ends, rtol)

    def dips(clock: Any, start: Any, ends: Any) -> Any:
        found = zip(*(dip_in_step(*event, Clock(*clock).trial) for event in _events(start, ends)), strict=True)
        return jnp.stack([functools.reduce(jnp.minimum, each) for each in found])

    def fences(clock: Any, start: Any, ends: Any, error: Any) -> Any:
        past = functools.reduce(jnp.logical_or, [after.value <= 0 for _, after in _events(start, ends)])
        return jnp.stack(_fences(Clock(*clock), error, past))

    def expected(clock: Any, start: Any, ends: Any, fences: Any, i: int) -> Any:
        before, after = _events(start, ends)[i]
        root = expected_fall(before, after, Clock(*clock).trial, fences[0], fences[1])
        # Past the trial's end all may still fall; before it, those that have fallen at it.
        return jnp.where((after.value <= 0) | (fences[2] == 0), root, jnp.inf)

    def decide(clock: Any, error: Any, scale: Any, dip: Any, fences: Any, roots: Any) -> Any:
        return jnp.stack(_decide(Clock(*clock), error, scale, dip, fences, roots))

    dip = Kernel(dips)(lanes.clock, lanes.start, ends)
    fence = Kernel(fences)(lanes.clock, lanes.start, ends, error)
    roots = [
        Kernel(functools.partial(expected, i=i))(lanes.clock, lanes.start, ends, fence)
        for i in range(ends.shape[0] // 2)
    ]
    clock = Kernel(decide)(lanes.clock, error, scale, dip, fence, roots)
    choose = Kernel(lambda clock, new, old: jnp.where(Clock(*clock).moved > 0, new, old))
    chosen = jax.tree.map(lambda new, old: choose(clock, new, old), (ends, jet, rate), tuple(lanes[1:]))
    return Lanes(clock, *chosen)


def _events(start: Any, ends: Any) -> list[tuple[Ends, Ends]]:
    # One by one: a reduction over an axis would not be one loop over the lanes.
    half = start.shape[0] // 2
    return [(Ends(start[i], start[half + i]), Ends(ends[i], ends[half + i])) for i in range(half)]


def _fences(clock: Clock, error: Any, past: Any) -> list[Any]:
    """Lengths known to be before and past the event, and whether the trial's end is past it."""
    high = jnp.where(_good(clock, error) & past, clock.trial, clock.high)
    return [jnp.where(past, 0.0, clock.trial), high, past.astype(float)]


def _good(clock: Clock, error: Any) -> Any:
    """Whether a trial counts: while locating, any that is shorter than the one that did, if it is finite."""
    return jnp.where(clock.mode == LOCATING, jnp.isfinite(error), error <= 1)


def _decide(clock: Clock, error: Any, scale: Any, dips: Any, fences: Any, roots: list[Any]) -> list[Any]:
    """The clock after a trial, and whether the lane moves to the trial's end.

    Args:
        clock: before the trial.
        error: over the tolerance; NaN is an error.
        scale: the model's time scale.
        dips: see `dip_in_step`; the least of all events. A dip that may reach below zero is
            landed on before anything is decided.
        fences: see `_fences`.
        roots: when each event is expected to fall through zero.
    """
    dip, high, past = dips[0], fences[1], fences[2] > 0
    going, locating = clock.mode <= LOCATING, clock.mode == LOCATING
    good = _good(clock, error)
    landing, fits = good & (dip < 1), good & (dip >= 1)
    bracketed = good & (past | locating)
    expected = functools.reduce(jnp.minimum, roots)
    which = jnp.zeros_like(expected)
    for i, root in enumerate(roots):
        which = jnp.where(root == expected, float(i), which)
    left = expected - clock.trial
    near = _NEAR * jnp.minimum(jnp.minimum(scale, clock.step), clock.time + clock.trial)
    ended = going & fits & bracketed & (jnp.abs(left) <= near)
    # A locating lane moves on as well, or it would look for ever at both sides of a dip.
    accepted = going & fits & ~past & ~ended

    factor = 0.9 / _eighth_root(error + 1e-30)
    factor = jnp.where(jnp.isfinite(error), jnp.clip(factor, 0.2, 5.0), 0.2)
    # Steps cut short to land on a dip say little about the step to take next.
    step = jnp.where(
        good & (clock.trial < clock.step), jnp.maximum(factor * clock.trial, clock.step), factor * clock.trial
    )
    step = jnp.where(locating, clock.step, step)
    trial = jnp.where(landing, dip * clock.trial, jnp.where(bracketed, jnp.where(past, expected, left), step))
    time = clock.time + jnp.where(accepted | ended, clock.trial, 0.0)

    mode = jnp.where(bracketed & ~landing, float(LOCATING), clock.mode)
    mode = jnp.where((time > _LONGEST_CUT * scale) | (clock.trials >= _MAX_TRIALS), UNFINISHED, mode)
    rejected = clock.rejected + (going & ~good)
    hopeless = rejected > _REJECTED + (clock.trials - clock.rejected) / 4
    mode = jnp.where(~(trial > 1e-14 * scale) | (locating & ~good) | hopeless, FAILED, mode)
    mode = jnp.where(ended, ENDED, mode)
    return [
        jnp.where(going, mode, clock.mode),
        jnp.where(going, time, clock.time),
        jnp.where(going, trial, clock.trial),
        step,
        jnp.where(accepted, high - clock.trial, high),
        jnp.where(ended, which, clock.which),
        jnp.where(ended, left, clock.left),
        clock.trials + going,
        rejected,
        jnp.where(accepted | ended, jnp.minimum(clock.margin, dips[1]), clock.margin),
        (accepted | ended).astype(float),
    ]


def _step(block: _Block, jet: Any, rate: Any, clock: Any) -> tuple[Any, Any, Any]:
    """One Runge-Kutta step of the length to try: jet and rate at its end, and its relative error."""
    stages = [[k] for k in rate]
    at = jet
    for row in (*_A[:-1], _B):
        combine = Kernel(lambda u, ks, clock, row=row: u + Clock(*clock).trial * _combine(row, ks))
        at = tuple(combine(u, _used(row, ks), clock) for u, ks in zip(jet, stages, strict=True))
        for ks, k in zip(stages, block.rate(at), strict=True):
            ks.append(k)

    def worst(before: Any, after: Any, slopes: Any, stages: Any, clock: Any) -> Any:
        length = Clock(*clock).trial
        # Errors count relative to each quantity's size in this step; a derivative's also
        # relative to the size of what it is the derivative of.
        sizes, errors = jnp.full_like(before[0], _TINY), jnp.zeros_like(length)
        for u, v, slope, ks in zip(before, after, slopes, stages, strict=True):
            sizes = jnp.maximum(jnp.maximum(jnp.abs(u), jnp.abs(v)), jnp.maximum(jnp.abs(length * slope), sizes))
            errors = functools.reduce(jnp.maximum, list(jnp.abs(length * _combine(_B_ERROR, ks)) / sizes), errors)
            # The volume's estimate is mostly the largest by far, so where it passes through zero by
            # chance an error would go unseen. It does not do so together with a second one.
            check = jnp.abs(length * _combine(_B_CHECK, [k[-1] for k in ks])) / sizes[-1]
            errors = jnp.maximum(errors, _CHECK * check * _eighth_root(check))
        return errors

    error = Kernel(worst)(jet, at, rate, [_used(_B_ERROR, ks) for ks in stages], clock)
    return at, tuple(ks[-1] for ks in stages), error


def _eighth_root(value: Any) -> Any:
    # XLA's `pow` on a CPU is one library call a number.
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(value)))


def _used(weights: np.ndarray, stages: Sequence[Any]) -> list[Any]:
    return [stage for weight, stage in zip(weights, stages, strict=False) if weight != 0]


def _combine(weights: np.ndarray, stages: Sequence[Any]) -> Any:
    terms = [float(weight) * stage for weight, stage in zip(weights[weights != 0], stages, strict=True)]
    return sum(terms[1:], terms[0])


def _finish(clock: Clock, time: Derivatives, volume: Derivatives, doubt: Any) -> Solution:
    """Zeros where nothing is cut; NaN, said to be failed, where a number is not finite."""
    numbers = jax.tree.map(lambda value: jnp.where(clock.which == NO_CUT, 0.0, value), (time, volume))
    whole = functools.reduce(jnp.logical_and, map(jnp.isfinite, jax.tree.leaves(numbers)), clock.mode == ENDED)
    mode = jnp.where((clock.mode == ENDED) & ~whole, FAILED, clock.mode)
    numbers = jax.tree.map(lambda value: jnp.where(whole, value, jnp.nan), numbers)
    time, volume = numbers
    return Solution(mode, clock.which, time, volume, clock.trials, clock.margin, doubt)


def _pick(values: Any, index: Any) -> Any:
    return jnp.sum(jnp.where(jnp.arange(values.shape[0])[:, None] == index, values, 0.0), axis=0)
