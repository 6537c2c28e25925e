"""Results -> matplotlib Axes: motion, path, end of the cut, removed volume.

Figures are made without pyplot, so nothing here has global state, and always in the same
style whatever the user's matplotlibrc says. Saved files hold no dates and no random ids:
the same results give the same bytes.
"""

import contextlib
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from scipy.interpolate import CubicSpline

from erosion.files import require_writable, write_whole
from erosion.model import ClosedForm, State
from erosion.models import model_name
from erosion.parameters import QUANTITIES
from erosion.quantities import RESULTS, Quantity
from erosion.trajectory import Trajectory
from erosion.units import SYSTEMS, Dimension, System, unit_name

# Okabe and Ito (2008), "Color universal design": told apart with any colour vision.
PALETTE: Mapping[str, str] = {
    "blue": "#0072b2", "vermillion": "#d55e00", "green": "#009e73",
    "purple": "#cc79a7", "sky": "#56b4e9", "orange": "#e69f00",
}  # fmt: skip
STYLES: Sequence[tuple[str, Any]] = tuple(
    (color, line) for line in ("-", (0, (5, 2)), (0, (1.5, 1.5))) for color in PALETTE.values()
)
"""Colour and line of each of many curves."""

INK = "#24292f"
FAINT = "#d0d7de"
DIM = "#7d858e"

ENDS: Mapping[str, str] = {"rebound": PALETTE["blue"], "stop": PALETTE["vermillion"], "no-cut": DIM}
"""The colour of each way a cut may end, the same in every figure."""

_NO_DATES: Mapping[str, Mapping[str, None]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
_STYLE: Mapping[Any, Any] = {
    "font.size": 10,
    "axes.labelsize": 10,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "mathtext.fontset": "dejavusans",
    # Text as outlines: every viewer shows it alike, whatever fonts it has.
    "svg.fonttype": "path",
    "svg.hashsalt": "erosion",
    "savefig.dpi": 160,
}

_HISTORIES = (
    ("x", "x_tip", Quantity("x", "along the surface", "length")),
    ("y", "depth", Quantity("y", "depth", "length")),
    ("vx", "vx_tip", Quantity("ẋ", "forward speed", "speed")),
    ("vy", "vdepth", Quantity("ẏ", "downward speed", "speed")),
)


class Scale(NamedTuple):
    """A unit that makes numbers readable: number in the base unit / size = number in `unit`."""

    size: float
    unit: str


_NAMED: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    **{("time", units): (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)) for units in SYSTEMS},
    ("length", "si"): (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)),
    ("volume", "si"): (("m³", 1.0), ("mm³", 1e-9), ("µm³", 1e-18)),
}


def superscript(exponent: int) -> str:
    """An integer raised: "⁻⁴"."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def readable_scale(dimension: Dimension, units: System, largest: float) -> Scale:
    """The unit in which numbers up to `largest` read well: "µs", "mm", "10⁻³ in", "10⁻⁴ in³".

    Args:
        dimension: what is measured.
        units: the unit system of `largest`.
        largest: the greatest magnitude to show; 0 or a number that is not finite gives the
            base unit.
    """
    base = unit_name(dimension, units)
    if not (math.isfinite(largest) and largest > 0):
        return Scale(1.0, base)
    for unit, size in _NAMED.get((dimension, units), ()):
        if (0.05 if dimension == "volume" else 0.5) <= largest / size < 1e3:
            return Scale(size, unit)
    if 0.5 <= largest < (1e5 if dimension in ("speed", "1") else 1e3):
        return Scale(1.0, base)
    exponent = math.floor(math.log10(largest) + 1e-9)
    exponent -= 0 if dimension == "volume" else exponent % 3
    return Scale(10.0**exponent, f"10{superscript(exponent)} {base}".strip())


@contextlib.contextmanager
def house_style() -> Iterator[None]:
    """Everything drawn or saved within looks alike, whatever the user's settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def new_figure(width: float = 5.4, height: float = 3.7) -> Figure:
    """An empty figure [in]. At this width 10 pt text is still readable on a phone."""
    with house_style():
        return Figure(figsize=(width, height), layout="constrained")


