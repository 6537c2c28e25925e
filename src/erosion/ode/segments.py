"""One segment of a motion: the loop of trial steps from a state to the first event."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, Number, Scalar
from erosion.ode import arming, step_control
from erosion.ode.cubics import Ends
from erosion.ode.event_location import Lane, Segment, all_finite, finish_step
from erosion.ode.guards import Guard, guards_of
from erosion.ode.horizon import Horizon, To
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.lost_tangents import LostTangents
from erosion.ode.motion import Augmented
from erosion.ode.recorders import Recorder, recorders_of
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import FIRST_STEP, MOMENT, ULPS
from erosion.ode.variational import EndTimeDependence

_SHARE = 1e-3  # of a rate, or of its jump: by more a rate jumps at the start, and by less it goes on after that

Written = list[Any]  # by each recorder, so far


class SegmentLoop:
    """The loop of steps, for every motion of a lane.

    Args:
        problem: the equations.
        rtol: relative tolerance.
        rows: of the tape, where steps are recorded or events logged.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar, rows: Scalar) -> None:
        self.problem, self.rtol, self.method = problem, rtol, problem.method
        self.scheduled = problem.signature.problem.scheduled()
        self.guards: list[Guard] = guards_of(problem, rtol)
        self.recorders: list[Recorder] = recorders_of(problem, rtol, rows)
        self.event_set = problem.event_set

    def to_its_event(
        self,
        initial: FlatState,
        time_to_end: Scalar | None,
        written: Written,
        before: Segment | None,
        elapsed: tuple[Scalar, ...],
    ) -> tuple[Segment, EndTimeDependence, Written]:
        """Integrate from a state to the first event; with how it and what is wanted there depend on the event's time.

        Args:
            initial: the state with derivatives.
            time_to_end: stop after this time.
            written: by the recorders so far.
            before: the motion before it in a chain.
            elapsed: the time since the chain began, with derivatives.
        """
        end = Horizon() if time_to_end is None else To(time_to_end, self.problem.clock.max_step)
        lost = LostTangents(self.problem, initial) if before is not None and self.problem.order else None
        initial = initial if lost is None else lost.start
        recorders = [recorder.of_motion(elapsed, lost) for recorder in self.recorders]

        def tries(at: tuple[Lane, Written]) -> tuple[Lane, Written]:
            lane, written = at
            after = self._try_step(end, lane)
            return after, [one.after_step(so_far, lane, after) for one, so_far in zip(recorders, written, strict=True)]

        start = self._start(initial, end, before), written
        lane, written = lax.while_loop(lambda at: step_control.goes_on(at[0].control), tries, start)
        motion, along = finish_step(self.problem, lane, time_to_end)
        if lost is not None:
            motion, along = lost.at_end(motion, along)
        written = [one.after_last_step(so_far, lane, motion) for one, so_far in zip(recorders, written, strict=True)]
        return motion, along, written

    def past_at_start(self, rows: FlatState) -> list[Flag]:
        """Of each event whether its function is past zero where a lane begins, or at zero and does not leave it."""
        slope, events = _at_start(self.problem, rows, self.problem.time_scale)
        scale = self.problem.scale_at_start(rows, slope)
        events = self.event_set.at_start(events, scale, jnp.asarray(True))
        return [jnp.logical_not(each.armed) for each in self.event_set.watch(events, scale)]

    def after_segment(self, written: Written, segment: Segment) -> Written:
        """What the recorders have written with the end of a segment, before any reset."""
        pairs = zip(self.recorders, written, strict=True)
        return [recorder.after_segment(so_far, segment) for recorder, so_far in pairs]

    def after_event(
        self, written: Written, event: Scalar, fires: Flag, at_once: Sequence[Flag], at: tuple[Augmented, ...],
        elapsed: tuple[Scalar, ...],
    ) -> Written:  # fmt: skip
        """What they have written with an event, if it fires: the state there before its reset, and the time."""
        pairs = zip(self.recorders, written, strict=True)
        return [one.of_motion(elapsed).after_event(so_far, event, fires, at_once, at) for one, so_far in pairs]

    def after_event_at_once(self, written: Written, fires: Flag) -> Written:
        """What they have written with an event without a segment of its own, if it fires at another one's time."""
        pairs = zip(self.recorders, written, strict=True)
        return [recorder.after_event_at_once(so_far, fires) for recorder, so_far in pairs]

    def recorded(self, written: Written) -> Mapping[str, Any]:
        """What they leave of the lane's results."""
        results: dict[str, Any] = {}
        for recorder, so_far in zip(self.recorders, written, strict=True):
            results |= recorder.results(so_far)
        return results

    def _start(self, initial: FlatState, end: Horizon, before: Segment | None) -> Lane:
        problem, method = self.problem, self.method
        slope, events = _at_start(problem, initial, problem.time_scale)
        scale = problem.scale_at_start(initial, slope)
        # 0·NaN and 0·∞ are NaN: this finds them also in parameters that the motion does not depend on.
        zero = sum(jnp.sum(0.0 * number) for number in _own(problem))
        zero = zero + sum(0.0 * row for row in (*initial, *slope)) + 0.0 * scale
        for event in events:
            zero = zero + 0.0 * event.value + 0.0 * event.rate
        events = self.event_set.at_start(events, scale, jnp.asarray(True) if before is None else before.event < 0)
        begins = self.event_set.begins(events, scale) if problem.options.check_start else jnp.asarray(True)
        if before is not None:
            begins = begins | (before.event >= 0)
        control = step_control.begin(scale, begins, jnp.isfinite(zero), FIRST_STEP)
        events = self.event_set.begun(events)
        if before is not None:
            # The functions of events that have just happened are zero, but for rounding.
            for i, near in enumerate(zip(before.at_once, before.still_zero, strict=True)):
                if i not in self.scheduled:  # these know their next time
                    events[i] = arming.after_event(events[i], *near, scale)
            past, trial = before.control, jnp.minimum(control.trial_length, before.control.step)
            control = control._replace(
                trial_length=trial,
                step=trial,
                trials=past.trials,
                rejected=past.rejected,
                closest_approach=past.closest_approach,
            )
        events = self.event_set.in_modes(events)
        first = method.first_step(initial, slope, scale, control.trial_length)
        control = control._replace(trial_length=first, step=first)
        memories = tuple(guard.begin(scale) for guard in self.guards)
        watched, greatest = self.event_set.watch(events, scale), method.sizes_at_start(initial, before)
        return Lane(end.within(control), events, initial, slope, watched, greatest, memories)

    def _try_step(self, end: Horizon, lane: Lane) -> Lane:
        """Try one step, and decide what follows."""
        problem, method, before = self.problem, self.method, lane.control
        guarded = list(zip(self.guards, lane.memories, strict=True))
        lane = lane._replace(slope=problem.without_rest(lane.slope))
        scale = problem.scale_near(before.step, FIRST_STEP)
        step = method.tried(lane, scale, self.rtol)
        # Events may be NaN where the motion is not: 0·NaN is NaN, and an error too.
        step = step._replace(error=sum((0.0 * part for event in step.events for part in event), step.error))
        step = self.event_set.resolved(lane.events, step, before.trial_length)
        watched = self.event_set.watch(lane.events, scale)
        control, moved = self.event_set.decide(
            watched, before, lane.events, step, scale, self.rtol, problem.limits, method.ending,
            lambda: end.reach(before),
        )  # fmt: skip
        memories = []
        for guard, memory in guarded:
            memory, step, control = guard.decided(memory, lane, step, moved, control, end)
            memories.append(memory)
        control, moved = method.arrives(before, end.within(control), moved)
        greatest = method.sizes(lane.greatest, step.state)
        after = step.events, step.state, step.slope, watched, greatest, tuple(memories)
        kept = jax.tree.map(lambda new, old: jnp.where(moved, new, old), after, tuple(lane[1:]))
        return Lane(control, *kept)


