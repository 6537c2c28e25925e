"""Curves over the angle of attack with their optimum, broken where they jump."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from erosion.impacts.impact import impact
from erosion.models.base import NO_CUT
from erosion.optimum.alpha_max import ASIDE, Optimum
from erosion.optimum.objectives import MEASURES
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.plotting.colors import DIM, ENDS, INK, REMOVED_AT_CONTACT
from erosion.plotting.curves import describe
from erosion.plotting.labels import AT_CONTACT, end_label
from erosion.plotting.marks import mark_best, star
from erosion.plotting.style import axes_or_new, house_style, legend_of_panel, typeset

_SHALLOWEST = 1e-4  # rad; a curve over angles from 0 begins here
_MARKERS = {"interior": "o", "jump": "D", "boundary": "s", "kink": "^", "plateau": "_", "unresolved": "v"}


class Piece(NamedTuple):
    """A part of a curve that has no jump, and on which all cuts end in the same way.

    Args:
        alpha: angles, shape (n,) [rad].
        value: the objective at these angles, shape (n,).
        at_contact: what contact adds to it, beside the cut, shape (n,).
        ended_by: how the cut ends.
    """

    alpha: np.ndarray
    value: np.ndarray
    at_contact: np.ndarray
    ended_by: str


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
    hits = impact(optimum.integrand, optimum.p.replace(alpha=np.concatenate(angles)), derivatives=2)
    cuts = np.cumsum(counts)[:-1]
    columns = (np.split(column, cuts) for column in (hits.volume, hits.volume_at_contact, hits.ended_by))
    return [
        Piece(alpha, value, at_contact, str(end[len(end) // 2]))
        for alpha, value, at_contact, end in zip(angles, *columns, strict=True)
    ]


@house_style()
def plot_optimum(optimum: Optimum, *, ax: Axes | None = None) -> Figure:
    """The objective over the angle, with the regimes, the jumps, the candidates and the optimum.

    The area below what is removed at contact, as by deformation, is shaded.

    Args:
        optimum: for scalar parameters.
        ax: where to draw; without it, in a new figure.

    Raises:
        ValueError: for a batch of optima.
    """
    if np.ndim(optimum.kind):
        raise ValueError(
            f"Argument `optimum` must be of one set of parameters, but has the shape {np.shape(optimum.kind)}."
        )
    fig, ax = axes_or_new(ax, 6.2, 4.4)
    curve = pieces(optimum)
    quantity = RESULTS[MEASURES[optimum.objective]] if optimum.objective in MEASURES else None
    dimension = "1" if quantity is None else quantity.dimension
    scale = readable_scale(dimension, optimum.p.units, _largest(curve))
    # Of a model that never cuts nothing is beside a cut.
    cuts = any(piece.ended_by != NO_CUT for piece in curve)
    shares = cuts and any(piece.at_contact.any() for piece in curve)
    for piece in curve:
        if shares:
            ax.fill_between(np.rad2deg(piece.alpha), 0, piece.at_contact / scale.size, **REMOVED_AT_CONTACT)
        ax.plot(np.rad2deg(piece.alpha), piece.value / scale.size, color=ENDS.get(piece.ended_by, INK), linewidth=2.2)
    for jump in optimum.jumps:
        ax.plot([np.rad2deg(jump.alpha)] * 2, np.array([jump.below, jump.above]) / scale.size, color=DIM,
                linestyle=(0, (2, 2)), linewidth=1.2)  # fmt: skip
    for candidate in optimum.candidates[1:]:
        ax.plot(np.rad2deg(candidate.alpha), candidate.value / scale.size, _MARKERS[candidate.kind], color="white",
                markeredgecolor=INK, markersize=7, zorder=4)  # fmt: skip
    handles: list[Any] = [
        Line2D([], [], color=ENDS.get(end, INK), linewidth=2.2,
               label=end_label(end))
        for end in dict.fromkeys(piece.ended_by for piece in curve)
    ]  # fmt: skip
    if shares:
        handles.append(Patch(label=AT_CONTACT, **REMOVED_AT_CONTACT))
    if optimum.jumps:
        handles.append(Line2D([], [], color=DIM, linestyle=(0, (2, 2)), linewidth=1.2, label="jump"))
    if np.isfinite(optimum.value) and optimum.kind != "none":
        mark_best(ax, optimum, scale.size)
        label = f"{'least' if optimum.least else 'greatest'}: {describe(optimum)}"
        handles.append(Line2D([], [], label=label, **star(optimum)))
    if len(optimum.candidates) > 1:
        handles.append(
            Line2D([], [], marker="o", color="white", markeredgecolor=INK, linestyle="", label="other candidates")
        )
    ax.set_ylabel(
        optimum.objective if quantity is None else f"{typeset(quantity.symbol)}  {quantity.meaning}  [{scale.unit}]"
    )
    _finish(ax, optimum)
    legend_of_panel(ax, handles, 2)
    return fig


def _largest(curve: Sequence[Piece]) -> float:
    return max(float(np.nanmax(np.abs(piece.value))) for piece in curve)


def _finish(ax: Axes, optimum: Optimum) -> None:
    low, high = (np.rad2deg(end) for end in (optimum.regimes[0].low, optimum.regimes[-1].high))
    ax.set_xlim(low, high)
    if low == 0 and high == 90:
        ax.set_xticks(range(0, 91, 15))
    ax.xaxis.set_major_formatter("{x:g}°")
    ax.set_xlabel(f"{QUANTITIES['alpha'].symbol}  {QUANTITIES['alpha'].meaning}")
    ax.set_ylim(bottom=0, top=1.05 * ax.get_ylim()[1])
