"""Figures of comparisons and of regime maps, drawn from their Datasets."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import System
from erosion.plotting.colors import DIM, ENDS, INK, STYLES
from erosion.plotting.curves import Best, broken, describe
from erosion.plotting.labels import AT_CONTACT, end_label
from erosion.plotting.marks import mark_best
from erosion.plotting.style import axes_or_new, house_style, legend_of_panel, new_figure, typeset
from erosion.sweeps.grid import in_words

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
    scale = readable_scale("volume", _units(comparison), float(np.nanmax(comparison.volume_max)))
    handles, shares = [], []
    for i, name in enumerate(models):
        color, line = STYLES[i % len(STYLES)]
        results = comparison.isel(model=i)
        x, y = broken(degrees, volume[i], np.deg2rad(1) * results.dvolume.values)
        ax.plot(x, y / scale.size, color=color, linestyle=line, linewidth=1.8)
        at_contact = results.get("volume_at_contact", 0 * results.volume).values
        # Of a model that never cuts nothing is beside a cut.
        if at_contact.any() and np.any(results.t_c > 0):
            ax.fill_between(degrees, 0, at_contact / scale.size, color=color, **_SHARE)
            shares = [Patch(color=DIM, label=AT_CONTACT, **_SHARE)]
        best = _best(results)
        if np.isfinite(best.alpha):
            mark_best(ax, best, scale.size, color)
        label = f"{name}: {describe(best)}"
        handles.append(Line2D([], [], color=color, linestyle=line, linewidth=1.8, label=label))
    ax.set_ylabel(f"{typeset(RESULTS['volume'].symbol)}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    ax.set_xlim(0 if degrees[0] < 1 else degrees[0], degrees[-1])
    ax.set_ylim(bottom=0, top=1.06 * float(np.nanmax(comparison.volume_max)) / scale.size)
    _angle_axis(ax.xaxis)
    legend_of_panel(ax, [*handles, *shares], 1 if len(models) < 4 else 2)
    return fig


@house_style()
def plot_regimes(regimes: xr.Dataset) -> Figure:
    """How cuts end and how much they remove, over angle and spin, with the best angle of each spin."""
    units = _units(regimes)
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
    bar = fig.colorbar(mesh, ax=right)
    bar.set_label(f"{typeset(RESULTS['volume'].symbol)}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    jumps = in_words(regimes.alpha_max_kind) == "jump"
    best = np.rad2deg(regimes.alpha_max.values)
    for ax, ink in ((left, INK), (right, "white")):
        ax.plot(np.where(jumps, np.nan, best), spins, ".", color=ink, markersize=3.5)
        ax.plot(np.where(jumps, best, np.nan), spins, "D", color="none", markeredgecolor=ink, markersize=4)
        _angle_axis(ax.xaxis)
        ax.set_xlim(0, 90)
        ax.grid(visible=False)
    left.set_ylabel(f"{QUANTITIES['phidot0'].symbol}  {QUANTITIES['phidot0'].meaning}  [{spin.unit}]")
    left.set_title("how the cut ends", fontsize=10)
    right.set_title("what it removes", fontsize=10)
    handles: list[Any] = [
        Patch(color=color, alpha=0.75, label=end_label(names[code]))
        for code, color in zip(present, colors, strict=True)
    ]
    handles.append(Line2D([], [], marker=".", linestyle="", color=INK, label="greatest for this spin"))
    if jumps.any():
        handles.append(Line2D([], [], marker="D", linestyle="", color="none", markeredgecolor=INK, markersize=5,
                              label="greatest for this spin, at a jump"))  # fmt: skip
    fig.legend(handles=handles, loc="outside lower center", ncols=3)
    return fig


def _best(results: xr.Dataset) -> Best:
    """A model's best angle in a comparison; the comparison does not hold the side of a jump."""
    alpha, kind = float(results.alpha_max), str(in_words(results.alpha_max_kind))
    return Best(alpha, float(results.volume_max), kind, attained=kind != "jump" and alpha != 0)


def _angle_axis(axis: Any) -> None:
    axis.set_ticks(range(0, 91, 15))
    axis.set_major_formatter("{x:g}°")
    axis.set_label_text(f"{QUANTITIES['alpha'].symbol}  {QUANTITIES['alpha'].meaning}")


def _units(dataset: xr.Dataset) -> System:
    return dataset.attrs["unit_system"]
