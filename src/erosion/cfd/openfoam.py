"""What OpenFOAM writes: patches of its meshes as surfaces, and the impacts of its cloud function objects."""

import dataclasses
import functools
import hashlib
import itertools
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    ImpactBlock,
    Impacts,
    ImpactsError,
    batches,
    blocks,
    digest_of,
    head,
    header_names,
    require_columns,
    weigh,
)
from erosion.cfd.surface import Surface
from erosion.extras import library

_MESH = Path("constant") / "polyMesh"
_ADDRESSING = "faceProcAddressing"


@dataclasses.dataclass(frozen=True)
class Patch:
    """Consecutive faces of the mesh."""

    kind: str
    start: int
    faces: int

    @property
    def end(self) -> int:
        """The first face after it."""
        return self.start + self.faces

    def has(self, mesh_faces: np.ndarray) -> np.ndarray:
        """Whether each face of the mesh is of this patch."""
        return (mesh_faces >= self.start) & (mesh_faces < self.end)


@dataclasses.dataclass(frozen=True)
class Mesh:
    """The mesh of a case; its files are read when they are needed."""

    case: Path

    @functools.cached_property
    def patches(self) -> dict[str, Patch]:
        """Its patches by name.

        Raises:
            ImpactsError: where the mesh's file cannot be read, or its patches are not one after the other.
        """
        path = self._path("boundary")
        patches = dict[str, Patch]()
        try:
            for name, entry in _content(path):
                if name in patches:
                    raise ImpactsError(f"{path}: has two patches {name!r}.")
                numbers = [_count(path, name, key, entry[key]) for key in ("startFace", "nFaces")]
                patches[name] = Patch(str(entry["type"]), *numbers)
        except (TypeError, ValueError, KeyError) as error:
            if isinstance(error, ImpactsError):
                raise
            raise ImpactsError(f"{path}: is no list of patches.") from error
        following = sorted((patch.start, patch.end, name) for name, patch in patches.items() if patch.faces)
        for (_, end, before), (start, _, name) in itertools.pairwise(following):
            if start != end:
                raise ImpactsError(
                    f"{path}: patch {name!r} must start at face {end}, where {before!r} ends, but starts at {start}."
                )
        return patches

    @functools.cached_property
    def faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each face's corners end, and the corners of all faces.

        Raises:
            ImpactsError: where the mesh's file cannot be read, or its faces are not those of the patches.
        """
        path = self._path("faces")
        content = _content(path)
        try:
            if isinstance(content, tuple):
                starts, corners = (_labels(path, labels) for labels in content)
            else:
                starts = np.cumsum([0, *map(len, content)])
                corners = _labels(path, np.concatenate([np.zeros(0, np.int64), *content]))
        except TypeError as error:
            raise ImpactsError(f"{path}: is no list of faces.") from error
        if not len(starts) or starts[0] != 0 or starts[-1] != len(corners) or (np.diff(starts) < 0).any():
            raise ImpactsError(f"{path}: is no list of faces: their corners do not follow one another.")
        faces = len(starts) - 1
        if self.patches and (end := max(patch.end for patch in self.patches.values())) != faces:
            raise ImpactsError(f"{path}: has {faces} faces, but the last patch of `boundary` ends at {end}.")
        return starts[1:], corners

    @functools.cached_property
    def processors(self) -> dict[int, np.ndarray]:
        """The number of each face of a processor's part in the whole mesh, by processor; empty for a serial case.

        Raises:
            ImpactsError: where a file cannot be read, or holds what is no number of a face.
        """
        addressing = {}
        for folder in self.case.glob("processor[0-9]*"):
            if not folder.name.removeprefix("processor").isdecimal():
                continue
            path = folder / _MESH / _ADDRESSING
            if not _present(path):
                continue
            # The numbers start at 1; a negative one says that the face is turned round.
            numbers = np.abs(_labels(path, _content(path))) - 1
            if (numbers < 0).any():
                raise ImpactsError(f"{path}: numbers faces from 1, but has a 0.")
            addressing[int(folder.name.removeprefix("processor"))] = numbers
        return addressing

    def surface(self, patch: str | Sequence[str] | None) -> Surface:
        """One or more patches, by default all walls.

        Raises:
            ImpactsError: naming the patches of the mesh, for one that is not among them.
        """
        names = self._chosen(patch)
        points = self._points()
        ends, corners = self.faces
        numbers = np.concatenate([np.arange(p.start, p.end) for p in map(self.patches.__getitem__, names)])
        sizes = np.diff(ends, prepend=0)[numbers]
        own_ends = np.cumsum(sizes)
        own_corners = corners[np.repeat(ends[numbers] - own_ends, sizes) + np.arange(sizes.sum())]
        used, own_corners = np.unique(own_corners, return_inverse=True)
        if len(used) and not 0 <= used[0] <= used[-1] < len(points):
            wrong = used[0] if used[0] < 0 else used[-1]
            raise ImpactsError(
                f"{self._path('faces')}: has a face with the corner {wrong}, but points are 0 to {len(points) - 1}."
            )
        return Surface(
            title=f"{self.case}: {', '.join(names)}",
            points=points[used],
            corners=own_corners.reshape(-1),
            ends=own_ends,
            patches=tuple(names),
            patch=np.repeat(np.arange(len(names)), [self.patches[name].faces for name in names]),
            mesh_face=numbers,
        )

    def _points(self) -> np.ndarray:
        path = self._path("points")
        try:
            points = np.asarray(_content(path), float)
        except (TypeError, ValueError) as error:
            if isinstance(error, ImpactsError):
                raise
            raise ImpactsError(f"{path}: is no list of points.") from error
        if points.ndim != 2 or points.shape[1] != 3:
            raise ImpactsError(f"{path}: is no list of points.")
        return points

    def _chosen(self, patch: str | Sequence[str] | None) -> list[str]:
        walls = [name for name, its in self.patches.items() if its.kind == "wall"]
        wanted = walls if patch is None else [patch] if isinstance(patch, str) else list(dict.fromkeys(patch))
        for name in wanted:
            if name not in self.patches:
                raise ImpactsError(f"{self.case}: has no patch {name!r}, but has {', '.join(self.patches)}.")
        if not wanted:
            raise ImpactsError(f"{self.case}: has no patch of type wall, but has {', '.join(self.patches)}.")
        return wanted

    def _path(self, name: str) -> Path:
        return self.case / _MESH / name


def case_of(path: Path) -> Path | None:
    """The case in which a file or folder lies; a case lies in itself."""
    folders = (path, *path.parents, *path.resolve().parents)
    return next((folder for folder in folders if _present(folder / _MESH / "boundary")), None)


def open_case(case: Path) -> Mesh:
    """The mesh of a case.

    Raises:
        ImpactsError: where the folder holds no mesh.
    """
    if not _present(case / _MESH / "boundary"):
        raise ImpactsError(f"{case}: is no OpenFOAM case, because it has no {_MESH / 'boundary'}.")
    return Mesh(case)


def dictionary(path: Path) -> Any:
    """A dictionary of OpenFOAM as foamlib gives it; None where the file is not there or cannot be read."""
    if not _present(path):
        return None
    try:
        return library("foamlib", "cfd").FoamFile(_stored(path)).as_dict()
    except (OSError, EOFError, ValueError):
        return None


def _count(path: Path, patch: str, key: str, value: Any) -> int:
    """A number of faces in `boundary`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 0 <= value < 2**63:
        raise ImpactsError(f"{path}: `{key}` of patch {patch!r} must be a whole number of at least 0, but is {value}.")
    return int(value)


