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
_POLYGONS = (5, 7, 9)  # VTK's numbers of triangle, polygon and quadrilateral


def open_surface(path: Path) -> Surface:
    """The polygons of a file; of a VTU those cells that are polygons.

    Raises:
        ImpactsError: for a file that cannot be read, or that holds no polygons.
    """
    pyvista = library("pyvista", "cfd")
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
