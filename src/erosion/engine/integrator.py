"""One impact from contact to its end: an error-controlled Runge-Kutta method that ends exactly at an event.

Plain JAX for one impact's numbers. `erosion.lanes` compiles it for many at a time, `jax.vmap` for a GPU.
"""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.array_types import Flag, ModelState, Number, Scalar
from erosion.engine import cut_end, step_control
from erosion.engine.crossings import Ends
from erosion.engine.kinks import Rows, corrected, is_broken
from erosion.engine.leaves import Layout
from erosion.engine.outcomes import AFTER_ARRIVED, AFTER_FAILED, AFTER_NO_CUT, AFTER_UNFINISHED
from erosion.engine.reduction import WholeMotion, reduced
from erosion.engine.smoothness import may_have_kinks
from erosion.engine.step_control import ARRIVED, ENDED, NOT_BEGUN, UNFINISHED, Control, eighth_root
from erosion.engine.tableau import B_CHECK, B_ERROR, A, B
from erosion.engine.variational import Cut, Derivatives, Direction, Variational, at_event
from erosion.models.base import ZERO

_SLACK = 4.0  # the embedded estimate is of 7th order, the solution of 8th; docs/performance.md
_TINY = 1e-200  # keeps 0/0 away
_CHECK = 0.1  # of the second estimate, brought to the first one's order; docs/performance.md
_FIRST_STEP = 0.17  # of the model's time scale
_LOOKS = (5, 9)  # stages at 0.15 and 0.92 of a step: a cubic that errs between them errs at one of them
_DOUBT = 100.0  # errors are mostly smaller than the tolerance by this factor
_GRAZE = 1e4  # tolerances: a dip this close to zero may be a fall, after many turns of a fast spin
TIGHTEST = 1e-13  # tolerance of a second integration: rounding is near
_MANY_STEPS, _MANY_FACTOR = 64, 1e-2  # the errors of this many steps add up, and may grow from step to step
_ROUGH_FACTOR = 1e-3  # across a kink an estimate says little, and a step may pass over a short visit behind one
_SOON = 1e-3  # of the time scale: what a row changes within it counts as its size
_MOMENT = 1e-12  # of the time scale: a rate that is 0·∞ at contact is taken this much later
_INSIDE = 1e-10  # of the time scale: as near to an end beyond which the motion is not defined
_SHARE = 0.98  # of the way to it is a step, by Newton's method


class Lane(NamedTuple):
    """An impact under way: its control, and the events, state and slopes at the start of its next step."""

    control: Control
    events: list[Ends]
    state: Rows
    slope: Rows


class Solution(NamedTuple):
    """The results of an impact.

    Args:
        outcome: a code; see `erosion.engine.outcomes`.
        tolerance: the tolerance that the impact needs for results as exact as asked for.
        time, volume: the end of the cut and the volume removed, with derivatives.
        state: the model's own state at the end, where asked for.
        trials: number of steps tried.
    """

    outcome: Scalar
    tolerance: Scalar
    time: Derivatives
    volume: Derivatives
    state: ModelState
    trials: Scalar


class Problem:
    """An impact's equations, as functions of plain numbers.

    Args:
        layout, numbers: of model and case.
        order, directions: see `Variational`.
        whole: keep the model's own state; otherwise as few unknowns as its arithmetic shows.
    """

    def __init__(
        self, layout: Layout, numbers: Sequence[Number], order: int, directions: tuple[Direction, ...], *, whole: bool
    ) -> None:
        self.layout, self.numbers = layout, list(numbers)
        motion = WholeMotion if whole else reduced(layout)
        self.order, self.rough = order, may_have_kinks(layout)
        named = all(isinstance(direction, str) for direction in directions)
        places = () if named else directions

        def equations(numbers: Sequence[Number], places: tuple[Direction, ...]) -> Variational:
            return Variational(layout, numbers, order, directions if named else places, motion)

        self.equations = equations(self.numbers, places)
        members, self._structure = jax.tree.flatten(self.equations.initial())
        self.initial: Rows = members
        self._member = jax.tree.structure(Cut(motion(*layout.joined(numbers)).initial_state(), 0.0))
        self.width = self._member.num_leaves

        # Each is traced once for all the places where it is called.
        @jax.jit
        def rate(numbers: Sequence[Number], places: tuple[Direction, ...], rows: Rows) -> Rows:
            return jax.tree.leaves(equations(numbers, places).rate(self.members(rows)))

        @jax.jit
        def rate_and_events(
            numbers: Sequence[Number], places: tuple[Direction, ...], rows: Rows
        ) -> tuple[Rows, list[Ends]]:
            extended, state = equations(numbers, places), self.members(rows)
            flow = extended.rate(state)
            motion_here = extended.at(numbers)
            values, rates = jax.jvp(motion_here.events, (state[0],), (flow[0],))
            return jax.tree.leaves(flow), [Ends(*pair) for pair in zip(values, rates, strict=True)]

        @jax.jit
        def events(numbers: Sequence[Number], rows: Rows) -> list[Scalar]:
            return motion(*layout.joined(numbers)).events(self.members(rows)[0])

        @jax.jit
        def motion_rate(numbers: Sequence[Number], rows: Rows) -> Rows:
            return jax.tree.leaves(motion(*layout.joined(numbers)).rate(self.members(rows)[0]))

        self.motion_rate = functools.partial(motion_rate, self.numbers)
        self.events = functools.partial(events, self.numbers)
        self.rate = functools.partial(rate, self.numbers, places)
        self.rate_and_events = functools.partial(rate_and_events, self.numbers, places)

    def members(self, rows: Rows) -> tuple[Cut, ...]:
        """Value and derivatives of a state."""
        parts = [rows[i : i + self.width] for i in range(0, len(rows), self.width)]
        return tuple(jax.tree.unflatten(self._member, part) for part in parts)


