"""`erosion export`: files for CFD codes."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cli import _status
from tests.documents import result_of

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
SI = P.to("si")
OPENFOAM = Path(__file__).parents[1] / "cfd" / "openfoam"


def rows_of(path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_all_four_files_are_written(tmp_path, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
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


def test_the_document_has_the_coefficients(tmp_path, shell):
    path = tmp_path / "p.txt"
    text = shell(["export", "--model", "finnie", "--openfoam", str(path), "--json"]).out
    assert json.loads(text)["result"]["openfoam"]["p"]["unit"] == "Pa"
    printed = result_of(text)["openfoam"]
    assert printed["file"] == str(path)
    assert (printed["p"], printed["K"]) == pytest.approx((float(SI.sigma), 2.0), rel=1e-9)
    assert printed["misfit"] < 1e-12


def test_in_an_openfoam_case_the_entry_names_its_walls(tmp_path, shell):
    mesh = tmp_path / "case" / "constant" / "polyMesh"
    mesh.mkdir(parents=True)
    shutil.copy(OPENFOAM / "serial" / "constant" / "polyMesh" / "boundary", mesh)
    for folder, patches in ((tmp_path, "(walls);"), (mesh.parent, "(floor hump roof sides);")):
        shell(["export", "--model", "finnie", "--openfoam", str(folder / "p.txt")])
        assert f"    patches     {patches}" in (folder / "p.txt").read_text()


def test_fluents_constant_is_finished_for_a_named_target(tmp_path, shell):
    path = tmp_path / "f.csv"
    words = ["export", "--units", "si", "--model", "finnie", "--target", "mild steel", "--fluent", str(path)]
    table = erosion.to_fluent("finnie", SI.with_target("mild steel"), density=7850.0)
    assert f"C = {table.factor * 7850.0:.6e} (s/m)^2" in shell(words).out
    assert "for a target of 7850 kg/m^3" in path.read_text()


def test_the_density_sets_the_diameter(tmp_path, capsys):
    options = ["--table", str(tmp_path / "v.csv"), "--particle-density", "2650 kg/m^3", "--diameters", "1 mm"]
    assert _status(["export", "--model", "finnie", "--angles", "30deg", "--speeds", "111.76 m/s", *options]) == 0
    (row,) = rows_of(tmp_path / "v.csv")
    # A sphere of quartz; finnie removes by mass.
    mass = 2650 * np.pi / 6 * 1e-9
    case = float(erosion.impact("finnie", SI.replace(alpha=np.deg2rad(30.0))).volume)
    assert float(row["volume [m^3]"]) == pytest.approx(case * mass / float(SI.m), rel=1e-8)
    options[1] = str(tmp_path / "v.txt")
    assert _status(["export", "--model", "finnie", "--angles", "30deg", "--speeds", "111.76 m/s", *options]) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "v.txt", comments="%"), [float(text) for text in row.values()])


def test_own_parameters_are_set(tmp_path, capsys):
    path = tmp_path / "f.csv"
    words = ["export", "--model", "linearized-deformation", "--set", "energy_ratio=3", "--fluent", str(path)]
    assert _status(words) == 0
    assert "linearized-deformation (energy_ratio = 3, threshold = 0 m/s)" in path.read_text()
    assert float(path.read_text().splitlines()[-1].split(",")[1]) == pytest.approx(
        float(erosion.impact(erosion.load_model("linearized-deformation").replace(energy_ratio=3.0),
                             P.replace(alpha=np.pi / 2)).volume)
        / erosion.alpha_max(erosion.load_model("linearized-deformation").replace(energy_ratio=3.0), P).volume,
        abs=1e-5)  # fmt: skip


def test_rebounds_that_are_missing_are_said(tmp_path, capsys, shell):
    path = tmp_path / "r.csv"
    assert _status(["export", "--restitution", str(path), "--angles", "45deg, 90deg"]) == 0
    said = "7 of 14 impacts have no rebound (nan): nothing is cut, or they fail."
    assert capsys.readouterr().err == f"warning: {said}\n"
    assert (
        "of 7 impacts none has a rebound" in shell(["export", "--restitution", str(path), "--angles", "90deg"], 1).err
    )


def test_nothing_is_written_where_one_form_is_refused(tmp_path, shell):
    table, dictionary = tmp_path / "f.csv", tmp_path / "p.txt"
    assert (
        "dnv is not of that shape"
        in shell(["export", "--model", "dnv", "--fluent", str(table), "--openfoam", str(dictionary)], 2).err
    )
    assert not table.exists()
    assert not dictionary.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("export --restitution x --model dnv", "dnv has no motion of a rigid body"),
        ("export --openfoam x --model rotating --speeds 200m/s", "at 200 m/s and 2032 µm it is off by up to"),
    ],
)
def test_a_form_that_cannot_be_made_is_refused(words, message, tmp_path, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
    assert message in shell(words, 2).err
