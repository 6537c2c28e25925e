"""Impacts of a CFD run in blocks of rows: from the columns of any table, with the same names and checks for all."""

import abc
import codecs
import contextlib
import dataclasses
import functools
import gzip
import hashlib
import io
import itertools
import logging
import math
import mmap
import re
import warnings
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from erosion.arguments import Indices, Numbers, Vectors
from erosion.extras import library
from erosion.output import briefly
from erosion.parameters import Scale


@dataclasses.dataclass(frozen=True)
class ImpactBlock:
    """Some consecutive rows of a table of impacts, each a parcel of equal particles, in SI units.

    A row says how fast and how steeply it hits either by `velocity`, from which the surface's normal gives the angle of
    attack, or by `speed` and `alpha`. It says where by `face`, else by `position`; a table may say neither.

    Args:
        source: the file of the rows, for messages.
        first: number of the first row in this file, from 0.
        count: particles that a row stands for, shape (rows,) [-].
        mass: of one particle, shape (rows,) [kg].
        diameter: of one particle, shape (rows,) [m].
        velocity: of the impact, before the rebound, shape (rows, 3) [m/s].
        speed: v₀, shape (rows,) [m/s].
        alpha: angle of attack, shape (rows,) [rad].
        spin: φ̇₀ as `Parameters` has it, shape (rows,) [rad/s].
        position: shape (rows, 3) [m].
        face: index among the faces of the surface, -1 where the row names none of them, shape (rows,).
        time: shape (rows,) [s].
        parcel: which parcel hits, the same number for all of its bounces, shape (rows,).
    """

    source: str
    first: int
    count: Numbers
    mass: Numbers
    diameter: Numbers
    velocity: Vectors | None = None
    speed: Numbers | None = None
    alpha: Numbers | None = None
    spin: Numbers | None = None
    position: Vectors | None = None
    face: Indices | None = None
    time: Numbers | None = None
    parcel: Indices | None = None

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.count)


@dataclasses.dataclass(kw_only=True)
class Impacts(abc.ABC):
    """A table of impacts that can be read again and again; `erosion.read_impacts` opens one.

    Attributes:
        title: file or folder, for messages and titles.
        rows: their number, None where only reading all of them tells it.
        density: of the particles [kg/m³], where no column gives it.
        duration: time that the table covers [s], None where it does not say; rates need it.
        duration_from: what says so, in words.
        injected: mass of the particles that were injected [kg], None where the run does not say it.
        has_parcels: whether rows say which parcel hits, so that bounces are known from new parcels.
        mesh_faces: whether `face` of its blocks counts the faces of the whole mesh (`Surface.face_of_mesh` leads from
            them to the surface's own).
        warnings: sentences on what the table does not say, and what is taken instead.
        read_as: how its columns are understood, in words.
        own_units: of diameters and speeds as the table has them, by "length" and "speed"; else those that read well.
    """

    title: str
    rows: int | None = None
    density: float | None = None
    duration: float | None = None
    duration_from: str = "as given"
    injected: float | None = None
    has_parcels: bool = False
    mesh_faces: bool = False
    warnings: tuple[str, ...] = ()
    read_as: str = ""
    own_units: Mapping[str, Scale] | None = None

    @abc.abstractmethod
    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """All rows in the order of the table, at most `rows` at a time.

        Raises:
            ImpactsError: a ValueError that names file and row.
        """

    @abc.abstractmethod
    def identity(self) -> str:
        """A digest of the content of all files, the same only for the same rows."""


class ImpactsError(ValueError):
    """A table of impacts or a surface that cannot be used; says which file, which row, and what to do."""


def require_rows(source: str, first: int, good: np.ndarray, what: Callable[[int], str]) -> None:
    """Refuse the first row of some that is not good.

    Args:
        source: the file, for messages.
        first: number of the first of these rows in the file, from 0.
        good: of each row.
        what: the end of the sentence for a row, by its number among these.
    """
    if not good.all():
        row = int(np.argmin(good))
        raise ImpactsError(f"{source}: row {first + row + 1:,}{what(row)}")


def digest_of(paths: Sequence[Path], more: str) -> str:
    """A digest of the content of files, in their order, and of what else the rows depend on."""
    digest = hashlib.sha256(more.encode())
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]


