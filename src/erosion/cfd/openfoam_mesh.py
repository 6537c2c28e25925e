"""Meshes of OpenFOAM: patches as surfaces, and the faces of the whole mesh by those of a processor's part."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.impacts import ImpactsError
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

    def has(self, mesh_faces: np.ndarray) -> np.ndarray:
        """Whether each face of the mesh is of this patch."""
        return (mesh_faces >= self.start) & (mesh_faces < self.start + self.faces)


@dataclasses.dataclass(frozen=True)
class Mesh:
    """The mesh of a case; its files are read when they are needed."""

    case: Path

    @functools.cached_property
    def patches(self) -> dict[str, Patch]:
        """Its patches by name.

        Raises:
            ImpactsError: where the mesh's file cannot be read.
        """
        path, entries = self._read("boundary")
        try:
            return {
                name: Patch(str(entry["type"]), int(entry["startFace"]), int(entry["nFaces"]))
                for name, entry in dict(entries).items()
            }
        except (TypeError, ValueError, KeyError) as error:
            raise ImpactsError(f"{path}: is no list of patches.") from error

    @functools.cached_property
    def faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each face's corners end, and the corners of all faces."""
        path, content = self._read("faces")
        try:
            if isinstance(content, tuple):
                starts, corners = content
                return _labels(starts)[1:], _labels(corners)
            sizes = np.fromiter(map(len, content), np.int64, len(content))
            return np.cumsum(sizes), np.concatenate([np.zeros(0, np.int64), *content]).astype(np.int64, copy=False)
        except (TypeError, ValueError) as error:
            raise ImpactsError(f"{path}: is no list of faces.") from error

    @functools.cached_property
    def processors(self) -> dict[int, np.ndarray]:
        """The number of each face of a processor's part in the whole mesh, by processor; empty for a serial case."""
        addressing = {}
        for folder in self.case.glob("processor[0-9]*"):
            if not folder.name.removeprefix("processor").isdecimal():
                continue
            path = folder / _MESH / _ADDRESSING
            if not _present(path):
                continue
            # The numbers start at 1; a negative one says that the face is turned round.
            addressing[int(folder.name.removeprefix("processor"))] = np.abs(_labels(_content(path))) - 1
        return addressing

    def surface(self, patch: str | Sequence[str] | None) -> Surface:
        """One or more patches, by default all walls.

        Raises:
            ImpactsError: naming the patches of the mesh, for one that is not among them.
        """
        names = self._chosen(patch)
        points = self._points()
        ends, corners = self.faces
        numbers = np.concatenate([np.arange(p.start, p.start + p.faces) for p in map(self.patches.__getitem__, names)])
        if len(numbers) and numbers.max() >= len(ends):
            raise ImpactsError(f"{self.case / _MESH}: has {len(ends)} faces, but its patches have more.")
        sizes = np.diff(ends, prepend=0)[numbers]
        own_ends = np.cumsum(sizes)
        own_corners = corners[np.repeat(ends[numbers] - own_ends, sizes) + np.arange(sizes.sum())]
        used, own_corners = np.unique(own_corners, return_inverse=True)
        if len(used) and used[-1] >= len(points):
            raise ImpactsError(f"{self.case / _MESH}: has {len(points)} points, but its faces name more.")
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
        path, content = self._read("points")
        points = np.asarray(content, float)
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

    def _read(self, name: str) -> tuple[Path, Any]:
        path = self.case / _MESH / name
        return path, _content(path)


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


def _labels(numbers: Any) -> np.ndarray:
    """Whole numbers; foamlib takes those of 64 bits in a binary file for floating point numbers."""
    numbers = np.asarray(numbers)
    return numbers.view(np.int64) if numbers.dtype == np.float64 else numbers.astype(np.int64)


def _present(path: Path) -> bool:
    return path.is_file() or _stored(path).is_file()


def _stored(path: Path) -> Path:
    compressed = path.with_name(f"{path.name}.gz")
    return compressed if compressed.is_file() and not path.is_file() else path


def _content(path: Path) -> Any:
    """What a file of OpenFOAM holds beside its header."""
    foamlib, stored = library("foamlib", "cfd"), _stored(path)
    try:
        return foamlib.FoamFile(stored)[None]
    except FileNotFoundError as error:
        raise ImpactsError(f"{path}: is not there.") from error
    except (OSError, EOFError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImpactsError(f"{stored}: cannot be read as a file of OpenFOAM ({reason[:120]}).") from error
