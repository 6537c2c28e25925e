"""One impact through diffrax: the whole motion, dense in time, with the end located exactly.

diffrax takes the steps. Where the cut ends is decided here, because an event search that
looks only at the ends of steps misses a tip that leaves and returns within a step, and one
that takes the first of several events in storage order picks the wrong end near a cusp.
"""

import dataclasses
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from erosion.model import CuttingModel, State, cuts_at_all, event_rates
from erosion.models import load_model, model_name
from erosion.parameters import QUANTITIES, Parameters, Quantity, validate
from erosion.precision import require_float64
from erosion.tables import Row, format_number, to_html, to_text
from erosion.units import unit_name

_MAX_STEPS = 4096
_SAMPLES = 8  # looks at the event functions within each step
_LONGEST_CUT = 1e4  # of the model's time scale; longer ones are reported, not waited for
_ATOL = 1e-40  # errors count relative to each quantity; this only keeps 0/0 away
_LONGEST_STEP = 0.05  # of the model's time scale: sampled 8 times, a cubic errs by 1e-10 or less


class SimulationError(RuntimeError):
    """An impact that could not be followed to its end."""


class TurnWarning(UserWarning):
    """The body turned so far that "the tip" is no longer one."""


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """One cut from contact to its end.

    Arrays have shape (points,) and run over times `t` from 0 to `t_c`, in the units of `p`.

    Args:
        model, p: what was simulated.
        t: times [s].
        x, y: displacement of the centre of mass [length]; y is positive into the target.
        phi: orientation [rad]; π/2 is upright.
        vx, vy: velocity of the centre of mass [speed].
        omega: φ̇ [rad/s].
        x_tip, depth: position of the cutting tip [length].
        vx_tip, vdepth: velocity of the tip [speed].
        removed: volume removed so far [volume].
        t_c: when the cut ends [s]; 0 where nothing is cut.
        ended_by: "rebound", "stop", "no-cut", or the name of a plug-in's event.
        volume: removed volume b ∫ depth dx_tip [volume].
        states: the model's own state over `t`, a pytree of arrays.
        at: state at any time(s) in [0, t_c], from the solver's dense output.
    """

    model: CuttingModel
    p: Parameters
    t: np.ndarray
    states: Any
    x_tip: np.ndarray
    depth: np.ndarray
    vx_tip: np.ndarray
    vdepth: np.ndarray
    removed: np.ndarray
    t_c: float
    ended_by: str
    volume: float
    _interpolate: Callable[[np.ndarray], Any] = dataclasses.field(repr=False)

    def at(self, t: Any) -> Any:
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
        return self._body().x

    @property
    def y(self) -> np.ndarray:
        return self._body().y

    @property
    def phi(self) -> np.ndarray:
        return self._body().phi

    @property
    def vx(self) -> np.ndarray:
        return self._body().vx

    @property
    def vy(self) -> np.ndarray:
        return self._body().vy

    @property
    def omega(self) -> np.ndarray:
        return self._body().omega

    @property
    def max_depth(self) -> float:
        """The tip's greatest depth on the grid of `t`, refined by a cubic [length]."""
        if len(self.t) < 2:
            return 0.0
        spline = CubicHermiteSpline(self.t, self.depth, self.vdepth)
        turning = [float(spline(t)) for t in spline.derivative().roots(extrapolate=False) if np.isfinite(t)]
        return max([float(self.depth.max()), *turning])

    @property
    def turn(self) -> float:
        """How far the body turned, φ(t_c) - φ(0) [rad]."""
        return float(self.phi[-1] - self.phi[0]) if isinstance(self.states, State) else math.nan

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of these numbers should know, as plain sentences."""
        greatest = np.abs(self.phi - self.phi[0]).max() if isinstance(self.states, State) else 0.0
        if greatest <= np.pi / 2:
            return ()
        return (
            f"The body turned by {np.rad2deg(greatest):.1f}° during the cut, more than 90°: the edge that cut "
            "first has left the surface, so the model's single tip no longer describes the contact.",
        )

    def rows(self) -> list[Row]:
        """The results as rows of a table."""
        return [
            result_row("t_c", self.t_c, self.p),
            Row("ended_by", "", self.ended_by, "", "how the cut ends"),
            result_row("volume", self.volume, self.p),
            result_row("max_depth", self.max_depth, self.p),
            result_row("turn", self.turn, self.p),
        ]

    def __str__(self) -> str:
        lines = [to_text(self._title(), self.rows()), *(f"warning: {line}" for line in self.warnings)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return to_html(self._title(), self.rows())

    def _title(self) -> str:
        return f"{model_name(self.model)} at α = {np.rad2deg(float(self.p.alpha)):.6g}°"

    def _body(self) -> State:
        if not isinstance(self.states, State):
            raise AttributeError(f"{type(self.model).__name__} keeps a state of its own: use `.states`.")
        return self.states


RESULTS = {
    "t_c": Quantity("t_c", "end of the cut", "time"),
    "volume": Quantity("V", "removed volume", "volume"),
    "dvolume": Quantity("dV/dα", "change of volume with angle", "volume per angle"),
    "d2volume": Quantity("d²V/dα²", "its own change with angle", "volume per angle²"),
    "max_depth": Quantity("d_max", "greatest depth of the tip", "length"),
    "turn": Quantity("Δφ", "how far the body turned", "angle"),
}


def result_row(name: str, value: Any, p: Parameters) -> Row:
    """One result as a table row, in the units of `p`."""
    quantity = RESULTS[name]
    unit = unit_name(quantity.dimension, p.units)
    return Row(name, quantity.symbol, format_number(value), unit, quantity.meaning)


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
        p: parameters, all scalars.
        points: times at which the histories are given, ≥ 2.
        rtol: relative tolerance of each step.
        solver: a diffrax solver with dense output, by default `Dopri8`.
        stepsize_controller: by default a PID controller at `rtol`; steps are bounded in any
            case to a twentieth of the model's time scale.

    Returns:
        The trajectory. Its end is the earliest fall of any event function through zero,
        located to 1e-12 relative; a tip that dips out and back within a step is seen.

    Raises:
        ValueError: for parameters out of range or not scalar.
        SimulationError: where the solver fails, or no event ends the cut.

    Warns:
        TurnWarning: where the body turned by more than π/2.
    """
    require_float64()
    model = load_model(model)
    validate(p)
    for name in QUANTITIES:
        if np.ndim(getattr(p, name)):
            raise ValueError(f"Argument `{name}` must be a scalar here, but has shape {np.shape(getattr(p, name))}.")
    if points < 2:
        raise ValueError(f"Argument `points` must be at least 2, but is {points}.")
    trajectory = _follow(model, p, diffrax.Dopri8() if solver is None else solver, stepsize_controller, rtol, points)
    for message in trajectory.warnings:
        warnings.warn(message, TurnWarning, stacklevel=2)
    return trajectory


