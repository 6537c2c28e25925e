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
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, PerImpact, Scalar
from erosion.lanes import tapes
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.reduction import FlatState
from erosion.ode.signature import Signature

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
