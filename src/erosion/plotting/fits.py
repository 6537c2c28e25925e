"""Figures of fits and posteriors: measurements, curves with bands, profiles, pairs, traces, the next test."""

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.fits import Calibration, NextTest, Posterior
from erosion.fits.conditions import MOST, Condition, describe, is_same
from erosion.fits.measurements import Measurements, conditions
from erosion.fits.predicted import BestAngles
from erosion.fits.prediction import Predictor
from erosion.fits.problem import FitProblem
from erosion.models import model_name
from erosion.parameters import QUANTITIES, RESULTS, Scale, in_si, readable_scale, unit_name
from erosion.plotting.labels import ENDS, INK, MARKS, PALETTE, STYLES, coinciding, model_title
from erosion.plotting.style import angle_axis, house_style, legend_below, mark_turned, new_figure, typeset
from erosion.results import Finding, found

_FIT_ANGLES = np.deg2rad(np.linspace(0.5, 90.0, 180))
_DASHES: Sequence[Any] = (
    "-",
    (0, (5, 1.5)),
    (0, (5, 1.5, 1, 1.5)),
    (0, (1, 1.5)),
    (0, (8, 3)),
    (0, (3, 1, 1, 1, 1, 1)),
)
_ALIKE = 0.9  # share of the angles at which fits that are called the same are
_LINE = 36  # letters of a label beside a panel
_RIGHT = 92  # degrees, so that a mark at 90° is whole


@house_style()
def plot_calibration(fits: Sequence[Calibration], level: float = 0.95) -> Figure:
    """The data, the fitted curves, the band of the first fit's predictions, and its residuals.

    Data of several speeds or masses has a colour for each, and a curve of each fit; a model is then
    known by its dashes.

    Args:
        fits: fits to the same data, the best first; only the first six are drawn, because a reader
            cannot distinguish more.
        level: of the bands, which also hold what the model may lack.
    """
    best, data = fits[0], fits[0].data
    groups = conditions(data, MOST)
    fig = new_figure(6.2, 5.8)
    upper, lower = fig.subplots(2, 1, sharex=True, height_ratios=(0.72, 0.28))
    _draw_curves(upper, fits[: len(PALETTE)], groups, scale := data.scale, level)
    for i, group in enumerate(groups):
        look = {"color": INK if len(groups) == 1 else _color(i, len(groups)), "fmt": MARKS[i]}
        angle, erosion, residuals = (values[group.rows] for values in (data.angle, data.erosion, best.residuals))
        errors = None if data.uncertainty is None else data.whole_error[group.rows] / scale.size
        _draw_rows(upper, angle, erosion / scale.size, errors, {**look, "label": group.label or _source(data)})
        _draw_rows(lower, angle, residuals / scale.size, errors, look)
    lower.axhline(0, color=PALETTE["blue"] if len(groups) == 1 else INK, linewidth=1.4)
    lowest = data.erosion - (0.0 if data.uncertainty is None else data.whole_error)
    upper.set_ylim(bottom=min(0.0, 1.1 * float(lowest.min()) / scale.size))
    _mark_turned(upper, best.predictor, groups)
    angle_axis(lower)
    lower.set_xlim(0, _RIGHT)
    legend_below([upper], 3, title=f"bands: {level:.0%} of the mean, by {', '.join(best.predictor.parts)}")
    lower.set_ylabel(f"residuals\n{_unit(scale).strip()}".rstrip())
    upper.set_ylabel(_amount(data))
    return fig


def _source(data: Measurements) -> str:
    return "measured" if data.source == "data" else data.source


def _amount(data: Measurements) -> str:
    """The label of an axis, on as many lines as it needs."""
    return textwrap.fill(f"{typeset(data.quantity.symbol)}  {data.quantity.meaning} {_unit(data.scale)}", _LINE)


def _unit(scale: Scale) -> str:
    return f" [{scale.unit}]" if scale.unit else ""