def new_axes(width: float = 5.4, height: float = 3.7) -> tuple[Figure, Axes]:
    """An empty figure of one panel."""
    fig = new_figure(width, height)
    with house_style():
        return fig, fig.subplots()


@house_style()
def plot_histories(fig: Figure | SubFigure, trajectory: Trajectory, closed: ClosedForm | None = None) -> list[Axes]:
    """x, y, ẋ and ẏ of the tip over time, in four panels (Laverty, Figure 7).

    Args:
        fig: an empty figure.
        trajectory: of any model. Where the centre of mass moves differently from the tip,
            it is drawn dashed.
        closed: the exact solution, drawn as a broad pale line below the numerical one.

    Returns:
        The panels, in the order x, y, ẋ, ẏ.
    """
    panels = list(fig.subplots(2, 2, sharex=True).ravel())
    p, t = trajectory.p, trajectory.t
    time = readable_scale("time", p.units, trajectory.t_c)
    exact = None if closed is None else closed.state(t, p)
    body = trajectory.states if isinstance(trajectory.states, State) else None
    turns = body is not None and not np.allclose(body.x, trajectory.x_tip, rtol=1e-9, atol=0)
    for panel, (of_body, of_tip, quantity) in zip(panels, _HISTORIES, strict=True):
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
        panel.set_ylabel(f"{quantity.symbol}  [{scale.unit}]")
        panel.set_title(quantity.meaning, fontsize=10)
    for panel in panels[2:]:
        panel.set_xlabel(f"t  [{time.unit}]")
    handles, labels = panels[0].get_legend_handles_labels()
    if len(handles) > 1:
        fig.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return panels


@house_style()
def plot_path(ax: Axes, trajectory: Trajectory) -> Axes:
    """The tip's path with the depth downward, the removed area filled (Laverty, Figure 8)."""
    p, x, depth = trajectory.p, trajectory.x_tip, trajectory.depth
    along = readable_scale("length", p.units, _largest(x))
    down = readable_scale("length", p.units, max(_largest(depth), trajectory.max_depth))
    x, depth = x / along.size, depth / down.size
    deepest = float(depth.max()) or 1.0
    ax.axhspan(0, 1.22 * deepest, color=DIM, alpha=0.13, linewidth=0)
    ax.axhline(0, color=INK, linewidth=1)
    ax.fill_between(x, 0, depth, color=PALETTE["orange"], alpha=0.55, linewidth=0, label="removed")
    ax.plot(x, depth, color=PALETTE["blue"], label="path of the tip")
    ax.plot(x[:1], depth[:1], ">", color=PALETTE["green"], markersize=9, label="start", clip_on=False, zorder=5)
    ax.plot(x[-1:], depth[-1:], "s", color=ENDS.get(trajectory.ended_by, INK), markersize=7, clip_on=False, zorder=5,
            label="nothing is cut" if trajectory.ended_by == "no-cut" else f"end: {trajectory.ended_by}")  # fmt: skip
    ax.set_ylim(1.22 * deepest, -0.12 * deepest)
    ax.set_xlabel(f"x of the tip, {_HISTORIES[0][2].meaning}  [{along.unit}]")
    ax.set_ylabel(f"depth of the tip  [{down.unit}]")
    legend_below(ax, columns=4)
    return ax


