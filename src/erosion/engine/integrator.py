"""One impact from contact to its end: an error-controlled Runge-Kutta method that ends exactly at an event.

Plain JAX for one impact's numbers. `erosion.lanes` compiles it for many at a time, `jax.vmap` for a GPU.
"""

import functools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.engine import step_control
from erosion.engine.crossings import Ends
from erosion.engine.leaves import Layout
from erosion.engine.outcomes import AFTER_ARRIVED, AFTER_FAILED, AFTER_NO_CUT, AFTER_UNFINISHED
from erosion.engine.reduction import WholeMotion, reduced
from erosion.engine.step_control import ARRIVED, ENDED, NO_CUT, UNFINISHED, Control, eighth_root, first_fall
from erosion.engine.tableau import B_CHECK, B_ERROR, A, B
from erosion.engine.variational import Cut, Derivatives, Direction, Variational, at_event
from erosion.models.base import ZERO

_SLACK = 4.0  # the embedded estimate is of 7th order, the solution of 8th; docs/performance.md
_TINY = 1e-200  # keeps 0/0 away
_CHECK = 0.1  # of the second estimate, brought to the first one's order; docs/performance.md
_FIRST_STEP = 0.17  # of the model's time scale
_LOOKS = (5, 9)  # stages at 0.15 and 0.92 of a step: no cubic errs at both by much less than in between
_DOUBT = 100.0  # errors are mostly so much smaller than the tolerance
_GRAZE = 1e4  # tolerances; a dip so close to zero may be a fall, after many turns of a fast spin
TIGHTEST = 1e-13  # tolerance of a second integration: rounding is near
_MANY_STEPS, _MANY_FACTOR = 64, 1e-2  # the errors of so many add up, and may grow from one to the next

Rows = list[Any]
"""The state with its derivatives as plain numbers, one member after the other."""


class Lane(NamedTuple):
    """An impact under way: where it stands, and at the start of the next step events, state and slopes."""

    control: Control
    events: list[Ends]
    state: Rows
    slope: Rows


class Solution(NamedTuple):
    """What comes of an impact.

    Args:
        outcome: a code; see `erosion.engine.outcomes`.
        tolerance: with which the impact should have been integrated for its results to be as exact as asked for.
        time, volume: the end of the cut and the volume removed, with derivatives.
        state: the model's own state there, where it was asked for.
        trials: steps that were tried.
    """

    outcome: Any
    tolerance: Any
    time: Derivatives
    volume: Derivatives
    state: Any
    trials: Any


class Problem:
    """An impact's equations, as functions of plain numbers.

    Args:
        layout, numbers: of model and case.
        order, directions: see `Variational`.
        whole: keep the model's own state, not as few unknowns as its arithmetic shows.
    """

    def __init__(
        self, layout: Layout, numbers: Sequence[Any], order: int, directions: tuple[Direction, ...], *, whole: bool
    ) -> None:
        self.layout, self.numbers = layout, list(numbers)
        motion = WholeMotion if whole else reduced(layout)
        named = all(isinstance(direction, str) for direction in directions)
        given = () if named else directions

        def equations(numbers: Sequence[Any], given: Any) -> Variational:
            return Variational(layout, numbers, order, directions if named else given, motion)

        self.equations = equations(self.numbers, given)
        members, self._structure = jax.tree.flatten(self.equations.initial())
        self.initial: Rows = members
        self._member = jax.tree.structure(Cut(motion(*layout.joined(numbers)).initial_state(), 0.0))
        self.width = self._member.num_leaves

        # Each is traced once for all the places where it is called.
        @jax.jit
        def rate(numbers: Sequence[Any], given: Any, rows: Rows) -> Rows:
            return jax.tree.leaves(equations(numbers, given).rate(self.members(rows)))

        @jax.jit
        def rate_and_events(numbers: Sequence[Any], given: Any, rows: Rows) -> tuple[Rows, list[Ends]]:
            its, state = equations(numbers, given), self.members(rows)
            flow = its.rate(state)
            here = its.at(numbers)
            values, rates = jax.jvp(here.events, (state[0],), (flow[0],))
            return jax.tree.leaves(flow), [Ends(*each) for each in zip(values, rates, strict=True)]

        @jax.jit
        def events(numbers: Sequence[Any], rows: Rows) -> list[Any]:
            return motion(*layout.joined(numbers)).events(self.members(rows)[0])

        self.events = functools.partial(events, self.numbers)
        self.rate = functools.partial(rate, self.numbers, given)
        self.rate_and_events = functools.partial(rate_and_events, self.numbers, given)

    def members(self, rows: Rows) -> tuple[Cut, ...]:
        """Value and derivatives of a state."""
        parts = [rows[i : i + self.width] for i in range(0, len(rows), self.width)]
        return tuple(jax.tree.unflatten(self._member, part) for part in parts)