def _draw_curves(
    ax: Axes, fits: Sequence[Calibration], groups: Sequence[Condition], scale: Scale, level: float
) -> None:
    """Each fit's curve for each group, with the band of the first one's mean."""
    degrees, names = np.rad2deg(_FIT_ANGLES), [model_title(model_name(fit.model)) for fit in fits]
    drawn = [np.stack([fit.curve(_FIT_ANGLES, group.values)[0] for group in groups]) for fit in fits]
    for rank, (fit, same) in enumerate(zip(fits, coinciding(drawn, _ALIKE), strict=True)):
        name = f"{names[rank]}, as {names[same[0]]}" if same else names[rank]
        for i, group in enumerate(groups):
            color = _color(rank) if len(groups) == 1 else _color(i, len(groups))
            if rank == 0:
                curves = fit.predictor.draw(_BAND_ANGLES, group.values, _DRAWS) / scale.size
                ends = np.nanquantile(curves, [(1 - level) / 2, (1 + level) / 2], axis=0)
                ax.fill_between(np.rad2deg(_BAND_ANGLES), *ends, color=color, linewidth=0, alpha=0.3, zorder=3)
            label, width = name if len(groups) == 1 else "", 1.4 if rank else 2.0
            ax.plot(degrees, drawn[rank][i] / scale.size, color=color, linestyle=_DASHES[rank], linewidth=width,
                    zorder=4 + 0.1 * rank, label=label)  # fmt: skip
        if len(groups) > 1:
            # One entry for a model, whatever the colour.
            ax.plot([], [], color=INK, linestyle=_DASHES[rank], linewidth=1.4 if rank else 2.0, label=name)


def _mark_turned(ax: Axes, predictor: Predictor, groups: Sequence[Condition]) -> None:
    """An entry of the legend where bodies turn by more than 90° along some curve."""
    share = max(predictor.share_turned({"alpha": _BAND_ANGLES, **group.values}) for group in groups)
    mark_turned(ax, found((share, Finding("turned_beyond_at_draws", numbers={"share": share}))))


def _draw_rows(
    ax: Axes, angle: np.ndarray, erosion: np.ndarray, errors: np.ndarray | None, look: Mapping[str, Any]
) -> None:
    """Rows with their errors; of very many rows points alone."""
    many = len(angle) > 500
    style: dict[str, Any] = {**look, "linestyle": "", **({"fmt": "."} if many else {})}
    ax.errorbar(np.rad2deg(angle), erosion, yerr=None if many else errors, elinewidth=0.9, markersize=2 if many else 4,
                capsize=2, alpha=0.3 if many else 0.9, zorder=2,
                **style)  # fmt: skip


def _color(index: int, count: int = 1) -> Any:
    """One of `count` colours; more than the palette has are shades from dark to light, in order."""
    if count <= len(PALETTE):
        return list(PALETTE.values())[index]
    return mpl.colormaps["viridis"](0.92 * index / (count - 1))


_BAND_ANGLES = np.deg2rad(np.linspace(0.5, 89.5, 179))
_DRAWS = 400  # of a band: its 95 % ends are known to some percents of its width
_DECADE = 10.0  # of an interval, from which on the axis is logarithmic
_BINS = 40
_LEAST_GAIN = 0.01  # of an axis, in per cent or bits
_BANDS = ((0.95, 0.18), (0.5, 0.4))  # probability, opacity


@house_style()
def plot_pairs(posterior: Posterior) -> Figure:
    """Each parameter's draws as a histogram, and each pair's as points: ridges and several modes are seen here.

    A parameter that varies by more than a factor of 10 has a logarithmic axis.
    """
    names = posterior.names
    columns, last = [_Column(posterior, name) for name in names], len(names) - 1
    size = max(1.7 * len(names), 3.2)
    fig = new_figure(size + 0.5, size)
    axes = np.atleast_2d(fig.subplots(len(names), len(names), squeeze=False))
    for (i, row), (j, column) in itertools.product(enumerate(columns), repeat=2):
        ax = axes[i, j]
        if j > i:
            ax.remove()
            continue
        if i == j:
            ax.hist(row.values, row.bins, color=PALETTE["blue"], alpha=0.8)
            ax.set_yticks([])
            ax.grid(visible=False)
        else:
            ax.plot(column.values, row.values, ".", color=PALETTE["blue"], markersize=2, alpha=0.25)
            row.scale_axis(ax.yaxis)
        column.scale_axis(ax.xaxis)
        ax.tick_params(labelbottom=i == last, labelleft=0 == j < i, labelsize="small")
        ax.tick_params(axis="x", rotation=45 if i == last else 0)
        ax.set_xlabel(column.label if i == last else "")
        ax.set_ylabel(row.label if 0 == j < i else "")
    fig.align_labels()
    return fig


