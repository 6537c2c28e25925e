"""The angle of greatest removal by scipy alone, as a script of its own: `python benchmarks/scipy_optimum.py`.

The equations of `rotating` at Table 1 in inches and seconds, DOP853 with events, and a scan before
the search, because V(α) jumps. Prints 25.571827…°: from values of V alone a maximum cannot be had
to more digits. Nothing of this package is imported.
"""

from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

K, PSI, R, B, M, V0, SIGMA, BETA = 2.0, 0.04, 0.04, 0.04, 2.855e-7, 4400.0, 200e3, 0.5
STIFFNESS = SIGMA * B * PSI
INERTIA = BETA * M * R**2
TIME = sqrt(M / (K * STIFFNESS))  # of a cut
STEP = 0.5  # of the scan [°]


def rate(_, state):
    """Rates of y, φ, ẋ, ẏ, φ̇ and the volume."""
    y, phi, vx, vy, omega, _ = state.tolist()
    depth = y - R * (1 - sin(phi))
    force = -STIFFNESS * depth
    return vy, omega, force / M, K * force / M, R * force / INERTIA, B * depth * (vx + R * omega * sin(phi))


def rebound(_, state):
    """Depth of the tip."""
    return state[0] - R * (1 - sin(state[1]))


def stop(_, state):
    """Horizontal velocity of the tip."""
    return state[2] + R * state[4] * sin(state[1])


for event in (rebound, stop):
    event.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
    event.direction = -1  # pyright: ignore[reportFunctionMemberAccess]


def volume(alpha):
    """The volume of one impact [in³]."""
    # A little below the surface: at depth 0 the event would be there at once.
    start = [1e-300, pi / 2, V0 * cos(alpha), V0 * sin(alpha), 0.0, 0.0]
    solution = solve_ivp(rate, (0, 100 * TIME), start, "DOP853", rtol=1e-9, atol=1e-15, events=(rebound, stop))
    return solution.y[-1, -1]


def best_angle():
    """The angle of greatest removal [rad]."""
    angles = np.deg2rad(np.arange(STEP, 90, STEP))
    best = angles[np.argmax([volume(alpha) for alpha in angles])]
    bounds = best - np.deg2rad(STEP), best + np.deg2rad(STEP)
    result: Any = minimize_scalar(lambda alpha: -volume(alpha), bounds=bounds, options={"xatol": 1e-9})
    return result.x


if __name__ == "__main__":
    print(f"{np.rad2deg(best_angle()):.9f}")
