"""Several V(α) on one figure, and the angle of greatest removal over a parameter."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import System
from erosion.plotting.colors import ENDS, FAINT, INK, PALETTE
from erosion.plotting.curves import leaps, with_gaps
from erosion.plotting.labels import end_label
from erosion.plotting.style import angle_axis, house_style, legend_below

_COLORS = (*PALETTE.values(), INK)
_MARKERS = ("o", "s", "^", "v", "D", "P")
_WIDE = 30  # times the least maximum; with a larger maximum the axis is logarithmic

_ROUNDING = 2.0**-52


class Curve(NamedTuple):
    """V(α) of one model and set of parameters.

    Args:
        label: the text in the legend.
        angles: α, ascending, shape (n,) [rad]; NaN where the curve has a gap.
        volume: V, shape (n,) [volume].
        best: (α, V) of the maximum, α = 0 for a limit; None draws no mark.
        attained: whether V reaches the maximum or only approaches it.
    """

    label: str
    angles: np.ndarray
    volume: np.ndarray
    best: tuple[float, float] | None = None
    attained: bool = True


class BestAngles(NamedTuple):
    """Angles of greatest removal over a parameter, ascending; arrays of shape (n,).

    Args:
        label: the text in the legend.
        x: the values of the parameter.
        alpha: α_max [rad], NaN where nothing is removed.
        at_jump: whether the maximum is at a jump of V(α).
        line: whether to join the maxima, with gaps where another one becomes the greatest; without it only markers are
            drawn.
    """

    label: str
    x: np.ndarray
    alpha: np.ndarray
    at_jump: np.ndarray
    line: bool = True


@house_style()
def plot_family(ax: Axes, curves: Sequence[Curve], *, units: System, joined: bool = False, columns: int = 3) -> Axes:
    """Removed volume over the angle of attack, several curves on one figure.

    If the maxima differ much, the axis is logarithmic: curves of one shape are then shifted copies.

    Args:
        ax: empty axes.
        curves: in the order of the legend.
        units: the unit system, for labels.
        joined: join the maxima by a dashed line, in the order of the curves.
        columns: of the legend.
    """
    largest = [float(np.nanmax(curve.volume)) for curve in curves]
    scale = readable_scale("volume", units, max(largest))
    for i, curve in enumerate(curves):
        colors_used_up = i >= len(_COLORS)
        ax.plot(np.rad2deg(curve.angles), curve.volume / scale.size, color=_COLORS[i % len(_COLORS)],
                linestyle=(0, (4, 3)) if colors_used_up else "-", linewidth=1.9, label=curve.label)  # fmt: skip
    marked = [curve for curve in curves if curve.best is not None]
    tops = np.array([curve.best for curve in marked]).reshape(-1, 2)
    if joined:
        ax.plot(np.rad2deg(tops[:, 0]), tops[:, 1] / scale.size, linestyle=(0, (2, 2)), color=INK, linewidth=1.1)
    for attained, fill, label in ((True, PALETTE["orange"], "greatest"), (False, "none", "approached, not reached")):
        drawn = np.array([curve.attained == attained for curve in marked], bool)
        if drawn.any():
            ax.plot(np.rad2deg(tops[drawn, 0]), tops[drawn, 1] / scale.size, "*" if attained else "o", color=fill,
                    markersize=12 if attained else 8, markeredgecolor=INK, markeredgewidth=0.8, linestyle="none",
                    zorder=5, clip_on=False, label=label)  # fmt: skip
    least = min(largest)
    if max(largest) > _WIDE * least > 0:
        ax.set_yscale("log")
        ax.set_ylim(0.03 * least / scale.size, 2 * max(largest) / scale.size)
    else:
        ax.set_ylim(0, 1.1 * max(largest) / scale.size or None)
    ax.set_ylabel(f"${RESULTS['volume'].symbol}$  {RESULTS['volume'].meaning}  [{scale.unit}]")
    angle_axis(ax)
    legend_below(ax, columns)
    return ax


@house_style()
def plot_best_angles(
    ax: Axes,
    best: Sequence[BestAngles],
    *,
    xlabel: str,
    log: bool = False,
    exact: tuple[str, np.ndarray, np.ndarray] | None = None,
    columns: int = 2,
) -> Axes:
    """The angle of greatest removal over a parameter; hollow markers show maxima at jumps.

    Args:
        ax: empty axes.
        best: in the order of the legend.
        xlabel: of the parameter.
        log: whether its axis is logarithmic.
        exact: label, parameter and angle [rad] of a law, at close points, drawn as a broad pale line.
        columns: of the legend.
    """
    if exact is not None:
        label, x, alpha = exact
        degrees = np.rad2deg(alpha)
        ax.plot(
            *with_gaps(leaps(degrees), x, degrees),
            color=PALETTE["sky"],
            linewidth=7,
            alpha=0.5,
            label=label,
        )
    highest = 0.0
    for i, (label, x, alpha, at_jump, line) in enumerate(best):
        color, degrees = _COLORS[i % len(_COLORS)], np.rad2deg(alpha)
        highest = max([highest, *degrees[np.isfinite(degrees)]])
        if line:
            ax.plot(*with_gaps(leaps(degrees), x, degrees), color=color, linewidth=1.7)
        marker, size = _MARKERS[i % len(_MARKERS)], 4 if line else 6.5
        ax.plot(x[~at_jump], degrees[~at_jump], marker, color=color, markersize=size, label=label,
                markeredgecolor=color if line else INK, markeredgewidth=0.6)  # fmt: skip
        if at_jump.any():
            ax.plot(x[at_jump], degrees[at_jump], marker, markerfacecolor="none", markeredgecolor=color,
                    markersize=size + 2.5, markeredgewidth=1.3, label=f"{label}, at a jump")  # fmt: skip
    if log:
        ax.set_xscale("log")
    ax.set_ylim(0, 15 * np.ceil(min(highest + 4, 90) / 15))
    ticks = range(0, int(ax.get_ylim()[1]) + 1, 15)
    ax.set_yticks(ticks, [f"{tick}°" for tick in ticks])
    ax.set_xlabel(xlabel)
    ax.set_ylabel(f"${QUANTITIES['alpha'].symbol}_\\mathrm{{max}}$  angle of greatest removal")
    legend_below(ax, columns)
    return ax


@house_style()
def plot_differences(ax: Axes, angles: np.ndarray, differences: Mapping[str, np.ndarray]) -> Axes:
    """Relative differences over the angle of attack, on a logarithmic axis down to rounding.

    Args:
        ax: empty axes.
        angles: α, shape (n,) [rad].
        differences: by label, not negative, shape (n,).
    """
    for color, (label, difference) in zip(_COLORS, differences.items(), strict=False):
        # A logarithmic axis has no zero: a difference of zero is drawn at the smallest value.
        ax.semilogy(np.rad2deg(angles), np.maximum(difference, _ROUNDING), ".", color=color, markersize=4, label=label)
    ax.axhline(_ROUNDING, color=INK, linestyle=(0, (4, 3)), linewidth=1, label="rounding of one number")
    ax.set_ylim(1e-17, max(1e-8, 10 * max(float(np.nanmax(difference)) for difference in differences.values())))
    ax.set_ylabel("difference over the volume scale V*")
    angle_axis(ax)
    legend_below(ax, 1)
    return ax


@house_style()
def plot_turn(ax: Axes, angles: np.ndarray, turn: np.ndarray, ended_by: np.ndarray) -> Axes:
    """How far the body turns during the cut, over the angle of attack; colours show how the cut ends.

    Args:
        ax: empty axes.
        angles: α, ascending, shape (n,) [rad].
        turn: Δφ, shape (n,) [rad].
        ended_by: shape (n,).
    """
    changes = np.flatnonzero(ended_by[1:] != ended_by[:-1]) + 1
    ax.plot(*with_gaps(changes, np.rad2deg(angles), np.rad2deg(turn)), color=FAINT, linewidth=1.5)
    for end in dict.fromkeys(str(end) for end in ended_by):
        shown = ended_by == end
        ax.plot(np.rad2deg(angles[shown]), np.rad2deg(turn[shown]), "o", color=ENDS.get(end, INK), markersize=5,
                label=end_label(end))  # fmt: skip
    ax.yaxis.set_major_formatter("{x:g}°")
    ax.set_ylabel(f"{RESULTS['turn'].symbol}  {RESULTS['turn'].meaning}")
    angle_axis(ax)
    legend_below(ax, 2)
    return ax
