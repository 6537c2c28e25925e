"""Tables of text: their characters, their comments, what separates cells, and the mark of decimals.

The header is the first line that is neither empty nor a comment (# or %). What CFD-Post writes up to "[Data]" may stand
before it, and a line such as "sep=;", which names the separator.
"""

import array
import codecs
import contextlib
import csv
import dataclasses
import functools
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv

from erosion.output import briefly
from erosion.tables.headings import unit_row
from erosion.tables.source import BLOCK_BYTES, Numbers, Source, TableError

_HEAD = 1 << 16  # bytes in which a header must end
TAB = "tab"
"""The word for the separator that a command cannot show."""

_SEPARATORS = "\t;,"  # the first of them in a header separates its cells; headings may hold the ones after it
_COMMENT = re.compile(rb'^[ \t]*"?[ \t]*[#%].*$')
_NOTHING = re.compile(rb'^[\s,;"]*$')
_NO_ROWS = re.compile(rb'^(?:[ \t]*"?[ \t]*[#%].*|[ \t;,"]*)\r?(?:\n|\Z)', re.MULTILINE)
_SIGNS = (b"#", b"%", b"\n\n", b"\n\r", b"\n ", b"\n\t", b"\n;", b"\n,", b'\n"')  # a row that is none begins with one
_PART = re.compile(r"\[\w+\]")
"""The line with which CFD-Post begins a part of a file."""
_NAMED_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_SPACES = bytes.maketrans(b"\t\r", b" \n")

_NUMBER = r"[-+]?(\d+{0}?\d*|{0}\d+)([eE][-+]?\d+)?"
_WITH_POINT, _WITH_COMMA = (re.compile(_NUMBER.format(re.escape(mark))) for mark in ".,")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+")
_WHOLE = re.compile(r"[-+]?\d+")

_WORDS = ("-", "–", "—", "--", "?", "n.a.", "n.a", "na", "n/a", "#n/a", "#nv", "nan", "nd", "n.d.", "k.a.", "none",
          "null", "missing")  # fmt: skip
MISSING = ("", *(form for word in _WORDS for form in dict.fromkeys((word, word.upper(), word.capitalize(), "NaN"))))
"""What stands in a cell that has no number."""


@dataclasses.dataclass(frozen=True)
class Layout:
    """The layout of a text.

    Args:
        first: lines before its first row.
        headings: of its columns.
        separator: of its cells; a space for any number of spaces.
        units: a row of them below the header; empty where there is none.
    """

    first: int
    headings: tuple[str, ...]
    separator: str
    units: tuple[str, ...] = ()


