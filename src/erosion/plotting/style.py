"""How every figure looks: colours, units that read well, files that are the same each time.

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
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.files import require_writable, write_whole
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.units import SYSTEMS, Dimension, System, unit_name

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


def typeset(symbol: str) -> str:
    """The symbol, such as t_c, as mathtext."""
    return re.sub(r"^(\w)_(\w+)$", r"$\1_{\2}$", symbol) if "_" in symbol else f"${symbol}$"


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