def _own(problem: LaneEquations) -> list[Number]:
    """The numbers that must be finite: those of the arguments, and of the clock t0, and t1 if it is not ∞."""
    t0, t1, *_ = problem.clock
    return [*problem.parameters[: problem.signature.arguments], t0, jnp.where(t1 == jnp.inf, t0, t1)]


def _at_start(problem: LaneEquations, initial: FlatState, scale: Scalar) -> tuple[FlatState, list[Ends]]:
    """Rate and events at the start; where one is 0·∞ by a √0, or a rate jumps there, those just after it."""
    slope, events = problem.rate_and_events(initial)
    if not problem.nonsmooth and problem.event_set.are_smooth:
        return slope, events
    known = [jnp.where(jnp.isfinite(k), k, 0.0) for k in slope]
    moment = jnp.maximum(MOMENT * scale, ULPS * jnp.abs(problem.clock.t0))

    def after(moments: float) -> FlatState:
        changes = [(moment * k, ULPS * jnp.abs(u) * jnp.sign(k)) for u, k in zip(initial, known, strict=True)]
        pairs = zip(initial, changes, strict=True)
        return [u + moments * jnp.where(jnp.abs(d) > jnp.abs(least), d, least) for u, (d, least) in pairs]

    # What a rate that is no root, but jumps, does once it does hardly again in a time that is longer.
    jumps: Flag = jnp.asarray(False)
    rates, later = (problem.motion_rate(after(moments)[: problem.width]) for moments in (1.0, 3.0))
    for now, soon, then in zip(known, rates, later, strict=False):
        jump = jnp.abs(soon - now)
        jumps = jumps | ((jump > _SHARE * jnp.abs(now)) & (jnp.abs(then - soon) < _SHARE * jump))

    def limit() -> tuple[FlatState, list[Ends]]:
        rates, ends = problem.rate_and_events(after(1.0))
        return rates, [Ends(event.value, end.rate) for event, end in zip(events, ends, strict=True)]

    defined = all_finite([*slope, *(event.rate for event in events)])
    return lax.cond(defined & ~jumps, lambda: (slope, events), limit)
