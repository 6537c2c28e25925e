"""Surfaces in files, in any size, and rows on them, for tests of what lies where."""

from pathlib import Path

import numpy as np
import pyvista

from erosion.cfd.surface import Surface
from tests.cfd.tables import Table, hump, quadrilaterals

HEAD = "FoamFile {{ version 2.0; format ascii; class {}; object x; }}\n"


def polygons(points: np.ndarray, corners: np.ndarray) -> Surface:
    """Faces of equally many corners; corners of shape (faces, corners)."""
    faces, sides = corners.shape
    ends = sides * np.arange(1, faces + 1)
    return Surface("part", points, corners.ravel(), ends, ("wall",), np.zeros(faces, np.int64))


def plate(length: float = 0.137, cells: int = 12) -> Surface:
    """In the plane z = 0 about the origin, below a fluid: in any other size it lies in the same plane."""
    x, y = np.meshgrid(*[np.linspace(-length / 2, length / 2, cells + 1)] * 2, indexing="ij")
    return quadrilaterals(np.stack([x, y, 0 * x], axis=-1))


def pipe(around: int = 24, along: int = 16, radius: float = 0.02, length: float = 0.137) -> Surface:
    """Along x, the fluid within, so that normals point away from the axis."""
    turn, x = 2 * np.pi * np.arange(around) / around, np.linspace(0, length, along + 1)[:, None]
    points = np.stack([*np.broadcast_arrays(x, radius * np.cos(turn), radius * np.sin(turn))], axis=-1)
    return quadrilaterals(points, closed=True, first=1)


PARTS = {"plate": plate(), "pipe": pipe(), "hump": hump()}


def write(surface: Surface, path: Path, scale: float = 1.0) -> Path:
    """An STL or VTP file, or the folder of an OpenFOAM case."""
    points = surface.points * scale
    if path.suffix:
        cells = np.insert(surface.corners, surface.ends - 4, 4)
        mesh = pyvista.PolyData(points, faces=cells)
        (mesh.triangulate() if path.suffix == ".stl" else mesh).save(path)
        return path
    mesh = path / "constant" / "polyMesh"
    mesh.mkdir(parents=True)
    listed = "\n".join(f"({x!r} {y!r} {z!r})" for x, y, z in points.tolist())
    (mesh / "points").write_text(f"{HEAD.format('vectorField')}{len(points)}(\n{listed})\n")
    faces = "\n".join(f"4({' '.join(map(str, face))})" for face in surface.corners.reshape(-1, 4).tolist())
    (mesh / "faces").write_text(f"{HEAD.format('faceList')}{surface.faces}(\n{faces})\n")
    wall = f"1(wall {{type wall; nFaces {surface.faces}; startFace 0;}})\n"
    (mesh / "boundary").write_text(HEAD.format("polyBoundaryMesh") + wall)
    return path


def rows_on(surface: Surface, rows: int = 400, seed: int = 0) -> Table:
    """Quartz of 50 µm at random places of the surface at 30 m/s and 30°, with positions and without faces."""
    rng = np.random.default_rng(seed)
    face = np.arange(rows) % surface.faces
    corner = surface.points[surface.corners.reshape(surface.faces, -1)[face]]
    share = rng.dirichlet(np.ones(3), rows)
    half = rng.random(rows) < 0.5
    triangle = np.where(half[:, None, None], corner[:, [0, 1, 2]], corner[:, [0, 2, 3]])
    normal = surface.normal[face]
    along = np.cross(normal, [0.3, 1.0, 0.2])
    along /= np.linalg.norm(along, axis=1)[:, None]
    velocity = 30.0 * (np.sin(0.52) * normal + np.cos(0.52) * along)
    diameter = np.full(rows, 5e-5)
    return Table(
        duration=1.0, count=np.full(rows, 10.0), mass=2650 * np.pi / 6 * diameter**3, diameter=diameter,
        velocity=velocity, position=np.einsum("ij,ijk->ik", share, triangle),
    )  # fmt: skip
