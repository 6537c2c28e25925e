"""Files of measurements as spreadsheets write them: characters, separators, decimal commas, cells without a number."""

import array
import codecs
import csv
import io
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path


class MeasurementError(ValueError):
    """Data that cannot be used; the message names the file, line and column."""


_SKIPPED = re.compile(r'\s*(?:"?\s*#|$)')  # empty, or a comment; a spreadsheet puts one with a comma into quotes


_MISSING = {"", "-", "–", "—", "--", "?", "n.a.", "n.a", "na", "n/a", "#n/a", "#nv", "nan", "nd", "n.d.", "k.a.",
            "none", "null", "missing"}  # fmt: skip
"""What stands in a cell that has no number, in small letters."""
_FROM_WINDOWS = "is not in UTF-8 and was read as Windows-1252; see that its units are right"


def text_of(path: Path) -> tuple[io.StringIO, tuple[str, ...]]:
    """The text of a file in UTF-8, UTF-16 or Windows-1252, and a note on the last."""
    content, notes = path.read_bytes(), ()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = content.decode("utf-16")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            if b"\0" in content:
                raise
            text, notes = content.decode("cp1252"), (f"{path}: {_FROM_WINDOWS}.",)
    return io.StringIO(text, newline=""), notes


def lines_of(file: Iterable[str], path: Path) -> tuple[Iterator[tuple[int, list[str]]], str]:
    """The cells of each line with the line's number, the header first, and what separates them."""
    numbered = ((i, text) for i, text in enumerate(file, start=1) if not _SKIPPED.match(text))
    first = next(numbered, None)
    if first is None:
        raise MeasurementError(f"{path}: is empty.")
    delimiter = next((mark for mark in (";", "\t") if mark in first[1]), ",")
    return _rows(itertools.chain([first], numbered), delimiter, path), delimiter


def _rows(numbered: Iterable[tuple[int, str]], delimiter: str, path: Path) -> Iterator[tuple[int, list[str]]]:
    """The cells of each line that is neither empty nor a comment, with the line's number."""
    line = 0

    def texts() -> Iterator[str]:
        nonlocal line
        for number, text in numbered:
            line = number
            yield text

    try:
        for cells in csv.reader(texts(), delimiter=delimiter, skipinitialspace=True, strict=True):
            if any(cells):
                yield line, cells
    except csv.Error as error:
        raise MeasurementError(f"{path}, line {line}: cannot be read ({error}).") from error


def numbers_of(
    rows: Iterable[tuple[int, list[str]]],
    header: Sequence[str],
    used: Sequence[int],
    delimiter: str,
    path: Path,
    lines: array.array,
) -> list[array.array]:
    """The columns of numbers that are used; the line of each row goes to `lines`."""
    columns, width, decimal_comma = [array.array("d") for _ in used], len(header), delimiter != ","
    for line, cells in rows:
        if len(cells) != width:
            place = f"{path}, line {line}, column {min(len(cells), width) + (len(cells) > width)}"
            hint = "; columns of numbers with decimal commas are separated by semicolons" if len(cells) > width else ""
            raise MeasurementError(f"{place}: there are {len(cells)} cells for {width} columns{hint}.")
        for column, index in zip(columns, used, strict=True):
            cell = cells[index]
            if cell.strip().lower() in _MISSING:
                column.append(float("nan"))
                continue
            text = cell.replace(",", ".") if decimal_comma and "." not in cell else cell
            try:
                if "_" in text:  # Python would read 1_000
                    raise ValueError
                column.append(float(text))
            except ValueError:
                hint = "" if decimal_comma or "," not in cell else " (with decimal commas, separate columns by ;)"
                raise MeasurementError(
                    f"{place_of(path, line, index, header)} must be a number, but is {cell.strip()!r}{hint}."
                ) from None
        lines.append(line)
    return columns


def place_of(path: Path, line: int, column: int | None, header: Sequence[str]) -> str:
    """Words for a place in the file; the header without a column."""
    of_line = f"{path}, line {line},"
    return f"{of_line} the header" if column is None else f"{of_line} column {column + 1} ({header[column].strip()})"
