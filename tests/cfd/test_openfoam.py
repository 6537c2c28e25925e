"""Tables and meshes that OpenFOAM v1912 wrote, copies of them with something wrong, and maps of its runs.

A map by `finnie` is OpenFOAM's own field Q, which it summed while it ran. Where OpenFOAM is installed, an exported
entry runs there.
"""

import functools
import gzip
import math
import os
import pickle
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foamlib import FoamFieldFile, FoamFile

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.openfoam import open_case
from erosion.cfd.read import read_impacts, read_surface
from erosion.cfd.rows import ImpactsError

RUNS = Path(__file__).parent / "openfoam"
TABLES = Path("postProcessing") / "lagrangian" / "kinematicCloud" / "impacts"
ROWS = 464  # lines of the four tables without their headers
HUMP, FLOOR = (942, 36), (918, 24)  # first face and number of faces, in constant/polyMesh/boundary


def together(impacts, rows=1_000_000):
    blocks = list(impacts.blocks(rows))
    names = ("count", "mass", "diameter", "velocity", "position", "face", "time", "parcel")
    return {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in names
        if getattr(blocks[0], name) is not None
    }


def faces_of(source: Path | str, **options: Any) -> np.ndarray:
    return together(read_impacts(source, **options))["face"]


@functools.cache
def original(name: str) -> np.ndarray:
    """The faces of the rows of a run as it is kept here."""
    return faces_of(RUNS / name)


