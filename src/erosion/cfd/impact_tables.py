"""Tables of impacts with named columns: CSV, Parquet and VTK of post-processors."""

import contextlib
import csv
import dataclasses
import io
import itertools
import math
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from erosion.cfd.doubts import Column, Noted
from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    ImpactBlock,
    Impacts,
    ImpactsError,
    Plain,
    beginning,
    blocks,
    cut_off,
    digest_of,
    first_wrong_field,
    kind_of,
    open_table,
    require_columns,
    require_rows,
    vtk_files,
    vtk_tables,
    weigh,
)
from erosion.extras import library
from erosion.output.tables import briefly
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
    head_parts,
    matching,
    read_heads,
    unused_note,
)
from erosion.parameters.quantities import Scale, about

_BLOCK = 1 << 22  # bytes of text, or 32 of a row of numbers, that are read at once
_NUMBERED = 10  # rows whose weights are 1, 2, 3, …, from which on these are the numbers of the rows
_PART = re.compile(r"\[\w+\]")
"""The line with which CFD-Post begins a part of a file."""
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_WITH_COMMA = re.compile(r"\(*[-+]?\d*,\d+([eE][-+]?\d+)?\)*")
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


@dataclasses.dataclass(kw_only=True)
class NamedImpacts(Impacts):
    """A CSV, Parquet or VTK file."""

    path: Path
    columns: dict[str, Column]
    beside: Column | None = None
    """Of speeds that the table has beside velocities."""
    expected: float | None = None
    """The density of the particle that the user names [kg/m³], where the table has its own."""

    def identity(self) -> str:
        """See `Impacts`."""
        blocks = vtk_files(self.path).values() if kind_of(self.path) == "vtk" else ()
        return digest_of([self.path, *blocks], f"{self.density} {self.duration} {self.columns}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`; after the last block `warnings` has what is doubtful in its numbers."""
        first, noted = 0, Noted(self.columns, self.beside)
        beside = [self.beside] if self.beside else []
        wanted = [column.name for column in self.columns.values()]
        for batch in _BATCHES[kind_of(self.path)](self.path, wanted, [column.name for column in beside]):
            columns = dict[str, np.ndarray]()
            for name, (head, size, *_) in self.columns.items():
                is_number = batch.column(head).is_valid().to_numpy(zero_copy_only=False)
                lacking = f": column `{head}` has no number."
                require_rows(self.title, first, is_number, lambda _, lacking=lacking: lacking)
                columns[name] = np.asarray(batch.column(head).to_numpy(zero_copy_only=False), float) * size
            if not first:
                self._require_weights(columns)
                for name, size, *_ in beside:
                    noted.add_speeds(columns, np.array(list(map(_number, batch.column(name).to_pylist()))) * size)
            noted.add_rows(columns)
            for block in blocks(self.title, first, columns, rows, self.density, self.duration):
                noted.add_sizes(block, columns.get("density", np.zeros(0))[block.first - first :][: block.rows])
                yield block
            first += batch.num_rows
        if not first:
            raise ImpactsError(f"{self.path}: has no rows.")
        # Each once, as a table may be read again.
        said = (f"{self.path.name}: {doubt}" for doubt in noted.doubts(self.expected))
        self.warnings = tuple(dict.fromkeys((*self.warnings, *said)))

    def _require_weights(self, columns: Mapping[str, np.ndarray]) -> None:
        """Refuse numbers of rows as numbers of particles."""
        count = columns.get("count", np.zeros(0))
        if len(count) >= _NUMBERED and count[0] in (0, 1) and (np.diff(count) == 1).all():
            raise ImpactsError(
                f"{self.path}: column {self.columns['count'].name!r} counts the rows, {count[0]:g}, {count[1]:g}, "
                f"{count[2]:g}, …, not the particles of a row; name it in Argument `ignore`."
            )


def open_named(
    path: Path,
    density: float | None,
    duration: float | None,
    ignore: Sequence[str] = (),
    meant: Mapping[str, str] | None = None,
) -> NamedImpacts:
    """A CSV, Parquet or VTK file, without the columns that `ignore` names, some of which mean what `meant` says.

    Raises:
        ImpactsError: for a file that cannot be read, and columns or units that cannot be used.
    """
    columns, unused, rows, blocks, beside = _head(path, ignore, meant)
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
    if len(blocks) > 1:
        warnings += (f"{path.name}: the points of its blocks {', '.join(blocks)} are joined.",)
    if kind_of(path) == "csv":
        warnings += cut_off(path)
    return NamedImpacts(
        title=str(path),
        path=path,
        columns=columns,
        beside=beside,
        rows=rows,
        density=density,
        duration=duration,
        has_parcels="parcel" in columns,
        mesh_faces="mesh_face" in columns,
        warnings=(*warnings, f"{path.name}: {unused_note(unused)}.") if unused else warnings,
        read_as=_in_words(columns),
        own_units={dimension: Scale(columns[name].factor, columns[name].unit)
                   for name, dimension in (("diameter", "length"), ("speed", "speed"), (VELOCITY[0], "speed"))
                   if name in columns},
    )  # fmt: skip


def _in_words(columns: Mapping[str, Column]) -> str:
    """Which columns are what, and in which units: "velocity from u, v, w in m/s, diameter from d in um as given"."""
    groups = dict[tuple[str, str], list[str]]()
    for name, column in columns.items():
        what = name[:-2] if name in (*VELOCITY, *POSITION) else name.replace("_", " ")
        unit = f" in {column.unit}{' as given' * column.is_given}" if column.unit else ""
        groups.setdefault((what, unit), []).append(head_parts(column.name)[0] or column.name.strip())
    return "; ".join(f"{what} from {', '.join(heads)}{unit}" for (what, unit), heads in groups.items())


def _number(cell: Any) -> float:
    """That of a cell of any kind, or NaN."""
    try:
        return float(cell)
    except (TypeError, ValueError):
        return math.nan


def gives_density(path: Path, ignore: Sequence[str], meant: Mapping[str, str] | None = None) -> bool:
    """Whether this is a table with named columns that has the density of its particles; errors as of `open_named`."""
    return is_named(path) and _gives_density(_head(path, ignore, meant)[0])


def _gives_density(columns: Collection[str]) -> bool:
    return "density" in columns or {"mass", "diameter"} <= set(columns)


def is_named(path: Path) -> bool:
    """Whether it is a CSV file, compressed or not, a Parquet or a VTK file."""
    return path.is_file() and kind_of(path) in _BATCHES


def read_meanings(given: str | Mapping[str, str] | None) -> dict[str, str]:
    """What columns mean, of "x,y,z=mm, d50=diameter [um]", of a TOML file with such entries, or of a mapping.

    Raises:
        ImpactsError: for what is none of these.
    """
    if given is None or isinstance(given, Mapping):
        return dict(given or {})
    if given.endswith(".toml"):
        try:
            meant = tomllib.loads(Path(given).read_text())
        except (OSError, ValueError) as error:
            raise ImpactsError(f"{given}: cannot be read as TOML ({error}).") from error
        if wrong := next((head for head, text in meant.items() if not isinstance(text, str)), None):
            raise ImpactsError(f'{given}: {wrong!r} must be a text such as "mm".')
        return meant
    meant, heads = {}, list[str]()
    for entry in given.split(","):
        head, equals, text = (part.strip() for part in entry.partition("="))
        heads.append(head)
        if equals:
            meant |= dict.fromkeys(heads, text)
            heads = []
    if heads or not all(meant) or not all(meant.values()):
        raise ImpactsError(
            f'Argument `columns` must be such as "x,y,z=mm, d50=diameter [um]", but is {briefly(given)}.'
        )
    return meant


def _explained(path: Path, heads: Sequence[str], meant: Mapping[str, str]) -> list[str]:
    """The heads of a table with the units or the names that a user gives them."""
    explained = list(heads)
    for name, text in meant.items():
        # "U" is all of U:0, U:1 and U:2.
        at = [i for i, head in enumerate(heads) if name in (head.strip(), re.sub(r":\d$", "", head.strip()))]
        if not at:
            known = briefly(", ".join(head.strip() for head in heads))
            raise ImpactsError(f"{path}: has no column {name!r}, which Argument `columns` names; it has {known}.")
        if not text.endswith("]") and head_parts(name)[1]:
            raise ImpactsError(f"{path}: column {name!r} has its unit, so Argument `columns` must not give it another.")
        for i in at:
            explained[i] = text if text.endswith("]") else f"{heads[i].strip()} [{text}]"
    return explained


class _Head(NamedTuple):
    """Columns that are used, by name, the heads of others, the number of rows if known, blocks, and speeds besides."""

    columns: dict[str, Column]
    unused: tuple[str, ...]
    rows: int | None
    blocks: tuple[str, ...]
    beside: Column | None


def _head(path: Path, ignore: Sequence[str], meant: Mapping[str, str] | None) -> _Head:
    blocks: tuple[str, ...] = ()
    if (kind := kind_of(path)) == "parquet":
        heads, units, rows = _parquet_head(path)
    elif kind == "vtk":
        tables = vtk_tables(path)
        blocks, heads, units = (*tables,), tables[next(iter(tables))].column_names, {}
        rows = sum(table.num_rows for table in tables.values())
    else:
        heads, units, rows = _csv_header(path).heads, {}, None
    texts = _explained(path, heads, meant or {})
    try:
        table = read_heads(texts, _known(texts), ignore=ignore, units=units, also=("mass flux",))
    except HeaderError as error:
        at = "" if error.index is None else f" column {heads[error.index]!r}"
        raise ImpactsError(f"{path}:{at} {error}.") from error
    columns = dict[str, Column]()
    for head, text, column in zip(heads, texts, table.columns, strict=True):
        if column is not None:
            own, other = (
                _factor(path, head, column.name, unit) for unit in (column.unit, units.get(head, column.unit))
            )
            if own != other and not math.isnan(other):
                raise ImpactsError(f"{path}: column {head!r} has another unit in its metadata, {units[head]!r}.")
            columns[column.name] = Column(head, own, column.unit, text != head)
    _require_units(path, columns)
    if {"face", "mesh_face"} <= columns.keys():
        raise ImpactsError(f"{path}: has both columns `face` and `mesh_face`; keep one.")
    # The velocity and the surface give both better.
    doubled = {name: columns.pop(name) for name in ("speed", "angle") if {name, VELOCITY[0]} <= columns.keys()}
    unused = (*table.unused, *(column.name for column in doubled.values()))
    return _Head(columns, unused, rows, blocks, doubled.get("speed"))


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


def _require_units(path: Path, columns: Mapping[str, Column]) -> None:
    """Refuse all columns at once that lack their units, each with one as an example."""
    lacking = dict[str, list[str]]()
    for name, column in columns.items():
        if math.isnan(column.factor):
            lacking.setdefault(_EXAMPLES[_KNOWN[name].dimensions[0]], []).append(column.name.strip())
    if lacking:
        unit, (first, *_) = next(iter(lacking.items()))
        named = ", ".join(repr(head) for heads in lacking.values() for head in heads)
        meant = ", ".join(f"{','.join(heads)}={unit}" for unit, heads in lacking.items())
        raise ImpactsError(
            f'{path}: {named} must have a unit, as `{first} [{unit}]`, or from Argument `columns`, such as "{meant}".'
        )


def _factor(path: Path, head: str, name: str, unit: str) -> float:
    (dimension,) = _KNOWN[name].dimensions
    if dimension == "1":
        if unit in NO_UNIT:
            return 1.0
        raise ImpactsError(f"{path}: column {head!r} must be a pure number, but has the unit {unit!r}.")
    if not unit:
        return math.nan
    with about(f"{path}: the unit of column {head!r}", ImpactsError):
        return factor(unit, dimension, "si")


_HEAD = re.compile(r'\s*"?(?!nan|inf)[a-zA-Zµ°%\[(]')


class _Layout(NamedTuple):
    """How a table of text is laid out: the lines before its header, the header's cells, and its punctuation."""

    first: int
    heads: list[str]
    delimiter: str
    decimal: str


def _csv_header(path: Path) -> _Layout:
    """The layout of a table of text.

    Empty lines, comments (#) and what CFD-Post writes before "[Data]" stand before it.
    """
    start = beginning(path)
    try:
        text = start.decode()
    except UnicodeDecodeError:
        text = start.decode("cp1252", errors="replace")  # as spreadsheets on Windows write "µm"
    lines = io.StringIO(text, newline="").readlines()  # `splitlines` also ends a line at a form feed
    first, in_data = len(lines), True
    for number, line in enumerate(map(str.strip, lines)):
        if _PART.fullmatch(line):
            in_data = line == "[Data]"
        elif in_data and not re.match(r'"?\s*#|$', line):
            first = number
            break
    if first == len(lines):
        raise ImpactsError(f"{path}: has no line that names columns{'' if in_data else ', for [Data] is missing'}.")
    # Headings between tabs or semicolons may have commas: "diameter, um".
    unquoted = re.sub(r'"[^"]*"', "", lines[first])
    delimiter = next((mark for mark in "\t;," if mark in unquoted), " ")
    try:
        text = io.StringIO("".join(lines[first:]), newline="")
        heads = lines[first].split() if delimiter == " " else next(csv.reader(text, delimiter=delimiter))
    except csv.Error as error:
        raise ImpactsError(f"{path}: is no CSV file ({error}).") from error
    rows = [line for line in lines[first + 1 :] if not line.lstrip(' "').startswith("#")]
    cells = {cell.strip(' "\r\n') for line in rows for cell in line.split(None if delimiter == " " else delimiter)}
    decimal = "," if delimiter != "," and any(map(_WITH_COMMA.fullmatch, cells)) else "."
    if decimal == "," and any("." in cell and _NUMBER.fullmatch(cell) for cell in cells):
        raise ImpactsError(f"{path}: has numbers with points and with commas; one of them must go.")
    if first and all(_NUMBER.fullmatch(head.strip()) for head in heads):
        raise ImpactsError(
            f"{path}: line {first + 1} must name the columns, but is {lines[first].strip()[:60]!r}; what begins with # "
            "is a comment, not a header."
        )
    second = lines[first + 1].split(None if delimiter == " " else delimiter) if first + 1 < len(lines) else []
    if len(second) == len(heads) > 1 and all(map(_HEAD.match, second)):
        raise ImpactsError(
            f"{path}: line {first + 2} is a second line of heads, {lines[first + 1].strip()[:40]!r}; write units into "
            f"the first, as `{heads[0].strip()} [{second[0].strip()}]`, and take this line away."
        )
    return _Layout(first, heads, delimiter, decimal)


def _csv_batches(path: Path, wanted: Sequence[str], beside: Sequence[str]) -> Iterator[Any]:
    """Some rows at a time; comments among them are left out, and columns beside those that are wanted are texts."""
    arrow, reader = library("pyarrow", "cfd"), library("pyarrow.csv", "cfd")
    first, heads, delimiter, decimal = _csv_header(path)
    begins = [heads[0]] if heads[0] not in wanted and heads.count(heads[0]) == 1 else []
    texts, wrong = dict.fromkeys(beside, arrow.binary()) | dict.fromkeys(begins, arrow.binary()), list[Any]()

    def refuse(row: Any) -> str:
        if row.text.lstrip(' "').startswith("#"):
            return "skip"
        wrong.append(row)
        return "error"

    with open_table(path) as file:
        try:
            batches = reader.open_csv(
                arrow.PythonFile(Plain(file) if delimiter == " " else file, mode="r"),
                reader.ReadOptions(column_names=heads, skip_rows=first + 1, block_size=_BLOCK),
                reader.ParseOptions(delimiter=delimiter, invalid_row_handler=refuse, newlines_in_values=False),
                reader.ConvertOptions(
                    include_columns=[*wanted, *texts],
                    decimal_point=decimal,
                    column_types=dict.fromkeys(wanted, arrow.float64()) | texts,
                ),
            )
            for batch in batches:
                for name in begins:
                    if any(text and text.startswith(b"#") for text in batch.column(name).unique().to_pylist()):
                        raise ImpactsError(
                            f"{path}: column {name!r}: rows begin with # as comments do; take these rows away."
                        )
                for name in beside:
                    with_points = library("pyarrow.compute", "cfd").replace_substring(batch.column(name), decimal, ".")
                    batch = batch.set_column(batch.schema.get_field_index(name), name, with_points)
                yield batch
        except arrow.ArrowInvalid as error:
            if not wrong:
                with open_table(path) as text:
                    lines = (line.decode(errors="replace") for line in itertools.islice(text, first + 1, None))
                    plain = csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter == " ")
                    points = ([field.replace(decimal, ".") for field in row] for row in plain)
                    rows = (row for row in points if not (row and row[0].lstrip(' "').startswith("#")))
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
        field.name: field.metadata[key].decode(errors="replace")
        for field in schema
        for key in (b"units", b"unit")
        if field.metadata and key in field.metadata
    }
    return schema.names, units, rows


def _require_numbers(path: Path, schema: Any, wanted: Sequence[str]) -> None:
    types = library("pyarrow", "cfd").types
    for name in wanted:
        kind = schema.field(name).type
        if not (types.is_integer(kind) or types.is_floating(kind)):
            raise ImpactsError(f"{path}: column {name!r} must hold numbers, but holds {kind}.")


def _parquet_batches(path: Path, wanted: Sequence[str], beside: Sequence[str]) -> Iterator[Any]:
    with _open_parquet(path) as file:
        _require_numbers(path, file.schema_arrow, wanted)
        yield from file.iter_batches(_BLOCK // 32, columns=[*wanted, *beside])


def _vtk_batches(path: Path, wanted: Sequence[str], beside: Sequence[str]) -> Iterator[Any]:
    for table in vtk_tables(path).values():
        _require_numbers(path, table.schema, wanted)
        yield from table.select([*wanted, *beside]).to_batches(_BLOCK // 32)


_BATCHES: Mapping[str, Callable[[Path, Sequence[str], Sequence[str]], Iterator[Any]]] = {
    "csv": _csv_batches, "parquet": _parquet_batches, "vtk": _vtk_batches,
}  # fmt: skip