class TextTable(Source):
    """A file of text, which may be compressed.

    Args:
        path: of the file.
        separator: of cells, where the user names it.
        decimal: the mark of decimals, where the user names it.
        layout: where another reader knows it.

    Raises:
        TableError: for a file that cannot be read, or without a header.
    """

    def __init__(
        self, path: Path, separator: str | None = None, decimal: str | None = None, layout: Layout | None = None
    ) -> None:
        self.title, self._path = str(path), path
        separator = "\t" if separator == TAB else separator
        for name, value, known in (("sep", separator, (",", ";", "\t", " ")), ("decimal", decimal, (".", ","))):
            if value is not None and value not in known:
                listed = ", ".join(repr(TAB if each == "\t" else each) for each in known)
                raise TableError(f"Argument `{name}` must be one of {listed}, but is {briefly(value)}.")
        self._decimal = "." if layout else decimal
        text, self._is_whole, self.notes = _beginning(path)
        self._lines = text.splitlines(keepends=True) if layout else io.StringIO(text, newline="\n").readlines()
        self._layout = layout or _layout(path, self._lines, separator)
        self.headings = self._layout.headings
        self.units = {head: unit for head, unit in zip(self.headings, self._layout.units, strict=False) if unit}
        self._removed = array.array("q")  # of each line that is no row, the number of rows before it

    def place(self, row: int) -> str:
        """The line of a row that was read."""
        return f"line {self.lines(np.array([row]))[0]:,}"

    def lines(self, rows: np.ndarray) -> np.ndarray:
        """See `Source`."""
        return self._layout.first + 1 + rows + np.searchsorted(self._removed, rows, side="right")

    def check(self, headings: Sequence[str]) -> None:
        """See `Source`: refuse decimals that cannot be told from thousands."""
        _ = self._punctuation(tuple(headings))

    def blocks(self, headings: Sequence[str]) -> Iterator[Numbers]:
        """See `Source`."""
        layout, (decimal, kind) = self._layout, self._punctuation(tuple(headings))
        self._removed = array.array("q")
        wrong = list[Any]()

        def refuse(row: Any) -> str:
            wrong.append(row)
            return "error"

        with open_text(self._path) as file:
            for _ in range(layout.first):
                file.readline()
            rows = _RowStream(file, layout.separator == " ", functools.partial(self._note, tuple(headings)))
            try:
                for batch in arrow_csv.open_csv(
                    pa.PythonFile(rows, mode="r"),
                    arrow_csv.ReadOptions(column_names=_distinct(self.headings), block_size=BLOCK_BYTES),
                    arrow_csv.ParseOptions(
                        delimiter=layout.separator,
                        quote_char=layout.separator != " " and '"',
                        invalid_row_handler=refuse,
                    ),
                    arrow_csv.ConvertOptions(
                        include_columns=list(headings),
                        decimal_point=decimal,
                        column_types=dict.fromkeys(headings, kind),
                        null_values=[*MISSING, *(f" {word}" for word in MISSING)],
                    ),
                ):
                    yield {
                        name: np.asarray(batch.column(name).to_numpy(zero_copy_only=False), float) for name in headings
                    }
            except pa.ArrowInvalid as error:
                said = self._wrong(headings, decimal)
                # A file without rows is one, too: pyarrow takes it for an error.
                if said is not None:
                    raise TableError(f"{self.title}{said}.") from error

    @functools.cached_property
    def _sample(self) -> list[list[str]]:
        """The cells of the rows at the beginning."""
        texts = (line for line in self._lines[self._layout.first :] if not _NO_ROWS.match(line.encode()))
        return [_cells(text, self._layout.separator) for text in texts]

    @functools.lru_cache(maxsize=4)  # noqa: B019 (a table is short-lived)
    def _punctuation(self, headings: tuple[str, ...]) -> tuple[str, Any]:
        """The mark of decimals, and the type of numbers, by the cells of the columns at the beginning."""
        if self._decimal is not None:
            return self._decimal, pa.float64()
        if self._layout.separator == ",":
            return ".", pa.float64()
        at = [self.headings.index(heading) for heading in headings]
        cells = [row[i].strip(' "') for row in self._sample for i in at if i < len(row)]
        points, commas = (
            [cell for cell in cells if mark in cell and pattern.fullmatch(cell)]
            for mark, pattern in ((".", _WITH_POINT), (",", _WITH_COMMA))
        )
        if points and commas:
            raise TableError(
                f"{self.title}: has numbers with points and with commas, {points[0]!r} and {commas[0]!r}; Argument "
                "`decimal` must say which is the mark of decimals, and the other must go."
            )
        if (marked := points + commas) and all(map(_THOUSANDS.fullmatch, marked)):
            mark = "." if points else ","
            whole = re.sub("[.,]", "", marked[0])
            raise TableError(
                f"{self.title}: {marked[0]!r} may be {marked[0].replace(',', '.', 1)} or {whole}: Argument `decimal` "
                f"must be {mark!r} if it is the mark of decimals; if it is that of thousands, it must go."
            )
        if not marked and not self._is_whole and all(map(_WHOLE.fullmatch, filter(None, cells))):
            return ".", pa.int64()
        return ("," if commas else "."), pa.float64()

    def _note(self, headings: tuple[str, ...], before: int, line: bytes) -> None:
        """Keep the place of a line that is no row; refuse a comment that may be one."""
        self._removed.append(before)
        if not _COMMENT.match(line):
            return
        text, separator = line.decode(errors="replace"), self._layout.separator
        if [cell.strip() for cell in _cells(re.sub("[#%()]", " ", text).strip(), separator)] == [*self.headings]:
            raise TableError(f"{self.title}: has its header again below {before:,} rows; is it two tables?")
        cells = _cells(text, separator)
        numbers = [cells[self.headings.index(heading)] for heading in headings] if self._has_all(cells) else []
        if numbers and all(_is_number(cell, self._decimal or ".") for cell in numbers):
            raise TableError(
                f"{self.title}: column {self.headings[0]!r}: rows begin with {line.lstrip()[:1].decode()} as comments "
                "do; take these rows away."
            )

    def _has_all(self, cells: Sequence[str]) -> bool:
        return len(cells) == len(self.headings)

    def _wrong(self, headings: Sequence[str], decimal: str) -> str | None:
        """The line that pyarrow refuses, and what is wrong with it; None for a file without rows."""
        has_rows = False
        with open_text(self._path) as file:
            for number, line in enumerate(file, 1):
                if number <= self._layout.first or _NO_ROWS.match(line):
                    continue
                has_rows = True
                text = (_plain(line) if self._layout.separator == " " else line).decode(errors="replace")
                cells, width = _cells(text, self._layout.separator), len(self.headings)
                if _PART.fullmatch(text.strip()):
                    return f", line {number}: {text.strip()} begins another part; keep the table alone"
                if not self._has_all(cells):
                    hint = "; with decimal commas, columns stand between semicolons" * (
                        self._layout.separator == "," and len(cells) > width
                    )
                    return f", line {number}: has {len(cells)} cells, but the header names {width} columns{hint}"
                for heading in headings:
                    cell = cells[self.headings.index(heading)].strip()
                    if cell in MISSING:
                        continue
                    if (
                        self._is_late(headings)
                        and any(map(_is_number, (cell, cell), ".,"))
                        and not _WHOLE.fullmatch(cell)
                    ):
                        return (
                            f", line {number}: column `{heading}` is {cell!r}, but all numbers before are whole: "
                            "Argument `decimal` must be its mark of decimals"
                        )
                    if not _is_number(cell, decimal):
                        return f", line {number}: column `{heading}` must be a number, but is {briefly(cell)}"
        return ": cannot be read as a table of text" if has_rows else None

    def _is_late(self, headings: Sequence[str]) -> bool:
        """Whether the beginning shows no mark of decimals."""
        return self._punctuation(tuple(headings))[1] == pa.int64()


