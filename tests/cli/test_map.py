"""`erosion export`: files for CFD codes.

`erosion map`, from files to files.
"""

import csv
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion.cfd.map_files import MAP_FORMATS
from erosion.cfd.surface import Surface
from erosion.cli import exit_status
from tests.cfd.parts import PARTS, rows_on, write
from tests.documents import Shell

P = erosion.TABLE_1
SI = P.to("si")
OPENFOAM = Path(__file__).parents[1] / "cfd" / "openfoam"


def rows_of(path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_all_four_files_are_written(tmp_path, shell):
    words = "export --model rotating --openfoam p.txt --fluent f.csv --table v.csv --restitution r.csv"
    options = ["--angles", "20deg, 30deg", "--speeds", "4300 in/s : 4500 in/s : 3", "--diameters", "2.032 mm"]
    said = shell([*words.split(), *options])
    assert said.out.startswith("rotating: for CFD codes\n")
    for name in ("p.txt", "f.csv", "v.csv", "r.csv"):
        assert name in said.out
    assert said.err.startswith("warning: OpenFOAM knows Finnie's curve only: it is off by up to 7.1% of the maximum.")
    assert re.search(r"K +3\.17", (tmp_path / "p.txt").read_text())
    assert "angle [deg],f [-]" in (tmp_path / "f.csv").read_text()
    volumes, rebounds = rows_of(tmp_path / "v.csv"), rows_of(tmp_path / "r.csv")
    assert len(volumes) == len(rebounds) == 6
    exact = erosion.impact("rotating", SI.replace(alpha=np.deg2rad(30.0), v0=4300 * 0.0254))
    assert float(volumes[1]["volume [m^3]"]) == pytest.approx(float(exact.volume), rel=1e-8)
    assert rebounds[1]["ended_by"] == exact.ended_by


def test_in_an_openfoam_case_the_entry_names_its_walls(tmp_path, shell):
    mesh = tmp_path / "case" / "constant" / "polyMesh"
    mesh.mkdir(parents=True)
    shutil.copy(OPENFOAM / "serial" / "constant" / "polyMesh" / "boundary", mesh)
    for folder, patches in ((tmp_path, "(walls);"), (mesh.parent, "(floor hump roof sides);")):
        shell(["export", "--model", "finnie", "--openfoam", str(folder / "p.txt")])
        assert f"    patches     {patches}" in (folder / "p.txt").read_text()


def test_the_density_sets_the_diameter(tmp_path):
    options = ["--table", str(tmp_path / "v.csv"), "--particle-density", "2650 kg/m^3", "--diameters", "1 mm"]
    assert exit_status(["export", "--model", "finnie", "--angles", "30deg", "--speeds", "111.76 m/s", *options]) == 0
    (row,) = rows_of(tmp_path / "v.csv")
    # A sphere of quartz; finnie removes by mass.
    mass = 2650 * np.pi / 6 * 1e-9
    case = float(erosion.impact("finnie", SI.replace(alpha=np.deg2rad(30.0))).volume)
    assert float(row["volume [m^3]"]) == pytest.approx(case * mass / float(SI.m), rel=1e-8)
    options[1] = str(tmp_path / "v.txt")
    assert exit_status(["export", "--model", "finnie", "--angles", "30deg", "--speeds", "111.76 m/s", *options]) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "v.txt", comments="%"), [float(text) for text in row.values()])


def test_a_form_that_is_refused_leaves_the_others(tmp_path, shell):
    table, dictionary, rebounds = tmp_path / "f.csv", tmp_path / "p.txt", tmp_path / "r.csv"
    words = ["export", "--model", "dnv", "--fluent", str(table), "--openfoam", str(dictionary), "--json"]
    said = shell([*words, "--restitution", str(rebounds)], 1)
    assert "dnv is not of that shape" in said.err
    assert "dnv has no motion of a rigid body" in said.err
    assert "angle [deg],f [-]" in table.read_text()
    assert [*json.loads(said.out)["result"]] == ["fluent"]
    assert not dictionary.exists()
    assert not rebounds.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("export --restitution x --model dnv", "dnv has no motion of a rigid body"),
        ("export --openfoam x --model rotating --speeds 200m/s", "at 200 m/s and 2032 µm it is off by up to"),
    ],
)
def test_a_form_that_cannot_be_made_is_refused(words, message, shell):
    assert message in shell(words, 2).err


