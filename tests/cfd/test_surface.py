"""Polygons in space: centroids, areas, normals, the faces of a mesh, and the face nearest to a point."""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cfd.rows import ImpactsError
from erosion.cfd.surface import Surface
from tests.cfd.parts import PARTS, polygons, rows_on, write

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
def test_normals_that_are_mixed_are_known_and_turned_by_the_impacts(part: str, share: float, tmp_path: Path) -> None:
    surface, table = PARTS[part], rows_on(PARTS[part])
    mixed, faces = flipped(surface, share)
    expected = set(np.flatnonzero(faces if share < 0.5 else ~faces))
    if share in (0.0, 1.0):
        assert not mixed.mixed.size
    elif share != 0.5:
        assert set(mixed.mixed) == expected
    file = write(mixed, tmp_path / "part.vtp")
    right = erosion.erosion_map("dnv", P, table, surface)
    turned = erosion.erosion_map("dnv", P, table, erosion.read_surface(file, reverse="auto", unit="m"))
    np.testing.assert_allclose(turned["depth"], right["depth"], rtol=1e-12)
    # Velocities after the rebound look the same.
    assert ("`restitution` must then" in turned.attrs["warnings"]) == (np.mean(faces) > 0.5)
    if 0 < share < 0.9:
        left = erosion.erosion_map("dnv", P, table, erosion.read_surface(file, unit="m"))
        assert "normals against those of their neighbours" in left.attrs["warnings"]


def test_a_strip_with_one_side_is_named() -> None:
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    across, turn_of_half = np.array([-0.3, 0.3])[:, None], turn / 2
    points = np.stack(
        [(1 + across * np.cos(turn_of_half)) * np.cos(turn), (1 + across * np.cos(turn_of_half)) * np.sin(turn),
         across * np.sin(turn_of_half)], axis=-1,
    )  # fmt: skip
    i = np.arange(12)
    following = np.where(i == 11, 0, i + 1)
    # The last piece joins each edge with the other one.
    corners = np.stack([i, np.where(i == 11, 12, following), np.where(i == 11, 0, 12 + following), 12 + i], axis=1)
    strip = polygons(points.reshape(-1, 3), corners)
    with pytest.raises(ImpactsError, match="one side only"):
        _ = strip.parts
    assert strip.mixed.size


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("turned", [False, True])
def test_the_sides_of_a_sheet_may_have_other_diagonals(part: str, turned: bool) -> None:
    quads = PARTS[part].corners.reshape(-1, 4)
    one, other = (np.concatenate([quads[:, cut] for cut in cuts]) for cuts in (([0, 1, 2], [0, 2, 3]),
                                                                               ([0, 1, 3], [1, 2, 3])))  # fmt: skip
    # In single precision, and oblique to the axes, as an STL has it.
    turn = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0] if turned else np.eye(3)
    turn[0] *= np.linalg.det(turn)
    points = (PARTS[part].points @ turn.T).astype(np.float32).astype(float)
    upper = polygons(points, one)
    both = polygons(points, np.concatenate([one, other[:, ::-1]]))
    sheet = polygons(points, quads)
    above, below = rows_on(sheet, 400), rows_on(sheet.reversed(), 400, seed=1)
    table = above.replace(**{name: np.concatenate([its, below.columns[name]]) for name, its in above.columns.items()})
    wear = erosion.erosion_map("dnv", P, table, both)
    assert not wear["left_out"].any()
    sides = wear["impacts"].values.reshape(2, -1)
    np.testing.assert_array_equal(sides.sum(axis=1), [400, 400])
    assert "faces that are hit lie on others" in wear.attrs["warnings"]
    alone = erosion.erosion_map("dnv", P, above, upper)
    assert "lie on others" not in alone.attrs["warnings"]
    np.testing.assert_allclose(wear["volume"].values[: upper.faces].sum(), alone["volume"].sum(), rtol=1e-6)


@pytest.mark.parametrize("reverse", [False, "auto"])
@pytest.mark.parametrize("thickness", [0.0, 1e-3])
def test_each_side_of_a_sheet_has_its_own_impacts(thickness: float, reverse: bool | str, tmp_path: Path) -> None:
    upper, lower = PARTS["plate"], PARTS["plate"].reversed()
    above, below = rows_on(upper, 400), rows_on(lower, 200)
    points, corners = np.concatenate([upper.points, lower.points]), np.concatenate([upper.corners, lower.corners])
    points[len(upper.points) :, 2] -= thickness
    corners[len(upper.corners) :] += len(upper.points)
    both = polygons(points, corners.reshape(-1, 4))
    table = above.replace(**{name: np.concatenate([its, below.columns[name]]) for name, its in above.columns.items()})
    table.columns["position"][400:, 2] -= thickness
    surface = erosion.read_surface(write(both, tmp_path / "part.vtp"), reverse=reverse, unit="m")
    wear = erosion.erosion_map("dnv", P, table, surface)
    assert not wear["left_out"].any()
    assert "turned" not in wear.attrs["warnings"]
    assert ("288 faces that are hit lie on others" in wear.attrs["warnings"]) == (thickness == 0)
    sides = wear["impacts"].values.reshape(2, -1)
    np.testing.assert_array_equal(sides.sum(axis=1), [400, 200])
    alone = erosion.erosion_map("dnv", P, above, upper)
    np.testing.assert_allclose(wear["volume"].values[: upper.faces], alone["volume"], rtol=1e-12)
