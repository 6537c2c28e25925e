"""Which reader opens what, surfaces from files, and a missing extra."""

import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from vtkmodules import vtkIOXML

from erosion.cfd.read import read_impacts, read_surface
from erosion.cfd.rows import ImpactsError
from erosion.extras import MissingExtraError


@pytest.fixture
def box(tmp_path):
    """Files with the surface of 1 × 2 × 3 m."""
    mesh = pyvista.Box(bounds=(0, 1, 0, 2, 0, 3), quads=True)
    mesh.save(tmp_path / "box.vtp")
    mesh.triangulate().save(tmp_path / "box.stl")
    mesh.triangulate().save(tmp_path / "text.stl", binary=False)
    pyvista.PolyData(mesh.points, faces=mesh.faces, lines=[2, 0, 1], verts=[1, 0]).save(tmp_path / "more.vtp")
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], float)
    cells = [4, 0, 1, 2, 4, 4, 0, 1, 2, 3, 3, 0, 1, 4]
    grid = pyvista.UnstructuredGrid(cells, [10, 9, 5], points)  # a tetrahedron, a quadrilateral, a triangle
    grid.save(tmp_path / "mesh.vtu")
    grid.extract_cells([0]).save(tmp_path / "volume.vtu")
    pyvista.PolyData(points, faces=[3, 0, 1, 4], strips=[4, 0, 1, 3, 2]).save(tmp_path / "strip.vtp")
    return tmp_path


# STL holds single precision. Lines and points beside polygons are left out, and a VTU file's volumes.
@pytest.mark.parametrize(
    ("name", "area"),
    [("box.vtp", [6, 6, 3, 3, 2, 2]), ("more.vtp", [6, 6, 3, 3, 2, 2]), ("box.stl", [3, 3, 3, 3, *[1.5] * 4, *[1] * 4]),
     ("text.stl", [3, 3, 3, 3, *[1.5] * 4, *[1] * 4]), ("mesh.vtu", [1, 0.5])],
)  # fmt: skip
def test_a_file_is_its_polygons(box, name, area):
    surface = read_surface(box / name, unit="m")
    assert surface.patches == (name.partition(".")[0],)
    np.testing.assert_allclose(surface.area, area, rtol=1e-7)
    # VTK's box has its normals outside, which is right for a flow within it.
    assert name == "mesh.vtu" or (np.sum(surface.normal * (surface.centre - (0.5, 1, 1.5)), axis=1) > 0).all()


GROUP = """<VTKFile type="vtkMultiBlockDataSet" version="1.0"><vtkMultiBlockDataSet><DataSet index="0" name="mesh"
 file="volume.vtu"/><Block index="1" name="boundary"><DataSet index="0" name="wall" file="box.vtp"/><DataSet index="1"
 name="{}" file="{}"/></Block></vtkMultiBlockDataSet></VTKFile>"""
BY_HAND = """<VTKFile type="PolyData" version="0.1"><PolyData>
<Piece NumberOfPoints="4" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="1">
<Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">0 0 0 4 0 0 4 5 0 0 5 0</DataArray></Points>
<Polys><DataArray type="Int32" Name="connectivity" format="ascii">0 1 2 3</DataArray>
<DataArray type="Int32" Name="offsets" format="ascii">4</DataArray></Polys></Piece></PolyData></VTKFile>"""


