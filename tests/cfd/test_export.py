"""Maps in files, read back by the libraries that others read them with."""

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import erosion
import erosion.cfd.surface
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import write_map
from tests.cfd.tables import hump, sand

pyvista = pytest.importorskip("pyvista")

P = erosion.TABLE_1.to("inch-pound")
SURFACE = hump(mesh=True)
WEAR = erosion_map("rotating", P, sand(SURFACE, 400), SURFACE, density=2780.0)
MM = 25.4


def test_vtk_reads_the_surface_and_its_wear(tmp_path: Path) -> None:
    mesh = pyvista.read(write_map(WEAR, tmp_path / "map.vtp"))
    np.testing.assert_array_equal(mesh.points, SURFACE.points)
    np.testing.assert_array_equal(mesh.regular_faces.ravel(), SURFACE.corners)
    cells = mesh.cell_data
    np.testing.assert_allclose(cells["depth [mm]"], WEAR["depth"] * MM, rtol=1e-14)
    np.testing.assert_allclose(cells["volume [mm^3]"], WEAR["volume"] * MM**3, rtol=1e-14)
    np.testing.assert_allclose(cells["area [mm^2]"], SURFACE.area * 1e6, rtol=1e-14)
    np.testing.assert_allclose(cells["mean angle [deg]"], np.rad2deg(WEAR["alpha_mean"]), rtol=1e-14)
    np.testing.assert_array_equal(cells["depth rate [mm/year]"], WEAR["depth_per_year"])
    np.testing.assert_array_equal(cells["impacts"], WEAR["impacts"])
    np.testing.assert_array_equal(cells["patch"], SURFACE.patch)
    np.testing.assert_array_equal(cells["mesh face"], SURFACE.mesh_face)
    density = float(WEAR["mass_flux"][0] / WEAR["depth_rate"][0]) * 4.4482216152605 / 0.0254**4
    np.testing.assert_allclose(cells["mass flux [kg/(m^2 s)]"], cells["depth rate [m/s]"] * density, rtol=1e-12)
    assert mesh.field_data["model"][0] == "rotating"
    assert list(mesh.field_data["patches"]) == ["front", "back"]


def test_polygons_of_any_number_of_corners_stay_what_they_are(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1.5, 1.5, 0]], float)
    corners, ends = np.array([0, 3, 2, 0, 2, 1, 1, 2, 6, 5, 4]), np.array([3, 6, 11])
    surface = erosion.cfd.surface.Surface("three", points, corners, ends, ("a",), np.zeros(3, np.int64))
    wear = erosion_map("linearized", P, sand(surface, 50), surface)
    mesh = pyvista.read(write_map(wear, tmp_path / "map.vtp"))
    assert [cell.point_ids for cell in mesh.cell] == [[0, 3, 2], [0, 2, 1], [1, 2, 6, 5, 4]]


def test_a_table_has_a_line_for_each_face(tmp_path: Path) -> None:
    with write_map(WEAR, tmp_path / "map.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == SURFACE.faces
    assert [row["patch"] for row in rows[:2]] == ["front", "front"]
    assert [float(row["depth [mm]"]) for row in rows] == pytest.approx(
        list(WEAR["depth"].values * MM), rel=1e-15, abs=0
    )
    assert float(rows[5]["x [m]"]) == SURFACE.centre[5, 0]


def test_totals_alone_are_one_line(tmp_path: Path) -> None:
    table = sand(SURFACE, 20).replace(velocity=None, face=None, position=None, speed=np.full(20, 50.0),
                                      alpha=np.full(20, 0.4))  # fmt: skip
    wear = erosion_map("linearized", P, table)
    (header, line) = write_map(wear, tmp_path / "map.csv").read_text().splitlines()
    assert header.startswith("patch,volume [mm^3],")
    assert float(line.split(",")[1]) == pytest.approx(float(wear["total_volume"]) * MM**3, abs=0)
    with pytest.raises(ValueError, match=r"a \.vtp file holds a surface, but there is none"):
        write_map(wear, tmp_path / "map.vtp")


def test_netcdf_holds_it_all(tmp_path: Path) -> None:
    path = write_map(WEAR, tmp_path / "map.nc")
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        xr.testing.assert_equal(stored.load(), WEAR)
        assert stored.attrs["model"] == "rotating"
        assert '"version": "erosion' in stored.attrs["identity"]
    # What is stored can be drawn and written again.
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        write_map(stored, tmp_path / "again.vtp")
    write_map(WEAR, tmp_path / "map.vtp")
    again, first = (pyvista.read(tmp_path / name) for name in ("again.vtp", "map.vtp"))
    np.testing.assert_array_equal(again.cell_data["depth [mm]"], first.cell_data["depth [mm]"])


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.vtp, \.csv, \.nc\.$"):
        write_map(WEAR, tmp_path / "map.vtk")
    (tmp_path / "full.vtp").mkdir()
    with pytest.raises(OSError, match=r"full\.vtp"):
        write_map(WEAR, tmp_path / "full.vtp")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full.vtp"]
