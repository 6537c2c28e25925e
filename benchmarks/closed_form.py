"""The linearized model's closed form, one pass over memory: no solver can be faster."""

from collections.abc import Callable

import numba
import numpy as np

import erosion
from benchmarks.work import Answers, Work


def _scales() -> tuple[float, float]:
    p = erosion.TABLE_1
    return float(p.k), float(p.m) * float(p.v0) ** 2 / (float(p.sigma) * float(p.psi))


def with_numba(work: Work) -> Callable[[], Answers]:
    """All cores, compiled; V = (V*/k)(sin 2α - (2/k) sin²α), or (V*/2) cos²α past the cusp."""
    k, scale = _scales()
    volume, alpha, end = np.empty(len(work)), work.alpha, np.zeros(len(work), int)
    _numba(alpha[:2], k, scale, volume[:2])

    def run() -> Answers:
        _numba(alpha, k, scale, volume)
        return Answers(volume, end)

    return run


@numba.njit(parallel=True, fastmath=True)
def _numba(alpha: np.ndarray, k: float, scale: float, volume: np.ndarray) -> None:
    for i in numba.prange(alpha.size):
        sine, cosine = np.sin(alpha[i]), np.cos(alpha[i])
        rebound = scale / k * (2 * sine * cosine - 2 / k * sine**2)
        volume[i] = rebound if 2 * sine <= k * cosine else scale / 2 * cosine**2


def with_numpy(work: Work) -> Callable[[], Answers]:
    """One core, array by array."""
    k, scale = _scales()
    alpha, end = work.alpha, np.zeros(len(work), int)

    def run() -> Answers:
        sine, cosine = np.sin(alpha), np.cos(alpha)
        rebound = scale / k * (2 * sine * cosine - 2 / k * sine**2)
        return Answers(np.where(2 * sine <= k * cosine, rebound, scale / 2 * cosine**2), end)

    return run