def test_blocks_of_polygons_are_patches(box):
    (box / "inlet.vtp").write_text(BY_HAND)
    (box / "case.vtm").write_text(GROUP.format("inlet", "inlet.vtp"))
    both = read_surface(box / "case.vtm", unit="mm")
    assert both.patches == ("boundary/wall", "boundary/inlet")
    assert both.title.endswith("case.vtm: boundary/wall, boundary/inlet")
    np.testing.assert_array_equal(both.patch, [0] * 6 + [1])
    np.testing.assert_allclose(both.area, 1e-6 * np.array([6, 6, 3, 3, 2, 2, 20]), rtol=1e-14)
    wall = read_surface(box / "case.vtm", "boundary/wall", unit="m")
    np.testing.assert_array_equal(wall.centre, read_surface(box / "box.vtp", unit="m").centre)
    with pytest.raises(ImpactsError, match="no patch 'wall', but has boundary/wall, boundary/inlet"):
        read_surface(box / "case.vtm", "wall")
    # ParaView gives the patches of a group twice.
    (box / "case.vtm").write_text(GROUP.format("group", "box.vtp"))
    with pytest.raises(
        ImpactsError, match=r"6 faces of 'boundary/group' are those of another block.*`patch` must name"
    ):
        read_surface(box / "case.vtm", unit="m")
    assert read_surface(box / "case.vtm", "boundary/group", unit="m").faces == 6
    (box / "case.vtm").write_text(GROUP.format("inlet", "cut.vtp"))
    (box / "cut.vtp").write_text(BY_HAND[:-60])
    with pytest.raises(ImpactsError, match=r"cut.vtp: cannot be read"):
        read_surface(box / "case.vtm", unit="m")
    (box / "cut.vtp").unlink()
    with pytest.raises(ImpactsError, match=r"case.vtm: names the file 'cut.vtp', which is not there"):
        read_surface(box / "case.vtm", unit="m")


SOLID = b"solid box".ljust(80)


@pytest.mark.parametrize(
    ("change", "held"),
    [
        (lambda content: content[:-50], "11"),
        (lambda content: content[:-20], "11.6"),
        (lambda content: content[:-300], "6"),
        (lambda content: content[:84], "0"),
        (lambda content: content + content[-50:], "13"),
        (lambda content: SOLID + content[80:], None),
        (lambda content: SOLID + content[80:-50], "11"),
    ],
)
def test_a_binary_stl_file_with_other_facets_than_it_says_is_refused(box, change, held):
    path = box / "box.stl"
    path.write_bytes(change(path.read_bytes()))
    if held is None:
        assert read_surface(path, unit="m").faces == 12
        return
    with pytest.raises(ImpactsError, match=rf"box.stl: .* has {held} facets, but it says that it has 12"):
        read_surface(path)


@pytest.mark.parametrize("lines", [-1, -2, -7, -8])
def test_an_stl_file_of_text_that_is_cut_is_refused(box, lines):
    path = box / "text.stl"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:lines]))
    with pytest.raises(ImpactsError, match="cannot be read"):
        read_surface(path)


@pytest.mark.parametrize("suffix", ["vtp", "stl", "vtu"])
@pytest.mark.parametrize("content", [b"", b"junk\0\xff" * 100])
@pytest.mark.filterwarnings("default")  # a program's warnings are no errors
def test_a_surface_that_cannot_be_read_is_one_sentence(written, suffix, content, capfd, caplog, recwarn):
    path = written(f"wall.{suffix}", content)
    with pytest.raises(ImpactsError, match=f"wall.{suffix}: cannot be read; it is damaged, or no .{suffix} file"):
        read_surface(path)
    assert (capfd.readouterr(), caplog.messages, list(recwarn)) == (("", ""), [], [])


@pytest.mark.parametrize(
    ("read", "name", "options", "message"),
    [
        (read_surface, "wall.obj", {}, "is no surface; it must be an OpenFOAM case, or its name must end in .vtp"),
        (read_surface, "x.vtp", {}, "x.vtp: is not there"),
        (read_surface, "volume.vtu", {}, "holds no polygons; extract the surface"),
        (read_surface, "strip.vtp", {}, "1 of its cells are strips, pixels or curved faces"),
        (read_surface, "box.vtp", {"patch": "wall"}, "has no patches, so Argument `patch` must be left out"),
        (read_impacts, "none.csv", {}, "none.csv: is not there"),
        (read_impacts, "empty", {}, r"has no tables of impacts .*, but nothing"),
        (read_impacts, "a.csv", {"particle_density": "heavy"}, "Argument `particle_density` must be a density"),
        (
            read_impacts,
            "a.csv",
            {"particle_density": -1.0},
            "positive and finite, but is -1",
        ),
        (read_impacts, "a.csv", {"particle_density": [2650.0]}, r"positive and finite, but is \[2650.0\]"),
        (read_impacts, "a.csv", {"duration": 0.0}, "`duration` must be a number, positive and finite, but is 0.0"),
        (read_impacts, "a.csv", {"duration": "60 s"}, "positive and finite, but is '60 s'"),
        (read_impacts, "a.csv", {"case": "/nowhere"}, "/nowhere: is not there"),
    ],
)
def test_what_cannot_be_used_is_refused(box, read, name, options, message):
    for file in ("wall.obj", "a.txt", "a.csv"):
        (box / file).touch()
    (box / "empty").mkdir()
    with pytest.raises(ImpactsError, match=message):
        read(box / name, **options)


