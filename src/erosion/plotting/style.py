"""The style of every figure: colours, labels, sizes, and files that are the same each time.

Figures are made without pyplot, so this module has no global state. The user's matplotlibrc does not
change their style. Saved files hold no dates and no random ids: the same results give the same bytes.
"""

import contextlib
import contextvars
import io
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure, SubFigure
from matplotlib.legend import Legend
from matplotlib.ticker import LogFormatter

from erosion.impacts import BEYOND_LABEL, OF_TURN
from erosion.output import write_whole
from erosion.parameters import QUANTITIES, RESULTS, Scale, UnitError, about, has_unit, read_quantity, unit_size
from erosion.plotting.labels import FAINT, INK
from erosion.results import Finding

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
    "legend.handlelength": 3.0,  # of which a reader tells long dashes
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
_FOR_PRINT: Mapping[Any, Any] = {"font.size": 8, "axes.labelsize": 8, "legend.fontsize": 7.6, "savefig.dpi": 400}
_LOWER = 0.8  # the heights of figures with smaller letters
_WIDTH: contextvars.ContextVar[float | None] = contextvars.ContextVar("width", default=None)
"""Of figures that are drawn for print [inch]; None for those of a screen, which have widths of their own."""
_NARROWEST, _WIDEST = 0.05, 0.5  # m
_UNHINTED = 400  # dpi, at which letters have the widths that they have in SVG and PDF
_SPARE = 0.95  # of a line's room, as some letters are wider than others
_LETTERS = 16  # of 8 pt in an inch
# A comma or an "@" anywhere else belongs to a name: "jo@work.com/Berlin,2026.png".
_SUFFIX = rf"\.(?:{'|'.join(FigureCanvasBase.filetypes)})"
_LISTED = re.compile(rf"({_SUFFIX}\s*(?:@[^/\\,]*)?),", re.IGNORECASE)
_OF_WIDTH = re.compile(rf"(.+{_SUFFIX})\s*@([^/\\]+)", re.IGNORECASE)


@contextlib.contextmanager
def house_style() -> Iterator[None]:
    """Draw and save in the same style, independent of the user's settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        if _WIDTH.get() is not None:
            mpl.rcParams.update(_FOR_PRINT)
        yield


@contextlib.contextmanager
def for_print(width: float | None) -> Iterator[None]:
    """Figures that are made and saved within have this width [m], such as a column's 0.084, and letters of 8 pt."""
    token = _WIDTH.set(None if width is None else width / unit_size("length", "inch-pound"))
    try:
        yield
    finally:
        _WIDTH.reset(token)


def new_figure(width: float = 5.4, height: float = 3.7) -> Figure:
    """An empty figure; width and height in inches. At the default width a phone shows 10 pt text readably."""
    if (printed := _WIDTH.get()) is not None:
        width, height = printed, _LOWER * height
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


def mark_turned(ax: Axes, findings: Iterable[Finding]) -> list[Artist]:
    """An entry of a panel's legend where a finding says that some bodies turn by more than 90°."""
    if not any(finding.code in OF_TURN for finding in findings):
        return []
    return [*ax.plot([], [], color="none", label=f"some: {BEYOND_LABEL}")]


def render(fig: Figure, suffix: str, *, transparent: bool = False) -> bytes:
    """The bytes of an "svg", "png" or "pdf" file; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with house_style():
        fig.savefig(buffer, format=suffix, transparent=transparent, metadata=dict(_NO_DATES[suffix]))
    return buffer.getvalue()


def save_plot(fig: Figure, path: str | Path) -> Path:
    """Write a figure to one file, in the format that its suffix names.

    Raises:
        ValueError: for a suffix other than .svg, .png or .pdf.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    write_whole(path, render(fig, _suffix(path)))
    return path


def plot_files(text: str | Path) -> dict[Path, float | None]:
    """The files of "a.png" or "a.png,b.pdf@84mm", and for print the width of each [m].

    Raises:
        ValueError: for a suffix as of `save_plot`, a file that is named twice, and a width that is none.
    """
    files: dict[Path, float | None] = {}
    for part in _LISTED.sub("\\1\0", str(text)).split("\0"):
        name, width = match.groups() if (match := _OF_WIDTH.fullmatch(part.strip())) else (part.strip(), None)
        _suffix(Path(name))
        if Path(name) in files:
            raise ValueError(f"{name}: is named twice, but every file must be another.")
        files[Path(name)] = None
        if width is not None:
            with about(f"{name}: the width"):
                files[Path(name)] = size = read_quantity(width, "length", "si")
                if not (has_unit(width) and _NARROWEST <= size <= _WIDEST):
                    raise UnitError(f"must be from 50 mm to 500 mm, with its unit, but is {width}")
    return files


def save_plots(make: Callable[[], Figure], files: Mapping[Path, float | None]) -> None:
    """Draw a figure into files, each of its width; see `plot_files`."""
    for width in dict.fromkeys(files.values()):
        with for_print(width):
            fig = make()
            fit_legends(fig)
            for path in (path for path, wanted in files.items() if wanted == width):
                save_plot(fig, path)


