"""Where the motion of a lane ends: at its event, by Newton's method from the last step, or at a time."""

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.ode.arming import Watched
from erosion.ode.cubics import Ends
from erosion.ode.kinks import divisors, radicands
from erosion.ode.motion import Augmented
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import ENDED, FAILED, FIRST_STEP, MOMENT, Control
from erosion.ode.variational import EndTimeDependence

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations

_VANISHES = 1e-5  # of the time scale: a divisor that is zero as soon leaves too few digits of second derivatives
_DOUBLE = 4.0  # the square of a rate over value and second derivative: 2 at a double zero, ∞ at a simple one


class Lane(NamedTuple):
    """A lane under way: its control, and the events, state and slopes at the start of its next step.

    An event of the last step is one that counted where that step began: `watched`.
    `greatest` is the greatest size so far of each row of the motion itself, where the whole state is wanted.
    `memories` are what guards keep of it, see `erosion.ode.guards`.
    """

    control: Control
    events: list[Ends]
    state: FlatState
    slope: FlatState
    watched: list[Watched]
    greatest: FlatState
    memories: tuple[Any, ...]


class Segment(NamedTuple):
    """A motion to its first event.

    Args:
        control: at its end.
        value_and_tangents: state and integrals at the event, with derivatives at a fixed time.
        event: its index; below 0 if there is none.
        time: since the motion began.
        count: events so far, of all motions of a chain.
        at_once: for each event whether it happens there.
        arrives: whether the time has come at which the lane ends without an event.
        greatest: the greatest size of each row of the motion itself, where the whole state is wanted.
        still_zero: of each event that happened whether its function is zero after the resets, but for rounding.
        lacks: whether it began without some derivatives, see `lost_tangents`.
    """

    control: Control
    value_and_tangents: tuple[Augmented, ...]
    event: Scalar
    time: Scalar
    count: Scalar  # pyrefly: ignore
    at_once: Sequence[Flag]
    arrives: Flag
    greatest: FlatState
    still_zero: Sequence[Flag] = ()
    lacks: Flag | bool = False

    @property
    def happening(self) -> list[Flag]:
        """What happens at its end: of each event, and last of the time at which the lane ends without one."""
        return [*self.at_once, self.arrives]

    @property
    def several(self) -> Flag:
        """Whether more than one of these does."""
        return how_many(self.happening) > 1


def how_many(flags: Sequence[Flag]) -> Scalar:
    """How many of some flags are set."""
    return functools.reduce(jnp.add, [jnp.where(flag, 1, 0) for flag in flags])


def finish_step(problem: "LaneEquations", lane: Lane, time_to_end: Scalar | None) -> tuple[Segment, EndTimeDependence]:
    """The motion to where its last step found its end; with how what is wanted there depends on the event's time."""
    motion, along = problem.method.finish_step(lane, time_to_end)
    if not problem.order:
        return motion, along
    lost = has_no_derivatives(problem, motion)
    control = motion.control._replace(mode=jnp.where(lost, FAILED, motion.control.mode))
    at_once = [event & ~lost for event in motion.at_once]
    return motion._replace(control=control, at_once=at_once, count=jnp.where(lost, 0, motion.count)), along  # pyrefly: ignore


def has_no_derivatives(problem: "LaneEquations", motion: Segment) -> Flag:
    """Whether derivatives at the end of a motion are not defined, as far as nothing else tells.

    A rate that divides by what vanishes there leaves nothing but rounding of them, as of those of sin(v)/v. So does the
    root of what has a double zero there of second ones, as √(v² + w²). At a switch that may be the rate of a mode that
    does not hold.
    """
    if not problem.event_set.locates_closely:
        return jnp.asarray(False)
    flat_state: FlatState = jax.tree.leaves(motion.value_and_tangents[0])
    near = _VANISHES * problem.scale_near(motion.control.step, FIRST_STEP)
    flow = problem.motion_rate(flat_state)
    ends = zip(*jax.jvp(problem.operands(divisors), (flat_state,), (flow,)), strict=True)
    vanish = [~(jnp.abs(value) > near * jnp.abs(rate)) for value, rate in ends]
    if problem.order == 2:

        def moving(flat_state: FlatState) -> list[tuple[Scalar, Scalar]]:
            both = jax.jvp(problem.operands(radicands), (flat_state,), (problem.motion_rate(flat_state),))
            return list(zip(*both, strict=True))

        ends, bends = jax.jvp(moving, (flat_state,), (flow,))
        for (value, rate), (_, bend) in zip(ends, bends, strict=True):
            product = jnp.abs(value * bend)
            vanish.append((rate * rate <= _DOUBLE * product) & (jnp.abs(value) < near * near * jnp.abs(bend)))
    at_its_end = (motion.control.mode == ENDED) & (motion.event < problem.own_events)
    return at_its_end & functools.reduce(jnp.logical_or, vanish, jnp.asarray(False))


def happening(
    problem: "LaneEquations", ended: Flag, event: Scalar, remaining: Scalar, events: Sequence[Ends], scale: Scalar
) -> list[Flag]:
    """For each event whether it happens at the end."""
    happened, near = ended & (event >= 0), problem.event_set.at_once(events, remaining, scale)
    return [happened & (there | (event == i)) for i, there in enumerate(near)]


def segment_to(
    lane: Lane, value_and_tangents: tuple[Augmented, ...], event: Scalar, time: Scalar, at_once: Sequence[Flag],
    time_to_end: Scalar | None, scale: Scalar,
) -> Segment:  # fmt: skip
    """A motion to the end that its last step found."""
    ended = lane.control.mode == ENDED
    count = lax.convert_element_type(ended & (event >= 0), np.int32)
    left = jnp.inf if time_to_end is None else time_to_end - time
    arrives = ended & (left <= MOMENT * scale)
    # A last step that fails has no end: the motion came to its start.
    time = jnp.where(jnp.isnan(time), lane.control.time, time)
    return Segment(lane.control, value_and_tangents, event, time, count, at_once, arrives, lane.greatest)


def all_finite(flat_state: FlatState) -> Flag:
    """Whether each of them is."""
    return functools.reduce(jnp.logical_and, map(jnp.isfinite, flat_state), jnp.asarray(True))
