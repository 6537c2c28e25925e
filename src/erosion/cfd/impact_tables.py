"""Tables of impacts with named columns: CSV and Parquet of post-processors, and Ansys Fluent's files `.dpm`.

A file `.dpm` begins with two lines, the surface and the columns; then one line for each parcel, the numbers in
parentheses and the name of its injection. All numbers are in SI units whatever the session shows; t is the
temperature, and `time` the age of the particle.
"""

import csv
import dataclasses
import io
import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    WEIGHTS,
    ImpactBlock,
    Impacts,
    ImpactsError,
    batches,
    beginning,
    blocks,
    digest_of,
    head,
    header_names,
    open_table,
    require_columns,
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
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Column:
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
        first, densities = 0, _Densities()
        for batch in self._batches():
            columns = {name: self._numbers(batch, name, first) for name in self.columns}
            if not first:
                self._require_weights(columns)
            for block in blocks(self.title, first, columns, rows, self.density, self.duration):
                own = columns["density"][block.first - first :][: block.rows] if "density" in columns else None
                densities.add(block, own)
                yield block
            first += batch.num_rows
        # Each once, as a table may be read again.
        self.warnings = tuple(dict.fromkeys((*self.warnings, *densities.warnings(self.path.name, self.expected))))
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
        mesh_faces="mesh_face" in columns,
        warnings=(*warnings, f"{path.name}: {unused_note(unused)}.") if unused else warnings,
    )


def gives_density(path: Path, ignore: Sequence[str]) -> bool:
    """Whether this is a table with named columns that has the density of its particles; errors as of `open_named`."""
    return is_named(path) and _gives_density(_head(path, ignore)[0])


def _gives_density(columns: Collection[str]) -> bool:
    return "density" in columns or {"mass", "diameter"} <= set(columns)


