"""Figures of streams: the volumes that single particles remove, and the mean volume over the nozzle's angle."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, PercentFormatter

from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import System
from erosion.plotting.colors import DIM, INK, PALETTE
from erosion.plotting.style import house_style, new_figure
from erosion.streams.nozzle import NozzleAngle
from erosion.streams.result import Stream


@house_style()
def plot_stream(stream: Stream) -> Figure:
    """The histogram of the volumes and, if it was computed, the curve over the nozzle's angle."""
    panels = 1 if stream.nozzle is None else 2
    fig = new_figure(5.8, 3.6 * panels)
    axes = np.ravel(fig.subplots(panels, 1))
    plot_stream_histogram(axes[0], stream)
    if stream.nozzle is not None:
        plot_nozzle_angle(axes[1], stream.nozzle, stream.particles.p.units)
    return fig


class _PlainNumbers(LogFormatter):
    """Ticks of a logarithmic axis as 0.3 and 30, not 3e-01 and 3 × 10¹."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


@house_style()
def plot_stream_histogram(ax: Axes, stream: Stream) -> Axes:
    """The share of the particles over the volume that they remove; the title says how many remove nothing."""
    edges, shares = stream.tally.histogram()
    mean = stream.mean_volume.value
    scale = readable_scale("volume", stream.particles.p.units, mean)
    ax.stairs(shares, edges / scale.size, fill=True, color=PALETTE["orange"], alpha=0.55)
    ax.stairs(shares, edges / scale.size, color=PALETTE["vermillion"])
    ax.axvline(mean / scale.size, color=PALETTE["blue"], label="mean")
    ax.axvline(stream.quantiles[0.5] / scale.size, color=PALETTE["green"], linestyle="--", label="median")
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(_PlainNumbers())
    ax.xaxis.set_minor_formatter(_PlainNumbers())
    ax.set_xlabel(f"{RESULTS['volume'].symbol}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    ax.set_ylabel("share of the particles")
    ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    ax.set_ylim(bottom=0)
    nothing = stream.tally.bins[0] / stream.tally.bins.sum()
    title = f"{100 * nothing:.2g} % of the particles remove nothing" if nothing else "every particle removes something"
    ax.set_title(title, fontsize=10)
    ax.legend(loc="best")
    return ax


@house_style()
def plot_nozzle_angle(ax: Axes, nozzle: NozzleAngle, units: System) -> Axes:
    """Mean volume over the nozzle's angle with its 95 % by sampling, and the volume that a typical particle removes."""
    scale = readable_scale("volume", units, float(max(nozzle.curve.max(), nozzle.single_curve.max())))
    degrees, mean = np.rad2deg(nozzle.angles), nozzle.curve / scale.size
    half = 1.96 * nozzle.curve_error / scale.size
    alone = f"one typical particle, greatest at {np.rad2deg(nozzle.single_alpha):.2f}°"
    ax.plot(np.rad2deg(nozzle.single_angles), nozzle.single_curve / scale.size, color=DIM, linestyle="--", label=alone)
    ax.fill_between(degrees, mean - half, mean + half, color=PALETTE["sky"], alpha=0.6, linewidth=0,
                    label="its 95 % by sampling alone")  # fmt: skip
    ax.plot(degrees, mean, color=PALETTE["blue"], label="mean of the stream")
    best = nozzle.alpha
    ax.axvspan(*np.rad2deg([best.low, best.high]), color=PALETTE["orange"], alpha=0.35, linewidth=0)
    label = (
        f"greatest at {np.rad2deg(best.value):.2f}° ± {np.rad2deg(best.high - best.value):.2f}° (95 %, sampling alone)"
    )
    ax.plot([np.rad2deg(best.value)], [nozzle.volume.value / scale.size], "*", color=PALETTE["orange"],
            markersize=13, markeredgecolor=INK, markeredgewidth=0.7, zorder=5, label=label)  # fmt: skip
    ax.set_xlim(0, 90)
    ax.set_ylim(bottom=0)
    ax.set_xticks(range(0, 91, 15), [f"{tick}°" for tick in range(0, 91, 15)])
    ax.set_xlabel("angle of the nozzle")
    ax.set_ylabel(f"{RESULTS['volume'].symbol}  of a particle  [{scale.unit}]")
    figure: Any = ax.figure
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return ax