def solve(
    layout: Layout,
    numbers: Sequence[Number],
    directions: tuple[Direction, ...],
    rtol: Scalar,
    until: Scalar | None = None,
    *,
    order: int = 0,
    whole: bool = False,
) -> Solution:
    """Integrate one impact to the end of its cut.

    Args:
        layout: of model and case.
        numbers: of this impact.
        directions: of the derivatives; see `Variational`.
        rtol: of volume, end time and derivatives.
        until: stop at this time since contact.
        order: 0, 1 or 2 derivatives.
        whole: give the model's own state at the end as well.
    """
    problem = Problem(layout, numbers, order, directions, whole=whole)
    model, p = layout.joined(numbers)
    scale = model.scales(p).time
    slope, events = _at_contact(problem, scale)
    # 0·NaN and 0·∞ are NaN: this finds them also in parameters that the motion does not depend on.
    zero = sum(jnp.sum(0.0 * number) for number in numbers)
    zero = zero + sum(0.0 * row for row in (*problem.initial, *slope)) + 0.0 * scale
    for event in events:
        zero = zero + 0.0 * event.value + 0.0 * event.rate
    control = step_control.begin(scale, _begins(events, scale), jnp.isfinite(zero), _FIRST_STEP)
    # Where an event function is zero at contact it rises, or nothing is cut.
    events = [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in events]
    lane = Lane(_within(control, until), events, problem.initial, slope)
    lane = lax.while_loop(
        lambda lane: step_control.goes_on(lane.control),
        lambda lane: _try_step(problem, scale, rtol, until, lane),
        lane,
    )
    return _finish(problem, lane, scale, rtol)


def _at_contact(problem: Problem, scale: Scalar) -> tuple[Rows, list[Ends]]:
    """Rate and events at contact; where √0 makes a rate 0·∞, its limit."""
    slope, events = problem.rate_and_events(problem.initial)
    if not problem.rough:
        return slope, events

    def limit() -> tuple[Rows, list[Ends]]:
        known = [jnp.where(jnp.isfinite(k), k, 0.0) for k in slope]
        later = [u + _MOMENT * scale * k for u, k in zip(problem.initial, known, strict=True)]
        rates, ends = problem.rate_and_events(later)
        return rates, [Ends(event.value, end.rate) for event, end in zip(events, ends, strict=True)]

    return lax.cond(_all_finite(slope), lambda: (slope, events), limit)


def _all_finite(rows: Rows) -> Flag:
    return functools.reduce(jnp.logical_and, map(jnp.isfinite, rows))


def _begins(events: Sequence[Ends], time: Scalar) -> Flag:
    """Whether anything is cut: every event function is positive or rises from zero."""
    rises = ((jnp.abs(event.value) <= ZERO) & (event.rate * time > ZERO) for event in events)
    return functools.reduce(
        jnp.logical_and, ((event.value > ZERO) | rising for event, rising in zip(events, rises, strict=True))
    )