def solve(
    layout: Layout,
    numbers: Sequence[Any],
    directions: tuple[Direction, ...],
    rtol: Any,
    until: Any = None,
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
        until: no further than to this time since contact.
        order: 0, 1 or 2 derivatives.
        whole: give the model's own state at the end, too.
    """
    problem = Problem(layout, numbers, order, directions, whole=whole)
    model, p = layout.joined(numbers)
    scale = model.scales(p).time
    slope, events = problem.rate_and_events(problem.initial)
    # 0·NaN and 0·∞ are NaN: also of parameters that the motion does not depend on.
    nothing = sum(jnp.sum(0.0 * number) for number in numbers)
    nothing = nothing + sum(0.0 * row for row in (*problem.initial, *slope)) + 0.0 * scale
    for event in events:
        nothing = nothing + 0.0 * event.value + 0.0 * event.rate
    control = step_control.begin(scale, _begins(events, scale), jnp.isfinite(nothing), _FIRST_STEP)
    # Where an event function is zero at contact it rises, or nothing is cut.
    events = [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in events]
    lane = Lane(_within(control, until), events, problem.initial, slope)
    lane = lax.while_loop(
        lambda lane: step_control.goes_on(lane.control),
        lambda lane: _try_step(problem, scale, rtol, until, lane),
        lane,
    )
    return _finish(problem, lane, rtol)


def _begins(events: Sequence[Ends], time: Any) -> Any:
    """Whether anything is cut: every event function is positive or rises from zero."""
    rises = ((jnp.abs(event.value) <= ZERO) & (event.rate * time > ZERO) for event in events)
    return functools.reduce(
        jnp.logical_and, ((event.value > ZERO) | rising for event, rising in zip(events, rises, strict=True))
    )


def _try_step(problem: Problem, scale: Any, rtol: Any, until: Any, lane: Lane) -> Lane:
    """Try one step, and act on what it was."""
    h = lane.control.trial
    state, stages, within = _step(problem, lane.state, lane.slope, h)
    slope, events = problem.rate_and_events(state)
    stages = [[*ks, k] for ks, k in zip(stages, slope, strict=True)]
    error = _error(problem, lane, state, stages, h) / (_SLACK * rtol)
    for event in events:
        # Events that are not numbers, of a motion that is, are an error too: 0·NaN is NaN.
        error = error + 0.0 * event.value + 0.0 * event.rate
    trial = step_control.look(lane.control, lane.events, events, within, error)
    control, moved = lax.cond(
        step_control.is_near_an_end(lane.control, trial),
        lambda: step_control.decide(lane.control, trial, scale),
        lambda: step_control.go_on(lane.control, trial, scale),
    )
    after = (events, state, slope)
    kept = jax.tree.map(lambda new, old: jnp.where(moved, new, old), after, (lane.events, lane.state, lane.slope))
    return Lane(_within(control, until), *kept)


def _within(control: Control, until: Any) -> Control:
    return control if until is None else step_control.stop_at(control, until)


def _step(problem: Problem, state: Rows, slope: Rows, h: Any) -> tuple[Rows, list[Rows], list[tuple[float, list[Any]]]]:
    """The state after a step of 8th order, each row's slopes at the stages, and the events at two of these."""
    stages, within = [[k] for k in slope], []
    for i, weights in enumerate(A[:-1]):
        at = [_moved_by(weights, u, h, ks) for u, ks in zip(state, stages, strict=True)]
        if i in _LOOKS:
            within.append((float(weights.sum()), problem.events(at)))
        for ks, k in zip(stages, problem.rate(at), strict=True):
            ks.append(k)
    return [_moved_by(B, u, h, ks) for u, ks in zip(state, stages, strict=True)], stages, within


def _moved_by(weights: np.ndarray, u: Any, h: Any, slopes: Sequence[Any]) -> Any:
    """U + h Σ w k."""
    used = [k for weight, k in zip(weights, slopes, strict=False) if weight != 0]
    return _increment(tuple(weights[weights != 0]))(u, h, used)


# JAX takes 0.1 ms to trace each product; these are traced once for all rows and programs.
@functools.cache
def _increment(weights: tuple[float, ...]) -> Any:
    return jax.jit(lambda u, h, slopes: u + h * _weighted(weights, slopes))


def _weighted(weights: Iterable[float], slopes: Sequence[Any]) -> Any:
    terms = [float(weight) * k for weight, k in zip(weights, slopes, strict=True) if weight != 0]
    return sum(terms[1:], terms[0])


def _error(problem: Problem, lane: Lane, state: Rows, stages: list[Rows], h: Any) -> Any:
    """The largest error of a row, relative to what that row is in this step.

    A derivative's error also counts relative to the size of what it is the derivative of.
    """
    sizes: list[Any] = [np.float64(_TINY)] * problem.width
    error = 0.0 * h
    for first in range(0, len(state), problem.width):
        rows = range(first, first + problem.width)
        for i, row in enumerate(rows):
            sizes[i] = _size(lane.state[row], state[row], h * stages[row][0], sizes[i])
        # Of the volume, what it would gain in as long a time again counts as well: most cuts go on.
        of_volume = stages[rows[-1]]
        sizes[-1] = sizes[-1] + jnp.abs(h * of_volume[-1])
        for row, size in zip(rows, sizes, strict=True):
            error = _larger_error(error, h, stages[row], size)
        # The volume's estimate is mostly the largest by far, so where it passes through zero by
        # chance an error would go unseen. It does not do so together with a second one.
        error = _checked_error(error, h, of_volume, sizes[-1])
    return error


@jax.jit
def _size(before: Any, after: Any, moved: Any, least: Any) -> Any:
    return jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), jnp.maximum(jnp.abs(moved), least))


