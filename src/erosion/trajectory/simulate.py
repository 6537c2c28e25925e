"""One impact through diffrax: the whole motion, dense in time, with the end located exactly.

diffrax takes the steps. Where the cut ends is decided here, because an event search that
looks only at the ends of steps misses a tip that leaves and returns within a step, and one
that takes the first of several events in storage order picks the wrong end near a cusp.
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import erosion.trajectory.diffrax_steps as flow
from erosion.arguments import check_tolerance, check_whole
from erosion.array_types import Structure
from erosion.correlations.ranges import OutOfRangeWarning
from erosion.models import load_model, model_name
from erosion.models.base import NO_CUT, CuttingModel, units_within
from erosion.models.own_parameters import require_one_impact
from erosion.ode.precision import require_xla
from erosion.ode.step_control import LONGEST
from erosion.parameters.parameters import Parameters, require_concrete, validate
from erosion.trajectory.events import Fall, find_root, first_fall
from erosion.trajectory.trajectory import SimulationError, Trajectory, TurnWarning

_SAMPLES = 8  # looks at the event functions within each step
_ATOL = 1e-15  # of each quantity's size: rounding
_LONGEST_STEP = 0.05  # of the model's time scale: sampled 8 times, a cubic errs by 1e-10 or less

_Functions = dict[str, np.ndarray]
_Look = tuple[_Functions, _Functions, tuple[np.ndarray, ...], np.ndarray]


def simulate(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    points: int = 201,
    rtol: float = 1e-12,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractAdaptiveStepSizeController | None = None,
) -> Trajectory:
    """Follow one impact from contact to the end of the cut.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters, all scalars, as are the model's own.
        points: times at which the histories are given, ≥ 2.
        rtol: relative tolerance of each step.
        solver: a diffrax solver with dense output, by default `Dopri8`.
        stepsize_controller: by default a PID controller at `rtol`, with steps of at most a
            twentieth of the model's time scale. It sees all quantities scaled to order 1.

    Returns:
        The trajectory. Its end is the earliest fall of any event function through zero,
        located to 1e-12 relative; a tip that dips out and back within a step is seen.

    Raises:
        ValueError: for parameters out of range or not scalar.
        SimulationError: where the solver fails, or no event ends the cut.

    Warns:
        TurnWarning: where the body turned by more than π/2.
        OutOfRangeWarning: where a correlation, or another model with a range, is used outside of it.
    """
    require_xla()
    model = load_model(model)
    validate(p)
    require_concrete(p)
    require_one_impact(model, p, "; for many impacts use `erosion.impact`")
    rtol, points = check_tolerance(rtol), check_whole("points", points, 2)
    for name, given, kind in (
        ("solver", solver, diffrax.AbstractSolver),
        ("stepsize_controller", stepsize_controller, diffrax.AbstractAdaptiveStepSizeController),
    ):
        if given is not None and not isinstance(given, kind):
            raise TypeError(f"Argument `{name}` must be a diffrax.{kind.__name__}, but is {given!r}.")
    trajectory = _follow(model, p, diffrax.Dopri8() if solver is None else solver, stepsize_controller, rtol, points)
    for message in trajectory.warnings:
        category = TurnWarning if message == trajectory.turn_warning else OutOfRangeWarning
        warnings.warn(message, category, stacklevel=2)
    return trajectory


def _follow(
    model: CuttingModel,
    p: Parameters,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractAdaptiveStepSizeController | None,
    rtol: float,
    points: int,
) -> Trajectory:
    given, p = p, dataclasses.replace(p, units=units_within(model, p))
    structure = flow.layout(model, p)
    begins, start, sizes, time = flow.begin(model, p)
    if not np.all(np.isfinite(start)):
        raise SimulationError(f"{model_name(model)}: state and volume are not finite at contact.")
    if not begins:
        ys = np.asarray(start)[None]
        return _trajectory(model, given, structure, np.zeros(1), ys, NO_CUT, lambda t: np.repeat(ys, len(t), 0))
    if controller is None:
        controller = diffrax.PIDController(rtol=rtol, atol=_ATOL, dtmax=_LONGEST_STEP * time)
    # Numpy from here: JAX would compile a program for every number of steps.
    problem = flow.Problem(model, p, solver, controller, sizes)
    ends, states, _, interpolant = flow.solve(problem, start, 0.0 * time, LONGEST * time)
    ends = np.asarray(ends)
    ends = np.append(0.0, ends[np.isfinite(ends)])

    def dense(t: np.ndarray) -> np.ndarray:
        return np.asarray(flow.interpolate(solver, interpolant, sizes, _padded(t)))[: len(t)]

    fall = _first_event(model, p, dense, ends, float(time))
    name = fall.name

    # From the start of the step in which the cut ends, steps of full order to any time in it.
    begun = int(np.searchsorted(ends, fall.low, side="right")) - 1
    before = start if begun == 0 else np.asarray(states)[begun - 1]

    @functools.cache
    def reach(t: float) -> Array | np.ndarray:
        if t <= ends[begun]:
            return before
        return flow.solve(problem, before, jnp.float64(ends[begun]), jnp.float64(t))[2]

    def event(t: float) -> tuple[float, float]:
        value, rate = flow.event(model, p, reach(t))
        return float(value[name]), float(rate[name])

    t_c = find_root(event, fall)
    t = np.linspace(0.0, t_c, points)
    # The ends of the histories are known better than the dense output gives them.
    ys = np.concatenate([dense(t)[:-1], np.asarray(reach(t_c))[None]])
    return _trajectory(model, given, structure, t, ys, name, dense)


def _first_event(
    model: CuttingModel, p: Parameters, dense: Callable[[np.ndarray], np.ndarray], ends: np.ndarray, time: float
) -> Fall:
    """The event that ends the cut, from looks within the steps, which end at `ends`."""
    t, values, rates = _looks(model, p, dense, ends, time)
    try:
        fall = first_fall(t, values, rates)
    except ArithmeticError as error:
        raise SimulationError(f"{model_name(model)}: {error}.") from error
    if len(ends) == 1:
        raise SimulationError(
            f"{model_name(model)}: no first step could be taken: the motion is not finite at contact."
        )
    if fall is None:
        raise SimulationError(
            f"{model_name(model)}: no event ended the cut within {ends[-1]:.3g} s "
            f"({ends[-1] / time:.3g} time scales, {len(ends) - 1} of at most {flow.MAX_STEPS} steps)."
        )
    return fall


def _looks(
    model: CuttingModel, p: Parameters, dense: Callable[[np.ndarray], np.ndarray], ends: np.ndarray, time: float
) -> tuple[np.ndarray, _Functions, _Functions]:
    """Times, several in each step, with the event functions and their rates there."""
    counts = np.maximum(_SAMPLES, np.ceil(np.diff(ends) / (_LONGEST_STEP * time / _SAMPLES))).astype(int)
    pieces = zip(ends[:-1], ends[1:], counts, strict=True)
    t = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in pieces] + [ends[-1:]])
    values, rates, *_ = _looked(model, p, dense(t))
    return t, values, rates


def _looked(model: CuttingModel, p: Parameters, ys: np.ndarray) -> _Look:
    """`flow.look` at any number of y."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(ys)], flow.look(model, p, _padded(ys)))


def _padded(array: np.ndarray) -> np.ndarray:
    """The array, its last repeated: few lengths are ever compiled, and most cuts need the same one."""
    count = len(array)
    repeated = np.minimum(np.arange(1 << max(10, (count - 1).bit_length())), count - 1)
    return array[repeated] if count else array


def _trajectory(
    model: CuttingModel,
    p: Parameters,
    structure: Structure,
    t: np.ndarray,
    ys: np.ndarray,
    name: str,
    dense: Callable[[np.ndarray], np.ndarray],
) -> Trajectory:
    _, _, tip, removal_rate = _looked(model, dataclasses.replace(p, units=units_within(model, p)), ys)
    x_tip, depth, vx_tip, vdepth = tip
    return Trajectory(
        model=model,
        p=p,
        t=t,
        states=flow.state_of(structure, ys),
        x_tip=x_tip,
        depth=depth,
        vx_tip=vx_tip,
        vdepth=vdepth,
        removed=ys[:, -1],
        removal_rate=removal_rate,
        t_c=float(t[-1]),
        ended_by=name,
        volume=float(ys[-1, -1]),
        _interpolate=lambda t: flow.state_of(structure, dense(t)),
    )
