"""Rosenbrock methods for stiff motions: the first step, the error, and the end.

An explicit step may be as short as one likes. A step that is to damp what is stiff may not: so the last one begins
where the one before it ended and reaches the event, with the length that Newton's method finds. At the event the rates
of stiff rows are known badly, as an error of the state counts there times an eigenvalue. So nothing is differentiated
along the flow there, but by the length of the last step.
"""

import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.crossings import ByTheLastStep
from erosion.ode.cubics import Ends
from erosion.ode.event_location import Lane, Segment, happening, segment_to
from erosion.ode.methods.base import (
    APART,
    LEAST,
    NOISE,
    TIGHTEST,
    BackStep,
    Method,
    Reverse,
    Step,
    leaves_rest,
)
from erosion.ode.methods.rosenbrock_steps import RosenbrockSteps, RosenbrockTableau, Stages
from erosion.ode.methods.sums import weighted
from erosion.ode.methods.transposes import plus, transposed, zeros
from erosion.ode.motion import Augmented, OfMotion
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import ENDED, FIRST_STEP, NOT_BEGUN, TINY, ULPS, Control
from erosion.ode.variational import Derivatives, EndTimeDependence

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations
    from erosion.ode.tape import Entry

_FIRST = 0.1  # of the time in which a number of the state changes by its own size, alone or by its own feedback
_SOONEST = 1e-9  # of the time scale: the shortest first step
_SMALL = 1e-100  # keeps a square above 0
NEAR = 0.1  # of the last step: Newton's method moves its end by less
_SHORTEST = 1e-14  # of the time scale: the last step of a lane that takes none
BLURRED = 1e-2  # of itself, at the tightest tolerance: a time that errs by more is not known
_EIGHTH = 8.0  # the order of which the step control takes the root


class _LastStepSearch(NamedTuple):
    """The last step of a stiff motion on its way to the event.

    Args:
        rounds: of Newton's method so far.
        length: of the step.
        event, remaining: which event is first, and how much longer the step must be, where `events` were looked at.
        events: event functions after the step, turned so that they fall to their events.
        step: rows after the step, and their derivatives by its length.
    """

    rounds: Scalar
    length: Scalar
    event: Scalar
    remaining: Scalar
    events: list[Ends]
    step: tuple[FlatState, FlatState]


class LastStep(EndTimeDependence):
    """The end of a lane as a function of the length of its last step.

    Args:
        method: with the equations.
        flat_state: at the end, with derivatives at a fixed time.
        rates: their derivatives by the step's length.
        greatest: the greatest size so far of each of these rows.
    """

    def __init__(self, method: "Rosenbrock", flat_state: FlatState, rates: FlatState, greatest: FlatState) -> None:
        super().__init__(method.problem.equations)
        self.method, self.problem, self.flat_state, self.rates, self.greatest = (
            method,
            method.problem,
            flat_state,
            rates,
            greatest,
        )

    @property
    def events(self) -> list[Ends]:
        """The event functions, and their derivatives by the step's length."""
        width = self.problem.width
        values, rates = jax.jvp(self.problem.events, (self.flat_state[:width],), (self.rates[:width],))
        return [Ends(*pair) for pair in zip(values, rates, strict=True)]

    def here(self, function: OfMotion) -> Derivatives:
        """See `EndTimeDependence`."""
        return self.equations.of(function, self.problem.value_and_tangents(self.flat_state))

    def rate(self, function: OfMotion) -> Derivatives:
        """See `EndTimeDependence`."""

        def of(flat_state: FlatState) -> Derivatives:
            return self.equations.of(function, self.problem.value_and_tangents(flat_state))

        return jax.jvp(of, (self.flat_state,), (self.rates,))[1]

    def lacking(self, lost: tuple[Augmented, ...]) -> "LastStep":
        """See `EndTimeDependence`."""
        state: FlatState = list(map(jnp.add, self.flat_state, jax.tree.leaves(lost)))
        return LastStep(self.method, state, self.rates, self.greatest)

    def amplification(self, event: OfMotion, rate: Scalar, time: Scalar) -> Scalar:
        """By how much more the event's time errs, relative to itself, than the state."""
        width, here = self.problem.width, self.equations.at(self.equations.parameters)
        flat_state, least = self.flat_state[:width], self.method.least_sizes(self.greatest)

        def value(flat_state: FlatState) -> Scalar:
            (at,) = self.problem.value_and_tangents(flat_state)
            return event(at, here)

        error: Scalar = 0.0 * time
        for i, row in enumerate(flat_state):
            slope = jax.jvp(lambda x, i=i: value([*flat_state[:i], x, *flat_state[i + 1 :]]), (row,), (jnp.ones(()),))[
                1
            ]
            error = error + jnp.abs(slope) * jnp.maximum(jnp.abs(row), least[i])
        return jnp.maximum(1.0, jnp.where(rate * time == 0, 1.0, error / jnp.abs(rate * time)))


