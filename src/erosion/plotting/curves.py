"""Curves over the angle of attack, broken where they jump: optima, families, models beside correlations."""

import itertools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.correlations import CORRELATIONS
from erosion.impacts import ASIDE, BEYOND_LABEL, MEASURES, TURNED, Optimum, impact, turned_beyond
from erosion.models import NO_CUT
from erosion.parameters import QUANTITIES, QUARTER_DEGREES, RESULTS, Scale, System, readable_scale
from erosion.plotting.labels import (
    AT_CONTACT,
    DIM,
    ENDS,
    EVENT_LABELS,
    FAINT,
    INK,
    PALETTE,
    REMOVED_AT_CONTACT,
    STYLES,
    Best,
    broken,
    describe,
    end_label,
    leaps,
    model_title,
    parted,
    with_gaps,
)
from erosion.plotting.style import (
    angle_axis,
    axes_or_new,
    house_style,
    legend_below,
    new_axes,
    result_label,
)
from erosion.sweeps.grid import in_words


def mark_best(
    ax: Axes, best: Best | Optimum, size: float, color: str = PALETTE["orange"], label: str | None = None
) -> None:
    """Draw a star at the optimum, hollow if the curve only approaches it; the axis shows values divided by `size`."""
    reached = best.attained
    ax.plot([np.rad2deg(best.alpha)], [best.value / size], "*", markersize=13, color=color if reached else "white",
            markeredgecolor=INK if reached else color, markeredgewidth=0.7 if reached else 1.2, zorder=6, clip_on=False,
            label=label)  # fmt: skip


_SHALLOWEST = 1e-4  # rad; a curve over angles from 0 begins here
_MARKS = {"interior": "o", "jump": "D", "boundary": "s", "limit": "<", "kink": "^", "plateau": "_", "unresolved": "v"}


class Piece(NamedTuple):
    """A part of a curve that has no jump, and on which all cuts end in the same way, or the body turns too far.

    Args:
        alpha: angles, shape (n,) [rad].
        value: the objective at these angles, shape (n,).
        slope: its derivative, shape (n,) [per rad].
        at_contact: what contact adds to it, beside the cut, shape (n,).
        ended_by: how the cut ends, "turned" where the body turns further than the optimum allows.
        beyond: whether the body turns by more than 90°, shape (n,).
    """

    alpha: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    at_contact: np.ndarray
    ended_by: str
    beyond: np.ndarray


