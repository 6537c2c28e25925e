"""A path in a file begins at the file's folder; a path on the command line at the working folder.

Names of columns at the command line: of impacts in `map`, of weighings in `calibrate`, of rows in `stream`.
"""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cli import exit_status
from erosion.fits.fit_files import model_of_draws, read_draws
from erosion.parameters.case_files import CaseFile, load_case
from erosion.parameters.quantities import QUANTITIES
from tests.documents import Shell

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


def test_what_is_not_beside_the_case_is_named_where_it_was_looked_for(two_folders, shell):
    Path("cases/plug.py").unlink()
    assert "cases/plug.py" in shell("run cases/case.toml", 2).err


def test_many_models_are_no_path_that_is_too_long(shell):
    models = ",".join(f"rotating-{number}" for number in range(30))
    assert (
        "rotating-0"
        in shell(["sweep", "--model", models, "--alpha", "20deg:30deg:2", "-o", "out.csv"], 2).err.partition(
            "known are"
        )[0]
    )


ROWS = "angle [deg], volume [mm^3/impact], uncertainty [mm^3]\n10,2e-2,1e-3\n20,3e-2,1e-3\n30,2e-2,1e-3\n"


def test_the_case_of_a_plug_ins_fit_names_its_file(two_folders, capsys):
    Path("weighed.csv").write_text(ROWS)
    Path("out").mkdir()
    fit = ["posterior", "weighed.csv", "cases/case.toml", "--target", "mt.toml: mine", "--free", "k", "--starts", "1"]
    files = ["--write-case", "out/fitted.toml", "--draws", "125", "-o", "out/post.nc"]
    assert exit_status([*fit, *files]) == 0
    written = tomllib.loads(Path("out/fitted.toml").read_text())
    assert written["model"] == "../cases/plug.py"
    assert (written["particle"], written["target"]) == ("../cases/grit.toml: slag 0.3 mm", "../mt.toml: mine")
    assert CaseFile.read("out/fitted.toml").model()[1] == {"softness": 1.0}
    assert Path(model_of_draws("out/post.nc")).resolve() == Path("cases/plug.py").resolve()
    # The commands of an advice name the table as the user finds it.
    assert written["advise"]["data"] == "../weighed.csv"
    assert Path(read_draws("out/post.nc", QUANTITIES).data).samefile("weighed.csv")
    for verb in (["run", "out/fitted.toml"], ["advise", "out/fitted.toml", "--uncertain", "out/post.nc"]):
        capsys.readouterr()
        assert exit_status(verb) == 0, capsys.readouterr().err
    # Another number of its own is no other model, another equation is one.
    for text, changed in (("= 9.0\n    _ = 'words'", False), ("= 9.0", True)):
        law = PLUG_IN.replace("horizontal = -", "horizontal = -2 * ") if changed else PLUG_IN
        Path("cases/plug.py").write_text(law.replace("= {softness}", text))
        for verb in (["predict", "out/post.nc"], ["advise", "out/fitted.toml", "--uncertain", "out/post.nc"]):
            assert exit_status(verb) == 2 * changed
            assert ("its equations have changed since" in capsys.readouterr().err) == changed
        assert exit_status(["run", "out/fitted.toml"]) == 0
        assert ("the equations of out/../cases/plug.py have changed" in capsys.readouterr().err) == changed


SI_CASE = ["--units", "si", "--particle", "quartz 0.1 mm"]


IMPACTS = "diameter [um],density [kg/m^3],speed [m/s],angle [deg],{},note\n100,2650,50,30,13,a\n100,2650,60,20,13,b\n"


def test_a_map_has_the_weights_of_its_rows_or_says_why_not(shell: Shell) -> None:
    pytest.importorskip("pyarrow")
    volumes = {}
    for name in ("count", "frequency [1/s]", "note 2"):
        Path("a.csv").write_text(IMPACTS.format(name))
        one = ["--each-row", "1 particle"] * (name == "note 2")
        printed = shell(["map", "a.csv", *SI_CASE, *one, "--json"])
        volumes[name], err = printed.result["total_volume"], printed.err
        assert "columns that are not used: " in err
    assert "Option `--each-row` must say it" in shell(["map", "a.csv", *SI_CASE], 2).err
    assert volumes["frequency [1/s]"] == volumes["count"]
    np.testing.assert_allclose(volumes["count"], 13 * volumes["note 2"], rtol=1e-12)
    Path("a.csv").write_text(IMPACTS.format("hits"))
    assert "a.csv: column 'hits' is not understood" in shell(["map", "a.csv", *SI_CASE], 2).err
    printed = shell(["map", "a.csv", *SI_CASE, "--json", "--each-row", "1 particle", "--ignore", "hits,note"])
    assert (printed.result["total_volume"], "not used" in printed.err) == (volumes["note 2"], False)
    assert "a.csv: has no column 'hit'" in shell(["map", "a.csv", *SI_CASE, "--ignore", "hit"], 2).err


