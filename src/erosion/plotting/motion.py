"""Figures of one impact, and of a solution of `erosion.ode`, over time."""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.interpolate import CubicSpline

from erosion.impacts import QUARTER_TURN, Trajectory
from erosion.models import NO_CUT, ClosedForm, State, model_name
from erosion.ode.solution import Solution
from erosion.output import briefly
from erosion.parameters import RESULTS, readable_scale
from erosion.plotting.curves import draw_parted
from erosion.plotting.dynamics import SHARES, dynamics
from erosion.plotting.labels import (
    AT_CONTACT,
    DIM,
    ENDS,
    FAINT,
    HISTORIES,
    INK,
    NOTHING,
    PALETTE,
    model_title,
    round_length,
)
from erosion.plotting.style import (
    angle_axis,
    axes_or_new,
    house_style,
    legend_below,
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
    time = readable_scale("time", p.shown_in, trajectory.t_c)
    exact = None if closed is None else closed.state(t, p)
    body = trajectory.states if isinstance(trajectory.states, State) else None
    turns = body is not None and not np.allclose(body.x, trajectory.x_tip, rtol=1e-9, atol=0)
    for panel, (of_body, of_tip, quantity) in zip(panels, HISTORIES, strict=True):
        tip = getattr(trajectory, of_tip)
        scale = readable_scale(quantity.dimension, p.shown_in, _largest(tip))
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
    if len(panels[0].lines) > 1:
        legend_below([panels[0]], 3)
    return panels


@house_style()
def plot_path(trajectory: Trajectory, *, ax: Axes | None = None) -> Axes:
    """The tip's path with the depth downward; the removed area is filled (Laverty, Figure 8)."""
    _, ax = axes_or_new(ax, 5.6, 3.4)
    p, x, depth = trajectory.p, trajectory.x_tip, trajectory.depth
    along = readable_scale("length", p.shown_in, _largest(x))
    down = readable_scale("length", p.shown_in, max(_largest(depth), trajectory.max_depth))
    x, depth = x / along.size, depth / down.size
    deepest = float(depth.max()) or 1.0
    ax.axhspan(0, 1.22 * deepest, color=DIM, alpha=0.13, linewidth=0)
    ax.axhline(0, color=INK, linewidth=1)
    ax.fill_between(x, 0, depth, color=PALETTE["orange"], alpha=0.55, linewidth=0, label="cut away")
    turned = np.abs(trajectory.phi - trajectory.phi[0]) > QUARTER_TURN if trajectory.turned_beyond else None
    draw_parted(ax, x, depth, turned, "path of the tip", color=PALETTE["blue"])
    ax.plot(x[:1], depth[:1], ">", color=PALETTE["green"], markersize=9, label="start", clip_on=False, zorder=5)
    ax.plot(x[-1:], depth[-1:], "s", color=ENDS.get(trajectory.ended_by, INK), markersize=7, clip_on=False, zorder=5,
            label=NOTHING if trajectory.ended_by == NO_CUT else f"end: {trajectory.ended_by}")  # fmt: skip
    xlabel = f"x of the tip, {HISTORIES[0][2].meaning}  [{along.unit}]"
    ax.set(xlabel=xlabel, ylabel=f"depth of the tip  [{down.unit}]", ylim=(1.22 * deepest, -0.12 * deepest))
    legend_below(ax, 4)
    return ax


@house_style()
def plot_trajectory(trajectory: Trajectory) -> Figure:
    """One impact of any model: the tip's path, and below it the tip's four histories."""
    fig = new_figure(6.2, 7.6)
    halves: Any = fig.subfigures(2, 1, height_ratios=(0.4, 0.6))
    plot_path(trajectory, ax=halves[0].subplots())
    plot_histories(halves[1], trajectory)
    p, turn = trajectory.p, trajectory.turn
    turned = f", turned by {np.rad2deg(turn):.4g}°" if turn > 0 else ""
    end = (
        f"{trajectory.ended_by} after {RESULTS['t_c'].in_words(trajectory.t_c, p.shown_in, 5)}"
        if trajectory.t_c
        else NOTHING
    )
    heading = f"{model_title(model_name(trajectory.model))}\nat α = {np.rad2deg(float(p.alpha)):.6g}°: {end}"
    at_contact = trajectory.volume_at_contact
    removed, beside = (RESULTS["volume"].in_words(part, p.shown_in, 5) for part in (trajectory.volume, at_contact))
    share = f", {beside} {AT_CONTACT}" if at_contact else ""
    fig.suptitle(f"{heading}\n{removed} removed{share}{turned}", fontsize="medium", wrap=True)
    return fig


_BODY = np.array([[0.0, 0.0], [-0.62, 0.5], [-0.56, 1.18], [0.1, 1.5], [0.7, 1.12], [0.66, 0.46]])
_CENTRE = np.array([0.0, 0.82])
_TIP_DEPTH = 0.34
"""A body of sand in a sketch, its tip at the origin; the distance from tip to centre is 0.82."""


def _metal(ax: Axes, left: float) -> None:
    ax.axhspan(-1, 0, color=DIM, alpha=0.16, linewidth=0)
    ax.axhline(0, color=INK, linewidth=1)
    ax.text(left, -0.04, "surface", va="top", fontsize="small", color=DIM)
    ax.set_aspect("equal")
    ax.axis("off")


def _arrow(ax: Axes, start: Any, end: Any, color: str) -> None:
    style = {"arrowstyle": "-|>", "color": color, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 13}
    ax.annotate("", end, start, arrowprops=style)


@house_style()
def plot_sketch(ax: Axes, alpha: float, k: float) -> Axes:
    """The body in the cut, with its speed at contact and the force at its tip (Laverty, Figures 4 to 6).

    Args:
        ax: empty axes.
        alpha: angle of attack [rad].
        k: F_y / F_x.
    """
    _metal(ax, -2.25)
    ax.fill(*(_BODY - [0, _TIP_DEPTH]).T, color=PALETTE["sky"], alpha=0.45, linewidth=0)
    ax.plot(*np.vstack([_BODY, _BODY[:1]]).T - np.array([[0], [_TIP_DEPTH]]), color=INK, linewidth=1)
    tip, centre = np.array([0, -_TIP_DEPTH]), _CENTRE - [0, _TIP_DEPTH]
    both_ways = {"arrowstyle": "<->", "color": INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (-0.16, -_TIP_DEPTH), (-0.16, centre[1]), arrowprops=both_ways)
    ax.plot(*centre, "o", color=INK, markersize=4)
    ax.text(-0.22, centre[1] / 2, "$r$", ha="right")
    start = centre - 1.5 * np.array([math.cos(alpha), -math.sin(alpha)])
    _arrow(ax, start, centre - 0.04 * np.array([math.cos(alpha), -math.sin(alpha)]), PALETTE["green"])
    ax.text(start[0], start[1], "$v_0$ ", ha="right", va="center", color=PALETTE["green"])
    ax.plot([start[0], start[0] + 0.9], [start[1]] * 2, color=DIM, linewidth=0.8)
    arc = np.linspace(0, -alpha, 30)
    ax.plot(start[0] + 0.55 * np.cos(arc), start[1] + 0.55 * np.sin(arc), color=INK, linewidth=0.9)
    ax.text(start[0] + 0.68, start[1] - 0.68 * math.sin(alpha / 2), "α", va="center", ha="left")
    # As long as the force is large: along the surface 1, and k of it upwards, within the picture.
    along = 1.1 / max(1.0, math.hypot(1, k) / 1.6)
    _arrow(ax, tip, (-along, -_TIP_DEPTH), PALETTE["vermillion"])
    ax.text(-1.05 * along, -_TIP_DEPTH, "$F_x$ ", ha="right", va="center", color=PALETTE["vermillion"])
    _arrow(ax, tip, (0, k * along - _TIP_DEPTH), PALETTE["vermillion"])
    ax.text(0.06, k * along - _TIP_DEPTH, "$F_y = kF_x$", ha="left", va="bottom", color=PALETTE["vermillion"])
    ax.annotate("", (1.0, -_TIP_DEPTH), (1.0, 0), arrowprops=both_ways)
    ax.text(1.07, -_TIP_DEPTH / 2, "$y$, depth of the tip", va="center")
    ax.plot([0, 1.06], [-_TIP_DEPTH] * 2, color=DIM, linewidth=0.8, linestyle=(0, (2, 2)))
    ax.set(xlim=(-2.3, 2.4), ylim=(-0.62, max(1.6, k * along - _TIP_DEPTH + 0.3, start[1] + 0.2)))
    return ax


@house_style()
def plot_half_angle(fig: Figure, k: float) -> list[Axes]:
    """Why the best angle halves the angle between the surface and the force, for cuts that rebound.

    Left the directions of motion and force; right depth, forward speed and their product over the angle.

    Args:
        fig: an empty figure.
        k: F_y / F_x; the force points away from the motion at arctan k above the surface.
    """
    sketch, curves = fig.subplots(1, 2, width_ratios=(1.0, 1.25))
    force, best = math.atan(k), math.atan(k) / 2
    _metal(sketch, -1.45)
    for angle, color, label, inwards in (
        (force, PALETTE["vermillion"], "force", False),
        (best, PALETTE["green"], "motion", True),
    ):
        far = 1.15 * np.array([-math.cos(angle), math.sin(angle)])
        _arrow(sketch, *((far, (0, 0)) if inwards else ((0, 0), far)), color)
        sketch.text(
            1.06 * far[0], 1.06 * far[1], label, color=color, ha="right" if angle < 1 else "center", va="bottom"
        )
    for low, high, size in ((0.0, best, 0.55), (best, force, 0.6)):
        arc = np.linspace(low, high, 40)
        sketch.plot(-size * np.cos(arc), size * np.sin(arc), color=INK, linewidth=0.9)
        middle = (low + high) / 2
        sketch.text(-(size + 0.13) * math.cos(middle), (size + 0.13) * math.sin(middle), "θ/2", ha="center",
                    va="center", fontsize="small")  # fmt: skip
    sketch.set(xlim=(-1.5, 0.45), ylim=(-0.22, 1.35))
    alpha = np.linspace(0, force, 200)
    depth, speed = np.sin(alpha), np.sin(force - alpha)
    degrees = np.rad2deg(alpha)
    curves.plot(degrees, depth / depth[-1], color=PALETTE["blue"], label="depth ∝ sin α")
    curves.plot(degrees, speed / speed[0], color=PALETTE["purple"], label="forward speed ∝ sin(θ − α)")
    product = depth * speed
    rebounds = alpha <= math.atan(k / 2)
    for shown, style, label in ((rebounds, "-", "volume ∝ product"), (~rebounds, ":", "steeper cuts stop first")):
        curves.plot(degrees[shown], product[shown] / product.max(), style, color=INK, linewidth=2.4, label=label)
    curves.plot(np.rad2deg(best), 1, "*", color=PALETTE["orange"], markersize=13, markeredgecolor=INK,
                markeredgewidth=0.7, zorder=5, clip_on=False, label="α = θ/2")  # fmt: skip
    curves.set(ylabel="over its greatest value", ylim=(0, 1.08))
    angle_axis(curves, 0, float(np.rad2deg(force)))
    legend_below([curves], 2)
    return [sketch, curves]


_FRAMES, _A_SECOND = 40, 13
_ARROW = 1.1  # r
_COLORS = {"velocity of the centre of mass": PALETTE["green"], "force on the tip": PALETTE["vermillion"]}
_OF_SHARES = dict(zip(SHARES.values(), (PALETTE["purple"], INK, FAINT), strict=True))


@house_style()
def animate_cut(trajectory: Trajectory) -> bytes:
    """The bytes of a GIF of three seconds: the body moves along the tip's path and turns.

    Arrows show the velocity and the force, a bar the shares of the energy, where the centre of mass is known.

    Args:
        trajectory: of any model; the body is drawn where its state holds the orientation.
    """
    p, vectors = trajectory.p, dynamics(trajectory)
    scale = readable_scale("length", p.shown_in, _largest(trajectory.x_tip))
    x, depth, r = trajectory.x_tip / scale.size, trajectory.depth / scale.size, float(p.r) / scale.size
    fig = Figure(figsize=(6.4, 4.2), dpi=100, layout="constrained")
    ax, below = fig.subplots(2, 1, height_ratios=(12, 1))
    lowest = max(1.3 * depth.max(), 0.4 * r)
    ax.axhspan(0, lowest, color=DIM, alpha=0.13, linewidth=0)
    ax.axhline(0, color=INK, linewidth=1)
    ax.plot(x, depth, color=PALETTE["blue"], linewidth=1)
    (removed,) = ax.fill([0], [0], color=PALETTE["orange"], alpha=0.75, linewidth=0)
    (body,) = ax.fill([0], [0], color=PALETTE["sky"], alpha=0.6, zorder=6)
    (tip,) = ax.plot([], [], "o", color=INK, markersize=4, zorder=7)
    arrows = [ax.quiver([0], [0], [0], [0], color=color, angles="xy", scale_units="xy", scale=1, width=0.007, zorder=8)
              for color in _COLORS.values()]  # fmt: skip
    ax.set(xlim=(x.min() - 1.3 * r, x.max() + 2.3 * r), ylim=(lowest, -2.2 * r), aspect="equal")
    ax.axis("off")
    bar, left = round_length(r), x.min() - 1.2 * r
    ax.plot([left, left + bar], [-2 * r] * 2, color=INK, linewidth=2)
    ax.text(left, -1.9 * r, f"{bar:g} {scale.unit}", va="top", fontsize="small")
    below.set(xlim=(0, 1), ylim=(-0.5, 0.5))
    below.axis("off")
    below.set_title("kinetic energy at contact" if vectors.energy else "", loc="left", fontsize="x-small")
    bars = below.barh([0] * len(SHARES), 0, height=1, color=list(_OF_SHARES.values()))
    handles: list[Any] = []
    if vectors.velocity:
        handles += [Line2D([], [], color=color, linestyle="", marker=r"$\rightarrow$", markersize=14, label=label)
                    for label, color in _COLORS.items()]  # fmt: skip
    if vectors.energy:
        handles += [Patch(color=color, label=label) for label, color in _OF_SHARES.items()]
    fig.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="x-small")
    shape = r * (_BODY - _CENTRE) / _CENTRE[1]  # about the centre of mass
    turned = trajectory.phi - np.pi / 2 if isinstance(trajectory.states, State) else None
    pushed = [vector for vector in (vectors.velocity, vectors.force) if vector]

    def show(frame: int) -> None:
        at = round(frame / (_FRAMES - 1) * (len(x) - 1))
        tip.set_data([x[at]], [depth[at]])
        removed.set_xy([*zip(x[: at + 1], depth[: at + 1], strict=True), (x[at], 0), (x[0], 0)])
        if turned is not None:
            sine, cosine = math.sin(turned[at]), math.cos(turned[at])
            centre = np.array([x[at] - r * sine, depth[at] - r * cosine])
            corners = shape @ np.array([[cosine, sine], [-sine, cosine]])
            body.set_xy(centre + corners * [1, -1])
            for arrow, foot, vector in zip(arrows, (centre, (x[at], depth[at])), pushed, strict=True):
                arrow.set_offsets([foot])
                arrow.set_UVC(*([_ARROW * r * part[at]] for part in vector))
        begin = 0.0
        for bar, share in zip(bars, vectors.energy or (), strict=bool(vectors.energy)):
            bar.set(x=begin, width=max(share[at], 0.0))
            begin += bar.get_width()

    fig.draw_without_rendering()
    fig.set_layout_engine("none")  # frames do not move, and are drawn much faster
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cut.gif"
        FuncAnimation(fig, show, _FRAMES).save(file, PillowWriter(fps=_A_SECOND), dpi=fig.dpi)
        return file.read_bytes()


@house_style()
def plot_removal_rate(ax: Axes, trajectory: Trajectory, bars: int = 10) -> Axes:
    """dV/dt over time, with the bars of the midpoint rule; the area below the curve is the volume."""
    p, t_c = trajectory.p, trajectory.t_c
    rate = trajectory.removal_rate
    time = readable_scale("time", p.shown_in, t_c)
    volume = readable_scale("volume", p.shown_in, _largest(rate) * time.size)
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
