"""The angle of the nozzle at which a whole stream removes most.

All angles see the same particles (common random numbers), so that the mean volume is a
function of the angle alone. It is smooth where a single particle's volume jumps: that a
stream's best angle is not the particle's is what the averages of a jet hide.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from erosion.engine.impact import impact
from erosion.optimum.alpha_max import alpha_max
from erosion.streams.particles import Particles
from erosion.streams.replicates import Estimate, Points

_ANGLES = np.deg2rad(np.linspace(2.0, 90.0, 45))
_DRAWN = 2**11  # particles of a replicate
_LANES = 2**20  # of one call
_PRECISION = 1e-5  # rad


@dataclasses.dataclass(frozen=True)
class NozzleAngle:
    """The best angle of the nozzle, and the curve that it is the top of.

    Args:
        alpha: the angle that removes most [rad].
        volume: mean volume of a particle there [volume].
        at_edge: whether the volume only falls (or rises) over all angles looked at.
        angles: of the nozzle, shape (n,) [rad].
        curve: mean volume of a particle at each, shape (n,) [volume].
        curve_error: its standard error, shape (n,) [volume].
        single_alpha: the best angle of one typical particle (see `Particles.typical`) [rad].
        single_kind: what makes it the best, see `Optimum`.
        single_angles: angles of attack, shape (k,) [rad].
        single_curve: its volume at each, shape (k,) [volume].
    """

    alpha: Estimate
    volume: Estimate
    at_edge: bool
    angles: np.ndarray
    curve: np.ndarray
    curve_error: np.ndarray
    single_alpha: float
    single_kind: str
    single_angles: np.ndarray
    single_curve: np.ndarray


def best_nozzle_angle(
    particles: Particles,
    points: str,
    seed: int,
    *,
    replicates: int = 16,
    rtol: float = 1e-9,
    progress: Callable[[int, int], Any] = lambda done, total: None,
) -> NozzleAngle:
    """Maximise the mean volume over the nozzle's angle, in each replicate and in all together.

    Args:
        particles: deviations from the nozzle's angle stay as they are drawn.
        points: see `Points`.
        seed: of the points.
        replicates: independent sets of 2048 particles, whose best angles' spread gives the interval.
        rtol: see `impact`.
        progress: called with angles done and their number, of the curve.
    """
    sample = particles.draw(Points(points, len(particles.laws), seed, replicates).take(_DRAWN))

    def means(angles: np.ndarray, which: Any = slice(None)) -> np.ndarray:
        """Mean volume of each replicate at each angle, shape (replicates, angles)."""
        values = {name: value[which][..., None, :] for name, value in sample.items()}
        model, p, hits = particles.impacts(values, angles[:, None])
        return np.nanmean(np.where(hits, impact(model, p, rtol=rtol).volume, 0.0), axis=-1)

    def best(which: Any, curve: np.ndarray) -> tuple[float, bool]:
        top = int(np.argmax(curve))
        around = _ANGLES[max(top - 1, 0)], _ANGLES[min(top + 1, len(_ANGLES) - 1)]
        minimum = minimize_scalar(
            lambda angle: -np.mean(means(np.array([angle]), which)),
            bounds=around,
            method="bounded",
            options={"xatol": _PRECISION},
        )
        edge = min(abs(minimum.x - _ANGLES[0]), abs(minimum.x - _ANGLES[-1])) < 3 * _PRECISION
        return float(minimum.x), bool(edge)

    at_once = max(1, _LANES // (replicates * _DRAWN))
    parts = []
    for begin in range(0, len(_ANGLES), at_once):
        parts.append(means(_ANGLES[begin : begin + at_once]))
        progress(min(begin + at_once, len(_ANGLES)), len(_ANGLES))
    curves = np.concatenate(parts, axis=1)
    tops = np.array([best(slice(i, i + 1), curve)[0] for i, curve in enumerate(curves)])
    alpha, at_edge = best(slice(None), curves.mean(axis=0))
    model, typical = particles.typical
    single = alpha_max(model, typical)
    fine = np.linspace(_ANGLES[0], _ANGLES[-1], 500)
    return NozzleAngle(
        alpha=Estimate.of(tops, alpha),
        volume=Estimate.of(means(np.array([alpha]))[:, 0]),
        at_edge=at_edge,
        angles=_ANGLES,
        curve=curves.mean(axis=0),
        curve_error=curves.std(axis=0, ddof=1) / np.sqrt(replicates),
        single_alpha=float(single.alpha),
        single_kind=str(single.kind),
        single_angles=fine,
        single_curve=np.asarray(impact(model, typical.replace(alpha=fine), rtol=rtol).volume),
    )
