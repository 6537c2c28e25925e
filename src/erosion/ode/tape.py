"""The tape of a lane: where each of its steps began, how long it was, and where its events were.

Each row holds a length and a code, and then the state. A row of a step has the code `STEP`. After the steps of a motion
comes a row with the code of what ended it and the state there, before any reset; its length is a number whose binary
digits say which events happened there.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, PerImpact, Scalar
from erosion.lanes import tapes
from erosion.ode.extended import Extended
from erosion.ode.reduction import Rows
from erosion.ode.variational import Layout

STEP = -9.0
BESIDE = 2  # numbers of a row before the state

_SLOT = 0


class Tape(NamedTuple):
    """What is written so far.

    Args:
        rows: how many rows; more than `capacity` of them do not fit, and are written over the last.
        capacity: of the tape, in rows.
        token: see `erosion.lanes.tapes`.
        has_derivatives: whether the results of what is written have any.
    """

    rows: Scalar
    capacity: Scalar
    token: Scalar
    has_derivatives: Flag

    def with_step(self, length: Scalar, state: Rows, moved: Flag) -> "Tape":
        """With a step, which the next row replaces unless the lane moved."""
        return self._with(length, jnp.full((), STEP), state, moved)

    def with_event(self, event: Scalar, happens: Sequence[Flag], state: Rows) -> "Tape":
        """With the end of a motion."""
        digits = sum((2.0**i * flag for i, flag in enumerate(happens)), jnp.zeros(()))
        return self._with(digits, lax.convert_element_type(event, float), state, jnp.asarray(True))

    def _with(self, length: Scalar, code: Scalar, state: Rows, is_kept: Flag) -> "Tape":
        place = jnp.minimum(self.rows, self.capacity - 1) * (BESIDE + len(state))
        token = tapes.write(_SLOT, self.token, place, length, code, *state)
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
def row_width(layout: Layout) -> int:
    """How many numbers a row has."""
    width: list[int] = []
    jax.eval_shape(lambda numbers: width.append(Extended(layout, numbers, 0, ()).width), layout.structs())
    return BESIDE + width[0]


class Entry(NamedTuple):
    """A row of a tape."""

    length: Scalar
    code: Scalar
    state: Rows


def read(token: Scalar, row: Scalar, width: int) -> Entry:
    """A row of states of a width."""
    place = row * (BESIDE + width)
    length, code, *state = (tapes.read(_SLOT, token, place + i) for i in range(BESIDE + width))
    return Entry(length, code, state)
