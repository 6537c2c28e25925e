"""heyoka's `taylor_adaptive`: one impact after another, as its manual shows."""

from collections.abc import Callable

import heyoka as hy
import numpy as np

from benchmarks.heyoka_taylor import SIZE, TOLERANCE, answers, equations, initial_states
from benchmarks.work import Answers, Work, constants

_LATE = 1e3  # no cut is longer [1/ω]


def prepare(work: Work, order: int = 0, tol: float = TOLERANCE) -> Callable[[], Answers]:
    """One integrator, one impact after another."""
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
