"""V(α) of models and the angle functions of engineers in one figure, each divided by its own maximum."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.correlations import CORRELATIONS
from erosion.parameters.ranges import QUARTER_DEGREES
from erosion.plotting.colors import DIM, STYLES
from erosion.plotting.curves import broken
from erosion.plotting.families import Curve
from erosion.plotting.style import angle_axis, house_style, legend_below, new_axes

_DASHES = ("-", (0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)), (0, (6, 2, 1, 2, 1, 2)), (0, (10, 3)))


@house_style()
def plot_shapes(ax: Axes, curves: Sequence[Curve], correlations: Sequence[str]) -> Axes:
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
    for i, curve in enumerate(curve for curve in curves if curve.best is not None):
        color, line = STYLES[i % len(STYLES)]
        alpha, greatest = curve.best or (0.0, 1.0)
        best = f"{np.rad2deg(alpha):.1f}°" if alpha else "as α → 0"
        ax.plot(np.rad2deg(curve.angles), curve.volume / greatest, color=color, linestyle=line, linewidth=2,
                label=f"{curve.label}: {best}")  # fmt: skip
    ax.set_ylabel("divided by its own maximum")
    ax.set_ylim(0, 1.05)
    angle_axis(ax)
    legend_below(ax, 2)
    return ax


@house_style()
def plot_against_correlations(comparison: xr.Dataset, correlations: Sequence[str]) -> Figure:
    """The models of `erosion.compare` and engineering correlations, each divided by its own maximum.

    Args:
        comparison: the result of `erosion.compare`.
        correlations: names in `erosion.CORRELATIONS`.
    """
    curves = []
    for name in comparison.model.values:
        results = comparison.sel(model=name)
        angles, volume = broken(results.alpha.values, results.volume.values, results.dvolume.values)
        best = (float(results.alpha_max), float(results.volume_max))
        curves.append(Curve(str(name), angles, volume, best if np.isfinite(best).all() and best[1] > 0 else None))
    fig, ax = new_axes(6.6, 4.4 + 0.11 * (len(curves) + len(correlations)))
    plot_shapes(ax, curves, correlations)
    return fig
