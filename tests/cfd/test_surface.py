"""Polygons in space: centroids, areas, normals, the faces of a mesh, and the face nearest to a point."""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cfd.rows import ImpactsError
from erosion.cfd.surface import Surface
from tests.cfd.parts import PARTS, rows_on, write

P = erosion.TABLE_1.to("si")

TRIANGLE = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0)]
# In the plane x = 1, an L of three squares of side 1, its normal along +x.
ELL = [(1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (1.0, 2.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0, 2.0), (1.0, 0.0, 2.0)]
# In the plane y = 5, its normal along -y.
TRAPEZIUM = [(0.0, 5.0, 0.0), (4.0, 5.0, 0.0), (3.0, 5.0, 1.0), (1.0, 5.0, 1.0)]


# A square of side 4 without the triangle (4, 0), (4, 4), (0.5, 2): area 16 - 7, centroid by the difference.
NOTCH = [(0, 0, 0), (4, 0, 0), (0.5, 2, 0), (4, 4, 0), (0, 4, 0)]


def surface(*polygons, **fields):
    points = np.array([point for polygon in polygons for point in polygon], float).reshape(-1, 3)
    return Surface(
        title="wall",
        points=points,
        corners=np.arange(len(points)),
        ends=np.cumsum([len(polygon) for polygon in polygons], dtype=int),
        patches=("wall",),
        patch=np.zeros(len(polygons), int),
        **fields,
    )


def test_centroids_areas_and_normals_of_plane_polygons():
    wall = surface(TRIANGLE, ELL, TRAPEZIUM, NOTCH)
    np.testing.assert_allclose(wall.area, [4.5, 3, 3, 9], rtol=1e-14)
    np.testing.assert_allclose(wall.normal, [(0, 0, 1), (1, 0, 0), (0, -1, 0), (0, 0, 1)], atol=1e-15)
    # The L's three squares have their centres at (0.5, 0.5), (1.5, 0.5), (0.5, 1.5).
    notch = (16 * 2 - 7 * 8.5 / 3) / 9, 2, 0
    np.testing.assert_allclose(wall.centre, [(1, 1, 0), (1, 5 / 6, 5 / 6), (2, 5, 4 / 9), notch], rtol=1e-14)
    mirrored = wall.reversed()
    np.testing.assert_array_equal(mirrored.normal, -wall.normal)
    np.testing.assert_allclose(mirrored.centre, wall.centre, rtol=1e-15)
    np.testing.assert_array_equal(mirrored.reversed().corners, wall.corners)


def test_a_twisted_face_has_the_area_vector_of_its_edge():
    twisted = surface([(0, 0, 0), (1, 0, 0.2), (1, 1, -0.1), (0, 1, 0.4)])
    edge = np.sum(np.cross(twisted.points, np.roll(twisted.points, -1, axis=0)), axis=0) / 2
    np.testing.assert_allclose(twisted.area_vector, [edge], rtol=1e-14)


def test_faces_of_the_mesh_that_are_not_of_the_surface_are_none():
    wall = surface(TRIANGLE, ELL, TRAPEZIUM, mesh_face=np.array([70, 12, 31]))
    np.testing.assert_array_equal(wall.face_of_mesh(np.array([12, 31, 70, 0, 13, 99, -1])), [1, 2, 0, -1, -1, -1, -1])
    with pytest.raises(ImpactsError, match="wall: does not say which faces of the mesh"):
        surface(TRIANGLE).face_of_mesh(np.array([0]))


def test_the_nearest_face_by_its_sides_not_by_its_centroid():
    # A face of 100 m beside one of 1 cm: near the great one's end the small one's centroid is nearer.
    great = [(0, 0, 0), (100, 0, 0), (100, 1, 0), (0, 1, 0)]
    small = [(100, 0, 0), (100.01, 0, 0), (100.01, 0.01, 0), (100, 0.01, 0)]
    wall = surface(great, small)
    faces, distances = wall.nearest(np.array([(99.9, 0.005, 0.001), (100.005, 0.005, -0.002), (50, 4, 4), (-3, 0, 4)]))
    np.testing.assert_array_equal(faces, [0, 1, 0, 0])
    np.testing.assert_allclose(distances, [0.001, 0.002, 5, 5], rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (surface, "wall: has no faces"),
        (lambda: surface(TRIANGLE, [(0, 0, 0), (1, 0, 0)]), "wall: face 1 has fewer than three corners"),
        (
            lambda: surface([(0, 0, 0), (1, 0, 0), (float("nan"), 1, 0)]),
            "wall: has points whose coordinates are not finite",
        ),
        (
            lambda: surface([(0, 0, 0), (1, 0, 0), (1e200, 1, 0)]),
            "wall: has points whose coordinates are not finite, or above 1e.20 m",
        ),
        (
            lambda: surface(TRIANGLE, [(0, 0, 0), (1, 1, 1), (2, 2, 2)]),
            "wall: 1 faces have no area, the first is face 1",
        ),
        (
            lambda: Surface("wall", np.eye(3), np.array([0, 1, 3]), np.array([3]), ("wall",), np.zeros(1, int)),
            "corners that are none of its 3 points",
        ),
    ],
    ids=["no face", "an edge", "NaN", "far", "no area", "no such point"],
)
def test_a_surface_that_cannot_be_one_is_refused(make, message):
    with pytest.raises(ImpactsError, match=message):
        make()


def flipped(surface: Surface, share: float) -> tuple[Surface, np.ndarray]:
    faces = np.random.default_rng(5).random(surface.faces) < share
    return surface.reversed(faces), faces


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("part", PARTS)
def test_normals_of_a_file_are_turned_by_the_impacts(part: str, share: float, tmp_path: Path) -> None:
    surface, table = PARTS[part], rows_on(PARTS[part])
    mixed, faces = flipped(surface, share)
    read = erosion.read_surface(write(mixed, tmp_path / "part.vtp"), unit="m")
    right, turned = (erosion.erosion_map("dnv", P, table, wall) for wall in (surface, read))
    np.testing.assert_allclose(turned["depth"], right["depth"], rtol=1e-12)
    said = [line for line in turned.attrs["read_as"].splitlines() if "normals" in line]
    assert len(said) == faces.any()
    assert not said or f"{faces.sum()} of {surface.faces} faces turned" in said[0]


def test_both_sides_of_a_sheet_in_one_place_are_refused() -> None:
    plate = PARTS["plate"]
    corners, ends = np.r_[plate.corners, plate.reversed().corners], np.r_[plate.ends, plate.ends + plate.ends[-1]]
    both = Surface("sheet", plate.points, corners, ends, ("wall",), np.zeros(2 * plate.faces, int))
    with pytest.raises(ImpactsError, match=f"sheet: {2 * plate.faces} faces lie on others, as both sides of a sheet"):
        erosion.erosion_map("dnv", P, rows_on(plate), both)
