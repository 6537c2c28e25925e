"""One lane from its start to its end: an error-controlled Runge-Kutta method that ends exactly at an event.

Plain JAX for one lane's numbers. `erosion.lanes` compiles it for many at a time.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Number, PerImpact, Scalar
from erosion.ode.event_location import Segment, all_finite
from erosion.ode.hybrid import trajectory
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.methods.base import LEAST
from erosion.ode.motion import outputs_of
from erosion.ode.problem import OTHER_ENDS
from erosion.ode.segments import SegmentLoop, Written
from erosion.ode.signature import Signature
from erosion.ode.step_control import ARRIVED, ENDED, NOT_BEGUN, SLIDES, STIFF, UNFINISHED
from erosion.ode.tape import Recorded
from erosion.ode.variational import AtEvent, Derivatives, Direction, at_event
from erosion.ode.verification import plan


class LaneEnd(NamedTuple):
    """The results of a lane: numbers, and after the batch arrays of shape (lanes,).

    Args:
        outcome: an index of `Signature.end_names`.
        rtol_next: the tolerance of a second integration, see `erosion.ode.verification.plan`.
        time: from the start to the end, with derivatives.
        outputs: what is wanted there, with derivatives; see `erosion.ode.reduction`.
        trials: number of steps tried.
        count: number of events on the way, that at the end included.
        at_once: for each event whether it happens at the end.
        least: where the whole state is wanted, a size of each of its elements below which it need not be known.
        reached: how long it went on, also where it failed; where the whole state is wanted.
        stiff: whether the lane was given up as stiff, or integrated by the method for that; where it is looked for.
        slides: whether the lane was given up as its rates point to a switch from both sides; where it has switches.
        rtol_used: after the batch, the tolerance of the results.
        error: after the batch, what the values err by as two integrations tell; 0 where there was one.
        saved: the token of what is written at times, or of events; after the batch numbers there and their derivatives,
            in the order of `Variational.pack`, shape (lanes, times, value and tangents, outputs), see
            `recorders.Events` for those of events, of which one row more than are wanted has any numbers.
        recorded: the steps, where they are recorded.
    """

    outcome: PerImpact
    rtol_next: PerImpact
    time: Derivatives
    outputs: Derivatives
    trials: PerImpact
    count: PerImpact  # pyrefly: ignore
    at_once: Sequence[PerImpact] = ()
    least: Sequence[PerImpact] = ()
    reached: PerImpact | None = None
    stiff: PerImpact | None = None
    slides: PerImpact | None = None
    rtol_used: PerImpact | None = None
    error: PerImpact | None = None
    saved: PerImpact | None = None
    recorded: Recorded | None = None

    @property
    def quantities(self) -> Derivatives:
        """Lists of the time and the outputs, and of their derivatives."""
        both = zip(self.time, self.outputs, strict=True)
        return Derivatives(*(None if time is None else [time, *outputs] for time, outputs in both))


def integrate_lane(
    signature: Signature,
    parameters: Sequence[Number],
    directions: tuple[Direction, ...],
    rtol: Scalar,
    *,
    order: int = 0,
    rows: Scalar = 0,
) -> LaneEnd:
    """Integrate one lane to its end.

    Args:
        signature: of problem and arguments.
        parameters: of this lane.
        directions: of the derivatives; see `Variational`.
        rtol: of outputs, end time and derivatives.
        order: 0, 1 or 2 derivatives.
        rows: of the tape, where steps are recorded or events logged.
    """
    problem = LaneEquations(signature, parameters, order, directions)
    loop = SegmentLoop(problem, rtol, rows)
    goes_on = problem.chains or problem.options.fires or signature.problem.scheduled()
    segment, end, written = (trajectory if goes_on else _single)(problem, loop)
    return _finish(problem, segment, end, rtol, loop.recorded(written))


def _single(problem: LaneEquations, loop: SegmentLoop) -> tuple[Segment, AtEvent, Written]:
    """A lane that ends with its first event."""
    time_to_end = problem.time_to_end
    written = [recorder.begin() for recorder in loop.recorders]
    motion, along, written = loop.to_its_event(problem.initial, time_to_end.value, written, None, ())
    rivals = problem.event_set.rivals(motion.happening)
    end = at_event(along, motion.event, motion.time, outputs_of, time_to_end, rivals)
    return motion, end, loop.after_segment(written, motion)


def _finish(
    problem: LaneEquations, motion: Segment, end: AtEvent, rtol: Scalar, recorded: Mapping[str, Any]
) -> LaneEnd:
    """The results where a lane ended, or at its start where it does not begin; NaN where one of them is not finite."""
    control, equations, event = motion.control, problem.equations, motion.event
    begun = event != NOT_BEGUN if problem.options.check_start else jnp.asarray(True)
    outputs, time = end.outputs, end.time
    if problem.options.check_start:
        at_start = equations.of(outputs_of, problem.value_and_tangents(problem.initial))
        outputs = jax.tree.map(lambda there, alone: jnp.where(begun, there, alone), outputs, at_start)
        time = jax.tree.map(lambda number: jnp.where(begun, number, 0.0), time)
    both = zip(equations.unscale(time), equations.unscale(outputs), strict=True)
    results = Derivatives(*(None if of_time is None else [of_time, of_outputs] for of_time, of_outputs in both))
    numbers, structure = jax.tree.flatten(results)
    values = len(jax.tree.leaves(results.value))
    ended = problem.method.is_known(control.mode == ENDED, end.amplification)
    # Of several events at one time, derivatives in which they differ are NaN.
    may_lack = motion.several | motion.lacks
    finite = ended & all_finite(numbers[:values]) & (all_finite(numbers[values:]) | may_lack)
    # What an unfinished lane has reached is given, where nothing else says so.
    wanted = problem.options.outputs
    keeps_values = wanted.keeps_values(finite, control.mode == UNFINISHED)
    known = [jnp.where(keeps_values, number, jnp.nan) for number in numbers[:values]]
    others = [jnp.where(finite, number, jnp.nan) for number in numbers[values:]]
    results = jax.tree.unflatten(structure, known + others)
    time, outputs = (Derivatives(*(part and part[i] for part in results)) for i in range(2))
    happening = [lax.convert_element_type(each, np.int8) for each in motion.at_once[: problem.own_events]]
    count, at_once, reached = wanted.of_events(lax.convert_element_type(motion.count, np.int32), happening, numbers[0])
    least = [LEAST * size for size in problem.sizes_of_state(motion.greatest)]
    return LaneEnd(
        outcome=_outcome(problem, finite, control.mode, event),
        rtol_next=plan(control, ended & begun, end.amplification, finite, rtol, wanted),
        time=time,
        outputs=outputs,
        trials=lax.convert_element_type(control.trials, np.int32),
        count=count,
        at_once=at_once,
        reached=reached,
        least=least,
        stiff=lax.convert_element_type(control.event == STIFF, np.int8) if problem.detects_stiffness else None,
        slides=lax.convert_element_type(control.event == SLIDES, np.int8) if problem.switches else None,
        **recorded,
    )


def _outcome(problem: LaneEquations, finite: Flag, mode: Scalar, event: Scalar) -> Scalar:
    """The code of an end, an index of `Signature.end_names`."""
    names = problem.signature.end_names
    code = {name: names.index(name) for name in OTHER_ENDS}
    without_event = jnp.where(event == ARRIVED, code["t1"], event)
    ended = jnp.where(event == NOT_BEGUN, code["start"], without_event)
    no_result = jnp.where(mode == UNFINISHED, code["unfinished"], code["failed"])
    return lax.convert_element_type(jnp.where(finite, ended, no_result), np.int8)