def _labels(path: Path, numbers: Any) -> np.ndarray:
    """Whole numbers, shape (labels,)."""
    try:
        labels = np.asarray(numbers)
    except ValueError as error:  # lists of several lengths
        raise ImpactsError(f"{path}: is no list of whole numbers.") from error
    if labels.dtype == np.float64 and labels.size:
        if library("foamlib", "cfd").FoamFile(_stored(path)).format != "binary":
            raise ImpactsError(f"{path}: must hold whole numbers, but holds decimals.")
        labels = labels.view(np.int64)  # foamlib takes labels of 64 bits in a binary file for floating point numbers
    if labels.ndim != 1 or (labels.size and labels.dtype.kind not in "iu"):
        raise ImpactsError(f"{path}: is no list of whole numbers.")
    return labels.astype(np.int64)


def _present(path: Path) -> bool:
    return path.is_file() or _stored(path).is_file()


def _stored(path: Path) -> Path:
    compressed = path.with_name(f"{path.name}.gz")
    return compressed if compressed.is_file() and not path.is_file() else path


def _content(path: Path) -> Any:
    """What a file of OpenFOAM holds beside its header."""
    foamlib, stored = library("foamlib", "cfd"), _stored(path)
    try:
        # foamlib warns of an entry that is there twice.
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            content = foamlib.FoamFile(stored)[None]
    except FileNotFoundError as error:
        raise ImpactsError(f"{path}: is not there.") from error
    except (OSError, EOFError, ValueError, KeyError, UserWarning) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImpactsError(f"{stored}: cannot be read as a file of OpenFOAM ({reason[:120]}).") from error
    if isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], int):
        # The number before a list is part of the list only where it is right.
        items = len(content[1]) if hasattr(content[1], "__len__") else "others"
        raise ImpactsError(f"{stored}: says that its list has {content[0]} items, but it has {items}.")
    return content


