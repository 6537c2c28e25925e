"""A surface that particles hit, as polygons."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float, Int


@dataclasses.dataclass(frozen=True)
class Surface:
    """A surface of polygons whose normals point out of the fluid, into the target; `erosion.read_surface` reads one.

    Args:
        title: file and patches, for messages and titles.
        points: shape (points, 3) [m].
        corners: indices of points, face after face, around each face, shape (corners,).
        ends: where each face's corners end in `corners`, shape (faces,).
        patches: names of patches.
        patch: of each face, an index of `patches`, shape (faces,).
        mesh_face: number of each face in the mesh of the CFD run, shape (faces,); None where there is none.
    """

    title: str
    points: Float[np.ndarray, "points 3"]
    corners: Int[np.ndarray, " corners"]
    ends: Int[np.ndarray, " faces"]
    patches: tuple[str, ...]
    patch: Int[np.ndarray, " faces"]
    mesh_face: Int[np.ndarray, " faces"] | None = None

    @property
    def faces(self) -> int:
        """The number of faces."""
        return len(self.ends)

    @functools.cached_property
    def centre(self) -> Float[np.ndarray, "faces 3"]:
        """The centroid of each face, shape (faces, 3) [m]."""
        raise NotImplementedError

    @functools.cached_property
    def area_vector(self) -> Float[np.ndarray, "faces 3"]:
        """The normal of each face times its area, shape (faces, 3) [m²]."""
        raise NotImplementedError

    @property
    def area(self) -> Float[np.ndarray, " faces"]:
        """Shape (faces,) [m²]."""
        return np.linalg.norm(self.area_vector, axis=1)

    @property
    def normal(self) -> Float[np.ndarray, "faces 3"]:
        """The unit normal of each face, out of the fluid, shape (faces, 3)."""
        return self.area_vector / self.area[:, None]

    def face_of_mesh(self, mesh_face: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
        """The surface's face of each face of the mesh, -1 for faces that are not of the surface."""
        raise NotImplementedError

    def nearest(
        self, positions: Float[np.ndarray, "rows 3"]
    ) -> tuple[Int[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
        """The face nearest to each position, and its distance [m]."""
        raise NotImplementedError
