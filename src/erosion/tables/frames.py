"""Tables in files of numbers, and in objects: Parquet, Feather, Excel, pandas, xarray, and mappings of columns."""

import contextlib
import datetime as dt
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet

from erosion.arguments import real_numbers, unit_of_labels
from erosion.extras import library
from erosion.output.files import require_finite
from erosion.tables.headings import heading_parts, unit_row
from erosion.tables.source import BLOCK_BYTES, Numbers, Source, TableError
from erosion.tables.text import MISSING, TextTable, open_text

_ROWS = BLOCK_BYTES // 32


class ArrowTable(Source):
    """A Parquet or Feather file, whose columns may have units in their metadata.

    Args:
        path: of the file.
        kind: words for its format.
        opened: opens it, and closes it after use; gives its schema, its rows, and batches of columns.
    """

    def __init__(self, path: Path, kind: str, opened: Callable[[Path], Any]) -> None:
        self.title, self._path, self._kind, self._opened = str(path), path, kind, opened
        with self._open() as (schema, rows, _):
            self._schema, self.rows = schema, rows
        self.headings = tuple(schema.names)
        self.units = {
            field.name: field.metadata[key].decode(errors="replace")
            for field in schema
            for key in (b"units", b"unit")
            if field.metadata and key in field.metadata
        }

    def check(self, headings: Sequence[str]) -> None:
        """See `Source`."""
        for name in headings:
            kind = self._schema.field(name).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
                raise TableError(f"{self.title}: column {name!r} must hold numbers, but holds {kind}.")

    def blocks(self, headings: Sequence[str]) -> Iterator[Numbers]:
        """See `Source`."""
        with self._open() as (_, _, batches):
            for batch in batches(list(headings)):
                yield {name: np.asarray(batch.column(name).to_numpy(zero_copy_only=False), float) for name in headings}

    @contextlib.contextmanager
    def _open(self) -> Iterator[Any]:
        try:
            with self._opened(self._path) as file:
                yield file
        except (OSError, pa.ArrowException) as error:
            reason = str(error).splitlines()[0][:120]
            raise TableError(f"{self.title}: cannot be read as {self._kind} ({reason}).") from error


@contextlib.contextmanager
def _parquet(path: Path) -> Iterator[Any]:
    # By default pyarrow keeps all that it has read until the end.
    with pyarrow.parquet.ParquetFile(path, pre_buffer=False) as file:
        yield file.schema_arrow, file.metadata.num_rows, lambda columns: file.iter_batches(_ROWS, columns=columns)


@contextlib.contextmanager
def _feather(path: Path) -> Iterator[Any]:
    with pa.memory_map(str(path)) as file:
        table = pyarrow.ipc.open_file(file).read_all()
        yield table.schema, table.num_rows, lambda columns: table.select(columns).to_batches(_ROWS)


class ListedTable(Source):
    """Columns that are in memory.

    Args:
        title: words for it.
        columns: values by heading, each of the same length.
        units: by heading, where they are beside it.
    """

    def __init__(self, title: str, columns: Mapping[str, Any], units: Mapping[str, str]) -> None:
        self.title, self._columns, self.units = title, columns, units
        self.headings = tuple(columns)

    def place(self, row: int) -> str:
        """See `Source`."""
        return f"row {row}"

    def blocks(self, headings: Sequence[str]) -> Iterator[Numbers]:
        """See `Source`."""
        numbers = {}
        for heading in headings:
            try:
                unit = self.units.get(heading) or heading_parts(heading)[1]
                numbers[heading] = np.atleast_1d(real_numbers(heading, self._columns[heading], unit=unit))
            except ValueError as error:
                raise TableError(str(error)) from error
        shapes = {values.shape for values in numbers.values()}
        if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
            raise TableError(f"{self.title} must hold columns of one length, but has shapes {sorted(shapes)}.")
        yield numbers


