"""`--set`: a model's own parameters at the command line and in case files.

Lists and models on the command line.
"""

import re
import shutil
from pathlib import Path

import pytest

import erosion
from erosion.cli import app
from erosion.cli.options import (
    chosen_models,
    read_models,
)
from erosion.models import usable_models
from tests.documents import Shell

ROOT = Path(__file__).parents[2]
P = erosion.TABLE_1
FILE = """
import erosion

class Harder(erosion.models.ForceLaw):
    factor: float = erosion.own_parameter(1.0, "f", "factor of the flow stress")
    speed: float = erosion.own_parameter(100.0, "u", "of nothing here", "speed")

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * self.factor * tip.depth
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k

model = erosion.models.Linearized(force=Harder())
"""


@pytest.fixture
def harder(tmp_path, monkeypatch):
    """The name of a file in the folder where the verbs work: `linearized` at a multiple of the flow stress."""
    Path("harder.py").write_text(FILE)
    return "harder.py"


def test_run_takes_own_parameters(harder, shell):
    printed = shell(["run", "--model", harder, "--set", "factor=2", "--json"]).document
    own = {"factor": {"value": 2.0, "unit": "1"}, "speed": {"value": pytest.approx(100 / 0.0254), "unit": "in/s"}}
    assert printed["model"] == {"name": harder, "own_parameters": own}
    assert printed["result"]["volume"]["value"] == pytest.approx(1.816436352531e-4 / 2, rel=1e-9)  # golden; V ∝ 1/σ


def test_a_stream_of_another_model_is_another_stream(harder, shell):
    words = [
        "stream",
        "--model",
        harder,
        "--n",
        "64",
        "--no-best-angle",
        "--units",
        "inch-pound",
        "--v0",
        "normal(4400, 40)",
        "-o",
        "jet.nc",
    ]
    case = erosion.dump_case(P) + "\n[stream]\nset.factor = 2\n"
    Path("case.toml").write_text(case)
    printed = shell([*words, "case.toml", "--json"]).document
    assert printed["model"]["own_parameters"]["factor"]["value"] == 2.0
    assert printed["result"]["mean_volume"]["value"] == pytest.approx(1.816436352531e-4 / 2, rel=0.01)
    import xarray as xr

    assert xr.load_dataset("jet.nc").attrs["own_parameters"] == "factor = 2, speed = 100"
    assert (
        "holds another result (of another models); it is left as it is." in shell([*words, "--set", "factor=3"], 2).err
    )


def test_models_lists_them(shell, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    shutil.copy(ROOT / "models/coulomb_tip.py", tmp_path)
    printed = shell(["models", "--path", str(tmp_path), "--json"]).document["result"]["models"]
    friction = {"value": 0.2, "symbol": "μ", "meaning": "coefficient of friction"}
    assert printed[str(tmp_path / "coulomb_tip.py")]["own_parameters"] == {"friction": friction}
    assert printed["rotating"]["own_parameters"] == {}
    assert "friction = 0.2 μ, coefficient of friction" in " ".join(
        shell(["models", "--path", str(tmp_path)]).out.split()
    )


def test_the_path_of_a_model_file_may_have_a_comma(tmp_path):
    path = tmp_path / "mine,yours.py"
    assert len(read_models(str(path))) == 2
    path.touch()
    assert read_models(str(path)) == [str(path)]


def test_all_names_every_usable_model():
    assert chosen_models(["all"]) == usable_models()
    assert chosen_models(["finnie"]) == ["finnie"]


@pytest.mark.parametrize(
    "words", ["--model linearized,finnie", "--model linearized --model finnie", "--model linearized finnie"]
)
def test_models_are_named_with_commas_or_by_repeating(words, shell):
    compared = shell(["compare", *words.split(), "--json"]).result["models"]
    assert [line["model"] for line in compared] == ["linearized", "finnie"]


@pytest.mark.parametrize("words", [["20:30 deg"], ["20deg : 30deg"], ["20deg,30deg"], ["20", "30deg"]])
def test_a_range_of_angles_is_one_text_or_two(words, shell):
    best = shell(["optimum", "--alpha-range", *words, "--json"]).result
    assert (best["kind"], best["alpha"]) == ("boundary", pytest.approx(0.5235987755982988))


GROUPS = {
    "": ["Compute", "Fit", "CFD", "Teach", "Check", "Options"],
    "calibrate": ["Case", "Model", "Fit", "Output"],
    "map": ["Surface", "Impacts", "Case", "Laws", "Output"],
}


@pytest.mark.parametrize("verb", GROUPS)
def test_the_help_of_a_big_verb_is_one_screen_with_all_options(verb, shell, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = shell([*verb.split(), "--help"]).out.splitlines()
    assert len(lines) <= 40
    assert [line for line in lines if line in GROUPS[verb]] == GROUPS[verb]
    known = (
        {name for argument in app[verb].assemble_argument_collection() for name in argument.names if argument.parse}
        if verb
        else set()
    )
    said = {
        "--alpha",
        "--v0",
        *re.findall(r"--[\w-]+", "\n".join(lines)),
    }  # the data give them
    assert {name for name in known if name.startswith("--")} <= said


@pytest.mark.parametrize("verb", ["compare", "calibrate tests.csv"])
def test_two_names_of_one_model_are_refused(verb: str, shell: Shell) -> None:
    Path("tests.csv").write_text("angle [deg],mass_loss [mg/kg]\n10,2\n30,3\n60,2.5\n")
    names = ["--model", "dnv,dnv:carbon-steel", "--target", "carbon steel 1018", "--units", "si"]
    assert "`dnv` and `dnv:carbon-steel` are the same here" in shell([*verb.split(), *names], 2).err