class _RowStream(io.RawIOBase):
    """The lines of a text that are rows.

    Args:
        file: at its first row.
        has_spaces: whether spaces separate cells.
        note: is called for each other line, with the number of rows before it.
    """

    def __init__(self, file: io.BufferedIOBase, has_spaces: bool, note: Callable[[int, bytes], None]) -> None:
        self._file, self._has_spaces, self._note = file, has_spaces, note
        self._rest, self._count = b"", 0

    def readable(self) -> bool:
        """Yes."""
        return True

    def read(self, size: int = -1, /) -> bytes:
        """Some rows, at most `size` bytes of them."""
        while not self._rest and (lines := self._file.read(BLOCK_BYTES)):
            self._rest = self._of_rows(lines + self._file.readline())
        size = len(self._rest) if size is None or size < 0 else size
        part, self._rest = self._rest[:size], self._rest[size:]
        return part

    def _of_rows(self, lines: bytes) -> bytes:
        """Complete lines without those that are no rows."""
        padded = b"\n" + lines
        if any(sign in padded for sign in _SIGNS):
            kept, begin = list[bytes](), 0
            for other in _NO_ROWS.finditer(lines):
                if other.end() > other.start():
                    kept.append(lines[begin : other.start()])
                    self._count += kept[-1].count(b"\n")
                    self._note(self._count, other[0])
                    begin = other.end()
            kept.append(lines[begin:])
            lines = b"".join(kept)
            self._count += kept[-1].count(b"\n")
        else:
            self._count += lines.count(b"\n")
        return _plain(lines) if self._has_spaces else lines


def _plain(lines: bytes) -> bytes:
    """Complete lines without parentheses, with one space between cells."""
    lines = lines.replace(b"\r\n", b"\n").translate(_SPACES, b"()")
    if b"  " in lines:
        lines = re.sub(rb" {2,}", b" ", lines)
    return lines.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


@contextlib.contextmanager
def open_text(path: Path) -> Iterator[Any]:
    """The bytes of a text for reading within, in UTF-8 or Windows-1252, decompressed where its name ends in ".gz".

    Raises:
        TableError: where it cannot be opened or read.
    """
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as file:
            begins = file.peek(_HEAD)[:_HEAD]
            if begins.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                yield io.BufferedReader(io.BytesIO(file.read().decode("utf-16").encode()))  # pyrefly: ignore
            elif b"\r" in begins and b"\n" not in begins:  # as spreadsheets wrote on old Macs
                yield io.BufferedReader(io.BytesIO(file.read().replace(b"\r", b"\n")))  # pyrefly: ignore
            else:
                if begins.startswith(codecs.BOM_UTF8):
                    file.read(len(codecs.BOM_UTF8))
                yield file
    except (OSError, EOFError, zlib.error) as error:
        raise TableError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}).") from error
    except UnicodeDecodeError as error:
        raise TableError(f"{path}: is no table of text.") from error


def beginning(path: Path) -> bytes:
    """The bytes in which a header must end, whole lines of them.

    Raises:
        TableError: for a file that cannot be read, an empty one, and one that is no text.
    """
    return _start(path)[0]


