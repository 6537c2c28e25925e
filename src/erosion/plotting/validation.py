"""Published numbers beside computed ones: how far each is off."""

import numpy as np
from matplotlib.figure import Figure

from erosion.plotting.colors import DIM, FAINT, INK, PALETTE
from erosion.plotting.style import house_style, legend_below, new_axes
from erosion.validation import Validation
from erosion.validation.facts import KINDS

_COLORS = dict(
    zip(KINDS, (PALETTE["vermillion"], PALETTE["blue"], PALETTE["green"], PALETTE["orange"], DIM), strict=True)
)
_MARKERS = dict(zip(KINDS, "osD^v", strict=True))
_NOTHING = 0.02  # where a number of zero is drawn


@house_style()
def plot_validation(validation: Validation) -> Figure:
    """Computed over published for each fact, on a logarithmic axis; 1 is agreement.

    Args:
        validation: from `against_published`.
    """
    comparisons = validation.comparisons
    fig, ax = new_axes(6.6, 1.4 + 0.2 * len(comparisons))
    places = -np.arange(len(comparisons), dtype=float)
    ax.axvspan(0.9, 1.1, color=FAINT, alpha=0.5, linewidth=0, label="within 10 %")
    ax.axvline(1, color=INK, linewidth=0.8)
    for kind in KINDS:
        rows = [i for i, comparison in enumerate(comparisons) if comparison.fact.kind == kind]
        ratios = [max(comparisons[i].ratio, _NOTHING) for i in rows]
        ax.plot(ratios, places[rows], _MARKERS[kind], color=_COLORS[kind], markersize=5, label=kind)
    for place, comparison in zip(places, comparisons, strict=True):
        if comparison.computed == 0:
            ax.annotate("0", (_NOTHING, place), xytext=(6, 0), textcoords="offset points", va="center", fontsize=8)
    ax.set_xscale("log")
    ax.set_yticks(places, [comparison.fact.name for comparison in comparisons], fontsize=8)
    ax.set_ylim(places[-1] - 0.7, 0.7)
    ax.set_xlabel("computed over published")
    ax.grid(axis="y", linewidth=0.3)
    legend_below(ax, 3)
    return fig