def _follow(
    model: CuttingModel,
    p: Parameters,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractAdaptiveStepSizeController | None,
    rtol: float,
    points: int,
) -> Trajectory:
    begins, first, time = _begin(model, p)
    start = (first, jnp.zeros_like(time))
    if not begins:
        only = jax.tree.map(lambda leaf: leaf[None], start)
        return _trajectory(model, p, np.zeros(1), only, "no-cut", lambda t: _repeat(first, t))
    if controller is None:
        controller = diffrax.PIDController(rtol=rtol, atol=_ATOL, dtmax=_LONGEST_STEP * time)
    solution = _solve(model, p, solver, controller, start, 0.0 * time, _LONGEST_CUT * time)
    ends = np.asarray(solution.ts[0])
    ends = np.append(0.0, ends[np.isfinite(ends)])
    name, low, high = _bracket(model, p, solution, ends, float(time))

    # From the start of the step in which the cut ends, steps of full order to any time in it.
    begun = int(np.searchsorted(ends, low, side="right")) - 1
    before = start if begun == 0 else jax.tree.map(lambda leaf: leaf[begun - 1], solution.ys[0])

    def reach(t: float) -> Any:
        if t <= ends[begun]:
            return before
        there = _solve(model, p, solver, controller, before, jnp.asarray(ends[begun]), jnp.asarray(t)).ys[1]
        return jax.tree.map(lambda leaf: leaf[0], there)

    def event(t: float) -> float:
        return float(model.events(reach(t)[0], p)[name])

    t_c = _root(event, low, high)
    t = np.linspace(0.0, t_c, points)
    states = _interpolate(solution, jnp.asarray(t))
    # The ends of the histories are known better than the dense output gives them.
    states = jax.tree.map(lambda all_, last: all_.at[-1].set(last), states, reach(t_c))
    return _trajectory(model, p, t, states, name, lambda t: _interpolate(solution, jnp.asarray(t))[0])


def _bracket(
    model: CuttingModel, p: Parameters, solution: diffrax.Solution, ends: np.ndarray, time: float
) -> tuple[str, float, float]:
    """The event that ends the cut and times between which it falls through zero, once."""
    counts = np.maximum(_SAMPLES, np.ceil(np.diff(ends) / (_LONGEST_STEP * time / _SAMPLES))).astype(int)
    pieces = zip(ends[:-1], ends[1:], counts, strict=True)
    t = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in pieces] + [ends[-1:]])
    # Padded to a power of two, so that few lengths are ever compiled.
    padded = np.append(t, np.full((1 << (len(t) - 1).bit_length()) - len(t), t[-1]))
    values, rates, _ = _look(model, p, _interpolate(solution, jnp.asarray(padded))[0])
    found: list[tuple[float, float, str]] = []
    for name in values:
        value, rate = np.array(values[name])[: len(t)], np.asarray(rates[name])[: len(t)]
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(rate))):
            raise SimulationError(f"{model_name(model)}: the motion is not finite after {_last_finite(t, value):g} s.")
        value[0] = max(value[0], np.finfo(float).tiny)  # rises from contact, `cuts_at_all` has checked
        falls = np.flatnonzero(value[1:] <= 0)
        # A dip between two looks: down at the first, up at the second, and a cubic below zero.
        dips = np.flatnonzero((rate[:-1] < 0) & (rate[1:] > 0) & (value[1:] > 0) & (value[:-1] > 0))
        found += [(t[i], t[i + 1], name) for i in falls[:1]]
        for i in dips:
            spline = CubicHermiteSpline(t[i : i + 2], value[i : i + 2], rate[i : i + 2])
            lowest = min(spline.derivative().roots(extrapolate=False), key=spline, default=t[i])
            if spline(lowest) <= 0:
                found.append((t[i], float(lowest), name))
                break
    if not found:
        raise SimulationError(
            f"{model_name(model)}: no event ended the cut within {ends[-1]:.3g} s "
            f"({ends[-1] / time:.3g} time scales, {len(ends) - 1} steps)."
        )
    # Two events may fall between the same two looks: the cubics tell which is first.
    first = min(low for low, _, _ in found)
    rivals = [f for f in found if f[0] == first]
    if len(rivals) > 1:
        i = int(np.searchsorted(t, first))
        rivals.sort(key=lambda f: _cubic_root(t[i : i + 2], values[f[2]][i : i + 2], rates[f[2]][i : i + 2], f[1]))
    low, high, name = rivals[0]
    return name, float(low), float(high)


