"""Newton's method for the angle of greatest removal, kept inside a bracket."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from erosion.impacts.impact import impact
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import Parameters
from erosion.trajectory.trajectory import SimulationError

_STEEPEST = np.pi / 2
_CLOSE = 1e-11  # [rad]: what V′ of a numerical volume can resolve near its root
_NEAR = 1e-7  # [rad]: Newton's step from a zero of V′ is below this, whatever the rounding
_RTOL = 1e-12
_MOST = 60  # bisection alone gains 18 digits in as many


class Iterate(NamedTuple):
    """One step: V and its derivatives at `alpha`, and the move made from there.

    Args:
        alpha: angle of attack [rad].
        volume, dvolume, d2volume: V, V′ and V″ there.
        step: to the next angle [rad].
        kind: "Newton", or "bisection" where Newton's step would have left the bracket.
    """

    alpha: float
    volume: float
    dvolume: float
    d2volume: float
    step: float
    kind: str


Jet = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def volume_jet(model: CuttingModel, p: Parameters) -> Jet:
    """Angles -> V, V′ and V″ there, by automatic differentiation of the solver."""

    def jet(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        result = impact(model, p.replace(alpha=angles), derivatives=2, wrt="alpha", rtol=_RTOL)
        return np.asarray(result.volume), np.asarray(result.dvolume), np.asarray(result.d2volume)

    return jet


def greatest(jet: Jet, looks: int = 17) -> list[Iterate]:
    """Climb to the greatest V in (0, π/2), for a V with one maximum.

    A scan of `looks` angles gives the start and, to either side of it, a bracket in which V′
    changes sign. Each step is Newton's, -V′/V″; where that would leave the bracket, or V″
    has the sign of a valley, the bracket is halved instead. Every look shrinks the bracket,
    so the climb ends whatever the shape of V: V″ jumps where cuts change their end.

    Args:
        jet: angles -> V, V′, V″.
        looks: angles in the scan.

    Returns:
        The steps; the last one's `alpha` is the answer, and its `step` is below 1e-11 rad.

    Raises:
        SimulationError: where an impact fails, or V′ has no zero near the greatest V seen.
    """
    scan = _STEEPEST * np.arange(1, looks + 1) / (looks + 1)
    alpha = float(scan[np.argmax(_finite(scan, jet(scan)[0]))])
    low, high = alpha - scan[0], alpha + scan[0]
    steps: list[Iterate] = []
    while len(steps) < _MOST:
        value, d1, d2 = (float(_finite([alpha], of)[0]) for of in jet(np.array([alpha])))
        low, high = (alpha, high) if d1 > 0 else (low, alpha)
        newton = alpha - d1 / d2 if d2 < 0 else np.nan
        # The end just moved to may itself be the root, to rounding.
        inside = low < newton < high or abs(newton - alpha) <= _CLOSE
        step = (newton if inside else (low + high) / 2) - alpha
        steps.append(Iterate(alpha, value, d1, d2, float(step), "Newton" if inside else "bisection"))
        if abs(step) <= _CLOSE:
            break
        alpha = float(alpha + step)
    # A bracket that held no zero of V′ shrinks to one of its ends, far from where V′ points.
    if abs(steps[-1].dvolume) > _NEAR * abs(steps[-1].d2volume):
        raise SimulationError(f"No angle was found where dV/dα vanishes; the search ended at {np.rad2deg(alpha):.6g}°.")
    return steps


def _finite(angles: Sequence[float] | np.ndarray, values: np.ndarray) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise SimulationError(f"The impact at α = {np.rad2deg(angles[bad[0]]):.6g}° could not be computed.")
    return values
