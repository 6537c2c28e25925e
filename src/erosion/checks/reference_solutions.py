"""Reference solutions: the equations of docs/physics.md typed a second time, solved by scipy and heyoka.

Lengths are in v₀/ω and times in 1/ω, with ω = √(c/m); q = φ - π/2. They share nothing with
the classes of the registered models, the engines or the events.
"""

import dataclasses
import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.integrate import solve_ivp

import erosion.impacts.diffrax_steps as flow
from erosion.models import NO_CUT, CuttingModel, own_quantities
from erosion.parameters import Parameters

_LATEST = 1e3  # [1/ω]; no cut of the cases is longer
_LONGEST_STEP = 0.05  # [1/ω], so that no step passes over an event
_FIRST_DEPTH = 1e-300  # depth at contact: from exactly 0 heyoka 7.13 loses events within its first step

Term = Any
"""A number, or an expression of heyoka's."""

_Function = Callable[[np.ndarray], Sequence[float] | np.ndarray]


class ReferenceSolution(NamedTuple):
    """A cut as another solver computes it: volume [m³], end [s], the event that ended it, own quantities."""

    volume: float
    t_c: float
    ended_by: str
    own: Mapping[str, float] = {}


class _ReferenceMotion(NamedTuple):
    """Names of a model's parts: the position of the tip, the force ratio K, the moment that turns the body.

    Normal motion removes its energy over `energy_ratio` σψ as well.
    """

    tip: str
    ratio: str
    torque: str
    energy_ratio: float = math.inf


# K = ẏ/ẋ is 0/0 at the end of the cut, but d(ẏ/ẋ)/dt = 0: it is tan α throughout.
EQUATIONS_OF: Mapping[str, _ReferenceMotion] = {
    "linearized": _ReferenceMotion("centre", "k", "none"),
    "tan-alpha": _ReferenceMotion("centre", "tan α", "none"),
    "velocity-aligned": _ReferenceMotion("centre", "tan α", "none"),
    "finnie": _ReferenceMotion("first order", "k", "horizontal"),
    "rotating": _ReferenceMotion("circle", "k", "horizontal"),
    "rotating-full-torque": _ReferenceMotion("circle", "k", "full"),
    "rotating-tan-alpha": _ReferenceMotion("circle", "tan α", "horizontal"),
    "rotating-velocity-aligned": _ReferenceMotion("circle", "tan α", "horizontal"),
    "rotating-tan-alpha-full-torque": _ReferenceMotion("circle", "tan α", "full"),
    "rotating-velocity-aligned-full-torque": _ReferenceMotion("circle", "tan α", "full"),
    "as-printed": _ReferenceMotion("printed", "k", "printed"),
    "linearized-deformation": _ReferenceMotion("centre", "k", "none", energy_ratio=1.6),
    "finnie-deformation": _ReferenceMotion("first order", "k", "horizontal", energy_ratio=4.8),
    "rotating-deformation": _ReferenceMotion("circle", "k", "horizontal", energy_ratio=4.8),
}


@dataclasses.dataclass(frozen=True)
class ReferenceEquations:
    """A registered model's equations in numbers, or in any algebra that has sine and cosine.

    The state is (y, q, ẋ, ẏ, q̇, V).

    Args:
        motion: the model's parts.
        ratio, size, turning: K, rω/v₀ and 1/(β rω/v₀).
        sin, cos: of the algebra.
    """

    motion: _ReferenceMotion
    ratio: Term
    size: Term
    turning: Term
    sin: Callable[[Term], Term] = math.sin
    cos: Callable[[Term], Term] = math.cos

    def rates(self, state: Sequence[Term] | np.ndarray) -> list[Term]:
        """d(state)/dt."""
        y, q, _, vy, spin, _ = state
        # sin φ = cos q, cos φ = -sin q.
        sine, cosine = self.cos(q), -self.sin(q)
        depth, speed = self.events(state)
        pressed = y - self.size * sine if self.motion.tip == "printed" else depth
        torque = {
            "none": 0 * y,
            "horizontal": -pressed,
            "full": -pressed * (sine + self.ratio * cosine),
            "printed": -y,
        }[self.motion.torque]
        return [vy, spin, -pressed, -self.ratio * pressed, self.turning * torque, depth * speed]

    def events(self, state: Sequence[Term] | np.ndarray) -> list[Term]:
        """The tip's depth (rebound) and horizontal velocity (stop)."""
        y, q, vx, _, spin, _ = state
        if self.motion.tip == "circle":
            sine = self.cos(q)
            return [y - self.size * (1 - sine), vx + self.size * spin * sine]
        return [y, vx + self.size * spin if self.motion.tip == "first order" else vx]


def scipy_solution(name: str, p: Parameters) -> ReferenceSolution:
    """A registered model's cut by scipy."""
    equations = ReferenceEquations(EQUATIONS_OF[name], *_numbers(name, p))
    time, state, event = _by_scipy(equations.rates, equations.events, np.array(_start(p)))
    return _in_units(name, p, time, state[-1], event)


