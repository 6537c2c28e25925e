"""Surfaces in STL files, text or binary."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.rows import ImpactsError
from erosion.extras import library

_HEAD = 256  # bytes by which text and binary files differ
_HEADER = 80  # bytes before the number of facets of a binary file
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SOLID = re.compile(rb"^[ \t]*solid\b[ \t]*([^\r\n]*)", re.IGNORECASE | re.MULTILINE)
_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+([^\r\n]+)", re.IGNORECASE | re.MULTILINE)
_FACET_END = re.compile(rb"^[ \t]*end[ \t]*facet\b", re.IGNORECASE | re.MULTILINE)
_SOLID_END = re.compile(rb"^[ \t]*end[ \t]*solid\b", re.IGNORECASE | re.MULTILINE)


def read_solids(path: Path) -> dict[str, Any]:
    """The triangles of an STL file by the names of its solids; those of a single one by the name of the file.

    Triangles with two corners in one point are left out.

    Raises:
        ImpactsError: for a file that was cut off, or that is no STL file.
    """
    content = path.read_bytes()
    # Binary files may begin with "solid", too.
    is_text = b"\0" not in content[:_HEAD] and _SOLID.match(content)
    solids = _of_text(path, content) if is_text else {path.stem: _of_numbers(path, content)}
    if len(solids) == 1:
        solids = dict.fromkeys([path.stem], *solids.values())
    polydata = library("pyvista", "cfd").PolyData
    return {name: polydata.from_regular_faces(*_connected(corners)) for name, corners in solids.items() if len(corners)}


def _of_text(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """The corners of the triangles of each solid, shape (triangles, 3, 3); solids of one name are joined."""
    _, *parts = _SOLID.split(content)
    solids = dict[str, list[np.ndarray]]()
    for name, part in zip(parts[::2], parts[1::2], strict=True):
        try:
            corners = np.array(b" ".join(_VERTEX.findall(part)).split(), float)
        except ValueError as error:
            raise ImpactsError(f"{path}: cannot be read; it is damaged, or no .stl file: {error}.") from error
        facets = len(_FACET_END.findall(part))
        if corners.size != 9 * facets or not _SOLID_END.search(part):
            raise ImpactsError(
                f"{path}: cannot be read; it is damaged, or no .stl file: its solid {name.decode(errors='replace')!r} "
                f"has {facets:,} whole facets, but {corners.size:,} coordinates, and "
                f"{'an' if _SOLID_END.search(part) else 'no'} end."
            )
        solids.setdefault(name.decode(errors="replace").strip() or path.stem, []).append(corners.reshape(-1, 3, 3))
    return {name: np.concatenate(its) for name, its in solids.items()}


def _of_numbers(path: Path, content: bytes) -> np.ndarray:
    """The corners of the triangles of a binary file, shape (triangles, 3, 3)."""
    start, size = _HEADER + 4, len(content)
    facets = int.from_bytes(content[_HEADER:start], "little")
    if size != start + _FACET.itemsize * facets:
        raise ImpactsError(
            f"{path}: cannot be read; it is damaged, or no .stl file: a binary one of its {size:,} bytes has "
            f"{max(size - start, 0) / _FACET.itemsize:,.6g} facets, but it says that it has {facets:,}."
        )
    return np.frombuffer(content, _FACET, offset=start)["corners"].astype(float)


def _connected(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points, each once, and the triangles between three of them."""
    points, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = number.reshape(-1, 3)
    has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return points, triangles[has_area]