def _try_step(problem: Problem, scale: Scalar, rtol: Scalar, until: Scalar | None, lane: Lane) -> Lane:
    """Try one step, and decide what follows."""
    h = lane.control.trial
    state, stages, within = _step(problem, lane.state, lane.slope, h)
    slope, events = problem.rate_and_events(state)
    stages = [[*ks, k] for ks, k in zip(stages, slope, strict=True)]
    error = _error(problem, lane, state, stages, h, scale) / (_SLACK * rtol)
    for event in events:
        # Events may be NaN where the motion is not: 0·NaN is NaN, and an error too.
        error = error + 0.0 * event.value + 0.0 * event.rate
    trial = cut_end.look(lane.control, lane.events, events, within, error, scale, rough=problem.rough)
    control, moved = lax.cond(
        cut_end.is_near_an_end(lane.control, trial),
        lambda: cut_end.decide(lane.control, trial, scale, rough=problem.rough),
        lambda: step_control.go_on(lane.control, trial.error, trial.lowest, scale),
    )
    if problem.rough and problem.order:
        broken = is_broken(problem, lane.state, stages, h, scale) & moved
        control = control._replace(mode=jnp.where(broken, step_control.FAILED, control.mode))
    if problem.rough and problem.order == 2:
        state, slope = corrected(problem, (lane.state, lane.slope), (state, slope), stages, h, scale)
    after = (events, state, slope)
    kept = jax.tree.map(lambda new, old: jnp.where(moved, new, old), after, (lane.events, lane.state, lane.slope))
    return Lane(_within(control, until), *kept)


def _within(control: Control, until: Scalar | None) -> Control:
    return control if until is None else cut_end.stop_at(control, until)


def _step(
    problem: Problem, state: Rows, slope: Rows, h: Scalar
) -> tuple[Rows, list[Rows], list[tuple[float, list[Scalar]]]]:
    """The state after a step of 8th order, each row's slopes at the stages, and the events at two stages."""
    stages, within = [[k] for k in slope], []
    for i, weights in enumerate(A[:-1]):
        at = [_moved_by(weights, u, h, ks) for u, ks in zip(state, stages, strict=True)]
        if i in _LOOKS:
            within.append((float(weights.sum()), problem.events(at)))
        for ks, k in zip(stages, problem.rate(at), strict=True):
            ks.append(k)
    return [_moved_by(B, u, h, ks) for u, ks in zip(state, stages, strict=True)], stages, within


def _moved_by(weights: np.ndarray, u: Scalar, h: Scalar, slopes: Sequence[Scalar]) -> Scalar:
    """U + h Σ w k."""
    used = [k for weight, k in zip(weights, slopes, strict=False) if weight != 0]
    return _increment(tuple(weights[weights != 0]))(u, h, used)


# JAX takes 0.1 ms to trace each product; these are traced once for all rows and programs.
@functools.cache
def _increment(weights: tuple[float, ...]) -> Callable[[Scalar, Scalar, Sequence[Scalar]], Scalar]:
    return jax.jit(lambda u, h, slopes: u + h * _weighted(weights, slopes))


def _weighted(weights: Iterable[float] | np.ndarray, slopes: Sequence[Scalar]) -> Scalar:
    terms = [float(weight) * k for weight, k in zip(weights, slopes, strict=True) if weight != 0]
    return sum(terms[1:], terms[0])


def _error(problem: Problem, lane: Lane, state: Rows, stages: list[Rows], h: Scalar, scale: Scalar) -> Scalar:
    """The largest error of a row, relative to the row's size in this step.

    The size of a derivative's row is at least that of the row which it differentiates. What a row soon changes
    by counts as well: a row that starts as a power of time has the same relative error in any first step.
    """
    sizes: list[Scalar] = [np.float64(_TINY)] * problem.width
    error = 0.0 * h
    for first in range(0, len(state), problem.width):
        rows = range(first, first + problem.width)
        for i, row in enumerate(rows):
            moved = jnp.maximum(jnp.abs(h * stages[row][0]), jnp.abs(_SOON * scale * stages[row][-1]))
            sizes[i] = _size(lane.state[row], state[row], moved, sizes[i])
        # The volume that another step of this length would remove counts as well: most cuts go on.
        of_volume = stages[rows[-1]]
        sizes[-1] = sizes[-1] + jnp.abs(h * of_volume[-1])
        for row, size in zip(rows, sizes, strict=True):
            error = _larger_error(error, h, stages[row], size)
        # The volume's estimate is mostly the largest by far. Where it passes through zero by chance
        # it hides an error, but a second estimate is not zero at the same place.
        error = _checked_error(error, h, of_volume, sizes[-1])
    return error


@jax.jit
def _size(before: Scalar, after: Scalar, moved: Scalar, least: Scalar) -> Scalar:
    return jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), jnp.maximum(moved, least))


