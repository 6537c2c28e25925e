"""The figures of a page in its language, and of a handout in its size."""

import re
from collections.abc import Sequence
from typing import Any, cast

from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter

from erosion.language import ENGLISH, Language
from erosion.plotting.style import house_style

# inches; a handout prints a figure in a column of 3.4 inches, and a wide one across both. Text of 9.5 pt is 7 pt there.
_IN_A_COLUMN, _WIDE, _FLAT = 4.5, 6.5, 3.6


def translate_figure(figure: Figure, language: Language) -> None:
    """Translate all texts of a figure, and the numbers of its axes."""
    if language == ENGLISH:
        return
    for text in cast(Sequence[Text], figure.findobj(Text)):
        text.set_text(language.number(_translated(text.get_text(), language)))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(_Translated(axis.get_major_formatter(), language))


def is_wide(figure: Figure) -> bool:
    """Whether a figure needs the whole width of a sheet."""
    return bool(figure.get_figwidth() > _WIDE)


@house_style()
def fit_on_sheet(figure: Figure) -> None:
    """Give a figure the size at which its text is readable on a handout; its legends get fewer columns if need be."""
    if is_wide(figure):
        figure.set_figheight(_FLAT)
    else:
        figure.set_size_inches(_IN_A_COLUMN, 0.88 * figure.get_figheight())
    for legend in list(figure.legends):
        for columns in (2, 1):
            extent = legend.get_window_extent()
            if extent.width <= figure.bbox.width:
                break
            legend.remove()
            labels = [text.get_text() for text in legend.get_texts()]
            handles = [handle for handle in legend.legend_handles if handle is not None]
            legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns)
            growth = (legend.get_window_extent().height - extent.height) / figure.dpi
            figure.set_figheight(figure.get_figheight() + growth)  # the axes keep their height


def _translated(label: str, language: Language) -> str:
    """A label such as "V  removed volume  [in³]": its symbol and unit stay."""
    symbol, gap, rest = label.partition("  ")
    whole = language.text(label)
    if whole != label or not gap:
        return whole
    meaning, end, unit = rest.partition("  ")
    name = symbol if re.fullmatch(r"\W*\w\W*|\$.*\$|\S{1,3}|.* = .*", symbol) else language.text(symbol)
    return name + gap + (language.text(meaning) if not meaning.startswith("[") else meaning) + end + unit


class _Translated(Formatter):
    """A formatter whose numbers have the separators of a language.

    Args:
        inner: the formatter that makes the texts.
        language: their language.
    """

    def __init__(self, inner: Formatter, language: Language) -> None:
        self._inner, self._language = inner, language

    def __call__(self, x: Any, pos: int | None = None) -> str:
        return self._language.number(self._inner(x, pos))

    def set_axis(self, axis: Any) -> None:
        self._inner.set_axis(cast(Axis, axis))

    def set_locs(self, locs: Any) -> None:
        self._inner.set_locs(locs)

    def get_offset(self) -> str:
        return self._inner.get_offset()
