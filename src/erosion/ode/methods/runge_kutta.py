"""Explicit Runge-Kutta methods: steps, errors, the end by a short step, states within a step, and steps back."""

import abc
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.crossings import ByAShortStep, ShortOfKinks
from erosion.ode.cubics import Ends
from erosion.ode.event_location import Lane, Segment, all_finite, happening, segment_to
from erosion.ode.kinks import is_kinked
from erosion.ode.methods.base import (
    APART,
    LEAST,
    NOISE,
    BackStep,
    Method,
    Reverse,
    Step,
    sizes_or_least,
)
from erosion.ode.methods.norms import NORMS
from erosion.ode.methods.sums import moved_by, weighted
from erosion.ode.methods.transposes import plus, transposed
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import ENDED, FAILED, FIRST_STEP, NOT_BEGUN, ULPS, eighth_root
from erosion.ode.variational import AlongFlow, EndTimeDependence

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations
    from erosion.ode.tape import Entry

_CHECK = 0.1  # of the second estimate, brought to the first one's order
_FAST = 1.0  # over an eigenvalue is a step at least that a fast part of the motion makes short
_LONGER = 0.5  # times as long a step at least would do for the method for stiff motions
_TOLD = 1e-4  # tolerances: stages that differ by less say nothing about eigenvalues
_TINY = 1e-200  # keeps 0/0 away
SOON = 1e-3  # of the time scale: what a row changes within it counts as its size
_INSIDE = 1e-10  # of the time scale: as near to an end beyond which the motion is not defined
_BESIDE = 1e-12  # the same beside an end at which a rate has a kink or a jump
_SHARE = 0.98  # of the way to it is a step, by Newton's method
_ORDERS, _ROUNDS = 64.0, 100  # of a zero, and of the search for it, at most
_BENDS = 0.01  # of what is left of a step: by less a rate changes where rounding hides the zero
_HIDDEN = 1e-5  # of the time scale: what Newton's method says beside a zero that is no rounding
_MOSTLY = 0.99  # of the way to such a zero is a step
_LONG = 0.1  # of the time scale: a way to the event by Newton's method that is no graze's
_COMPARED = 0.25, 0.75  # of a step: where the polynomial's rates are compared with the motion's, if it may have kinks
_FOLLOWS = 1.0  # tolerances: the polynomial is as exact


class _Search(NamedTuple):
    """The way to an event that Newton's method does not reach soon.

    Args:
        rounds: so far.
        time_to_event: time since the last trial.
        flat_state, slope, events: there.
        time: to the zero by Newton's method.
        low, high: times before and after the zero.
        length: of the next step.
        slow: whether Newton's method alone is too slow.
    """

    rounds: Scalar
    passed: Scalar
    flat_state: FlatState
    slope: FlatState
    events: list[Ends]
    time: Scalar
    low: Scalar
    high: Scalar
    length: Scalar
    slow: Flag


class Tableau(NamedTuple):
    """Weights of an explicit method.

    Args:
        a: of the slopes so far in each stage after the first; the last row is the step itself.
        b: of all slopes, that at the step's end included, in the solution.
        error: and in its difference from the embedded one.
    """

    a: tuple[np.ndarray, ...]
    b: np.ndarray
    error: np.ndarray


