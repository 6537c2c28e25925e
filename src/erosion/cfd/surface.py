"""A surface that particles hit, as polygons."""

import dataclasses
import functools
from typing import Any

import numpy as np
from scipy import sparse

from erosion.arguments import Indices, Numbers, Vectors
from erosion.cfd.rows import GREATEST, ImpactsError
from erosion.extras import library
from erosion.output.tables import briefly, first_of
from erosion.parameters.quantities import about, read_quantity

_SHARP = np.pi / 3
"""The angle between two faces from which on they are two walls, not facets of a curved one [rad]."""
_SAME_PLACE = 1e-5  # of the surface's length, within which two centres are one
_ROWS = 1 << 15  # whose distances are computed at once


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
        unit: that of the file, of which `points` are in metres.
        turned: whether the normals are against those of the file, shape (faces,), or of all faces.
        is_facing: whether the normals are known to point out of the fluid; else `erosion_map` turns those of each
            connected part so that most particles come from the fluid.

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
    unit: str = "m"
    turned: Any = False
    is_facing: bool = True

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

    def reversed(self, faces: Any = True) -> "Surface":
        """The same surface with the opposite normals, of all faces or of those of a mask."""
        starts = np.concatenate([[0], self.ends[:-1]])
        sizes = np.diff(self.ends, prepend=0)
        # Corner i of a face becomes its corner (size - 1 - i).
        mirrored = np.repeat(starts + self.ends - 1, sizes) - np.arange(len(self.corners))
        mask = np.repeat(np.broadcast_to(faces, self.faces), sizes)
        corners = self.corners[np.where(mask, mirrored, np.arange(len(mirrored)))]
        return dataclasses.replace(self, corners=corners, turned=np.not_equal(self.turned, faces))

    @functools.cached_property
    def parts(self) -> tuple[Indices, np.ndarray]:
        """The connected part of each face, and whether its normal disagrees with most of the part's area.

        Two faces agree where they run along the side that they share in opposite directions. Sides of three faces or
        more connect nothing.

        Raises:
            ImpactsError: naming faces of a part that has one side only, as a Möbius strip.
        """
        one, other, are_along = self._shared_sides
        # Each face twice, as it is and turned: a part falls into two, each of which is turned against the other.
        first = np.concatenate([one, one + self.faces])
        second = np.concatenate([other + are_along * self.faces, other + ~are_along * self.faces])
        graph = sparse.coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=[2 * self.faces] * 2)
        _, label = sparse.csgraph.connected_components(graph, directed=False)
        upright, turned = label[: self.faces], label[self.faces :]
        if (upright == turned).any():
            faces = ", ".join(first_of([*map(str, np.flatnonzero(upright == turned))], 3))
            raise ImpactsError(f"{self.title}: has one side only, as a Möbius strip: faces {faces}; mend them.")
        _, part = np.unique(np.minimum(upright, turned), return_inverse=True)
        is_turned = upright > turned
        areas = np.bincount(part, np.where(is_turned, self.area, -self.area))
        return part.reshape(-1), is_turned ^ (areas > 0)[part.reshape(-1)]

    def in_unit(self, unit: str) -> "Surface":
        """The surface of a file whose numbers are in this unit, in metres.

        Raises:
            ImpactsError: for what is no unit of length.
        """
        return dataclasses.replace(self, points=self.points * metres_of(unit), unit=unit)

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

    def distance(self, faces: Indices, positions: Vectors) -> Numbers:
        """The distance of each position from one face [m]."""
        face, *corners = self._triangles
        counts = np.bincount(face, minlength=self.faces)
        starts = np.cumsum(counts) - counts
        distances = np.zeros(len(faces))
        for first in range(0, len(faces), _ROWS):
            part = faces[first : first + _ROWS]
            begins = np.cumsum(counts[part]) - counts[part]
            # The triangles of a face stand side by side.
            triangle = np.repeat(starts[part] - begins, counts[part]) + np.arange(counts[part].sum())
            position = np.repeat(np.asarray(positions, float)[first : first + _ROWS], counts[part], axis=0)
            each = _to_triangles(position, *(corner[triangle] for corner in corners))
            distances[first : first + _ROWS] = np.minimum.reduceat(each, begins)
        return distances

    @functools.cached_property
    def doubled(self) -> Indices:
        """Faces that lie on another one, as both sides of a sheet do."""
        place = np.round(self.centre / (_SAME_PLACE * self.length)).astype(np.int64)
        _, which, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
        return np.flatnonzero(count[which.reshape(-1)] > 1)

    @functools.cached_property
    def box(self) -> tuple[Numbers, Numbers]:
        """The least and the greatest coordinates [m]."""
        used = self.points[self.corners]
        return used.min(axis=0), used.max(axis=0)

    @property
    def length(self) -> float:
        """From end to end, the diagonal of the box [m]."""
        low, high = self.box
        return float(np.linalg.norm(high - low))

    @functools.cached_property
    def width(self) -> float:
        """The area over the length [m], of a strip its width, of a pipe its circumference."""
        return float(self.area.sum()) / self.length

    @functools.cached_property
    def longest_side(self) -> Numbers:
        """Of each face, shape (faces,) [m]."""
        _, sides = self._sides
        return np.maximum.reduceat(sides, np.concatenate([[0], self.ends[:-1]]))

    @functools.cached_property
    def bulge(self) -> Numbers:
        """How far a curved wall may lie from each of its facets, 0 where the neighbours are in its plane, [m].

        A facet of width c that turns by θ against the next one is the chord of an arc, which is c/2 tan(θ/4) off it.
        Facets are not even, so it is twice as much here, and as much as that of the neighbours.
        """
        sizes = np.diff(self.ends, prepend=0)
        face = np.repeat(np.arange(self.faces), sizes)
        sides = self._sides[1]
        one, other, _, _ = self._beside
        cosine = np.einsum("ij,ij->i", self.normal[face[one]], self.normal[face[other]])
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        angle[angle > _SHARP] = 0.0
        # A triangle is as high over its side as a rectangle of twice its area.
        width = np.where(sizes == 3, 2, 1)[face] * self.area[face] / sides
        own = np.zeros(self.faces)
        for side in (one, other):
            np.maximum.at(own, face[side], width[side] * np.tan(angle / 4))
        bulge = own.copy()
        for side, beside in ((one, other), (other, one)):
            np.maximum.at(bulge, face[side], np.where(angle > 0, own[face[beside]], 0.0))
        return bulge

    @functools.cached_property
    def _sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the side that begins at each corner, the corner at which it ends, and its length [m]."""
        following = np.arange(len(self.corners)) + 1
        following[self.ends - 1] = np.concatenate([[0], self.ends[:-1]])
        used = self.points[self.corners]
        return following, np.linalg.norm(used[following] - used, axis=1)

    @functools.cached_property
    def _beside(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of sides of the same ends, by the corners where they begin: whether they run alike, and alone."""
        following, _ = self._sides
        # Files may repeat a point for each of its faces.
        points = np.unique(self.points[self.corners], axis=0, return_inverse=True)[1].reshape(-1)
        ends = np.stack([points, points[following]])
        order = np.lexsort(np.sort(ends, axis=0))
        shared = (np.diff(np.sort(ends[:, order], axis=0), axis=1) == 0).all(axis=0)
        alone = shared & ~np.append(shared[1:], False) & ~np.insert(shared[:-1], 0, False)
        one, other = order[:-1][shared], order[1:][shared]
        return one, other, points[one] == points[other], alone[shared]

    @property
    def _shared_sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of faces that alone share a side, and whether they run along it in the same direction."""
        face = np.repeat(np.arange(self.faces), np.diff(self.ends, prepend=0))
        one, other, are_along, alone = self._beside
        return face[one[alone]], face[other[alone]], are_along[alone]

    @functools.cached_property
    def _triangles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Face and three corners of each triangle: a triangle is itself, another polygon has one to a side."""
        sizes = np.diff(self.ends, prepend=0)
        starts = self.ends - sizes
        face = np.repeat(np.arange(self.faces), sizes)
        following, _ = self._sides
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