class ExcelTable(ListedTable):
    """The only sheet with content of an Excel workbook."""

    def __init__(self, path: Path) -> None:
        calamine = library("python_calamine", "excel")
        try:
            book = calamine.CalamineWorkbook.from_path(path)
            sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
        except (OSError, calamine.CalamineError) as error:
            raise TableError(f"{path}: cannot be read as an Excel workbook ({error}).") from error
        filled = {name: rows for name, rows in sheets.items() if any(cell != "" for row in rows for cell in row)}
        if len(filled) != 1:
            raise TableError(
                f"{path}: must have one sheet with content, but has {', '.join(filled) or 'none'}; save one alone."
            )
        (numbered,) = ([*enumerate(rows, 1)] for rows in filled.values())
        rows = [(n, row) for n, row in numbered if any(cell != "" for cell in row) and not str(row[0]).startswith("#")]
        (_, heads), *rows = rows
        headings = [str(head) for head in heads]
        units = unit_row(headings, [str(cell) for cell in rows[0][1]]) if rows else ()
        rows = rows[bool(units) :]
        self._numbers = [number for number, _ in rows]
        columns = {head: [_cell(row[i]) for _, row in rows] for i, head in enumerate(headings) if head}
        super().__init__(str(path), columns, {h: u for h, u in zip(headings, units, strict=False) if u})

    def place(self, row: int) -> str:
        """See `Source`."""
        return f"line {self._numbers[row]:,}"

    def lines(self, rows: np.ndarray) -> np.ndarray:
        """See `Source`."""
        return np.array(self._numbers)[rows]

    def check(self, headings: Sequence[str]) -> None:
        """See `Source`: refuse texts and dates."""
        for heading in headings:
            for row, cell in enumerate(self._columns[heading]):
                if not (cell is None or (isinstance(cell, (int, float)) and not isinstance(cell, bool))):
                    raise TableError(
                        f"{self.title}, {self.place(row)}: column `{heading}` must be a number, but is {cell!r}."
                    )


def _cell(value: Any) -> Any:
    """A cell of a sheet; None where it has no number."""
    if isinstance(value, str) and value.strip() in MISSING:
        return None
    return str(value) if isinstance(value, (dt.date, dt.time, dt.timedelta)) else value


def _of_object(data: Any) -> ListedTable:
    """The columns of an object of pandas or xarray, or of a mapping."""
    if hasattr(data, "data_vars"):  # a Dataset of xarray, whose coordinates are columns, too
        data = {name: values for name, values in data.variables.items() if values.ndim <= 1}
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for key in data.keys():  # noqa: SIM118 (tables iterate rows)
        # A header of two rows, of which the second has units.
        heading = f"{key[0]} [{str(key[1]).strip('[]()')}]" if isinstance(key, tuple) and len(key) == 2 else str(key)
        columns[heading] = data[key]
        if unit := unit_of_labels(data[key]):
            units[heading] = unit
    return ListedTable("Argument `data`", columns, units)


class TableFormat(NamedTuple):
    """A format of tables beside text.

    Args:
        endings: of the names of its files.
        begins: the bytes that its files begin with.
        opened: opens a file.
    """

    endings: tuple[str, ...]
    begins: bytes
    opened: Callable[[Path], Source]


TABLE_FORMATS = (
    TableFormat((".parquet",), b"PAR1", lambda path: ArrowTable(path, "Parquet", _parquet)),
    TableFormat((".feather", ".arrow"), b"ARROW1", lambda path: ArrowTable(path, "Feather", _feather)),
    TableFormat((".xlsx", ".xlsm"), b"PK\3\4", ExcelTable),
)


def format_of(path: Path) -> TableFormat | None:
    """The format of a file by its name, or by what it begins with; None for text.

    Raises:
        TableError: for a file that cannot be read.
    """
    with open_text(path) as file:
        begins = file.read(8)
    for each in TABLE_FORMATS:
        if path.name.lower().endswith(each.endings) or (begins.startswith(each.begins) and path.suffix != ".gz"):
            return each
    return None


def open_source(source: Any, separator: str | None = None, decimal: str | None = None) -> Source:
    """A table by the name of its file, or by what it begins with; other files are text.

    Args:
        source: a path, an object of pandas or xarray, a mapping of columns by heading, or a `Source`.
        separator: of the cells of a text.
        decimal: the mark of decimals of a text.

    Raises:
        TableError: for a file that cannot be read.
    """
    if isinstance(source, Source):
        return source
    if not isinstance(source, (str, Path)):
        if not (hasattr(source, "keys") and hasattr(source, "__getitem__")):
            raise TableError(
                f"Argument `data` must be the path of a table or columns by name, but is {type(source).__name__}."
            )
        return _of_object(source)
    path = Path(source)
    require_finite(path, TableError)
    form = format_of(path)
    if form is None:
        return TextTable(path, separator, decimal)
    if separator or decimal:
        given = "sep" if separator else "decimal"
        raise TableError(f"{path}: is no table of text, so Argument `{given}` must be left out.")
    return form.opened(path)