@pytest.fixture
def run(tmp_path):
    """A copy of the parallel run, whose tables are plain text, to spoil."""
    shutil.copytree(RUNS / "parallel", tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.parametrize("name", ["serial", "parallel"])
def test_each_impact_lies_on_the_face_that_it_names(name):
    rows, surface = together(read_impacts(RUNS / name)), read_surface(RUNS / name, ["hump", "floor"])
    faces, distances = surface.nearest(rows["position"])
    np.testing.assert_array_equal(faces, surface.face_of_mesh(rows["face"]))
    assert len(faces) == ROWS
    assert distances.max() < 1e-16  # m


def test_blocks_keep_the_order_of_the_table_whatever_their_size():
    impacts = read_impacts(RUNS / "serial")
    whole, parts = together(impacts), together(impacts, 7)
    for name, values in whole.items():
        np.testing.assert_array_equal(parts[name], values)
    assert max(block.rows for block in impacts.blocks(7)) == 7
    # Times of a patch increase through its windows, and the numbers of rows start again in each file.
    first = [(Path(block.source).parent.name, Path(block.source).name, block.first) for block in impacts.blocks(1000)]
    assert first == [(window, f"{patch}.post.gz", 0) for window in ("0.01", "0.02") for patch in ("floor", "hump")]
    # One file, one window and a whole case give the same rows.
    np.testing.assert_array_equal(faces_of(RUNS / "serial" / TABLES), whole["face"])
    windows = [faces_of(RUNS / "serial" / TABLES / window) for window in ("0.01", "0.02")]
    np.testing.assert_array_equal(np.concatenate(windows), whole["face"])
    assert 0 < len(faces_of(RUNS / "serial" / TABLES / "0.01" / "hump.post.gz")) < len(windows[0])


def test_a_case_is_found_from_within_or_given(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert read_surface("run", "hump").title == "run: hump"
    monkeypatch.chdir(run / TABLES)
    np.testing.assert_array_equal(faces_of("0.01"), faces_of(RUNS / "parallel" / TABLES / "0.01"))
    shutil.move(run / TABLES, tmp_path / "apart")
    with pytest.raises(ImpactsError, match="faceProcAddressing is needed of the case, which is not given"):
        faces_of(tmp_path / "apart")
    np.testing.assert_array_equal(faces_of(tmp_path / "apart", case=run), original("parallel"))


def test_what_the_case_says_of_the_run(run):
    impacts, here, copy = (read_impacts(source) for source in (RUNS / "serial", RUNS / "parallel", run))
    assert (impacts.mesh_faces, impacts.rows, impacts.warnings) == (True, None, ())
    assert impacts.duration == pytest.approx(0.02, rel=1e-15)
    assert read_impacts(RUNS / "serial", duration=3.0).duration == 3.0
    # A table can be sent to another process.
    np.testing.assert_array_equal(together(pickle.loads(pickle.dumps(here)))["face"], original("parallel"))
    # The identity is of the rows alone.
    assert copy.identity() == here.identity()
    edit(run / TABLES / "0.02" / "floor.post", ("2650", "2651"))
    assert copy.identity() != here.identity()


def test_a_parallel_run_that_hits_on_one_processor_alone(run):
    # Left of x = 6 cm, where the mesh is cut, all is of processor 0.
    left = original("parallel")[together(read_impacts(run))["position"][:, 0] < 0.06]
    assert 100 < len(left) < ROWS
    for path in (run / TABLES).rglob("*.post"):
        head, *lines = path.read_text().splitlines()
        path.write_text("\n".join([head, *(line for line in lines if line.split()[1] == "0")]) + "\n")
    np.testing.assert_array_equal(faces_of(run), left)


def test_a_serial_run_of_a_case_that_is_decomposed_too(run):
    for path in (RUNS / "serial" / TABLES).rglob("*.post.gz"):
        (run / TABLES / path.parent.name / path.stem).write_bytes(gzip.decompress(path.read_bytes()))
    np.testing.assert_array_equal(faces_of(run), original("serial"))


def test_faces_that_fit_a_serial_and_a_parallel_run_are_refused(run):
    numbers = np.arange(1, 1300)
    numbers[FLOOR[0] : sum(FLOOR)] = numbers[FLOOR[0] : sum(FLOOR)][::-1]
    (run / "processor0" / ADDRESSING).write_text(f"{LABELS}{len(numbers)}({' '.join(map(str, numbers))})")
    shutil.rmtree(run / TABLES)
    (run / TABLES / "0.01").mkdir(parents=True)
    table = f"# Time currentProc (U0 U1 U2) facei d rho nParticle\n0.01 0 (1 -2 3) {FLOOR[0]} 1e-4 2650 20\n"
    (run / TABLES / "0.01" / "floor.post").write_text(table)
    with pytest.raises(ImpactsError, match="names faces of patch 'floor', whether they are counted in the whole mesh"):
        together(read_impacts(run))


def test_names_of_other_versions(tmp_path):
    # As openfoam.org and `particlePostProcessing` of openfoam.com write: (Ux Uy Uz), tabs, and only the wanted fields.
    table = tmp_path / "0.5" / "wall.dat"
    table.parent.mkdir()
    table.write_text(
        "# page\f\n# Time currentProc (positionx positiony positionz) d rho nParticle (Ux Uy Uz) active\n"
        "0.1\t0 (1 2 3) 1e-4 2650 20 (10 -20 30) 1\n0.2\t0  (1 2 4) 2e-4 2650 2.5 (1 2 -3) 1\n"
    )
    rows = together(read_impacts(tmp_path))
    expected = {"velocity": [(10, -20, 30), (1, 2, -3)], "position": [(1, 2, 3), (1, 2, 4)], "count": [20, 2.5],
                "mass": 2650 * math.pi / 6 * np.array([1e-12, 8e-12])}  # fmt: skip
    for name, values in expected.items():
        np.testing.assert_allclose(rows[name], values, rtol=1e-15)
    assert ("face" in rows, read_impacts(tmp_path).mesh_faces) == (False, False)


def test_patches_of_the_ascii_and_of_the_binary_mesh():
    ascii_mesh, binary_mesh = (read_surface(RUNS / name) for name in ("serial", "parallel"))
    assert ascii_mesh.patches == binary_mesh.patches == ("floor", "hump", "roof", "sides")
    np.testing.assert_array_equal(np.asarray(ascii_mesh.mesh_face), np.asarray(binary_mesh.mesh_face))
    np.testing.assert_array_equal(ascii_mesh.centre, binary_mesh.centre)
    hump, both = (read_surface(RUNS / "serial", patch) for patch in ("hump", ["hump", "floor"]))
    np.testing.assert_array_equal(np.asarray(hump.mesh_face), np.arange(HUMP[0], sum(HUMP)))
    np.testing.assert_array_equal(np.bincount(both.patch), [HUMP[1], FLOOR[1]])
    assert (hump.normal[:, 1] < 0).all()  # the fluid is above
    # The arc through (4, 0), (6, 1.2), (8, 0) cm has the radius (2² + 1.2²) / 2.4; twelve chords are shorter by 0.2 %.
    radius = (2**2 + 1.2**2) / 2.4
    assert hump.area.sum() == pytest.approx(2 * radius * math.asin(2 / radius) * 2 * 1e-4, rel=3e-3)


@pytest.mark.skipif(shutil.which("icoUncoupledKinematicParcelFoam") is None, reason="OpenFOAM is not installed")
def test_the_recipe_makes_the_same_runs_again(tmp_path):
    subprocess.run(["sh", RUNS / "run.sh", tmp_path], check=True, capture_output=True)
    for name in ("serial", "parallel"):
        again, rows = together(read_impacts(tmp_path / name)), together(read_impacts(RUNS / name))
        np.testing.assert_array_equal(again["face"], rows["face"])
        np.testing.assert_allclose(again["velocity"], rows["velocity"], rtol=1e-9)


def test_a_binary_mesh_with_labels_of_64_bits(run):
    head = 'FoamFile {{ version 2.0; format binary; arch "LSB;label=64;scalar=64"; class {}; object x; }}\n'
    mesh = Path("constant") / "polyMesh"
    lists: dict[Path, Any] = {path: [FoamFile(path)[None]] for path in run.glob(f"processor*/{ADDRESSING}")}
    lists[run / mesh / "faces"] = FoamFile(run / mesh / "faces")[None]
    for path, labels in lists.items():
        parts = [f"{len(part)}\n(".encode() + np.asarray(part, "<i8").tobytes() + b")\n" for part in labels]
        kind = "faceCompactList" if path.name == "faces" else "labelList"
        path.write_bytes(head.format(kind).encode() + b"".join(parts))
    np.testing.assert_array_equal(read_surface(run).centre, read_surface(RUNS / "parallel").centre)
    np.testing.assert_array_equal(faces_of(run), original("parallel"))


@pytest.mark.parametrize(("frequency", "evolutions"), [(1, 40), (10, 4), (8, 5 + 1)])
def test_a_steady_cloud_injects_for_one_second_in_each_of_its_evolutions(run, frequency, evolutions):
    # Windows end at the iterations 20 and 40; those that are written are evolved as well.
    properties = run / "constant" / "kinematicCloudProperties"
    edit(properties, ("transient yes", f"transient no; calcFrequency {frequency}"))
    impacts = read_impacts(run)
    assert impacts.duration == evolutions
    # What was injected is OpenFOAM's own sum, or not known.
    for path in run.rglob("kinematicCloudOutputProperties*"):
        path.unlink()
    assert read_impacts(run).injected is None


def test_windows_before_the_first_impact_name_no_columns(run):
    for patch in ("floor", "hump"):
        (run / TABLES / "0.005" / f"{patch}.post").parent.mkdir(exist_ok=True)
        (run / TABLES / "0.005" / f"{patch}.post").write_text("# Time currentProc\n")
    assert not read_impacts(run).warnings
    np.testing.assert_array_equal(faces_of(run), original("parallel"))


def test_positions_of_another_name(tmp_path):
    (tmp_path / "wall.post").write_text(
        "# Time currentProc (Px Py Pz) (Ux Uy Uz) d rho\n0 0 (1 2 3) (4 5 6) 1e-4 2650\n"
    )
    np.testing.assert_array_equal(together(read_impacts(tmp_path))["position"], [(1, 2, 3)])


def test_walls_are_of_several_types(tmp_path):
    boundary = BOUNDARY.replace("type patch", "type mappedWall")
    assert read_surface(tetrahedron(tmp_path, boundary=boundary)).patches == ("a", "b")


def test_a_binary_list_of_faces_that_is_not_compact_is_refused_with_the_tool_that_rewrites_it(tmp_path):
    path = tetrahedron(tmp_path) / "constant" / "polyMesh" / "faces"
    faces = b"".join(b"\n3\n(" + np.array(face, "<i4").tobytes() + b")" for face in ([0, 2, 1], [0, 1, 3], [0, 3, 2]))
    path.write_bytes(HEAD.format("faceList").replace("ascii", "binary").encode() + b"3\n(" + faces + b"\n)\n")
    with pytest.raises(ImpactsError, match=r"faces: is a binary list .*`foamFormatConvert` rewrites it"):
        read_surface(tmp_path)


@pytest.mark.parametrize("name", ["serial", "parallel"])
def test_a_mesh_that_was_renumbered_after_the_run_is_refused(tmp_path, name):
    run = shutil.copytree(RUNS / name, tmp_path / name)
    owners = dict[int, dict[int, int]]()
    for path in (run / TABLES).rglob("*.post*"):
        content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        head, *lines = content.decode().replace("(", "").replace(")", "").splitlines()
        names = head.removeprefix("#").split()
        for line in lines:
            row = dict(zip(names, line.split(), strict=True))
            owners.setdefault(int(row["currentProc"]), {})[int(row["facei"])] = int(row["celli"])
    for shift, fits in ((0, True), (1, False)):
        for number, owner in owners.items():
            labels = [owner.get(face, 0) + shift for face in range(1100)]
            path = run / (f"processor{number}" if name == "parallel" else "") / "constant" / "polyMesh" / "owner"
            path.write_text(f"{LABELS}{len(labels)}({' '.join(map(str, labels))})")
        if fits:
            np.testing.assert_array_equal(faces_of(run), original(name))
    with pytest.raises(
        ImpactsError, match=r"row \d+ is of cell \d+, but this face is of another cell in .* renumbered"
    ):
        faces_of(run)


LAST = TABLES / "0.02" / "hump.post"
LABELS = "FoamFile { version 2.0; format ascii; class labelList; object x; }\n"
ADDRESSING = Path("constant") / "polyMesh" / "faceProcAddressing"


def edit(path: Path, *changes: tuple[str, str]) -> None:
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)


def edit_row(path: Path, old: str, new: str) -> None:
    """In row 12, which other rows may be like."""
    lines = path.read_text().splitlines()
    lines[12] = lines[12].replace(old, new) if old else lines[12].rsplit(" ", 1)[0]
    path.write_text("\n".join(lines) + "\n")


def serial_first(run: Path) -> None:
    content = gzip.decompress((RUNS / "serial" / TABLES / "0.01" / "floor.post.gz").read_bytes())
    (run / TABLES / "0.01" / "floor.post").write_bytes(content)


def cut_gzip(run: Path) -> None:
    (run / LAST).with_name("hump.post.gz").write_bytes(gzip.compress((run / LAST).read_bytes())[:-3000])
    (run / LAST).unlink()


FOREIGN = [("nFaces          24", "nFaces          23"), ("nFaces          36", "nFaces          37"), ("942", "941")]
SPOILED = [
    (serial_first, "0.01.hump.post: is of a parallel run, but the rows before it are of a serial one"),
    (lambda run: [shutil.rmtree(folder) for folder in run.glob("processor*")],
     "is of a parallel run.*processor[01]/constant/polyMesh/faceProcAddressing is needed"),
    (lambda run: shutil.copytree(run / TABLES / "0.02", run / TABLES / "0.03"),
     "0.03.floor.post: begins at .* before .*0.02.floor.post ends at 0.02 s: a restart"),
    (lambda run: (run / LAST).write_text(""), "0.02.hump.post: is empty"),
    (lambda run: (run / LAST).write_bytes(bytes(range(256)) * 40), "0.02.hump.post: is no table of text"),
    (lambda run: edit(run / LAST, ("# ", "")),
     "0.02.hump.post: has no header of OpenFOAM, a line that starts with '# Time'"),
    (lambda run: (run / LAST).write_text((run / LAST).read_text() * 2), "0.02.hump.post: has its header again"),
    (lambda run: shutil.copy(run / LAST, run / LAST.with_name("hump (copy).post")),
     "copy..post: names faces of patch 'hump', of which another table has the impacts"),
    (lambda run: edit(run / LAST, (" dTarget ", " dAim ")), "0.02.hump.post: has other columns than .*0.01.floor.post"),
    (lambda run: edit_row(run / LAST, "", ""), "0.02.hump.post, line 13: has 38 cells, but the header names 39"),
    (lambda run: edit_row(run / LAST, "2650", "steel"),
     "0.02.hump.post, line 13: column `rho` must be a number, but is 'steel'"),
    (lambda run: edit_row(run / LAST, "2650", "nan"),
     "0.02.hump.post: row 12: column `density` must be finite, but is nan"),
    (lambda run: edit(run / "constant" / "kinematicCloudProperties",
                      ("maxStoredParcels 100000", "maxStoredParcels 50")),
     r"holds \d+ rows of processor [01], which is the case's `maxStoredParcels`"),
    (lambda run: shutil.copytree(run / TABLES, run / TABLES.with_name("more")),
     "has tables of 2 function objects, .*impacts, .*more; give one"),
    (lambda run: shutil.rmtree(run / "postProcessing"),
     r"run: has no tables of impacts \(.post, .dat\), but 0.02/, constant/, processor0/"),
    (lambda run: (run / LAST).with_name("hump.post.gz").write_bytes(gzip.compress((run / LAST).read_bytes())),
     "hump.post.gz: is there twice"),
    (lambda run: edit(run / "constant" / "polyMesh" / "boundary", *FOREIGN),
     "names face .* which is none of patch 'floor'"),
    (lambda run: (run / "processor1" / ADDRESSING).write_text(LABELS + "3(1 -2 3)"),
     "of processor 1, which has 3 faces"),
    (cut_gzip, "hump.post.gz: cannot be read"),
    *((lambda run, numbers=numbers: (run / "processor1" / ADDRESSING).write_text(LABELS + numbers),
       f"faceProcAddressing: {message}")
      for numbers, message in (("3(1 2.5 3)", "must hold whole numbers"),
                               ("3(1 0 3)", "numbers faces from 1, but has a 0"),
                               ("4(1 -2 3)", "says that its list has 4 items, but it has 3"),
                               ("3((1 2) (3 4) (5 6))", "is no list of whole numbers"))),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "message"), SPOILED)