def pieces(optimum: Optimum, points: int = 600) -> list[Piece]:
    """The objective over the range of angles that was searched, for scalar parameters."""
    low, high = optimum.regimes[0].low, optimum.regimes[-1].high
    breaks = sorted({*(jump.alpha for jump in optimum.jumps), *(regime.low for regime in optimum.regimes[1:])})
    aside = min(ASIDE, (high - low) / 1000)
    limits = [low or min(_SHALLOWEST, high / 100), *breaks, high - aside]
    spans = [(a + 2 * aside, b - 2 * aside) for a, b in itertools.pairwise(limits) if b - a > 10 * aside]
    counts = [max(3, round(points * (b - a) / (high - low))) for a, b in spans]
    angles = [np.linspace(a, b, count) for (a, b), count in zip(spans, counts, strict=True)]
    # With second derivatives, as the optimum was computed: so its points lie on the curve to the last bit.
    p = optimum.p.replace(alpha=np.concatenate(angles))
    hits = impact(optimum.integrand, p, derivatives=2)
    cuts, beyond = np.cumsum(counts)[:-1], turned_beyond(optimum.model, p)
    numbers = hits.volume, hits.dvolume, hits.volume_at_contact, hits.ended_by, beyond
    columns = (np.split(column, cuts) for column in numbers)
    # Of a range where the body turns too far only its ends were searched.
    begins = np.array([regime.low for regime in optimum.regimes[1:]])
    regimes = (optimum.regimes[np.searchsorted(begins, alpha[0])] for alpha in angles)
    return [
        Piece(alpha, value, slope, contact, TURNED if regime.ended_by == TURNED else str(end[len(end) // 2]), turned)
        for alpha, value, slope, contact, end, turned, regime in zip(angles, *columns, regimes, strict=True)
    ]


@house_style()
def plot_optimum(
    optimum: Optimum, *, ax: Axes | None = None, marks: Mapping[str, tuple[float, float]] = MappingProxyType({})
) -> Figure:
    """The objective over the angle, with the regimes, the jumps, the candidates and the optimum.

    The area below what is removed at contact, as by deformation, is shaded.

    Args:
        optimum: for scalar parameters.
        ax: where to draw; without it, in a new figure.
        marks: (α, value) of further points, by their names in `MARKS`.

    Raises:
        ValueError: for a batch of optima.
    """
    if np.ndim(optimum.kind):
        raise ValueError(
            f"Argument `optimum` must be of one set of parameters, but has the shape {np.shape(optimum.kind)}."
        )
    fig, ax = axes_or_new(ax, 6.2, 4.4)
    curve = pieces(optimum)
    measured = MEASURES.get(optimum.objective)
    dimension = "1" if measured is None else RESULTS[measured].dimension
    largest = max(float(np.nanmax(np.abs(piece.value))) for piece in curve)
    scale = readable_scale(dimension, optimum.p.shown_in, largest)
    # Of a model that never cuts nothing is beside a cut.
    cuts = any(piece.ended_by != NO_CUT for piece in curve)
    shares = cuts and any(piece.at_contact.any() for piece in curve)
    for piece in curve:
        color, degrees, value = ENDS.get(piece.ended_by, INK), np.rad2deg(piece.alpha), piece.value / scale.size
        if not piece.beyond.all():
            ax.plot(degrees, np.where(piece.beyond, np.nan, value), color=color, linewidth=2.2,
                    label=end_label(piece.ended_by))  # fmt: skip
        if piece.beyond.any():
            slope = np.deg2rad(piece.slope) / scale.size
            ax.plot(*broken(degrees, np.where(piece.beyond, value, np.nan), slope), color=color, linewidth=2.2,
                    linestyle=":", label=BEYOND_LABEL)  # fmt: skip
    for piece in curve if shares else ():
        at_contact = piece.at_contact / scale.size
        ax.fill_between(np.rad2deg(piece.alpha), 0, at_contact, label=AT_CONTACT, **REMOVED_AT_CONTACT)
    for jump in optimum.jumps:
        ax.plot([np.rad2deg(jump.alpha)] * 2, np.array([jump.below, jump.above]) / scale.size, color=DIM,
                linestyle=(0, (2, 2)), linewidth=1.2, label="jump")  # fmt: skip
    if np.isfinite(optimum.value) and optimum.kind != "none":
        label = f"{'least' if optimum.least else 'greatest'}: {describe(optimum)}"
        mark_best(ax, optimum, scale.size, label=label)
    for candidate in optimum.candidates[1:]:
        ax.plot(np.rad2deg(candidate.alpha), candidate.value / scale.size, _MARKS[candidate.kind], color="white",
                markeredgecolor=INK, markersize=7, zorder=4, label="other candidates")  # fmt: skip
    _mark(ax, marks, scale)
    ax.set_ylabel(optimum.objective if measured is None else result_label(measured, scale))
    angle_axis(ax, *(np.rad2deg(end) for end in (optimum.regimes[0].low, optimum.regimes[-1].high)))
    ax.set_ylim(bottom=0, top=1.05 * ax.get_ylim()[1])
    legend_below(ax, 2)
    return fig


_COLORS = (*PALETTE.values(), INK)
_MARKERS = ("o", "s", "^", "v", "D", "P")
_WIDE = 30  # times the least maximum; with a larger maximum the axis is logarithmic

_ROUNDING = 2.0**-52
_PALE = 0.35  # opacity


class ShapeCurve(NamedTuple):
    """V(α) of one model and set of parameters.

    Args:
        label: the text in the legend.
        angles: α, ascending, shape (n,) [rad]; NaN where the curve has a gap.
        volume: V, shape (n,) [m³].
        best: the maximum, α = 0 for a limit; None draws no mark.
        beyond: where the body turns by more than 90°, shape (n,); there the curve is dotted.
    """

    label: str
    angles: np.ndarray
    volume: np.ndarray
    best: Best | Optimum | None = None
    beyond: np.ndarray | None = None


class AngleSeries(NamedTuple):
    """Angles of greatest removal over a parameter, ascending; arrays of shape (n,).

    Args:
        label: the text in the legend.
        x: the values of the parameter.
        alpha: α_max [rad], NaN where nothing is removed.
        at_jump: whether the maximum is at a jump of V(α).
        line: whether to join the maxima, with gaps where another one becomes the greatest; without it only markers are
            drawn.
        beyond: where the body turns by more than 90°; there the markers are pale.
    """

    label: str
    x: np.ndarray
    alpha: np.ndarray
    at_jump: np.ndarray
    line: bool = True
    beyond: np.ndarray | None = None


def _over_angles(ax: Axes, label: str, columns: int, limits: tuple[float | None, float | None] | None = None) -> Axes:
    """Finish a panel of curves over α: the label and the limits of y, the axis of α, and the legend below."""
    ax.set(ylabel=label, ylim=limits)
    angle_axis(ax)
    legend_below(ax, columns)
    return ax


def draw_parted(ax: Axes, x: np.ndarray, y: np.ndarray, beyond: np.ndarray | None, label: str, **style: Any) -> None:
    """Draw y(x), dotted where the body turns by more than 90°, with entries of the legend for both."""
    beyond = np.zeros(x.size, bool) if beyond is None else beyond
    valid, dotted = parted(y, beyond)
    ax.plot(x, valid, label=label, **style)
    if beyond.any():
        ax.plot(x, dotted, **style | {"linestyle": ":"})
        ax.plot([], [], color=DIM, linestyle=":", linewidth=1.9, label=BEYOND_LABEL)


def draw_curve(ax: Axes, curve: ShapeCurve, size: float, label: str, **style: Any) -> None:
    """V(α) divided by `size`, dotted where the body turns by more than 90°."""
    draw_parted(ax, np.rad2deg(curve.angles), curve.volume / size, curve.beyond, label, **style)


@house_style()
def plot_family(
    ax: Axes, curves: Sequence[ShapeCurve], *, system: System, joined: bool = False, columns: int = 3
) -> Axes:
    """Removed volume over the angle of attack, several curves on one figure.

    If the maxima differ much, the axis is logarithmic: curves of one shape are then shifted copies.

    Args:
        ax: empty axes.
        curves: in the order of the legend.
        system: the unit system, for labels.
        joined: join the maxima by a dashed line, in the order of the curves.
        columns: of the legend.
    """
    largest = [float(np.nanmax(curve.volume)) for curve in curves]
    scale = readable_scale("volume", system, max(largest))
    for i, curve in enumerate(curves):
        colors_used_up = i >= len(_COLORS)
        draw_curve(ax, curve, scale.size, curve.label, color=_COLORS[i % len(_COLORS)],
                    linestyle=(0, (4, 3)) if colors_used_up else "-", linewidth=1.9)  # fmt: skip
    tops = [curve.best for curve in curves if curve.best is not None]
    if joined and tops:
        angles, volumes = np.array([(best.alpha, best.value) for best in tops]).T
        ax.plot(np.rad2deg(angles), volumes / scale.size, linestyle=(0, (2, 2)), color=INK, linewidth=1.1)
    for best in tops:
        mark_best(ax, best, scale.size, label="greatest" if best.attained else "approached, not reached")
    least, top = min(largest), max(largest) / scale.size
    limits = (0, 1.1 * top or None)
    if max(largest) > _WIDE * least > 0:
        ax.set_yscale("log")
        limits = (0.03 * least / scale.size, 2 * top)
    return _over_angles(ax, result_label("volume", scale), columns, limits)


@house_style()
def plot_best_angles(
    ax: Axes,
    best: Sequence[AngleSeries],
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
    for i, (label, x, alpha, at_jump, line, beyond) in enumerate(best):
        color, degrees = _COLORS[i % len(_COLORS)], np.rad2deg(alpha)
        highest = max([highest, *degrees[np.isfinite(degrees)]])
        if line:
            ax.plot(*with_gaps(leaps(degrees), x, degrees), color=color, linewidth=1.7)
        marker, size = _MARKERS[i % len(_MARKERS)], 4 if line else 6.5
        plain = {"color": color, "markersize": size, "markeredgecolor": color if line else INK, "markeredgewidth": 0.6}
        open_ = {"markerfacecolor": "none", "markeredgecolor": color, "markersize": size + 2.5, "markeredgewidth": 1.3}
        looks: list[tuple[np.ndarray, dict[str, Any], str]] = [
            (~at_jump, plain, label),
            (at_jump, open_, f"{label}, at a jump"),
        ]
        pale = np.zeros(x.size, bool) if beyond is None else beyond
        for at, style, words in looks:
            if at.any():
                ax.plot([], [], marker, label=words, **style)
                ax.plot(x[at & ~pale], degrees[at & ~pale], marker, **style)
                ax.plot(x[at & pale], degrees[at & pale], marker, alpha=_PALE, **style)
        if pale.any():
            ax.plot([], [], "o", color=INK, alpha=_PALE, markersize=6, label=BEYOND_LABEL)
    if log:
        ax.set_xscale("log")
    ax.set_ylim(0, 15 * np.ceil(min(highest + 4, 90) / 15))
    ticks = range(0, int(ax.get_ylim()[1]) + 1, 15)
    ax.set_yticks(ticks, [f"{tick}°" for tick in ticks])
    ax.set(xlabel=xlabel, ylabel=f"${QUANTITIES['alpha'].symbol}_\\mathrm{{max}}$  angle of greatest removal")
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
    top = max(1e-8, 10 * max(float(np.nanmax(difference)) for difference in differences.values()))
    return _over_angles(ax, "difference over the volume scale V*", 1, (1e-17, top))


@house_style()
def plot_turn(ax: Axes, angles: np.ndarray, turn: np.ndarray, ended_by: np.ndarray) -> Axes:
    """Plot the turn of the body over the angle of attack; colours show how the cut ends.

    Args:
        ax: empty axes.
        angles: α, ascending, shape (n,) [rad].
        turn: |Δφ|, shape (n,) [rad].
        ended_by: shape (n,).
    """
    changes = np.flatnonzero(ended_by[1:] != ended_by[:-1]) + 1
    ax.plot(*with_gaps(changes, np.rad2deg(angles), np.rad2deg(turn)), color=FAINT, linewidth=1.5)
    for end in dict.fromkeys(str(end) for end in ended_by):
        shown = ended_by == end
        ax.plot(np.rad2deg(angles[shown]), np.rad2deg(turn[shown]), "o", color=ENDS.get(end, INK), markersize=5,
                label=end_label(end))  # fmt: skip
    if np.any(turn > np.pi / 2):
        ax.axhline(90, color=DIM, linestyle=":", linewidth=1.9, label="90°: limit of validity")
    ax.yaxis.set_major_formatter("{x:g}°")
    return _over_angles(ax, f"{RESULTS['turn'].symbol}  {RESULTS['turn'].meaning}", 2)


_DASHES = ("-", (0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)), (0, (6, 2, 1, 2, 1, 2)), (0, (10, 3)))


@house_style()
def plot_shapes(ax: Axes, curves: Sequence[ShapeCurve], correlations: Sequence[str]) -> Axes:
    """Models' V/V_max in colour and correlations' F/F_max in grey, over the angle of attack.

    Args:
        ax: empty axes.
        curves: of models; those that remove nothing are left out.
        correlations: names in `erosion.CORRELATIONS`.
    """
    angles = np.append(0.0, QUARTER_DEGREES)
    for i, name in enumerate(correlations):
        correlation = CORRELATIONS[name]
        label = f"{correlation.title}: {np.rad2deg(correlation.alpha_max):.1f}°"
        ax.plot(np.rad2deg(angles), np.asarray(correlation.normalised(angles)), color=DIM, linewidth=1.3,
                linestyle=_DASHES[i % len(_DASHES)], label=label)  # fmt: skip
    marked = [(curve, curve.best) for curve in curves if curve.best is not None]
    for (curve, best), (color, line) in zip(marked, itertools.cycle(STYLES)):
        label = f"{curve.label}: {describe(best)}"
        draw_curve(ax, curve, float(best.value), label, color=color, linestyle=line, linewidth=2)
    return _over_angles(ax, "divided by its own maximum", 2, (0, 1.05))


def curves_of(comparison: xr.Dataset) -> list[ShapeCurve]:
    """The models of `erosion.compare`, broken at jumps."""
    curves = []
    for name in comparison.model.values:
        results = comparison.sel(model=name)
        alpha, greatest, kind = float(results.alpha_max), float(results.volume_max), in_words(results.alpha_max_kind)
        # A comparison does not hold the side of a jump.
        best = Best(alpha, greatest, str(kind), attained=str(kind) != "jump" and alpha != 0)
        angles, volume = broken(results.alpha.values, results.volume.values, results.dvolume.values)
        beyond = np.isin(angles, results.alpha.values[results.turned_beyond.values])
        has_best = bool(np.isfinite([alpha, greatest]).all() and greatest > 0)
        curves.append(ShapeCurve(model_title(str(name)), angles, volume, best if has_best else None, beyond))
    return curves


@house_style()
def plot_against_correlations(comparison: xr.Dataset, correlations: Sequence[str]) -> Figure:
    """The models of `erosion.compare` and engineering correlations, each divided by its own maximum.

    Args:
        comparison: the result of `erosion.compare`.
        correlations: names in `erosion.CORRELATIONS`.
    """
    curves = curves_of(comparison)
    fig, ax = new_axes(6.6, 4.4 + 0.11 * (len(curves) + len(correlations)))
    plot_shapes(ax, curves, correlations)
    return fig


MARKS = {
    "cusp": ("D", PALETTE["green"], "cusp at {}"),
    "case": ("o", PALETTE["purple"], "this case, {}"),
}
"""Marker, colour and label of the points over the angle that a figure can mark."""


@house_style()
def plot_end_times(
    ax: Axes,
    angles: np.ndarray,
    candidates: Mapping[str, np.ndarray],
    t_c: np.ndarray,
    *,
    system: System,
    real_part: np.ndarray | None = None,
    marks: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> Axes:
    """When each event alone would end the cut, and when the cut ends, over the angle (Laverty, Figure 9).

    Args:
        ax: empty axes.
        angles: α, shape (n,) [rad].
        candidates: by event name, times of shape (n,) [s]; NaN where the event never happens.
        t_c: the actual end, shape (n,) [s].
        system: the unit system, for labels.
        real_part: the real part of the complex root of ẋ = 0, shape (n,) [s]; NaN where the root is real.
        marks: (α, t) of points, by their names in `MARKS`.
    """
    time = readable_scale("time", system, float(np.nanmax(t_c)))
    degrees = np.rad2deg(angles)
    ax.plot(
        degrees, t_c / time.size, color=DIM, alpha=0.4, linewidth=9, solid_capstyle="butt", label="actual end $t_c$"
    )
    for name, times in candidates.items():
        ax.plot(degrees, times / time.size, color=ENDS.get(name, INK), label=EVENT_LABELS.get(name, name))
    if real_part is not None:
        ax.plot(degrees, real_part / time.size, color=ENDS["stop"], linestyle=(0, (4, 4)), alpha=0.7,
                label="ẋ = 0: real part, complex root")  # fmt: skip
    _mark(ax, marks, time)
    return _over_angles(ax, result_label("t_c", time), 2, (0, 1.12 * float(np.nanmax(t_c)) / time.size))


def _mark(ax: Axes, marks: Mapping[str, tuple[float, float]], scale: Scale) -> None:
    for name, (alpha, value) in marks.items():
        marker, color, label = MARKS[name]
        angle = float(np.rad2deg(alpha))
        ax.plot([angle], [value / scale.size], marker, color=color, markersize=7, markeredgecolor=INK,
                markeredgewidth=0.7, zorder=5, clip_on=False, label=label.format(f"{angle:.4g}°"))  # fmt: skip
