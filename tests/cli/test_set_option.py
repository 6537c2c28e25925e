"""`--set`: a model's own parameters at the command line and in case files."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cli.options import CaseOptions, in_full, load_set, read_settings, settings
from erosion.parameters.quantities import read_quantity

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
    monkeypatch.chdir(tmp_path)
    Path("harder.py").write_text(FILE)
    return "harder.py"


def test_options_win_over_the_case_file():
    said = settings(["a = 1", "b=x=y"], {"set": {"a": 2, "c": "3 in"}}, "case.toml: `set` of [sweep]")
    assert said == {
        "a": ("Option `--set a`", "1"),
        "b": ("Option `--set b`", "x=y"),
        "c": ("case.toml: `set` of [sweep], field `c`,", "3 in"),
    }
    assert settings(None) == {}


def test_quantities_are_read_in_the_units_of_the_case(harder):
    model = erosion.load_model(harder)
    said = settings(["speed=10 m/s", "factor=2"])

    def read(units):
        return read_settings(harder, model, said, units, lambda _, *of: read_quantity(*of))

    assert read("si") == {"speed": 10.0, "factor": 2.0}
    assert read("inch-pound")["speed"] == pytest.approx(10 / 0.0254)
    assert (
        in_full(harder, load_set(harder, said, CaseOptions(), "si"), "si") == "harder.py (factor = 2, speed = 10 m/s)"
    )
    assert in_full("finnie", erosion.load_model("finnie"), "si") == "finnie"


def test_run_takes_own_parameters(harder, shell):
    printed = shell(["run", "--model", harder, "--set", "factor=2", "--json"]).document
    own = {"factor": {"value": 2.0, "unit": "1"}, "speed": {"value": 100.0, "unit": "in/s"}}
    assert printed["model"] == {"name": harder, "own_parameters": own}
    assert printed["result"]["volume"]["value"] == pytest.approx(1.816436352531e-4 / 2, rel=1e-9)  # golden; V ∝ 1/σ


def test_a_stream_of_another_model_is_another_stream(harder, shell):
    words = ["stream", "--model", harder, "--n", "64", "--no-best-angle", "--v0", "normal(4400, 40)", "-o", "jet.nc"]
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


def test_every_unit_that_is_shown_is_read():
    assert read_quantity("40.4 1/s", "rate", "si") == 40.4
    assert np.isclose(read_quantity("3 1/ms", "rate", "si"), 3000)


def test_own_parameters_have_their_units_in_titles(shell):
    assert (
        "linearized-deformation (energy_ratio = 1.6, threshold = 12 m/s): one impact"
        in shell("run --units si --model linearized-deformation --set 'threshold=12 m/s'").out
    )
