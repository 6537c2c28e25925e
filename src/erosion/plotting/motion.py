"""Figures of one impact, and of a solution of `erosion.ode`, over time."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from scipy.interpolate import CubicSpline

from erosion.impacts import Trajectory
from erosion.models import NO_CUT, ClosedForm, State, model_name
from erosion.ode.solution import Solution
from erosion.output import briefly
from erosion.parameters import RESULTS, System, readable_scale
from erosion.plotting.labels import AT_CONTACT, DIM, ENDS, HISTORIES, INK, NOTHING, PALETTE
from erosion.plotting.style import (
    axes_or_new,
    house_style,
    legend_below,
    legend_of_panel,
    new_figure,
)


@house_style()
def plot_histories(fig: Figure | SubFigure, trajectory: Trajectory, closed: ClosedForm | None = None) -> list[Axes]:
    """x, y, ẋ and ẏ of the tip over time, in four panels (Laverty, Figure 7).

    Args:
        fig: an empty figure.
        trajectory: of any model. If the centre of mass moves differently from the tip, a dashed line
            shows it.
        closed: the exact solution, drawn as a broad pale line below the numerical solution.

    Returns:
        The panels, in the order x, y, ẋ, ẏ.
    """
    panels = list(fig.subplots(2, 2, sharex=True).ravel())
    p, t = trajectory.p, trajectory.t
    time = readable_scale("time", p.units, trajectory.t_c)
    exact = None if closed is None else closed.state(t, p)
    body = trajectory.states if isinstance(trajectory.states, State) else None
    turns = body is not None and not np.allclose(body.x, trajectory.x_tip, rtol=1e-9, atol=0)
    for panel, (of_body, of_tip, quantity) in zip(panels, HISTORIES, strict=True):
        tip = getattr(trajectory, of_tip)
        scale = readable_scale(quantity.dimension, p.units, _largest(tip))
        if exact is not None:
            panel.plot(t / time.size, np.asarray(getattr(exact, of_body)) / scale.size,
                       color=PALETTE["sky"], linewidth=6, alpha=0.5, label="closed form")  # fmt: skip
        if body is not None and turns:
            panel.plot(t / time.size, np.asarray(getattr(body, of_body)) / scale.size,
                       color=PALETTE["orange"], linestyle="--", label="centre of mass")  # fmt: skip
        panel.plot(t / time.size, tip / scale.size, color=PALETTE["blue"], marker="o" if len(t) == 1 else "",
                   label="tip" if exact is None else "tip, numerical solution")  # fmt: skip
        panel.set(ylabel=f"{quantity.symbol}  [{scale.unit}]")
        panel.set_title(quantity.meaning, fontsize="medium")
    for panel in panels[2:]:
        panel.set_xlabel(f"t  [{time.unit}]")
    handles, labels = panels[0].get_legend_handles_labels()
    if len(handles) > 1:
        fig.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return panels


@house_style()
def plot_path(trajectory: Trajectory, *, ax: Axes | None = None) -> Axes:
    """The tip's path with the depth downward; the removed area is filled (Laverty, Figure 8)."""
    _, ax = axes_or_new(ax, 5.6, 3.4)
    p, x, depth = trajectory.p, trajectory.x_tip, trajectory.depth
    along = readable_scale("length", p.units, _largest(x))
    down = readable_scale("length", p.units, max(_largest(depth), trajectory.max_depth))
    x, depth = x / along.size, depth / down.size
    deepest = float(depth.max()) or 1.0
    ax.axhspan(0, 1.22 * deepest, color=DIM, alpha=0.13, linewidth=0)
    ax.axhline(0, color=INK, linewidth=1)
    ax.fill_between(x, 0, depth, color=PALETTE["orange"], alpha=0.55, linewidth=0, label="cut away")
    ax.plot(x, depth, color=PALETTE["blue"], label="path of the tip")
    ax.plot(x[:1], depth[:1], ">", color=PALETTE["green"], markersize=9, label="start", clip_on=False, zorder=5)
    ax.plot(x[-1:], depth[-1:], "s", color=ENDS.get(trajectory.ended_by, INK), markersize=7, clip_on=False, zorder=5,
            label=NOTHING if trajectory.ended_by == NO_CUT else f"end: {trajectory.ended_by}")  # fmt: skip
    xlabel = f"x of the tip, {HISTORIES[0][2].meaning}  [{along.unit}]"
    ax.set(xlabel=xlabel, ylabel=f"depth of the tip  [{down.unit}]", ylim=(1.22 * deepest, -0.12 * deepest))
    legend_of_panel(ax, ax.get_legend_handles_labels()[0], 4)
    return ax