Columns = Mapping[str, np.ndarray]
"""Numbers in SI units by name, see `NAMES`; each shape (rows,)."""

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
POSITION = ("position_x", "position_y", "position_z")
NAMES = (
    *(WEIGHTS := ("count", "parcel_mass", "mass_flow", "frequency")), "mass", "density", "diameter", *VELOCITY, "speed",
    "angle", "spin", *POSITION, "face", "mesh_face", "cell", "processor", "time", "parcel", "origin",
)  # fmt: skip
"""Columns that a table may have. `parcel_mass` is of all particles of a row, `mass` of one of them. `origin` is the
processor that injected a parcel, which may give the number of another one's again."""

_RATES = {"mass_flow": "parcel_mass", "frequency": "count"}
"""Weights of a steady run, whose rows are streams: the mass and the number of particles that hit in 1 s."""

GREATEST = 1e20
"""Of a number in SI units, so that no product of a map overflows."""

NO_WEIGHT = "has no column of the number of particles that a row stands for, so each row counts as one particle"


def require_columns(source: str, names: Collection[str], *, has_density: bool = False) -> None:
    """Refuse a table whose columns do not make impacts.

    Args:
        source: the file, for messages.
        names: those of its columns that are in `NAMES`.
        has_density: whether the density is known from elsewhere.

    Raises:
        ImpactsError: one sentence that names what is missing.
    """
    for vector in (VELOCITY, POSITION):
        missing = [name for name in vector if name not in names]
        if missing and len(missing) < len(vector):
            raise ImpactsError(f"{source}: has no column {' and '.join(missing)}, but the others of the vector.")
    if VELOCITY[0] not in names and not {"speed", "angle"} <= set(names):
        raise ImpactsError(
            f"{source}: has no columns of the velocity (`{'`, `'.join(VELOCITY)}`), and none of `speed` and `angle`."
        )
    if "diameter" not in names and not ({"mass", "density"} <= set(names) or ("mass" in names and has_density)):
        raise ImpactsError(f"{source}: has no column `diameter`, and no columns `mass` and `density`.")
    if "mass" not in names and "density" not in names and not has_density:
        raise ImpactsError(
            f"{source}: has no column `mass` or `density` of a particle; Argument `particle_density` must give it."
        )


def weigh(source: str, names: Collection[str], duration: float | None) -> tuple[float | None, tuple[str, ...]]:
    """The duration of a table, and sentences on what it does not say of the weights of its rows.

    Args:
        source: the file, for messages.
        names: its columns, of `NAMES`.
        duration: the time that it covers [s], where it is known.

    Raises:
        ImpactsError: for two weights, and for rates beside the times of impacts.
    """
    weights, name = [weight for weight in WEIGHTS if weight in names], Path(source).name
    if not weights:
        return duration, (f"{name} {NO_WEIGHT}.",)
    if len(weights) > 1:
        raise ImpactsError(
            f"{source}: the columns {' and '.join(weights)} all give the weight of a row; keep one, and name others in "
            "Argument `ignore`."
        )
    if weights[0] not in _RATES:
        return duration, ()
    if "time" in names:
        raise ImpactsError(
            f"{source}: has the column {weights[0]}, of a steady run, but also the `time` of each impact; if this is "
            "the age of a particle, name it in Argument `ignore`."
        )
    if duration is not None:
        return duration, ()
    return 1.0, (
        f"{name} is of a steady run, so its rows are what hits in 1 s; Argument `duration` sets another time.",
    )