pyvista = pytest.importorskip("pyvista")
pytest.importorskip("foamlib")

RUNS = Path(__file__).parents[1] / "cfd" / "openfoam"
CASE = """units = "si"
k = 2.4
psi = 2.0
sigma = 1.5e9
r = 0.000125
b = 0.00025
m = 2.168e-8
inertia = 0.5
v0 = 25.0
alpha = 0.44
"""
OPTIONS = ["--surface", str(RUNS / "serial"), "--patch", "hump", "sand.toml"]


@pytest.fixture(autouse=True)
def in_folder(in_folder: Path) -> Path:
    (in_folder / "sand.toml").write_text(CASE)
    return in_folder


def wear(model: str = "rotating", **options: Any) -> xr.Dataset:
    surface = erosion.read_surface(RUNS / "serial", patch="hump")
    impacts = erosion.read_impacts(RUNS / "serial")
    return erosion.erosion_map(model, erosion.load_case("sand.toml"), impacts, surface, **options)


def test_the_command_is_the_function(shell: Shell) -> None:
    # Both patches are in the case's table, and only one of them in the surface.
    files = ["-o", "map.vtp", "--plot", "map.png"]
    out, err = shell(["map", str(RUNS / "serial"), *OPTIONS, "--model", "rotating", *files])
    assert err == ""
    assert "faces_hit" in out
    assert out.endswith("map: map.vtp\nfigure: map.png\n")
    depth = pyvista.read("map.vtp").cell_data["depth [mm]"]
    np.testing.assert_allclose(depth, wear()["depth"] * 1e3, rtol=1e-14)
    assert Path("map.png").read_bytes()[1:4] == b"PNG"


