"""What watches the trials of a lane beside its error, and may change one, or stop the lane.

A program has a list of guards, chosen where it is traced. What a guard remembers is of one motion.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from erosion.arguments import Flag, Scalar
from erosion.ode.event_location import Lane
from erosion.ode.horizon import Horizon
from erosion.ode.kinks import square_roots
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.methods.base import Step
from erosion.ode.methods.runge_kutta import RungeKutta
from erosion.ode.reduction import FlatState
from erosion.ode.step_control import FAILED, SLIDES, STIFF, UNFINISHED, Control, goes_on

_MANY_STIFF = 12  # steps, more than others, that are short although the motion is smooth: it is stiff
_BEYOND = 1e-9  # of the time scale: a bound below zero that would take so long is no rounding
_TOUCHES = 0.1  # of the square of a rate: a parabola's least value as near zero is not resolved by a step
_AT_KINK = 1e-9  # of the time scale: so near a double zero of a radicand its rounding begins to show
_FAR = 200  # steps: a nearer end is reached all the same


class Decided(NamedTuple):
    """A trial, and what was decided after it.

    Args:
        memory: of the guard.
        step: the trial.
        control: after it.
    """

    memory: Any
    step: Step
    control: Control


class Guard:
    """Sees the trials of a lane; it may change one, or stop the lane.

    Args:
        problem: the equations.
        rtol: relative tolerance.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar) -> None:
        self.problem, self.rtol = problem, rtol

    def begin(self, scale: Scalar) -> Any:
        """The memory where a motion begins: 0.0 * scale for a number."""
        return ()

    def decided(self, memory: Any, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """What follows."""
        return Decided(memory, step, control)


class InModes(Guard):
    """A lane is given up where a bound that rested at zero falls, so that no mode fits: see `switches`."""

    def begin(self, scale: Scalar) -> FlatState:
        """See `Guard`."""
        return [0.0 * scale for _ in self.problem.directions[self.problem.own_events :]]

    def decided(
        self, memory: FlatState, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon
    ) -> Decided:
        """See `Guard`."""
        own, scale, greatest = self.problem.own_events, self.problem.time_scale, []
        lost: Flag = jnp.asarray(False)
        for most, before, after in zip(memory, lane.events[own:], step.events[own:], strict=True):
            most = functools.reduce(jnp.maximum, (jnp.abs(before.rate), jnp.abs(after.rate)), most)
            lost = lost | (after.value < -_BEYOND * scale * most)
            greatest.append(most)
        lost = moved & goes_on(control) & lost
        mode, event = jnp.where(lost, UNFINISHED, control.mode), jnp.where(lost, SLIDES, control.event)
        return Decided(greatest, step, control._replace(mode=mode, event=event))


class Stiffness(Guard):
    """A lane is given up whose steps are short although the motion is smooth.

    Args:
        problem, rtol: see `Guard`.
        method: whose stages tell eigenvalues.
    """

    def __init__(self, problem: LaneEquations, rtol: Scalar, method: RungeKutta) -> None:
        super().__init__(problem, rtol)
        self.method = method

    def begin(self, scale: Scalar) -> Scalar:
        """See `Guard`."""
        return 0.0 * scale

    def decided(self, memory: Scalar, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """See `Guard`."""
        states = (lane.state, step.state)
        one = self.method.stiffness(lane.greatest, states, step.stages, lane.control.trial_length, self.rtol)
        count = jnp.maximum(memory + jnp.where(moved, one, 0.0), 0.0)
        stops = goes_on(control) & (count >= _MANY_STIFF) & end.is_far(control, _FAR)
        mode, event = jnp.where(stops, UNFINISHED, control.mode), jnp.where(stops, STIFF, control.event)
        return Decided(count, step, control._replace(mode=mode, event=event))


class Roots(Guard):
    """A lane with second derivatives fails where what a square root is taken of touches zero within a step.

    The root has a kink there, as √(v² + w²) has where a body comes to rest. First derivatives of the motion bend at
    the kink, and no step sees what the second ones gain by that.
    """

    def decided(self, memory: Any, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """See `Guard`."""
        problem, length, lost = self.problem, lane.control.trial_length, jnp.asarray(False)
        width, near = problem.width, _AT_KINK * problem.time_scale
        before, after = (
            jax.jvp(problem.operands(square_roots), (rows[:width],), (slope[:width],))
            for rows, slope in ((lane.state, lane.slope), (step.state, step.slope))
        )
        for value, rate, other, later in zip(*before, *after, strict=True):
            # The parabola of both rates: its least value is zero where the square of a rate is 2 value · bend.
            greater = value > other
            farther, slope = jnp.where(greater, value, other), jnp.where(greater, rate, later)
            bend = (later - rate) / length
            touching = 2.0 * farther * bend
            # Steps that get shorter towards the kink come as near as rounding lets them, and never across it.
            reaches = (later > 0) | (farther < near * near * bend)
            lost = lost | ((rate < 0) & reaches & (jnp.abs(slope * slope - touching) < _TOUCHES * touching))
        return Decided(memory, step, control._replace(mode=jnp.where(moved & lost, FAILED, control.mode)))


def guards_of(problem: LaneEquations, rtol: Scalar) -> list[Guard]:
    """Those that a program needs."""
    guards: list[Guard] = []
    if problem.switches is not None:
        guards.append(InModes(problem, rtol))
    may_touch = problem.order == 2 and problem.nonsmooth and problem.event_set.locates_closely
    if may_touch and jax.eval_shape(problem.operands(square_roots), problem.initial[: problem.width]):
        guards.append(Roots(problem, rtol))
    if problem.detects_stiffness and isinstance(problem.method, RungeKutta):
        guards.append(Stiffness(problem, rtol, problem.method))
    return guards