def scipy_solution_of_model(model: CuttingModel, p: Parameters) -> ReferenceSolution:
    """Any model's cut by scipy, own quantities included, from its own methods: a plug-in has no other equations."""
    cuts, start, sizes, time = flow.begin(model, p)
    if not cuts:
        return ReferenceSolution(float(start[-1]), 0.0, NO_CUT, dict.fromkeys(own_quantities(type(model)), 0.0))
    structure, own = flow.layout(model, p), list(own_quantities(type(model)))
    names = list(model.events(flow.state_of(structure, start), p))

    def own_rates(y: Array | np.ndarray) -> Array:
        state = flow.state_of(structure, y)
        return jnp.asarray([time * getattr(model, name)(state, p) for name in own])

    largest = np.maximum(*(np.abs(own_rates(y)) for y in (start, sizes)))
    own_sizes = np.where(largest > 0, largest, 1.0)

    @jax.jit
    def rates(y: Array | np.ndarray) -> Array | np.ndarray:
        y = y[: len(sizes)] * sizes
        state = flow.state_of(structure, y)
        rate = *jax.tree.leaves(model.derivative(state, p)), model.removal_rate(state, p)
        return jnp.concatenate([time * jnp.stack(rate) / sizes, own_rates(y) / own_sizes])

    @jax.jit
    def events(y: Array | np.ndarray) -> Array | np.ndarray:
        values = model.events(flow.state_of(structure, y[: len(sizes)] * sizes), p)
        return jnp.stack([values[name] for name in names])

    def numbers(function: Callable[[np.ndarray], Array | np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda state: np.asarray(function(state))

    t, state, event = _by_scipy(numbers(rates), numbers(events), np.append(start / sizes, np.zeros(len(own))))
    removed, *quantities = state[len(sizes) - 1 :] * np.append(sizes[-1], own_sizes)
    return ReferenceSolution(float(removed), float(t * time), names[event], dict(zip(own, quantities, strict=True)))


def _by_scipy(rates: _Function, events: _Function, start: np.ndarray) -> tuple[float, np.ndarray, int]:
    """The time of the first event, the state then, and the number of the event."""

    def falling(i: int) -> Callable[[float, np.ndarray], float]:
        def event(t: float, state: np.ndarray) -> float:
            return events(state)[i]

        event.terminal, event.direction = True, -1.0  # pyrefly: ignore
        return event

    solution = solve_ivp(
        lambda t, state: rates(state),
        (0, _LATEST),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        max_step=_LONGEST_STEP,
        events=[falling(i) for i in range(len(events(start)))],
    )
    events_reached = [i for i, times in enumerate(solution.t_events) if len(times)]
    if not events_reached:
        raise ArithmeticError(f"scipy's DOP853 found no end of the cut: {solution.message}")
    return float(solution.t[-1]), solution.y[:, -1], events_reached[0]


def heyoka_solutions(name: str, cases: Sequence[Parameters]) -> list[ReferenceSolution]:
    """A registered model's cuts by heyoka: a Taylor series, whose events are isolated roots."""
    import heyoka as hy

    state = hy.make_vars("y", "q", "vx", "vy", "spin", "volume")
    equations = ReferenceEquations(EQUATIONS_OF[name], hy.par[0], hy.par[1], hy.par[2], hy.sin, hy.cos)
    falling = hy.event_direction.negative
    integrator: Any = hy.taylor_adaptive(
        list(zip(state, equations.rates(state), strict=True)),
        [0.0] * len(state),
        tol=1e-15,
        t_events=[hy.t_event(event, direction=falling) for event in equations.events(state)],
    )

    def cut(p: Parameters) -> ReferenceSolution:
        integrator.state[:] = _start(p)
        # heyoka has no places for parameters that the equations do not contain.
        integrator.pars[:] = _numbers(name, p)[: len(integrator.pars)]
        integrator.time = 0.0
        integrator.reset_cooldowns()
        outcome = integrator.propagate_until(_LATEST)[0]
        # heyoka numbers terminal events from -1 downwards.
        return _in_units(name, p, integrator.time, integrator.state[-1], -int(outcome) - 1)

    return [cut(p) for p in cases]


def has_heyoka() -> bool:
    """Whether heyoka is installed."""
    return importlib.util.find_spec("heyoka") is not None


def _numbers(name: str, p: Parameters) -> tuple[float, float, float]:
    ratio = float(p.k) if EQUATIONS_OF[name].ratio == "k" else math.tan(float(p.alpha))
    size = float(p.r) * _rate(p) / float(p.v0)
    return ratio, size, 1 / (float(p.inertia) * size)


def _start(p: Parameters) -> list[float]:
    alpha = float(p.alpha)
    return [_FIRST_DEPTH, 0.0, math.cos(alpha), math.sin(alpha), float(p.phidot0) / _rate(p), 0.0]


def _in_units(name: str, p: Parameters, time: float, volume: float, event: int) -> ReferenceSolution:
    length = float(p.v0) / _rate(p)
    normal_energy = float(p.m) * (float(p.v0) * math.sin(float(p.alpha))) ** 2 / 2
    deformed = normal_energy / (EQUATIONS_OF[name].energy_ratio * float(p.sigma) * float(p.psi))
    removed = float(p.b) * length**2 * volume + deformed
    return ReferenceSolution(removed, time / _rate(p), ("rebound", "stop")[event])


def _rate(p: Parameters) -> float:
    return math.sqrt(float(p.stiffness) / float(p.m))