@jax.jit
def _larger_error(error: Scalar, h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
    return jnp.maximum(error, jnp.abs(h * _weighted(B_ERROR, slopes)) / size)


@jax.jit
def _checked_error(error: Scalar, h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
    check = jnp.abs(h * _weighted(B_CHECK, slopes)) / size
    return jnp.maximum(error, _CHECK * check * eighth_root(check))


def _finish(problem: Problem, lane: Lane, scale: Scalar, rtol: Scalar) -> Solution:
    """The results where an impact ended, those at contact where nothing is cut; NaN where one of them is not finite."""
    control, equations = lane.control, problem.equations
    left, state, moves = _to_the_end(problem, lane, scale)
    slope, events = problem.rate_and_events(state)
    ended = control.mode == ENDED
    cut = ended & (control.event != NOT_BEGUN)
    event, remaining = cut_end.first_fall(control, events)
    remaining = jnp.where(cut, remaining, 0.0)
    rows = [u + jnp.where(moves, remaining, 0.0) * k for u, k in zip(state, slope, strict=True)]
    members = problem.members(rows)
    time = control.time + left + remaining
    end = at_event(equations, members, event, time)
    at_contact = equations.of(lambda cut, _: cut.volume, problem.members(problem.initial))
    volume = jax.tree.map(lambda cut, alone: jnp.where(event == NOT_BEGUN, alone, cut), end.volume, at_contact)
    time = jax.tree.map(lambda number: jnp.where(event == NOT_BEGUN, 0.0, number), end.time)
    numbers, structure = jax.tree.flatten([equations.per_unit(time), equations.per_unit(volume)])
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, numbers), ended)
    time, volume = jax.tree.unflatten(structure, [jnp.where(finite, number, jnp.nan) for number in numbers])

    count = len(events)
    without_event = jnp.where(event == ARRIVED, count + AFTER_ARRIVED, event)
    outcome = jnp.where(event == NOT_BEGUN, count + AFTER_NO_CUT, without_event)
    no_result = jnp.where(control.mode == UNFINISHED, count + AFTER_UNFINISHED, count + AFTER_FAILED)
    outcome = jnp.where(finite, outcome, no_result)
    amplified = cut & (end.amplification > _DOUBT)
    factor = jnp.where(amplified, _DOUBT / end.amplification, 1.0)
    factor = jnp.where(control.margin < _GRAZE * rtol, jnp.minimum(factor, 1 / _GRAZE), factor)
    factor = jnp.where(control.trials > _MANY_STEPS, jnp.minimum(factor, _MANY_FACTOR), factor)
    if problem.rough:
        factor = jnp.minimum(factor, _ROUGH_FACTOR)
    state_of = getattr(equations.at(problem.numbers), "state", None)
    return Solution(
        outcome=outcome.astype(np.int8),
        tolerance=jnp.where(finite, jnp.maximum(factor * rtol, jnp.minimum(TIGHTEST, rtol)), rtol),
        time=time,
        volume=volume,
        state=None if state_of is None else state_of(members[0]),
        trials=lax.convert_element_type(control.trials, np.int16),
    )


def _to_the_end(problem: Problem, lane: Lane, scale: Scalar) -> tuple[Scalar, Rows, Flag]:
    """The time from the last trial to the end, the state there, and whether it may move to the event itself.

    A force such as depth^1.5 is not defined above the surface. Where the step to the end would find that, Newton's
    method for the event ends a little before it.
    """
    left = lane.control.left
    state = _short_step(problem, lane.state, lane.slope, left)
    if not problem.rough:
        return left, state, jnp.asarray(True)

    def remaining(events: list[Ends]) -> Scalar:
        return sum(jnp.where(lane.control.event == i, -end.value / end.rate, 0.0) for i, end in enumerate(events))

    def nearer(at: tuple[Scalar, Rows, Rows, Scalar]) -> tuple[Scalar, Rows, Rows, Scalar]:
        passed, rows, slope, fall = at
        length = _SHARE * fall
        rows = _short_step(problem, rows, slope, length)
        slope, events = problem.rate_and_events(rows)
        return passed + length, rows, slope, remaining(events)

    def inside() -> tuple[Scalar, Rows, Flag]:
        start = (0.0 * left, lane.state, lane.slope, jnp.minimum(remaining(lane.events), left))
        passed, rows, *_ = lax.while_loop(lambda at: at[-1] > _INSIDE * scale, nearer, start)
        return passed, rows, jnp.asarray(False)

    slope, events = problem.rate_and_events(state)
    event = [u + remaining(events) * k for u, k in zip(state, slope, strict=True)]
    defined = _all_finite([*state, *slope, *problem.rate(event)])
    return lax.cond(defined, lambda: (left, state, jnp.asarray(True)), inside)


def _short_step(problem: Problem, state: Rows, slope: Rows, h: Scalar) -> Rows:
    """The state a short time after: the classical method of fourth order."""

    def after(weight: float, slopes: Rows) -> Rows:
        return [_moved_by(np.array([weight]), u, h, [k]) for u, k in zip(state, slopes, strict=True)]

    second = problem.rate(after(1 / 2, slope))
    third = problem.rate(after(1 / 2, second))
    fourth = problem.rate(after(1.0, third))
    weights = np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6])
    return [_moved_by(weights, u, h, ks) for u, *ks in zip(state, slope, second, third, fourth, strict=True)]