@house_style()
def plot_trajectory(trajectory: Trajectory) -> Figure:
    """One impact of any model: the tip's path, and below it the tip's four histories."""
    fig = new_figure(6.2, 7.6)
    halves: Any = fig.subfigures(2, 1, height_ratios=(0.4, 0.6))
    plot_path(trajectory, ax=halves[0].subplots())
    plot_histories(halves[1], trajectory)
    p, turn = trajectory.p, trajectory.turn
    turned = f", turned by {np.rad2deg(turn):.4g}°".replace("-", "−") if math.isfinite(turn) and turn else ""
    end = f"{trajectory.ended_by} after {_read('t_c', trajectory.t_c, p.units)}" if trajectory.t_c else NOTHING
    heading = f"{model_name(trajectory.model)} at α = {np.rad2deg(float(p.alpha)):.6g}°: {end}"
    at_contact = trajectory.volume_at_contact
    share = f", {_read('volume', at_contact, p.units)} {AT_CONTACT}" if at_contact else ""
    fig.suptitle(
        f"{heading}\n{_read('volume', trajectory.volume, p.units)} removed{share}{turned}", fontsize="medium", wrap=True
    )
    return fig


@house_style()
def plot_removal_rate(ax: Axes, trajectory: Trajectory, bars: int = 10) -> Axes:
    """dV/dt over time, with the bars of the midpoint rule; the area below the curve is the volume."""
    p, t_c = trajectory.p, trajectory.t_c
    rate = trajectory.removal_rate
    time = readable_scale("time", p.units, t_c)
    volume = readable_scale("volume", p.units, _largest(rate) * time.size)
    height = time.size / volume.size
    ax.fill_between(trajectory.t / time.size, 0, rate * height, color=PALETTE["orange"], alpha=0.4, linewidth=0)
    ax.plot(trajectory.t / time.size, rate * height, color=PALETTE["blue"], label="rate of removal")
    if t_c > 0:
        width = t_c / bars
        middles = (np.arange(bars) + 0.5) * width
        heights = CubicSpline(trajectory.t, rate)(middles) * height
        ax.bar(middles / time.size, heights, width=width / time.size, fill=False, edgecolor=INK, linewidth=0.9,
               label=f"midpoint rule, {bars} bars")  # fmt: skip
    ax.set(xlabel=f"t  time since contact  [{time.unit}]", ylabel=f"$dV/dt$  [{volume.unit}/{time.unit}]")
    legend_below(ax, columns=2)
    return ax


def _largest(values: Any) -> float:
    return float(np.max(np.abs(np.asarray(values))))


def _read(name: str, value: float, units: System) -> str:
    scale = readable_scale(RESULTS[name].dimension, units, abs(value))
    return f"{value / scale.size:.5g} {scale.unit}".replace(" 10", " × 10")


_MOST = 12  # lanes in one figure: more cannot be told from each other


@house_style()
def plot_solution(solution: Solution, names: Sequence[str] = (), ax: Axes | None = None) -> Axes:
    """Draw states over time, a line for each lane and each part of the state, and a mark where a lane ends.

    Args:
        solution: solved with `ts`.
        names: which parts of the state, by their path: "x", "body.vx"; all of them without it.
        ax: where to draw; a new figure without it.

    Returns:
        The axes.

    Raises:
        ValueError: without times, for names that are no parts of the state, or for more than 12 lanes.
    """
    if solution.times is None:
        raise ValueError("Argument `solution` must have states at times: solve with `ts`.")
    parts = {name.removeprefix("y."): values for name, values in solution.named(solution.times).items()}
    ends = {name.removeprefix("y."): values for name, values in solution.named(solution).items()}
    for name in names:
        if name not in parts:
            raise ValueError(
                f"Argument `names` must be parts of the state ({', '.join(parts)}), but has {briefly(name)}."
            )
    if not 0 < np.size(solution.t) <= _MOST:
        raise ValueError(f"Argument `solution` must have 1 to {_MOST} lanes, but has {np.size(solution.t):,}.")
    _, ax = axes_or_new(ax, 6.4, 3.6)
    times, last = solution.times.ts, np.ravel(solution.t)
    chosen = list(names or parts)
    colors = list(PALETTE.values())
    for i, name in enumerate(chosen):
        lines = np.reshape(parts[name], (last.size, times.size, -1))
        marks = np.reshape(ends[name], (last.size, -1))
        for lane, element in np.ndindex(last.size, lines.shape[-1]):
            # One part: a colour for each lane. Several: a colour for each part.
            place = (lane if len(chosen) == 1 else i) + element
            color, first = colors[place % len(colors)], lane == 0 or len(chosen) == 1
            label = name if lines.shape[-1] == 1 else f"{name}[{element}]"
            label = f"{label}, lane {lane}" if len(chosen) == 1 and last.size > 1 else label
            ax.plot(times, lines[lane, :, element], color=color, label=label if first else None)
            ax.plot(last[lane], marks[lane, element], "o", color=color, markersize=4)
    ax.set(xlabel="t", ylabel=chosen[0] if len(chosen) == 1 else "")
    if len(ax.get_legend_handles_labels()[0]) > 1:
        ax.legend()
    return ax
