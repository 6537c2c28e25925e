"""Surfaces from files of VTK and STL."""

import contextlib
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from erosion.cfd.impacts import ImpactsError
from erosion.cfd.surface import Surface
from erosion.extras import library

SUFFIXES = (".vtp", ".stl", ".vtu")
_STL_HEAD = 256  # bytes, of which VTK tells text from numbers as well
_POLYGONS = (5, 7, 9)  # VTK's numbers of triangle, polygon and quadrilateral


def open_surface(path: Path) -> Surface:
    """The polygons of a file; of a VTU those cells that are polygons.

    Raises:
        ImpactsError: for a file that cannot be read, or that holds no polygons.
    """
    pyvista = library("pyvista", "cfd")
    if path.suffix.lower() == ".stl":
        _require_whole_stl(path)
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
