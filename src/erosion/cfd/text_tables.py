"""Tables of impacts as text, of the cloud function objects of OpenFOAM and of Ansys Fluent's samples `.dpm`.

A file `.dpm` begins with two lines, the surface and the columns; then one line for each parcel, the numbers in
parentheses and the name of its injection. All numbers are in SI units whatever the session shows; t is the
temperature, and `time` the age of the particle.
"""

import dataclasses
import hashlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from erosion.cfd.openfoam import Mesh, case_of, dictionary, open_case
from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    WEIGHTS,
    ImpactBlock,
    Impacts,
    ImpactsError,
    blocks,
    digest_of,
    reading_impacts,
    require_columns,
    require_rows,
    weigh,
)
from erosion.output import first_of
from erosion.tables.text import Layout, TextTable, beginning, cut_off

_OF_OPENFOAM = {"nParticle": "count", "d": "diameter", "rho": "density", "facei": "mesh_face", "celli": "cell",
                "Time": "time", "currentProc": "processor", "origId": "parcel", "origProc": "origin"}  # fmt: skip
_VECTORS = {"U": VELOCITY, "P": POSITION, "position": POSITION}
_READ_AS = "columns of {} in SI units"
_AXES = ("012", "xyz")  # how versions name the components
_WINDOW = re.compile(r"\d+\.?\d*(?:[eE][-+]?\d+)?")
_OF_FLUENT = {
    **dict(zip("xyz", POSITION, strict=True)), **dict(zip("uvw", VELOCITY, strict=True)), "diameter": "diameter",
    "mass": "mass", "n-in-parcel": "count", "parcel-mass": "parcel_mass", "mass-flow": "mass_flow",
    "frequency": "frequency", "flow-time": "time",
}  # fmt: skip


class FileTable(NamedTuple):
    """One file; of OpenFOAM, that of one patch in one window of time.

    Args:
        path: the file.
        skipped: lines before the first row.
        names: its columns as the header names them.
        columns: the header's names by those of `rows.NAMES`.
        patch: the name of the patch.
        window: the folder's name, the time at which it was written; empty where there is none.
    """

    path: Path
    skipped: int
    names: tuple[str, ...]
    columns: dict[str, str]
    patch: str = ""
    window: str = ""

    def blocks(self) -> Iterator[dict[str, np.ndarray]]:
        """The numbers of the columns, some thousand rows at a time.

        Raises:
            ImpactsError: naming the first row that cannot be read.
        """
        with reading_impacts():
            text = TextTable(self.path, layout=Layout(self.skipped, self.names, " "))
            for block in text.blocks([*self.columns.values()]):
                yield {name: block[heading] for name, heading in self.columns.items()}