def blocks(
    source: str,
    first: int,
    columns: Columns,
    rows: int,
    density: float | None = None,
    duration: float | None = None,
) -> Iterator[ImpactBlock]:
    """The rows of a table whose columns `require_columns` accepts.

    Args:
        source: the file, for messages.
        first: number of the first row in the file, from 0.
        columns: see `NAMES`; one of `face` and `mesh_face` at most.
        rows: of a block, at most.
        density: of particles [kg/m³], where no column gives it.
        duration: for which streams of particles hit [s]; see `weigh`.

    Raises:
        ImpactsError: naming file, row and column of a number that is not finite or too great, or of a face that is no
            number of one.
    """
    columns = {**columns, **{weight: columns[rate] * duration for rate, weight in _RATES.items() if rate in columns}}
    for name, values in columns.items():
        require_rows(source, first, np.abs(values) <= GREATEST, functools.partial(_too_great, name, values))
    mass, diameter = _sizes(columns, density)
    count = columns.get("count")
    if count is None:
        count = columns["parcel_mass"] / mass if "parcel_mass" in columns else np.ones(len(mass))
    fields: dict[str, Any] = {"count": count, "mass": mass, "diameter": diameter}
    for name, axes in (("velocity", VELOCITY), ("position", POSITION)):
        if axes[0] in columns:
            fields[name] = np.stack([columns[axis] for axis in axes], axis=1)
    own = {"spin": "spin", "time": "time"} | ({} if "velocity" in fields else {"speed": "speed", "angle": "alpha"})
    fields |= {field: columns[name] for name, field in own.items() if name in columns}
    if name := next((name for name in ("mesh_face", "face") if name in columns), ""):
        values, fields["face"] = columns[name], columns[name].astype(np.int64)
        must = f": column `{name}` must be the number of a face, or -1 for none, but is"
        good = (fields["face"] == values) & (fields["face"] >= -1)
        require_rows(source, first, good, lambda row: f"{must} {values[row]:g}.")
    if "parcel" in columns:
        number, origin = columns["parcel"], columns.get("origin", np.zeros(len(count)))
        # Whole numbers below 2^53 are exact.
        most = 2.0**53 if "origin" not in columns else 2.0**32
        good = (number >= 0) & (number < most) & (origin >= 0) & (origin < 2.0**20) & ((number + origin) % 1 == 0)
        require_rows(source, first, good, lambda row: f": `parcel` must be a number of one, but is {number[row]:g}.")
        fields["parcel"] = (number + 2.0**32 * origin).astype(np.int64)
    for begin in range(0, len(count), rows):
        part = slice(begin, begin + rows)
        yield ImpactBlock(source, first + begin, **{name: values[part] for name, values in fields.items()})


def _too_great(name: str, values: np.ndarray, row: int) -> str:
    condition = f"at most {GREATEST:g}" if np.isfinite(values[row]) else "finite"
    return f": column `{name}` must be {condition}, but is {values[row]}."


