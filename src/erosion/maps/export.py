"""Maps in files: VTP for ParaView, CSV, netCDF."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import check_path
from erosion.extras import library
from erosion.files import write_whole
from erosion.maps.result import FACES
from erosion.parameters.units import conversion_factor
from erosion.storage.identity import code_version
from erosion.storage.netcdf import write_netcdf
from erosion.tables import to_csv

SUFFIXES = (".vtp", ".csv", ".nc")


# By variable its heading, and the SI unit over the file's. The units fit to the surface, which is in metres, whatever
# those of the case are. ASCII, as ParaView's filters are.
_COLUMNS: Mapping[str, tuple[str, float]] = {
    "depth": ("depth [mm]", 1e3),
    "volume": ("volume [mm^3]", 1e9),
    "mass": ("mass [kg]", 1.0),
    "depth_rate": ("depth rate [m/s]", 1.0),
    "depth_per_year": ("depth rate [mm/year]", 1.0),
    "mass_flux": ("mass flux [kg/(m^2 s)]", 1.0),
    "erosion": ("erosion [mm^3/kg]", 1e9),
    "erosion_ratio": ("erosion ratio [kg/kg]", 1.0),
    "erodent": ("erodent [kg]", 1.0),
    "impacts": ("impacts", 1.0),
    "particles": ("particles", 1.0),
    "alpha_mean": ("mean angle [deg]", 180 / math.pi),
    "v0_mean": ("mean speed [m/s]", 1.0),
    "relative_error": ("relative standard error", 1.0),
    "sampling_error": ("relative error by sampling", 1.0),
    "parameter_error": ("relative error by parameters", 1.0),
    "area": ("area [mm^2]", 1e6),
}


def write_map(dataset: xr.Dataset, path: str | Path, identity: Mapping[str, str] | None = None) -> Path:
    """Write a map into a file; an existing one is replaced.

    Args:
        dataset: what `erosion_map` returns.
        path: `….vtp`, which ParaView opens: the surface in metres, with the wear of each face. `….csv`: a line for
            each face, or for all if there is no surface. `….nc`: the Dataset, with its identity.
        identity: of a netCDF file; without it the version and what the Dataset says of its origin.

    Raises:
        ValueError: for another suffix, and for a VTP file of a map without a surface.
        OSError: where the file cannot be written.
    """
    path = require_map_path(path, has_surface="face" in dataset.dims)
    if path.suffix == ".vtp":
        _write_vtp(dataset, path)
    elif path.suffix == ".csv":
        write_whole(path, _as_csv(dataset).encode())
    else:
        told = {str(name): str(value) for name, value in dataset.attrs.items()}
        write_netcdf(dataset, path, identity or {"version": code_version(), **told})
    return path


def require_map_path(path: str | Path, *, has_surface: bool = True) -> Path:
    """The path of a map's file; errors as of `write_map`."""
    path = check_path("path", path)
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: the name of a map's file must end in {', '.join(SUFFIXES)}.")
    if path.suffix == ".vtp" and not has_surface:
        raise ValueError(f"{path}: a .vtp file holds a surface, but there is none; a .csv file holds totals.")
    return path


def to_polydata(dataset: xr.Dataset) -> Any:
    """The surface of a map as pyvista's `PolyData`, with names and units in the names of the arrays.

    Raises:
        MissingExtraError: where pyvista is not installed.
    """
    points, corners, ends = (dataset[name].values for name in ("point", "corner", "corner_end"))
    sizes = np.diff(ends, prepend=0)
    # VTK's list of faces has the number of corners before each face's corners.
    cells = np.insert(corners, ends - sizes, sizes)
    surface = library("pyvista", "cfd").PolyData(points, faces=cells)
    for name, values in _columns(dataset, "").items():
        surface.cell_data[name] = values
    surface.cell_data["patch"] = dataset["face_patch"].values
    if "mesh_face" in dataset:
        surface.cell_data["mesh face"] = dataset["mesh_face"].values
    told = {str(name): [str(value)] for name, value in dataset.attrs.items() if value}
    told["patches"] = [str(name) for name in dataset["patch"].values]
    for name, texts in told.items():
        surface.field_data[name] = [text.encode("ascii", "backslashreplace").decode() for text in texts]
    return surface


def _columns(dataset: xr.Dataset, prefix: str) -> dict[str, np.ndarray]:
    """The columns of the variables that the map has."""
    units, columns = dataset.attrs["unit_system"], {}
    for name, (heading, size) in _COLUMNS.items():
        if prefix + name in dataset:
            factor = conversion_factor(FACES[name].dimension, units, "si") * size
            values = dataset[prefix + name].values
            columns[heading] = values if factor == 1 else values * factor
    return columns


def _write_vtp(dataset: xr.Dataset, path: Path) -> None:
    surface = to_polydata(dataset)
    writer = library("vtkmodules.vtkIOXML", "cfd").vtkXMLPolyDataWriter()
    # VTK has words of its own for a full disk.
    writer.WriteToOutputStringOn()
    writer.SetInputData(surface)
    writer.Write()
    write_whole(path, writer.GetOutputString().encode())


def _as_csv(dataset: xr.Dataset) -> str:
    """A line for each face, or for each patch if there are no faces."""
    patches = dataset["patch"].values
    columns: dict[str, Any] = {}
    prefix = "" if "face" in dataset.dims else "patch_"
    if not prefix:
        columns["face"] = range(dataset.sizes["face"])
        columns["patch"] = [patches[i] for i in dataset["face_patch"].values]
        columns |= {f"{axis} [m]": dataset["centre"].values[:, i].tolist() for i, axis in enumerate("xyz")}
    else:
        columns["patch"] = list(patches)
    return to_csv(columns | {name: values.tolist() for name, values in _columns(dataset, prefix).items()})