@house_style()
def fit_legends(figure: Figure) -> None:
    """Give legends that are wider than their figure fewer columns, and break their texts where that is not enough."""
    for part in (figure, *figure.subfigs):
        axes = reversed(part.axes)  # marks of the first panels have the colour of ink
        whole = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
        for legend in list(part.legends):
            _fit_legend(part, legend, whole)


def _fit_legend(figure: Figure | SubFigure, legend: Legend, whole: Mapping[str, Any]) -> None:
    """See `fit_legends`.

    Args:
        figure: of the legend.
        legend: to be fitted.
        whole: the marks of the axes by their labels: of those with bars the legend's own are lines.
    """
    title = "\n".join(textwrap.wrap(legend.get_title().get_text(), int(_LETTERS * _inches(figure))))
    for columns in (2, 1):
        if _overhang(figure, legend) <= 0:
            break
        height = legend.get_window_extent().height
        legend.remove()
        labels = [text.get_text() for text in legend.get_texts()]
        handles: Any = [whole.get(label, own) for label, own in zip(labels, legend.legend_handles, strict=True)]
        legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns, title=title or None)
        _grow(figure, legend, height)
    if (overhang := _overhang(figure, legend)) <= 0:
        return
    height, widths = legend.get_window_extent().height, [_width(figure, text) for text in legend.get_texts()]
    room = _SPARE * (max(*widths, _width(figure, legend.get_title())) - overhang)
    for text, width in zip(legend.get_texts(), widths, strict=True):
        if width > room:
            words = text.get_text()
            text.set_text("\n".join(textwrap.wrap(words, max(1, int(len(words) * room / width)))))
    _grow(figure, legend, height)


def _inches(figure: Figure | SubFigure) -> float:
    """The width of a figure [inch]."""
    return figure.bbox.width / figure.dpi


def _width(figure: Figure | SubFigure, artist: Artist) -> float:
    """The width of a part of a figure [inch]; the greatest, as hinted letters of a file in pixels are wider."""
    whole, widths = _whole(figure), []
    dpi = whole.get_dpi()
    for dots in (float(mpl.rcParams["savefig.dpi"]), _UNHINTED):
        whole.set_dpi(dots)
        widths.append(artist.get_window_extent().width / dots)
    whole.set_dpi(dpi)
    return max(widths)


def _overhang(figure: Figure | SubFigure, legend: Legend) -> float:
    """By how much a legend is wider than its figure [inch]."""
    return _width(figure, legend) - _inches(figure)


def _grow(figure: Figure | SubFigure, legend: Legend, height: float) -> None:
    """Make the figure higher by what its legend has grown from this height, so that the axes keep theirs."""
    whole = _whole(figure)
    share = figure.bbox.height / whole.bbox.height
    growth = (legend.get_window_extent().height - height) / whole.dpi
    whole.set_figheight(whole.get_figheight() + growth / share)


def _whole(figure: Figure | SubFigure) -> Figure:
    """The figure that a figure is a part of."""
    return figure.get_figure(root=True)


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in _NO_DATES:
        raise ValueError(f"{path}: a plot's file name must end in .svg, .png or .pdf.")
    return suffix


def typeset(symbol: str) -> str:
    """A symbol such as t_c as mathtext."""
    return re.sub(r"^(\w)_(\w+)$", r"$\1_{\2}$", symbol) if "_" in symbol else f"${symbol}$"


class PlainNumbers(LogFormatter):
    """Ticks of a logarithmic axis as 0.3 and 30, not 3e-01 and 3 × 10¹."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """The label of a tick; none for 4, 40, …, whose labels would touch those of 3, 30, …."""
        return f"{x:g}" if super().__call__(x, pos) and not f"{x:e}".startswith("4") else ""


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


def legend_below(
    panels: Axes | Sequence[Axes], columns: int, handles: Sequence[Any] = (), title: str | None = None
) -> None:
    """A legend below a figure, or below one of its panels: each label once, that of invalid cuts last.

    Args:
        panels: one, or a list for a legend below the whole figure.
        columns: of the legend, on a screen.
        handles: the entries; without it all labelled ones of the panels.
        title: above the entries.
    """
    axes = [panels] if isinstance(panels, Axes) else panels
    figure: Any = axes[0].figure
    entries: dict[str, Any] = {}
    for handle in handles or [handle for ax in axes for handle in ax.get_legend_handles_labels()[0]]:
        entries.setdefault(handle.get_label(), handle)
    labels = sorted(entries, key=BEYOND_LABEL.__eq__)
    columns = min(columns, len(labels), columns if _WIDTH.get() is None else 2)
    look: dict[str, Any] = {"handles": [entries[label] for label in labels], "labels": labels, "ncols": columns or 1}
    if axes is panels or len(figure.axes) == 1:
        figure.legend(loc="outside lower center", title=title, **look)
    else:
        axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), title=title, **look)
