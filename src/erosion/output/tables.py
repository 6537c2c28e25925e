"""Results as a person or a program reads them: tables in text and HTML, JSON."""

import csv
import dataclasses
import html
import io
import json
import math
import re
import sys
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rich.text import Text


WIDTH = 120  # characters of a line of text
_PLAIN = 6  # digits before the point that need no power of ten
_LONG = 200  # characters of a value in a message


Record = dict[str, Any]
"""Results by name: numbers, texts, lists and dictionaries of them."""


def is_traced(value: Any) -> bool:
    """Whether JAX is tracing the value; nothing is where JAX isn't loaded."""
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.core.Tracer)


def format_number(value: Any, digits: int = 10, size: float = 1.0) -> str:
    """A number as read by a person; an array as its shape and range.

    Args:
        value: numbers, or words, which are counted.
        digits: significant digits; fewer than six give a power of ten from a million on, as six do.
        size: of the unit in which numbers are shown.
    """
    if is_traced(value):
        return f"traced{list(np.shape(value))}"
    array = np.asarray(value)
    if array.dtype.kind in "US":
        if array.ndim == 0:
            return str(array)
        names, counts = np.unique(array, return_counts=True)
        return ", ".join(f"{count:,} {name}" for name, count in zip(names, counts, strict=True))
    array = array / size
    if array.ndim == 0:
        return f"{float(f'{float(array):.{digits}g}'):.{max(digits, _PLAIN)}g}"
    if not array.size:
        return f"{list(array.shape)} empty"
    # NumPy's own least and greatest of nothing but NaN warn of it.
    least, greatest = np.fmin.reduce(array, axis=None), np.fmax.reduce(array, axis=None)
    return f"{list(array.shape)} {least:.{digits}g} … {greatest:.{digits}g}"


def largest_of(value: object) -> float:
    """The greatest magnitude of a number or an array; 0 where there is none."""
    if is_traced(value):
        return 0.0
    magnitudes = np.abs(np.asarray(value, dtype=float))
    return float(np.max(magnitudes, where=np.isfinite(magnitudes), initial=0.0))


def with_error(value: float, error: float, size: float = 1.0) -> str:
    """A number and its standard error, to the error's second digit: "31.72 ± 0.11"; alone where the error is 0."""
    value, error = value / size, error / size
    if not (math.isfinite(error) and error > 0 and math.isfinite(value)):
        return f"{value:.6g}" if error == 0 else f"{value:.6g} ± {error:.2g}"
    places = 1 - math.floor(math.log10(float(f"{error:.1e}")))
    if abs(value) >= 1e7 or places > 12:
        return f"{value:.6g} ± {error:.2g}"
    return f"{round(value, places):.{max(places, 0)}f} ± {round(error, places):.{max(places, 0)}f}"


def abbreviate(value: object) -> str:
    """A number so that Python reads the same one back, text in quotes, an array as its shape and range."""
    if is_traced(value) or np.asarray(value).ndim:
        return f"<{format_number(value, 6)}>"
    number = np.asarray(value)
    if number.dtype.kind in "US":
        return repr(str(number))
    return repr(float(number)).removesuffix(".0")


def briefly(value: Any) -> str:
    """A value as a message shows it, on one line; of a long one the beginning."""
    text = repr(value)
    if "\n" in text:
        text = " ".join(text.split())
    return text if len(text) <= _LONG else f"{text[:40]}… ({len(text):,} characters)"


def first_of(words: Sequence[str], most: int) -> list[str]:
    """The first words of a list, and how many more it has: "a", "b", "and 3 more"."""
    return [*words[:most], f"and {len(words) - most:,} more"] if len(words) > most else [*words]


def sentences(*table: tuple[object, str]) -> tuple[str, ...]:
    """The sentences of a table of conditions, each with its sentence, whose condition is true."""
    return tuple(sentence for condition, sentence in table if condition)