@jax.jit
def _larger_error(error: Any, h: Any, slopes: Sequence[Any], size: Any) -> Any:
    return jnp.maximum(error, jnp.abs(h * _weighted(B_ERROR, slopes)) / size)


@jax.jit
def _checked_error(error: Any, h: Any, slopes: Sequence[Any], size: Any) -> Any:
    check = jnp.abs(h * _weighted(B_CHECK, slopes)) / size
    return jnp.maximum(error, _CHECK * check * eighth_root(check))


def _finish(problem: Problem, lane: Lane, rtol: Any) -> Solution:
    """Where an impact ended: zeros where nothing is cut; NaN, and failed, where a number is not finite."""
    control, equations = lane.control, problem.equations
    state = _short_step(problem, lane.state, lane.slope, control.left)
    slope, events = problem.rate_and_events(state)
    ended = control.mode == ENDED
    cut = ended & (control.event != NO_CUT)
    which, remaining = first_fall(control, events)
    remaining = jnp.where(cut, remaining, 0.0)
    rows = [u + remaining * k for u, k in zip(state, slope, strict=True)]
    members = problem.members(rows)
    time = control.time + control.left + remaining
    end = at_event(equations, members, which, time)
    results = [equations.per_unit(end.time), equations.per_unit(end.volume)]
    numbers, structure = jax.tree.flatten(results)
    numbers = [jnp.where(which == NO_CUT, 0.0, number) for number in numbers]
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, numbers), ended)
    time, volume = jax.tree.unflatten(structure, [jnp.where(finite, number, jnp.nan) for number in numbers])

    count = len(events)
    without_event = jnp.where(which == ARRIVED, count + AFTER_ARRIVED, which)
    outcome = jnp.where(which == NO_CUT, count + AFTER_NO_CUT, without_event)
    no_result = jnp.where(control.mode == UNFINISHED, count + AFTER_UNFINISHED, count + AFTER_FAILED)
    outcome = jnp.where(finite, outcome, no_result)
    amplified = cut & (end.amplification > _DOUBT)
    factor = jnp.where(amplified, _DOUBT / end.amplification, 1.0)
    factor = jnp.where(control.margin < _GRAZE * rtol, jnp.minimum(factor, 1 / _GRAZE), factor)
    factor = jnp.where(control.trials > _MANY_STEPS, jnp.minimum(factor, _MANY_FACTOR), factor)
    own = getattr(equations.at(problem.numbers), "state", None)
    return Solution(
        outcome=outcome.astype(np.int8),
        tolerance=jnp.where(finite, jnp.maximum(factor * rtol, jnp.minimum(TIGHTEST, rtol)), rtol),
        time=time,
        volume=volume,
        state=None if own is None else own(members[0]),
        trials=control.trials.astype(np.int16),
    )


def _short_step(problem: Problem, state: Rows, slope: Rows, h: Any) -> Rows:
    """The state a short time after: the classical method of fourth order."""

    def after(weight: float, slopes: Rows) -> Rows:
        return [_moved_by(np.array([weight]), u, h, [k]) for u, k in zip(state, slopes, strict=True)]

    second = problem.rate(after(1 / 2, slope))
    third = problem.rate(after(1 / 2, second))
    fourth = problem.rate(after(1.0, third))
    weights = np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6])
    return [_moved_by(weights, u, h, ks) for u, *ks in zip(state, slope, second, third, fourth, strict=True)]
