"""Recorders of a lane's motion; see `erosion.ode.tape`. A recorder holds all motions of a lane."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.lanes import tapes
from erosion.ode.event_location import Lane, Segment, has_no_derivatives
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.lost_tangents import LostTangents
from erosion.ode.motion import Augmented, outputs_of
from erosion.ode.step_control import ARRIVED
from erosion.ode.tape import ROUNDING, STATES, TIMES, EventLog, Recorded, Saved, Tape
from erosion.ode.variational import Derivatives, EndTimeDependence, at_event


class Recorder(abc.ABC):
    """Writes a lane's results to its tapes, after each step, motion and segment."""

    @abc.abstractmethod
    def begin(self) -> Any:
        """Nothing is written yet."""

    def of_motion(self, elapsed: tuple[Scalar, ...], lost: LostTangents | None = None) -> "Recorder":
        """That for a motion which begins or ends so much later than the lane begins, with derivatives.

        Args:
            elapsed: so much later.
            lost: the lost tangents of the motion.
        """
        return self

    def after_step(self, written: Any, before: Lane, after: Lane) -> Any:
        """With a trial."""
        return written

    def after_last_step(self, written: Any, lane: Lane, motion: Segment) -> Any:
        """With the end of a motion."""
        return written

    def after_segment(self, written: Any, segment: Segment) -> Any:
        """With the end of a segment, before any reset."""
        return written

    def after_event(
        self, written: Any, event: Scalar, fires: Flag, at_once: Sequence[Flag], at: tuple[Augmented, ...]
    ) -> Any:
        """With an event, if it fires, those that happen at once and the state before its reset."""
        return written

    def after_event_at_once(self, written: Any, fires: Flag) -> Any:
        """With an event that has no segment of its own, if it fires at the time of another one."""
        return written

    @abc.abstractmethod
    def results(self, written: Any) -> Mapping[str, Any]:
        """What is left of it in `LaneEnd`."""