def test_a_run_with_something_wrong_is_refused(run, spoil, message):
    spoil(run)
    with pytest.raises(ImpactsError, match=message):
        together(read_impacts(run))


HEADER = "# Time currentProc (U0 U1 U2) facei d rho nParticle"


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (HEADER.replace(" facei", ""), "names neither the face"),
        (HEADER.replace(" d ", " "), "has no column `diameter`"),
        (HEADER.replace(" rho", ""), "has no column `mass` or `density`.*`particle_density` must give it"),
        (HEADER.replace("U0 U1 U2", ""), "has no columns of the velocity"),
        (HEADER.replace("rho", "d"), "the header repeats d"),
    ],
)
def test_columns_that_are_needed_are_named(tmp_path, header, message):
    (tmp_path / "wall.post").write_text(f"{header}\n")
    with pytest.raises(ImpactsError, match=message):
        read_impacts(tmp_path / "wall.post")


@pytest.mark.parametrize(
    ("patch", "message"),
    [("hmup", "has no patch 'hmup', but has inlet, outlet, floor, hump, roof, sides"), (["hump", "x"], "no patch 'x'")],
)
def test_a_patch_that_is_not_there_is_refused_with_those_that_are(patch, message):
    with pytest.raises(ImpactsError, match=message):
        read_surface(RUNS / "serial", patch)


