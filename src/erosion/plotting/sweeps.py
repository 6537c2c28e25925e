"""Figures of sweeps, comparisons and regimes from their Datasets."""

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from erosion.impacts import BEYOND_LABEL
from erosion.parameters import QUANTITIES, System, readable_scale
from erosion.plotting.curves import mark_best
from erosion.plotting.labels import (
    AT_CONTACT,
    DIM,
    ENDS,
    INK,
    PALETTE,
    STYLES,
    Best,
    broken,
    coinciding,
    describe,
    end_label,
)
from erosion.plotting.style import (
    angle_axis,
    axes_or_new,
    house_style,
    legend_of_panel,
    mark_turned,
    new_figure,
    result_label,
)
from erosion.results import Finding, from_attribute
from erosion.sweeps.grid import in_words

_DASH = 8.0  # and gap, in widths of a line
_HIDDEN = 0.25  # share of a curve, from which on it is dashed
_SHARE: Mapping[str, Any] = {"alpha": 0.2, "linewidth": 0}  # of areas below curves of several colours


@house_style()
def plot_comparison(comparison: xr.Dataset, *, ax: Axes | None = None) -> Figure:
    """V(α) of several models, broken at jumps. A star marks each maximum; it is hollow if V only approaches it.

    The area below what is removed at contact, as by deformation, is shaded in the model's colour.
    """
    models = [str(name) for name in comparison.model.values]
    rows = -(-len(models) // 2)
    fig, ax = axes_or_new(ax, 6.6, 4.4 + 0.22 * rows)
    volume, degrees = comparison.volume.values, np.rad2deg(comparison.alpha.values)
    scale = readable_scale("volume", comparison.attrs["unit_system"], float(np.nanmax(comparison.volume_max)))
    shares: list[Any] = []
    for i, (name, below) in enumerate(zip(models, coinciding(volume, _HIDDEN), strict=True)):
        color, line = STYLES[i % len(STYLES)]
        if below:  # dashes through whose gaps these are seen
            line = (0, (_DASH / 2 ** len(below), _DASH * (1 - 1 / 2 ** len(below))))
        results = comparison.isel(model=i)
        alpha, kind = float(results.alpha_max), str(in_words(results.alpha_max_kind))
        # A comparison does not hold the side of a jump.
        best = Best(alpha, float(results.volume_max), kind, attained=kind != "jump" and alpha != 0)
        turned, slope = results.turned_beyond.values, np.deg2rad(1) * results.dvolume.values
        for flags, style, label in ((~turned, line, f"{name}: {describe(best)}"), (turned, ":", "")):
            if flags.any():
                x, y = broken(degrees, np.where(flags, volume[i], np.nan), slope)
                ax.plot(x, y / scale.size, color=color, linestyle=style, linewidth=1.8, label=label)
        at_contact = results.get("volume_at_contact", 0 * results.volume).values
        # Of a model that never cuts nothing is beside a cut.
        if at_contact.any() and np.any(results.t_c > 0):
            ax.fill_between(degrees, 0, at_contact / scale.size, color=color, **_SHARE)
            shares = [Patch(color=DIM, label=AT_CONTACT, **_SHARE)]
        if np.isfinite(best.alpha):
            mark_best(ax, best, scale.size, color)
    if comparison.turned_beyond.any():
        shares.append(Line2D([], [], color=INK, linestyle=":", label=BEYOND_LABEL))
    top = 1.06 * float(np.nanmax([comparison.volume_max.max(), comparison.volume.max()])) / scale.size
    ax.set(ylabel=result_label("volume", scale), ylim=(0, top))
    angle_axis(ax)
    legend_of_panel(ax, [*ax.get_legend_handles_labels()[0], *shares], 1 if len(models) < 4 else 2)
    return fig


@house_style()
def plot_regimes(regimes: xr.Dataset) -> Figure:
    """How cuts end and how much they remove, over angle and spin, with the best angle of each spin.

    A dotted line surrounds the cuts that turn the body by more than 90°.
    """
    units: System = regimes.attrs["unit_system"]
    fig = new_figure(7.2, 4.6)
    left, right = fig.subplots(1, 2, sharey=True)
    degrees = np.rad2deg(regimes.alpha.values)
    spin = readable_scale("angular speed", units, float(np.max(np.abs(regimes.phidot0))))
    spins = regimes.phidot0.values / spin.size
    names = regimes.ended_by.attrs["flag_meanings"].split()
    codes = regimes.ended_by.transpose("phidot0", "alpha").values
    present = [int(code) for code in np.unique(codes)]
    colors = [ENDS.get(names[code], INK) for code in present]
    left.pcolormesh(degrees, spins, np.searchsorted(present, codes), cmap=ListedColormap(colors), vmin=-0.5,
                    vmax=len(present) - 0.5, alpha=0.75, rasterized=True)  # fmt: skip
    volume = regimes.volume.transpose("phidot0", "alpha").values
    scale = readable_scale("volume", units, float(np.nanmax(volume)))
    mesh = right.pcolormesh(degrees, spins, volume / scale.size, cmap="cividis", rasterized=True)
    fig.colorbar(mesh, ax=right, label=result_label("volume", scale))
    jumps = in_words(regimes.alpha_max_kind) == "jump"
    best = np.rad2deg(regimes.alpha_max.values)
    for ax, ink in ((left, INK), (right, "white")):
        ax.plot(np.where(jumps, np.nan, best), spins, ".", color=ink, markersize=3.5)
        ax.plot(np.where(jumps, best, np.nan), spins, "D", color="none", markeredgecolor=ink, markersize=4)
        if regimes.turned_beyond.any():
            turned = regimes.turned_beyond.transpose("phidot0", "alpha").values
            ax.contour(degrees, spins, turned, levels=(0.5,), colors=ink, linewidths=1.1, linestyles="dotted")
        angle_axis(ax)
        ax.grid(visible=False)
        ax.set_title("how the cut ends" if ax is left else "what it removes", fontsize="medium")
    left.set_ylabel(f"{QUANTITIES['phidot0'].symbol}  {QUANTITIES['phidot0'].meaning}  [{spin.unit}]")
    handles: list[Any] = [
        Patch(color=color, alpha=0.75, label=end_label(names[code]))
        for code, color in zip(present, colors, strict=True)
    ]
    handles.append(Line2D([], [], marker=".", linestyle="", color=INK, label="greatest for this spin"))
    if jumps.any():
        handles.append(Line2D([], [], marker="D", linestyle="", color="none", markeredgecolor=INK, markersize=5,
                              label="greatest for this spin, at a jump"))  # fmt: skip
    if regimes.turned_beyond.any():
        handles.append(Line2D([], [], color=INK, linestyle="dotted", linewidth=1.1, label=f"inside: {BEYOND_LABEL}"))
    fig.legend(handles=handles, loc="outside lower center", ncols=3)
    return fig


_FEW = 6
"""Curves that a reader distinguishes easily; an axis with more values makes a map."""


def plot_sweep(sweep: xr.Dataset, *, ax: Axes | None = None) -> Figure:
    """The volume of a sweep: curves over one axis, or a map if both axes have many values.

    Args:
        sweep: of one or two dimensions. If it has more, select from it: `sweep.isel(v0=0)`.
        ax: where to draw; without it, in a new figure.

    Raises:
        ValueError: for a sweep of other dimensions.
    """
    numeric = sorted((dim for dim in sweep.dims if sweep[dim].dtype.kind == "f"), key=lambda dim: -sweep.sizes[dim])
    many = [dim for dim in numeric if sweep.sizes[dim] > _FEW]
    if not numeric or len(sweep.dims) > 2:
        shape = " × ".join(f"{n} {dim}" for dim, n in sweep.sizes.items())
        raise ValueError(
            f"A sweep must have one or two dimensions, one of them a parameter, to be drawn; this is {shape}."
        )
    fig, ax = axes_or_new(ax, 6.2, 4.4)
    if len(sweep.dims) == len(many) == 2:
        plot_volume_map(ax, sweep, *(str(dim) for dim in sweep.dims))
    else:
        plot_volume_family(ax, sweep, str(numeric[0]))
    return fig


@house_style()
def plot_volume_family(ax: Axes, sweep: xr.Dataset, along: str) -> Axes:
    """Removed volume along an axis, with one curve for each value of the other dimension if there is one."""
    scale = readable_scale("volume", _sweep_units(sweep), float(np.nanmax(sweep.volume)))
    x, x_label = _axis(sweep, along)
    other_dims = [str(dim) for dim in sweep.dims if dim != along]
    curves = sweep.volume.transpose(..., along).values.reshape(-1, len(x)) / scale.size
    labels = _labels(sweep, other_dims[0]) if other_dims else [sweep.attrs.get("model", "")]
    colors = list(PALETTE.values())
    if len(curves) > _FEW:
        colors = [mpl.colormaps["viridis"](fraction) for fraction in np.linspace(0, 0.92, len(curves))]
    for curve, label, color in zip(curves, labels, colors, strict=False):
        ax.plot(x, curve, color=color, label=label, marker="" if len(x) > 1 else "o")
    ax.set(xlabel=x_label, ylabel=result_label("volume", scale), ylim=(0, None))
    ax.margins(x=0)
    shown = slice(None, None, max(1, (len(curves) - 1) // (_FEW - 1)))
    handles = [*ax.get_legend_handles_labels()[0][shown], *mark_turned(ax, _findings(sweep))]
    legend_of_panel(ax, handles, min(3, len(handles)))
    return ax


@house_style()
def plot_volume_map(ax: Axes, sweep: xr.Dataset, x: str, y: str) -> Axes:
    """Removed volume over two axes, with lines where the kind of end changes."""
    scale = readable_scale("volume", _sweep_units(sweep), float(np.nanmax(sweep.volume)))
    (across, x_label), (up, y_label) = _axis(sweep, x), _axis(sweep, y)
    volume = sweep.volume.transpose(y, x).values / scale.size
    ends = sweep.ended_by.transpose(y, x).values.astype(float)
    image = ax.pcolormesh(across, up, volume, cmap="viridis", shading="nearest", rasterized=True)
    if np.ptp(ends) > 0:
        codes = np.unique(ends)
        ax.contour(across, up, ends, levels=(codes[1:] + codes[:-1]) / 2, colors="white", linewidths=1.2)
        ax.plot([], [], color="white", label="the end of the cut changes")
    mark_turned(ax, _findings(sweep))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper right", frameon=True, facecolor=INK, labelcolor="white", framealpha=0.75)
    ax.set(xlabel=x_label, ylabel=y_label)
    ax.grid(visible=False)
    figure: Any = ax.figure
    figure.colorbar(image, ax=ax, label=result_label("volume", scale))
    return ax


def _findings(sweep: xr.Dataset) -> tuple[Finding, ...]:
    return from_attribute(sweep.attrs.get("findings", ""))


def _sweep_units(sweep: xr.Dataset) -> System:
    if "unit_system" not in sweep.attrs:
        raise ValueError("Argument `sweep` must come from `erosion.sweep`; draw others with xarray: `sweep.t.plot()`.")
    return sweep.attrs["unit_system"]


def _axis(sweep: xr.Dataset, name: str) -> tuple[np.ndarray, str]:
    """Values in readable units, and the label of a parameter's axis; angles are in degrees."""
    values = sweep[name].values
    if name not in QUANTITIES:
        labels = sweep[name].attrs
        unit = "" if labels["units"] == "1" else f"  [{labels['units']}]"
        return values, f"{labels['symbol']}  {labels['long_name']}{unit}"
    quantity = QUANTITIES[name]
    if quantity.dimension == "angle":
        return np.rad2deg(values), f"{quantity.symbol}  {quantity.meaning}  [°]"
    scale = readable_scale(quantity.dimension, _sweep_units(sweep), float(np.abs(values).max()))
    unit = f"  [{scale.unit}]" if scale.unit else ""
    return values / scale.size, f"{quantity.symbol}  {quantity.meaning}{unit}"


def _labels(sweep: xr.Dataset, name: str) -> list[str]:
    if sweep[name].dtype.kind != "f":
        return [str(value) for value in sweep[name].values]
    values, label = _axis(sweep, name)
    unit = label.partition("[")[2].rstrip("]")
    return [
        f"{sweep[name].attrs['symbol']} = {value:.4g}{'' if unit == '°' else ' '}{unit}".rstrip() for value in values
    ]
