"""Results as a person or a program reads them: tables in text and HTML, JSON."""

import abc
import dataclasses
import html
import io
import json
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.core import Tracer

HEADINGS = ("quantity", "", "value", "unit", "meaning")
WIDTH = 120  # characters of a line of text


class Row(NamedTuple):
    """One line of a table; all cells are text already."""

    name: str
    symbol: str
    value: str
    unit: str
    meaning: str = ""


def format_number(value: Any, digits: int = 10) -> str:
    """A number as read by a person; an array as its shape and range."""
    if isinstance(value, Tracer):
        return f"traced{list(value.shape)}"
    array = np.asarray(value)
    if array.dtype.kind in "US":
        if array.ndim == 0:
            return str(array)
        names, counts = np.unique(array, return_counts=True)
        return ", ".join(f"{count:,} {name}" for name, count in zip(names, counts, strict=True))
    if array.ndim == 0:
        return f"{float(array):.{digits}g}"
    if not array.size:
        return f"{list(array.shape)} empty"
    return f"{list(array.shape)} {np.nanmin(array):.{digits}g} … {np.nanmax(array):.{digits}g}"


def abbreviate(value: Any) -> str:
    """A number so that Python reads the same one back, text in quotes, an array as its shape and range."""
    if isinstance(value, Tracer) or np.ndim(value):
        return f"<{format_number(value, 6)}>"
    number = np.asarray(value)
    if number.dtype.kind in "US":
        return repr(str(number))
    return repr(float(number)).removesuffix(".0")


def to_text(title: str, rows: Sequence[Sequence[str]], headings: Sequence[str] = HEADINGS) -> str:
    """An aligned table under a title, without colour, ending without a newline."""
    from rich.console import Console

    buffer = io.StringIO()
    # In a notebook rich would show the table there and leave the buffer empty.
    console = Console(file=buffer, width=WIDTH, highlight=False, color_system=None, force_jupyter=False)
    console.print(to_rich(title, rows, headings))
    return "\n".join(line.rstrip() for line in buffer.getvalue().rstrip().splitlines())


def to_rich(
    title: str, rows: Sequence[Sequence[str]], headings: Sequence[str] = HEADINGS, numbers: Collection[int] = (2,)
) -> Any:
    """The same as a rich table, for the terminal; the columns `numbers` are flush right."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    # As `Text`, because rich takes what is in brackets, like a unit, for its own markup.
    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, title_style="bold", pad_edge=False)
    for i, heading in enumerate(headings):
        last = i == len(headings) - 1
        side = "right" if i in numbers else "left"
        keep, style = i > 0 and not last, "dim" if last else ""
        table.add_column(Text(heading), justify=side, no_wrap=keep, overflow="fold", style=style)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table


def to_html(title: str, rows: Sequence[Sequence[str]], headings: Sequence[str] = HEADINGS) -> str:
    """The same as an HTML table."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><caption>{html.escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


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


class Result(abc.ABC):
    """A result that prints as a table, shows as one in a notebook, and is numbers by name for programs."""

    @property
    @abc.abstractmethod
    def title(self) -> str:
        """One line above the table."""

    @abc.abstractmethod
    def rows(self) -> Sequence[Sequence[str]]:
        """The table, all cells as text."""

    @property
    def headings(self) -> Sequence[str]:
        """The columns of the table."""
        return HEADINGS

    @property
    def statements(self) -> Sequence[str]:
        """Sentences below the table."""
        return ()

    def to_dict(self) -> dict[str, Any]:
        """The numbers by name, in Python's own types; NaN and infinity stay what they are."""
        return to_plain(self)

    def __str__(self) -> str:
        return "\n".join([to_text(self.title, self.rows(), self.headings), *self.statements])

    def _repr_html_(self) -> str:
        sentences = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in self.statements)
        return to_html(self.title, self.rows(), self.headings) + sentences