class Rosenbrock(Method):
    """Any Rosenbrock method.

    Args:
        tableau: its weights.
    """

    # Where a motion is fast its second derivatives at a fixed time are huge, and those at an event their small
    # difference.
    derivatives = 1
    tableau: ClassVar[RosenbrockTableau]
    foresees = False
    ending = ByTheLastStep()

    def __init__(self, problem: "LaneEquations") -> None:
        if problem.nonsmooth:
            raise ValueError(
                'The method "rosenbrock" needs rates without kinks, but these may have some (roots, powers, loops): '
                'use the method "explicit", or say `smooth=True` where there are none.'
            )
        super().__init__(problem)
        self.steps = RosenbrockSteps(problem, self.tableau)

    def sizes_at_start(self, initial: FlatState, before: Segment | None) -> FlatState:
        """See `Method`: what a chain has had counts in all of it."""
        return self.sizes([0.0 * row for row in initial] if before is None else before.greatest, initial)

    def tried(self, lane: Lane, scale: Scalar, rtol: Scalar) -> Step:
        """See `Method`."""
        h, before = lane.control.trial_length, lane.state
        state, found = self.steps.step(before, lane.slope, h)
        slope, events = self.problem.rate_and_events(state)
        apart = jnp.maximum(APART, NOISE / rtol) if self.problem.signature.problem.parameter_scale is None else 1.0
        error = self.error_of(lane.greatest, apart, (before, state), (lane.slope, slope), found, h, rtol)
        return Step(state, slope, found, events, self.steps.interior_samples(before, state, found), error)

    def arrives(self, before: Control, after: Control, moved: Flag) -> tuple[Control, Flag]:
        """See `Method`: the step that arrives is the last one, which a lane ends with."""
        last = moved & (after.mode == ENDED)
        after = after._replace(
            time=jnp.where(last, before.time, after.time),
            time_to_event=jnp.where(last, before.trial_length, after.time_to_event),
        )
        return after, moved & jnp.logical_not(last)

    def is_known(self, ended: Flag, amplification: Scalar) -> Flag:
        """See `Method`."""
        return ended & (amplification < BLURRED / TIGHTEST)

    def interpolate(self, before: Lane, after: Lane, rtol: Scalar) -> Callable[[Scalar], EndTimeDependence]:
        """See `Method`: no polynomial is as exact as a step."""
        return functools.partial(self._by_a_step, before)

    def beyond(self, lane: Lane, motion: Segment) -> Callable[[Scalar], EndTimeDependence]:
        """See `Method`."""
        return lambda time: self._by_a_step(lane, jnp.minimum(time, motion.time))

    def _by_a_step(self, before: Lane, time: Scalar) -> EndTimeDependence:
        return self.step_of(before.state, before.slope, before.greatest, time - before.control.time)

    def reverse(
        self, rate: Callable[[list[Number], FlatState], FlatState], parameters: list[Number], every: Any
    ) -> "_Reverse":
        """See `Method`."""
        return _Reverse(self, rate, parameters, every)

    def first_step(self, initial: FlatState, slope: FlatState, scale: Scalar, asked: Scalar) -> Scalar:
        """A length in which little happens, but for numbers that are almost zero."""
        motion = zip(initial[: self.problem.width], slope, strict=False)
        times = [jnp.where(u == 0, jnp.inf, jnp.abs(u) / (jnp.abs(k) + TINY)) for u, k in motion]
        own = zip(self.steps.sparse.places, self.steps.entries(initial), strict=True)
        times += [1.0 / (jnp.abs(entry) + TINY) for (i, j), entry in own if i == j]
        return jnp.minimum(
            asked, jnp.maximum(_FIRST * functools.reduce(jnp.minimum, times, jnp.asarray(jnp.inf)), _SOONEST * scale)
        )

    def least_sizes(self, greatest: FlatState) -> list[Scalar]:
        """Sizes of the rows of the motion itself below which these need not be known: as given, or by the greatest."""
        given = self.problem.options.state_scale is not None
        return [np.float64(least) if given and least > TINY else jnp.maximum(LEAST * size, TINY)
                for least, size in zip(self.problem.sizes, greatest, strict=True)]  # fmt: skip

    def error_of(
        self,
        greatest: FlatState,
        apart: Scalar,
        states: tuple[FlatState, FlatState],
        slopes: tuple[FlatState, FlatState],
        stages: Stages,
        h: Scalar,
        rtol: Scalar,
    ) -> Scalar:
        """The largest error of a row relative to its size, over the tolerance, as the step control wants it.

        A row need not be known better than relative to its greatest size so far, nor than rounding of the terms of
        its rate allows. The size of a derivative's row is at least that of the row which it differentiates.

        Args:
            greatest: the greatest size so far of each row of the motion itself.
            apart: the least size of a derivative's row, of the size of that which it differentiates.
            states: before and after the step.
            slopes: there.
            stages: of the step.
            h: its length.
            rtol: the tolerance.
        """
        before, after = states
        width, places = self.problem.width, self.steps.sparse.places
        terms: list[Scalar] = [0.0 * h for _ in range(width)]
        damped = [h for _ in range(width)]
        for (i, j), entry in zip(places, stages.entries, strict=True):
            terms[i] = terms[i] + jnp.abs(entry * after[j])
            if i == j:
                damped[i] = 1.0 / (1.0 / h + jnp.abs(entry))
        rounding = [ULPS / rtol * term * time for term, time in zip(terms, damped, strict=True)]
        sizes: list[Scalar] = list(map(jnp.maximum, self.least_sizes(greatest), rounding))
        error, of_motion = 0.0 * h, sizes
        for first in range(0, len(after), width):
            if first:
                sizes = [apart * size for size in of_motion]
            for i in range(width):
                row = first + i
                sizes[i] = jnp.maximum(jnp.maximum(jnp.abs(before[row]), jnp.abs(after[row])), sizes[i])
                ends = (before[row], after[row]), (slopes[0][row], slopes[1][row])
                size = jnp.where(leaves_rest(*ends, h, self.problem.time_scale), jnp.inf, sizes[i])
                error = jnp.maximum(error, jnp.abs(weighted(self.tableau.error, stages.increments[row])) / size)
            of_motion = of_motion if first else list(sizes)
        error = jnp.where(stages.sound, error / rtol, jnp.inf)
        return jnp.exp(_EIGHTH / self.tableau.order * jnp.log(error + 1e-30))

    def last_step(self, state: FlatState, slope: FlatState, greatest: FlatState, h: Scalar) -> LastStep:
        """The step of a length, with its derivatives by that."""
        at, rates = jax.jvp(lambda h: self.steps.step(state, slope, h)[0], (h,), (jnp.ones(()),))
        return LastStep(self, at, rates, greatest)

    def step_of(self, state: FlatState, slope: FlatState, greatest: FlatState, passed: Scalar) -> LastStep:
        """The state a time after a step began, 0 or later."""
        passed = jnp.where(passed > _SMALL * self.problem.time_scale, passed, 0.0)
        step = self.last_step(state, slope, greatest, length_of(passed, self.problem.time_scale))
        flat_state: FlatState = [
            jnp.where(passed > 0, new, old) for new, old in zip(step.flat_state, state, strict=True)
        ]
        return LastStep(self, flat_state, step.rates, greatest)

    def finish_step(self, lane: Lane, time_to_end: Scalar | None) -> tuple[Segment, EndTimeDependence]:
        """The same by the method for stiff motions: the length of the last step is what Newton's method finds.

        The step is written once, in a loop: it is most of a program for many unknowns.
        """
        control, event_set = lane.control, self.problem.event_set
        scale = self.problem.scale_near(control.step, FIRST_STEP)
        watched = event_set.watch(lane.events, scale)
        ended = (control.mode == ENDED) & (control.event != NOT_BEGUN)

        def nearer(search: _LastStepSearch) -> _LastStepSearch:
            along = self.last_step(lane.state, lane.slope, lane.greatest, search.length)
            events = event_set.counting(watched, along.events, control.event)
            more = sum(
                (jnp.where(control.event == i, -each.value / each.rate, 0.0) for i, each in enumerate(events)),
                jnp.zeros(()),
            )
            near = ended & (jnp.abs(more) < NEAR * search.length)
            event, remaining = event_set.first_at_end(control, events, scale, time_to_end)
            found = event, jnp.where(ended, remaining, 0.0), events
            # The first round finds the place of the event that was seen, the second which is the first there.
            looks = search.rounds == 1
            event, remaining, events = jax.tree.map(
                functools.partial(jnp.where, looks), found, (search.event, search.remaining, search.events)
            )
            moves = jnp.where(search.rounds == 0, jnp.where(near, more, 0.0), jnp.where(looks, remaining, 0.0))
            return _LastStepSearch(
                search.rounds + 1, search.length + moves, event, remaining, events, (along.flat_state, along.rates)
            )

        length = length_of(control.time_to_event, scale)
        nothing = [0.0 * row for row in lane.state]
        search = _LastStepSearch(0 * control.mode, length, control.event, 0.0 * length, lane.events, (nothing, nothing))
        search = lax.while_loop(lambda search: search.rounds < 3, nearer, search)
        stepped = control.time_to_event > 0
        flat_state, rates = search.step
        flat_state: FlatState = [jnp.where(stepped, new, old) for new, old in zip(flat_state, lane.state, strict=True)]
        along = LastStep(self, flat_state, rates, lane.greatest)
        at_once = happening(self.problem, ended, search.event, search.remaining, search.events, scale)
        time = control.time + jnp.where(stepped, search.length, 0.0)
        value_and_tangents = self.problem.value_and_tangents(flat_state)
        return segment_to(lane, value_and_tangents, search.event, time, at_once, time_to_end, scale), along