def test_a_missing_extra_is_one_sentence(box, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    said = re.escape("The package pyvista is not installed: pip install 'particle-erosion[cfd]'.")
    with pytest.raises(MissingExtraError, match=f"^{said}$"):
        read_surface(box / "box.vtp")


@pytest.mark.parametrize("read", [read_impacts, read_surface])
@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.post.gz", "a.dpm", "a.stl", "a.vtp"])
def test_a_pipe_is_refused_before_it_waits_for_its_writer(tmp_path, read, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ImpactsError, match="is no file"):
        read(tmp_path / name)


SOLID_TEXT = """  {start} inlet plane
 FACET NORMAL 0 0 1
  outer loop
   vertex 0 0 0
   vertex 1 0 0
   vertex 0 1.5 0
  end loop
 end facet
{end} inlet plane
{start}
facet normal 0 0 1
outer loop
vertex 0 0 1e0
vertex 1 0 1
vertex 0 1 1
endloop
endfacet
{end}
"""


@pytest.mark.parametrize(("start", "end"), [("solid", "endsolid"), ("SOLID", "ENDSOLID"), ("solid", "end solid")])
def test_the_solids_of_an_stl_file_are_patches(tmp_path, start, end):
    path = tmp_path / "wall.stl"
    path.write_text(SOLID_TEXT.format(start=start, end=end))
    both, inlet = read_surface(path, unit="m"), read_surface(path, "inlet plane", unit="m")
    assert (both.patches, inlet.patches) == (("inlet plane", "wall"), ("inlet plane",))
    np.testing.assert_array_equal(both.area, [0.75, 0.5])
    np.testing.assert_array_equal(both.patch, [0, 1])
    np.testing.assert_array_equal(inlet.centre, both.centre[:1])
    with pytest.raises(ImpactsError, match="no patch 'outlet', but has inlet plane, wall"):
        read_surface(path, "outlet")


def by_meshio(path: Path, **options: Any) -> None:
    import meshio

    meshio.Mesh(CUBE.points, [("triangle", CUBE.faces.reshape(-1, 4)[:, 1:])]).write(path, **options)


def by_trimesh(path: Path, **options: Any) -> None:
    import trimesh

    trimesh.Trimesh(CUBE.points, CUBE.faces.reshape(-1, 4)[:, 1:], process=False).export(path, **options)


CUBE: Any = pyvista.Cube(x_length=1 / 3).triangulate()
OF_MESHIO = {"a.stl": {"binary": False}, "b.stl": {"binary": True}, "a.vtu": {"binary": False},
             "b.vtu": {"compression": None}, "c.vtu": {}, "d.vtu": {"compression": "lzma"},
             "a.vtk": {}, "a.ply": {}, "a.obj": {}}  # fmt: skip
OF_TRIMESH = {"a.stl": {"file_type": "stl_ascii"}, "b.stl": {}, "a.ply": {}, "a.obj": {}}


@pytest.mark.parametrize(
    ("write", "name", "options"),
    [*((by_meshio, *case) for case in OF_MESHIO.items()), *((by_trimesh, *case) for case in OF_TRIMESH.items())],
)
def test_a_file_of_another_program_is_read_exactly_or_refused_with_what_to_type(tmp_path, write, name, options):
    write(tmp_path / name, **options)
    if name.endswith((".stl", ".vtu")):
        surface = read_surface(tmp_path / name, unit="m")
        corners = surface.points[surface.corners].reshape(-1, 3, 3)
        exact = CUBE.points[CUBE.faces.reshape(-1, 4)[:, 1:]]
        np.testing.assert_allclose(
            corners, exact, rtol=1e-7 if name.endswith(".stl") else 0
        )  # STL has single precision
        return
    with pytest.raises(ImpactsError, match=r"is no surface.*pyvista.read\('a\.\w+'\).*save\('a.vtp'\)"):
        read_surface(tmp_path / name, unit="m")


@pytest.mark.parametrize("suffix", ["vtk", "pvtp", "ply", "obj"])
def test_a_surface_of_another_format_is_refused_with_the_line_that_converts_it(tmp_path, suffix):
    path = tmp_path / f"wall.{suffix}"
    pyvista.Plane().save(tmp_path / "wall.ply")
    (tmp_path / "wall.ply").rename(path)
    with pytest.raises(ImpactsError, match=r"wall.* is no surface.*pyvista.read\('wall\.\w+'\).*save\('wall.vtp'\)"):
        read_surface(path)


@pytest.mark.parametrize("file", ["wall.vtp", "wall.vtu"])
def test_faces_that_are_ghosts_are_refused(tmp_path, file, monkeypatch):
    mesh = pyvista.Plane(i_resolution=2, j_resolution=1)
    mesh = mesh.cast_to_unstructured_grid() if file == "wall.vtu" else mesh
    for ghosts in (0, 1):
        mesh.cell_data["vtkGhostType"] = np.array([0, ghosts], np.uint8)
        mesh.save(tmp_path / file)
        if not ghosts:
            assert read_surface(tmp_path / file, unit="m").faces == 2
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ImpactsError, match="1 of its cells are ghosts") as refused:
        read_surface(file)
    exec(str(refused.value).partition("Python removes them: ")[2].removesuffix("."), {"pyvista": pyvista})
    assert read_surface("wall.vtu", unit="m").faces == 1


