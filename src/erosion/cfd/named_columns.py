"""Tables whose columns have names and units, as CSV and Parquet files of post-processors do."""

import csv
import dataclasses
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.impacts import ImpactBlock, Impacts, ImpactsError, digest_of
from erosion.cfd.rows import NO_WEIGHT, POSITION, VELOCITY, blocks, require_columns
from erosion.cfd.text import beginning, open_table
from erosion.extras import library
from erosion.parameters.units import Dimension, about, header_parts, read_quantity

SUFFIXES = (".csv", ".parquet")
_BLOCK = 1 << 22  # bytes of text, or 32 of a row of numbers, that are read at once
_DIMENSIONS: Mapping[str, Dimension] = {
    "count": "1", "parcel_mass": "mass", "mass": "mass", "density": "density", "diameter": "length",
    **dict.fromkeys(VELOCITY, "speed"), "speed": "speed", "angle": "angle", "spin": "angular speed",
    **dict.fromkeys(POSITION, "length"), "face": "1", "mesh_face": "1", "time": "time",
}  # fmt: skip
_EXAMPLES: Mapping[str, str] = {
    "mass": "kg", "density": "kg/m^3", "length": "m", "speed": "m/s", "angle": "deg", "angular speed": "rad/s",
    "time": "s",
}  # fmt: skip
# Other names that codes and their post-processors give to the same columns.
_ALIASES: Mapping[str, str] = {
    "nparticle": "count", "number": "count", "weight": "count", "n_in_parcel": "count", "d": "diameter",
    "rho": "density", "alpha": "angle", "v0": "speed", "x": POSITION[0], "y": POSITION[1], "z": POSITION[2],
    "u": VELOCITY[0], "v": VELOCITY[1], "w": VELOCITY[2],
    "facei": "mesh_face",
    **{f"u{separator}{axis}": name for separator in ("", "_", ":") for number, name in enumerate(VELOCITY)
       for axis in ("xyz"[number], str(number))},
    **{f"{word}{axis}": VELOCITY[number] for word in ("v", "v_", "vel_") for number, axis in enumerate("xyz")},
    **{f"velocity{separator}{number}": name for separator in ":_" for number, name in enumerate(VELOCITY)},
    **{f"points:{number}": name for number, name in enumerate(POSITION)},
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of the file: number in the file × factor = number in SI units."""

    name: str
    factor: float


@dataclasses.dataclass
class NamedImpacts(Impacts):
    """A CSV or Parquet file."""

    path: Path
    columns: dict[str, Column]
    title: str
    rows: int | None
    density: float | None
    duration: float | None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.mesh_faces = "mesh_face" in self.columns

    def identity(self) -> str:
        """See `Impacts`."""
        return digest_of([self.path], f"{self.density} {self.duration}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`."""
        first = 0
        for batch in self._batches():
            columns = {name: self._numbers(batch, name, first) for name in self.columns}
            yield from blocks(self.title, first, columns, rows, self.density)
            first += batch.num_rows
        if not first:
            raise ImpactsError(f"{self.path}: has no rows.")

    def _numbers(self, batch: Any, name: str, first: int) -> np.ndarray:
        column = self.columns[name]
        numbers = batch.column(column.name)
        if numbers.null_count:
            row = int(np.argmax(numbers.is_null().to_numpy(zero_copy_only=False)))
            raise ImpactsError(f"{self.path}: row {first + row + 1:,}: column `{column.name}` has no number.")
        return np.asarray(numbers.to_numpy(zero_copy_only=False), float) * column.factor

    def _batches(self) -> Iterator[Any]:
        wanted = [column.name for column in self.columns.values()]
        if self.path.suffix == ".parquet":
            yield from _parquet_batches(self.path, wanted)
        else:
            yield from _csv_batches(self.path, wanted)


def open_named(path: Path, density: float | None, duration: float | None) -> NamedImpacts:
    """A CSV or Parquet file.

    Raises:
        ImpactsError: for a file that cannot be read, and columns or units that cannot be used.
    """
    if path.suffix == ".parquet":
        heads, units, rows = _parquet_head(path)
    else:
        heads, units, rows = _csv_head(path), {}, None
    columns = _columns(path, heads, units)
    require_columns(str(path), columns, has_density=density is not None)
    if rows == 0:
        raise ImpactsError(f"{path}: has no rows.")
    weighted = "count" in columns or "parcel_mass" in columns
    notes = () if weighted else (f"{path.name} {NO_WEIGHT}.",)
    return NamedImpacts(path, columns, str(path), rows, density, duration, notes)


def is_named(path: Path) -> bool:
    """Whether the name is one of a CSV file, compressed or not, or a Parquet file."""
    return path.suffix in SUFFIXES or path.name.endswith(".csv.gz")


def _columns(path: Path, heads: Sequence[str], units: Mapping[str, str]) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    for head in heads:
        name, unit = header_parts(head)
        name, unit = _ALIASES.get(name, name), unit or units.get(head, "")
        if name not in _DIMENSIONS:
            continue
        if name in columns:
            raise ImpactsError(f"{path}: the columns {columns[name].name!r} and {head!r} both give the {name}.")
        columns[name] = Column(head, _factor(path, head, name, unit))
    if {"face", "mesh_face"} <= columns.keys():
        raise ImpactsError(f"{path}: has both columns `face` and `mesh_face`; keep one.")
    return columns


def _factor(path: Path, head: str, name: str, unit: str) -> float:
    dimension = _DIMENSIONS[name]
    if dimension == "1":
        if unit in ("", "-", "–", "1"):
            return 1.0
        raise ImpactsError(f"{path}: column {head!r} must be a pure number, but has the unit {unit!r}.")
    if not unit:
        raise ImpactsError(
            f"{path}: column {head!r} must carry its unit in brackets, as `{head.strip()} [{_EXAMPLES[dimension]}]`."
        )
    with about(f"{path}: the unit of column {head!r}", ImpactsError):
        return read_quantity(unit if unit[0].isdigit() else f"1 {unit}", dimension, "si")


def _csv_head(path: Path) -> list[str]:
    text = beginning(path).decode(errors="replace")
    try:
        heads = next(csv.reader(io.StringIO(text, newline="")))
    except csv.Error as error:
        raise ImpactsError(f"{path}: is no CSV file ({error}).") from error
    if len(heads) == 1 and (";" in heads[0] or "\t" in heads[0]):
        raise ImpactsError(f"{path}: must have commas between its columns, and points in its numbers.")
    return heads


def _csv_batches(path: Path, wanted: Sequence[str]) -> Iterator[Any]:
    arrow, reader = library("pyarrow", "cfd"), library("pyarrow.csv", "cfd")
    heads = _csv_head(path)
    wrong: list[Any] = []

    def refuse(row: Any) -> str:
        wrong.append(row)
        return "error"

    with open_table(path) as file:
        try:
            batches = reader.open_csv(
                arrow.PythonFile(file, mode="r"),
                reader.ReadOptions(column_names=heads, skip_rows=1, block_size=_BLOCK),
                reader.ParseOptions(invalid_row_handler=refuse, newlines_in_values=False),
                reader.ConvertOptions(
                    include_columns=list(wanted), column_types=dict.fromkeys(wanted, arrow.float64())
                ),
            )
            yield from batches
        except arrow.ArrowInvalid as error:
            if wrong:
                row = wrong[0]
                raise ImpactsError(
                    f"{path}: the row {row.text[:60]!r} has {row.actual_columns} fields, but the header names "
                    f"{row.expected_columns}."
                ) from error
            raise ImpactsError(f"{path}: {_wrong_number(path, heads, wanted)}.") from error


def _wrong_number(path: Path, heads: Sequence[str], wanted: Sequence[str]) -> str:
    """The first field that is no number."""
    places = {heads.index(name): name for name in wanted}
    with open_table(path) as file:
        for row, fields in enumerate(csv.reader(line.decode(errors="replace") for line in file)):
            for place, name in places.items():
                try:
                    _ = float(fields[place]) if row and fields else 0.0
                except ValueError:
                    return f"row {row:,}: column `{name}` must be a number, but is {fields[place][:40]!r}"
    return "cannot be read as CSV"


def _parquet_head(path: Path) -> tuple[list[str], dict[str, str], int]:
    """Columns, units from the columns' metadata, and the number of rows."""
    arrow, parquet = library("pyarrow", "cfd"), library("pyarrow.parquet", "cfd")
    try:
        with parquet.ParquetFile(path) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
    except (OSError, arrow.ArrowException) as error:
        raise ImpactsError(f"{path}: cannot be read as Parquet ({str(error).splitlines()[0][:120]}).") from error
    units = {}
    for field in schema:
        for key in (b"units", b"unit"):
            if field.metadata and key in field.metadata:
                units[field.name] = field.metadata[key].decode()
    return schema.names, units, rows


def _parquet_batches(path: Path, wanted: Sequence[str]) -> Iterator[Any]:
    arrow, parquet = library("pyarrow", "cfd"), library("pyarrow.parquet", "cfd")
    try:
        # By default pyarrow keeps all that it has read until the end.
        with parquet.ParquetFile(path, pre_buffer=False) as file:
            for name in wanted:
                kind = file.schema_arrow.field(name).type
                if not (arrow.types.is_integer(kind) or arrow.types.is_floating(kind)):
                    raise ImpactsError(f"{path}: column {name!r} must hold numbers, but holds {kind}.")
            yield from file.iter_batches(_BLOCK // 32, columns=list(wanted))
    except (OSError, arrow.ArrowException) as error:
        raise ImpactsError(f"{path}: cannot be read as Parquet ({str(error).splitlines()[0][:120]}).") from error