def length_of(time_to_event: Scalar, scale: Scalar) -> Scalar:
    """The length of the last step; a lane that takes none may take its derivatives by a very short one."""
    return jnp.where(time_to_event > 0, time_to_event, _SHORTEST * scale)


_LOST, _LOST_AT_MOST = 1e6, 0.01  # an estimate of 4th order is far greater than the error, and counts effects alone


class _Reverse(Reverse):
    share = 1.0

    def __init__(
        self,
        method: Rosenbrock,
        rate: Callable[[list[Number], FlatState], FlatState],
        parameters: list[Number],
        every: Any,
    ) -> None:
        self._method, self._rate, self._parameters, steps = method, rate, parameters, method.steps
        self._entries = jax.jit(lambda parameters, flat_state: steps.entries(flat_state, every(parameters)))
        self._solve, self._solve_transposed = jax.jit(steps.sparse.solve), jax.jit(steps.sparse.solve_transposed)

    def most(self, rtol: Scalar) -> Scalar:
        """See `Reverse`."""
        return jnp.minimum(_LOST * rtol, _LOST_AT_MOST)

    def flow(self, flat_state: FlatState, before: Callable[[], "Entry"]) -> FlatState:
        """See `Reverse`."""
        last = before()
        h = length_of(last.length, self._method.problem.time_scale)
        return self._method.last_step(last.state, self._rate(self._parameters, last.state), [], h).rates

    def step(self, row: "Entry") -> BackStep:
        """The same by the Rosenbrock method; a motion that ends where it began takes no step."""
        steps, tableau, takes = self._method.steps, self._method.tableau, row.length > 0
        inverse = 1.0 / length_of(row.length, self._method.problem.time_scale)
        entries, pull_entries = jax.vjp(self._entries, self._parameters, row.state)
        factors = steps.factors(entries, inverse * (1 / tableau.gamma))
        slope: FlatState = []
        increments, pulls = [], []
        for a, c in zip(((), *tableau.a), ((), *tableau.c), strict=True):
            so_far = list(zip(*increments, strict=True)) or [()] * self._method.problem.width
            flat_state = [u + weighted(a, us) if a else u for u, us in zip(row.state, so_far, strict=True)]
            right, pull = jax.vjp(self._rate, self._parameters, flat_state)
            slope = slope or right
            if c:
                right = [r + inverse * weighted(c, us) for r, us in zip(right, so_far, strict=True)]
            increments.append(self._solve(factors, right))
            pulls.append(pull)
        count = len(increments)

        def of_right(i: int, cotangents: FlatState, of_rights: dict[int, FlatState]) -> FlatState:
            later = range(i + 1, count)
            others = [tableau.c[j - 1][i] for j in later]
            if others:
                rights = ([of_rights[j][r] for j in later] for r in range(self._method.problem.width))
                cotangents = [
                    cotangent + inverse * weighted(others, each)
                    for cotangent, each in zip(cotangents, rights, strict=True)
                ]
            return self._solve_transposed(factors, cotangents)

        def of_all(b: Sequence[float], after: FlatState) -> tuple[FlatState, list[Number]]:
            total, gained, (of_rights, _) = transposed(self._parameters, b, tableau.a, after, pulls, of_right)
            of_entries = [
                sum((of_rights[k][i] * increments[k][j] for k in range(count)), jnp.zeros(()))
                for i, j in steps.sparse.places
            ]
            grads, of_state = pull_entries(of_entries)
            return plus(total, of_state), plus(gained, grads)

        def back(after: FlatState) -> tuple[FlatState, list[Number], FlatState]:
            moved, gained = of_all(tableau.b, after)
            # What is damped within the step is no error of what comes before: W^-T d takes it away.
            errors = self._solve_transposed(factors, of_all(tableau.error, after)[0])
            results = plus(after, moved), gained, [inverse * (1 / tableau.gamma) * e for e in errors]
            nothing = list(after), zeros(gained), zeros(after)
            return jax.tree.map(functools.partial(jnp.where, takes), results, nothing)

        return BackStep([], slope, back)