SUFFIXES = (".post", ".dat")
_FIELDS = {"nParticle": "count", "d": "diameter", "rho": "density", "facei": "mesh_face", "Time": "time",
           "currentProc": "processor"}  # fmt: skip
_VECTORS = {"U": VELOCITY, "position": POSITION}
_AXES = (("0", "1", "2"), ("x", "y", "z"))  # how versions name the components
_WINDOW = re.compile(r"\d+\.?\d*(?:[eE][-+]?\d+)?")


@dataclasses.dataclass(frozen=True)
class Table:
    """One file of one patch in one window of time.

    Args:
        path: the file.
        patch: the name of the patch.
        window: the folder's name, the time at which it was written; empty where there is none.
        skipped: lines before the first row.
        names: its columns as the header names them.
    """

    path: Path
    patch: str
    window: str
    skipped: int
    names: tuple[str, ...]

    @functools.cached_property
    def columns(self) -> dict[str, str]:
        """The header's names by those of `rows.NAMES`."""
        columns = {ours: name for name, ours in _FIELDS.items() if name in self.names}
        for vector, ours in _VECTORS.items():
            for axes in _AXES:
                if all(vector + axis in self.names for axis in axes):
                    columns |= {name: vector + axis for name, axis in zip(ours, axes, strict=True)}
        return columns


