"""Open tables of impacts and surfaces (VTK, STL, OpenFOAM) by the kind of their files."""

import contextlib
import dataclasses
import logging
import mmap
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import check_path
from erosion.cfd import impact_tables, text_tables
from erosion.cfd.openfoam import case_of, open_case
from erosion.cfd.rows import Impacts, ImpactsError, kind_of
from erosion.cfd.surface import Surface, metres_of
from erosion.extras import library
from erosion.output.files import require_finite
from erosion.parameters.quantities import about, read_quantity

SURFACE_SUFFIXES = (".vtp", ".stl", ".vtu")
_MOST_PACKED = 1000  # numbers for each byte: so much packs zlib at most
_STL_HEAD = 256  # bytes, of which VTK tells text from numbers as well
_POLYGONS = (5, 7, 9)  # VTK's numbers of triangle, polygon and quadrilateral


def open_surface(path: Path) -> Surface:
    """The polygons of a file; of a VTU those cells that are polygons.

    Raises:
        ImpactsError: for a file that cannot be read, or that holds no polygons.
    """
    pyvista = library("pyvista", "cfd")
    (_require_whole_stl if path.suffix.lower() == ".stl" else _require_counts)(path)
    try:
        with _quiet(), pyvista.vtk_verbosity("off"):
            mesh = pyvista.read(path)
    except Exception as error:
        raise ImpactsError(f"{path}: cannot be read; it is damaged, or no {path.suffix} file.") from error
    grid = mesh.cast_to_unstructured_grid() if hasattr(mesh, "cast_to_unstructured_grid") else None
    chosen = np.isin(grid.celltypes, _POLYGONS) if grid is not None and grid.n_cells else np.zeros(0, bool)
    if grid is None or not chosen.any():
        raise ImpactsError(f"{path}: holds no polygons; extract the surface of a volume's mesh first.")
    cells = grid.GetCells()
    corners = np.asarray(pyvista.convert_array(cells.GetConnectivityArray()), np.int64)
    sizes = np.diff(pyvista.convert_array(cells.GetOffsetsArray()))
    return Surface(
        title=str(path),
        points=np.asarray(grid.points, float),
        corners=corners[np.repeat(chosen, sizes)],
        ends=np.cumsum(sizes[chosen], dtype=np.int64),
        patches=(path.stem,),
        patch=np.zeros(int(chosen.sum()), np.int64),
    )


def _require_whole_stl(path: Path) -> None:
    """Refuse a binary file that has other facets than its header says; VTK reads those that are there."""
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(_STL_HEAD)
    # Binary files may begin with "solid", too.
    if b"\0" not in start and start.lstrip().startswith(b"solid"):
        return
    facets = int.from_bytes(start[80:84], "little")
    if size != 84 + 50 * facets:
        raise ImpactsError(
            f"{path}: cannot be read; it is damaged, or no .stl file: a binary one of its {size:,} bytes has "
            f"{max(size - 84, 0) / 50:,.6g} facets, but it says that it has {facets:,}."
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
                    f"{path}: cannot be read; it is damaged: {what.decode()} is {number!r} in a file of {size:,} bytes."
                )


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


_SURFACES = ".vtp, .stl or .vtu"


