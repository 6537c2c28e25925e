"""Curves that jump, broken at their jumps, and the words for their best point; the same in every figure."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from erosion.optimum.alpha_max import ASIDE, Optimum
from erosion.optimum.maxima import Jump
from erosion.plotting.labels import NOTHING

_LONG_STEP = 4.0  # degrees
_STEEPER = 3.0  # times the shorter of the steps beside


class Best(NamedTuple):
    """The fields of an optimum that a figure needs. Their names are those of `Optimum`, so a figure takes both."""

    alpha: float
    value: float
    kind: str
    attained: bool
    side: str = ""
    low: float = np.nan
    high: float = np.nan


def describe(best: Best | Optimum) -> str:
    """An optimum in a few words: "at 25.57°", "as α → 0", "just below the jump at 40.00°", "from 0.00° to 45.00°"."""
    if best.kind == "none":
        return NOTHING
    if best.alpha == 0:
        return "as α → 0"
    if best.kind == "plateau" and best.low < best.high:
        return f"from {np.rad2deg(best.low):.2f}° to {np.rad2deg(best.high):.2f}°"
    at = f"{np.rad2deg(best.alpha):.2f}°"
    if best.kind != "jump":
        return f"at {at}"
    return f"just {best.side} the jump at {at}" if best.side else f"at the jump, {at}"


def with_gaps(before: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Insert NaN into the arrays before each of these indices, so that a curve has gaps there."""
    return tuple(np.insert(array, before, np.nan) for array in arrays)


def leaps(degrees: np.ndarray) -> np.ndarray:
    """The indices before which a line over angles of greatest removal breaks, for another maximum is the greatest.

    Args:
        degrees: the angles, shape (n,), NaN where nothing is removed.
    """
    steps = np.abs(np.diff(degrees))
    around = np.concatenate([[np.nan], steps, [np.nan]])
    # Where a line is only steep, the steps beside are long, too.
    smaller = np.nan_to_num(np.fmin(around[:-2], around[2:]))
    return np.flatnonzero((steps > _LONG_STEP) & (steps > _STEEPER * smaller)) + 1


def broken_at(jumps: Sequence[Jump], angles: np.ndarray, volume: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Insert both sides of each jump into a curve, and NaN between them."""
    for jump in jumps:
        at = int(np.searchsorted(angles, jump.alpha))
        angles = np.insert(angles, at, [jump.alpha - ASIDE, np.nan, jump.alpha + ASIDE])
        volume = np.insert(volume, at, [jump.below, np.nan, jump.above])
        # The next search needs ascending angles.
        angles[at + 1] = jump.alpha
    return np.where(np.isnan(volume), np.nan, angles), volume


def broken(x: np.ndarray, y: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, ...]:
    """Insert NaN into a sampled curve where it must jump: where it changes by much more than its slopes explain.

    Args:
        x: along the axis, shape (n,).
        y: the curve, shape (n,).
        slope: dy/dx, shape (n,).
    """
    h = np.diff(x)
    unexplained = np.abs(np.diff(y) - h * (slope[1:] + slope[:-1]) / 2)
    expected = h * (np.abs(slope[1:]) + np.abs(slope[:-1]))
    jumps = np.flatnonzero((unexplained > 0.01 * np.nanmax(np.abs(y), initial=0.0)) & (unexplained > expected)) + 1
    return with_gaps(jumps, x, y)