def test_a_folder_without_a_mesh_is_no_case(tmp_path):
    with pytest.raises(ImpactsError, match="is no OpenFOAM case, because it has no constant/polyMesh/boundary"):
        read_surface(tmp_path)
    (tmp_path / "processor0" / "constant" / "polyMesh").mkdir(parents=True)
    with pytest.raises(ImpactsError, match="`reconstructParMesh` joins them"):
        read_surface(tmp_path)


HEAD = "FoamFile {{ version 2.0; format ascii; class {}; object x; }}\n"
POINTS = "4((0 0 0) (1 0 0) (0 1 0) (0 0 1))"
FACES = "4(3(0 2 1) 3(0 1 3) 3(0 3 2) 3(1 2 3))"
COMPACT = "5(0 3 6 9 12)\n12(0 2 1 0 1 3 0 3 2 1 2 3)"
BOUNDARY = "2(a {type wall; nFaces 3; startFace 0;} b {type patch; nFaces 1; startFace 3;})"


def tetrahedron(folder, points=POINTS, faces=FACES, boundary=BOUNDARY):
    mesh = folder / "constant" / "polyMesh"
    mesh.mkdir(parents=True)
    (mesh / "points").write_text(HEAD.format("vectorField") + points)
    (mesh / "faces").write_text(HEAD.format("faceCompactList" if faces[0] == "5" else "faceList") + faces)
    (mesh / "boundary").write_text(HEAD.format("polyBoundaryMesh") + boundary)
    return folder


