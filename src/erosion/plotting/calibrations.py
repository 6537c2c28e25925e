"""Figures of fits: measurements, fitted curves with bands, and profiles."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from erosion.calibration import Calibration
from erosion.calibration.conditions import MOST, Condition, conditions
from erosion.models import model_name
from erosion.parameters.scales import Scale, readable_scale
from erosion.plotting.colors import INK, MARKS, PALETTE
from erosion.plotting.style import angle_axis, house_style, new_figure, typeset

_ANGLES = np.deg2rad(np.linspace(0.5, 90.0, 180))
_DASHES: Sequence[Any] = (
    "-",
    (0, (5, 1.5)),
    (0, (5, 1.5, 1, 1.5)),
    (0, (1, 1.5)),
    (0, (8, 3)),
    (0, (3, 1, 1, 1, 1, 1)),
)
_RIGHT = 92  # degrees, so that a mark at 90° is whole

_BY = {True: "by the rows' scatter alone", False: "by the rows' uncertainties alone"}


@house_style()
def plot_calibration(fits: Sequence[Calibration], level: float = 0.95) -> Figure:
    """The data, the fitted curves with the bands of their uncertainty, and the first fit's residuals.

    Data of several speeds or masses has a colour for each, and a curve of each fit; a model is then
    known by its dashes. A line above the figure says whether the first fit has warnings (`Calibration.statements`).

    Args:
        fits: fits to the same data, the best first; only the first six are drawn, because a reader
            cannot distinguish more.
        level: the confidence level of the bands.
    """
    best, data = fits[0], fits[0].data
    groups = conditions(data, MOST)
    fig = new_figure(6.2, 5.8)
    upper, lower = fig.subplots(2, 1, sharex=True, height_ratios=(0.72, 0.28))
    scale = readable_scale(data.dimension, data.units, float(np.abs(data.erosion).max()))
    _draw_curves(upper, fits[: len(PALETTE)], groups, scale, float(stats.norm.ppf((1 + level) / 2)))
    for i, group in enumerate(groups):
        label = group.label or ("measured" if data.source == "data" else data.source)
        look = {"color": INK if len(groups) == 1 else _color(i, len(groups)), "fmt": MARKS[i]}
        _draw_data(upper, best, data.erosion, group.rows, scale, {**look, "label": label})
        _draw_data(lower, best, best.residuals, group.rows, scale, look)
    lower.axhline(0, color=PALETTE["blue"] if len(groups) == 1 else INK, linewidth=1.4)
    lowest = data.erosion - (0.0 if data.uncertainty is None else data.uncertainty)
    upper.set_ylim(bottom=min(0.0, 1.1 * float(lowest.min()) / scale.size))
    lower.set_ylabel("residuals")
    angle_axis(lower)
    lower.set_xlim(0, _RIGHT)
    handles, labels = upper.get_legend_handles_labels()
    fig.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(len(labels), 3),
        title=f"bands: {level:.0%} of the curve, {_BY[best.data.uncertainty is None]}",
    )
    if best.statements:
        whose = f"{model_name(best.model)}: " if len(fits) > 1 else ""
        count = len(best.statements)
        note = f"{whose}{count} warning{'s' if count > 1 else ''}: see the text of the fit"
        upper.set_title(note, fontsize=7.5, loc="left")
    unit = f"[{scale.unit}]" if scale.unit else ""
    _label_whole(upper, f"{typeset(data.quantity.symbol)}  {data.quantity.meaning}", unit)
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
    ax.set_xlabel(typeset(fit.quantities[name].symbol) + (f" [{profile.unit}]" if profile.unit else ""))
    ax.set_ylabel("Δχ² above the best fit")
    ax.set_ylim(0, 2.5 * height)
    ax.legend()
    return ax


def _draw_curves(
    ax: Axes, fits: Sequence[Calibration], groups: Sequence[Condition], scale: Scale, width: float
) -> None:
    """Each fit's curve for each group, with its band."""
    degrees = np.rad2deg(_ANGLES)
    for rank, fit in enumerate(fits):
        name = model_name(fit.model)
        for i, group in enumerate(groups):
            erosion, error = (values / scale.size for values in fit.curve(_ANGLES, group.values))
            color = _color(rank) if len(groups) == 1 else _color(i, len(groups))
            if len(groups) == 1 or rank == 0:
                ax.fill_between(degrees, erosion - width * error, erosion + width * error, color=color, linewidth=0,
                                alpha=0.12 if rank else 0.3, zorder=3)  # fmt: skip
            ax.plot(degrees, erosion, color=color, linestyle=_DASHES[rank], linewidth=1.4 if rank else 2.0,
                    zorder=4 - 0.1 * rank, label=name if len(groups) == 1 else "")  # fmt: skip
        if len(groups) > 1:
            # One entry for a model, whatever the colour.
            ax.plot([], [], color=INK, linestyle=_DASHES[rank], linewidth=1.4 if rank else 2.0, label=name)


def _draw_data(
    ax: Axes, fit: Calibration, values: np.ndarray, rows: np.ndarray, scale: Scale, look: Mapping[str, Any]
) -> None:
    """Rows with their uncertainties."""
    data = fit.data
    errors = None if data.uncertainty is None else data.uncertainty[rows] / scale.size
    many = len(data) > 500
    ax.errorbar(np.rad2deg(data.angle[rows]), values[rows] / scale.size, yerr=None if many else errors, elinewidth=0.9,
                markersize=2 if many else 4, capsize=2, alpha=0.3 if many else 0.9, zorder=2,
                **{**look, "fmt": "."} if many else look)  # fmt: skip


def _color(index: int, count: int = 1) -> Any:
    """One of `count` colours; more than the palette has are shades from dark to light, in order."""
    if count <= len(PALETTE):
        return list(PALETTE.values())[index]
    return mpl.colormaps["viridis"](0.92 * index / (count - 1))


def _label_whole(ax: Axes, meaning: str, unit: str) -> None:
    """A label of the y axis on as many lines as let all of it be seen."""
    figure: Any = ax.figure
    words = meaning.split(" ")
    forms = [f"{meaning}  {unit}".rstrip(), f"{meaning}\n{unit}".rstrip()]
    forms += [f"{' '.join(words[:i])}\n{' '.join(words[i:])}  {unit}".rstrip() for i in (len(words) // 2 + 1,)]
    for form in forms:
        label = ax.set_ylabel(form)
        figure.draw_without_rendering()
        if label.get_window_extent().height <= ax.get_window_extent().height:
            break
