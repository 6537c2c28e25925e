"""How the best point of a curve is marked."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from erosion.optimum.alpha_max import Optimum
from erosion.plotting.colors import INK, PALETTE
from erosion.plotting.curves import Best


def star(best: Best | Optimum, color: str = PALETTE["orange"]) -> dict[str, Any]:
    """How its marker looks, in a figure and in a legend: hollow where it is only approached."""
    return {
        "marker": "*",
        "markersize": 13,
        "linestyle": "",
        "color": color if best.attained else "white",
        "markeredgecolor": INK if best.attained else color,
        "markeredgewidth": 0.7 if best.attained else 1.2,
    }


def mark_best(ax: Axes, best: Best | Optimum, size: float, color: str = PALETTE["orange"]) -> None:
    """A star where the optimum is; the axis shows its value over `size`."""
    ax.plot([np.rad2deg(best.alpha)], [best.value / size], zorder=6, clip_on=False, **star(best, color))
