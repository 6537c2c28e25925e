"""Figures of sweeps: several curves, or a map over two axes."""

from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import System
from erosion.plotting.colors import INK, PALETTE
from erosion.plotting.style import axes_or_new, house_style, legend_of_panel

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
    if len(sweep.dims) == 2 and len(many) == 2:
        fig, ax = axes_or_new(ax, 6.2, 4.4)
        plot_volume_map(ax, sweep, *(str(dim) for dim in sweep.dims))
        return fig
    if not numeric or len(sweep.dims) > 2:
        shape = " × ".join(f"{n} {dim}" for dim, n in sweep.sizes.items())
        raise ValueError(
            f"A sweep must have one or two dimensions, one of them a parameter, to be drawn; this is {shape}."
        )
    fig, ax = axes_or_new(ax, 6.2, 4.4)
    plot_volume_family(ax, sweep, str(numeric[0]))
    return fig


@house_style()
def plot_volume_family(ax: Axes, sweep: xr.Dataset, along: str) -> Axes:
    """Removed volume along an axis, with one curve for each value of the other dimension if there is one."""
    scale = readable_scale("volume", _units(sweep), float(np.nanmax(sweep.volume)))
    x, x_label = _axis(sweep, along)
    other_dims = [str(dim) for dim in sweep.dims if dim != along]
    curves = sweep.volume.transpose(..., along).values.reshape(-1, len(x)) / scale.size
    labels = _labels(sweep, other_dims[0]) if other_dims else [sweep.attrs.get("model", "")]
    colors = list(PALETTE.values())
    if len(curves) > _FEW:
        colors = [mpl.colormaps["viridis"](fraction) for fraction in np.linspace(0, 0.92, len(curves))]
    for curve, label, color in zip(curves, labels, colors, strict=False):
        ax.plot(x, curve, color=color, label=label, marker="" if len(x) > 1 else "o")
    ax.set_xlabel(x_label)
    ax.set_ylabel(f"{RESULTS['volume'].symbol}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    ax.set_ylim(bottom=0)
    ax.margins(x=0)
    shown = slice(None, None, max(1, (len(curves) - 1) // (_FEW - 1)))
    handles = ax.get_legend_handles_labels()[0][shown]
    legend_of_panel(ax, handles, min(3, len(handles)))
    return ax


@house_style()
def plot_volume_map(ax: Axes, sweep: xr.Dataset, x: str, y: str) -> Axes:
    """Removed volume over two axes, with lines where the kind of end changes."""
    scale = readable_scale("volume", _units(sweep), float(np.nanmax(sweep.volume)))
    (across, x_label), (up, y_label) = _axis(sweep, x), _axis(sweep, y)
    volume = sweep.volume.transpose(y, x).values / scale.size
    ends = sweep.ended_by.transpose(y, x).values.astype(float)
    image = ax.pcolormesh(across, up, volume, cmap="viridis", shading="nearest", rasterized=True)
    if np.ptp(ends) > 0:
        codes = np.unique(ends)
        ax.contour(across, up, ends, levels=(codes[1:] + codes[:-1]) / 2, colors="white", linewidths=1.2)
        ax.plot([], [], color="white", label="the end of the cut changes")
        ax.legend(loc="upper right", frameon=True, facecolor=INK, labelcolor="white", framealpha=0.75)
    ax.set_xlabel(x_label)
    ax.set_ylabel(y_label)
    ax.grid(visible=False)
    figure: Any = ax.figure
    bar = figure.colorbar(image, ax=ax)
    bar.set_label(f"{RESULTS['volume'].symbol}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    return ax


def _units(sweep: xr.Dataset) -> System:
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
    scale = readable_scale(quantity.dimension, _units(sweep), float(np.abs(values).max()))
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
