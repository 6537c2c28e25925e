"""Tables of impacts with named columns: CSV and Parquet of post-processors."""

import contextlib
import csv
import dataclasses
import io
import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    ImpactBlock,
    Impacts,
    ImpactsError,
    beginning,
    blocks,
    digest_of,
    first_wrong_field,
    open_table,
    require_columns,
    require_rows,
    weigh,
)
from erosion.extras import library
from erosion.parameters.headings import (
    ANGLE_WORDS,
    ANGLES,
    MASS_WORDS,
    MASSES,
    NO_UNIT,
    RATE_WORDS,
    SIZE_WORDS,
    SPEED_WORDS,
    SPEEDS,
    WEIGHT_WORDS,
    HeaderError,
    Known,
    factor,
    matching,
    read_heads,
    unused_note,
)
from erosion.parameters.materials import HEAVIEST, LIGHTEST
from erosion.parameters.units import about

TABLE_SUFFIXES = (".csv", ".parquet")
_BLOCK = 1 << 22  # bytes of text, or 32 of a row of numbers, that are read at once
_NUMBERED = 10  # rows whose weights are 1, 2, 3, …, from which on these are the numbers of the rows
_SAME = 1.1  # ratio of densities of one solid
_PART = re.compile(r"\[\w+\]")
"""The line with which CFD-Post begins a part of a file."""
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_EXAMPLES: Mapping[str, str] = {
    "mass": "kg", "mass flow": "kg/s", "rate": "1/s", "density": "kg/m^3", "length": "m", "speed": "m/s",
    "angle": "deg", "angular speed": "rad/s", "time": "s",
}  # fmt: skip
_COMPONENTS = [
    ("uvw"[axis], f"velocity {'uvw'[axis]}", f"velocity[{'ijk'[axis]}]", f"v:{axis}",
     *(f"{word}{colon}{letter}" for word in ("u", "v", "vel", "velocity") for colon in ("", ":")),
     *(f"{word}{colon}{axis}" for word in ("u", "velocity") for colon in ("", ":")))
    for axis, letter in enumerate("xyz")
]  # fmt: skip
# Other names that codes and their post-processors give to the same columns. A "number" may be that of the row, and a
# "weight" a share: both are refused.
_KNOWN: Mapping[str, Known] = {
    "count": Known(
        ("1",),
        ("nparticle", "nparticles", "n particles", "number of particles", "num particles", "particle count",
         "particles per parcel", "particles in parcel", "number in parcel", "n in parcel"),
        WEIGHT_WORDS,
    ),
    "parcel_mass": Known(("mass",), ("mass of parcel", "mass per parcel", "mass in parcel"), MASS_WORDS),
    "mass_flow": Known(
        ("mass flow",), ("mass flow rate", "particle mass flow rate", "parcel mass flow rate", "mdot"), RATE_WORDS
    ),
    "frequency": Known(("rate",), ("particle frequency", "particle rate", "number flow rate"), RATE_WORDS),
    "mass": Known(("mass",), MASSES, MASS_WORDS),
    "density": Known(("density",), ("rho", "particle density", "rho p"), r"dens\w*|rho\w?|dichte"),
    "diameter": Known(("length",), ("d", "d p", "particle diameter", "diameter of particle"), SIZE_WORDS),
    "speed": Known(("speed",), SPEEDS, SPEED_WORDS),
    **{name: Known(("speed",), _COMPONENTS[axis]) for axis, name in enumerate(VELOCITY)},
    "angle": Known(("angle",), ANGLES, ANGLE_WORDS),
    "spin": Known(("angular speed",), (), r"spin\w*|omega|rotation\w*"),
    **{name: Known(("length",), (letter, f"points:{axis}", f"position[{letter}]"))
       for axis, (letter, name) in enumerate(zip("xyz", POSITION, strict=True))},
    "face": Known(("1",)), "mesh_face": Known(("1",), ("facei",)),
    "time": Known(("time",), ("flow time", "time of impact")),
    "parcel": Known(("1",), ("parcel id", "particle id", "orig id")),
    "origin": Known(("1",), ("orig proc", "orig proc id", "origin processor")),
}  # fmt: skip


class Column(NamedTuple):
    """A column of the file: number in the file × factor = number in SI units."""

    name: str
    factor: float