class _Densities:
    """The densities of the particles of a table, by their masses and diameters."""

    def __init__(self) -> None:
        self._least, self._greatest, self._contradictions = math.inf, 0.0, 0

    def add(self, block: ImpactBlock, own: np.ndarray | None) -> None:
        """Take note of a block; `own` are the densities that the table gives."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            density = block.mass / (math.pi / 6 * block.diameter**3)
            if own is not None:
                self._contradictions += int((np.abs(np.log(density / own)) > math.log(_SAME)).sum())
        finite = density[np.isfinite(density) & (density > 0)]
        self._least = min(self._least, float(finite.min(initial=math.inf)))
        self._greatest = max(self._greatest, float(finite.max(initial=0.0)))

    def warnings(self, table: str, expected: float | None) -> list[str]:
        """What is doubtful in them, where `expected` is the density of the particle that the user names [kg/m³]."""
        said, low, high = list[str](), self._least, self._greatest
        if low > high:
            return said
        between = f"{low:.4g} kg/m³" if high < _SAME * low else f"{low:.4g} to {high:.4g} kg/m³"
        if low < LIGHTEST:
            said.append(f"{table}: its particles have a density of {between}, less than any grain; is it a fluid's?")
        if high > HEAVIEST:
            said.append(
                f"{table}: its particles have a density of {between}, more than any solid; if a mass is that of all "
                "particles of a row, its column must be named `parcel_mass`."
            )
        if self._contradictions:
            said.append(
                f"{table}: in {self._contradictions:,} rows the density is not that of mass and diameter, which count."
            )
        if expected is not None and (low * _SAME < expected or high > _SAME * expected):
            said.append(
                f"{table}: its particles have a density of {between}, which counts, but the particle that is named "
                f"has {expected:g} kg/m³."
            )
        return said


def is_named(path: Path) -> bool:
    """Whether the name is one of a CSV file, compressed or not, or a Parquet file."""
    return path.suffix in TABLE_SUFFIXES or path.name.endswith(".csv.gz")


def _head(path: Path, ignore: Sequence[str]) -> tuple[dict[str, Column], tuple[str, ...], int | None]:
    """The columns as `_columns` has them, and the number of rows where it is known."""
    if path.suffix == ".parquet":
        heads, units, rows = _parquet_head(path)
    else:
        heads, units, rows = _csv_header(path)[1], {}, None
    return *_columns(path, heads, units, ignore), rows


def _columns(
    path: Path, heads: Sequence[str], units: Mapping[str, str], ignore: Sequence[str]
) -> tuple[dict[str, Column], tuple[str, ...]]:
    """The columns that are used, by name, and the heads of those that are left out."""
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
    return columns, (*table.unused, *doubled)


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
    first, in_data = -1, True
    for number, line in enumerate(lines):
        text = line.strip()
        if re.fullmatch(r"\[\w+\]", text):
            in_data = text == "[Data]"
        elif in_data and not re.match(r'"?\s*#|$', text):
            first = number
            break
    if first < 0:
        raise ImpactsError(f"{path}: has no line that names columns{'' if in_data else ', for [Data] is missing'}.")
    try:
        heads = next(csv.reader(io.StringIO("".join(lines[first:]), newline="")))
    except csv.Error as error:
        raise ImpactsError(f"{path}: is no CSV file ({error}).") from error
    if len(heads) == 1 and (";" in heads[0] or "\t" in heads[0]):
        raise ImpactsError(f"{path}: must have commas between its columns, and points in its numbers.")
    if first and all(_is_number(head) for head in heads):
        raise ImpactsError(
            f"{path}: line {first + 1} must name the columns, but is {lines[first].strip()[:60]!r}; what begins with # "
            "is a comment, not a header."
        )
    return first, heads


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _csv_batches(path: Path, wanted: Sequence[str]) -> Iterator[Any]:
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
            if wrong:
                row = wrong[0]
                if re.fullmatch(r"\[\w+\]", row.text.strip()):
                    raise ImpactsError(
                        f"{path}: {row.text.strip()} begins another part; keep the table alone, to the line before."
                    ) from error
                raise ImpactsError(
                    f"{path}: the row {row.text[:60]!r} has {row.actual_columns} fields, but the header names "
                    f"{row.expected_columns}."
                ) from error
            raise ImpactsError(f"{path}: {_wrong_number(path, first, heads, wanted)}.") from error


def _wrong_number(path: Path, first: int, heads: Sequence[str], wanted: Sequence[str]) -> str:
    """The first field that is no number, below a header with `first` lines before it."""
    places = {heads.index(name): name for name in wanted}
    with open_table(path) as file:
        for row, fields in enumerate(
            csv.reader(line.decode(errors="replace") for line in itertools.islice(file, first, None))
        ):
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


FLUENT_SUFFIXES = (".dpm",)
_COLUMNS = {
    **dict(zip("xyz", POSITION, strict=True)), **dict(zip("uvw", VELOCITY, strict=True)), "diameter": "diameter",
    "mass": "mass", "n-in-parcel": "count", "parcel-mass": "parcel_mass", "mass-flow": "mass_flow",
    "frequency": "frequency", "flow-time": "time",
}  # fmt: skip


@dataclasses.dataclass(kw_only=True)
class FluentImpacts(Impacts):
    """A sample of parcels at one surface.

    In a steady run a row is a stream of particles, and its `mass-flow` [kg/s] hits for the whole duration.
    """

    path: Path
    names: tuple[str, ...]
    skipped: int
    columns: dict[str, str]

    def identity(self) -> str:
        """See `Impacts`."""
        return digest_of([self.path], f"{self.duration}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`."""
        first = 0
        for columns in batches(self.path, self.skipped, self.names, self.columns):
            yield from blocks(str(self.path), first, columns, rows, duration=self.duration)
            first += len(columns["diameter"])


def open_fluent(path: Path, density: float | None, duration: float | None) -> FluentImpacts:
    """A sample of Fluent.

    Raises:
        ImpactsError: for a file without Fluent's header, or without columns that are needed.
    """
    if density is not None:
        raise ImpactsError(f"{path}: gives the mass of each particle; Argument `particle_density` must be left out.")
    lines = head(path)
    numbers = [number for number, line in enumerate(lines[:10]) if "diameter" in line and line.lstrip().startswith("(")]
    if not numbers:
        raise ImpactsError(f"{path}: has no header of Fluent, a line such as (x y z u v w diameter t … name).")
    names = header_names(path, lines[numbers[0]])
    columns = {ours: name for name, ours in _COLUMNS.items() if name in names}
    # Fluent gives the weight in several ways, which agree.
    for weight in [weight for weight in WEIGHTS if weight in columns][1:]:
        del columns[weight]
    duration, warnings = weigh(str(path), columns.keys() - {"time"}, duration)
    require_columns(str(path), columns)
    return FluentImpacts(
        title=str(path),
        path=path,
        names=names,
        skipped=numbers[0] + 1,
        columns=columns,
        duration=duration,
        warnings=warnings,
    )