@house_style()
def plot_trajectory(trajectory: Trajectory) -> Figure:
    """One impact of any model at a glance: the tip's path above its four histories."""
    fig = new_figure(6.2, 7.6)
    halves: Any = fig.subfigures(2, 1, height_ratios=(0.4, 0.6))
    plot_path(halves[0].subplots(), trajectory)
    plot_histories(halves[1], trajectory)
    p, turn = trajectory.p, trajectory.turn
    turned = f", turned by {np.rad2deg(turn):.4g}°".replace("-", "−") if math.isfinite(turn) and turn else ""
    end = f"{trajectory.ended_by} after {_read('t_c', trajectory.t_c, p.units)}" if trajectory.t_c else "nothing is cut"
    heading = f"{model_name(trajectory.model)} at α = {np.rad2deg(float(p.alpha)):.6g}°: {end}"
    fig.suptitle(f"{heading}\n{_read('volume', trajectory.volume, p.units)} removed{turned}", fontsize=11)
    return fig


@house_style()
def plot_end_times(
    ax: Axes,
    angles: np.ndarray,
    candidates: Mapping[str, np.ndarray],
    t_c: np.ndarray,
    *,
    units: System,
    real_part: np.ndarray | None = None,
    cusp: tuple[float, float] | None = None,
    case: tuple[float, float] | None = None,
) -> Axes:
    """When each event would end the cut, over the angle, and when it does (Laverty, Figure 9).

    Args:
        ax: empty axes.
        angles: α, shape (n,) [rad].
        candidates: by event name, times of shape (n,) [s], NaN where it never happens.
        t_c: the actual end, shape (n,) [s].
        units: the unit system, for labels.
        real_part: of the complex root of ẋ = 0, NaN where it is real, shape (n,) [s].
        cusp: (α, t) where the events coincide.
        case: (α, t_c) of the case at hand.
    """
    time = readable_scale("time", units, float(np.nanmax(t_c)))
    degrees = np.rad2deg(angles)
    ax.plot(
        degrees, t_c / time.size, color=DIM, alpha=0.4, linewidth=9, solid_capstyle="butt", label="actual end $t_c$"
    )
    for name, times in candidates.items():
        ax.plot(degrees, times / time.size, color=ENDS.get(name, INK), label=_EVENT_LABELS.get(name, name))
    if real_part is not None:
        ax.plot(degrees, real_part / time.size, color=ENDS["stop"], linestyle=(0, (4, 4)), alpha=0.7,
                label="ẋ = 0: real part, complex root")  # fmt: skip
    _mark(ax, cusp, time, "D", PALETTE["green"], "cusp at {}")
    _mark(ax, case, time, "o", PALETTE["purple"], "this case, {}")
    ax.set_ylim(bottom=0, top=1.12 * float(np.nanmax(t_c)) / time.size)
    ax.set_ylabel(f"{typeset(RESULTS['t_c'].symbol)}  {RESULTS['t_c'].meaning}  [{time.unit}]")
    angle_axis(ax)
    legend_below(ax, columns=2)
    return ax


@house_style()
def plot_removal_rate(ax: Axes, trajectory: Trajectory, bars: int = 10) -> Axes:
    """dV/dt over time, whose area is the volume, with the bars of the midpoint rule."""
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
    ax.set_xlabel(f"t  time since contact  [{time.unit}]")
    ax.set_ylabel(f"$dV/dt$  [{volume.unit}/{time.unit}]")
    legend_below(ax, columns=2)
    return ax


