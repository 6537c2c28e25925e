"""Files of a map: for ParaView, for spreadsheets, and its Dataset."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from erosion.arguments import check_path
from erosion.cfd.map_result import FACES
from erosion.extras import library
from erosion.impacts import code_version, write_netcdf
from erosion.output import to_csv, write_whole

Identity = Callable[[], Mapping[str, str]]
"""Gives what a map depends on, in words; it may read the whole table."""


class MapFormat(NamedTuple):
    """A format that maps are written in.

    Args:
        write: writes a Dataset into a path, with its identity where the format has a place for it.
        holds_surface: whether it has no place for totals alone.
        is_drawn: whether it holds the picture.
    """

    write: Callable[[xr.Dataset, Path, Identity], None]
    holds_surface: bool = False
    is_drawn: bool = False


def write_map(dataset: xr.Dataset, path: str | Path, identity: Identity | None = None) -> Path:
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
    told = {str(name): str(value) for name, value in dataset.attrs.items()}
    MAP_FORMATS[path.suffix].write(dataset, path, identity or (lambda: {"version": code_version(), **told}))
    return path


def require_map_path(
    path: str | Path, *, has_surface: bool = True, formats: Mapping[str, MapFormat] | None = None
) -> Path:
    """The path of a map's file in one of the formats, `MAP_FORMATS` without any; errors as of `write_map`."""
    path, formats = check_path("path", path), MAP_FORMATS if formats is None else formats
    if path.suffix not in formats:
        raise ValueError(f"{path}: the name of a map's file must end in {', '.join(formats)}.")
    if formats[path.suffix].holds_surface and not has_surface:
        raise ValueError(f"{path}: a {path.suffix} file holds a surface, but there is none; a .csv file holds totals.")
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


def _write_polydata(dataset: xr.Dataset, path: Path, _: Identity) -> None:
    writer = library("vtkmodules.vtkIOXML", "cfd").vtkXMLPolyDataWriter()
    # VTK has words of its own for a full disk.
    writer.WriteToOutputStringOn()
    writer.SetInputData(to_polydata(dataset))
    writer.Write()
    write_whole(path, writer.GetOutputString().encode())


def _write_csv(dataset: xr.Dataset, path: Path, _: Identity) -> None:
    """A line for each face, or for each patch if there are no faces."""
    patches = dataset["patch"].values
    if "face" not in dataset.dims:
        columns, prefix = {"patch": list(patches)}, "patch_"
    else:
        columns, prefix = {"face": range(dataset.sizes["face"]), "patch": patches[dataset["face_patch"].values]}, ""
        columns |= {f"{axis} [m]": dataset["centre"].values[:, i].tolist() for i, axis in enumerate("xyz")}
    columns |= {name: values.tolist() for name, values in _columns(dataset, prefix).items()}
    write_whole(path, to_csv(columns).encode())


def _write_dataset(dataset: xr.Dataset, path: Path, identity: Identity) -> None:
    write_netcdf(dataset, path, identity())


MAP_FORMATS: Mapping[str, MapFormat] = {
    ".vtp": MapFormat(_write_polydata, holds_surface=True),
    ".csv": MapFormat(_write_csv),
    ".nc": MapFormat(_write_dataset),
}
"""By the ending of a file's name."""


def _columns(dataset: xr.Dataset, prefix: str) -> dict[str, np.ndarray]:
    """The columns of the variables that the map has, the depth first."""
    columns = {}
    for name in sorted(FACES, key=lambda name: name != "depth"):
        if prefix + name in dataset:
            wear, values = FACES[name], dataset[prefix + name].values
            columns[wear.heading] = values if wear.per_si == 1 else values * wear.per_si
    return columns
