import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from erosion.cli import _status
from erosion.cli.errors import InputError
from erosion.cli.options import CaseOptions
from erosion.cli.output import Output
from erosion.parameters.quantities import QUANTITIES
from tests.documents import result_of

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def erosion(*arguments, **options):
    """The command as a shell runs it."""
    command = [sys.executable, "-c", "from erosion.cli import main; main()", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)


def test_run_prints_the_reference_as_json(capsys):
    assert _status(["run", "--case", str(ROOT / "cases/table-1.toml"), "--json"]) == 0
    printed = result_of(capsys.readouterr().out)
    assert printed["volume"] == pytest.approx(1.816436352531e-04, rel=1e-10)
    assert printed["ended_by"] == "rebound"
    assert printed["t_c"] == pytest.approx(6.6353363429e-05, rel=1e-10)
    assert printed["dvolume"] == pytest.approx(3.072135725e-4, rel=1e-9)


def test_run_takes_a_model_and_parameters(capsys):
    assert _status(["run", "--model", "rotating", "--alpha", "20deg", "--json"]) == 0
    assert result_of(capsys.readouterr().out)["volume"] == pytest.approx(1.014085387462e-04, rel=1e-10)
    assert _status(["run", "--case", str(ROOT / "cases/table-1-si.toml"), "--v0", "8800 in/s", "--json"]) == 0
    printed = result_of(capsys.readouterr().out)
    assert printed["volume"] == pytest.approx(4 * 1.816436352531e-04 * 0.0254**3, rel=1e-10)


def test_run_prints_a_table_and_draws(capsys, tmp_path):
    assert _status(["run", "--plot", str(tmp_path / "cut.svg")]) == 0
    out = capsys.readouterr().out
    assert "1.81644   10⁻⁴ in³" in out
    assert "2.97661   mm³" in out
    assert (tmp_path / "cut.svg").read_text().startswith("<?xml")