@house_style()
def plot_traces(posterior: Posterior) -> Figure:
    """The draws of each population one after the other, and their histograms: populations that agree look alike."""
    names = posterior.names
    fig = new_figure(6.2, 1.5 * len(names) + 0.7)
    axes = fig.subplots(len(names), 2, squeeze=False, width_ratios=(0.7, 0.3), sharey="row")
    for (left, right), name in zip(axes, names, strict=True):
        column = _Column(posterior, name)
        for chain, color in zip(column.chains, PALETTE.values(), strict=False):
            left.plot(chain, color=color, linewidth=0.5)
            right.hist(chain, column.bins, histtype="step", orientation="horizontal", color=color)
        column.scale_axis(left.yaxis)
        left.set_ylabel(column.label)
        right.set_xticks([])
        left.tick_params(labelbottom=False)
        right.grid(visible=False)
    axes[-1, 0].tick_params(labelbottom=True)
    axes[-1, 0].set_xlabel("draw of each population")
    axes[0, 0].set_title(f"R̂ {max(posterior.rhat.values()):.4f}", fontsize="small", loc="left")
    return fig


@house_style()
def plot_prediction(posterior: Posterior, at: Mapping[str, Any] | None = None) -> Figure:
    """Plot predictions over all angles, and below how cuts end, for draws of the posterior.

    The bands are quantiles of the curve, without the error of a measurement, at each angle. Where V(α) jumps at another
    angle for each draw, a band spans the jump, and the panel below says which share of the draws is beyond it.

    Args:
        posterior: the draws.
        at: other parameters of the case, such as {"v0": "60 m/s"}; see `Parameters.replace`. Without it each speed and
            mass of the data has bands, in a colour of its own, and its rows; of more than six, those of similar energy
            share one. They have a panel on their ends together where these are the same, as without rotation, else one
            each.
    """
    groups = _drawn_groups(posterior.problem, None if at is None else [at])
    ends = [posterior.ends(_BAND_ANGLES, group.values, _DRAWS) for group in groups]
    are_same = all(np.array_equal(ends[0], other) for other in ends)
    panels = (1.15,) if are_same else (0.72,) * len(groups)
    fig = new_figure(6.2, 4.2 + sum(panels))
    upper, *lower = fig.subplots(1 + len(panels), 1, sharex=True, height_ratios=(3.7, *panels))
    for ax, of_group, group in zip(lower, ends, groups, strict=False):
        _draw_ends(ax, of_group)
        ax.set_ylabel("share of draws" if are_same else "share")
        ax.set_title("" if are_same else group.label, fontsize="small", loc="left", pad=2)
    _draw_means([upper, *lower], posterior.predictor, groups)
    return fig


@house_style()
def plot_means(predictor: Predictor, at: Sequence[Mapping[str, Any]]) -> Figure:
    """The bands of the mean over all angles, at other parameters of the case, in a colour for each."""
    fig = new_figure(6.2, 4.2)
    _draw_means([fig.subplots()], predictor, _drawn_groups(predictor.problem, at))
    return fig


def _drawn_groups(problem: FitProblem, asked: Sequence[Mapping[str, Any]] | None) -> list[Condition]:
    """The rows of each speed and mass; or what is asked for, with its rows if it was measured."""
    data = problem.data
    groups = conditions(data, len(PALETTE))
    if asked is None:
        return groups

    def rows(at: Mapping[str, float]) -> np.ndarray:
        for group in groups:
            tested = {**{name: float(getattr(problem.p, name)) for name in at}, **group.values}
            if all(is_same(at.get(name, data.usual.get(name, value)), value) for name, value in tested.items()):
                return group.rows
        return np.zeros(0, int)

    read = [in_si(at, QUANTITIES, problem.p.shown_in) for at in asked]
    return [Condition(rows(at), at, describe(at, data.shown_in)) for at in read]


