"""Lanes to their first events, with derivatives: `erosion.ode.solve`."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import PerImpact, as_names, check_order
from erosion.ode.back_in_time import early
from erosion.ode.ensemble import Lanes, Part, by_names, checked_lanes, checked_times, ends, named_events, shaped
from erosion.ode.event_log import Passed, events_passed
from erosion.ode.gradient import goes_back
from erosion.ode.problem import Problem, in_these_words
from erosion.ode.solution import INEXACT, Integration, Solution, Times
from erosion.ode.step_control import require_float64
from erosion.ode.traced import traced_events, traced_solution
from erosion.output.tables import briefly


@in_these_words
def solve(
    problem: Problem,
    args: PyTree = None,
    *,
    t1: Any = None,
    t0: Any = 0.0,
    wrt: str | Sequence[str] = (),
    derivatives: int | None = None,
    rtol: float = 1e-9,
    start: str = "wait",
    ts: Any = None,
    max_step: Any = math.inf,
    max_events: Any = math.inf,
    state_scale: PyTree = None,
    smooth: bool | None = None,
    max_steps: int = 20_000,
    method: str = "auto",
    shared: str | Sequence[str] = (),
    gradient: bool = False,
) -> Solution:
    """Integrate lanes, each to the first event that ends it, or to `t1`.

    A lane is one initial value problem; arrays among the arguments make many. Within `jax.jit`, `vmap`, `grad`,
    `hessian` and their like the results are numbers that JAX can trace, with derivatives up to the second.

    Args:
        problem: the equations.
        args: any pytree for its functions. Numbers and arrays in it broadcast, one number for each lane.
        t1: where a lane without an event ends; numbers or arrays. Before `t0` time goes back, unless JAX traces it; an
            event's direction is that on the way. It may be left out where the problem has a
            `time_scale`: then a lane may take any time.
        t0: where lanes begin; numbers or arrays.
        wrt: the numbers by which derivatives are taken, by their path in `args` with dots between: "angle",
            "drag.coefficient", "masses.0"; also "t0" and "t1". Where an argument has such a name say "args.t1" for it,
            and "solve.t1" for the other.
        derivatives: 0, 1 or 2; 1 by default where `wrt` names something.
        rtol: relative tolerance of times, states, integrals and their derivatives.
        start: "wait": an event function that is zero or beyond its event at the start counts once it has returned;
            "end": such a lane ends at its start; "fire": such an event happens there, with its reset.
        ts: times at which the state is wanted as well, shape (n,); at an event that before its reset. For those before
            `t0` lanes go back as well, up to the event that ends them; where JAX traces `t0` or them they are NaN.
        max_step: no step is longer; a pulse of an event function shorter than a step may go unseen.
        max_events: a chain of events that the motion survives ends with this one; None for no bound.
        state_scale: typical sizes of y, a pytree like it or one number: a state need not be known to better than
            `rtol` times its size.
        smooth: True says that the equations have no kinks although `sqrt` or `where` occurs; by default the
            arithmetic is looked at.
        max_steps: trials of steps after which a lane is "unfinished".
        method: "explicit", a Runge-Kutta method of 8th order; "rosenbrock", Rodas5P of 5th order for stiff motions of
            up to some twenty unknowns without kinks, whose second derivatives are NaN; or "auto": explicit, and lanes
            that turn out to be stiff by the other (`Solution.stiff`).
        shared: paths of arrays that each lane has as a whole, such as tables and weights.
        gradient: whether `Solution.gradient` follows; it then takes the steps of this integration, and
            `Solution.warnings` say which lanes it goes through forwards.

    Returns:
        What the lanes ended by, when, in which state; see `Solution`.

    Raises:
        ValueError, TypeError: for arguments that do not fit, and for functions of the problem that cannot be
            computed, with the line in them. A lane that fails is no error: it is an outcome, in `ended_by`.

    Example:
        >>> from erosion import ode
        >>> fall = ode.Problem(
        ...     y0={"y": 10.0, "v": 0.0},
        ...     vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"]},
        ...     events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
        ... )
        >>> end = ode.solve(fall, {"g": 9.81}, t1=100.0, wrt="g")
        >>> float(end.t), str(end.ended_by)  # √(2·10/9.81)
        (1.427843..., 'ground')
    """
    require_float64()
    names = as_names("wrt", wrt)
    order = check_order((1 if names else 0) if derivatives is None else derivatives)
    if order and not names:
        raise ValueError(f"Argument `derivatives` needs numbers in `wrt`, but is {order} and `wrt` names none.")
    if (names and not order) or len(set(names)) != len(names):
        raise ValueError(f"Argument `wrt` must name different numbers, and needs derivatives, but is {briefly(wrt)}.")
    lanes, rtol = checked_lanes(
        problem, args, t1=t1, t0=t0, rtol=rtol, start=start, max_step=max_step, max_events=max_events,
        state_scale=state_scale, smooth=smooth, max_steps=max_steps, method=method, shared=shared,
    )  # fmt: skip
    if gradient:
        lanes = lanes._replace(signature=lanes.signature.wanting(records=goes_back(lanes.signature)))
    end = _Integration(lanes, names, order, rtol).at(ts)
    return dataclasses.replace(end, has_gradient=True) if gradient else end


@dataclasses.dataclass(frozen=True)
class _Integration(Integration):
    """See `Integration`.

    Args:
        lanes: the lanes.
        names, order: of the derivatives.
        rtol: relative tolerance.
    """

    lanes: Lanes
    names: Sequence[str]
    order: int
    rtol: float

    def at(self, times: Any) -> Solution:
        """See `Integration`; times may be None."""
        if times is not None:
            times = jnp.asarray(times, float) if _is_traced(jax.tree.leaves(times)) else checked_times(times)
        is_back = self.lanes.original is not None
        end = self._both_ways(-1.0 * times if is_back and times is not None else times)
        end = dataclasses.replace(end, integration=self)
        return end.mirrored() if is_back else end

    def events(self, count: PerImpact) -> Passed:
        """See `Integration`."""
        if _is_traced(self.lanes.parameters):
            return traced_events(self.lanes, self.rtol)
        return events_passed(self.lanes, count, self.names, self.order, self.rtol)

    def _both_ways(self, times: Any) -> Solution:
        """The solution, with states at times before the start as well."""
        lanes, t0 = self.lanes, self.lanes.signature.clock(self.lanes.parameters).t0
        end = self._found(lanes, times)
        if times is None or _is_traced([t0, times]):
            return end
        flags = early(t0, lanes.shape, times)
        if not np.any(flags):
            return end
        if any(event.reset for event in lanes.signature.problem.events.values()):
            raise ValueError(
                "Argument `ts` must hold no times before `t0` where events have resets, as these know no way back."
            )
        first = np.min(times, where=np.isfinite(times), initial=np.inf)
        before = self._found(lanes.turned(first), -1.0 * times)
        return end.with_earlier(before.mirrored(), flags)

    def _found(self, lanes: Lanes, times: Any) -> Solution:
        found = traced_solution if _is_traced([*lanes.parameters, times]) else solution
        return found(lanes, self.names, self.order, self.rtol, times)


def _is_traced(numbers: Sequence[Any]) -> bool:
    return any(isinstance(number, Tracer) for number in numbers)


def solution(lanes: Lanes, names: Sequence[str], order: int, rtol: float, ts: np.ndarray | None = None) -> Solution:
    """The solution of lanes, with derivatives of an order along all pairs of names, and states at times."""
    known = None if ts is None else np.unique(ts[np.isfinite(ts)])
    results, along = ends(lanes, names, order, rtol, known)
    lanes = lanes._replace(signature=lanes.signature.wanting(records=False))
    several = results.time.value.ndim > 1

    def part(kind: str, column: int) -> Part:
        """Times, states and integrals, or one of their derivatives."""
        time, *outputs = (
            found[:, column].reshape(lanes.shape)[()] if several else found.reshape(lanes.shape)[()]
            for found in getattr(results.quantities, kind)
        )
        return shaped(lanes, time, outputs)

    value = part("value", 0)
    found: dict[tuple[str, ...], Part] = {}
    for i, each in enumerate(along if order else []):
        for kind, path in (("by_first", each[:1]), ("by_second", each[-1:]), ("mixed", each[:2])):
            if len(path) <= order and (kind != "mixed" or order == 2) and path not in found:
                found[path] = part(kind, i)
    for name in names if order else ():
        if lanes.begins_with(name):
            found[(name,)] = found[(name,)]._replace(t=found[(name,)].t + 1.0)
    outcome = results.outcome.reshape(lanes.shape)
    elapsed = np.reshape(value.t, lanes.size)
    t = lanes.signature.end_times(lanes.parameters, results.outcome, elapsed).reshape(lanes.shape)[()]
    times = None if ts is None or results.saved is None else _at_times(lanes, ts, t, results.saved, along)
    stiff = np.full(lanes.size, lanes.signature.options.for_stiff)
    if results.stiff is not None:
        stiff = results.stiff > 0
    return Solution(
        problem=lanes.signature.problem,
        names=lanes.signature.end_names,
        wrt=tuple(names),
        outcome=outcome[()],
        t=t,
        y=value.y,
        integrals=value.integrals,
        count=results.count.reshape(lanes.shape)[()],
        trials=results.trials.reshape(lanes.shape)[()],
        at_once=named_events(lanes, [each.reshape(lanes.shape)[()] > 0 for each in results.at_once]),
        stiff=stiff.reshape(lanes.shape)[()],
        _reached=lanes.signature.end_times(lanes.parameters, results.outcome, results.reached).reshape(lanes.shape)[()],
        slides=None if results.slides is None else results.slides.reshape(lanes.shape)[()] > 0,
        derivatives=found,
        lanes=lanes,
        rtol=rtol,
        digest=lanes.signature.equations.digest,
        tolerance=None if order else results.rtol_used,
        inexact=np.reshape(np.asarray(results.error) > INEXACT * rtol, lanes.shape)[()],
        recorded=results.recorded,
        times=times,
    )


def _at_times(lanes: Lanes, ts: np.ndarray, t: Any, saved: np.ndarray, along: Sequence[tuple[str, ...]]) -> Times:
    """The states at times and their derivatives; NaN after the end, which is among the times itself.

    Args:
        lanes: the lanes.
        ts: the times in the order asked for.
        t: the end of each lane.
        saved: at each finite time once, in rising order; see `ends`.
        along: the names of the derivatives.
    """
    known, wide = np.isfinite(ts), lanes._replace(shape=(*lanes.shape, ts.size))
    places = np.unique(ts[known], return_inverse=True)[1]
    in_order, late = np.array_equal(places, np.arange(ts.size)), ts > np.reshape(t, (-1, 1))

    def part(given: np.ndarray) -> Times:
        rows = given
        if not in_order:
            rows = np.full((lanes.size, ts.size, saved.shape[-1]), np.nan)
            rows[:, known] = given[:, places]
        rows[late] = np.nan
        outputs = [row.reshape(wide.shape) for row in np.moveaxis(rows, -1, 0)]
        y, integrals = shaped(wide, np.broadcast_to(ts, wide.shape), outputs)[1:]
        return Times(ts, y, integrals)

    value, found = by_names(saved, along, part)
    return value._replace(derivatives=found)