class RungeKutta(Method):
    """Any explicit method.

    Args:
        tableau: its weights.
        slack: tolerances that the embedded estimate may be: where a quantity alone is wanted, and by order of
            derivatives where the whole state is.
        interior_stages: stages within a step at which the events are asked for; at least one, for a function that is
            not affine in the state may rise and fall within a step.
        more_interior_stages: the same where event functions may move faster than the state.
    """

    foresees = True
    tableau: ClassVar[Tableau]
    slack: ClassVar[tuple[float, tuple[float, float, float]]]
    back_steps: "ClassVar[type[BackSteps]]"
    interior_stages: ClassVar[tuple[int, ...]]
    more_interior_stages: ClassVar[tuple[int, ...]]

    def after_stage(self, stage: int, flat_state: FlatState) -> list[tuple[float, list[Scalar]]]:
        """The events there, if the stage is one at which they are asked for."""
        interior_stages = self.interior_stages if self.problem.event_set.are_slow else self.more_interior_stages
        if stage not in interior_stages:
            return []
        return [(float(self.tableau.a[stage].sum()), self.problem.events(flat_state))]

    def at_end(self, state: FlatState, stages: list[FlatState], h: Scalar) -> list[tuple[float, list[Scalar]]]:
        """The events within a step, from all its slopes."""
        return []

    def check(self, check: Scalar, h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
        """The greatest second estimate of an error, with one more row."""
        return check

    def raised(self, error: Scalar) -> Scalar:
        """An error over the tolerance, to the 8th order, whose root the step control takes."""
        return error

    def __init__(self, problem: "LaneEquations") -> None:
        super().__init__(problem)
        self.ending = ShortOfKinks() if problem.nonsmooth else ByAShortStep()
        self.norm = NORMS[type(problem.options.outputs)](problem)

    def first_step(self, initial: FlatState, slope: FlatState, scale: Scalar, asked: Scalar) -> Scalar:
        """See `Method`."""
        return asked

    def sizes(self, before: FlatState, state: FlatState) -> FlatState:
        """See `Method`."""
        return super().sizes(before, state) if self.norm.remembers else []

    def tried(self, lane: Lane, scale: Scalar, rtol: Scalar) -> Step:
        """See `Method`."""
        h, before = lane.control.trial_length, lane.state
        state, stages, interior_samples = self.step(before, lane.slope, h)
        slope, events = self.problem.rate_and_events(state)
        stages = [[*ks, k] for ks, k in zip(stages, slope, strict=True)]
        error = self.error_of(lane.greatest, (before, state), stages, h, scale, rtol) / (
            self.norm.slack(*self.slack) * rtol
        )
        interior_samples += self.at_end(before, stages, h)
        return Step(state, slope, stages, events, interior_samples, self.raised(error))

    def step(
        self, state: FlatState, slope: FlatState, h: Scalar
    ) -> tuple[FlatState, list[FlatState], list[tuple[float, list[Scalar]]]]:
        """The state after a step of 8th order, each row's slopes at the stages, and the events at two stages."""
        stages, interior_samples = [[k] for k in slope], []
        for i, weights in enumerate(self.tableau.a[:-1]):
            at = [moved_by(weights, u, h, ks) for u, ks in zip(state, stages, strict=True)]
            interior_samples += self.after_stage(i, at)
            for ks, k in zip(stages, self.problem.rate(at), strict=True):
                ks.append(k)
        return (
            [moved_by(self.tableau.b, u, h, ks) for u, ks in zip(state, stages, strict=True)],
            stages,
            interior_samples,
        )

    def error_of(
        self,
        greatest: FlatState,
        states: tuple[FlatState, FlatState],
        stages: list[FlatState],
        h: Scalar,
        scale: Scalar,
        rtol: Scalar,
    ) -> Scalar:
        """The largest error of a row, relative to the row's size in this step.

        The size of a derivative's row is at least that of the row which it differentiates. What a row soon changes
        by counts as well: a row that starts as a power of time has the same relative error in any first step.

        Args:
            greatest: the greatest size so far of each row of the motion itself, where the whole state is wanted.
            states: before and after the step.
            stages: the slopes of each row in the step.
            h: its length.
            scale: the time scale.
            rtol: the tolerance, for the rounding of derivatives.
        """
        before, state = states
        sizes: list[Scalar] = sizes_or_least(self.problem.sizes, greatest)
        error = check = 0.0 * h
        late, integrals = self.norm.late, range(self.problem.width - self.problem.integrals, self.problem.width)
        of_motion = sizes
        for first in range(0, len(state), self.problem.width):
            member = range(first, first + self.problem.width)
            if first:
                sizes = self.norm.of_tangent(sizes, of_motion, rtol)
            for i, row in enumerate(member):
                moved = jnp.maximum(jnp.abs(h * stages[row][0]), jnp.abs(SOON * scale * stages[row][late]))
                sizes[i] = _size(before[row], state[row], moved, sizes[i])
            # What another step of this length would add to an integral counts as well: most lanes go on.
            for i in integrals:
                sizes[i] = sizes[i] + jnp.abs(h * stages[first + i][late])
            some = slice(first, first + self.problem.width)
            measures = self.norm.measures(sizes, (before[some], state[some]), stages[some], h)
            for row, size in zip(member, measures, strict=True):
                error = jnp.maximum(error, estimate(tuple(self.tableau.error), h, stages[row], size))
            for i in self.norm.checked:
                check = self.check(check, h, stages[first + i], measures[i])
            of_motion = of_motion if first else list(sizes)
        return jnp.maximum(error, _CHECK * check * eighth_root(check))

    def stiffness(
        self, greatest: FlatState, states: tuple[FlatState, FlatState], stages: list[FlatState], h: Scalar, rtol: Scalar
    ) -> Scalar:
        """1 where the fastest part of a smooth motion makes a step short, -1 where it does not, 0 where none can say.

        Two stages are near the step's end. Their slopes differ by an eigenvalue times their difference. How smooth the
        motion is shows in how much its slopes change: a step of a method of 5th order could be about rtol^0.2 over the
        root of that change times as long.

        Args:
            greatest: the greatest size so far of each row of the motion itself.
            states: before and after the step.
            stages: the slopes of each row in the step.
            h: its length.
            rtol: the tolerance.
        """
        apart = slopes = change = 0.0 * h
        sizes: list[Scalar] = [LEAST * size for size in greatest]
        for i, (before, after, ks) in enumerate(zip(*states, stages, strict=True)):
            own = i % self.problem.width
            size = jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), sizes[own]) + _TINY
            change = jnp.maximum(change, jnp.abs(h * (ks[-1] - ks[0])) / size)
            if i == own:
                one, other = (moved_by(self.tableau.a[j], before, h, ks[: j + 1]) for j in (-3, -2))
                apart = jnp.maximum(apart, jnp.abs(other - one) / size)
                slopes = jnp.maximum(
                    slopes, jnp.abs(h * (ks[len(self.tableau.a) - 1] - ks[len(self.tableau.a) - 2])) / size
                )
                sizes[own] = jnp.maximum(APART, NOISE / rtol) * size
        smooth = (_LONGER * _LONGER * change) ** 5 < rtol * rtol
        # Differences of rounding say nothing.
        return jnp.where(apart > _TOLD * rtol, jnp.where(smooth & (slopes > _FAST * apart), 1.0, -1.0), 0.0)

    def short_step(self, state: FlatState, slope: FlatState, h: Scalar) -> FlatState:
        """The state a short time after: the classical method of fourth order."""

        def after(weight: float, slopes: FlatState) -> FlatState:
            return [moved_by(np.array([weight]), u, h, [k]) for u, k in zip(state, slopes, strict=True)]

        second = self.problem.rate(after(1 / 2, slope))
        third = self.problem.rate(after(1 / 2, second))
        fourth = self.problem.rate(after(1.0, third))
        weights = np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6])
        return [moved_by(weights, u, h, ks) for u, *ks in zip(state, slope, second, third, fourth, strict=True)]

    def finish_step(self, lane: Lane, time_to_end: Scalar | None) -> tuple[Segment, EndTimeDependence]:
        """The motion where its last step found its end."""
        control, event_set = lane.control, self.problem.event_set
        scale = self.problem.scale_near(control.step, FIRST_STEP)
        search, moves = self._searched(lane, *self._to_the_end(lane, scale), scale)
        passed, state, slope = search.passed, search.flat_state, search.slope
        # What is rounding has no zero.
        lost = search.slow & ~(_ORDERS * jnp.abs(search.time) < _HIDDEN * scale)
        control = control._replace(mode=jnp.where(lost, FAILED, control.mode))
        events = event_set.counting(lane.watched, search.events, control.event)
        ended = (control.mode == ENDED) & (control.event != NOT_BEGUN)
        event, remaining = event_set.first_at_end(control, events, scale, time_to_end)
        # The derivatives are those beside a zero that Newton's method does not reach: at it they are 0/0.
        remaining = jnp.where(search.slow, search.length, jnp.where(ended, remaining, 0.0))
        flat_state: FlatState = [u + jnp.where(moves, remaining, 0.0) * k for u, k in zip(state, slope, strict=True)]
        value_and_tangents = self.problem.value_and_tangents(flat_state)
        along = AlongFlow(self.problem.equations, value_and_tangents, jnp.where(moves, 0.0, remaining))
        at_once = happening(self.problem, ended, event, remaining, events, scale)
        motion = segment_to(
            lane._replace(control=control), along.value_and_tangents, event, control.time + passed + remaining, at_once,
            time_to_end, scale,
        )  # fmt: skip
        return motion, along

    def _searched(
        self, lane: Lane, start: Scalar, state: FlatState, moves: Flag, scale: Scalar
    ) -> tuple[_Search, Flag]:
        """Take one more short step before Newton's last, as an event function may bend more than the motion.

        Towards a zero of higher order, as of (y - 1)⁵, or one beside other zeros, Newton's method leaves a share of the
        way at each step. There the steps are as many times longer as the zero has orders, or halve what is known to
        hold it, and end beside it. Also whether the state moves to the event itself.
        """
        control = lane.control
        near = jnp.maximum(_BESIDE * scale, ULPS * control.time)
        happens = moves & (control.mode == ENDED) & (control.event >= 0)

        def chosen(parts: Sequence[Scalar]) -> Scalar:
            return sum((jnp.where(control.event == i, part, 0.0) for i, part in enumerate(parts)), jnp.zeros(()))

        def rate_of(events: Sequence[Ends]) -> Scalar:
            return chosen([event.rate for event in events])

        def at(passed: Scalar, flat_state: FlatState, before: _Search | None) -> _Search:
            slope, events = self.problem.rate_and_events(flat_state)
            time = chosen([-event.value / event.rate for event in events])
            fits = happens & jnp.isfinite(time) & (jnp.abs(time) < jnp.abs(start) + SOON * scale)
            simple = jnp.where(fits, time, 0.0)
            if before is None:
                far = simple + jnp.inf
                return _Search(
                    0 * control.mode, passed, flat_state, slope, events, simple, -far, far, simple, jnp.asarray(False)
                )
            # Newton's last step leaves the third power of this one over the square of that before. By as much the rate
            # has changed, if it is not rounding that hides the zero.
            ratio = jnp.abs(time / before.time)
            bends = jnp.abs(rate_of(events) / rate_of(before.events) - 1) > _BENDS * ratio
            far = (jnp.abs(time) > near) & (jnp.abs(time) * ratio * ratio > near)
            # Behind a kink of the function a step along a line is too long, unless its rate has gone, as at a graze.
            straight = jnp.abs(rate_of(events) / rate_of(before.events) - 1) < _BENDS
            long = happens & ~fits & straight & (jnp.abs(time) < _LONG * scale)
            slow = before.slow | ((before.rounds == 0) & ((fits & bends & far) | long))
            turns = zip(lane.watched, events, strict=True)
            is_before = chosen([watched.sign * event.value for watched, event in turns]) > 0
            low, high = jnp.where(is_before, passed, before.low), jnp.where(is_before, before.high, passed)
            order = jnp.clip(before.length / (before.time - time), 1.0, _ORDERS)
            aim = _MOSTLY * order * time
            inside = (passed + aim > low) & (passed + aim < high)
            shorter = jnp.abs(aim) < jnp.abs(before.length) / 2
            bracketed = high - low < jnp.inf
            further = jnp.where(is_before, 2.0, -2.0) * jnp.abs(before.length)
            length = jnp.where(
                inside & (shorter | ~bracketed), aim, jnp.where(bracketed, (low + high) / 2 - passed, further)
            )
            return _Search(
                before.rounds + 1,
                passed,
                flat_state,
                slope,
                events,
                time,
                low,
                high,
                jnp.where(slow, length, 0.0),
                slow,
            )

        def goes_on(search: _Search) -> Flag:
            far = (
                (jnp.abs(search.length) > near)
                & (search.high - search.low > near)
                & (jnp.abs(search.passed - start) < scale)
            )
            return (search.rounds == 0) | (search.slow & far & (search.rounds < _ROUNDS))

        def nearer(search: _Search) -> _Search:
            flat_state = self.short_step(search.flat_state, search.slope, search.length)
            return at(search.passed + search.length, flat_state, search)

        search = at(start, state, None)
        if self.problem.event_set.locates_closely:
            search = lax.while_loop(goes_on, nearer, search)
        return search, jnp.logical_and(moves, ~search.slow)

    def _to_the_end(self, lane: Lane, scale: Scalar) -> tuple[Scalar, FlatState, Flag]:
        """The time from the last trial to the end, the state there, and whether it may move to the event itself.

        A force such as depth^1.5 is not defined above the surface, and |v| has another slope beyond v = 0. At such an
        event only the side from which the motion comes counts: Newton's method ends a little before it.
        """
        time_to_event = lane.control.time_to_event
        state = self.short_step(lane.state, lane.slope, time_to_event)
        if not self.problem.nonsmooth:
            return time_to_event, state, jnp.asarray(True)

        def remaining(events: list[Ends]) -> Scalar:
            times = (jnp.where(lane.control.event == i, -end.value / end.rate, 0.0) for i, end in enumerate(events))
            return sum(times, jnp.zeros(()))

        def nearer(at: tuple[Scalar, FlatState, FlatState, Scalar]) -> tuple[Scalar, FlatState, FlatState, Scalar]:
            passed, flat_state, slope, fall = at
            length = _SHARE * fall
            flat_state = self.short_step(flat_state, slope, length)
            slope, events = self.problem.rate_and_events(flat_state)
            return passed + length, flat_state, slope, remaining(events)

        def inside() -> tuple[Scalar, FlatState, Flag]:
            start = (0.0 * time_to_event, lane.state, lane.slope, jnp.minimum(remaining(lane.events), time_to_event))
            beside = jnp.where(reached, _BESIDE, _INSIDE) * scale
            passed, flat_state, *_ = lax.while_loop(lambda at: at[-1] > beside, nearer, start)
            return passed, flat_state, jnp.asarray(False)

        slope, events = self.problem.rate_and_events(state)
        event = [u + remaining(events) * k for u, k in zip(state, slope, strict=True)]
        reached = defined = all_finite([*state, *slope, *self.problem.rate(event)])
        if self.problem.event_set.locates_closely:
            # One more short step follows: where the event is the edge of what is defined, rounding might pass over it.
            beyond = [u + _BESIDE * scale * k for u, k in zip(event, slope, strict=True)]
            defined = defined & all_finite(self.problem.rate(beyond))
        happens = (lane.control.mode == ENDED) & (lane.control.event >= 0)
        kinked = happens & is_kinked(self.problem.rate, event, slope, scale)
        return lax.cond(defined & ~kinked, lambda: (time_to_event, state, jnp.asarray(True)), inside)

    def interpolate(self, before: "Lane", after: "Lane", rtol: Scalar) -> Callable[[Scalar], EndTimeDependence]:
        """See `Method`: a polynomial of degree 8, or where the motion may have kinks a step."""
        problem, begin, h = self.problem, before.control.time, before.control.trial_length
        middle, *_ = self.step(before.state, before.slope, 0.5 * h)
        flow = problem.rate(middle)
        points = (before.state, before.slope), (middle, flow), (after.state, after.slope)
        curves = [jax.jvp(problem.rate, (flat_state,), (slope,))[1] for flat_state, slope in points]
        columns = list(
            zip(*(flat_state for flat_state, _ in points), *(slope for _, slope in points), *curves, strict=True)
        )
        polynomials = [_polynomial(h, column) for column in columns]

        def at(passed: Scalar) -> FlatState:
            x = 2.0 * passed - 1.0
            # From the start of the step, which is met exactly.
            return [u + passed * functools.reduce(lambda sum_, c: sum_ * x + c, cs) for u, cs in polynomials]

        if not problem.nonsmooth:
            return lambda time: self._along(at((time - begin) / h))
        follows = jnp.asarray(True)
        for share in _COMPARED:
            flat_state, slopes = jax.jvp(at, (jnp.asarray(share),), (jnp.ones(()),))
            for column, slope, rate in zip(columns, slopes, problem.rate(flat_state), strict=True):
                size = functools.reduce(jnp.maximum, [jnp.abs(u) for u in column[:3]]) + jnp.abs(h * rate)
                follows &= jnp.abs(slope - h * rate) <= _FOLLOWS * rtol * size

        def rows_at(time: Scalar) -> FlatState:
            passed = time - begin
            return lax.cond(
                follows,
                lambda: at(passed / h),
                lambda: self.step(before.state, before.slope, passed)[0],
            )

        return lambda time: self._along(rows_at(time))

    def beyond(self, lane: Lane, motion: Segment) -> Callable[[Scalar], EndTimeDependence]:
        """See `Method`."""
        last: FlatState = jax.tree.leaves(motion.value_and_tangents)
        end = motion.time

        def at(time: Scalar) -> EndTimeDependence:
            there = time >= end
            passed = jnp.where(there, 0.0, time - lane.control.time)
            flat_state = self.short_step(lane.state, lane.slope, passed)
            return self._along([jnp.where(there, at_end, row) for at_end, row in zip(last, flat_state, strict=True)])

        return at

    def _along(self, flat_state: FlatState) -> EndTimeDependence:
        return AlongFlow(self.problem.equations, self.problem.value_and_tangents(flat_state))

    def reverse(
        self, rate: Callable[[list[Number], FlatState], FlatState], parameters: list[Number], every: Any
    ) -> "BackSteps":
        """See `Method`."""
        return self.back_steps(self.tableau, rate, parameters)