def read_impacts(
    source: str | Path,
    case: str | Path | None = None,
    *,
    particle_density: float | int | str | None = None,
    duration: float | int | None = None,
    ignore: Sequence[str] = (),
    columns: str | Mapping[str, str] | None = None,
) -> Impacts:
    """Open a table of impacts of a CFD run.

    Only headers are read here; the rows are read in blocks where they are used, so that memory does not grow with their
    number.

        impacts = erosion.read_impacts("bend/postProcessing/lagrangian/sand/impacts")
        surface = erosion.read_surface("bend", patch="wall")
        dataset = erosion.erosion_map("rotating", p, impacts, surface)

    Formats, by the name of the file, which may also end in ".gz" where it is text; or, with another name such as
    ".dat" or ".txt", by what it begins with:

    - `.post`: OpenFOAM's function objects `patchPostProcessing` and `particlePostProcessing`; a file, the
      folder of a function object with all its windows of time, or a case that has one. Columns are found by the header.
    - `.dpm`: a sample of Fluent. Of a steady run the rows are what hits within `duration`.
    - `.csv`, `.parquet`: text with commas, semicolons, tabs or spaces between columns, or numbers: columns
      `diameter [um]`; `mass [ug]` or `density [kg/m^3]`; `velocity_x [m/s]`, `velocity_y`,
      `velocity_z`, or `speed [m/s]` and `angle [deg]`; at will one of `count`, `parcel_mass [kg]`, and of a steady run
      `mass_flow [kg/s]`, `frequency [1/s]`; `position_x [m]`, …, `face` (of the surface) or `mesh_face` (of the mesh),
      from 0, `spin [rad/s]`, `time [s]`. A Parquet file may hold units in its columns' metadata (`units`). A column
      that may be one of these, but is not understood, is refused; and `warnings` of the result names
      the columns that are left out.

    A table without weights counts each row as one particle; `warnings` of the result says so.

    Args:
        source: a file or folder.
        case: the OpenFOAM case whose mesh the faces belong to; by default the one in which `source` lies.
        particle_density: of the particles, where no column gives it: a number [kg/m³], or "2.65 g/cm^3".
        duration: time that the table covers [s], where it does not say it or says it wrongly.
        ignore: columns of a CSV or Parquet file that are left out, by their names: ("frequency",).
        columns: units of columns that carry none, and meanings of those whose names are not understood, by the names of
            the file: "x,y,z=mm, vel_x,vel_y,vel_z=m/s, d50=diameter [um]", the same as a mapping, or a TOML file.

    Returns:
        The table; `blocks` of it reads the rows.

    Raises:
        ImpactsError: a ValueError that names the file and what is wrong with it.
    """
    path = _existing("source", source)
    case = None if case is None else _existing("case", case)
    kilograms = _density(particle_density)
    if duration is not None and not (np.isfinite(duration) and duration > 0):
        raise ImpactsError(f"Argument `duration` must be positive and finite, but is {duration!r}.")
    seconds = None if duration is None else float(duration)
    if (ignore or columns) and not impact_tables.is_named(path):
        given = "ignore" if ignore else "columns"
        raise ImpactsError(f"{path}: is no table with named columns, so Argument `{given}` must be left out.")
    kind = "openfoam" if path.is_dir() else kind_of(path)
    if kind == "openfoam":
        return text_tables.open_openfoam(path, case, kilograms, seconds)
    if kind == "fluent":
        return text_tables.open_fluent(path, kilograms, seconds)
    return impact_tables.open_named(path, kilograms, seconds, ignore, impact_tables.read_meanings(columns))


def read_surface(
    source: str | Path,
    patch: str | Sequence[str] | None = None,
    *,
    unit: str | None = None,
    reverse: bool | str = False,
) -> Surface:
    """Read the surface that particles hit.

    Args:
        source: an OpenFOAM case (its mesh in ASCII or binary, compressed or not), or a file `.vtp`, `.stl` or `.vtu`.
        patch: one or more patches of the case; by default all of type wall.
        unit: of the coordinates, "mm"; by default they are in metres, and `erosion_map` compares them with the
            positions of impacts.
        reverse: whether to turn the normals round, for a file whose normals point into the fluid. OpenFOAM's point
            out of it. Where nearly all impacts come from behind, `erosion_map` says it. "auto" makes the normals of
            each connected part agree, so that most of the first impacts come from the fluid.

    Raises:
        ImpactsError: a ValueError that names the file and what is wrong with it.
    """
    path = _existing("source", source)
    if unit is not None:
        metres_of(unit)
    if path.is_dir():
        case = case_of(path)
        surface = open_case(path if case is None else case).surface(patch)
    elif path.suffix.lower() in SURFACE_SUFFIXES:
        if patch is not None:
            raise ImpactsError(f"{path}: has no patches, so Argument `patch` must be left out.")
        surface = open_surface(path)
    else:
        raise ImpactsError(f"{path}: is no surface; it must be an OpenFOAM case, or its name must end in {_SURFACES}.")
    surface = surface.in_unit(unit)
    if reverse not in (False, True, "auto"):
        raise ImpactsError(f"Argument `reverse` must be True, False or 'auto', but is {reverse!r}.")
    if reverse == "auto":
        return dataclasses.replace(surface.reversed(surface.parts[1]), turns_itself=True)
    return surface.reversed() if reverse else surface


def _existing(name: str, value: Any) -> Path:
    path = check_path(name, value)
    if not path.exists():
        raise ImpactsError(f"{path}: is not there.")
    require_finite(path, ImpactsError)
    return path


def _density(density: float | int | str | None) -> float | None:
    if density is None:
        return None
    with about("Argument `particle_density`", ImpactsError):
        value = read_quantity(density, "density", "si") if isinstance(density, str) else float(density)
    if not (np.isfinite(value) and value > 0):
        raise ImpactsError(f"Argument `particle_density` must be positive and finite, but is {density!r}.")
    return value