def test_a_far_turn_is_a_warning_on_stderr(capsys):
    assert _status(["run", "--model", "rotating-tan-alpha", "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("warning: The body turned by 155")
    assert json.loads(captured.out)["warnings"]


def test_models_lists_them_all(capsys):
    assert _status(["models", "--json"]) == 0
    assert len(result_of(capsys.readouterr().out)["models"]) == 14
    assert _status(["models", "--path", str(ROOT / "models")]) == 0
    assert "saturating_lip" in capsys.readouterr().out


def test_a_material_replaces_the_flow_stress_and_the_contact_ratio(capsys):
    assert _status(["run", "--units", "si", "--target", "copper", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["case"]["parameters"]["sigma"]["value"] == pytest.approx(10e3 * 6894.757293168, rel=1e-12)
    # V is proportional to 1/(σψ), and ψ is that of the hardness: σψ = 2 · 52 kgf/mm².
    softer = 0.04 * 200e3 * 6894.757293168 / (2 * 52 * 9.80665e6)
    assert printed["result"]["volume"]["value"] == pytest.approx(softer * 1.816436352531e-04 * 0.0254**3, rel=1e-9)


def test_models_lists_a_bad_file_with_its_reason_and_goes_on(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "a_bad.py").write_text("1/0")
    (tmp_path / "good.py").write_text('"""One of mine."""\nimport erosion\nmodel = erosion.models.Rotating()\n')
    assert _status(["models", "--path", str(tmp_path), "--json"]) == 1
    captured = capsys.readouterr()
    printed = json.loads(captured.out)["result"]["models"]
    assert "ZeroDivisionError" in printed[str(tmp_path / "a_bad.py")]["error"]
    good = {"summary": "One of mine.", "equations": "plug-in", "error": None, "own_parameters": {}}
    assert printed[str(tmp_path / "good.py")] == good
    assert captured.err == "erosion: 1 of 16 models cannot be used.\n"
    assert _status(["models", "--help"]) == 0
    assert "run as Python" in " ".join(capsys.readouterr().out.replace("│", " ").split())


@pytest.mark.parametrize("columns", [80, 120])
def test_models_table_fits_the_terminal(capsys, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    assert _status(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= columns
    assert any("rotating-velocity-aligned-full-torque " in line for line in lines)


@pytest.fixture
def far_model(tmp_path):
    """A model file whose path has more than 150 characters, in parts that a table would fold at hyphens and spaces."""
    folder = tmp_path / "-".join(["long"] * 20) / " ".join(["name"] * 10)
    folder.mkdir(parents=True)
    return Path(shutil.copy(ROOT / "models/coulomb_tip.py", folder))


@pytest.mark.parametrize("columns", ["80", "120"])
@pytest.mark.parametrize("words", ["models --path", "run --model", "optimum --model", "compare --model finnie --model"])
def test_a_long_path_is_never_broken(far_model, capsys, monkeypatch, words, columns):
    monkeypatch.setenv("COLUMNS", columns)
    assert len(str(far_model)) > 150
    assert _status([*words.split(), str(far_model.parent if words.startswith("models") else far_model)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(str(far_model) in line for line in lines)
    assert all(len(line) <= int(columns) for line in lines if str(far_model) not in line)


def test_help_comes_without_jax():
    code = "import sys; from erosion.cli import main\ntry: main(['--help'])\nfinally: assert 'jax' not in sys.modules"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert process.returncode == 0, process.stderr
    assert "Compute" in process.stdout


@pytest.mark.slow
def test_an_optimum_comes_without_what_it_does_not_use():
    unused = {"diffrax", "matplotlib", "pandas", "pint", "rich", "scipy", "xarray"}
    code = f"import sys, erosion, erosion.cli; erosion.alpha_max; sys.exit({unused} & {{*sys.modules}} or 0)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert process.returncode == 0, process.stderr


@pytest.mark.slow
def test_the_process_exits_with_the_status():
    assert erosion("run", "--alpha", "95deg").returncode == 2
    assert erosion("--version").stdout.strip() == "0.1.0"


def test_optimum_is_printed_and_drawn(capsys, tmp_path):
    figure = tmp_path / "best.svg"
    assert _status(["optimum", "--model", "rotating", "--k", "1", "--plot", str(figure)]) == 0
    out = capsys.readouterr().out
    assert "39.996   °" in out
    assert "just below a jump, not reached" in out
    assert figure.read_text().startswith("<?xml")


def test_optimum_as_json_has_everything(capsys):
    assert _status(["optimum", "--model", "rotating", "--json", "--sensitivities"]) == 0
    printed = result_of(capsys.readouterr().out)
    assert np.rad2deg(printed["alpha"]) == pytest.approx(25.571827308, abs=1e-8)
    assert printed["kind"] == "interior"
    assert printed["certified"] is True
    assert len(printed["jumps"]) == 1
    assert set(printed["sensitivities"]) == {"k", "psi", "r", "b", "m", "v0", "sigma", "phidot0", "inertia"}


def test_compare_lists_models_at_the_case_and_at_their_best(capsys, tmp_path):
    curves = tmp_path / "curves.nc"
    assert _status(["compare", "--model", "linearized,rotating", "--output", str(curves), "--json"]) == 0
    one, other = result_of(capsys.readouterr().out)["models"]
    assert one["volume"] == pytest.approx(1.816436352531e-4, rel=1e-9)
    assert other["volume_max"] == pytest.approx(1.050019817361e-4, rel=1e-9)
    assert curves.stat().st_size > 1000


def test_compare_prints_a_table(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "120")
    plot = tmp_path / "models.svg"
    assert _status(["compare", "--model", "linearized", "--model", "tan-alpha", "--plot", str(plot)]) == 0
    out = capsys.readouterr().out
    assert "2 models: impacts at α = 20° and best angles; volumes in 10⁻⁴ in³" in out
    assert "31.717°" in out
    assert "→ 0°" in out
    assert out.endswith(f"figure: {plot}\n")
    assert plot.read_text().startswith("<?xml")


def test_a_table_keeps_units_and_names_whole(capsys):
    """rich takes brackets for markup and shortens names, unless told otherwise."""
    row = ("rotating-velocity-aligned-full-torque", "0.5", "rebound")
    Output("compare", json=False).table("Title [m]", [row], ("model", "V [in³]", "ends by"), (1,))
    printed = capsys.readouterr().out
    assert "Title [m]" in printed
    assert "V [in³]" in printed
    assert row[0] in printed


def test_every_parameter_of_an_impact_is_an_option(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    assert _status(["run", "--help"]) == 0
    printed = capsys.readouterr().out
    for name, quantity in QUANTITIES.items():
        assert f" --{name} " in printed
        assert f"{quantity.symbol}, {quantity.meaning}" in printed
    assert 'v₀, impact speed: "4400 in/s".' in printed


def test_particle_and_target_are_named_and_single_parameters_overrule_them(capsys):
    named = ["run", "--units", "si", "--particle", "garnet 0.3 mm", "--target", "aluminium 6061"]
    assert _status([*named, "--psi", "1", "--json"]) == 0
    parameters = json.loads(capsys.readouterr().out)["case"]["parameters"]
    assert parameters["r"]["value"] == 1.5e-4
    assert parameters["m"]["value"] == pytest.approx(4190 * np.pi / 6 * 3e-4**3)
    assert parameters["sigma"]["value"] == pytest.approx(107 * 9.80665e6)
    assert parameters["psi"]["value"] == 1.0


def test_a_mass_that_fits_no_body_of_the_size_is_a_warning(capsys):
    assert _status(["run", "--r", "0.3 mm", "--json"]) == 0
    said = capsys.readouterr()
    assert said.err.startswith("warning: m does not fit r and b: ")
    assert [f"warning: {message}" for message in json.loads(said.out)["warnings"]] == said.err.splitlines()
    assert _status(["run", "--particle", "garnet 0.3 mm"]) == 0
    assert "does not fit" not in capsys.readouterr().err


def test_materials_lists_names_ranges_and_sources(capsys, tmp_path):
    assert _status(["materials"]) == 0
    out = capsys.readouterr().out
    assert "4190 (4090 to 4310)" in out
    assert "107 HV" in out
    table = tmp_path / "mine.toml"
    table.write_text('[targets."my alloy"]\nvickers = 200\n')
    assert _status(["materials", str(table), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert result["particles"] == []
    assert result["targets"][0]["flow_stress"] == {"value": pytest.approx(200 * 9.80665e6), "unit": "Pa"}
    assert _status(["materials", str(tmp_path / "none.toml")]) == 2


NAMED = ["--units", "si", "--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", [["run"], ["optimum"], ["stream", "--alpha", "normal(20deg, 3deg)", "--n", "1024", "--no-best-angle"]]
)
def test_verbs_give_grams_per_kilogramme_and_the_fraction_scales_them(capsys, verb):
    assert _status([*verb, *NAMED, "--json"]) == 0
    said = capsys.readouterr()
    whole = json.loads(said.out)
    assert "is far from what tests on ductile metals find at 100 m/s" in whole["warnings"][0]
    assert _status([*verb, *NAMED, "--cutting-fraction", "0.5", "--json"]) == 0
    half = json.loads(capsys.readouterr().out)
    for document in (whole, half):
        assert document["result"]["erosion_ratio"]["unit"].count("/") == 1
    assert 2 * half["result"]["erosion_ratio"]["value"] == pytest.approx(
        whole["result"]["erosion_ratio"]["value"], rel=1e-9
    )
    assert _status([*verb, *NAMED, "--cutting-fraction", "0.1"]) == 0
    said = capsys.readouterr()
    assert "0.1 of the particles cut" in " ".join(said.out.split())
    assert "g/kg" in said.out
    assert said.err == ""


@pytest.mark.slow
def test_compare_and_sweep_write_tables_for_spreadsheets(capsys, tmp_path):
    table = tmp_path / "curves.csv"
    assert _status(["compare", *NAMED, "--model", "linearized,dnv:aluminium", "-o", str(table), "--json"]) == 0
    first = json.loads(capsys.readouterr().out)["result"]["models"][0]
    assert first["erosion_ratio_max"]["value"] > first["erosion_ratio"]["value"] > 1e-3
    heading, *lines = table.read_text().splitlines()
    assert heading.startswith("model,alpha [deg],volume [m^3]")
    assert heading.endswith("specific_volume [mm^3/kg],erosion_ratio [g/kg]")
    assert len(lines) == 2 * 360
    table = tmp_path / "grid.csv"
    assert _status(["sweep", *NAMED, "--alpha", "10deg,20deg", "-o", str(table), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert result["erosion_ratio_greatest"]["value"] == pytest.approx(3.38e-3, rel=1e-2)
    assert len(table.read_text().splitlines()) == 3
    assert _status(["sweep", *NAMED, "--alpha", "10deg,20deg", "-o", str(table), "--workers", "2"]) == 2
    assert _status(["sweep", "--r", "0.2mm,0.4mm", "-o", str(table)]) == 0
    assert "warning: m does not fit r and b" in capsys.readouterr().err


def test_a_case_is_called_by_its_title_and_what_options_change(tmp_path: Path) -> None:
    named, bare, wrong = tmp_path / "a.toml", tmp_path / "sand.toml", tmp_path / "c.toml"
    named.write_text('title = "Quartz\\non aluminium"\n')
    bare.write_text('title = ""\n')
    wrong.write_text("title = 3\n")
    assert CaseOptions().title() == "Table 1"
    assert CaseOptions(case=named).title() == "Quartz on aluminium"
    assert CaseOptions(case=bare, target="copper").title() == "sand, copper"
    parameters: dict[str, Any] = {"alpha": "40deg", "k": "3"}  # fields that are made from the table of quantities
    assert CaseOptions(**parameters).title() == "Table 1, k = 3, α = 40deg"
    with pytest.raises(InputError, match=r"c\.toml: field `title` must be text in quotes, but is 3\.$"):
        CaseOptions(case=wrong).title()