@pytest.mark.parametrize("faces", [FACES, COMPACT])
def test_a_small_mesh_is_read(tmp_path, faces):
    surface = read_surface(tetrahedron(tmp_path, faces=faces))
    np.testing.assert_allclose(surface.area, 0.5)
    np.testing.assert_array_equal(surface.normal, -np.eye(3)[[2, 1, 0]])


def test_polyhedra_with_faces_of_many_corners(tmp_path):
    points, faces = "6((0 0 0) (2 0 0) (2 1 0) (1 2 0) (0 1 0) (1 1 5))", "3(5(0 1 2 3 4) 3(0 5 1) 4(0 4 5 1))"
    patches = "2(a {type patch; nFaces 1; startFace 2;} b {type wall; nFaces 2; startFace 0;})"
    surface = read_surface(tetrahedron(tmp_path, points, faces, patches), "b")
    np.testing.assert_allclose(surface.area[0], 3.0, rtol=1e-15)
    np.testing.assert_array_equal(surface.ends, [5, 8])


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("boundary", "startFace 0", "startFace -40", "boundary: `startFace` of patch 'a' must be .* but is -40"),
        ("boundary", "startFace 3", "startFace 3.7", "boundary: `startFace` of patch 'b' must be .* but is 3.7"),
        ("boundary", "nFaces 3", "nFaces yes", "boundary: `nFaces` of patch 'a' must be .* but is True"),
        ("boundary", "nFaces 3", "nFaces -3", "boundary: `nFaces` of patch 'a' must be .* but is -3"),
        ("boundary", "nFaces 3;", "", "boundary: is no list of patches"),
        ("boundary", "nFaces 3;", "nFaces 3; nFaces 2;", "boundary: cannot be read .*[dD]uplicate"),
        ("boundary", "b {", "a {", "boundary: has two patches 'a'"),
        ("boundary", "nFaces 3", "nFaces 4", "patch 'b' must start at face 4, where 'a' ends, but starts at 3"),
        ("boundary", "nFaces 3", "nFaces 2", "patch 'b' must start at face 2, where 'a' ends, but starts at 3"),
        ("boundary", "nFaces 1", "nFaces 2", "faces: has 4 faces, but the last patch of `boundary` ends at 5"),
        ("boundary", "2(a", "3(a", "boundary: says that its list has 3 items, but it has 2"),
        ("faces", "3(0 2 1)", "3(0 2 -1)", "faces: has a face with the corner -1, but points are 0 to 3"),
        ("faces", "3(0 2 1)", "3(0 2 4)", "faces: has a face with the corner 4, but points are 0 to 3"),
        ("faces", "3(0 2 1)", "3(0 2 1.5)", "faces: must hold whole numbers, but holds decimals"),
        ("faces", "3(0 2 1)", "3(0 2 nan)", "faces: must hold whole numbers, but holds decimals"),
        ("faces", "3(0 2 1)", "2(0 2)", "face 0 has fewer than three corners"),
        ("faces", "3(0 2 1)", "4(0 2 1)", "faces: cannot be read"),
        ("faces", "4(3(0 2 1)", "5(3(0 2 1)", "faces: says that its list has 5 items, but it has 4"),
        ("faces", "4(3(0 2 1) 3", "3(3", "faces: has 3 faces, but the last patch of `boundary` ends at 4"),
        ("compact", "5(0 3 6", "5(0 7 6", "faces: is no list of faces: their corners do not follow one another"),
        ("compact", "5(0 3 6", "5(1 3 6", "faces: is no list of faces: their corners do not follow one another"),
        ("compact", "9 12)", "9 15)", "faces: is no list of faces: their corners do not follow one another"),
        ("compact", "5(0 3 6", "5(0 3.5 6", "faces: must hold whole numbers, but holds decimals"),
        ("compact", "12(0 2", "12(0 -2", "faces: has a face with the corner -2, but points are 0 to 3"),
        ("faces", "1 2 3))", "1 2", "faces: cannot be read .* has 5 [(] and 3 [)], as a file that was cut off"),
        ("points", "(1 0 0)", "(1 0 nan)", "coordinates are not finite"),
        ("points", "(1 0 0)", "(1 0)", "points: is no list of points"),
        ("points", "4((0", "5((0", "points: says that its list has 5 items, but it has 4"),
        ("points", " (0 0 1)", "", "points: says that its list has 4 items, but it has 3"),
    ],
)
def test_a_mesh_with_a_wrong_number_is_refused_by_its_file(tmp_path, name, old, new, message):
    parts = {"points": POINTS, "faces": FACES, "compact": COMPACT, "boundary": BOUNDARY}
    assert old in parts[name]
    key = name.replace("compact", "faces")
    with pytest.raises(ImpactsError, match=message):
        read_surface(tetrahedron(tmp_path, **{key: parts[name].replace(old, new, 1)}), ["a", "b"])