class Steps(Recorder):
    """Each step and event, for reverse mode.

    Args:
        problem: the equations.
        rtol: relative tolerance.
        rows: of the tape.
        elapsed: the time at which the motion begins.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar, rows: Scalar, elapsed: tuple[Scalar, ...] = ()) -> None:
        self.problem, self.rtol, self.rows, self.elapsed = problem, rtol, rows, elapsed

    def begin(self) -> Tape:
        """See `Recorder`."""
        rows = lax.convert_element_type(self.rows, int)
        return Tape(jnp.zeros((), int), rows, 0.0 * self.rtol, jnp.asarray(True), jnp.zeros(()))

    def of_motion(self, elapsed: tuple[Scalar, ...], lost: LostTangents | None = None) -> "Steps":
        """See `Recorder`."""
        return Steps(self.problem, self.rtol, self.rows, elapsed)

    def after_step(self, written: Tape, before: Lane, after: Lane) -> Tape:
        """See `Recorder`."""
        now, then = before.control.time, after.control.time
        return written.with_step(then - now, before.state, then != now)

    def after_last_step(self, written: Tape, lane: Lane, motion: Segment) -> Tape:
        """See `Recorder`."""
        written = written.with_step(motion.time - lane.control.time, lane.state, jnp.asarray(True))
        # Several events at one time are gone through forwards.
        has = written.has_derivatives & ~has_no_derivatives(self.problem, motion) & ~motion.several
        return written._replace(has_derivatives=has, elapsed=sum(self.elapsed[:1], motion.time))  # pyrefly: ignore

    def after_segment(self, written: Tape, segment: Segment) -> Tape:
        """See `Recorder`."""
        return written.with_event(segment.event, jax.tree.leaves(segment.value_and_tangents))

    def after_event_at_once(self, written: Tape, fires: Flag) -> Tape:
        """See `Recorder`."""
        return written._replace(has_derivatives=written.has_derivatives & ~fires)  # pyrefly: ignore

    def results(self, written: Tape) -> Mapping[str, Any]:
        """See `Recorder`."""
        return {"recorded": Recorded(jnp.where(written.has_derivatives, written.rows, 0), written.token)}


class SaveAt(Recorder):
    """States at many times.

    Args:
        problem: the equations; of a stiff motion without second derivatives.
        rtol: relative tolerance.
        elapsed: of a chain, the time since the lane began, with its tangents.
        lost: the lost tangents of a motion.
    """

    def __init__(
        self, problem: LaneEquations, rtol: Scalar, elapsed: tuple[Scalar, ...] = (), lost: LostTangents | None = None
    ) -> None:
        self.problem, self.rtol, self.lost = problem, rtol, lost
        self.elapsed = problem.equations.unpack(elapsed) if elapsed else None

    def begin(self) -> Saved:
        """See `Recorder`."""
        return Saved(jnp.zeros((), int), 0.0 * self.rtol)

    def of_motion(self, elapsed: tuple[Scalar, ...], lost: LostTangents | None = None) -> "SaveAt":
        """See `Recorder`."""
        return SaveAt(self.problem, self.rtol, elapsed, lost)

    def after_step(self, written: Saved, before: Lane, after: Lane) -> Saved:
        """With the states at the times up to the end of a trial, if the lane moved there."""
        end = after.control.time
        due = (end > before.control.time) & (self._time(written.following) <= end)
        return lax.cond(
            due,
            lambda: self._written(written, end, self.problem.method.interpolate(before, after, self.rtol)),
            lambda: written,
        )

    def after_last_step(self, written: Saved, lane: Lane, motion: Segment) -> Saved:
        """With those up to the end of the motion, which may lie before or after that of the last step."""
        end, problem = motion.time, self.problem
        if problem.chains:
            # Another motion begins there, and writes what is later.
            following = lax.while_loop(
                lambda k: (k > 0) & (self._time(jnp.maximum(k - 1, 0)) > end), lambda k: k - 1, written.following
            )
            written = written._replace(following=following)
        so_far = jnp.abs(problem.clock.t0) + end + (0.0 if self.elapsed is None else self.elapsed.value)
        return self._written(written, end + ROUNDING * so_far, problem.method.beyond(lane, motion))

    def results(self, written: Saved) -> Mapping[str, Any]:
        """See `Recorder`."""
        return {"saved": written.token}

    def _time(self, index: Scalar) -> Scalar:
        """A time, since the motion began."""
        time = tapes.read(TIMES, np.zeros(()), index) - self.problem.clock.t0
        return time if self.elapsed is None else time - self.elapsed.value

    def _written(self, saved: Saved, t_stop: Scalar, at: Callable[[Scalar], EndTimeDependence]) -> Saved:
        def writes(saved: Saved) -> Saved:
            along = at(self._time(saved.following))
            numbers = self._numbers(along if self.lost is None else self.lost.later(along))
            token = tapes.write(STATES, saved.token, saved.following * len(numbers), *numbers)
            return Saved(saved.following + 1, token)

        return lax.while_loop(lambda saved: self._time(saved.following) <= t_stop, writes, saved)

    def _numbers(self, along: EndTimeDependence) -> list[Scalar]:
        """What is wanted of a state, and its derivatives at a fixed time, of a motion that began at any."""
        problem, equations = self.problem, self.problem.equations
        if problem.order == 0:
            return along.here(outputs_of).value
        began = equations.of(lambda _, motion: motion.clock.t0, ())
        if self.elapsed is not None:
            began = jax.tree.map(jnp.add, began, self.elapsed)
        since = jax.tree.map(lambda number: -1.0 * number, began)
        outputs = at_event(along, jnp.full((), ARRIVED), 0.0 * problem.time_scale, outputs_of, since).outputs
        return jax.tree.leaves(equations.pack(equations.unscale(outputs)))


class Events(Recorder):
    """Each event that happens: its index, those that happen at once, its time, and the outputs before its own reset.

    Args:
        problem: the equations.
        rtol: relative tolerance.
        rows: of the tape.
        elapsed: the time of the event, with derivatives.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar, rows: Scalar, elapsed: tuple[Scalar, ...] = ()) -> None:
        self.problem, self.rtol, self.rows, self.elapsed = problem, rtol, rows, elapsed

    def begin(self) -> EventLog:
        """See `Recorder`."""
        return EventLog(jnp.zeros((), int), lax.convert_element_type(self.rows, int), 0.0 * self.rtol)

    def of_motion(self, elapsed: tuple[Scalar, ...], lost: LostTangents | None = None) -> "Events":
        """See `Recorder`."""
        return Events(self.problem, self.rtol, self.rows, elapsed)

    def after_event(
        self, written: EventLog, event: Scalar, fires: Flag, at_once: Sequence[Flag], at: tuple[Augmented, ...]
    ) -> EventLog:
        """See `Recorder`."""
        equations, happening = self.problem.equations, at_once[: self.problem.own_events]
        pairs = zip(equations.unpack(self.elapsed), equations.of(outputs_of, at), strict=True)
        there = Derivatives(*(None if outputs is None else [time, *outputs] for time, outputs in pairs))
        numbers = []
        for i, part in enumerate(equations.pack(equations.unscale(there))):
            codes = [lax.convert_element_type(number, float) for number in (event, *happening)]
            numbers += [*(jnp.zeros(()) + (0.0 if i else code) for code in codes), *part]
        return written.with_event(fires, numbers)

    def results(self, written: EventLog) -> Mapping[str, Any]:
        """See `Recorder`."""
        return {"saved": written.token}


def recorders_of(problem: LaneEquations, rtol: Scalar, rows: Scalar) -> list[Recorder]:
    """Those that a program asks for."""
    recorders: list[Recorder] = []
    if problem.options.records:
        recorders.append(Steps(problem, rtol, rows))
    if problem.options.saves:
        recorders.append(SaveAt(problem, rtol))
    if problem.options.logs:
        recorders.append(Events(problem, rtol, rows))
    return recorders