@dataclasses.dataclass(kw_only=True)
class NamedImpacts(Impacts):
    """A CSV or Parquet file."""

    path: Path
    columns: dict[str, Column]
    expected: float | None = None
    """The density of the particle that the user names [kg/m³], where the table has its own."""

    def identity(self) -> str:
        """See `Impacts`."""
        return digest_of([self.path], f"{self.density} {self.duration} {self.columns}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`; after the last block `warnings` has what is doubtful in its numbers."""
        first, low, high, contradictions = 0, math.inf, 0.0, 0
        wanted = [column.name for column in self.columns.values()]
        for batch in (_parquet_batches if self.path.suffix == ".parquet" else _csv_batches)(self.path, wanted):
            columns = dict[str, np.ndarray]()
            for name, (head, size) in self.columns.items():
                is_number = batch.column(head).is_valid().to_numpy(zero_copy_only=False)
                lacking = f": column `{head}` has no number."
                require_rows(self.title, first, is_number, lambda _, lacking=lacking: lacking)
                columns[name] = np.asarray(batch.column(head).to_numpy(zero_copy_only=False), float) * size
            if not first:
                self._require_weights(columns)
            for block in blocks(self.title, first, columns, rows, self.density, self.duration):
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    density = block.mass / (math.pi / 6 * block.diameter**3)
                    if "density" in columns:
                        own = columns["density"][block.first - first :][: block.rows]
                        contradictions += int((np.abs(np.log(density / own)) > math.log(_SAME)).sum())
                known = density[np.isfinite(density) & (density > 0)]
                low, high = float(known.min(initial=low)), float(known.max(initial=high))
                yield block
            first += batch.num_rows
        said = _doubtful_densities(low, high, contradictions, self.expected) if low <= high else []
        # Each once, as a table may be read again.
        self.warnings = tuple(dict.fromkeys((*self.warnings, *(f"{self.path.name}: {doubt}" for doubt in said))))
        if not first:
            raise ImpactsError(f"{self.path}: has no rows.")

    def _require_weights(self, columns: Mapping[str, np.ndarray]) -> None:
        """Refuse numbers of rows as numbers of particles."""
        count = columns.get("count", np.zeros(0))
        if len(count) >= _NUMBERED and count[0] in (0, 1) and (np.diff(count) == 1).all():
            raise ImpactsError(
                f"{self.path}: column {self.columns['count'].name!r} counts the rows, {count[0]:g}, {count[1]:g}, "
                f"{count[2]:g}, …, not the particles of a row; name it in Argument `ignore`."
            )


def open_named(path: Path, density: float | None, duration: float | None, ignore: Sequence[str] = ()) -> NamedImpacts:
    """A CSV or Parquet file, without the columns that `ignore` names.

    Raises:
        ImpactsError: for a file that cannot be read, and columns or units that cannot be used.
    """
    columns, unused, rows = _head(path, ignore)
    if density is not None and _gives_density(columns):
        own = [columns[name].name for name in ("density", "mass", "diameter") if name in columns]
        raise ImpactsError(
            f"{path}: Argument `particle_density` gives the density of the particles, but so does "
            f"{own[0]!r}{f' with {own[1]!r}' if 'density' not in columns else ''}; leave one out. "
            f"If that is none of the particles, name {own[0]!r} in Argument `ignore`."
        )
    require_columns(str(path), columns, has_density=density is not None)
    if rows == 0:
        raise ImpactsError(f"{path}: has no rows.")
    duration, warnings = weigh(str(path), columns, duration)
    return NamedImpacts(
        title=str(path),
        path=path,
        columns=columns,
        rows=rows,
        density=density,
        duration=duration,
        has_parcels="parcel" in columns,
        mesh_faces="mesh_face" in columns,
        warnings=(*warnings, f"{path.name}: {unused_note(unused)}.") if unused else warnings,
    )


def gives_density(path: Path, ignore: Sequence[str]) -> bool:
    """Whether this is a table with named columns that has the density of its particles; errors as of `open_named`."""
    return is_named(path) and _gives_density(_head(path, ignore)[0])


def _gives_density(columns: Collection[str]) -> bool:
    return "density" in columns or {"mass", "diameter"} <= set(columns)


def _doubtful_densities(low: float, high: float, contradictions: int, expected: float | None) -> list[str]:
    """What is doubtful in the densities of a table, from least to greatest [kg/m³].

    Args:
        low: the least, by masses and diameters.
        high: the greatest.
        contradictions: rows whose own density is another.
        expected: the density of the particle that the user names.
    """
    between = f"{low:.4g} kg/m³" if high < _SAME * low else f"{low:.4g} to {high:.4g} kg/m³"
    has = f"its particles have a density of {between},"
    sentences = {
        f"{has} less than any grain; is it a fluid's?": low < LIGHTEST,
        f"{has} more than any solid; if a mass is that of all particles of a row, its column must be named "
        "`parcel_mass`.": high > HEAVIEST,
        f"in {contradictions:,} rows the density is not that of mass and diameter, which count.":
            contradictions,
        f"{has} which counts, but the particle that is named has {expected or 0:g} kg/m³.":
            expected is not None and (low * _SAME < expected or high > _SAME * expected),
    }  # fmt: skip
    return [sentence for sentence, is_so in sentences.items() if is_so]


def is_named(path: Path) -> bool:
    """Whether the name is one of a CSV file, compressed or not, or a Parquet file."""
    return path.suffix in TABLE_SUFFIXES or path.name.endswith(".csv.gz")


def _head(path: Path, ignore: Sequence[str]) -> tuple[dict[str, Column], tuple[str, ...], int | None]:
    """The columns that are used, by name, the heads of those that are left out, and the number of rows if known."""
    if path.suffix == ".parquet":
        heads, units, rows = _parquet_head(path)
    else:
        heads, units, rows = _csv_header(path)[1], {}, None
    try:
        table = read_heads(heads, _known(heads), ignore=ignore, units=units, also=("mass flux",))
    except HeaderError as error:
        at = "" if error.index is None else f" column {heads[error.index]!r}"
        raise ImpactsError(f"{path}:{at} {error}.") from error
    columns = {
        column.name: Column(head, _factor(path, head, column.name, column.unit))
        for head, column in zip(heads, table.columns, strict=True)
        if column is not None
    }
    if {"face", "mesh_face"} <= columns.keys():
        raise ImpactsError(f"{path}: has both columns `face` and `mesh_face`; keep one.")
    # The velocity and the surface give both better.
    doubled = [columns.pop(name).name for name in ("speed", "angle") if {name, VELOCITY[0]} <= columns.keys()]
    return columns, (*table.unused, *doubled), rows


def _known(heads: Sequence[str]) -> Mapping[str, Known]:
    """What is known, where "v" is the speed unless it stands beside u or w."""
    if any(matching(heads, {"u": Known(("speed",)), "w": Known(("speed",))})):
        return _KNOWN
    second = _KNOWN[VELOCITY[1]]
    return {
        **_KNOWN,
        VELOCITY[1]: second._replace(names=[name for name in second.names if name != "v"]),
        "speed": _KNOWN["speed"]._replace(names=(*SPEEDS, "v")),
    }


def _factor(path: Path, head: str, name: str, unit: str) -> float:
    (dimension,) = _KNOWN[name].dimensions
    if dimension == "1":
        if unit in NO_UNIT:
            return 1.0
        raise ImpactsError(f"{path}: column {head!r} must be a pure number, but has the unit {unit!r}.")
    if not unit:
        raise ImpactsError(
            f"{path}: column {head!r} must carry its unit in brackets, as `{head.strip()} [{_EXAMPLES[dimension]}]`."
        )
    with about(f"{path}: the unit of column {head!r}", ImpactsError):
        return factor(unit, dimension, "si")


def _csv_header(path: Path) -> tuple[int, list[str]]:
    """How many lines stand before the header, and its cells.

    Empty lines, comments (#) and what CFD-Post writes before "[Data]" stand before it.
    """
    lines = beginning(path).decode(errors="replace").splitlines(keepends=True)
    first, in_data = len(lines), True
    for number, line in enumerate(map(str.strip, lines)):
        if _PART.fullmatch(line):
            in_data = line == "[Data]"
        elif in_data and not re.match(r'"?\s*#|$', line):
            first = number
            break
    if first == len(lines):
        raise ImpactsError(f"{path}: has no line that names columns{'' if in_data else ', for [Data] is missing'}.")
    try:
        heads = next(csv.reader(io.StringIO("".join(lines[first:]), newline="")))
    except csv.Error as error:
        raise ImpactsError(f"{path}: is no CSV file ({error}).") from error
    if len(heads) == 1 and (";" in heads[0] or "\t" in heads[0]):
        raise ImpactsError(f"{path}: must have commas between its columns, and points in its numbers.")
    if first and all(_NUMBER.fullmatch(head.strip()) for head in heads):
        raise ImpactsError(
            f"{path}: line {first + 1} must name the columns, but is {lines[first].strip()[:60]!r}; what begins with # "
            "is a comment, not a header."
        )
    return first, heads


def _csv_batches(path: Path, wanted: Sequence[str]) -> Iterator[Any]:
    """Some rows at a time; comments among them are left out."""
    arrow, reader = library("pyarrow", "cfd"), library("pyarrow.csv", "cfd")
    first, heads = _csv_header(path)
    begins = [heads[0]] if heads[0] not in wanted and heads.count(heads[0]) == 1 else []
    wrong: list[Any] = []

    def refuse(row: Any) -> str:
        if row.text.lstrip(' "').startswith("#"):
            return "skip"
        wrong.append(row)
        return "error"

    with open_table(path) as file:
        try:
            batches = reader.open_csv(
                arrow.PythonFile(file, mode="r"),
                reader.ReadOptions(column_names=heads, skip_rows=first + 1, block_size=_BLOCK),
                reader.ParseOptions(invalid_row_handler=refuse, newlines_in_values=False),
                reader.ConvertOptions(
                    include_columns=[*wanted, *begins],
                    column_types=dict.fromkeys(wanted, arrow.float64()) | dict.fromkeys(begins, arrow.string()),
                ),
            )
            for batch in batches:
                for name in begins:
                    if any(text and text.startswith("#") for text in batch.column(name).unique().to_pylist()):
                        raise ImpactsError(
                            f"{path}: column {name!r}: rows begin with # as comments do; take these rows away."
                        )
                yield batch
        except arrow.ArrowInvalid as error:
            if not wrong:
                with open_table(path) as text:
                    lines = (line.decode(errors="replace") for line in itertools.islice(text, first + 1, None))
                    rows = (row for row in csv.reader(lines) if not (row and row[0].lstrip(' "').startswith("#")))
                    said = first_wrong_field(rows, heads, wanted, "cannot be read as CSV")
            elif _PART.fullmatch(wrong[0].text.strip()):
                said = f"{wrong[0].text.strip()} begins another part; keep the table alone, to the line before"
            else:
                fields = f"{wrong[0].actual_columns} fields, but the header names {wrong[0].expected_columns}"
                said = f"the row {wrong[0].text[:60]!r} has {fields}"
            raise ImpactsError(f"{path}: {said}.") from error


@contextlib.contextmanager
def _open_parquet(path: Path) -> Iterator[Any]:
    arrow, parquet = library("pyarrow", "cfd"), library("pyarrow.parquet", "cfd")
    try:
        # By default pyarrow keeps all that it has read until the end.
        with parquet.ParquetFile(path, pre_buffer=False) as file:
            yield file
    except (OSError, arrow.ArrowException) as error:
        raise ImpactsError(f"{path}: cannot be read as Parquet ({str(error).splitlines()[0][:120]}).") from error


def _parquet_head(path: Path) -> tuple[list[str], dict[str, str], int]:
    """Columns, units from the columns' metadata, and the number of rows."""
    with _open_parquet(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
    units = {
        field.name: field.metadata[key].decode()
        for field in schema
        for key in (b"units", b"unit")
        if field.metadata and key in field.metadata
    }
    return schema.names, units, rows


def _parquet_batches(path: Path, wanted: Sequence[str]) -> Iterator[Any]:
    types = library("pyarrow", "cfd").types
    with _open_parquet(path) as file:
        for name in wanted:
            kind = file.schema_arrow.field(name).type
            if not (types.is_integer(kind) or types.is_floating(kind)):
                raise ImpactsError(f"{path}: column {name!r} must hold numbers, but holds {kind}.")
        yield from file.iter_batches(_BLOCK // 32, columns=list(wanted))
