"""Which reader opens what, surfaces from files, and a missing extra."""

import os
import sys

import numpy as np
import pytest
import pyvista

from erosion.cfd.read import read_impacts, read_surface
from erosion.cfd.rows import ImpactsError
from erosion.extras import MissingExtraError


@pytest.fixture
def box():
    return pyvista.Box(bounds=(0, 1, 0, 2, 0, 3), quads=True)


def test_a_vtp_file_is_its_polygons(tmp_path, box):
    box.save(tmp_path / "box.vtp")
    surface = read_surface(tmp_path / "box.vtp")
    assert surface.patches == ("box",)
    np.testing.assert_allclose(surface.area, [6, 6, 3, 3, 2, 2], rtol=1e-15)
    # VTK's box has its normals outside, which is right for a flow within it.
    assert (np.sum(surface.normal * (surface.centre - (0.5, 1, 1.5)), axis=1) > 0).all()
    np.testing.assert_array_equal(read_surface(tmp_path / "box.vtp", reverse=True).normal, -surface.normal)


def test_lines_and_points_beside_polygons_are_left_out(tmp_path, box):
    mesh = pyvista.PolyData(box.points, faces=box.faces, lines=[2, 0, 1], verts=[1, 0])
    mesh.save(tmp_path / "box.vtp")
    assert read_surface(tmp_path / "box.vtp").area.sum() == pytest.approx(22, rel=1e-15)


def test_an_stl_file_is_its_triangles(tmp_path, box):
    box.triangulate().save(tmp_path / "box.stl")
    surface = read_surface(tmp_path / "box.stl")
    assert surface.faces == 12
    assert surface.area.sum() == pytest.approx(22, rel=1e-7)  # STL holds single precision


@pytest.mark.parametrize(
    ("cut", "held"), [(slice(0, -50), "11"), (slice(0, -20), "11.6"), (slice(0, -300), "6"), (slice(0, 84), "0")]
)
def test_a_binary_stl_file_without_some_of_its_facets_is_refused(tmp_path, box, cut, held):
    path = tmp_path / "box.stl"
    box.triangulate().save(path)
    path.write_bytes(path.read_bytes()[cut])
    with pytest.raises(ImpactsError, match=rf"box.stl: .* has {held} facets, but it says that it has 12"):
        read_surface(path)


def test_a_binary_stl_file_with_other_facets_than_it_says_is_refused(tmp_path, box):
    path = tmp_path / "box.stl"
    box.triangulate().save(path)
    content = path.read_bytes()
    path.write_bytes(content + content[-50:])
    with pytest.raises(ImpactsError, match="has 13 facets, but it says that it has 12"):
        read_surface(path)
    path.write_bytes(b"solid box".ljust(80) + content[80:])
    assert read_surface(path).faces == 12
    path.write_bytes(b"solid box".ljust(80) + content[80:-50])
    with pytest.raises(ImpactsError, match="has 11 facets, but it says that it has 12"):
        read_surface(path)


@pytest.mark.parametrize("lines", [-1, -2, -7, -8])
def test_an_stl_file_of_text_that_is_cut_is_refused(tmp_path, box, lines):
    path = tmp_path / "box.stl"
    box.triangulate().save(path, binary=False)
    assert read_surface(path).faces == 12
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:lines]))
    with pytest.raises(ImpactsError, match="cannot be read"):
        read_surface(path)


def test_the_surface_cells_of_a_vtu_file(tmp_path):
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], float)
    cells = [4, 0, 1, 2, 4, 4, 0, 1, 2, 3, 3, 0, 1, 4]
    grid = pyvista.UnstructuredGrid(cells, [10, 9, 5], points)  # a tetrahedron, a quadrilateral, a triangle
    grid.save(tmp_path / "mesh.vtu")
    np.testing.assert_allclose(read_surface(tmp_path / "mesh.vtu").area, [1, 0.5], rtol=1e-15)
    grid.extract_cells([0]).save(tmp_path / "volume.vtu")
    with pytest.raises(ImpactsError, match="holds no polygons; extract the surface"):
        read_surface(tmp_path / "volume.vtu")


@pytest.mark.parametrize("suffix", ["vtp", "stl", "vtu"])
@pytest.mark.parametrize("content", [b"", b"junk\0\xff" * 100])
@pytest.mark.filterwarnings("default")  # a program's warnings are no errors
def test_a_surface_that_cannot_be_read_is_one_sentence(tmp_path, suffix, content, capfd, caplog, recwarn):
    path = tmp_path / f"wall.{suffix}"
    path.write_bytes(content)
    with pytest.raises(ImpactsError, match=f"wall.{suffix}: cannot be read; it is damaged, or no .{suffix} file"):
        read_surface(path)
    assert capfd.readouterr() == ("", "")
    assert (caplog.messages, list(recwarn)) == ([], [])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("wall.obj", "is no surface; it must be an OpenFOAM case, or its name must end in .vtp"),
        ("x.vtp", "is not there"),
    ],
)
def test_a_surface_of_an_unknown_kind_is_refused(tmp_path, name, message):
    (tmp_path / "wall.obj").touch()
    with pytest.raises(ImpactsError, match=message):
        read_surface(tmp_path / name)


def test_a_patch_of_a_file_is_refused(tmp_path, box):
    box.save(tmp_path / "box.vtp")
    with pytest.raises(ImpactsError, match="has no patches, so Argument `patch` must be left out"):
        read_surface(tmp_path / "box.vtp", patch="wall")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("impacts.txt", r"is no table of impacts; its name must end in .post, .dat, .dpm, .csv or .parquet"),
        ("none.csv", "none.csv: is not there"),
    ],
)
def test_a_table_of_an_unknown_kind_is_refused(tmp_path, name, message):
    (tmp_path / "impacts.txt").touch()
    with pytest.raises(ImpactsError, match=message):
        read_impacts(tmp_path / name)


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(ImpactsError, match=r"has no tables of impacts .*, but nothing"):
        read_impacts(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"particle_density": "heavy"}, "Argument `particle_density` must be a density"),
        ({"particle_density": -1.0}, "Argument `particle_density` must be positive and finite, but is -1.0"),
        ({"duration": 0.0}, "Argument `duration` must be positive and finite, but is 0.0"),
        ({"case": "/nowhere"}, "/nowhere: is not there"),
    ],
)
def test_arguments_are_checked(tmp_path, arguments, message):
    (tmp_path / "a.csv").touch()
    with pytest.raises(ImpactsError, match=message):
        read_impacts(tmp_path / "a.csv", **arguments)


def test_a_missing_extra_is_one_sentence(tmp_path, monkeypatch, box):
    box.save(tmp_path / "box.vtp")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(
        MissingExtraError, match=r"^The package pyvista is not installed: pip install 'erosion\[cfd\]'.$"
    ):
        read_surface(tmp_path / "box.vtp")


@pytest.mark.parametrize("read", [read_impacts, read_surface])
@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.post.gz", "a.dpm", "a.stl", "a.vtp"])
def test_a_pipe_is_refused_before_it_waits_for_its_writer(tmp_path, read, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ImpactsError, match="is no file"):
        read(tmp_path / name)
