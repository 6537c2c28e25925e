"""A path in a file begins at the file's folder; a path on the command line at the working folder."""

import json
import tomllib
from pathlib import Path

import pytest

from erosion.cli import _status
from erosion.fits import calibrate, to_case
from erosion.fits.posterior_files import model_of_draws
from erosion.models import ProportionalDeformationWear, Rotating, TanAlpha
from erosion.parameters.case_files import CaseFile, load_case

PLUG_IN = """
import erosion

class Soft(erosion.models.ForceLaw):
    softness: float = {softness}

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * self.softness * tip.depth
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k * self.softness

model = erosion.models.Linearized(force=Soft())
"""
CASE = """
model = "plug.py"
particle = "grit.toml: slag 0.3 mm"
target = "mt.toml: mine"
k = 1
psi = 2
v0 = "100 m/s"
alpha = "20 deg"

[stream]
n = 256
phidot0 = "samples(jet.csv)"
rows = "rows.csv"
uncertain = "draws.csv"
"""


def _fill(folder: Path, scale: float) -> None:
    """Files of the names in `CASE`, of other numbers in each folder."""
    folder.mkdir(exist_ok=True)
    (folder / "plug.py").write_text(PLUG_IN.format(softness=scale))
    (folder / "grit.toml").write_text(f"[particles.slag]\ndensity = {2800 * scale}\n")
    (folder / "mt.toml").write_text(f'[targets.mine]\nflow_stress = "{scale} GPa"\npsi = 2\ndensity = {7000 * scale}\n')
    (folder / "jet.csv").write_text(f"phidot0 [rad/s]\n{scale}\n{2 * scale}\n")
    (folder / "rows.csv").write_text(f"v0 [m/s]\n{100 * scale}\n{110 * scale}\n")
    (folder / "draws.csv").write_text(f"psi\n{scale}\n{1.5 * scale}\n")


@pytest.fixture
def two_folders(tmp_path, monkeypatch):
    """The working folder with files of the same names as those of the case's folder, which differ."""
    _fill(tmp_path, 3.0)
    _fill(tmp_path / "cases", 1.0)
    (tmp_path / "cases" / "case.toml").write_text(CASE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_path_of_a_case_begins_at_its_folder(two_folders):
    case = Path("cases/case.toml")
    assert load_case(case).to("si").sigma == pytest.approx(1e9)
    assert load_case(case).to("si").m == pytest.approx(2800 * 3.14159265 * 0.0003**3 / 6)
    assert CaseFile.read(case).model()[0] == "cases/plug.py"
    assert CaseFile.read(case).section("stream") == {
        "n": 256, "phidot0": "samples(cases/jet.csv)", "rows": "cases/rows.csv", "uncertain": "cases/draws.csv"
    }  # fmt: skip


@pytest.mark.parametrize("verb", ["run", "stream"])
def test_a_case_gives_the_same_from_every_folder(two_folders, monkeypatch, shell, verb):
    def computed(case: str) -> str:
        return json.dumps(shell([verb, case, "--json"]).result)

    from_above = computed("cases/case.toml")
    monkeypatch.chdir(two_folders / "cases")
    assert computed("case.toml") == from_above


def test_a_path_of_an_option_begins_at_the_working_folder(two_folders, shell):
    document = shell("run cases/case.toml --model plug.py --json").document
    assert document["model"]["own_parameters"]["softness"]["value"] == 3.0


def test_the_option_that_names_the_model_of_the_file_keeps_its_numbers(two_folders, shell):
    case = Path("cases/case.toml")
    case.write_text("set = {softness = 2.0}\n" + CASE)
    document = shell(["run", str(case), "--model", "../" + Path.cwd().name + "/cases/plug.py", "--json"]).document
    assert document["model"]["own_parameters"]["softness"]["value"] == 2.0


def test_what_is_not_beside_the_case_is_named_where_it_was_looked_for(two_folders, shell):
    Path("cases/plug.py").unlink()
    assert "cases/plug.py" in shell("run cases/case.toml", 2).err


def test_many_models_are_no_path_that_is_too_long(tmp_path, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
    models = ",".join(f"rotating-{number}" for number in range(30))
    assert (
        "rotating-0"
        in shell(["sweep", "--model", models, "--alpha", "20deg:30deg:2", "-o", "out.csv"], 2).err.partition(
            "known are"
        )[0]
    )


ROWS = "angle [deg], volume [mm^3], uncertainty [mm^3]\n10,2e-2,1e-3\n20,3e-2,1e-3\n30,2e-2,1e-3\n"


def test_the_case_of_a_plug_ins_fit_names_its_file(two_folders, capsys):
    Path("weighed.csv").write_text(ROWS)
    Path("out").mkdir()
    fit = ["posterior", "weighed.csv", "cases/case.toml", "--target", "mt.toml: mine", "--free", "k", "--starts", "1"]
    files = ["--write-case", "out/fitted.toml", "--draws", "125", "-o", "out/post.nc"]
    assert _status([*fit, *files]) == 0
    written = tomllib.loads(Path("out/fitted.toml").read_text())
    assert written["model"] == "../cases/plug.py"
    assert (written["particle"], written["target"]) == ("../cases/grit.toml: slag 0.3 mm", "../mt.toml: mine")
    assert CaseFile.read("out/fitted.toml").model()[1] == {"softness": 1.0}
    assert Path(model_of_draws("out/post.nc")).resolve() == Path("cases/plug.py").resolve()
    for verb in (["run", "out/fitted.toml"], ["advise", "out/fitted.toml", "--uncertain", "out/post.nc"]):
        capsys.readouterr()
        assert _status(verb) == 0, capsys.readouterr().err
    # Another number of its own is no other model, another equation is one.
    for text, changed in (("= 9.0", False), ("= 9.0\n    _ = 'words'", False), ("= 9.0", True)):
        law = PLUG_IN.replace("horizontal = -", "horizontal = -2 * ") if changed else PLUG_IN
        Path("cases/plug.py").write_text(law.replace("= {softness}", text))
        for verb in (["predict", "out/post.nc"], ["advise", "out/fitted.toml", "--uncertain", "out/post.nc"]):
            assert _status(verb) == 2 * changed
            assert ("its equations have changed since" in capsys.readouterr().err) == changed
        assert _status(["run", "out/fitted.toml"]) == 0
        assert ("the equations of out/../cases/plug.py have changed" in capsys.readouterr().err) == changed


def test_a_model_without_a_file_is_refused_a_case(two_folders):
    made = Rotating(force=TanAlpha(), deformation=ProportionalDeformationWear(2.0))
    Path("weighed.csv").write_text(ROWS)
    fit = calibrate(made, load_case("cases/case.toml"), "weighed.csv", ["psi"], starts=1)
    with pytest.raises(ValueError, match="file"):
        to_case(fit)
