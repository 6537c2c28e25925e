"""What watches the trials of a lane beside its error, and may change one, or stop the lane.

A program has a list of guards, chosen where it is traced. What a guard remembers is of one motion.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from erosion.arguments import Flag, Scalar
from erosion.ode.horizon import Horizon
from erosion.ode.kinks import breaks, comes_near, corrected, is_broken
from erosion.ode.landing import Lane, Segment
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.methods.base import Step
from erosion.ode.methods.runge_kutta import RungeKutta
from erosion.ode.reduction import Rows
from erosion.ode.step_control import FAILED, SLIDES, STIFF, UNFINISHED, Control, goes_on

MOMENT = 1e-12  # of the time scale: a rate that is 0·∞ at the start, or jumps, is taken this much later
ULPS = 1e-15  # of a number, at least: then it is another one
_SAMPLES = 24  # parts of a step between which kinks are looked for: as close as the stages of a second integration
_MANY_STIFF = 12  # steps, more than others, that are short although the motion is smooth: it is stiff
_BEYOND = 1e-9  # of the time scale: a bound below zero that would take so long is no rounding
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

    def ends(self, memory: Any, lane: Lane, motion: Segment) -> Segment:
        """The end of a motion, with what the guard has seen on its way."""
        return motion


class NearKinks(Guard):
    """Sees whether a lane comes near a kink: a lane that does not is not integrated again as one that does."""

    def begin(self, scale: Scalar) -> Flag:
        """See `Guard`."""
        return jnp.asarray(False)

    def decided(self, memory: Flag, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """See `Guard`."""
        problem, h = self.problem, lane.control.trial
        ends = lane.state, lane.slope, step.state, step.slope
        rows = list(zip(*(each[: problem.width] for each in ends), strict=True))

        def at(share: float) -> Rows:
            a, b = share * share * (3 - 2 * share), share * (1 - share)
            return [u + a * (v - u) + h * b * ((1 - share) * k - share * m) for u, k, v, m in rows]

        near = comes_near([problem.singular(at(i / _SAMPLES)) for i in range(_SAMPLES + 1)])
        return Decided(memory | near, step, control)

    def ends(self, memory: Flag, lane: Lane, motion: Segment) -> Segment:
        """See `Guard`."""
        rows: Rows = jax.tree.leaves(motion.members[0])
        both = self.problem.singular(lane.state[: self.problem.width]), self.problem.singular(rows)
        return motion._replace(near_kink=memory | comes_near(both))


class Jumps(Guard):
    """A lane with derivatives fails where a rate jumps."""

    def decided(self, memory: Any, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """See `Guard`."""
        problem, h = self.problem, lane.control.trial
        broken = is_broken(problem, lane.state, step.stages, h, problem.time_scale)
        begun = jnp.maximum(MOMENT, ULPS * jnp.abs(problem.clock.t0) / h)
        begun = jnp.where(lane.control.time == 0, begun, -1.0)
        ends = (lane.state, lane.slope), (step.state, step.slope)
        broken = moved & (broken | breaks(problem, *ends, h, problem.time_scale, begun))
        return Decided(memory, step, control._replace(mode=jnp.where(broken, FAILED, control.mode)))


class Kinks(Guard):
    """Second derivatives jump at a kink."""

    def decided(self, memory: Any, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
        """See `Guard`."""
        ends = (lane.state, lane.slope), (step.state, step.slope)
        state, slope = corrected(self.problem, *ends, step.stages, lane.control.trial, self.problem.time_scale)
        return Decided(memory, step._replace(state=state, slope=slope), control)


class InModes(Guard):
    """A lane is given up where a bound that rested at zero falls, so that no mode fits: see `switches`."""

    def begin(self, scale: Scalar) -> Rows:
        """See `Guard`."""
        return [0.0 * scale for _ in self.problem.directions[self.problem.own_events :]]

    def decided(self, memory: Rows, lane: Lane, step: Step, moved: Flag, control: Control, end: Horizon) -> Decided:
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
        rows = (lane.state, step.state)
        one = self.method.stiffness(lane.greatest, rows, step.stages, lane.control.trial, self.rtol)
        count = jnp.maximum(memory + jnp.where(moved, one, 0.0), 0.0)
        stops = goes_on(control) & (count >= _MANY_STIFF) & end.is_far(control, _FAR)
        mode, event = jnp.where(stops, UNFINISHED, control.mode), jnp.where(stops, STIFF, control.event)
        return Decided(count, step, control._replace(mode=mode, event=event))


def guards_of(problem: LaneEquations, rtol: Scalar) -> list[Guard]:
    """Those that a program needs."""
    guards: list[Guard] = [NearKinks(problem, rtol)] if problem.shows_kinks else []
    if problem.nonsmooth and problem.order:
        guards.append(Jumps(problem, rtol))
    if problem.nonsmooth and problem.order == 2:
        guards.append(Kinks(problem, rtol))
    if problem.switches is not None:
        guards.append(InModes(problem, rtol))
    if problem.detects_stiffness and isinstance(problem.method, RungeKutta):
        guards.append(Stiffness(problem, rtol, problem.method))
    return guards
