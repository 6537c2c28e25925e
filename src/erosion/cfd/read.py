"""Open tables of impacts and surfaces (VTK, STL, OpenFOAM) by the kind of their files."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import NUMBERS, check_path
from erosion.cfd import impact_tables, text_tables
from erosion.cfd.openfoam import case_of, open_case
from erosion.cfd.rows import Impacts, ImpactsError, reading_impacts
from erosion.cfd.stl import read_solids
from erosion.cfd.surface import Surface, metres_of
from erosion.cfd.vtk import ENDINGS, vtk_blocks
from erosion.extras import library
from erosion.output import briefly, require_finite
from erosion.parameters import about, read_quantity
from erosion.tables import read_meanings
from erosion.tables.frames import format_of
from erosion.tables.text import beginning

SURFACE_FORMATS: Mapping[str, Callable[[Path], dict[str, Any]]] = {
    **dict.fromkeys(ENDINGS, vtk_blocks),
    ".stl": read_solids,
}
"""By the ending of a file's name, what reads its blocks of polygons, as data sets of pyvista by name."""

_POLYGONS = (5, 7, 9)  # VTK's numbers of triangle, polygon and quadrilateral
_OTHER_FACES = (6, 8, 22, 23, 28, 30, 34, 36, 61, 62, 69, 70, 76, 77)  # of strip and pixel, and of curved faces


def open_surface(path: Path, patch: str | Sequence[str] | None = None, unit: str | None = None) -> Surface:
    """The polygons of a file: of a VTU its cells that are polygons; each solid of an STL and block of a VTM is a patch.

    Raises:
        ImpactsError: for a file of another format, that cannot be read, or that holds no polygons, a patch that is not
            there, and a file whose unit nobody says.
    """
    read_blocks = SURFACE_FORMATS.get(path.suffix.lower())
    if read_blocks is None:
        converted = path.with_suffix(".vtp").name
        hint = (
            f" Python converts other files of polygons: pyvista.read({path.name!r}).extract_surface().triangulate()"
            f".save({converted!r})."
        ) * (path.suffix.lower() in _CONVERTIBLE)
        endings = ", ".join(SURFACE_FORMATS)
        raise ImpactsError(
            f"{path}: is no surface; it must be an OpenFOAM case, or its name must end in {endings}.{hint}"
        )
    blocks = read_blocks(path)
    if patch is not None and len(blocks) < 2 and path.suffix.lower() != ".vtm":
        raise ImpactsError(f"{path}: has no patches, so Argument `patch` must be left out.")
    grids = dict[str, tuple[Any, np.ndarray]]()
    for name, block in blocks.items():
        grid = block.cast_to_unstructured_grid()
        if (others := np.isin(grid.celltypes, _OTHER_FACES)).any():
            raise ImpactsError(
                f"{path}: {others.sum():,} of its cells are strips, pixels or curved faces, which are not read; make "
                "triangles of them, as by ParaView's filter Triangulate."
            )
        if (chosen := np.isin(grid.celltypes, _POLYGONS)).any():
            grids[name] = grid, chosen
    if not grids:
        raise ImpactsError(f"{path}: holds no polygons; extract the surface of a volume's mesh first.")
    names = list(grids) if patch is None else [patch] if isinstance(patch, str) else list(dict.fromkeys(patch))
    if unknown := next((name for name in names if name not in grids), ""):
        raise ImpactsError(f"{path}: has no patch {unknown!r}, but has {', '.join(grids)}.")
    points, corners, sizes = [list[np.ndarray]() for _ in range(3)]
    pyvista = library("pyvista", "cfd")
    for grid, chosen in (grids[name] for name in names):
        cells, first = grid.GetCells(), sum(map(len, points))
        size = np.diff(pyvista.convert_array(cells.GetOffsetsArray()))
        its = np.asarray(pyvista.convert_array(cells.GetConnectivityArray()), np.int64)
        corners.append(its[np.repeat(chosen, size)] + first)
        points.append(np.asarray(grid.points, float))
        sizes.append(size[chosen])
    surface = Surface(
        title=str(path) if path.suffix.lower() != ".vtm" and len(blocks) == 1 else f"{path}: {', '.join(names)}",
        points=np.concatenate(points),
        corners=np.concatenate(corners),
        ends=np.cumsum(np.concatenate(sizes), dtype=np.int64),
        patches=tuple(names),
        patch=np.repeat(np.arange(len(names)), list(map(len, sizes))),
        is_facing=False,
    )
    stated = {str(text) for grid, _ in grids.values() for text in grid.field_data.get("unit", ())}
    if unit is None and len(stated) != 1:
        raise ImpactsError(f"{path}: does not say the unit of its coordinates: Argument `unit` must, such as 'mm'.")
    surface = surface.in_unit(next(iter(stated)) if unit is None else unit)
    if len(names) == 1:
        return surface
    twice = np.setdiff1d(np.arange(surface.faces), np.unique(surface.centre, axis=0, return_index=True)[1])
    if len(twice):
        raise ImpactsError(
            f"{path}: {len(twice):,} faces of {names[surface.patch[twice[0]]]!r} are those of another block, too: "
            f"Argument `patch` must name some of {', '.join(names)}."
        )
    return surface