@pytest.mark.parametrize("name", ["boundary", "faces", "points"])
def test_a_mesh_that_cannot_be_read_is_refused_by_its_file(run, name):
    (run / "constant" / "polyMesh" / name).write_bytes(b"\0\xff junk {")
    with pytest.raises(ImpactsError, match=rf"{name}: (cannot be read as a file of OpenFOAM|is no list)"):
        read_surface(run, "hump")


# p, psi and K of case/constant/kinematicCloudProperties.
P = erosion.TABLE_1.to("si").replace(sigma=1.5e9, psi=2.0, k=2.4, inertia=0.5)


def packed(path: Path) -> None:
    Path(f"{path}.gz").write_bytes(gzip.compress(path.read_bytes()))
    path.unlink()


def unpacked(path: Path) -> None:
    if path.suffix == ".gz":
        path.with_suffix("").write_bytes(gzip.decompress(path.read_bytes()))
        path.unlink()


# What OpenFOAM wrote, serial in compressed text, parallel in plain binary, and the same files packed otherwise.
@pytest.mark.parametrize("name", ["serial", "parallel"])
@pytest.mark.parametrize("is_repacked", [False, True])
def test_finnie_is_what_openfoam_summed(tmp_path: Path, name: str, is_repacked: bool) -> None:
    run = shutil.copytree(RUNS / name, tmp_path / name)
    (field,) = map(FoamFieldFile, (run / "0.02").iterdir())
    q = [np.asarray(field["boundaryField", patch, "value"]) for patch in ("hump", "floor")]
    for path in [*run.rglob("polyMesh/*"), *run.rglob("*.post*")] if is_repacked else []:
        (unpacked if name == "serial" else packed)(path)
    assert any(run.rglob("polyMesh/*.gz")) == (name == ("parallel" if is_repacked else "serial"))
    wear = erosion_map("finnie", P, read_impacts(run), read_surface(run, patch=["hump", "floor"]))
    most = max(map(np.max, q))
    np.testing.assert_allclose(wear["volume"], np.concatenate(q), rtol=0, atol=1e-10 * most)
    assert int(wear["total_impacts"]) > 400
    assert int((wear["impacts"] > 0).sum()) > 30
    assert not wear["left_out"].any()