def test_a_page_is_one_of_the_files(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["map", str(RUNS / "serial"), *OPTIONS[:4], "-o", "page.html", "--quantity", "alpha_mean"]
    assert shell(given).out.endswith("map: page.html\n")
    assert "The worst 10 faces" in Path("page.html").read_text()
    assert "a .html file holds a surface" in shell(["map", "none.csv", "-o", "page.html"], 2).err
    assert f"must end in {', '.join(MAP_FORMATS)}, .html." in shell(["map", "none.csv", "-o", "page.doc"], 2).err
    # A page needs what draws pictures, which is known before anything is computed.
    monkeypatch.setattr("erosion.cli.lazy.require_renderer", lambda: (_ for _ in ()).throw(RuntimeError("No screen.")))
    assert "No screen." in shell(given, 1).err


def test_options_are_those_of_the_function() -> None:
    given = ["--density", "7.8 g/cm^3", "--diameter", "0.2 mm", "--phidot0", "normal(0, 1e5)", "--seed", "4"]
    assert exit_status(["map", str(RUNS / "serial"), *OPTIONS, "--model", "rotating", *given, "-o", "map.nc"]) == 0
    law = stats.norm(0.0, 1e5)
    expected = wear(density=7800.0, diameter=2e-4, phidot0=law, seed=4)
    with xr.open_dataset("map.nc", engine="h5netcdf") as stored:
        np.testing.assert_allclose(stored["mass"], expected["mass"], rtol=1e-12)
        assert "impacts" not in stored.attrs
        identity = json.loads(stored.attrs["identity"])
    assert set(identity) == {"version", "case", "models", "table", "surface", "options"}


def test_without_a_model_the_number_is_one_that_tests_find(shell: Shell) -> None:
    given = ["map", str(RUNS / "serial"), *OPTIONS[:4]]
    named = [*given, "--particle", "quartz sand 0.2 mm", "--target", "carbon steel 1018"]
    out, err = shell(named)
    assert err == ""
    assert "dnv:carbon-steel is the usual correlation for carbon steel 1018" in " ".join(out.split())
    assert "no-cut" not in out
    ratio = shell([*named, "--json"]).document["result"]["total_erosion_ratio"]["value"]
    assert 2.9e-6 < ratio < 29e-6  # what DNV's tests find at 22.9 m/s
    assert shell([*given, "--target", "aluminium 6061", "--json"]).document["model"]["name"] == "dnv:aluminium"
    assert shell([*given, "--json"]).document["model"]["name"] == "dnv:carbon-steel"
    for cut in (["--k", "2"], ["--cutting-fraction", "0.5"], ["sand.toml"], ["--scaling", "none"]):
        assert shell([*given, *cut, "--json"]).document["model"]["name"] == "linearized"
    assert shell([*given, "--target", "titanium", "--json"]).document["model"]["name"] == "linearized"


def test_a_spin_that_is_given_takes_the_place_of_the_tables(shell: Shell) -> None:
    """A spin for this verb, not the one that every case file has."""
    header = "diameter [um], density [kg/m^3], speed [m/s], angle [deg], spin [rad/s]\n"
    Path("spins.csv").write_text(header + "".join(f"200, 2650, 30, {5 + i}, 2e4\n" for i in range(20)))
    Path("plain.csv").write_text(Path("spins.csv").read_text().replace(", spin [rad/s]", "").replace(", 2e4\n", "\n"))
    case = erosion.dump_case(erosion.TABLE_1.to("si").replace(phidot0=-3e4))
    Path("sand.toml").write_text(case)
    Path("of_map.toml").write_text(case + "\n[map]\nphidot0 = -1e4\n")

    def total(*words: str) -> float:
        words = (*words, "--each-row", "1 particle", "--model", "rotating", "--json")
        return shell(["map", *words]).document["result"]["total_volume"]["value"]

    assert total("spins.csv", "--phidot0", "-1e4 rad/s") == total("plain.csv", "--phidot0", "-1e4 rad/s")
    assert total("spins.csv", "of_map.toml") == total("plain.csv", "--phidot0", "-1e4 rad/s")
    assert total("spins.csv", "sand.toml") == total("plain.csv", "--phidot0", "2e4 rad/s")
    assert total("plain.csv", "sand.toml") == total("plain.csv", "--phidot0", "-3e4 rad/s")


def positions_on(surface: Surface) -> Path:
    """A table with positions alone."""
    table, path = rows_on(surface), Path("rows.csv")
    names = ("velocity_{} [m/s]", "position_{} [mm]")
    heads = ["diameter [um]", "density [kg/m^3]", *(name.format(axis) for name in names for axis in "xyz")]
    numbers = np.hstack([table.columns["velocity"], 1e3 * table.columns["position"]])
    rows = [",".join(map(repr, (50.0, 2650.0, *row))) for row in numbers.tolist()]
    path.write_text("\n".join([",".join(heads), *rows]) + "\n")
    return path


@pytest.mark.parametrize("part", ["pipe", "plate"])
def test_a_surface_in_millimetres(part: str, shell: Shell) -> None:
    table = positions_on(PARTS[part])
    given = ["map", str(table), "sand.toml", "--duration", "1 s", "--each-row", "1 particle", "--surface"]
    write(PARTS[part], Path("metres.vtp"))
    write(PARTS[part], Path("part.stl"), 1000)
    expected = shell([*given, "metres.vtp", "--surface-unit", "m", "--json"]).document["result"]
    assert (
        "part.stl: does not say the unit of its coordinates: Option `--surface-unit`"
        in shell([*given, "part.stl"], 2).err
    )
    result = shell([*given, "part.stl", "--surface-unit", "mm", "--json"]).document["result"]
    assert result["total_volume"]["value"] == pytest.approx(expected["total_volume"]["value"], rel=1e-6, abs=0)


def test_density_is_that_of_the_target_as_in_every_verb(shell: Shell) -> None:
    Path("grains.csv").write_text("diameter [um],speed [m/s],angle [deg]\n200,30,20\n200,30,40\n")
    assert "Option `--particle-density` must give it." in shell("map grains.csv --density '7.8 g/cm^3'", 2).err

    one = ["--each-row", "1 particle"]
    assert "Option `--each-row`" in shell("map grains.csv --particle-density '2650 kg/m^3'", 2).err

    def totals(*words: str) -> dict[str, float]:
        result = shell(["map", "grains.csv", *one, "--model", "linearized", *words, "--json"]).document["result"]
        return {name: result[f"total_{name}"]["value"] for name in ("volume", "mass", "particle_mass")}

    sand = ["--particle-density", "2650 kg/m^3"]
    steel, aluminium = (totals(*sand, "--density", density) for density in ("7.8 g/cm^3", "2.7 g/cm^3"))
    assert steel["volume"] == aluminium["volume"]
    assert steel["mass"] / aluminium["mass"] == pytest.approx(7.8 / 2.7)
    assert steel["particle_mass"] == pytest.approx(2 * 2650 * np.pi / 6 * 2e-4**3)


BAD = [
    ("map", "Option `IMPACTS` must have a value, but has none."),
    ("map nowhere", "nowhere: is not there."),
    ("map {run} --patch hump", "Option `--patch` needs `--surface`"),
    ("map {run} --surface-unit mm", "Option `--surface-unit` needs `--surface`"),
    ("map {run} --surface {run} --surface-unit mm", "Option `--surface-unit` must be left out."),
    ("map {run} --surface {run} --each-row 2", "Option `--each-row` must be such as \"1 particle\", but is '2'."),
    ("map {run} --surface {run} --each-row '2 particles'", "Option `--each-row` must be left out"),
    ("map {run} --surface {run} --patch hmp", "has no patch 'hmp', but has inlet, outlet, floor, hump, roof, sides."),
    ("map {run} --surface {run} --restitution 0.8,0.1", "Option `--restitution` must be left out."),
    ("map {run} --surface {run} --restitution 0.8", 'Option `--restitution` must be two numbers such as "0.8,0.1"'),
    ("map {run} --surface {run} --restitution ''", 'Option `--restitution` must be two numbers such as "0.8,0.1"'),
    ("map {run} --surface {run} --restitution 0,0", "Option `--restitution` must be (e, μ) with e in (0, 1]"),
    ("map {run}", "gives velocities, so the angle of attack needs the normals of a surface"),
    ("map {run} --surface {run} --alpha 20deg", "Option `--alpha` has no meaning here"),
    ("map {run} --surface {run} --v0 '20 m/s'", "Option `--v0` has no meaning here"),
    ("map {run} --surface {run} --density '3 kg'", "Option `--density` must be a density such as"),
    ("map {run} --particle-density 2650", "Option `--particle-density` must be a density with its unit"),
    ("map {run} --surface {run} --limit 0", "Option `--limit` must be positive and finite, but is 0.0."),
    ("map {run} --surface {run} --diameter '1 kg'", "Option `--diameter` must be a length such as"),
    ("map {run} --surface {run} --limit 1", 'Option `--limit` must have a unit, such as --limit "1 mm"'),
    ("map {run} --surface {run} --duration 60", "Option `--duration` must have a unit"),
    ("map {run} --surface {run} --duration soon", "Option `--duration` must be a time such as"),
    ("map {run} --surface {run} --phidot0 slow", "Option `--phidot0` must be an angular speed"),
    ("map {run} --surface {run} --phidot0 'normal(0 rad/s)'", "Option `--phidot0` must be normal(mean, deviation)"),
    ("map {run} --surface {run} --scaling big", "Option `--scaling` must be one of similar, none, but is 'big'."),
    ("map {run} --surface {run} -o map.vtk", "map.vtk: the name of a map's file must end in .vtp, "),
    ("map {run} -o map.vtp", "map.vtp: a .vtp file holds a surface, but there is none"),
    ("map {run} --plot map.png", "Option `--plot` needs `--surface`"),
    ("map {run} --surface {run} --plot map.png --view top", "Option `--view` must be one of iso, +x, "),
    ("map {run} --surface {run} --plot map.png --view 1,b", "Option `--view` must be such as iso, +x or"),
    ("map {run} --surface {run} --patch hump --plot map.png --view +z", "Option `--view` must show the surface"),
    ("map {run} --surface {run} --plot map.png --zoom 0", "Option `--zoom` must be positive and finite"),
    ("map {run} --surface {run} --plot map.png --quantity dept", "Option `--quantity` must be one of volume, depth"),
    ("map rows.csv -o rows.csv", "rows.csv: must not be written, because rows.csv is read."),
    ("map {run} --surface {run} --set friction=1", "must name an own parameter of linearized, which has none."),
    ("map {run} --surface {run} --workers 0", "Option `--workers` must be 1 or more, but is 0."),
]


@pytest.mark.parametrize(("line", "sentence"), BAD)
def test_bad_input_is_one_line(line: str, sentence: str, shell: Shell, in_folder: Path) -> None:
    assert sentence in shell(line.format(run=shlex.quote(str(RUNS / "serial"))), 2).err
    assert [path.name for path in in_folder.iterdir()] == ["sand.toml"]
