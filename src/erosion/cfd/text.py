"""Tables of numbers between spaces and parentheses, as OpenFOAM and Fluent write them."""

import codecs
import contextlib
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.impacts import ImpactsError
from erosion.extras import library

_CHUNK = 1 << 22  # bytes that are read and parsed at once
_HEAD = 1 << 16  # bytes in which a header must end
_SPACES = bytes.maketrans(b"\t\r", b"  ")


@contextlib.contextmanager
def open_table(path: Path) -> Iterator[io.BufferedIOBase]:
    """The file for reading within, decompressed where its name ends in ".gz".

    Raises:
        ImpactsError: where it cannot be opened or read.
    """
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as file:
            yield file
    except (OSError, EOFError, zlib.error) as error:
        raise ImpactsError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}).") from error


def beginning(path: Path) -> bytes:
    """The bytes in which a header must end.

    Raises:
        ImpactsError: for a file that cannot be read, an empty one, and one that is no text.
    """
    with open_table(path) as file:
        start = file.read(_HEAD).removeprefix(codecs.BOM_UTF8)
    if not start.strip():
        raise ImpactsError(f"{path}: is empty.")
    if b"\0" in start:
        raise ImpactsError(f"{path}: is no table of text.")
    return start


def head(path: Path) -> list[str]:
    """The first lines of a file, complete ones; errors as of `beginning`."""
    start = beginning(path)
    try:
        lines = (start if len(start) < _HEAD else start[: start.rfind(b"\n") + 1]).decode().splitlines()
    except UnicodeDecodeError:
        lines = []
    if not lines:
        raise ImpactsError(f"{path}: is no table of text.")
    return lines


def header_names(path: Path, line: str) -> tuple[str, ...]:
    """The columns that a header of OpenFOAM or Fluent names.

    Raises:
        ImpactsError: where it repeats one.
    """
    names = tuple(re.sub(r"[#()]", " ", line).split())
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ImpactsError(f"{path}: the header repeats {', '.join(repeated)}.")
    return names


def batches(path: Path, skipped: int, names: Sequence[str], wanted: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
    """The numbers of some columns, some thousand rows at a time.

    Args:
        path: of the file.
        skipped: lines before the first row.
        names: of all columns.
        wanted: of those that are read.

    Raises:
        ImpactsError: naming the first row that has another number of fields, or a field that is no number.
    """
    csv, arrow = library("pyarrow.csv", "cfd"), library("pyarrow", "cfd")
    with open_table(path) as file:
        for _ in range(skipped):
            file.readline()
        try:
            reader = csv.open_csv(
                arrow.PythonFile(_Plain(file), mode="r"),
                csv.ReadOptions(column_names=list(names), block_size=_CHUNK),
                csv.ParseOptions(delimiter=" ", quote_char=False),
                csv.ConvertOptions(
                    include_columns=list(wanted),
                    column_types=dict.fromkeys(wanted, arrow.float64()),
                    null_values=[],
                ),
            )
            for batch in reader:
                yield {
                    name: column.to_numpy(zero_copy_only=False)
                    for name, column in zip(wanted, batch.columns, strict=True)
                }
        except arrow.ArrowInvalid as error:
            # A file without rows is one, too: pyarrow takes it for an error.
            if (message := _first_wrong_row(path, skipped, names, wanted)) is not None:
                raise ImpactsError(f"{path}: {message}.") from error


class _Plain(io.RawIOBase):
    """The file without its parentheses, with one space between fields, for pyarrow's parser."""

    def __init__(self, file: io.BufferedIOBase):
        self._file = file
        self._rest = b""

    def readable(self) -> bool:
        """Yes."""
        return True

    def read(self, size: int = -1, /) -> bytes:
        """Some lines, at most `size` bytes of them."""
        while not self._rest:
            lines = self._file.read(_CHUNK)
            if not lines:
                return b""
            self._rest = plain(lines + self._file.readline())
        size = len(self._rest) if size is None or size < 0 else size
        part, self._rest = self._rest[:size], self._rest[size:]
        return part


def plain(lines: bytes) -> bytes:
    """Complete lines without parentheses, with one space between fields."""
    lines = lines.translate(_SPACES, b"()")
    if b"  " in lines:
        lines = re.sub(rb" {2,}", b" ", lines)
    return lines.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


def _first_wrong_row(path: Path, skipped: int, names: Sequence[str], wanted: Sequence[str]) -> str | None:
    """What is wrong with the first row that pyarrow refuses; None for a file without rows."""
    row = 0
    with open_table(path) as file:
        for number, line in enumerate(file):
            fields = plain(line).split()
            if number < skipped or not fields:
                continue
            row += 1
            if len(fields) != len(names):
                return f"row {row:,} has {len(fields)} fields, but the header names {len(names)}"
            for name in wanted:
                field = fields[names.index(name)].decode(errors="replace")
                if not _is_number(field):
                    return f"row {row:,}: column `{name}` must be a number, but is {field[:40]!r}"
    return None if row == 0 else "cannot be read"


def _is_number(text: Any) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
