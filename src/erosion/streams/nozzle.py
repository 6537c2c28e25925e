"""The angle of the nozzle at which a whole stream removes most.

The same particles are used at all angles (common random numbers), so the mean volume is a
function of the angle alone. It is smooth where the volume of a single particle jumps, and its
maximum is at another angle than that of a single particle.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy.optimize import minimize_scalar

from erosion.arguments import Progress, no_progress
from erosion.impacts.impact import impact
from erosion.optimum.alpha_max import alpha_max
from erosion.streams.particles import Particles
from erosion.streams.replicates import Estimate, Points

_ANGLES = np.deg2rad(np.linspace(2.0, 90.0, 45))
_DRAWN = 2**11  # particles of a replicate
_LANES = 2**20  # impacts of one call
_PRECISION = 1e-5  # rad; of the best angle


@dataclasses.dataclass(frozen=True)
class NozzleAngle:
    """The best angle of the nozzle, and the mean volume over all angles.

    Args:
        alpha: the angle that removes most [rad].
        volume: mean volume of a particle there [volume].
        at_edge: whether the best angle is the first or last of `angles`.
        angles: of the nozzle, shape (n,) [rad].
        curve: mean volume of a particle at each, shape (n,) [volume].
        curve_error: its standard error, shape (n,) [volume].
        single_alpha: the best angle of one typical particle (see `Particles.typical`) [rad].
        single_kind: the kind of that optimum, see `Optimum`.
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


@dataclasses.dataclass(frozen=True)
class _Jet:
    """The same particles at any angle of the nozzle; `sample` has the shape (replicates, particles)."""

    particles: Particles
    sample: Mapping[str, np.ndarray]
    rtol: float

    def means(self, angles: np.ndarray, replicates: slice = slice(None)) -> np.ndarray:
        """Mean volume of each replicate at each angle, shape (replicates, angles) [volume]."""
        values = {name: value[replicates][..., None, :] for name, value in self.sample.items()}
        model, p, hits = self.particles.impacts(values, angles[:, None])
        return np.nanmean(np.where(hits, impact(model, p, rtol=self.rtol).volume, 0.0), axis=-1)

    def curves(self, angles: np.ndarray, at_once: int, progress: Progress) -> np.ndarray:
        """`means` over many angles, `at_once` at a time; shape (replicates, angles) [volume]."""
        parts = []
        for begin in range(0, len(angles), at_once):
            parts.append(self.means(angles[begin : begin + at_once]))
            progress("angles", min(begin + at_once, len(angles)), len(angles))
        return np.concatenate(parts, axis=1)

    def best(self, curve: np.ndarray, replicates: slice = slice(None)) -> tuple[float, bool]:
        """The best angle of some replicates [rad], near the top of their mean curve, and whether it is at an edge."""
        top = int(np.argmax(curve))
        around = _ANGLES[max(top - 1, 0)], _ANGLES[min(top + 1, len(_ANGLES) - 1)]
        minimum = minimize_scalar(
            lambda angle: -np.mean(self.means(np.array([angle]), replicates)),
            bounds=around,
            method="bounded",
            options={"xatol": _PRECISION},
        )
        at_edge = min(abs(minimum.x - _ANGLES[0]), abs(minimum.x - _ANGLES[-1])) < 3 * _PRECISION
        return float(minimum.x), bool(at_edge)


def best_nozzle_angle(
    particles: Particles,
    points: str,
    seed: int,
    *,
    replicates: int = 16,
    rtol: float = 1e-9,
    progress: Progress = no_progress,
) -> NozzleAngle:
    """Maximise the mean volume over the nozzle's angle, in each replicate and in all together.

    Args:
        particles: their deviations from the nozzle's angle stay as they are drawn.
        points: see `Points`.
        seed: of the points.
        replicates: independent sets of 2048 particles; the spread of their best angles gives the interval.
        rtol: see `impact`.
        progress: called with "angles", the number of angles of the curve that are done, and of all.
    """
    sample = particles.draw(Points(points, particles.dimension, seed, replicates).take(_DRAWN))
    jet = _Jet(particles, sample, rtol)
    curves = jet.curves(_ANGLES, max(1, _LANES // (replicates * _DRAWN)), progress)
    tops = np.array([jet.best(curve, slice(i, i + 1))[0] for i, curve in enumerate(curves)])
    alpha, at_edge = jet.best(curves.mean(axis=0))
    model, typical = particles.typical
    single = alpha_max(model, typical)
    single_angles = np.linspace(_ANGLES[0], _ANGLES[-1], 500)
    return NozzleAngle(
        alpha=Estimate.of(tops, alpha),
        volume=Estimate.of(jet.means(np.array([alpha]))[:, 0]),
        at_edge=at_edge,
        angles=_ANGLES,
        curve=curves.mean(axis=0),
        curve_error=curves.std(axis=0, ddof=1) / np.sqrt(replicates),
        single_alpha=float(single.alpha),
        single_kind=str(single.kind),
        single_angles=single_angles,
        single_curve=np.asarray(impact(model, typical.replace(alpha=single_angles), rtol=rtol).volume),
    )
