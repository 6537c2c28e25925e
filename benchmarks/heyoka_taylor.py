"""heyoka's `taylor_adaptive`, and the equations, initial states and derivatives for its batch, too.

The equations are the engine's without units (time in 1/ω, length in v0/ω) and without x,
which neither volume nor events need; the turn q = φ - π/2 is carried in place of φ.

A start at depth exactly 0 loses an event within the first step (heyoka 7.13.2: about 1 lane in
1,000, the shortest cuts). A depth of 1e-300 does not, and changes no other digit.

The derivatives with respect to α enter by the initial state alone. `var_ode_sys` with a
parameter that no equation contains gives one direction, 18 equations, not the 36 of (ẋ, ẏ).
"""

from collections.abc import Callable
from typing import Any

import heyoka as hy
import numpy as np

from benchmarks.work import NO_CUT, REBOUND, STOP, Answers, Constants, Work, constants

TOLERANCE = 1e-9  # 99 % of the volumes are then right to 2e-9
_NOTHING = 1e-300  # depth at contact
_LATE = 1e3  # no cut is longer [1/ω]
SIZE = 6  # y, q, ẋ, ẏ, q̇, V


def equations(c: Constants, order: int) -> tuple[Any, list[Any], list[float]]:
    """The system, the event functions and the parameters."""
    y, q, vx, vy, omega, volume = hy.make_vars("y", "q", "vx", "vy", "omega", "volume")
    rho, by_k, by_inertia = hy.par[0], hy.par[1], hy.par[2]
    cosine = hy.cos(q)
    depth = y - rho * (1.0 - cosine)
    speed = vx + rho * omega * cosine
    system: Any = [
        (y, vy),
        (q, omega),
        (vx, -by_k * depth),
        (vy, -depth),
        (omega, -by_inertia * depth),
        (volume, depth * speed),
    ]
    if order:
        system = hy.var_ode_sys(system, args=[hy.par[3]], order=order)
    return system, [depth, speed], [c.rho, 1 / c.k, 1 / (c.k * c.rho * c.beta)]


def initial_states(work: Work, c: Constants, order: int) -> np.ndarray:
    """State at contact and its derivatives with respect to α, of shape (lanes, size)."""
    sine, cosine = np.sin(work.alpha), np.cos(work.alpha)
    states = np.zeros((len(work), SIZE * (1 + order)))
    states[:, 0] = _NOTHING
    states[:, 4] = work.s / c.rho
    for i, (vx, vy) in enumerate(((cosine, sine), (-sine, cosine), (-cosine, -sine))[: 1 + order]):
        states[:, SIZE * i + 2], states[:, SIZE * i + 3] = vx, vy
    return states


def answers(work: Work, c: Constants, order: int, end: np.ndarray) -> Answers:
    """Volumes and derivatives from the states at the end of the cuts."""
    cut = work.cutting()
    columns = [np.zeros(len(work)) for _ in range(1 + order)]
    code = np.full(len(work), NO_CUT)
    y, q, vx, vy, omega, volume = end[:, :SIZE].T
    sine, cosine = np.sin(q), np.cos(q)
    depth, speed = y - c.rho * (1 - cosine), vx + c.rho * omega * cosine
    rebound = np.abs(depth) < np.abs(speed)
    code[cut] = np.where(rebound, REBOUND, STOP)
    columns[0][cut] = c.volume * volume
    if order:
        y1, q1, vx1, _, omega1, volume1 = end[:, SIZE : 2 * SIZE].T
        depth1 = y1 - c.rho * sine * q1
        speed1 = vx1 + c.rho * (omega1 * cosine - omega * sine * q1)
        sink = vy - c.rho * sine * omega
        brake = -depth / c.k * (1 + cosine / c.beta) - c.rho * omega**2 * sine
        dt_c = np.where(rebound, -depth1 / sink, -speed1 / brake)
        columns[1][cut] = c.volume * volume1
        # d²V/dα² at a fixed time, and what the end's own motion adds.
        columns[2][cut] = c.volume * (end[:, -1] + (depth1 * speed + depth * speed1) * dt_c)
    return Answers(columns[0], code, *columns[1:])


def prepare(work: Work, order: int = 0, tol: float = TOLERANCE) -> Callable[[], Answers]:
    """One integrator, one impact after another, as its manual shows."""
    c = constants()
    system, events, parameters = equations(c, order)
    falling = hy.event_direction.negative
    integrator = hy.taylor_adaptive(
        system,
        [0.0] * SIZE,
        pars=parameters,
        tol=tol,
        fast_math=True,
        t_events=[hy.t_event(event, direction=falling) for event in events],
    )
    starts = initial_states(work, c, order)[work.cutting()]
    end = np.empty_like(starts)

    def run() -> Answers:
        state, propagate, reset = integrator.state, integrator.propagate_until, integrator.reset_cooldowns
        for i in range(len(starts)):
            state[:] = starts[i]
            integrator.time = 0.0
            reset()
            propagate(_LATE)
            end[i] = state
        return answers(work, c, order, end)

    return run
