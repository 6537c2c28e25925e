"""The linearized cut as a student solves it: fixed steps in plain numpy, nothing of the package's own solvers."""

import math
from collections.abc import Callable

import numpy as np

from erosion.parameters.parameters import Parameters

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