def _trajectory(
    model: CuttingModel, p: Parameters, t: np.ndarray, states: Any, name: str, interpolate: Callable[[Any], Any]
) -> Trajectory:
    bodies, removed = jax.tree.map(np.asarray, states)
    tip = jax.tree.map(np.asarray, _look(model, p, bodies)[2])
    return Trajectory(
        model=model,
        p=p,
        t=t,
        states=bodies,
        x_tip=tip.x,
        depth=tip.depth,
        vx_tip=tip.vx,
        vdepth=tip.vdepth,
        removed=removed,
        t_c=float(t[-1]),
        ended_by=name,
        volume=float(removed[-1]),
        _interpolate=interpolate,
    )


@eqx.filter_jit
def _solve(
    model: CuttingModel,
    p: Parameters,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController,
    start: tuple[Any, Any],
    t0: Any,
    t1: Any,
) -> diffrax.Solution:
    """Integrate (state, volume) from `t0` until `t1`, or the first step that ends past an event."""
    time = model.scales(p).time

    def rate(t: Any, y: Any, args: Any) -> Any:
        return model.derivative(y[0], p), model.removal_rate(y[0], p)

    # A boolean condition only tells diffrax when to stop stepping; the names are its own.
    def past_the_end(t: Any, y: Any, args: Any, **kwargs: Any) -> Any:
        return (t > t0) & (_least(model.events(y[0], p)) <= 0)

    return diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        solver,
        t0=t0,
        t1=t1,
        dt0=jnp.minimum(0.01 * time, t1 - t0),
        y0=start,
        saveat=diffrax.SaveAt(subs=(diffrax.SubSaveAt(steps=True), diffrax.SubSaveAt(t1=True)), dense=True),
        stepsize_controller=controller,
        event=diffrax.Event(past_the_end),
        max_steps=_MAX_STEPS,
        throw=False,
    )


@eqx.filter_jit
def _begin(model: CuttingModel, p: Parameters) -> Any:
    return cuts_at_all(model, p), model.initial_state(p), model.scales(p).time


@eqx.filter_jit
def _interpolate(solution: diffrax.Solution, times: Any) -> Any:
    return jax.vmap(solution.evaluate)(times)


@eqx.filter_jit
def _look(model: CuttingModel, p: Parameters, states: Any) -> Any:
    """Event functions, their rates, the tip and its removal rate in many states."""

    def one(state: Any) -> Any:
        values, rates = event_rates(model, state, model.derivative(state, p), p)
        return values, rates, model.tip(state, p)

    return jax.vmap(one)(states)


def _root(event: Callable[[float], float], low: float, high: float) -> float:
    """Where `event` falls through zero in (low, high], to a few ulp."""
    if event(high) > 0:  # a graze that only the cubic saw: its lowest point is the end
        return high
    # At contact an event may be zero and rising; brentq must not find that root.
    while low == 0.0 or event(low) <= 0:
        trial = low + (high - low) / 16
        if event(trial) <= 0:
            high = trial
        else:
            low = trial
    return float(brentq(event, low, high, xtol=1e-15 * high, rtol=8 * np.finfo(float).eps))


def _cubic_root(t: np.ndarray, values: Any, rates: Any, latest: float) -> float:
    spline = CubicHermiteSpline(t, np.asarray(values), np.asarray(rates))
    return min((float(r) for r in spline.roots(extrapolate=False) if t[0] < r <= t[1]), default=latest)


def _last_finite(t: np.ndarray, value: np.ndarray) -> float:
    finite = np.flatnonzero(np.isfinite(value))
    return float(t[finite[-1]]) if len(finite) else 0.0


def _repeat(state: Any, t: np.ndarray) -> Any:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, t.shape), state)


def _least(values: dict[str, Any]) -> Any:
    return jnp.min(jnp.stack(list(values.values())))
