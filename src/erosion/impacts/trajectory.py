"""One impact with the histories of its motion: `simulate` by diffrax, `path` by `erosion.ode`.

diffrax takes the steps. Where the cut ends is decided here, because an event search that
looks only at the ends of steps misses a tip that leaves and returns within a step, and one
that takes the first of several events in storage order picks the wrong end near a cusp.
"""

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

import erosion.impacts.diffrax_steps as flow
from erosion.arguments import ModelState, Structure, check_share, check_whole, refuse
from erosion.correlations.ranges import OutOfRangeWarning
from erosion.impacts.batch import OTHER_ENDS, element_of, end_names, signature_of, split, tip_at
from erosion.impacts.diffrax_steps import Fall, find_root, first_fall
from erosion.impacts.turn import pushed_forward
from erosion.models import (
    NO_CUT,
    CuttingModel,
    State,
    impact_to_dict,
    load_model,
    model_name,
    require_one_impact,
)
from erosion.ode.batch import integrate
from erosion.ode.ensemble import path_of
from erosion.ode.signature import Clock
from erosion.ode.step_control import LONGEST, require_float64, require_xla
from erosion.output import Record, briefly
from erosion.parameters import Parameters, declare_result, validate
from erosion.results import Finding, Result, System, Value

TURNED_BEYOND = "turned_beyond"
"""The code of the finding on a body that turned by more than 90°."""


class SimulationError(RuntimeError):
    """An impact that could not be followed to its end."""


class TurnWarning(UserWarning):
    """The body turned so far that "the tip" is no longer one."""


_WARNINGS: Mapping[str, type[Warning]] = {TURNED_BEYOND: TurnWarning, "pushed_forward": UserWarning}


