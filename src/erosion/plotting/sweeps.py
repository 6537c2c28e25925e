"""Figures of sweeps, comparisons and regimes from their Datasets."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from erosion.impacts import BEYOND_LABEL, QUARTER_TURN
from erosion.models import NO_CUT
from erosion.parameters import QUANTITIES, Scale, System, readable_scale
from erosion.plotting.curves import curves_of, draw_curve, draw_parted, mark_best
from erosion.plotting.labels import (
    AT_CONTACT,
    DIM,
    ENDS,
    INK,
    MARKS,
    NOTHING,
    PALETTE,
    STYLES,
    describe,
    end_label,
    model_title,
)
from erosion.plotting.style import (
    PlainNumbers,
    angle_axis,
    axes_or_new,
    fit_legends,
    house_style,
    legend_below,
    mark_turned,
    new_figure,
    result_label,
)
from erosion.results import Finding, from_attribute
from erosion.sweeps.grid import in_words

_BESIDE = 5.0  # inches; two panels of a narrower figure are below each other
_APART = 0.3  # of the panel's diagonal, between the marks of a curve
_GOLDEN = 0.618  # of this distance, from the marks of a curve to those of the next: so all lie apart
_HATCH = "////"
_BOUNDARY = 1.2  # width of a line
_SHARE: Mapping[str, Any] = {"alpha": 0.2, "linewidth": 0}  # of areas below curves of several colours


@house_style()
def plot_comparison(comparison: xr.Dataset, *, ax: Axes | None = None) -> Figure:
    """V(α) of several models, broken at jumps. A star marks each maximum; it is hollow if V only approaches it.

    The area below what is removed at contact, as by deformation, is shaded in the model's colour.
    """
    curves, degrees = curves_of(comparison), np.rad2deg(comparison.alpha.values)
    fig, ax = axes_or_new(ax, 6.6, 4.4 + 0.22 * len(curves))
    scale = readable_scale("volume", comparison.attrs["unit_system"], float(np.nanmax(comparison.volume_max)))
    shares: list[Any] = []
    for i, curve in enumerate(curves):
        (color, line), mark = STYLES[i % len(STYLES)], MARKS[i % len(MARKS)]
        # The marks lie beside each other where curves coincide.
        marks = {"marker": mark, "markersize": 5, "markevery": (_APART * ((i + 0.3) * _GOLDEN % 1), _APART)}
        label = f"{curve.label}: {NOTHING if curve.best is None else describe(curve.best)}"
        draw_curve(ax, curve, scale.size, label, color=color, linestyle=line, linewidth=1.6,
                   **(marks if len(curves) > 1 else {}))  # fmt: skip
        results = comparison.isel(model=i)
        at_contact = results.get("volume_at_contact", 0 * results.volume).values
        # Of a model that never cuts nothing is beside a cut.
        if at_contact.any() and np.any(results.t_c > 0):
            ax.fill_between(degrees, 0, at_contact / scale.size, color=color, **_SHARE)
            shares = [Patch(color=DIM, label=AT_CONTACT, **_SHARE)]
        if curve.best is not None:
            mark_best(ax, curve.best, scale.size, color)
    top = 1.06 * float(np.nanmax([comparison.volume_max.max(), comparison.volume.max()])) / scale.size
    ax.set(ylabel=result_label("volume", scale), ylim=(0, top))
    angle_axis(ax)
    legend_below(ax, 1, [*ax.get_legend_handles_labels()[0], *shares])
    return fig


class _Axis(NamedTuple):
    """An axis of a sweep: its values in a readable unit, the size of this, its label, and whether it is logarithmic."""

    name: str
    values: np.ndarray
    size: float
    label: str
    log: bool

    def apply(self, axis: XAxis | YAxis) -> None:
        """Scale and name an axis of a panel."""
        axis.set_label_text(self.label)
        if self.log:
            axis.axes.set(**{f"{axis.axis_name}scale": "log"})
            axis.set(major_formatter=PlainNumbers(), minor_formatter=PlainNumbers())

    @property
    def edges(self) -> np.ndarray:
        """The middles between neighbouring values, on the scale of the axis, from the first value to the last."""
        middles = (self.values[1:] + self.values[:-1]) / 2
        if self.log:
            middles = np.sqrt(self.values[1:] * self.values[:-1])
        return np.array([self.values[0], *middles, self.values[-1]])


@dataclasses.dataclass(frozen=True)
class _Plane:
    """Two parameters of a sweep, as the axes of panels."""

    found: xr.Dataset
    across: _Axis
    up: _Axis

    @classmethod
    def of(cls, found: xr.Dataset, x: str, y: str) -> "_Plane":
        for name in (x, y):
            if found.sizes[name] < 2:
                raise ValueError(f"A map must have two or more values of each parameter, but has one of `{name}`.")
        return cls(found.transpose(y, x, ...), _axis(found, x), _axis(found, y))

    def fill(self, ax: Axes, values: np.ndarray, **look: Any) -> QuadMesh:
        """Colour each point, and name the axes."""
        self.across.apply(ax.xaxis)
        self.up.apply(ax.yaxis)
        ax.grid(visible=False)
        return ax.pcolormesh(self.across.edges, self.up.edges, values, rasterized=True, **look)

    @property
    def is_of_optima(self) -> bool:
        """Whether there is a best angle for each point."""
        return "alpha_max" in self.found and self.found.alpha_max.ndim == len((self.across, self.up))

    def draw_results(self, ax: Axes) -> None:
        """Colour each point by its best angle, or else by its volume, with a colour bar."""
        if self.is_of_optima:
            values, label = np.rad2deg(self.found.alpha_max), _BEST
        else:
            scale = readable_scale("volume", _sweep_units(self.found), float(np.nanmax(self.found.volume)))
            values, label = self.found.volume / scale.size, result_label("volume", scale)
        figure: Any = ax.figure
        figure.colorbar(self.fill(ax, values.values, cmap="cividis"), ax=ax, label=label)

    def draw_regions(self, ax: Axes, ink: str) -> list[Artist]:
        """Draw where results change their kind, and where a model does not hold; returns entries of a legend."""
        if self.is_of_optima:
            return self._line(ax, "best_boundary", _optima_label(self.found), ink)
        line = self._line(ax, "end_boundary", _ends_label(self.found), ink)
        self._line(ax, "turn_boundary", "", ink, linestyle=":")
        return [*line, *self._hatch(ax, ink)]

    def _hatch(self, ax: Axes, ink: str) -> list[Artist]:
        """Hatch the region of the cuts that turn the body too far."""
        turned = _turned(self.found)
        if turned is None:
            return mark_turned(ax, _findings(self.found))
        flags = turned.values
        if not flags.any():
            return []
        region = ax.contourf(
            self.across.values, self.up.values, flags, levels=[0.5, 1.5], colors="none", hatches=[_HATCH]
        )
        region.set(edgecolor=ink, linewidth=0)
        return [Patch(facecolor="none", edgecolor=INK, linewidth=0, hatch=_HATCH, label=BEYOND_LABEL)]

    def _line(self, ax: Axes, name: str, label: str, ink: str, linestyle: str = "-") -> list[Artist]:
        """Draw a boundary of the sweep, if it has this one."""
        if name not in self.found or not self.found[name].size:
            return []
        pieces = self.found[name].sel(axis=[self.across.name, self.up.name]).values
        lines = LineCollection(
            list(pieces / (self.across.size, self.up.size)), color=ink, linewidth=_BOUNDARY, linestyle=linestyle
        )
        ax.add_collection(lines, autolim=False)
        return [Line2D([], [], color=INK, linewidth=_BOUNDARY, label=label)]


@house_style()
def plot_regimes(regimes: xr.Dataset) -> Figure:
    """Plot ends of cuts and volumes over two parameters, with the best angles.

    Over the angle and another parameter dots are the best angle of each value. Over two other parameters the best angle
    is the colour, and the ends are those of its cuts. Hatched cuts turn the body by more than 90°.
    """
    y, x = regimes.volume.dims
    plane, of_optima = _Plane.of(regimes, str(x), str(y)), "alpha" not in (x, y)
    fig = new_figure(7.2, 4.6)
    beside = fig.get_figwidth() > _BESIDE
    if not beside:
        fig.set_figheight(2 * fig.get_figwidth())
    left, right = fig.subplots(1 if beside else 2, 2 if beside else 1, sharex=True, sharey=True)
    ends = regimes.alpha_max_ended_by if of_optima else regimes.ended_by
    names, present = ends.attrs["flag_meanings"].split(), np.unique(ends.values)
    colors = [ENDS.get(names[code], INK) for code in present]
    look: dict[str, Any] = {"cmap": ListedColormap(colors), "vmin": -0.5, "vmax": len(present) - 0.5, "alpha": 0.75}
    plane.fill(left, np.searchsorted(present, ends.values), **look)
    plane.draw_results(right)
    handles = plane.draw_regions(left, INK)
    plane.draw_regions(right, "white")
    if not of_optima:
        handles += _draw_best(left, regimes, plane, x == "alpha", INK)
        _draw_best(right, regimes, plane, x == "alpha", "white")
    left.set_title("how the best cut ends" if of_optima else "how the cut ends", fontsize="medium")
    right.set_title("its angle" if of_optima else "what it removes", fontsize="medium")
    (right.yaxis if beside else left.xaxis).label.set_visible(False)
    patches = [Patch(color=color, alpha=0.75, label=end_label(names[code]))
               for code, color in zip(present, colors, strict=True)]  # fmt: skip
    legend_below([left, right], 3, [*patches, *handles])
    fit_legends(fig)
    return fig


_IN_WORDS: Mapping[str, str] = {
    "interior": "smooth maximum", "boundary": "end of the range", "limit": "limit of the turn", "none": "no cut",
    NO_CUT: "no cut",
}  # fmt: skip


def _sides(codes: xr.DataArray) -> str:
    """The words for the codes of a map: "between rebound and stop"; empty if all are the same."""
    *others, last = (_IN_WORDS.get(word, word) for word in np.unique(in_words(codes)))
    return f"between {', '.join(others)} and {last}" if others else ""


def _ends_label(sweep: xr.Dataset) -> str:
    return f"boundary {_sides(sweep.ended_by)}"


def _optima_label(sweep: xr.Dataset) -> str:
    sides = filter(None, (_sides(sweep.alpha_max_kind), _sides(sweep.alpha_max_ended_by)))
    return "boundary " + ",\nor ".join(sides)


def _draw_best(ax: Axes, regimes: xr.Dataset, plane: _Plane, flat: bool, ink: str) -> list[Line2D]:
    """Draw the best angle of each value of the other parameter; `flat` where the angle runs along x."""
    jumps = in_words(regimes.alpha_max_kind) == "jump"
    best, values = np.rad2deg(regimes.alpha_max.values), (plane.up if flat else plane.across).values
    marks: tuple[tuple[np.ndarray, str, dict[str, Any]], ...] = (
        (~jumps, "", {"marker": ".", "color": ink, "markersize": 3.5}),
        (jumps, ", at a jump", {"marker": "D", "color": "none", "markeredgecolor": ink, "markersize": 4}),
    )
    drawn: list[Line2D] = []
    for chosen, more, look in marks:
        if chosen.any():
            at = (best[chosen], values[chosen]) if flat else (values[chosen], best[chosen])
            drawn += ax.plot(*at, linestyle="", label=f"greatest for this value{more}", **look)
    return drawn


_FEW = 6
"""Curves that a reader distinguishes easily; an axis with more values makes a map."""


def plot_sweep(sweep: xr.Dataset, *, ax: Axes | None = None) -> Figure:
    """The volume of a sweep: curves over one axis, or a map if both have many values; of best angles if it has them.

    Args:
        sweep: of one or two dimensions. If it has more, select from it: `sweep.isel(v0=0)`.
        ax: where to draw; without it, in a new figure.

    Raises:
        ValueError: for a sweep of other dimensions.
    """
    sizes = {str(dim): length for dim, length in sweep.volume.sizes.items()}
    numeric = [dim for dim in sizes if sweep[dim].dtype.kind == "f"]
    require_drawable(sizes, numeric)
    fig, ax = axes_or_new(ax, 6.2, 4.4)
    if len(numeric) == 2 and min(sizes.values()) > _FEW:
        plot_sweep_map(ax, sweep, *sizes)
    else:
        plot_volume_family(ax, sweep, max(numeric, key=sizes.__getitem__))
    return fig


def require_drawable(sizes: Mapping[str, int], parameters: Collection[str]) -> None:
    """Refuse a sweep that `plot_sweep` cannot draw.

    Args:
        sizes: the lengths of its dimensions.
        parameters: those of its axes; other dimensions are "model" and "pair".

    Raises:
        ValueError: for more than two dimensions, and where none is a parameter.
    """
    if len(sizes) > 2 or not sizes.keys() & parameters:
        shape = " × ".join(f"{n} {dim}" for dim, n in sizes.items())
        raise ValueError(
            f"A sweep must have one or two dimensions, one of them a parameter, to be drawn; this is {shape}."
        )


@house_style()
def plot_volume_family(ax: Axes, sweep: xr.Dataset, along: str) -> Axes:
    """Removed volume along an axis, with one curve for each value of the other dimension if there is one."""
    scale = readable_scale("volume", _sweep_units(sweep), float(np.nanmax(sweep.volume)))
    axis = _axis(sweep, along)
    other_dims = [str(dim) for dim in sweep.volume.dims if dim != along]
    curves = sweep.volume.transpose(..., along).values.reshape(-1, len(axis.values)) / scale.size
    labels = _labels(sweep, other_dims[0]) if other_dims else [model_title(sweep.attrs.get("model", ""))]
    turned = _turned(sweep)
    beyond = [None] * len(curves) if turned is None else turned.transpose(..., along).values.reshape(curves.shape)
    colors = list(PALETTE.values())
    if len(curves) > _FEW:
        colors = [mpl.colormaps["viridis"](fraction) for fraction in np.linspace(0, 0.92, len(curves))]
    for curve, dotted, label, color in zip(curves, beyond, labels, colors, strict=False):
        draw_parted(ax, axis.values, curve, dotted, label, color=color, marker="" if len(curve) > 1 else "o")
    axis.apply(ax.xaxis)
    ax.set(ylabel=result_label("volume", scale), ylim=(0, None))
    ax.margins(x=0)
    shown = slice(None, None, max(1, (len(curves) - 1) // (_FEW - 1)))
    handles = {handle.get_label(): handle for handle in ax.get_legend_handles_labels()[0]}
    entries = [*labels[shown], *(label for label in (BEYOND_LABEL,) if label in handles)]
    legend_below(ax, 3, [handles[label] for label in entries]
                 + (mark_turned(ax, _findings(sweep)) if turned is None else []))  # fmt: skip
    return ax


@house_style()
def plot_sweep_map(ax: Axes, sweep: xr.Dataset, x: str, y: str) -> Axes:
    """The best angle over two axes, or without it the removed volume, with the lines where its kind changes."""
    plane = _Plane.of(sweep, x, y)
    plane.draw_results(ax)
    if handles := plane.draw_regions(ax, "white"):
        legend_below([ax], 2, handles)
    return ax


def _turned(sweep: xr.Dataset) -> xr.DataArray | None:
    """Where the body turns by more than 90°; None where the sweep does not hold it."""
    if "turned_beyond" in sweep:
        return sweep.turned_beyond
    return sweep.turn > QUARTER_TURN if "turn" in sweep else None


def _findings(sweep: xr.Dataset) -> tuple[Finding, ...]:
    return from_attribute(sweep.attrs.get("findings", ""))


def _sweep_units(sweep: xr.Dataset) -> System:
    if "unit_system" not in sweep.attrs:
        raise ValueError("Argument `sweep` must come from `erosion.sweep`; draw others with xarray: `sweep.t.plot()`.")
    return sweep.attrs["unit_system"]


_BEST = "best angle  [°]"
_LARGE = 1e4  # from which on four digits would need a power of ten
_EQUAL = 1e-6  # relative difference of the steps of an axis


def _axis(sweep: xr.Dataset, name: str) -> _Axis:
    """A parameter's axis, in readable units; angles are in degrees."""
    values = sweep[name].values
    log = _is_geometric(values)
    if name not in QUANTITIES:
        labels = sweep[name].attrs
        unit = "" if labels["units"] == "1" else f"  [{labels['units']}]"
        return _Axis(name, values, 1.0, f"{labels['symbol']}  {labels['long_name']}{unit}", log)
    quantity = QUANTITIES[name]
    scale = Scale(math.pi / 180, "°")
    if quantity.dimension != "angle":
        scale = readable_scale(quantity.dimension, _sweep_units(sweep), float(np.abs(values).max()))
    unit = f"  [{scale.unit}]" if scale.unit else ""
    return _Axis(name, values / scale.size, scale.size, f"{quantity.symbol}  {quantity.meaning}{unit}", log)


def _is_geometric(values: np.ndarray) -> bool:
    """Whether the ratios of neighbours are equal, and their distances are not."""
    if len(values) <= 2 or values[0] * values[-1] <= 0 or not (values > 0).all():
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(
        np.allclose(ratios, ratios[0], rtol=_EQUAL, atol=0) and not np.allclose(steps, steps[0], rtol=_EQUAL, atol=0)
    )


def _labels(sweep: xr.Dataset, name: str) -> list[str]:
    if sweep[name].dtype.kind != "f":
        return [model_title(str(value)) for value in sweep[name].values]
    axis = _axis(sweep, name)
    unit = axis.label.partition("[")[2].rstrip("]")
    space = "" if unit == "°" else " "
    symbol, values = sweep[name].attrs["symbol"], axis.values
    numbers, digits = [f"{value:{'.0f' if abs(value) >= _LARGE else '.4g'}}" for value in values], 4
    while len({*numbers}) < len({*values.tolist()}):  # repr has 17 digits, by which all differ
        digits += 1
        numbers = [f"{value:.{digits}g}" for value in values]
    return [f"{symbol} = {number}{space}{unit}".rstrip() for number in numbers]