def to_lines(
    title: str,
    rows: Sequence[Sequence[str]],
    headings: Sequence[str],
    numbers: Collection[int],
    width: int = WIDTH,
) -> "list[Text]":
    """A table as lines of rich text for a terminal.

    To fit into the width, the last column wraps between words, and a long name in the first column gets
    a line of its own. The title and names are never broken, as they may hold paths: `rich.table` would break them.

    Args:
        title: above the table; none where it is empty.
        rows: cells.
        headings: of the columns.
        numbers: the columns that are flush right.
        width: of the terminal, in characters.
    """
    from rich.cells import cell_len  # with `text` 40 ms that `--json` does without
    from rich.text import Text

    columns = list(zip(headings, *rows, strict=True))
    names, *others = ([cell_len(cell) for cell in column] for column in columns)
    layouts = [(_widths(names, [*map(max, others)], numbers, width, gap, least), gap) for gap, least in _LAYOUTS]
    # The roomiest in which all names fit, else the tightest.
    widths, gap = next((layout for layout in layouts if max(names) <= layout[0][0]), layouts[-1])
    lines = [Text(title, "bold")] * bool(title) + [Text()]
    for at, (name, *middle, last) in enumerate([headings, *rows]):
        if names[at] > widths[0]:
            lines.append(Text(f" {name}"))
            name = ""
        cells = [name, *middle]
        for words in _wrapped(last, widths[-1]):
            spaces = [" " * (size - cell_len(cell)) for cell, size in zip([*cells, words], widths, strict=True)]
            padded = [space + cell if i in numbers else cell + space
                      for i, (cell, space) in enumerate(zip([*cells, words], spaces, strict=True))]  # fmt: skip
            before = f" {(' ' * gap).join([*padded[:-1], ''])}"
            lines.append(Text.assemble((before, "" if at else "bold"), (padded[-1], "dim" if at else "bold")))
            lines[-1].rstrip()
            cells = [""] * len(cells)
        if not at:
            lines.append(Text(" " + "─" * (sum(widths) + gap * (len(widths) - 1))))
    return [*lines, Text()]


_LAYOUTS = ((3, 24), (2, 24), (2, 16))
"""Characters between two columns and those to which the last column shrinks, the roomiest layout first."""


def _widths(
    names: Sequence[int], others: Sequence[int], numbers: Collection[int], width: int, gap: int, least: int
) -> list[int]:
    """The widths of the columns; the first one's is that of the names which fit beside the others."""
    *middle, last = others
    room = width - 1 - gap * len(others) - sum(middle)
    if len(others) in numbers:  # numbers never wrap
        return [max((length for length in names if length <= room - last), default=0), *others]
    least = min(last, least)
    first = max((length for length in names if length <= room - least), default=0)
    return [first, *middle, max(least, min(last, room - first))]


def _wrapped(text: str, width: int) -> list[str]:
    """Lines of whole words; "k = 2" is one word, if there is room for it."""
    whole = re.sub(
        r"\S+ = \S+", lambda found: found[0].replace(" ", "\0") if len(found[0]) <= width else found[0], text
    )
    lines = textwrap.wrap(whole, width, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\0", " ") for line in lines] or [""]


def to_html(title: str, rows: Sequence[Sequence[str]], headings: Sequence[str]) -> str:
    """The same as an HTML table."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><caption>{html.escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def split_list(text: str) -> list[str]:
    """The items of a list with commas between them; one in quotes may have commas: 'a, "b, c"'.

    Raises:
        ValueError: with a clause that starts with "must".
    """
    try:
        items = next(csv.reader([text], skipinitialspace=True), [])
    except csv.Error as error:
        raise ValueError(f"must be a list in one line, but is {briefly(text)}") from error
    return [item.strip() for item in items]


def list_item(text: str) -> str:
    """A text as `split_list` reads it: in quotes where it needs them."""
    return '"{}"'.format(text.replace('"', '""')) if "," in text or text.startswith('"') else text


def to_csv(columns: Mapping[str, Iterable[Any]]) -> str:
    """Comma-separated values: the headings, then a line for each row; Python's own floats are exact to the last bit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def to_json(content: Mapping[str, Any]) -> str:
    """JSON, indented; NaN and infinity, which it lacks, as null."""
    return json.dumps(_finite(to_plain(content)), indent=2, ensure_ascii=False, allow_nan=False)


def to_plain(value: Any) -> Any:
    """Numbers, lists, texts and dictionaries of Python, from arrays and dataclasses of any depth."""
    if isinstance(value, (bool, int)) or value is None:
        return value
    if isinstance(value, (str, float)):
        return str(value) if isinstance(value, str) else float(value)  # numpy's are subclasses
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    array = np.asarray(value)
    if array.dtype == object and not array.ndim:
        raise TypeError(f"{type(value).__name__} is not made of numbers and texts.")
    return to_plain(array.tolist())


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