def test_finnie_is_what_each_processor_summed() -> None:
    run = RUNS / "parallel"
    wear = erosion_map("finnie", P, read_impacts(run), read_surface(run, patch=["hump", "floor"]))
    volumes = dict(zip(wear["mesh_face"].values.tolist(), wear["volume"].values.tolist(), strict=True))
    q, expected = list[float](), list[float]()
    for number, addressing in open_case(run).processors.items():
        part = run / f"processor{number}"
        field = FoamFieldFile(part / "0.02" / "kinematicCloudQ")
        for patch in ("hump", "floor"):
            _, start, end = open_case(part).patches[patch]
            value: Any = field["boundaryField", patch, "value"]
            q += np.broadcast_to(value, end - start).tolist()
            expected += [volumes[face] for face in addressing[start:end].tolist()]
    assert len(q) == len(volumes)
    np.testing.assert_allclose(q, expected, rtol=0, atol=1e-10 * max(volumes.values()))


# OpenFOAM joins the files of all processors, or of groups of them, where it writes them collated.
@pytest.mark.parametrize("groups", [{"processors2": "01"}, {"processors2_0-0": "0", "processors2_1-1": "1"}])
@pytest.mark.parametrize("kind", ["ascii", "binary", "64 bits"])
def test_faces_of_collated_files(run: Path, groups: dict[str, str], kind: str) -> None:
    head = b"FoamFile { version 2.0; format binary; class decomposedBlockData; object faceProcAddressing; }\n"
    for group, numbers in groups.items():
        blocks = []
        for rank, number in enumerate(numbers):
            path = run / f"processor{number}" / ADDRESSING
            labels: Any = FoamFile(path)[None]
            text = f"{LABELS}{len(labels)}({' '.join(map(str, labels))})".encode()
            head_64 = LABELS.replace("ascii;", 'binary; arch "LSB;label=64;scalar=64";').encode()
            long = b"%b%d\n(%b)\n" % (head_64, len(labels), np.asarray(labels, "<i8").tobytes())
            block = {"ascii": text, "binary": path.read_bytes(), "64 bits": long}[kind]
            # The first one alone has a header.
            block = block[block.index(b"}") + 1 :] if rank else block
            blocks.append(b"\n// Processor%d\n\n%d\n(%b)\n" % (rank, len(block), block))
            shutil.rmtree(run / f"processor{number}")
        (run / group / ADDRESSING).parent.mkdir(parents=True)
        (run / group / ADDRESSING).write_bytes(head + b"".join(blocks))
    np.testing.assert_array_equal(faces_of(run), original("parallel"))
    path = run / next(iter(groups)) / ADDRESSING
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ImpactsError, match="faceProcAddressing: is no whole file of several processors"):
        faces_of(run)