def _draw_means(axes: Sequence[Axes], predictor: Predictor, groups: Sequence[Condition]) -> None:
    """The bands and the rows of each group on the first of the axes, the angles below the last, and the legend."""
    fig: Any = axes[0].figure
    (upper, *lower), data = axes, predictor.data
    curves = [predictor.draw(_BAND_ANGLES, group.values, _DRAWS) for group in groups]
    is_alone, errors, scale = len(groups) == 1, predictor.row_errors, data.scale
    for i, (group, curve, mark) in enumerate(zip(groups, curves, cycle(MARKS), strict=False)):
        look = {"color": _color(i, len(groups)), "fmt": mark, "label": group.label}
        _draw_bands(upper, curve / scale.size, look["color"], labelled=is_alone)
        if is_alone:
            look = {"color": INK, "fmt": "o", "label": _source(data)}
        if group.rows.size:
            angle, erosion, error = (values[group.rows] for values in (data.angle, data.erosion, errors))
            _draw_rows(upper, angle, erosion / scale.size, error / scale.size, look)
        elif not is_alone:
            upper.plot([], [], color=look["color"], label=group.label)
    if not is_alone:
        # One entry for a band, whatever its colour.
        for level, opacity in _BANDS:
            upper.fill_between([], [], color=INK, alpha=opacity, linewidth=0, label=f"{level:.0%}")
        upper.plot([], [], color=INK, label="median")
    angle_axis(axes[-1])
    axes[-1].set_xlim(0, _RIGHT)
    what = groups[0].label if is_alone else data.source
    upper.set_title(
        f"{model_title(model_name(predictor.problem.model))}\n{what}", fontsize="small", loc="left", wrap=True
    )
    upper.set_ylim(bottom=0)
    _mark_turned(upper, predictor, groups)
    legend_below([upper, *lower], 4, title=f"bands: of the mean, by {', '.join(predictor.parts)}")
    upper.set_ylabel(_amount(data))
    fig.align_ylabels()


@house_style()
def plot_best_angles(best: BestAngles) -> Figure:
    """The angle of greatest removal at each draw, and the removal there, coloured by the kind of the maximum.

    Bars and points are of the model alone; a line shows the angles with what the model may lack.
    """
    optimum = best.optimum
    volume, kinds = np.atleast_1d(optimum.volume), np.atleast_1d(optimum.kind)
    scale = readable_scale("volume", optimum.p.shown_in, float(np.nanmax(volume)))
    fig = new_figure(5.4, 4.6)
    upper, lower = fig.subplots(2, 1, sharex=True, height_ratios=(0.4, 0.6))
    degrees, predicted = np.rad2deg(best.of_model), np.rad2deg(best.alpha)
    together = np.append(degrees, predicted)
    bins = np.linspace(np.nanmin(together), np.nanmax(together) + 1e-9, _BINS)
    parts = [degrees[(kinds == kind) & np.isfinite(degrees)] for kind in best.kinds]
    labels = [f"{kind}: {share:.1%} of the draws" for kind, share in best.kinds.items()]
    upper.hist(parts, bins, stacked=True, color=[*PALETTE.values()][: len(parts)], label=labels)
    if best.predicted is not None:
        upper.hist(predicted, bins, histtype="step", color=INK, label=f"with {', '.join(best.parts)}")
    for kind, color in zip(best.kinds, PALETTE.values(), strict=False):
        of_kind = kinds == kind
        lower.plot(degrees[of_kind], volume[of_kind] / scale.size, ".", color=color, markersize=4, alpha=0.5)
    upper.set_ylabel("draws")
    lower.set_xlabel(f"{typeset(RESULTS['alpha_max'].symbol)} [°]")
    lower.set_ylabel(f"{typeset(RESULTS['volume_max'].symbol)}  [{scale.unit}]")
    legend_below([upper], 2)
    return fig


