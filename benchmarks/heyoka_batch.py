"""heyoka's `taylor_adaptive_batch`: SIMD lanes, each refilled as soon as its impact has ended.

`propagate_until` of the batch ends all its lanes at the first terminal event of any. Here the
batch goes step by step; the events' callbacks mark the lanes that ended, which a numba function
then stores and fills with the next impacts.
"""

from collections.abc import Callable
from typing import Any

import heyoka as hy
import numba
import numpy as np

from benchmarks.heyoka_taylor import SIZE, TOLERANCE, answers, equations, initial_states
from benchmarks.work import Answers, Work, constants


def prepare(work: Work, order: int = 0, tol: float = TOLERANCE, width: int = 0) -> Callable[[], Answers]:
    """`width` impacts in SIMD lanes, each replaced by the next as soon as it has ended."""
    c = constants()
    width = width or (16 if order else 64)  # the fastest of 8, 16, 32, 48 and 64, or within 3 % of it
    system, events, parameters = equations(c, order)
    ended = np.zeros(width, bool)

    def mark(_: Any, __: int, lane: int) -> bool:
        ended[lane] = True
        return True

    integrator = hy.taylor_adaptive_batch(
        system,
        np.zeros((SIZE, width)),
        pars=np.repeat(np.array(parameters)[:, None], width, 1),
        tol=tol,
        fast_math=True,
        t_events=[
            hy.t_event_batch(event, direction=hy.event_direction.negative, callback=mark, cooldown=0.0)
            for event in events
        ],
    )
    starts = initial_states(work, c, order)[work.cutting()]
    end = np.empty_like(starts)

    def run() -> Answers:
        integrator.set_time([0.0] * width)
        integrator.reset_cooldowns()
        state, step = integrator.state, integrator.step
        lanes = np.full(width, -1)
        ended[:] = True
        following, left = _refill(ended, state, lanes, starts, end, 0), len(starts)
        while left:
            step()
            left -= _ended(ended, lanes)
            following = _refill(ended, state, lanes, starts, end, following)
        return answers(work, c, order, end)

    return run


@numba.njit
def _ended(ended: np.ndarray, lanes: np.ndarray) -> int:
    return int(np.count_nonzero(ended & (lanes >= 0)))


@numba.njit
def _refill(
    ended: np.ndarray, state: np.ndarray, lanes: np.ndarray, starts: np.ndarray, end: np.ndarray, following: int
) -> int:
    """Store the lanes that ended and give them the impacts from `following` on."""
    for lane in range(ended.size):
        if ended[lane]:
            ended[lane] = False
            impact = lanes[lane]
            if impact >= 0:
                end[impact] = state[:, lane]
            # A lane without work repeats the first impact: it must hold something that ends.
            lanes[lane] = following if following < len(starts) else -1
            state[:, lane] = starts[following if following < len(starts) else 0]
            following += 1
    return following
