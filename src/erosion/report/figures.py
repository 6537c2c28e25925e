"""The figures of a page in its language."""

import re
from collections.abc import Sequence
from typing import Any, cast

from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter

from erosion.language import ENGLISH, Language


def translate_figure(figure: Figure, language: Language) -> None:
    """Translate all texts of a figure, and the numbers of its axes."""
    if language == ENGLISH:
        return
    for text in cast(Sequence[Text], figure.findobj(Text)):
        text.set_text(language.number(_translated(text.get_text(), language)))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(_Translated(axis.get_major_formatter(), language))


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