@house_style()
def plot_next_test(answer: NextTest) -> Figure:
    """By how much one more test narrows the prediction and the parameters, over its angle, a curve for each speed.

    Of several models the last panel is about which one is right. The best candidate narrows the prediction most. Where
    no candidate can be judged, the figure says so.
    """
    if not answer.best:
        fig = new_figure(6.2, 1.2)
        fig.suptitle(answer.sentence, fontsize="small", wrap=True)
        return fig
    panels = [("prediction narrows by", "[%]", 100 * answer.prediction),
              ("parameters narrow by", "[%]", 100 * answer.parameters),
              ("about the model", "[bit]", answer.discrimination)][: 3 if len(answer.names) > 1 else 2]  # fmt: skip
    fig = new_figure(6.2, 1.2 + 2.2 * len(panels))
    axes = fig.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    best, degrees = int(answer.order[0]), np.rad2deg(answer.candidates["alpha"])
    best_in_words = ", ".join(answer.condition_in_words(name, values[best]) for name, values in answer.shown.items())
    for ax, (_, _, gains) in zip(axes, panels, strict=True):
        for (label, candidates), (color, line) in zip(_by_conditions(answer), cycle(STYLES)):
            order = candidates[np.argsort(degrees[candidates])]
            ax.plot(degrees[order], gains[order], color=color, linestyle=line, marker=".", label=label)
        ax.plot(degrees[best], gains[best], "*", color=PALETTE["orange"], markersize=13, markeredgecolor=INK,
                markeredgewidth=0.7, zorder=5, label=f"best: {best_in_words}")  # fmt: skip
        ax.set_ylim(0, max(1.05 * float(np.nanmax(gains)), _LEAST_GAIN))
    angle_axis(axes[-1])
    axes[0].set_title(f"what one more test narrows: {', '.join(answer.names)}", fontsize="small", loc="left", wrap=True)
    fig.align_ylabels(axes)
    legend_below([axes[0]], 4)
    for ax, (meaning, unit, _) in zip(axes, panels, strict=True):
        ax.set_ylabel(f"{meaning}\n{unit}")
    return fig


def _by_conditions(answer: NextTest) -> list[tuple[str, np.ndarray]]:
    """The candidates with the same conditions but for the angle, by words for these."""
    others = {name: values for name, values in answer.shown.items() if name != "alpha"}
    rows = np.stack([*others.values(), np.zeros(len(answer.prediction))], axis=1)  # of no others, too
    groups = []
    for kind in np.unique(rows, axis=0):
        words = [answer.condition_in_words(name, value) for name, value in zip(others, kind, strict=False)]
        groups.append((", ".join(words) or "_one condition", np.flatnonzero((rows == kind).all(axis=1))))
    return groups


class _Column:
    """The draws of one parameter in the unit of its axis."""

    def __init__(self, posterior: Posterior, name: str) -> None:
        quantity = posterior.quantities[name]
        chains = posterior.samples[name].values
        low, high = np.quantile(chains, [0.025, 0.975])
        self.logarithmic = bool(low > 0 and high / low > _DECADE)
        middle = float(np.median(chains))
        scale = readable_scale(quantity.dimension, posterior.p.shown_in, abs(middle))
        if quantity.dimension == "1" or self.logarithmic:
            scale = Scale(quantity.size(posterior.p.shown_in), unit_name(quantity.dimension, posterior.p.shown_in))
        self.chains = chains / scale.size
        self.values = self.chains.ravel()
        self.label = f"{typeset(quantity.symbol)}{_unit(scale)}"
        least, greatest = self.values.min(), self.values.max()
        spaced: Any = np.geomspace if self.logarithmic else np.linspace
        ends = spaced(least, greatest, _BINS) if greatest > least else [least - 0.5, least + 0.5]
        self.bins = [float(end) for end in ends]

    def scale_axis(self, axis: Any) -> None:
        """Make the axis logarithmic where the draws are."""
        if self.logarithmic:
            axis._set_axes_scale("log")


def _draw_bands(ax: Axes, curves: np.ndarray, color: str, *, labelled: bool) -> None:
    """The quantiles of curves, shape (draws, angles), and their median."""
    degrees = np.rad2deg(_BAND_ANGLES)
    for level, opacity in _BANDS:
        label = f"{level:.0%}" if labelled else ""
        low, high = np.nanquantile(curves, [(1 - level) / 2, (1 + level) / 2], axis=0)
        ax.fill_between(degrees, low, high, color=color, alpha=opacity, linewidth=0, label=label)
    ax.plot(degrees, np.nanmedian(curves, axis=0), color=color, label="median" if labelled else "")


def _draw_ends(ax: Axes, ends: np.ndarray) -> None:
    """The shares of the draws by how their cuts end, over the angle; shape (draws, angles)."""
    kinds = sorted(set(ends.ravel().tolist()), key=lambda kind: [*ENDS, kind].index(kind))
    shares = [(ends == kind).mean(axis=0) for kind in kinds]
    others = iter(PALETTE[name] for name in ("green", "purple", "sky", "orange"))
    colors = [ENDS[kind] if kind in ENDS else next(others) for kind in kinds]
    ax.stackplot(np.rad2deg(_BAND_ANGLES), *shares, colors=colors, labels=kinds, alpha=0.6, linewidth=0)
    ax.set_ylim(0, 1)