def _sizes(columns: Columns, density: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Mass and diameter of spheres, of which two of mass, diameter and density are enough."""
    rho = np.asarray(columns.get("density", density), float)
    if "mass" not in columns:
        return rho * math.pi / 6 * columns["diameter"] ** 3, columns["diameter"]
    if "diameter" not in columns:
        return columns["mass"], np.cbrt(6 * columns["mass"] / (math.pi * rho))
    return columns["mass"], columns["diameter"]


_CHUNK = 1 << 22  # bytes that are read and parsed at once
_HEAD = 1 << 16  # bytes in which a header must end
_VERTICES = (0, 1, 2)  # VTK's numbers of no cell, of one point, and of several
_MOST_PACKED = 1000  # numbers for each byte: so much packs zlib at most
_SPACES = bytes.maketrans(b"\t\r", b" \n")


@contextlib.contextmanager
def open_table(path: Path) -> Iterator[Any]:
    """The file for reading within, decompressed where its name ends in ".gz".

    Raises:
        ImpactsError: where it cannot be opened or read.
    """
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as file:
            yield file
    except (OSError, EOFError, zlib.error) as error:
        raise ImpactsError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}).") from error


def cut_off(path: Path) -> tuple[str, ...]:
    """A sentence where a text, not compressed, does not end with the end of a line."""
    if path.suffix == ".gz":
        return ()
    with path.open("rb") as file:
        file.seek(-1, io.SEEK_END)
        has_end = file.read(1) in (b"\n", b"\r")
    return () if has_end else (f"{path.name} does not end with the end of a line; is it there to its end?",)


_SUFFIXES = {"openfoam": (".post",), "fluent": (".dpm",), "parquet": (".parquet",), "csv": (".csv",),
             "vtk": (".vtp", ".vtu", ".vtm")}  # fmt: skip
_BEGINS = {"openfoam": rb"^#\s*Time\b", "fluent": rb"^\s*\(+\s*x\s+y\s+z\b.*\bdiameter\b"}


def kind_of(path: Path) -> str:
    """Which table a file is, "openfoam", "fluent", "parquet", "csv" or "vtk": by its name, or by what it begins with.

    Raises:
        ImpactsError: as of `beginning`.
    """
    name = path.name.removesuffix(".gz").lower()
    if kind := next((kind for kind, suffixes in _SUFFIXES.items() if name.endswith(suffixes)), ""):
        return kind
    with open_table(path) as file:
        if file.read(4) == b"PAR1":
            return "parquet"
    start = beginning(path)
    return next((kind for kind, line in _BEGINS.items() if re.search(line, start, re.MULTILINE)), "csv")


def beginning(path: Path) -> bytes:
    """The bytes in which a header must end, whole lines of them.

    Raises:
        ImpactsError: for a file that cannot be read, an empty one, and one that is no text.
    """
    with open_table(path) as file:
        start = file.read(_HEAD).removeprefix(codecs.BOM_UTF8)
        is_whole = not file.peek(1)
    if not start.strip():
        raise ImpactsError(f"{path}: is empty.")
    if b"\0" in start:
        raise ImpactsError(f"{path}: is no table of text.")
    return start if is_whole else start[: start.rfind(b"\n") + 1]


def batches(
    path: Path, skipped: int, names: Sequence[str], columns: Mapping[str, str]
) -> Iterator[dict[str, np.ndarray]]:
    """The numbers of some columns, some thousand rows at a time.

    Args:
        path: of the file.
        skipped: lines before the first row.
        names: of all columns.
        columns: those that are read, by the names that they get.

    Raises:
        ImpactsError: naming the first row that has another number of fields, or a field that is no number.
    """
    csv, arrow, wanted = library("pyarrow.csv", "cfd"), library("pyarrow", "cfd"), list(columns.values())
    with open_table(path) as file:
        for _ in range(skipped):
            file.readline()
        try:
            reader = csv.open_csv(
                arrow.PythonFile(Plain(file), mode="r"),
                csv.ReadOptions(column_names=list(names), block_size=_CHUNK),
                csv.ParseOptions(delimiter=" ", quote_char=False),
                csv.ConvertOptions(
                    include_columns=wanted,
                    column_types=dict.fromkeys(wanted, arrow.float64()),
                    null_values=[],
                ),
            )
            for batch in reader:
                yield {
                    name: column.to_numpy(zero_copy_only=False)
                    for name, column in zip(columns, batch.columns, strict=True)
                }
        except arrow.ArrowInvalid as error:
            with open_table(path) as text:
                lines = (plain(line).decode(errors="replace").split() for line in itertools.islice(text, skipped, None))
                wrong = first_wrong_field(lines, names, wanted, "cannot be read")
            # A file without rows is one, too: pyarrow takes it for an error.
            if wrong is not None:
                raise ImpactsError(f"{path}: {wrong}.") from error


class Plain(io.RawIOBase):
    """The file without its parentheses, with one space between fields, for pyarrow's parser."""

    def __init__(self, file: io.BufferedIOBase):
        self._file = file
        self._rest = b""

    def readable(self) -> bool:
        """Yes."""
        return True

    def read(self, size: int = -1, /) -> bytes:
        """Some lines, at most `size` bytes of them."""
        while not self._rest and (lines := self._file.read(_CHUNK)):
            self._rest = plain(lines + self._file.readline())
        size = len(self._rest) if size is None or size < 0 else size
        part, self._rest = self._rest[:size], self._rest[size:]
        return part


def plain(lines: bytes) -> bytes:
    """Complete lines without parentheses, with one space between fields."""
    lines = lines.replace(b"\r\n", b"\n").translate(_SPACES, b"()")
    if b"  " in lines:
        lines = re.sub(rb" {2,}", b" ", lines)
    return lines.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


def first_wrong_field(
    lines: Iterable[Sequence[str]], names: Sequence[str], wanted: Sequence[str], otherwise: str
) -> str | None:
    """What is wrong with the first row that pyarrow refuses; None for a file without rows.

    Args:
        lines: the fields of all lines; empty lines are no rows.
        names: of all columns.
        wanted: of those that hold numbers.
        otherwise: what is said where no row is wrong.
    """
    row = 0
    for row, fields in enumerate(filter(None, lines), 1):
        if len(fields) != len(names):
            return f"row {row:,} has {len(fields)} fields, but the header names {len(names)}"
        for name in wanted:
            field = fields[names.index(name)]
            try:
                _ = float(field)
            except ValueError:
                return f"row {row:,}: column `{name}` must be a number, but is {field[:40]!r}"
    return otherwise if row else None


def vtk_files(path: Path) -> dict[str, Path]:
    """The files of a `.vtm` by the names of its blocks; any other file by its own.

    Raises:
        ImpactsError: for a `.vtm` that cannot be read, and where one of its files is missing.
    """
    if path.suffix.lower() != ".vtm":
        return {path.stem: path}
    try:
        named = list(_named_files(ET.parse(path).getroot(), ""))
    except (ET.ParseError, OSError) as error:
        raise ImpactsError(f"{path}: cannot be read; it is damaged, or no .vtm file.") from error
    files = {name: path.parent / file for name, file in named}
    if missing := next((file for _, file in named if not (path.parent / file).is_file()), ""):
        raise ImpactsError(f"{path}: names the file {missing!r}, which is not there.")
    if len(files) < len(named):
        raise ImpactsError(f"{path}: has two blocks of the same name.")
    return files


def _named_files(element: ET.Element, above: str) -> Iterator[tuple[str, str]]:
    for child in element:
        # The element of all blocks has no index.
        name = "/".join(filter(None, (above, child.get("name", child.get("index", "")))))
        if "file" in child.attrib:
            yield name, child.attrib["file"]
        yield from _named_files(child, name)


def vtk_blocks(path: Path) -> dict[str, Any]:
    """The data sets of the files of `vtk_files` that have points, and its errors.

    Raises:
        ImpactsError: for a file that cannot be read.
    """
    pyvista, blocks = library("pyvista", "cfd"), dict[str, Any]()
    for name, file in vtk_files(path).items():
        _require_counts(file)
        try:
            with _quiet(), pyvista.vtk_verbosity("off"):
                block = pyvista.read(file)
        except Exception as error:
            raise ImpactsError(f"{file}: cannot be read; it is damaged, or no {file.suffix} file.") from error
        if getattr(block, "n_points", 0):
            _require_no_ghosts(file, block, "cell")
            blocks[name] = block
    return blocks


def _require_no_ghosts(path: Path, block: Any, kind: str) -> None:
    """Refuse cells or points that another part of a parallel run has, too: they would count twice."""
    ghosts = np.count_nonzero(getattr(block, f"{kind}_data").get("vtkGhostType", 0))
    if ghosts:
        raise ImpactsError(
            f"{path}: {ghosts:,} of its {kind}s are ghosts, which would count twice. Python removes them: "
            f"mesh = pyvista.read({path.name!r}); mesh.extract_{kind}s(mesh.{kind}_data['vtkGhostType'] == 0)"
            f".save({path.with_suffix('.vtu').name!r})."
        )


def _require_counts(path: Path) -> None:
    """Refuse an XML file whose counts are more than it could hold: VTK makes room for as many, and ends the process."""
    size = path.stat().st_size
    if not size:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for what, count in re.findall(rb"(NumberOf\w+)\s*=\s*[\"']([^\"']*)", content):
            if not count.strip().isdigit() or int(count) > _MOST_PACKED * size:
                number = count[:20].decode("ascii", "replace")
                raise ImpactsError(
                    f"{path}: cannot be read; it is damaged: {what.decode()} is {briefly(number)} "
                    f"in a file of {size:,} bytes."
                )


def vtk_tables(path: Path) -> dict[str, Any]:
    """The points of each block of points, with their arrays as columns: "U:0", "U:1", "U:2" of a vector.

    Raises:
        ImpactsError: for points that are corners of cells, and blocks with other arrays than the first one.
    """
    arrow, tables = library("pyarrow", "cfd"), dict[str, Any]()
    for name, block in vtk_blocks(path).items():
        cells = block.cast_to_unstructured_grid()
        if not np.isin(cells.celltypes, _VERTICES).all():
            continue
        _require_no_ghosts(path, block, "point")
        arrays = [("Points", block.points), *block.point_data.items()]
        if block.cell_data.keys():
            if not np.array_equal(cells.cell_connectivity, np.arange(cells.n_points)) or cells.n_cells < cells.n_points:
                raise ImpactsError(f"{path}: has arrays of cells that are not one to each point, as {name!r} shows.")
            arrays = [*block.cell_data.items(), *arrays]
        columns = dict[str, np.ndarray]()
        for head, values in arrays:
            parts = np.asarray(values).reshape(cells.n_points, -1).T
            for i, part in enumerate(parts):
                column = f"{head}:{i}" if len(parts) > 1 else head
                if column in columns and not np.array_equal(columns[column], part):
                    raise ImpactsError(f"{path}: has the array {column!r} twice; rename or take away one of them.")
                columns[column] = part
        tables[name] = arrow.table(columns)
    if not tables:
        raise ImpactsError(f"{path}: holds no points of their own, as impacts are, but corners of cells.")
    (first, table), *others = tables.items()
    if other := next((name for name, its in others if set(its.column_names) != set(table.column_names)), ""):
        raise ImpactsError(
            f"{path}: its blocks {first!r} and {other!r} both hold points, but with other arrays; save one alone."
        )
    return tables


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Make pyvista raise what it would log and warn of, before it goes on with an empty mesh."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            yield
    finally:
        logging.disable(before)