def test_one_patch_leaves_the_rows_of_others_out() -> None:
    impacts = read_impacts(RUNS / "serial")
    hump, both = (
        erosion_map("finnie", P, impacts, read_surface(RUNS / "serial", patch=patch))
        for patch in ("hump", ["hump", "floor"])
    )
    assert float(hump["total_volume"]) == float(both["patch_volume"].sel(patch="hump"))
    assert int(hump["left_out"].sel(reason="elsewhere")) == int(both["total_impacts"] - hump["total_impacts"]) > 0


def test_both_runs_have_nearly_the_same_wear() -> None:
    # Their injections draw other random numbers.
    totals = [
        erosion_map("rotating", P, read_impacts(RUNS / name), read_surface(RUNS / name, patch="hump"))
        for name in ("serial", "parallel")
    ]
    values = [float(wear["total_volume"]) for wear in totals]
    errors = [float(wear["total_volume"] * wear["total_relative_error"]) for wear in totals]
    assert abs(values[0] - values[1]) < 3 * np.hypot(errors[0], errors[1])


SOLVER = "icoUncoupledKinematicParcelFoam"
DIAMETER = 0.25e-3  # m
SAND = erosion.Parameters(
    k=2.4, psi=2.0, sigma=1.5e9, r=DIAMETER / 2, b=DIAMETER, m=2650 * np.pi / 6 * DIAMETER**3, v0=25.0, alpha=0.4,
    inertia=0.4,
)  # fmt: skip


@pytest.fixture(scope="module")
def run_of_export(tmp_path_factory) -> Path:
    """The hump with the entry for `rotating` in the place of the case's own."""
    folder = tmp_path_factory.mktemp("run") / "case"
    shutil.copytree(RUNS / "case", folder)
    control = folder / "system" / "controlDict"
    control.write_text(control.read_text().replace("FORMAT", "ascii").replace("COMPRESSION", "off"))
    entry = erosion.to_openfoam("rotating", SAND).text().replace("(walls)", "(hump floor)")
    cloud = folder / "constant" / "kinematicCloudProperties"
    text, entries = re.subn(r"    erosion\s*\{.*?\}\n", lambda _: entry, cloud.read_text(), flags=re.S)
    assert entries == 1
    cloud.write_text(text)
    # OpenFOAM believes PWD, and stops where that path has spaces.
    environment = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ, "PWD": str(folder)}
    for command in ("blockMesh", SOLVER):
        subprocess.run([command], cwd=folder, env=environment, check=True, capture_output=True, timeout=120)
    return folder


@pytest.mark.skipif(shutil.which(SOLVER) is None, reason="OpenFOAM is not installed")
@pytest.mark.parametrize("patch", ["hump", "floor"])
def test_openfoams_field_is_the_map_of_the_model(run_of_export: Path, patch: str) -> None:
    wear = erosion_map("rotating", SAND, read_impacts(run_of_export), read_surface(run_of_export, patch=patch))
    field = (run_of_export / "0.02" / "kinematicCloudQ").read_text()
    numbers = re.search(rf"    {patch}\n.*?List<scalar>\s*\d+\s*\((.*?)\)", field, re.S)
    assert numbers is not None
    q = np.array(numbers[1].split(), float)
    assert q.size == wear.sizes["face"]
    assert q.sum() > 0
    # The form is off by less than 0.4 % of the maximum from half to twice the case's speed.
    assert np.abs(q - wear.volume.values).max() < 4e-3 * q.max()