@dataclasses.dataclass(kw_only=True)
class OpenFoamImpacts(Impacts):
    """All tables of a function object."""

    tables: tuple[Table, ...]
    mesh: Mesh | None
    most_stored: int | None

    def identity(self) -> str:
        """See `Impacts`."""
        processors = {} if self.mesh is None else self.mesh.processors
        addressing = [hashlib.sha256(processors[number].tobytes()).hexdigest() for number in sorted(processors)]
        return digest_of([table.path for table in self.tables], f"{self.density} {self.duration} {addressing}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`."""
        is_parallel: bool | None = None
        last = dict[str, tuple[Path, float]]()  # of each patch, the window before and its last time
        for table in self.tables:
            first, latest, stored = 0, -math.inf, np.zeros(0, np.int64)
            for columns in batches(table.path, table.skipped, table.names, table.columns):
                if is_parallel is None:
                    is_parallel = self._is_parallel(table, columns)
                if "mesh_face" in columns:
                    columns["mesh_face"] = self._mesh_faces(table, first, columns, is_parallel)
                if "time" in columns:
                    begins, before = columns["time"].min(), last.get(table.patch)
                    if before is not None and begins < before[1]:
                        raise ImpactsError(
                            f"{table.path}: begins at {begins:g} s, before {before[0]} ends at {before[1]:g} s: a "
                            "restart repeated this time. Move the windows of one of both runs away."
                        )
                    latest = max(latest, float(columns["time"].max()))
                stored = self._require_complete(table, stored, columns)
                yield from blocks(str(table.path), first, columns, rows, self.density)
                first += len(columns["diameter"])
            if first:
                last[table.patch] = (table.path, latest)

    def _is_parallel(self, table: Table, columns: Mapping[str, np.ndarray]) -> bool:
        """Whether faces are counted in each processor's part of the mesh."""
        if "mesh_face" not in columns or "processor" not in columns:
            return False
        if columns["processor"].any():
            return True
        if self.mesh is None or 0 not in self.mesh.processors or table.patch not in self.mesh.patches:
            return False
        # All rows are of processor 0, and the case is decomposed: the faces tell whether the run was serial.
        patch, faces = self.mesh.patches[table.patch], columns["mesh_face"]
        if not patch.has(faces).all():
            return True
        addressing = self.mesh.processors[0]
        mapped = addressing[np.minimum(faces.astype(np.int64), len(addressing) - 1)]
        if patch.has(mapped).all() and (mapped != faces).any():
            raise ImpactsError(
                f"{table.path}: names faces of patch {table.patch!r}, whether they are counted in the whole mesh of "
                f"{self.mesh.case} or in its part in processor0. If the run was serial, move the folders processor0, "
                "processor1, … away; if not, give all windows."
            )
        return False

    def _mesh_faces(self, table: Table, first: int, columns: Mapping[str, np.ndarray], is_parallel: bool) -> np.ndarray:
        """The faces' numbers in the whole mesh, checked against the patch's."""
        faces = columns["mesh_face"]
        if is_parallel or ("processor" in columns and columns["processor"].any()):
            faces = self._undecomposed(table, first, columns)
            if not is_parallel:
                raise ImpactsError(f"{table.path}: is of a parallel run, but the rows before it are of a serial one.")
        if self.mesh is None or table.patch not in self.mesh.patches:
            return faces
        own = self.mesh.patches[table.patch].has(faces)
        if not own.all():
            row = int(np.argmin(own))
            raise ImpactsError(
                f"{table.path}: row {first + row + 1:,} names face {columns['mesh_face'][row]:.0f}, which is none "
                f"of patch {table.patch!r} of {self.mesh.case}. Is the table of another mesh, or of a parallel run "
                "whose folders processor0, processor1, … are gone?"
            )
        return faces

    def _undecomposed(self, table: Table, first: int, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Faces of the whole mesh from those of the processors' parts."""
        processors = {} if self.mesh is None else self.mesh.processors
        faces = columns["mesh_face"].copy()
        for processor in np.unique(columns["processor"]).astype(int):
            if processor not in processors:
                where = "the case, which is not given" if self.mesh is None else f"{self.mesh.case}"
                raise ImpactsError(
                    f"{table.path}: is of a parallel run, and its faces are those of a processor's part of the mesh: "
                    f"processor{processor}/constant/polyMesh/faceProcAddressing is needed of {where}."
                )
            addressing = processors[processor]
            rows = np.flatnonzero(columns["processor"] == processor)
            wrong = (faces[rows] < 0) | (faces[rows] >= len(addressing))
            if wrong.any():
                row = int(rows[np.argmax(wrong)])
                raise ImpactsError(
                    f"{table.path}: row {first + row + 1:,} names face {faces[row]:.0f} of processor {processor}, "
                    f"which has {len(addressing):,} faces."
                )
            faces[rows] = addressing[faces[rows].astype(np.int64)]
        return faces

    def _require_complete(self, table: Table, stored: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Count rows by processor, and refuse a table that is full: what came later is lost."""
        length = len(columns["diameter"])
        processors = columns.get("processor", np.zeros(length)).astype(np.int64)
        counted = np.bincount(processors, minlength=len(stored))
        counted[: len(stored)] += stored
        if self.most_stored is not None and counted.max(initial=0) >= self.most_stored:
            raise ImpactsError(
                f"{table.path}: holds {counted.max():,} rows of processor {counted.argmax()}, which is the case's "
                "`maxStoredParcels`: later impacts were not written. Increase it, and run the case again."
            )
        return counted


def open_openfoam(path: Path, case: Path | None, density: float | None, duration: float | None) -> OpenFoamImpacts:
    """The tables of a file, a window, a function object or a whole case.

    Raises:
        ImpactsError: where there are none, or of several function objects, or their headers are not usable.
    """
    tables = _tables(path)
    mesh_case = case_of(path) if case is None else case
    mesh = None if mesh_case is None else open_case(mesh_case)
    first = tables[0]
    for table in tables:
        if table.names != first.names:
            raise ImpactsError(f"{table.path}: has other columns than {first.path}; read them one by one.")
    require_columns(str(first.path), first.columns, has_density=density is not None)
    if not {"mesh_face", POSITION[0]} & first.columns.keys():
        raise ImpactsError(f"{first.path}: names neither the face (`facei`) nor the position of an impact.")
    _, warnings_of_weights = weigh(str(first.path), first.columns, duration)
    if duration is None and mesh is not None and (start := _start(mesh.case)) is not None:
        windows = [float(table.window) for table in tables if table.window]
        duration = max(windows) - start if windows and max(windows) > start else None
    return OpenFoamImpacts(
        title=str(path),
        tables=tuple(tables),
        mesh=mesh,
        most_stored=None if mesh is None else _most_stored(mesh.case, first.path),
        density=density,
        duration=duration,
        mesh_faces="mesh_face" in first.columns,
        warnings=warnings_of_weights,
    )


def is_table(path: Path) -> bool:
    """Whether the name is one of a table of impacts, compressed or not."""
    return _plain_name(path).suffix in SUFFIXES


def _tables(path: Path) -> list[Table]:
    if path.is_file():
        return [_table(path)]
    # Beside those of clouds a case has tables of forces, probes and others.
    within = [folder for folder in (path / "postProcessing" / "lagrangian", path / "lagrangian") if folder.is_dir()]
    root = within[0] if within else path
    files = sorted(file for file in root.rglob("*") if file.is_file() and is_table(file) and _in_window(file))
    if not files:
        files = sorted(file for file in root.iterdir() if file.is_file() and is_table(file))
    if not files:
        names = sorted(file.name + "/" * file.is_dir() for file in path.iterdir())
        listed = f"{', '.join(names[:10])}{', …' if len(names) > 10 else ''}" if names else "nothing"
        raise ImpactsError(f"{path}: has no tables of impacts (.post, .dat), but {listed}.")
    objects = {_function_object(file) for file in files}
    if len(objects) > 1:
        listed = ", ".join(str(folder.relative_to(path)) for folder in sorted(objects))
        raise ImpactsError(
            f"{path}: has tables of {len(objects)} function objects, {listed}; give one of these folders."
        )
    twice = [file for file in files if file.suffix == ".gz" and file.with_suffix("") in files]
    if twice:
        raise ImpactsError(f"{twice[0]}: is there twice, also as {twice[0].stem}; remove one of them.")
    tables = [_table(file) for file in files]
    return sorted(tables, key=lambda table: (float(table.window or 0), table.patch))


def _table(path: Path) -> Table:
    lines = head(path)
    header = [number for number, line in enumerate(lines) if line.startswith("#")]
    names = header_names(path, lines[header[-1]]) if header else ()
    if "Time" not in names:
        raise ImpactsError(f"{path}: has no header of OpenFOAM, a line that starts with '# Time'.")
    window = path.parent.name if _in_window(path) else ""
    return Table(path, _plain_name(path).stem, window, header[-1] + 1, names)


def _in_window(path: Path) -> bool:
    """Whether the file lies in a folder that has a time for its name."""
    return bool(_WINDOW.fullmatch(path.parent.name))


def _function_object(path: Path) -> Path:
    return path.parent.parent if _in_window(path) else path.parent


def _plain_name(path: Path) -> Path:
    return path.with_suffix("") if path.suffix == ".gz" else path


def _most_stored(case: Path, table: Path) -> int | None:
    """`maxStoredParcels` of the function object of a table; None where the case does not say it."""
    folder = _function_object(table)
    content = dictionary(case / "constant" / f"{folder.parent.name}Properties")
    try:
        value = content["cloudFunctions"][folder.name]["maxStoredParcels"] if content else None
    except (KeyError, TypeError):
        return None
    return int(value) if isinstance(value, (int, float)) else None


def _start(case: Path) -> float | None:
    """The time at which the run began; None where the case does not say it."""
    content = dictionary(case / "system" / "controlDict")
    start = content.get("startTime") if content and content.get("startFrom") == "startTime" else None
    return float(start) if isinstance(start, (int, float)) else None