@jax.jit
def _size(before: Scalar, after: Scalar, moved: Scalar, least: Scalar) -> Scalar:
    return jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), jnp.maximum(moved, least))


@functools.partial(jax.jit, static_argnums=0)
def estimate(weights: tuple[float, ...], h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
    """An estimate of a step's error over a size."""
    return jnp.abs(h * weighted(weights, slopes)) / size


# From the values at -1, 0 and 1, the first and the second derivatives, all of them in halves of the step, to the
# coefficients of 1, x, … x⁸; sixteenths.
_POWERS = np.arange(9)
_CONDITIONS = [
    [np.prod(k - np.arange(order)) * float(x) ** max(k - order, 0) for k in _POWERS]
    for order in range(3)
    for x in (-1, 0, 1)
]
_COEFFICIENTS = np.round(16 * np.linalg.inv(np.array(_CONDITIONS))) / 16
# Of a polynomial that is zero at -1, over (1 + x)/2: the coefficients of x⁷, … 1.
_WEIGHTS = 2.0 * np.array(list(itertools.accumulate(_COEFFICIENTS[:0:-1, 1:], lambda above, c: c - above)))


@jax.jit
def _polynomial(h: Scalar, column: Sequence[Scalar]) -> tuple[Scalar, list[Scalar]]:
    """The start of a step, and the coefficients of x⁷, … 1 in the rest; x is -1 at its start and 1 at its end."""
    start, middle, end, *others = column
    half = 0.5 * h
    slopes, curves = [half * slope for slope in others[:3]], [half * half * curve for curve in others[3:]]
    data = [middle - start, end - start, *slopes, *curves]
    return start, [sum(float(w) * d for w, d in zip(row, data, strict=True) if w != 0) for row in _WEIGHTS]


# A cotangent is not known that errs by so many tolerances of the greatest that it had.
_LOST = 1e3


class BackSteps(Reverse):
    """Steps back of an explicit method; `power` brings the error of cotangents to the order of a step's."""

    share = 1e-6
    power: ClassVar[float]
    stages: ClassVar[int]  # that are gone back through

    def __init__(
        self, tableau: Tableau, rate: Callable[[list[Number], FlatState], FlatState], parameters: list[Number]
    ) -> None:
        self.tableau, self._rate, self._parameters = tableau, rate, parameters

    @abc.abstractmethod
    def errors(self, transposed: Callable[[np.ndarray], FlatState], of_states: dict[int, FlatState]) -> FlatState:
        """What cotangents err by, of the stages' or of other weights."""

    def most(self, rtol: Scalar) -> Scalar:
        """See `Reverse`."""
        return (_LOST * rtol) ** (1 / self.power)

    def flow(self, flat_state: FlatState, before: Callable[[], "Entry"]) -> FlatState:
        """See `Reverse`."""
        return self._rate(self._parameters, flat_state)

    def step(self, row: "Entry") -> BackStep:
        """See `Reverse`."""
        h, slopes, pulls = row.length, [[] for _ in row.state], []
        for i in range(self.stages):
            flat_state = [
                u + h * weighted(self.tableau.a[i - 1], ks) if i else u for u, ks in zip(row.state, slopes, strict=True)
            ]
            rates, pull = jax.vjp(self._rate, self._parameters, flat_state)
            pulls.append(pull)
            for ks, k in zip(slopes, rates, strict=True):
                ks.append(k)

        def of_all(b: np.ndarray, after: FlatState) -> tuple[FlatState, list[Number], dict[int, FlatState]]:
            total, gained, (_, of_states) = transposed(
                self._parameters,
                b,
                self.tableau.a,
                after,
                pulls,
                lambda _, cotangents, __: [h * cotangent for cotangent in cotangents],
            )
            return total, gained, of_states

        def back(after: FlatState) -> tuple[FlatState, list[Number], FlatState]:
            total, gained, of_states = of_all(self.tableau.b, after)
            return plus(after, total), gained, self.errors(lambda b: of_all(b, after)[0], of_states)

        end: FlatState = [u + h * weighted(self.tableau.b, ks) for u, ks in zip(row.state, slopes, strict=True)]
        return BackStep(end, [ks[0] for ks in slopes], back)
