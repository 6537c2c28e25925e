"""The style of every figure: colours, labels, sizes, and files that are the same each time.

Figures are made without pyplot, so this module has no global state. The user's matplotlibrc does not
change their style. Saved files hold no dates and no random ids: the same results give the same bytes.
"""

import contextlib
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter

from erosion.output.files import require_writable, write_whole
from erosion.output.language import ENGLISH, Language
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS, Scale
from erosion.plotting.labels import FAINT, INK

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
    # Text as outlines: every viewer shows the same text, with any fonts.
    "svg.fonttype": "path",
    "svg.hashsalt": "erosion",
    "savefig.dpi": 160,
}


@contextlib.contextmanager
def house_style() -> Iterator[None]:
    """Draw and save in the same style, independent of the user's settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def new_figure(width: float = 5.4, height: float = 3.7) -> Figure:
    """An empty figure; width and height in inches. At the default width a phone shows 10 pt text readably."""
    with house_style():
        return Figure(figsize=(width, height), layout="constrained")


def new_axes(width: float = 5.4, height: float = 3.7) -> tuple[Figure, Axes]:
    """An empty figure of one panel."""
    fig = new_figure(width, height)
    with house_style():
        return fig, fig.subplots()


def axes_or_new(ax: Axes | None, width: float, height: float) -> tuple[Figure, Axes]:
    """The axes that the caller gives, with their figure, or those of an empty figure."""
    if ax is None:
        return new_axes(width, height)
    fig = ax.get_figure(root=True)
    if fig is None:
        raise ValueError("Argument `ax` must be axes of a figure, but their figure is gone.")
    return fig, ax


def legend_of_panel(ax: Axes, handles: Sequence[Artist], columns: int) -> None:
    """A legend below a figure of one panel, or below one panel of several."""
    fig: Any = ax.figure
    if len(fig.axes) == 1:
        fig.legend(handles=handles, loc="outside lower center", ncols=columns)
    else:
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)


def render(fig: Figure, suffix: str, *, transparent: bool = False) -> bytes:
    """The bytes of an "svg", "png" or "pdf" file; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with house_style():
        fig.savefig(buffer, format=suffix, transparent=transparent, metadata=dict(_NO_DATES[suffix]))
    return buffer.getvalue()


def save_figure(fig: Figure, stem: Path) -> list[Path]:
    """Write `stem`.svg and `stem`.png on a white background; returns their paths."""
    svg, png = (stem.with_name(f"{stem.name}.{suffix}") for suffix in ("svg", "png"))
    save_plot(fig, svg)
    # Everything stays where it was drawn: to lay a figure out takes as long as to draw it.
    engine = fig.get_layout_engine()
    fig.set_layout_engine("none")
    save_plot(fig, png)
    fig.set_layout_engine(engine)
    return [svg, png]


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
    """Check that `save_plot` can write to the path, before anything is computed; errors as of `save_plot`."""
    _suffix(Path(path))
    require_writable(Path(path))


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in _NO_DATES:
        raise ValueError(f"{path}: a plot's file name must end in .svg, .png or .pdf.")
    return suffix


def typeset(symbol: str) -> str:
    """A symbol such as t_c as mathtext."""
    return re.sub(r"^(\w)_(\w+)$", r"$\1_{\2}$", symbol) if "_" in symbol else f"${symbol}$"


def angle_axis(ax: Axes, low: float = 0.0, high: float = 90.0, label: str | None = None) -> None:
    """Make x the axis of an angle in degrees, which is α unless a label says otherwise."""
    quantity = QUANTITIES["alpha"]
    ax.set_xlim(low, high)
    if (low, high) == (0, 90):
        ax.set_xticks(range(0, 91, 15))
    ax.xaxis.set_major_formatter("{x:g}°")
    ax.set_xlabel(f"{quantity.symbol}  {quantity.meaning}" if label is None else label)


def result_label(name: str, scale: Scale) -> str:
    """A result as an axis names it: "V  removed volume  [in³]"."""
    quantity = RESULTS[name]
    return f"{typeset(quantity.symbol)}  {quantity.meaning}  [{scale.unit}]"


def legend_below(ax: Axes, columns: int) -> None:
    """Put the axes' legend below the axes, at the bottom of the figure."""
    figure: Any = ax.figure
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def translate_figure(figure: Figure, language: Language) -> None:
    """Translate all texts of a figure, and the numbers of its axes."""
    if language == ENGLISH:
        return
    for text in cast(Sequence[Text], figure.findobj(Text)):
        text.set_text(language.number(language.label(text.get_text())))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            _translate_ticks(axis.get_major_formatter(), language)


def _translate_ticks(formatter: Formatter, language: Language) -> None:
    texts = formatter.format_ticks
    setattr(formatter, "format_ticks", lambda values: [language.number(text) for text in texts(values)])  # noqa: B010
