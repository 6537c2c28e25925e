"""The mark of the best point of a curve."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from erosion.optimum.alpha_max import Optimum
from erosion.plotting.colors import INK, PALETTE
from erosion.plotting.curves import Best


def star(best: Best | Optimum, color: str = PALETTE["orange"]) -> dict[str, Any]:
    """The style of the mark in a figure and in its legend; hollow if the curve only approaches the point."""
    return {
        "marker": "*",
        "markersize": 13,
        "linestyle": "",
        "color": color if best.attained else "white",
        "markeredgecolor": INK if best.attained else color,
        "markeredgewidth": 0.7 if best.attained else 1.2,
    }


def mark_best(ax: Axes, best: Best | Optimum, size: float, color: str = PALETTE["orange"]) -> None:
    """Draw a star at the optimum, on an axis that shows values divided by `size`."""
    ax.plot([np.rad2deg(best.alpha)], [best.value / size], zorder=6, clip_on=False, **star(best, color))
