"""Maps in files, read back by the libraries that others read them with."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import erosion
import erosion.cfd.surface
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_files import MAP_FORMATS, write_map
from tests.cfd.tables import Table, hump, sand

pyvista = pytest.importorskip("pyvista")

P = erosion.TABLE_1
SURFACE = hump(mesh=True)
MM = 1e3


@pytest.fixture(scope="module")
def wear() -> xr.Dataset:
    return erosion_map("rotating", P, sand(SURFACE, 400), SURFACE, density=2780.0)


def test_vtk_reads_the_surface_and_its_wear(wear: xr.Dataset, tmp_path: Path) -> None:
    mesh = pyvista.read(write_map(wear, tmp_path / "map.vtp"))
    np.testing.assert_array_equal(mesh.points, SURFACE.points)
    np.testing.assert_array_equal(mesh.regular_faces.ravel(), SURFACE.corners)
    density = float(wear["mass_flux"][0] / wear["depth_rate"][0])
    expected = {
        "depth [mm]": wear["depth"] * MM,
        "volume [mm^3]": wear["volume"] * MM**3,
        "area [mm^2]": SURFACE.area * 1e6,
        "mean angle [deg]": np.rad2deg(wear["alpha_mean"]),
        "depth rate [mm/year]": wear["depth_per_year"],
        "impacts": wear["impacts"],
        "patch": SURFACE.patch,
        "mesh face": np.asarray(SURFACE.mesh_face),
        "mass flux [kg/(m^2 s)]": mesh.cell_data["depth rate [m/s]"] * density,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(mesh.cell_data[name], values, rtol=1e-12, err_msg=name)
    assert mesh.field_data["model"][0] == "rotating"
    assert list(mesh.field_data["patches"]) == ["front", "back"]


def test_polygons_of_any_number_of_corners_stay_what_they_are(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1.5, 1.5, 0]], float)
    corners, ends = np.array([0, 3, 2, 0, 2, 1, 1, 2, 6, 5, 4]), np.array([3, 6, 11])
    surface = erosion.cfd.surface.Surface("three", points, corners, ends, ("a",), np.zeros(3, np.int64))
    wear = erosion_map("linearized", P, sand(surface, 50), surface)
    mesh = pyvista.read(write_map(wear, tmp_path / "map.vtp"))
    assert [cell.point_ids for cell in mesh.cell] == [[0, 3, 2], [0, 2, 1], [1, 2, 6, 5, 4]]


def test_a_table_has_a_line_for_each_face(wear: xr.Dataset, tmp_path: Path) -> None:
    rows = list(csv.DictReader(write_map(wear, tmp_path / "map.csv").read_text().splitlines()))
    assert [row["patch"] for row in rows] == ["front"] * 24 + ["back"] * 24
    depths = [float(row["depth [mm]"]) for row in rows]
    assert depths == pytest.approx(list(wear["depth"].values * MM), rel=1e-15, abs=0)
    assert float(rows[5]["x [m]"]) == SURFACE.centre[5, 0]


def test_netcdf_holds_it_all(wear: xr.Dataset, tmp_path: Path) -> None:
    stored = xr.load_dataset(write_map(wear, tmp_path / "map.nc"), engine="h5netcdf")
    xr.testing.assert_equal(stored, wear)
    assert stored.attrs["model"] == "rotating"
    assert '"version": "erosion' in stored.attrs["identity"]
    # What is stored can be drawn and written again.
    again, first = (pyvista.read(write_map(data, tmp_path / "map.vtp")) for data in (stored, wear))
    np.testing.assert_array_equal(again.cell_data["depth [mm]"], first.cell_data["depth [mm]"])


def test_other_files_are_refused(wear: xr.Dataset, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"must end in {re.escape(', '.join(MAP_FORMATS))}\.$"):
        write_map(wear, tmp_path / "map.vtk")


@pytest.mark.parametrize("ending", MAP_FORMATS)
def test_a_map_that_cannot_be_written_leaves_nothing(wear: xr.Dataset, tmp_path: Path, ending: str) -> None:
    (tmp_path / f"full{ending}").mkdir()
    with pytest.raises(OSError, match=rf"full\{ending}"):
        write_map(wear, tmp_path / f"full{ending}")
    assert [path.name for path in tmp_path.iterdir()] == [f"full{ending}"]


@pytest.mark.parametrize("ending", MAP_FORMATS)
def test_a_format_without_a_place_for_totals_needs_a_surface(tmp_path: Path, ending: str) -> None:
    two = Table(count=[1.0, 2.0], mass=[1e-7] * 2, diameter=[4e-4] * 2, speed=[50.0] * 2, alpha=[0.4] * 2)
    totals = erosion_map("linearized", P, two)
    if MAP_FORMATS[ending].holds_surface:
        with pytest.raises(ValueError, match=f"a {ending} file holds a surface"):
            write_map(totals, tmp_path / f"map{ending}")
    else:
        assert write_map(totals, tmp_path / f"map{ending}").stat().st_size
