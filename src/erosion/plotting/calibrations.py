"""Figures of fits: measurements, fitted curves with bands, and profiles."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from erosion.calibration import Calibration
from erosion.models import model_name
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.scales import readable_scale
from erosion.plotting.colors import INK, PALETTE
from erosion.plotting.style import house_style, new_figure

_ANGLES = np.deg2rad(np.linspace(0.5, 90.0, 180))


@house_style()
def plot_calibration(fits: Sequence[Calibration], level: float = 0.95) -> Figure:
    """The data, the fitted curves with the bands of their uncertainty, and the first fit's residuals.

    Args:
        fits: fits to the same data, the best first; only the first six are drawn, because a reader
            cannot distinguish more.
        level: the confidence level of the bands.
    """
    best = fits[0]
    data = best.data
    fig = new_figure(6.2, 5.6)
    upper, lower = fig.subplots(2, 1, sharex=True, height_ratios=(0.75, 0.25))
    scale = readable_scale(data.dimension, data.units, float(np.abs(data.erosion).max()))
    _draw_data(upper, best, data.erosion / scale.size, scale.size)
    degrees = np.rad2deg(_ANGLES)
    width = float(stats.norm.ppf((1 + level) / 2))
    for rank, (fit, color) in enumerate(zip(fits, PALETTE.values(), strict=False)):
        erosion, error = (values / scale.size for values in fit.curve(_ANGLES))
        dashes = "-" if rank == 0 else (0, (5, 1.5, *(1, 1.5) * (rank % 3)))
        upper.fill_between(degrees, erosion - width * error, erosion + width * error, color=color, linewidth=0,
                           alpha=0.12 if rank else 0.3, zorder=3)  # fmt: skip
        upper.plot(degrees, erosion, color=color, linestyle=dashes, linewidth=1.4 if rank else 2.0,
                   zorder=4 - 0.1 * rank, label=model_name(fit.model))  # fmt: skip
    _draw_data(lower, best, best.residuals / scale.size, scale.size)
    lower.axhline(0, color=PALETTE["blue"], linewidth=1.4)
    lowest = data.erosion - (0.0 if data.uncertainty is None else data.uncertainty)
    upper.set_ylim(bottom=min(0.0, 1.1 * float(lowest.min()) / scale.size))
    quantity = data.quantity
    upper.set_ylabel(f"${quantity.symbol}$  {quantity.meaning}" + (f"  [{scale.unit}]" if scale.unit else ""))
    lower.set_ylabel("residuals")
    lower.set_xlim(0, 90)
    lower.set_xticks(range(0, 91, 15), [f"{tick}°" for tick in range(0, 91, 15)])
    lower.set_xlabel(f"{QUANTITIES['alpha'].symbol}  {QUANTITIES['alpha'].meaning}")
    handles, labels = upper.get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 3), title=f"bands: {level:.0%}")
    return fig


@house_style()
def plot_profile(ax: Axes, fit: Calibration, name: str, level: float = 0.95) -> Axes:
    """The profile likelihood of one parameter, with its interval."""
    profile, height = fit.profile(name), fit.rise(level)
    ax.plot(profile.values, profile.rise, color=PALETTE["blue"], marker="o", markersize=3.5, label="profile")
    ax.axhline(height, color=PALETTE["vermillion"], linewidth=1.2, label=f"{level:.0%}")
    for end in fit.intervals(level)[name]:
        if 0 < abs(end) < np.inf:
            ax.axvline(end, color=PALETTE["vermillion"], linewidth=1.2, linestyle=(0, (4, 3)))
    ax.set_xlabel(name if name not in QUANTITIES else QUANTITIES[name].symbol)
    ax.set_ylabel("Δχ² above the best fit")
    ax.set_ylim(0, 2.5 * height)
    ax.legend()
    return ax


def _draw_data(ax: Axes, fit: Calibration, values: np.ndarray, size: float) -> None:
    data = fit.data
    errors = None if data.uncertainty is None else data.uncertainty / size
    many = len(data) > 500
    ax.errorbar(np.rad2deg(data.angle), values, yerr=None if many else errors, fmt="." if many else "o", color=INK,
                markersize=2 if many else 4, elinewidth=0.9, capsize=2, alpha=0.3 if many else 0.9, zorder=2,
                label="measured" if data.source == "data" else data.source)  # fmt: skip
