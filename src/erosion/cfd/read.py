"""Open tables of impacts and surfaces by the kind of their files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import check_path
from erosion.cfd import fluent, named_columns, openfoam_impacts, surface_files
from erosion.cfd.impacts import Impacts, ImpactsError
from erosion.cfd.openfoam_mesh import case_of, open_case
from erosion.cfd.surface import Surface, metres_of
from erosion.parameters.units import about, read_quantity

_IMPACTS = ".post, .dat, .dpm, .csv or .parquet"
_SURFACES = ".vtp, .stl or .vtu"


def read_impacts(
    source: str | Path,
    case: str | Path | None = None,
    *,
    particle_density: float | int | str | None = None,
    duration: float | int | None = None,
    ignore: Sequence[str] = (),
) -> Impacts:
    """Open a table of impacts of a CFD run.

    Only headers are read here; the rows are read in blocks where they are used, so that memory does not grow with their
    number.

        impacts = erosion.read_impacts("bend/postProcessing/lagrangian/sand/impacts")
        surface = erosion.read_surface("bend", patch="wall")
        dataset = erosion.erosion_map("rotating", p, impacts, surface)

    Formats, by the name of the file, which may also end in ".gz" where it is text:

    - `.post`, `.dat`: OpenFOAM's function objects `patchPostProcessing` and `particlePostProcessing`; a file, the
      folder of a function object with all its windows of time, or a case that has one. Columns are found by the header.
    - `.dpm`: a sample of Fluent. Of a steady run the rows are what hits within `duration`.
    - `.csv`, `.parquet`: columns `diameter [um]`; `mass [ug]` or `density [kg/m^3]`; `velocity_x [m/s]`, `velocity_y`,
      `velocity_z`, or `speed [m/s]` and `angle [deg]`; at will one of `count`, `parcel_mass [kg]`, and of a steady run
      `mass_flow [kg/s]`, `frequency [1/s]`; `position_x [m]`, …, `face` (of the surface) or `mesh_face` (of the mesh),
      from 0, `spin [rad/s]`, `time [s]`. A Parquet file may hold units in its columns' metadata (`units`). A column
      that may be one of these, but is not understood, is refused; `notes` of the result names those that are left out.

    A table without weights counts each row as one particle; `notes` of the result says so.

    Args:
        source: a file or folder.
        case: the OpenFOAM case whose mesh the faces belong to; by default the one in which `source` lies.
        particle_density: of the particles, where no column gives it: a number [kg/m³], or "2.65 g/cm^3".
        duration: time that the table covers [s], where it does not say it or says it wrongly.
        ignore: columns of a CSV or Parquet file that are left out, by their names: ("frequency",).

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
    if ignore and not named_columns.is_named(path):
        raise ImpactsError(
            f"{path}: is no table with named columns (.csv, .parquet), so Argument `ignore` must be left out."
        )
    if path.is_dir() or openfoam_impacts.is_table(path):
        return openfoam_impacts.open_openfoam(path, case, kilograms, seconds)
    if named_columns.is_named(path):
        return named_columns.open_named(path, kilograms, seconds, ignore)
    if path.name.removesuffix(".gz").endswith(fluent.SUFFIXES):
        return fluent.open_fluent(path, kilograms, seconds)
    raise ImpactsError(f"{path}: is no table of impacts; its name must end in {_IMPACTS}.")


def read_surface(
    source: str | Path,
    patch: str | Sequence[str] | None = None,
    *,
    unit: str | None = None,
    reverse: bool = False,
) -> Surface:
    """Read the surface that particles hit.

    Args:
        source: an OpenFOAM case (its mesh in ASCII or binary, compressed or not), or a file `.vtp`, `.stl` or `.vtu`.
        patch: one or more patches of the case; by default all of type wall.
        unit: of the coordinates, "mm"; by default they are in metres, and `erosion_map` compares them with the
            positions of impacts.
        reverse: whether to turn the normals round, for a file whose normals point into the fluid. OpenFOAM's point
            out of it. Where nearly all impacts come from behind, `erosion_map` says it.

    Raises:
        ImpactsError: a ValueError that names the file and what is wrong with it.
    """
    path = _existing("source", source)
    if unit is not None:
        metres_of(unit)
    if path.is_dir():
        case = case_of(path)
        surface = open_case(path if case is None else case).surface(patch)
    elif path.suffix.lower() in surface_files.SUFFIXES:
        if patch is not None:
            raise ImpactsError(f"{path}: has no patches, so Argument `patch` must be left out.")
        surface = surface_files.open_surface(path)
    else:
        raise ImpactsError(f"{path}: is no surface; it must be an OpenFOAM case, or its name must end in {_SURFACES}.")
    surface = surface.in_unit(unit)
    return surface.reversed() if reverse else surface


def _existing(name: str, value: Any) -> Path:
    path = check_path(name, value)
    if not path.exists():
        raise ImpactsError(f"{path}: is not there.")
    if not (path.is_file() or path.is_dir()):  # a pipe waits for its writer
        raise ImpactsError(f"{path}: is no file.")
    return path


def _density(density: float | int | str | None) -> float | None:
    if density is None:
        return None
    with about("Argument `particle_density`", ImpactsError):
        value = read_quantity(density, "density", "si") if isinstance(density, str) else float(density)
    if not (np.isfinite(value) and value > 0):
        raise ImpactsError(f"Argument `particle_density` must be positive and finite, but is {density!r}.")
    return value
