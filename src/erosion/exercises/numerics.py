"""The numerical course: fixed steps in plain numpy, the end of a cut, Newton's method, and where it fails."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

from erosion.exercises.course import Course, Task, best_angle, end_of_cut, omega, volume
from erosion.impacts import alpha_max, impact
from erosion.parameters import Parameters

Rate = Callable[[np.ndarray], np.ndarray]


def linearized_rate(p: Parameters) -> Rate:
    """The derivative of the state (x, y, ẋ, ẏ): ẍ = -c y/m, ÿ = -k c y/m with c = σ b ψ."""
    k, stiffness_over_mass = float(p.k), float(p.sigma * p.b * p.psi / p.m)

    def rate(state: np.ndarray) -> np.ndarray:
        _, y, vx, vy = state
        return np.array([vx, vy, -stiffness_over_mass * y, -k * stiffness_over_mass * y])

    return rate


def at_contact(p: Parameters) -> np.ndarray:
    """The state (x, y, ẋ, ẏ) at contact."""
    v0, alpha = float(p.v0), float(p.alpha)
    return np.array([0.0, 0.0, v0 * math.cos(alpha), v0 * math.sin(alpha)])


def euler(rate: Rate, state: np.ndarray, time: float, steps: int) -> np.ndarray:
    """The state after equal steps of Euler's method."""
    h = time / steps
    for _ in range(steps):
        state = state + h * rate(state)
    return state


def rk4(rate: Rate, state: np.ndarray, time: float, steps: int) -> np.ndarray:
    """The state after equal steps of the classical method of Runge and Kutta."""
    h = time / steps
    for _ in range(steps):
        first = rate(state)
        second = rate(state + h / 2 * first)
        third = rate(state + h / 2 * second)
        fourth = rate(state + h * third)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    return state


EULER_STEPS = 100
RK4_STEPS = 10


def quarter(p: Parameters) -> float:
    """A quarter of the time from surface to surface, π/(4ω) [s].

    At half of it the tip is deepest, and the errors of phase do not count: the order of Runge and Kutta's method
    would seem to be 5.
    """
    return math.pi / 4 / omega(p)


def _depth(method: Callable[..., np.ndarray], steps: int) -> Callable[[Parameters], float]:
    return lambda p: float(method(linearized_rate(p), at_contact(p), quarter(p), steps)[1])


def first_guess(p: Parameters) -> float:
    """The angle from which Newton's method begins, two digits of degrees [rad]."""
    return math.radians(float(f"{0.75 * math.degrees(best_angle(p)):.2g}"))


def _newton_step(p: Parameters) -> float:
    start = first_guess(p)
    hit = impact("linearized", p.replace(alpha=start), derivatives=2)
    return start - float(hit.dvolume) / float(hit.d2volume)


def spinning(p: Parameters) -> Parameters:
    """A grain whose best angle is at a jump of V(α) and turns by less than 90°: k = 1, rω/v₀ = 0.6, rφ̇₀/v₀ = 0.4."""
    v0 = float(p.r) * math.sqrt(float(p.stiffness / p.m)) / 0.6
    return dataclasses.replace(p, k=1.0, v0=v0, phidot0=0.4 * v0 / float(p.r), inertia=0.5)


def _farthest(v0: float = 100.0, drag: float = 0.1, g: float = 9.81) -> float:
    """The angle at which a ball with the drag γẋ and γẏ flies farthest, by its closed form [rad]."""

    def distance(angle: float) -> float:
        vx, vy = v0 * math.cos(angle), v0 * math.sin(angle)

        def height(t: float) -> float:
            return (vy + g / drag) * -math.expm1(-drag * t) / drag - g * t / drag

        # It lands after more than half of the time, and before all of it, that a ball without drag would fly.
        time: Any = optimize.brentq(height, vy / g, 2 * vy / g)
        return -vx * math.expm1(-drag * time) / drag

    best = optimize.minimize_scalar(lambda angle: -distance(angle), bounds=(0.3, 1.2), options={"xatol": 1e-9})
    return float(best.x)


_EVENT = "End at the event, not at a step."

NUMERICS = Course(
    text=Path(__file__).with_name("numerics.md"),
    tasks={
        "omega": Task("the angular frequency ω of the depth", "rate", 1e-4, 1, "Keep all digits of p.", omega),
        "euler_depth": Task(
            f"the depth at the time π/(4ω), after {EULER_STEPS} steps of Euler's method", "length", 1e-6, 2,
            "Check the number of steps, and that all four numbers of the state are taken from before the step.",
            _depth(euler, EULER_STEPS),
        ),
        "euler_order": Task(
            "the power of the step with which Euler's error falls", "1", 0.05, 2, "Take more steps.", lambda p: 1.0
        ),
        "rk4_depth": Task(
            f"the depth at the time π/(4ω), after {RK4_STEPS} steps of Runge and Kutta's method", "length", 1e-7, 2,
            "Check the number of steps and the weights 1, 2, 2, 1 of the four rates.", _depth(rk4, RK4_STEPS),
        ),
        "rk4_order": Task(
            "the power of the step with which Runge and Kutta's error falls", "1", 0.05, 2,
            "Take more steps, but not so many that rounding is all that is left.", lambda p: 4.0,
        ),
        "t_c": Task(
            "the time at which the cut ends", "time", 1e-5, 3, "Look for the end between two steps, not at one.",
            end_of_cut,
        ),
        "volume": Task(
            "the removed volume", "volume", 1e-4, 2, "Take the integral to the end of the cut, in smaller steps.",
            volume,
        ),
        "newton_step": Task(
            "the angle after one step of Newton's method", "angle", 1e-4, 2,
            "Take the differences of V over a smaller angle.", _newton_step,
        ),
        "alpha_max": Task(
            "the angle of greatest removal", "angle", 1e-5, 2, "Take one more step of Newton's method.", best_angle
        ),
        "cannonball": Task(
            "the angle at which the cannonball flies farthest", "angle", 1e-4, 2, "Take more angles near the best one.",
            lambda p: _farthest(),
        ),
        # β s falls to γ: i = i₀ + s₀ - (γ/β)(1 + ln(β s₀/γ)) by di/ds = -1 + γ/(β s).
        "epidemic_peak": Task(
            "the share of the ill at the peak of the epidemic", "1", 1e-5, 2, _EVENT,
            lambda p: 1.0 - 0.4 * (1.0 + math.log(0.999 / 0.4)),
        ),
        "first_spike": Task(
            "the time of the first spike in milliseconds", "1", 1e-5, 2, _EVENT,
            lambda p: 20.0 * math.log(3.0),  # u = 1.5 (1 - exp(-t/20))
        ),
        "alpha_max_at_jump": Task(
            "the angle of greatest removal with spin", "angle", 1e-5, 3, "Halve the interval more often.",
            lambda p: float(alpha_max("rotating", spinning(p)).alpha),
        ),
    },
)  # fmt: skip
"""Fixed steps, events, Newton's method, and a maximum at a jump."""