def _start(path: Path) -> tuple[bytes, bool]:
    with open_text(path) as file:
        start = file.read(_HEAD)
        is_whole = not file.peek(1)
    if not start.strip():
        raise TableError(f"{path}: is empty.")
    if b"\0" in start:
        raise TableError(f"{path}: is no table of text.")
    return (start if is_whole else start[: start.rfind(b"\n") + 1]), is_whole


def _beginning(path: Path) -> tuple[str, bool, tuple[str, ...]]:
    """The text at the beginning, whether it is all, and a note where it is not in UTF-8."""
    start, is_whole = _start(path)
    try:
        return start.decode(), is_whole, ()
    except UnicodeDecodeError:
        note = f"{path}: is not in UTF-8 and was read as Windows-1252; see that its units are right."
        return start.decode("cp1252", errors="replace"), is_whole, (note,)


def _layout(path: Path, lines: list[str], separator: str | None) -> Layout:
    """The layout of a text.

    Raises:
        TableError: where no line names columns.
    """
    first, in_data = len(lines), True
    for number, line in enumerate(map(str.strip, lines)):
        if named := _NAMED_SEPARATOR.fullmatch(line):
            separator = separator or named[1]
        elif _PART.fullmatch(line):
            in_data = line == "[Data]"
        elif in_data and not _NO_ROWS.match(line.encode()):
            first = number
            break
    if first == len(lines):
        raise TableError(f"{path}: has no line that names columns{'' if in_data else ', for [Data] is missing'}.")
    if separator is None:
        # A heading in quotes may go over several lines.
        quotes = itertools.accumulate(line.count('"') for line in lines[first:])
        end = first + 1 + next((i for i, count in enumerate(quotes) if count % 2 == 0), 0)
        # Headings between tabs or semicolons may have commas: "diameter, um".
        unquoted = re.sub(r'"[^"]*"', "", "".join(lines[first:end]))
        separator = next((mark for mark in _SEPARATORS if mark in unquoted), "" if '"' in lines[first] else " ")
        following = next((line for line in lines[end:] if not _NO_ROWS.match(line.encode())), "")
        if separator in ("", " ") and re.match(r"[^\d\t;,]*[\t;,]", following):
            raise TableError(f"{path}: line {first + 1} is no header, but a title above one; begin it with #.")
        if separator in ("", " ") and (separator == "" or len(following.split()) != len(lines[first].split())):
            separator = ";"  # one column, whose headings may have spaces, and whose decimals may have commas
    rows = csv.reader(lines[first:], delimiter=separator, skipinitialspace=True)
    try:
        headings = tuple(lines[first].split()) if separator == " " else tuple(next(rows))
    except csv.Error as error:
        raise TableError(f"{path}: cannot be read as a table of text ({error}).") from error
    end = first + (1 if separator == " " else rows.line_num)
    if any(_is_number(heading.strip(), ".") for heading in headings):
        raise TableError(
            f"{path}: line {first + 1} must name the columns, but is {briefly(lines[first].strip())}; what begins with "
            "# or % is a comment, not a header."
        )
    below = next((n for n, line in enumerate(lines[end:], end) if not _NO_ROWS.match(line.encode())), None)
    cells = [] if below is None else _cells(lines[below], separator)
    if len(headings) == 1 < len(cells):
        raise TableError(f"{path}: line {first + 1} is no header, but a title above one; begin it with #.")
    if below is not None and (units := unit_row(headings, cells)):
        return Layout(below + 1, headings, separator, units)
    return Layout(end, headings, separator)


def _cells(text: str, separator: str) -> list[str]:
    if separator == " ":
        return text.split()
    return next(csv.reader([text.rstrip("\r\n")], delimiter=separator, skipinitialspace=True), [])


def _is_number(cell: str, decimal: str) -> bool:
    try:
        return "_" not in cell and (decimal == "." or "." not in cell) and float(cell.replace(decimal, ".")) is not None
    except ValueError:
        return False


def _distinct(headings: Iterable[str]) -> list[str]:
    """The headings, each once, as pyarrow wants them; the first of equal ones keeps its name."""
    seen = set[str]()
    fresh = map("\0{}".format, itertools.count())
    return [next(fresh) if heading in seen else (seen.add(heading) or heading) for heading in headings]


def cut_off(path: Path) -> tuple[str, ...]:
    """A sentence where a text, not compressed, does not end with the end of a line."""
    if path.suffix == ".gz":
        return ()
    with path.open("rb") as file:
        file.seek(-1, io.SEEK_END)
        has_end = file.read(1) in (b"\n", b"\r", b"\0")
    return () if has_end else (f"{path.name} does not end with the end of a line; is it there to its end?",)
