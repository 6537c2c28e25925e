"""scipy: `solve_ivp` with DOP853 and terminal events, one impact after another."""

from collections.abc import Callable
from math import cos
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.work import NO_CUT, REBOUND, STOP, Answers, Work, constants

TOLERANCE = 1e-10  # 99 % of the volumes are then right to 2e-9
_LATE = 1e3  # [1/ω]


def prepare(
    work: Work, rtol: float = TOLERANCE, atol: float = 1e-12, max_step: float = np.inf
) -> Callable[[], Answers]:
    """The equations as in `heyoka_taylor`; the start 1e-300 deep, else the event at 0 is found."""
    c = constants()
    rho, by_k, by_inertia = c.rho, 1 / c.k, 1 / (c.k * c.rho * c.beta)

    def derivative(_: float, z: Any) -> list[float]:
        y, q, vx, vy, omega, _ = z.tolist()
        cosine = cos(q)
        depth = y - rho * (1 - cosine)
        return [vy, omega, -by_k * depth, -depth, -by_inertia * depth, depth * (vx + rho * omega * cosine)]

    def rebound(_: float, z: Any) -> float:
        return z[0] - rho * (1 - cos(z[1]))

    def stop(_: float, z: Any) -> float:
        return z[2] + rho * z[4] * cos(z[1])

    for event in (rebound, stop):
        event.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
        event.direction = -1  # pyright: ignore[reportFunctionMemberAccess]

    def run() -> Answers:
        volume, end = np.zeros(len(work)), np.full(len(work), NO_CUT)
        for i in np.nonzero(work.cutting())[0]:
            alpha, s = work.alpha[i], work.s[i]
            start = [1e-300, 0.0, np.cos(alpha), np.sin(alpha), s / rho, 0.0]
            solution = solve_ivp(
                derivative,
                (0.0, _LATE),
                start,
                method="DOP853",
                rtol=rtol,
                atol=atol,
                max_step=max_step,
                events=(rebound, stop),
            )
            volume[i] = c.volume * solution.y[-1, -1]
            end[i] = REBOUND if solution.t_events[0].size else STOP
        return Answers(volume, end)

    return run
