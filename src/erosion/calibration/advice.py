"""Where to measure what the data leaves open: the angle and speed at which two fits differ that the data allows."""

from collections.abc import Sequence

import numpy as np

from erosion.calibration.conditions import conditions, describe
from erosion.calibration.least_squares import Problem

_ANGLES = np.deg2rad(np.arange(5.0, 90.0, 5.0))
_FACTORS = 0.5, 2.0  # of the least and the greatest speed of the data, which a laboratory may also have
_SEEN = 2.0  # standard deviations of a row, by which the two fits must differ there


def advise(problem: Problem, names: Sequence[str], allowed: np.ndarray, noise: float) -> str:
    """What to do about parameters that are left open, as "Fix one of them, or measure at 10°." says it.

    Args:
        problem: the model and the data.
        names: of these parameters.
        allowed: two θ, far from each other, that fit the data as well; shape (2, names).
        noise: standard deviation of a row over the greatest erosion.
    """
    fixed = "Fix it" if len(names) == 1 else "Fix one of them"
    for speed in _speeds(problem):
        at = {"alpha": _ANGLES} if speed is None else {"alpha": _ANGLES, "v0": np.full(_ANGLES.shape, speed)}
        first, second = problem.forward.predict_many(allowed, at)
        greatest = max(np.abs(first).max(), np.abs(second).max())
        if not greatest > 0:  # impacts failed, or there is no erosion
            continue
        differs = np.abs(first - second) / (noise * greatest)
        if differs.max() >= _SEEN:
            where = "" if speed is None else f" and {describe({'v0': speed}, problem.data.units)}"
            return f"{fixed}, or measure at {np.rad2deg(_ANGLES[np.argmax(differs)]):.0f}°{where}."
    return f"{fixed}."


def _speeds(problem: Problem) -> list[float | None]:
    """The speeds to think of: first those of the data, or of the case (None); then a lower and a greater one."""
    if "v0" in problem.forward.free:
        return [None]
    measured = [group.values["v0"] for group in conditions(problem.data, most=3) if "v0" in group.values]
    own: list[float | None] = [*measured] or [None]
    known = measured or [float(problem.forward.p.v0)]
    return [*own, _FACTORS[0] * min(known), _FACTORS[1] * max(known)]
