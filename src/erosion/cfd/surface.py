"""A surface that particles hit, as polygons."""

import dataclasses
import functools
from typing import Any

import numpy as np

from erosion.array_types import Indices, Numbers, Vectors
from erosion.cfd.impacts import ImpactsError
from erosion.cfd.rows import GREATEST
from erosion.extras import library


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A surface of polygons whose normals point out of the fluid, into the target; `erosion.read_surface` reads one.

    A polygon that is not plane is taken as the triangles between its sides and the mean of its corners, as OpenFOAM
    takes it.

    Args:
        title: file and patches, for messages and titles.
        points: shape (points, 3) [m].
        corners: indices of points, face after face, around each face, shape (corners,).
        ends: where each face's corners end in `corners`, shape (faces,).
        patches: names of patches.
        patch: of each face, an index of `patches`, shape (faces,).
        mesh_face: number of each face in the mesh of the CFD run, shape (faces,); None where there is none.

    Raises:
        ImpactsError: for a surface without faces, coordinates that are not finite, corners that are no points, and
            faces without an area.
    """

    title: str
    points: Vectors
    corners: Indices
    ends: Indices
    patches: tuple[str, ...]
    patch: Indices
    mesh_face: Indices | None = None

    def __post_init__(self) -> None:
        if not self.faces:
            raise ImpactsError(f"{self.title}: has no faces.")
        if self.corners.min() < 0 or self.corners.max() >= len(self.points):
            raise ImpactsError(f"{self.title}: has faces with corners that are none of its {len(self.points)} points.")
        if np.diff(self.ends, prepend=0).min() < 3:
            face = int(np.argmin(np.diff(self.ends, prepend=0)))
            raise ImpactsError(f"{self.title}: face {face} has fewer than three corners.")
        if not (np.abs(self.points[self.corners]) <= GREATEST).all():
            raise ImpactsError(f"{self.title}: has points whose coordinates are not finite, or above {GREATEST:g} m.")
        if not self.area.all():
            faces = np.flatnonzero(self.area == 0)
            raise ImpactsError(f"{self.title}: {len(faces)} faces have no area, the first is face {faces[0]}.")

    @property
    def faces(self) -> int:
        """The number of faces."""
        return len(self.ends)

    @functools.cached_property
    def centre(self) -> Vectors:
        """The centroid of each face, shape (faces, 3) [m]."""
        face, a, b, c = self._triangles
        # Where a side is re-entrant, its triangle has a negative area.
        areas = np.einsum("ij,ij->i", np.cross(b - a, c - a), self.normal[face])
        weighted = _sums(face, (a + b + c) / 3 * areas[:, None], self.faces)
        return weighted / np.bincount(face, areas, self.faces)[:, None]

    @functools.cached_property
    def area_vector(self) -> Vectors:
        """The normal of each face times its area, shape (faces, 3) [m²]."""
        face, a, b, c = self._triangles
        return _sums(face, np.cross(b - a, c - a) / 2, self.faces)

    @property
    def area(self) -> Numbers:
        """Shape (faces,) [m²]."""
        return np.linalg.norm(self.area_vector, axis=1)

    @property
    def normal(self) -> Vectors:
        """The unit normal of each face, out of the fluid, shape (faces, 3)."""
        return self.area_vector / self.area[:, None]

    def reversed(self) -> "Surface":
        """The same surface with the opposite normals."""
        starts = np.concatenate([[0], self.ends[:-1]])
        sizes = np.diff(self.ends, prepend=0)
        # Corner i of a face becomes its corner (size - 1 - i).
        mirrored = np.repeat(starts + self.ends - 1, sizes) - np.arange(len(self.corners))
        return dataclasses.replace(self, corners=self.corners[mirrored])

    def face_of_mesh(self, mesh_face: Indices) -> Indices:
        """The surface's face of each face of the mesh, -1 for faces that are not of the surface.

        Raises:
            ImpactsError: for a surface that is of no mesh.
        """
        if self.mesh_face is None:
            raise ImpactsError(f"{self.title}: does not say which faces of the mesh of the CFD run its faces are.")
        numbers, faces = self._sorted_mesh_faces
        at = np.minimum(np.searchsorted(numbers, mesh_face), len(numbers) - 1)
        return np.where(numbers[at] == mesh_face, faces[at], -1)

    def nearest(self, positions: Vectors) -> tuple[Indices, Numbers]:
        """The face nearest to each position, and its distance [m]."""
        triangles, points = self._for_vtk.find_closest_cell(np.asarray(positions, float), return_closest_point=True)
        return self._triangles[0][triangles], np.linalg.norm(points - positions, axis=1)

    @functools.cached_property
    def _triangles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Face and three corners of each triangle: a triangle is itself, another polygon has one to a side."""
        sizes = np.diff(self.ends, prepend=0)
        starts = self.ends - sizes
        face = np.repeat(np.arange(self.faces), sizes)
        following = np.arange(len(self.corners)) + 1
        following[self.ends - 1] = starts
        a, b = self.points[self.corners], self.points[self.corners[following]]
        middle = np.add.reduceat(a, starts) / sizes[:, None]
        # The first side of a triangle with its third corner is the triangle.
        kept = (sizes[face] > 3) | (np.arange(len(self.corners)) == starts[face])
        third = np.where((sizes == 3)[:, None], self.points[self.corners[self.ends - 1]], middle)
        return face[kept], a[kept], b[kept], third[face[kept]]

    @functools.cached_property
    def _sorted_mesh_faces(self) -> tuple[np.ndarray, np.ndarray]:
        assert self.mesh_face is not None
        order = np.argsort(self.mesh_face, kind="stable")
        return self.mesh_face[order], order

    @functools.cached_property
    def _for_vtk(self) -> Any:
        """The triangles for VTK, which keeps its tree of cells with them.

        VTK takes polygons too, but their sides are exact only to 1e-4 of their length.
        """
        _, *corners = self._triangles
        cells = np.arange(3 * len(corners[0])).reshape(3, -1).T
        return library("pyvista", "cfd").PolyData.from_regular_faces(np.concatenate(corners), cells)


def _sums(face: np.ndarray, vectors: np.ndarray, faces: int) -> np.ndarray:
    return np.stack([np.bincount(face, vectors[:, i], faces) for i in range(3)], axis=1)
