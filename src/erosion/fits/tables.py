"""Files of measurements as spreadsheets write them: characters, separators, decimal commas, heads of columns."""

import array
import codecs
import csv
import difflib
import io
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from erosion.output import briefly
from erosion.parameters import Dimension, System, UnitError
from erosion.parameters.headings import (
    ANGLE_WORDS,
    ANGLES,
    MASS_WORDS,
    MASSES,
    NO_UNIT,
    SIZE_WORDS,
    SPEED_WORDS,
    SPEEDS,
    Head,
    HeaderError,
    Known,
    factor,
    head_parts,
    read_heads,
)


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


REMOVALS: Mapping[str, Sequence[Dimension]] = {
    "volume": ("volume", "volume per mass"),
    "mass_loss": ("mass", "mass per mass"),
    "erosion": ("volume", "volume per mass", "mass", "mass per mass"),
}
"""The columns that may hold the erosion, with their dimensions; `erosion [-]` has units of its own."""

_LOSS_WORDS = r"vol\w*|loss\w*|lost|wear\w*|erosion\w*|eroded|remov\w*|ratio|rate|depth|abtrag|verlust|verschlei\w*"
KNOWN: Mapping[str, Known] = {
    "angle": Known(("angle",), ANGLES, ANGLE_WORDS),
    "volume": Known(
        REMOVALS["volume"],
        ("volume loss", "wear volume", "eroded volume", "removed volume", "volume removed"),
        _LOSS_WORDS,
    ),
    "mass_loss": Known(
        REMOVALS["mass_loss"],
        ("mass loss", "weight loss", "eroded mass", "removed mass", "mass removed", "mass loss of target"),
        _LOSS_WORDS,
    ),
    "erosion": Known(
        REMOVALS["erosion"],
        ("erosion rate", "erosion ratio", "specific erosion", "erosion loss", "wear", "wear rate"),
        _LOSS_WORDS,
    ),
    "uncertainty": Known(
        REMOVALS["erosion"],
        ("standard deviation", "standard uncertainty", "std", "stdev", "std dev", "sd"),
        r"uncert\w*|std\w*|stdev|deviation|errors?|err|scatter|unsicherheit|streuung",
    ),
    "speed": Known(("speed",), (*SPEEDS, "v"), f"{SPEED_WORDS}|rpm"),
    "mass": Known(("mass",), (*MASSES, "erodent mass", "mass of erodent", "grain mass"), f"{MASS_WORDS}|{SIZE_WORDS}"),
}
_ALSO: Sequence[Dimension] = ("length", "density", "angular speed", "mass flow", "rate")
"""Conditions of a row that are the case's: sizes, densities, spins, feeds."""

_PERCENT = ("%", "percent")
SHARES = "uncertainty over erosion"
_EXAMPLES = {
    "angle": "angle [deg]", "volume": "volume [mm^3]", "mass_loss": "mass_loss [mg/g]", "erosion": "erosion [-]",
    "speed": "speed [m/s]", "mass": "mass [mg]",
}  # fmt: skip


class DataColumn(NamedTuple):
    """A column: number in the file × factor = number in the unit system; its unit, where that has no number."""

    name: str
    dimension: Dimension
    factor: float
    unit: str = ""


class Header(NamedTuple):
    """The columns of a table.

    Args:
        columns: in their order; None for one that is not used.
        unused: the heads of those, without those that were to be ignored.
    """

    columns: Sequence[DataColumn | None]
    unused: tuple[str, ...]


def read_header(cells: Sequence[str], units: System, ignore: Sequence[str] = ()) -> Header:
    """The columns of a header.

    Args:
        cells: "angle [deg]", "volume [in^3]", …
        units: the unit system to convert to.
        ignore: columns that are left out, by their names.

    Raises:
        HeaderError: for a repeated or missing column, one that is not understood, or a unit that does not fit.
    """
    heads, unused = read_heads(cells, KNOWN, ignore=ignore, also=_ALSO)
    names = ["" if head is None else head.name for head in heads]
    removals = [name for name in names if name in REMOVALS]
    if "angle" not in names:
        raise HeaderError(None, f"has no column `angle [deg]`{_instead(cells)}")
    if len(removals) != 1:
        present = f"has {' and '.join(removals)}" if removals else "has none"
        remedy = "; Argument `ignore` may name the others" if removals else ""
        raise HeaderError(None, f"must have one column of erosion ({', '.join(REMOVALS)}), but {present}{remedy}")
    at = names.index(removals[0])
    removal = _column(at, heads[at], REMOVALS[removals[0]], units)
    expected: dict[str, Sequence[Dimension]] = {name: known.dimensions for name, known in KNOWN.items()}
    expected["uncertainty"] = [removal.dimension]
    columns = [removal if i == at else head and _column(i, head, expected[head.name], units)
               for i, head in enumerate(heads)]  # fmt: skip
    return Header(columns, unused)


def _instead(cells: Sequence[str]) -> str:
    """The columns that a table has in place of the one that is looked for, as a clause."""
    listed = [cell.strip() for cell in cells if cell.strip()]
    names = {head_parts(cell)[0].lower(): cell for cell in listed}
    near = difflib.get_close_matches("angle", names, 1, 0.5) or difflib.get_close_matches("impact angle", names, 1, 0.5)
    nearest = f"; {briefly(names[near[0]])} comes nearest to it" if near else ""
    return f"; its columns are {briefly(', '.join(listed))}{nearest}"


def _column(index: int, head: Head | None, dimensions: Sequence[Dimension], units: System) -> DataColumn:
    assert head is not None
    name, unit = head.name, head.unit
    if name == "uncertainty" and unit in _PERCENT:
        return DataColumn(SHARES, "1", 0.01)
    if name in REMOVALS and unit in _PERCENT:
        raise HeaderError(index, "must not be a percentage, which may be one of the target's mass; write [mg/g]")
    if unit in NO_UNIT:
        if name == "erosion" and head.alias:
            message = "must carry its unit in brackets, as [mg/g]; `erosion [-]` is known up to a factor"
            raise HeaderError(index, message)
        if name == "erosion" or tuple(dimensions) == ("1",):
            return DataColumn(name, "1", 1.0)
        if "mass per mass" in dimensions and unit:
            return DataColumn(name, "mass per mass", 1.0)
        example = _EXAMPLES.get(name, f"{name} [mm^3]")
        raise HeaderError(index, f"`{name}` must carry its unit in brackets, as `{example}`")
    said = f"must be one of {', '.join(dimensions[:-1])} or {dimensions[-1]}, but is {briefly(unit)}"
    for dimension in dimensions:
        try:
            # "volume [1e-4 in^3]" has a number of its own.
            return DataColumn(name, dimension, factor(unit, dimension, units), "" if unit[0].isdigit() else unit)
        except UnitError as error:
            said = said if len(dimensions) > 1 else str(error).replace(repr("1 " + unit), repr(unit))
    raise HeaderError(index, f"the unit of `{name}` {said}")