@dataclasses.dataclass(kw_only=True)
class TextImpacts(Impacts):
    """All tables of a function object, or a sample of parcels at one surface.

    In a steady run of Fluent a row is a stream of particles, and its `mass-flow` [kg/s] hits for the whole duration.
    """

    tables: tuple[FileTable, ...]
    mesh: Mesh | None = None
    most_stored: int | None = None

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
            for columns in table.blocks():
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
                yield from blocks(str(table.path), first, columns, rows, self.density, self.duration)
                first += len(columns["diameter"])
            if first:
                last[table.patch] = (table.path, latest)

    def _is_parallel(self, table: FileTable, columns: Mapping[str, np.ndarray]) -> bool:
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

    def _mesh_faces(
        self, table: FileTable, first: int, columns: Mapping[str, np.ndarray], is_parallel: bool
    ) -> np.ndarray:
        """The faces' numbers in the whole mesh, checked against the patch's."""
        faces = columns["mesh_face"]
        if is_parallel or ("processor" in columns and columns["processor"].any()):
            faces = self._undecomposed(table, first, columns)
            if not is_parallel:
                raise ImpactsError(f"{table.path}: is of a parallel run, but the rows before it are of a serial one.")
        if self.mesh is None:
            return faces
        if table.patch not in (patches := self.mesh.patches):
            others = sorted({one.patch for one in self.tables} & patches.keys())
            if other := next((name for name in others if patches[name].has(faces).any()), ""):
                raise ImpactsError(
                    f"{table.path}: names faces of patch {other!r}, of which another table has the impacts; "
                    "if it is a copy, move it away."
                )
            return faces
        own, named = self.mesh.patches[table.patch].has(faces), columns["mesh_face"]
        doubt = (
            f", which is none of patch {table.patch!r} of {self.mesh.case}. Is the table of another mesh, or of a "
            "parallel run whose folders processor0, processor1, … are gone?"
        )
        require_rows(str(table.path), first, own, lambda row: f" names face {named[row]:.0f}{doubt}")
        self._require_cells(table, first, columns, is_parallel)
        return faces

    def _require_cells(
        self, table: FileTable, first: int, columns: Mapping[str, np.ndarray], is_parallel: bool
    ) -> None:
        """Refuse faces of another cell than the row's: the mesh has other numbers than during the run."""
        if "cell" not in columns or self.mesh is None:
            return
        faces, cells = columns["mesh_face"].astype(np.int64), columns["cell"]
        processors = columns["processor"] if is_parallel else np.full(len(faces), -1)
        for number, owner in self.mesh.owners.items():
            own = processors == (-1 if number is None else number)
            fits = ~own | (owner[np.minimum(faces, len(owner) - 1)] == cells)
            of = f", but this face is of another cell in {self.mesh.case}. Was the mesh renumbered after the run?"
            require_rows(str(table.path), first, fits, lambda row, of=of: f" is of cell {cells[row]:.0f}{of}")

    def _undecomposed(self, table: FileTable, first: int, columns: Mapping[str, np.ndarray]) -> np.ndarray:
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
            addressing, own = processors[processor], columns["processor"] == processor
            good = ~own | ((faces >= 0) & (faces < len(addressing)))
            of = f"of processor {processor}, which has {len(addressing):,} faces."
            require_rows(str(table.path), first, good, lambda row, of=of: f" names face {faces[row]:.0f} {of}")
            faces[own] = addressing[faces[own].astype(np.int64)]
        return faces

    def _require_complete(self, table: FileTable, stored: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
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


def open_openfoam(path: Path, case: Path | None, density: float | None, duration: float | None) -> TextImpacts:
    """The tables of a file, a window, a function object or a whole case.

    Raises:
        ImpactsError: where there are none, or of several function objects, or their headers are not usable.
    """
    every = [_openfoam_table(file) for file in ([path] if path.is_file() else _files(path))]
    every.sort(key=lambda table: (float(table.window or 0), table.patch))
    # OpenFOAM names the columns of parcels only once one has hit.
    tables = [table for table in every if table.columns.keys() - {"time", "processor"}] or every
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
    warnings_of_weights += tuple(itertools.chain(*(cut_off(table.path) for table in tables)))
    given, covered = duration, _covered(path, every, mesh)
    if given is not None and covered is not None and not math.isclose(given, covered, rel_tol=0.01):
        warnings_of_weights += (
            f"Argument `duration`, {given:g} s, takes the place of the {covered:g} s of the windows of time.",
        )
    there = {(table.window, table.patch): table for table in every}  # in the order of time
    windows, patches = dict.fromkeys(window for window, _ in there), sorted({patch for _, patch in there})
    if lacking := ["/".join(pair) for pair in itertools.product(windows, patches) if pair not in there]:
        listed = ", ".join(first_of(lacking, 3))
        warnings_of_weights += (f"{path.name} has no table {listed}, but those of others; is it lost?",)
    is_whole = path.is_dir() and not _WINDOW.fullmatch(path.name)
    return TextImpacts(
        title=str(path),
        tables=tuple(tables),
        mesh=mesh,
        most_stored=None if mesh is None else _most_stored(mesh.case, first.path),
        density=density,
        duration=covered if given is None else given,
        duration_from="by the windows of time" if given is None else "as given",
        injected=_injected(mesh.case, tables) if mesh is not None and is_whole else None,
        has_parcels="parcel" in first.columns,
        has_weights=any(name in first.columns for name in WEIGHTS),
        mesh_faces="mesh_face" in first.columns,
        warnings=warnings_of_weights,
        read_as=_READ_AS.format("OpenFOAM"),
    )


def open_fluent(path: Path, density: float | None, duration: float | None) -> TextImpacts:
    """A sample of Fluent.

    Raises:
        ImpactsError: for a file without Fluent's header, or without columns that are needed.
    """
    if density is not None:
        raise ImpactsError(f"{path}: gives the mass of each particle; Argument `particle_density` must be left out.")
    lines = _head(path)
    numbers = [number for number, line in enumerate(lines[:10]) if "diameter" in line and line.lstrip().startswith("(")]
    if not numbers:
        raise ImpactsError(f"{path}: has no header of Fluent, a line such as (x y z u v w diameter t … name).")
    names = _names(path, lines[numbers[0]])
    columns = {ours: name for name, ours in _OF_FLUENT.items() if name in names}
    # Fluent gives the weight in several ways, which agree.
    for weight in [weight for weight in WEIGHTS if weight in columns][1:]:
        del columns[weight]
    duration, warnings = weigh(str(path), columns.keys() - {"time"}, duration)
    require_columns(str(path), columns)
    table = FileTable(path, numbers[0] + 1, names, columns)
    read_as = _READ_AS.format("Fluent")
    warnings += cut_off(path)
    return TextImpacts(
        title=str(path),
        tables=(table,),
        duration=duration,
        has_weights=any(name in columns for name in WEIGHTS),
        warnings=warnings,
        read_as=read_as,
    )


def _files(folder: Path) -> list[Path]:
    """The tables of a window, a function object or a whole case."""
    # Beside those of clouds a case has tables of forces, probes and others.
    roots = (folder / "postProcessing" / "lagrangian", folder / "lagrangian", folder)
    root = next(root for root in roots if root.is_dir())
    tables = sorted(file for file in root.rglob("*") if _is_table(file, root))
    files = [file for file in tables if _in_window(file)] or [file for file in tables if file.parent == root]
    if not files:
        names = sorted(file.name + "/" * file.is_dir() for file in folder.iterdir())
        listed = ", ".join(first_of(names, 10)) or "nothing"
        raise ImpactsError(f"{folder}: has no tables of impacts (.post, .dat), but {listed}.")
    objects = {_function_object(file) for file in files}
    if len(objects) > 1:
        listed = ", ".join(str(one.relative_to(folder)) for one in sorted(objects))
        raise ImpactsError(
            f"{folder}: has tables of {len(objects)} function objects, {listed}; give one of these folders."
        )
    if twice := [file for file in files if file.suffix == ".gz" and file.with_suffix("") in files]:
        raise ImpactsError(f"{twice[0]}: is there twice, also as {twice[0].stem}; remove one of them.")
    return files


def _is_table(file: Path, root: Path) -> bool:
    """Whether its name is a table's, and nothing below `root` is hidden, as copies and unfinished files are."""
    is_hidden = any(part.startswith(".") for part in file.relative_to(root).parts)
    return file.name.removesuffix(".gz").endswith((".post", ".dat")) and file.is_file() and not is_hidden


def _openfoam_table(path: Path) -> FileTable:
    lines = _head(path)
    comments = [*itertools.takewhile(lambda line: line.startswith("#"), lines)]  # another header below them is no row
    names = _names(path, comments[-1]) if comments else ()
    if "Time" not in names:
        raise ImpactsError(f"{path}: has no header of OpenFOAM, a line that starts with '# Time'.")
    columns = {ours: name for name, ours in _OF_OPENFOAM.items() if name in names}
    for vector, ours in _VECTORS.items():
        for axes in _AXES:
            if all(vector + axis in names for axis in axes):
                columns |= {name: vector + axis for name, axis in zip(ours, axes, strict=True)}
    window = path.parent.name if _in_window(path) else ""
    return FileTable(path, len(comments), names, columns, Path(path.name.removesuffix(".gz")).stem, window)


def _head(path: Path) -> list[str]:
    """The complete lines at the beginning of a file; errors as of `beginning`."""
    try:
        with reading_impacts():
            lines = beginning(path).decode().split("\n")
    except UnicodeDecodeError:
        lines = []
    if not lines:
        raise ImpactsError(f"{path}: is no table of text.")
    return lines


def _names(path: Path, line: str) -> tuple[str, ...]:
    """The columns that a header names.

    Raises:
        ImpactsError: where it repeats one.
    """
    names = tuple(re.sub(r"[#()]", " ", line).split())
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ImpactsError(f"{path}: the header repeats {', '.join(repeated)}.")
    return names


def _in_window(path: Path) -> bool:
    """Whether the file lies in a folder that has a time for its name."""
    return bool(_WINDOW.fullmatch(path.parent.name))


def _function_object(path: Path) -> Path:
    return path.parent.parent if _in_window(path) else path.parent


def _most_stored(case: Path, table: Path) -> int | None:
    """`maxStoredParcels` of the function object of a table; None where the case does not say it."""
    folder = _function_object(table)
    value = _entry(_properties(case, folder.parent.name), "cloudFunctions", folder.name, "maxStoredParcels")
    return int(value) if isinstance(value, (int, float)) else None


def _covered(path: Path, tables: Sequence[FileTable], mesh: Mesh | None) -> float | None:
    """The time that windows cover [s]: from the one before them, or the start of the run, to their ends."""
    windows = [float(table.window) for table in tables if table.window]
    if not windows:
        return None
    folder = _function_object(tables[0].path)
    all_windows = sorted(float(one.name) for one in folder.iterdir() if one.is_dir() and _WINDOW.fullmatch(one.name))
    before = [window for window in all_windows if window < min(windows)]
    start = before[-1] if before else None if mesh is None else _start(mesh.case)
    if start is None or not max(windows) > start:
        return None
    solution = None if mesh is None else _entry(_properties(mesh.case, folder.parent.name), "solution")
    if mesh is not None and _entry(solution, "transient") is False:
        passed = [window for window in all_windows if start < window <= max(windows)]
        return _evolutions(mesh.case, solution, start, passed)
    return max(windows) - start


def _evolutions(case: Path, solution: Any, start: float, windows: Sequence[float]) -> float | None:
    """The time for which a steady cloud injects [s]: 1 s in each iteration that evolves it.

    These are one in `calcFrequency`, and those that are written. None where the case does not say it.
    """
    step, frequency = _entry(dictionary(case / "system" / "controlDict"), "deltaT"), solution.get("calcFrequency", 1)
    if not all(isinstance(number, (int, float)) and number > 0 for number in (step, frequency)):
        return None
    first, *written = (round(time / step) for time in (start, *windows))
    between = sum(iteration % frequency != 0 for iteration in written)
    return float(written[-1] // frequency - first // frequency + between)


def _properties(case: Path, cloud: str) -> Any:
    """The dictionary of a cloud; None where it is not there or cannot be read."""
    return dictionary(case / "constant" / f"{cloud}Properties")


def _start(case: Path) -> float | None:
    """The time at which the run began; None where the case does not say it."""
    content = dictionary(case / "system" / "controlDict")
    start = content.get("startTime") if content and content.get("startFrom") == "startTime" else None
    return float(start) if isinstance(start, (int, float)) else None


def _injected(case: Path, tables: Sequence[FileTable]) -> float | None:
    """The mass that was injected until the end of the tables [kg]; None where the case does not say it."""
    if _start(case) != 0:  # what an earlier run injected counts in OpenFOAM's sum
        return None
    last = max(tables, key=lambda table: float(table.window or 0))
    cloud, end = _function_object(last.path).parent.name, last.window
    state = Path(end) / "uniform" / "lagrangian" / cloud / f"{cloud}OutputProperties"
    # Each processor has the mass that all have injected.
    for folder in (case, case / "processor0") if end else ():
        if masses := list(_entries(dictionary(folder / state), "massInjected")):
            return sum(masses) or None
    content = _properties(case, cloud)
    if _entry(content, "solution", "transient") is False:
        return None
    models = _entry(content, "subModels", "injectionModels")
    # What is injected at a constant rate, or all of it by now.
    masses = [_injected_by(model, float(end or math.inf)) for model in models.values()] if models else [None]
    return None if None in masses else sum(mass for mass in masses if mass is not None) or None


def _injected_by(model: Any, end: float) -> float | None:
    """The mass of an injection until a time [kg]."""
    total, start, duration = (_entry(model, name) for name in ("massTotal", "SOI", "duration"))
    if not all(isinstance(number, (int, float)) for number in (total, start, duration)):
        return None
    if model.get("parcelBasisType") != "mass" or not duration > 0:
        return None
    is_even = model.get("flowRateProfile") in (("constant", 1), ["constant", 1], 1)
    done = min(max((end - start) / duration, 0.0), 1.0)
    return total * done if is_even or done in (0, 1) else None


def _entry(content: Any, *names: str) -> Any:
    """An entry of a dictionary in dictionaries; None where it is not there."""
    for name in names:
        content = content.get(name) if isinstance(content, Mapping) else None
    return content


def _entries(content: Any, name: str) -> Iterator[float]:
    """The numbers of all entries of a name."""
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if key == name and isinstance(value, (int, float)):
            yield float(value)
        yield from _entries(value, name)