@dataclasses.dataclass(frozen=True, repr=False)
class Trajectory(Result):
    """One cut from contact to its end.

    Arrays have shape (points,) and run over times `t` from 0 to `t_c`.

    Args:
        model, p: what was simulated.
        t: times [s].
        x, y: displacement of the centre of mass [m]; y is positive into the target.
        phi: orientation [rad]; π/2 is upright.
        vx, vy: velocity of the centre of mass [m/s].
        omega: φ̇ [rad/s].
        x_tip, depth: position of the cutting tip [m].
        vx_tip, vdepth: velocity of the tip [m/s].
        removed: volume removed so far [m³]; the first is what is removed at contact.
        removal_rate: dV/dt [m³/s].
        t_c: when the cut ends [s]; 0 where nothing is cut.
        ended_by: "rebound", "stop", "no-cut", or the name of a plug-in's event.
        volume: removed volume [m³], b ∫ depth dx_tip and what is removed at contact.
        states: the model's own state over `t`, a pytree of arrays.
        dvolume: dV/dα [m³/rad], where it was computed.
        at: state at any time(s) in [0, t_c].
    """

    model: CuttingModel
    p: Parameters
    t: np.ndarray
    states: ModelState
    x_tip: np.ndarray
    depth: np.ndarray
    vx_tip: np.ndarray
    vdepth: np.ndarray
    removed: np.ndarray
    removal_rate: np.ndarray
    t_c: float
    ended_by: str
    volume: float
    _interpolate: Callable[[np.ndarray], ModelState] = dataclasses.field(repr=False)
    dvolume: float | None = None

    def at(self, t: ArrayLike) -> ModelState:
        """The state at time(s) `t` [s].

        Raises:
            ValueError: for a time outside [0, t_c].
        """
        times = np.asarray(t, dtype=float)
        if not np.all((times >= 0) & (times <= self.t_c)):
            raise ValueError(f"Argument `t` must be in [0, t_c] = [0, {self.t_c:.12g}] s, but is {t}.")
        flat = self._interpolate(times.reshape(-1))
        return jax.tree.map(lambda leaf: np.asarray(leaf).reshape(times.shape)[()], flat)

    @property
    def x(self) -> np.ndarray:
        """Displacement of the centre of mass along the surface [m]."""
        return np.asarray(self._body().x)

    @property
    def y(self) -> np.ndarray:
        """Displacement of the centre of mass into the target [m]."""
        return np.asarray(self._body().y)

    @property
    def phi(self) -> np.ndarray:
        """Orientation [rad]; π/2 is upright."""
        return np.asarray(self._body().phi)

    @property
    def vx(self) -> np.ndarray:
        """Velocity of the centre of mass along the surface [m/s]."""
        return np.asarray(self._body().vx)

    @property
    def vy(self) -> np.ndarray:
        """Velocity of the centre of mass into the target [m/s]."""
        return np.asarray(self._body().vy)

    @property
    def omega(self) -> np.ndarray:
        """Spin φ̇ [rad/s]."""
        return np.asarray(self._body().omega)

    @property
    def volume_at_contact(self) -> float:
        """The volume removed at contact by deformation, beside the cut [m³]."""
        return float(self.removed[0])

    @property
    def max_depth(self) -> float:
        """The tip's greatest depth on the grid of `t`, refined by a cubic [m]."""
        if len(self.t) < 2:
            return 0.0
        # In shares of t_c and of the depth, whose powers neither overflow nor vanish.
        step = np.diff(self.t / self.t_c)
        deepest = max(float(self.depth.max()), self.t_c * float(np.abs(self.vdepth[:-1] * step).max()))
        depth = self.depth / deepest
        from_, to = (step * (rate * (self.t_c / deepest)) for rate in (self.vdepth[:-1], self.vdepth[1:]))
        # The cubic of each step, and where its derivative a θ² + b θ + from vanishes.
        a, b = 3 * (from_ + to - 2 * np.diff(depth)), 2 * (3 * np.diff(depth) - 2 * from_ - to)
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(b * b - 4 * a * from_), b)) / 2
            theta = np.stack([q / a, from_ / q])
            values = depth[:-1] + theta * (from_ + theta * (b / 2 + theta * (a / 3)))
        turning = values[(theta > 0) & (theta < 1)]
        return deepest * float(np.max(turning, initial=depth.max()))

    @property
    def turn(self) -> float:
        """How far the body turned, `|φ(t_c) - φ(0)|` [rad]."""
        return abs(float(self.phi[-1] - self.phi[0])) if isinstance(self.states, State) else math.nan

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A force of the wrong sign, a body that turned too far, and a case out of the model's range."""
        pushed = Finding("pushed_forward") if pushed_forward(self.model, self.p) else None
        found = (pushed, self._turned_beyond, self.model.outside_of_range(self.p))
        return tuple(finding for finding in found if finding is not None)

    @property
    def turned_beyond(self) -> bool:
        """Whether the body turned by more than 90°, where the model does not hold."""
        return self._turned_beyond is not None

    @property
    def _turned_beyond(self) -> Finding | None:
        greatest = np.abs(self.phi - self.phi[0]).max() if isinstance(self.states, State) else 0.0
        return None if greatest <= np.pi / 2 else Finding(TURNED_BEYOND, numbers={"turn": greatest})

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Value]:
        """When and how the cut ends, and what it removes; of a model with a state of its own its parts at the end."""
        at_contact = self.volume_at_contact
        is_rigid = isinstance(self.states, State)
        state = self._own_state()
        return [
            declare_result("t_c", self.t_c),
            Value("ended_by", self.ended_by, meaning="how the cut ends"),
            declare_result("volume", self.volume),
            declare_result("volume_at_contact", at_contact, only="" if at_contact else "data"),
            declare_result("dvolume", self.dvolume),
            declare_result("max_depth", self.max_depth),
            *([declare_result("turn", self.turn)] if is_rigid else []),
            *([Value("state", [*state.values()], meaning="of the model's own state, at the end", labels=[*state])]
              if state else []),
        ]  # fmt: skip

    def _own_state(self) -> dict[str, np.ndarray]:
        """Each part of a state of the model's own, at the end; none of a rigid body."""
        parts = [] if isinstance(self.states, State) else jax.tree_util.tree_flatten_with_path(self.states)[0]
        return {".".join(path_of(keys)) or "state": values[-1] for keys, values in parts}

    @property
    def title(self) -> str:
        """The model and the angle of attack."""
        return f"{model_name(self.model)}: one impact at α = {np.rad2deg(float(self.p.alpha)):.6g}°"

    @property
    def subject(self) -> Record:
        """The model and the case."""
        return impact_to_dict(self.model, self.p)

    def _body(self) -> State:
        if not isinstance(self.states, State):
            raise AttributeError(f"{type(self.model).__name__} keeps a state of its own: use `.states`.")
        return self.states