def test_impacts_that_are_ghosts_are_refused(tmp_path, monkeypatch):
    mesh = pyvista.PolyData(np.eye(3))
    mesh.point_data["vtkGhostType"] = np.array([0, 0, 1], np.uint8)
    mesh.point_data.update({"d [mm]": np.ones(3), "mass [mg]": np.ones(3), "U": np.ones((3, 3))})
    mesh.save(tmp_path / "hits.vtp")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ImpactsError, match="1 of its points are ghosts") as refused:
        read_impacts("hits.vtp", columns="U=m/s, Points=m")
    exec(str(refused.value).partition("Python removes them: ")[2].removesuffix("."), {"pyvista": pyvista})
    assert read_impacts("hits.vtu", columns="U=m/s, Points=m").rows == 2


VARIANTS = {
    "text": {"DataMode": 0},
    "binary": {"DataMode": 1, "CompressorType": 0},
    "packed": {"DataMode": 1, "CompressorType": 1},
    "LZ4": {"DataMode": 2, "CompressorType": 2, "EncodeAppendedData": True},
    "LZMA": {"DataMode": 2, "CompressorType": 3, "EncodeAppendedData": False},
    "raw, 64 bits": {"DataMode": 2, "CompressorType": 0, "EncodeAppendedData": False, "HeaderType": 64},
    "big-endian": {"DataMode": 2, "CompressorType": 0, "EncodeAppendedData": True, "ByteOrder": 0},
}


@pytest.mark.parametrize("ending", ["vtp", "vtu", "vtm"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_each_variant_of_vtks_files_is_read_exactly(box, ending, variant):
    mesh: Any = pyvista.read(box / "box.vtp")
    mesh.points = np.asarray(mesh.points) * 0.1 + 1 / 3
    made = {"vtp": mesh, "vtu": mesh.cast_to_unstructured_grid(), "vtm": pyvista.MultiBlock({"side": mesh})}[ending]
    names = {"vtp": "vtkXMLPolyDataWriter", "vtu": "vtkXMLUnstructuredGridWriter", "vtm": "vtkXMLMultiBlockDataWriter"}
    writer = getattr(vtkIOXML, names[ending])()
    writer.SetInputData(made)
    writer.SetFileName(str(box / f"out.{ending}"))
    for name, value in VARIANTS[variant].items():
        getattr(writer, f"Set{name}")(value)
    assert writer.Write()
    surface = read_surface(box / f"out.{ending}", unit="m")
    np.testing.assert_array_equal(surface.points, mesh.points)
    np.testing.assert_array_equal(surface.corners, mesh.faces.reshape(-1, 5)[:, 1:].ravel())
