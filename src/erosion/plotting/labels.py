"""Colours, labels and broken curves: what figures and pages share, without matplotlib."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from erosion.correlations import CORRELATIONS
from erosion.impacts import ASIDE, OTHER_ENDS, Jump, Optimum
from erosion.models import BUILT_IN, NO_CUT
from erosion.parameters import Quantity

# Okabe and Ito (2008), "Color universal design": readers with any colour vision can distinguish them.
PALETTE: Mapping[str, str] = {
    "blue": "#0072b2", "vermillion": "#d55e00", "green": "#009e73",
    "purple": "#cc79a7", "sky": "#56b4e9", "orange": "#e69f00",
}  # fmt: skip
STYLES: Sequence[tuple[str, Any]] = tuple(
    (color, line) for line in ("-", (0, (5, 2)), (0, (6, 2, 1.2, 2))) for color in PALETTE.values()
)
"""Colour and line style of the first, second, … curve of a figure; dots mean that the model does not hold."""

MARKS = "os^Dv<>XPd+xph"
"""The mark of the first, second, … group of measurements, or curve of many; a star is an optimum."""

INK = "#24292f"
FAINT = "#d0d7de"
DIM = "#7d858e"

REMOVED_AT_CONTACT: Mapping[str, Any] = {"color": PALETTE["purple"], "alpha": 0.4, "linewidth": 0}
"""The style of areas that stand for what is removed at contact."""

ENDS: Mapping[str, str] = {"rebound": PALETTE["blue"], "stop": PALETTE["vermillion"], NO_CUT: DIM}
"""The colour of each kind of end, the same in every figure."""

HISTORIES = (
    ("x", "x_tip", Quantity("x", "along the surface", "length")),
    ("y", "depth", Quantity("y", "depth", "length")),
    ("vx", "vx_tip", Quantity("ẋ", "forward speed", "speed")),
    ("vy", "vdepth", Quantity("ẏ", "downward speed", "speed")),
)

NOTHING = OTHER_ENDS[NO_CUT]

AT_CONTACT = "of it at contact, beside the cut"

EVENT_LABELS = {"rebound": "rebound, y = 0", "stop": "stop, ẋ = 0"}


def model_title(name: str) -> str:
    """A model as legends name it: what it says, or its name if it is not one of the package's."""
    if name in CORRELATIONS:
        return CORRELATIONS[name].title
    return BUILT_IN[name].summary.replace("F_x", "Fₓ") if name in BUILT_IN else name


def end_label(ended_by: str) -> str:
    """The label of a kind of end: "ends by stop", "nothing is cut"."""
    return NOTHING if ended_by == NO_CUT else f"ends by {ended_by}"


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
    if best.kind == "limit":
        return f"at {at}, limit of the turn"
    if best.kind != "jump":
        return f"at {at}"
    return f"just {best.side} the jump at {at}" if best.side else f"at the jump, {at}"


_WIDTH = 0.005  # of a line, over the greatest value


def coinciding(curves: Sequence[np.ndarray], share: float) -> list[list[int]]:
    """The curves before each one that it would hide at more than this share of the points, in each group of them.

    Args:
        curves: each of shape (points,), or (groups, points), where a group is measured by its own greatest value.
        share: of the points.
    """
    most = _WIDTH * np.nanmax([*curves, np.zeros_like(curves[0])], axis=(0, -1))[..., None]
    return [[i for i, other in enumerate(curves[:at])
             if (np.isclose(curve, other, 0, most, True).mean(axis=-1) > share).all()]
            for at, curve in enumerate(curves)]  # fmt: skip


def round_length(longest: float) -> float:
    """1, 2 or 5 times a power of ten, at most `longest`: the length of a bar that shows the scale."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(factor for factor in (1, 2, 5) if factor * power <= longest * (1 + 1e-9)) * power)


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


def parted(values: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a curve where the model holds, and that where the body turns by more than 90°, to be dotted.

    The dotted part begins at the last valid point.

    Args:
        values: along the curve, shape (n,).
        beyond: where the body turns by more than 90°, shape (n,).
    """
    beside = beyond | np.append(beyond[1:], False) | np.insert(beyond[:-1], 0, False)
    return np.where(beyond, np.nan, values), np.where(beside, values, np.nan)


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