_SAMPLES = 8  # looks at the event functions within each step
_ATOL = 1e-15  # of each quantity's size: rounding
_LONGEST_STEP = 0.05  # of the model's time scale: sampled 8 times, a cubic errs by 1e-10 or less

_Functions = dict[str, np.ndarray]


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
    require_one_impact(model, p, "; for many impacts use `erosion.impact`")
    rtol, points = check_share("rtol", rtol), check_whole("points", points, 2)
    for name, given, kind in (
        ("solver", solver, diffrax.AbstractSolver),
        ("stepsize_controller", stepsize_controller, diffrax.AbstractAdaptiveStepSizeController),
    ):
        if given is not None and not isinstance(given, kind):
            raise TypeError(f"Argument `{name}` must be a diffrax.{kind.__name__}, but is {briefly(given)}.")
    trajectory = _follow(model, p, diffrax.Dopri8() if solver is None else solver, stepsize_controller, rtol, points)
    for finding in trajectory.findings:
        warnings.warn(finding.text, _WARNINGS.get(finding.code, OutOfRangeWarning), stacklevel=2)
    return trajectory


def _follow(
    model: CuttingModel,
    p: Parameters,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractAdaptiveStepSizeController | None,
    rtol: float,
    points: int,
) -> Trajectory:
    given, p = p, p.to("si")
    structure = flow.layout(model, p)
    begins, start, sizes, time = flow.begin(model, p)
    if not np.all(np.isfinite(start)):
        raise SimulationError(f"{model_name(model)}: state and volume are not finite at contact.")
    if not begins:
        ys = np.asarray(start)[None]
        return _trajectory(model, given, structure, np.zeros(1), ys, NO_CUT, functools.partial(_at_rest, ys))
    if controller is None:
        controller = diffrax.PIDController(rtol=rtol, atol=_ATOL, dtmax=_LONGEST_STEP * time)
    # Numpy from here: JAX would compile a program for every number of steps.
    problem = flow.DiffraxProblem(model, p, solver, controller, sizes)
    ends, states, _, interpolant = flow.solve(problem, start, 0.0 * time, LONGEST * time)
    ends = np.asarray(ends)
    ends = np.append(0.0, ends[np.isfinite(ends)])
    dense = functools.partial(_interpolated, solver, interpolant, sizes)
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


