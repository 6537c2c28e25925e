"""What a lane writes on its way: each of its steps and events, or its states at many times.

Of steps each row holds a length and a code, and then the state. A row of a step has the code `STEP`. After the steps
of a motion comes a row with the time since the lane began, the code of what ended it and the state there, before any
reset. A lane in which several events happen at one time is gone through forwards.

For states, a step that has a time within it takes one more step of half its length from the same start. The polynomial
of degree 8 through the states, the rates and the second derivatives at the start, in the middle and at the end is about
as exact as the step. Where the motion may have kinks its second derivatives may be none: unless the polynomial's rates
are those of the motion, each time has a step of its own from the start of the step around it. The same where the motion
is stiff: no polynomial is as exact. What is left between the last step and the end has the step that ends a lane.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, PerImpact, Scalar
from erosion.lanes import tapes
from erosion.ode.event_location import Lane, Segment
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.motion import outputs_of
from erosion.ode.reduction import FlatState
from erosion.ode.signature import Signature
from erosion.ode.step_control import ARRIVED
from erosion.ode.variational import EndTimeDependence, at_event

STEP = -9.0
BESIDE = 2  # numbers of a row before the state

_STEPS = 0


class Tape(NamedTuple):
    """What is written so far.

    Args:
        rows: how many rows; more than `capacity` of them do not fit, and are written over the last.
        capacity: of the tape, in rows.
        token: see `erosion.lanes.tapes`.
        has_derivatives: whether the results of what is written have any.
        elapsed: since the lane began, at the end of the last motion.
    """

    rows: Scalar
    capacity: Scalar
    token: Scalar
    has_derivatives: Flag
    elapsed: Scalar

    def with_step(self, length: Scalar, state: FlatState, moved: Flag) -> "Tape":
        """With a step, which the next row replaces unless the lane moved."""
        return self._with(length, jnp.full((), STEP), state, moved)

    def with_event(self, event: Scalar, state: FlatState) -> "Tape":
        """With the end of a motion."""
        return self._with(self.elapsed, lax.convert_element_type(event, float), state, jnp.asarray(True))

    def _with(self, length: Scalar, code: Scalar, state: FlatState, is_kept: Flag) -> "Tape":
        place = jnp.minimum(self.rows, self.capacity - 1) * (BESIDE + len(state))
        token = tapes.write(_STEPS, self.token, place, length, code, *state)
        return self._replace(rows=self.rows + jnp.where(is_kept, 1, 0), token=token)


class Recorded(NamedTuple):
    """What was recorded of lanes.

    Args:
        rows: of each lane's tape, which may be more than fit; 0 where the lane has no derivatives, or was not recorded.
        tapes: the token of a lane's tape; after the batch the tapes, shape (lanes, length).
    """

    rows: PerImpact
    tapes: PerImpact


@functools.lru_cache(maxsize=256)
def row_width(signature: Signature) -> int:
    """How many numbers a row has."""
    width: list[int] = []
    jax.eval_shape(
        lambda parameters: width.append(LaneEquations(signature, parameters, 0, ()).width), signature.structs()
    )
    return BESIDE + width[0]


class Entry(NamedTuple):
    """A row of a tape."""

    length: Scalar
    code: Scalar
    state: FlatState


def read(token: Scalar, row: Scalar, width: int) -> Entry:
    """A row of states of a width."""
    place = row * (BESIDE + width)
    length, code, *state = (tapes.read(_STEPS, token, place + i) for i in range(BESIDE + width))
    return Entry(length, code, state)


_EVENTS = 0


class EventLog(NamedTuple):
    """The events that are written so far.

    A row has the numbers of an event, and then those of their tangents.

    Args:
        rows: how many.
        capacity: of the tape, in rows; one more than events that are kept.
        token: see `erosion.lanes.tapes`.
    """

    rows: Scalar
    capacity: Scalar
    token: Scalar

    def with_event(self, happens: Flag, numbers: FlatState) -> "EventLog":
        """With an event, which the next one replaces unless it happens."""
        place = jnp.minimum(self.rows, self.capacity - 1) * len(numbers)
        token = tapes.write(_EVENTS, self.token, place, *numbers)
        return self._replace(rows=self.rows + jnp.where(happens, 1, 0), token=token)


TIMES, STATES = 0, 1
"""Tapes: the times of a lane, rising, ∞ the last of them; and for each time a lane's row of numbers."""

ROUNDING = 2e-15  # of the times so far: a time that is this much later than the end is the end


class Saved(NamedTuple):
    """What is written so far.

    Args:
        following: the index of the next time.
        token: see `erosion.lanes.tapes`.
    """

    following: Scalar
    token: Scalar


class StateWriter:
    """Writes the states of one motion of a lane.

    Args:
        problem: the equations; of a stiff motion without second derivatives.
        rtol: relative tolerance.
        elapsed: of a chain, the time since the lane began, with its tangents.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar, elapsed: tuple[Scalar, ...] = ()) -> None:
        self.problem, self.rtol = problem, rtol
        self.elapsed = problem.equations.unpack(elapsed) if elapsed else None

    def after_step(self, saved: Saved, before: Lane, after: Lane) -> Saved:
        """With the states at the times up to the end of a trial, if the lane moved there."""
        end = after.control.time
        due = (end > before.control.time) & (self._time(saved.following) <= end)
        return lax.cond(
            due,
            lambda: self._written(saved, end, self.problem.method.interpolate(before, after, self.rtol)),
            lambda: saved,
        )

    def after_last_step(self, saved: Saved, lane: Lane, motion: Segment) -> Saved:
        """With those up to the end of the motion, which may lie before or after that of the last step."""
        end, problem = motion.time, self.problem
        if problem.chains:
            # Another motion begins there, and writes what is later.
            following = lax.while_loop(
                lambda k: (k > 0) & (self._time(jnp.maximum(k - 1, 0)) > end), lambda k: k - 1, saved.following
            )
            saved = saved._replace(following=following)
        so_far = jnp.abs(problem.clock.t0) + end + (0.0 if self.elapsed is None else self.elapsed.value)
        return self._written(saved, end + ROUNDING * so_far, problem.method.beyond(lane, motion))

    def _time(self, index: Scalar) -> Scalar:
        """A time, since the motion began."""
        time = tapes.read(TIMES, np.zeros(()), index) - self.problem.clock.t0
        return time if self.elapsed is None else time - self.elapsed.value

    def _written(self, saved: Saved, t_stop: Scalar, at: Callable[[Scalar], EndTimeDependence]) -> Saved:
        def writes(saved: Saved) -> Saved:
            numbers = self._numbers(at(self._time(saved.following)))
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