@house_style()
def plot_volume(
    ax: Axes,
    angles: np.ndarray,
    volume: np.ndarray,
    ended_by: np.ndarray,
    *,
    units: System,
    best: tuple[float, float] | None = None,
    cusp: tuple[float, float] | None = None,
    case: tuple[float, float] | None = None,
) -> Axes:
    """Removed volume over the angle of attack, coloured by how the cut ends.

    Args:
        ax: empty axes.
        angles: α, ascending, shape (n,) [rad].
        volume: V, shape (n,) [volume].
        ended_by: "rebound", "stop" or "no-cut", shape (n,).
        units: the unit system, for labels.
        best: (α, V) of the maximum.
        cusp: (α, V) of the change of branch.
        case: (α, V) of the case at hand.
    """
    scale = readable_scale("volume", units, _largest(volume))
    for end in dict.fromkeys(str(end) for end in ended_by):
        shown = ended_by == end
        shown[:-1] |= shown[1:]  # one more point to the left, so that the coloured pieces join
        ax.plot(np.rad2deg(angles), np.where(shown, volume / scale.size, np.nan), color=ENDS.get(end, INK),
                linewidth=2.2, label="nothing is cut" if end == "no-cut" else f"ends by {end}")  # fmt: skip
    _mark(ax, cusp, scale, "D", PALETTE["green"], "change of branch at {}")
    _mark(ax, case, scale, "o", PALETTE["purple"], "this case, {}")
    _mark(ax, best, scale, "*", PALETTE["orange"], "greatest at {}")
    ax.set_ylim(bottom=0, top=1.1 * _largest(volume) / scale.size or None)
    ax.set_ylabel(f"{typeset(RESULTS['volume'].symbol)}  {RESULTS['volume'].meaning}  [{scale.unit}]")
    angle_axis(ax)
    legend_below(ax, columns=2)
    return ax


def render(fig: Figure, suffix: str, *, transparent: bool = False) -> bytes:
    """The figure as the bytes of an "svg", "png" or "pdf" file, the same for the same figure."""
    buffer = io.BytesIO()
    with house_style():
        fig.savefig(buffer, format=suffix, transparent=transparent, metadata=dict(_NO_DATES[suffix]))
    return buffer.getvalue()


def save_figure(fig: Figure, stem: Path) -> list[Path]:
    """Write `stem`.svg and `stem`.png on a white ground; returns their paths."""
    return [save_plot(fig, stem.with_name(f"{stem.name}.{suffix}")) for suffix in ("svg", "png")]


def save_plot(fig: Figure, path: str | Path) -> Path:
    """Write a figure to one file, in the format that its suffix names.

    Raises:
        ValueError: for a suffix other than .svg, .png or .pdf.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    write_whole(path, render(fig, _suffix(path)))
    return path


def require_plot_path(path: str | Path) -> None:
    """Find out whether `save_plot` can write there, before computing for it; raises as it does."""
    _suffix(Path(path))
    require_writable(Path(path))


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in _NO_DATES:
        raise ValueError(f"{path}: a plot's file name must end in .svg, .png or .pdf.")
    return suffix


_EVENT_LABELS = {"rebound": "rebound, y = 0", "stop": "stop, ẋ = 0"}


def _largest(values: Any) -> float:
    return float(np.max(np.abs(np.asarray(values))))


def _read(name: str, value: float, units: System) -> str:
    scale = readable_scale(RESULTS[name].dimension, units, abs(value))
    return f"{value / scale.size:.5g} {scale.unit}".replace(" 10", " × 10")


def typeset(symbol: str) -> str:
    """The symbol, such as t_c, as mathtext."""
    return re.sub(r"^(\w)_(\w+)$", r"$\1_{\2}$", symbol) if "_" in symbol else f"${symbol}$"


def _mark(ax: Axes, point: tuple[float, float] | None, scale: Scale, marker: str, color: str, label: str) -> None:
    if point is None:
        return
    angle = float(np.rad2deg(point[0]))
    size = 13 if marker == "*" else 7
    ax.plot([angle], [point[1] / scale.size], marker, color=color, markersize=size, markeredgecolor=INK,
            markeredgewidth=0.7, zorder=5, clip_on=False, label=label.format(f"{angle:.4g}°"))  # fmt: skip


def angle_axis(ax: Axes) -> None:
    """α from 0° to 90° along x."""
    quantity = QUANTITIES["alpha"]
    ax.set_xlim(0, 90)
    ax.set_xticks(range(0, 91, 15), [f"{tick}°" for tick in range(0, 91, 15)])
    ax.set_xlabel(f"{quantity.symbol}  {quantity.meaning}")


def legend_below(ax: Axes, columns: int) -> None:
    """The axes' legend, outside at the foot of the figure."""
    figure: Any = ax.figure
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=columns)