_CONVERTIBLE = ".vtk", ".pvtp", ".ply", ".obj"  # VTK reads those that were cut off without an error, or it crashes


def read_impacts(
    source: str | Path,
    case: str | Path | None = None,
    *,
    particle_density: float | int | str | None = None,
    duration: float | int | None = None,
    ignore: Sequence[str] = (),
    columns: str | Mapping[str, str] | None = None,
    sep: str | None = None,
    decimal: str | None = None,
    named_density: float | None = None,
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
    - `.csv`, `.parquet`, `.feather`, `.xlsx`; `.vtp`, `.vtu`, `.vtm`: text with commas, semicolons, tabs or spaces
      between columns, or numbers; or VTK's points with arrays, where the vector `U` is the columns `U:0`, `U:1` and
      `U:2`. Columns `diameter [um]`; `mass [ug]` or `density [kg/m^3]`; `velocity_x [m/s]`, `velocity_y`,
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
        sep: what separates the cells of a text: ",", ";", "tab" or " "; its header shows it otherwise.
        decimal: the mark of decimals of a text, "." or ","; its numbers show it otherwise.
        named_density: of a particle that is named [kg/m³], for a table that does not have its own.

    Returns:
        The table; `blocks` of it reads the rows.

    Raises:
        ImpactsError: a ValueError that names the file and what is wrong with it.
    """
    path = _existing("source", source)
    case = None if case is None else _existing("case", case)
    kilograms = _density(particle_density)
    if duration is not None and not (isinstance(duration, NUMBERS) and 0 < duration < np.inf):
        raise ImpactsError(f"Argument `duration` must be a number, positive and finite, but is {briefly(duration)}.")
    seconds = None if duration is None else float(duration)
    kind = _kind_of(path)
    of_text = {"ignore": tuple(ignore), "columns": columns, "sep": sep, "decimal": decimal}
    if kind != "named":
        if given := next((name for name, value in of_text.items() if value), ""):
            raise ImpactsError(f"{path}: is no table with named columns, so Argument `{given}` must be left out.")
        if kind == "fluent":
            return text_tables.open_fluent(path, kilograms, seconds)
        return text_tables.open_openfoam(path, case, named_density if kilograms is None else kilograms, seconds)
    with reading_impacts():
        of_text["columns"] = read_meanings(columns)
    return impact_tables.open_named(path, kilograms, seconds, named_density=named_density, **of_text)


_BEGINS = {"openfoam": rb"^#\s*Time\b", "fluent": rb"^\s*\(+\s*x\s+y\s+z\b.*\bdiameter\b"}
_KINDS = {".post": "openfoam", ".dpm": "fluent", ".csv": "named", **dict.fromkeys(ENDINGS, "named")}


def _kind_of(path: Path) -> str:
    """Which table it is, "openfoam", "fluent" or "named": by its name, or by what it begins with."""
    if path.is_dir():
        return "openfoam"
    if kind := _KINDS.get(Path(path.name.removesuffix(".gz").lower()).suffix):
        return kind
    with reading_impacts():
        if format_of(path) is not None:
            return "named"
        start = beginning(path)
    return next((kind for kind, line in _BEGINS.items() if re.search(line, start, re.MULTILINE)), "named")


def read_surface(
    source: str | Path,
    patch: str | Sequence[str] | None = None,
    *,
    unit: str | None = None,
) -> Surface:
    """Read the surface that particles hit.

    Args:
        source: an OpenFOAM case (its mesh in ASCII or binary, compressed or not), or a file `.vtp`, `.stl`, `.vtu` or
            `.vtm`.
        patch: one or more patches of the case; by default all walls. Or blocks of a `.vtm`, or solids of an `.stl`; by
            default all that have polygons.
        unit: of the coordinates, "mm"; a file needs it, unless it has a field `unit` (VTK). A case is in metres.

    Normals of a file may point to either side: `erosion_map` turns those of each connected part so that most of the
    particles come from the fluid.

    Raises:
        ImpactsError: a ValueError that names the file and what is wrong with it.
    """
    path = _existing("source", source)
    if unit is not None:
        metres_of(unit)
    if path.is_dir():
        if unit is not None:
            raise ImpactsError(f"{path}: is an OpenFOAM case, which is in metres: Argument `unit` must be left out.")
        case = case_of(path)
        return open_case(path if case is None else case).surface(patch)
    return open_surface(path, patch, unit)


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
        value = read_quantity(density, "density", None) if isinstance(density, str) else density
    if not isinstance(value, NUMBERS) or not 0 < value < np.inf:
        raise ImpactsError(
            f"Argument `particle_density` must be a number, positive and finite, but is {briefly(density)}."
        )
    return float(value)