def test_a_fit_has_the_speeds_of_its_rows_or_is_refused(shell: Shell) -> None:
    p = erosion.TABLE_1.to("si").replace(psi=0.04)
    degrees, speeds = np.tile(np.linspace(10, 60, 9), 2), np.repeat([60.0, 120.0], 9)
    volumes = np.asarray(erosion.impact("linearized", p.replace(alpha=np.deg2rad(degrees), v0=speeds)).volume)
    rows = "".join(f"{a:g},{v * 1e9:.9g},{s:g}\n" for a, v, s in zip(degrees, volumes, speeds, strict=True))
    free = ["--free", "psi", "--units", "si", "--json", "--starts", "2"]
    for name in ("speed [m/s]", "v [m/s]", "velocity [m/s]", "speed (m/s)"):
        Path("a.csv").write_text(f"angle [deg],volume [mm^3/impact],{name}\n{rows}")
        out, _ = shell(["calibrate", "a.csv", *free])
        assert json.loads(out)["result"]["estimates"]["psi"]["value"] == pytest.approx(0.04, rel=1e-3)
    Path("a.csv").write_text(f"angle [deg],volume [mm^3/impact],jet velocity [m/s]\n{rows}")
    _, err = shell(["calibrate", "a.csv", *free], 2)
    assert "column 'jet velocity [m/s]'" in err
    assert "`speed`" in err
    assert "Option `--ignore`" in err
    assert "not used" not in shell(["calibrate", "a.csv", *free, "--ignore", "jet velocity"]).err


def test_rows_of_a_stream_have_their_speeds_or_are_refused(shell: Shell) -> None:
    means = {}
    for name in ("v0 [m/s]", "Impact Velocity (m/s)"):
        Path("a.csv").write_text(f"alpha [deg],{name},cell\n20,200,1\n30,300,2\n")
        out, err = shell(["stream", "--units", "si", "--rows", "a.csv", "--n", "64", "--json"])
        assert "a.csv: columns that are not used: 'cell'." in err
        means[name] = json.loads(out)["result"]["mean_volume"]["value"]
    assert len({*means.values()}) == 1
    Path("a.csv").write_text("alpha [deg],v_rel [m/s]\n20,200\n30,300\n")
    refused = shell("stream --units si --rows a.csv --n 64", 2)
    assert "a.csv: column 'v_rel [m/s]' has the unit of a speed" in refused.err


def test_draws_of_a_table_may_have_the_share_of_particles_that_cut(shell: Shell) -> None:
    pytest.importorskip("pyarrow")
    Path("a.csv").write_text(IMPACTS.format("count"))
    volumes = []
    for share in (1.0, 0.25):
        Path("draws.csv").write_text(f"psi,cutting_fraction,chain\n0.04,{share},1\n0.05,{share},2\n")
        given = [*SI_CASE, "--uncertain", "draws.csv", "--draws", "4"]
        out, err = shell(["map", "a.csv", *given, "--json"])
        assert "draws.csv: columns that are not used: 'chain'." in err
        volumes.append(json.loads(out)["result"]["total_volume"]["value"])
    assert volumes[1] == pytest.approx(0.25 * volumes[0])
    # A stream takes a number alone for this share, whatever gives it.
    shell("stream --v0 'normal(110, 5)' --units si --uncertain draws.csv", 2)


WEIGHTS = (
    "count", "weight", "n", "nParticle", "N_p", "frequency", "frequency [1/s]", "rate [1/s]", "mass_flow [kg/s]",
    "mass flow rate", "probability", "share", "fraction", "Anzahl", "rel. frequency", "wt", "particles",
)  # fmt: skip


@pytest.mark.parametrize("head", WEIGHTS)
@pytest.mark.parametrize("how", [["--rows", "a.csv"], ["--v0", "samples(a.csv)"]])
def test_rows_that_do_not_count_alike_are_refused(tmp_path: Path, shell: Shell, head: str, how: list[str]) -> None:
    (tmp_path / "a.csv").write_text(f"v0 [m/s],{head}\n100,1\n300,1000\n")
    assert head in shell(["stream", "--n", "64", "--no-best-angle", *how], 2).err