# Functions of the module, as a trajectory keeps them and is pickled.
def _at_rest(ys: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.repeat(ys, len(t), 0)


def _interpolated(solver: diffrax.AbstractSolver, interpolant: flow.Dense, sizes: Array, t: np.ndarray) -> np.ndarray:
    return np.asarray(flow.interpolate(solver, interpolant, sizes, _padded(t)))[: len(t)]


def _as_states(states: ModelState, dense: Callable[[np.ndarray], np.ndarray], t: np.ndarray) -> ModelState:
    return flow.state_of(jax.tree.structure(states), dense(t))


def _integrated(model: CuttingModel, p: Parameters, t: np.ndarray) -> np.ndarray:
    return _end_and_states(model, p, t)[1]


def _first_event(
    model: CuttingModel, p: Parameters, dense: Callable[[np.ndarray], np.ndarray], ends: np.ndarray, time: float
) -> Fall:
    """The event that ends the cut, from looks within the steps, which end at `ends`."""
    t, values, rates = _looks(model, p, dense, ends, time)
    try:
        fall = first_fall(t, values, rates)
    except ArithmeticError as error:
        raise SimulationError(f"{model_name(model)}: {error}.") from error
    refuse(
        f"{model_name(model)}: no ",
        (len(ends) == 1, "first step could be taken: the motion is not finite at contact."),
        (fall is None, f"event ended the cut within {ends[-1]:.3g} s ({ends[-1] / time:.3g} time scales, "
                       f"{len(ends) - 1} of at most {flow.MAX_STEPS} steps).{_pushed(model, p)}"),
        kind=SimulationError,
    )  # fmt: skip
    assert fall is not None
    return fall


def _pushed(model: CuttingModel, p: Parameters) -> str:
    """A sentence on a force that pushes a body forward; empty for any other."""
    return f" {Finding('pushed_forward').text}" if pushed_forward(model, p) else ""


def _looks(
    model: CuttingModel, p: Parameters, dense: Callable[[np.ndarray], np.ndarray], ends: np.ndarray, time: float
) -> tuple[np.ndarray, _Functions, _Functions]:
    """Times, several in each step, with the event functions and their rates there."""
    counts = np.maximum(_SAMPLES, np.ceil(np.diff(ends) / (_LONGEST_STEP * time / _SAMPLES))).astype(int)
    pieces = zip(ends[:-1], ends[1:], counts, strict=True)
    t = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in pieces] + [ends[-1:]])
    seen = flow.events(model, p, _padded(dense(t)))
    return t, *jax.tree.map(lambda leaf: np.asarray(leaf)[: t.size], seen)


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
    x_tip, depth, vx_tip, vdepth, removal_rate = tip_at(model, p, ys)
    states = flow.state_of(structure, ys)
    return Trajectory(
        model=model,
        p=p,
        t=t,
        states=states,
        x_tip=x_tip,
        depth=depth,
        vx_tip=vx_tip,
        vdepth=vdepth,
        removed=ys[:, -1],
        removal_rate=removal_rate,
        t_c=float(t[-1]),
        ended_by=name,
        volume=float(ys[-1, -1]),
        _interpolate=functools.partial(_as_states, states, dense),
    )


_RTOL = 1e-12


def path(model: CuttingModel, p: Parameters, points: int = 201) -> Trajectory:
    """Follow one impact from contact to the end of the cut, with dV/dα.

    `erosion.simulate` gives the same by diffrax; arguments are not checked here.

    Raises:
        SimulationError: where the impact fails or does not end.
    """
    require_float64()
    (outcome, t_c, dvolume), _ = _end_and_states(model, p, np.zeros(0))
    name = end_names(model)[outcome]
    if name in OTHER_ENDS and name != NO_CUT:
        raise SimulationError(f"{model_name(model)}: {OTHER_ENDS[name]}.{_pushed(model, p)}")
    dense = functools.partial(_integrated, model, p)
    t = np.linspace(0.0, t_c, points) if name != NO_CUT else np.zeros(1)
    trajectory = _trajectory(model, p, flow.layout(model, p), t, dense(t), name, dense)
    return dataclasses.replace(trajectory, dvolume=dvolume)


def _end_and_states(model: CuttingModel, p: Parameters, t: np.ndarray) -> tuple[tuple[int, float, float], np.ndarray]:
    """How and when one cut ends, and dV/dα; the vectors `y` of its motion at times up to there."""
    signature, (_, parameters) = signature_of(model, p, reports_state=True), split(model, p)
    clock = Clock(t0=0.0, t1=np.inf, max_step=np.inf, max_events=np.inf)
    rising, places = np.unique(t, return_inverse=True)
    alpha = element_of(model, "alpha")
    end = integrate(
        signature, [*parameters, *map(np.asarray, clock)], 1, 1, (alpha,), _RTOL, refines=False, times=rising
    )
    # After the state comes the volume, and after that what the model itself integrates.
    volume = len(end.outputs.value) - len(signature.problem.integrals)
    at_the_end, t_c = np.concatenate(end.outputs.value[: volume + 1]), end.time.value[0]
    first, saved = np.array(end.outputs.by_first), np.asarray(end.saved)
    ys = np.where(t[:, None] < t_c, saved[0, places, 0, : volume + 1], at_the_end)
    return (int(end.outcome[0]), float(t_c), float(first[volume][0])), ys