def metres_of(unit: str) -> float:
    """The metres of a unit of length, such as "mm".

    Raises:
        ImpactsError: for what is no unit of length.
    """
    if not (isinstance(unit, str) and any(letter.isalpha() for letter in unit)):
        raise ImpactsError(f"Argument `unit` must be a unit of length such as 'mm', but is {briefly(unit)}.")
    with about("Argument `unit`", ImpactsError):
        metres = read_quantity(unit if unit[:1].isdigit() else f"1 {unit}", "length", "si")
    if not 0 < metres <= GREATEST:
        raise ImpactsError(f"Argument `unit` must be a unit of length such as 'mm', but is {briefly(unit)}.")
    return metres


def _to_triangles(position: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The distance of each position from a triangle; all of shape (rows, 3)."""
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    sides = ((a, b), (b, c), (c, a))
    inside = area > 0
    for begin, end in sides:
        inside &= np.einsum("ij,ij->i", np.cross(end - begin, position - begin), normal) >= 0
    height = np.abs(np.einsum("ij,ij->i", position - a, normal))
    plane = np.divide(height, area, out=np.zeros(len(area)), where=inside)
    return np.where(inside, plane, np.min([_to_side(position, *side) for side in sides], axis=0))


def _to_side(position: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    side = end - begin
    square = np.einsum("ij,ij->i", side, side)
    along = np.einsum("ij,ij->i", position - begin, side)
    share = np.clip(np.divide(along, square, out=np.zeros(len(square)), where=square > 0), 0.0, 1.0)
    return np.linalg.norm(position - begin - share[:, None] * side, axis=1)


def _sums(face: np.ndarray, vectors: np.ndarray, faces: int) -> np.ndarray:
    return np.stack([np.bincount(face, vectors[:, i], faces) for i in range(3)], axis=1)
