"""One protocol of progress for every verb, and the bar that shows it."""

import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from erosion.cli import exit_status
from erosion.cli.output import progress_bar
from erosion.parameters.quantities import QUANTITIES

ROOT = Path(__file__).parents[2]


def test_run_takes_a_model_and_parameters(shell):
    assert shell("run --model rotating --alpha 20deg --json").result["volume"] == pytest.approx(
        1.014085387462e-04, rel=1e-10
    )
    printed = shell(["run", str(ROOT / "examples/table-1-si.toml"), "--v0", "8800 in/s", "--json"]).result
    assert printed["volume"] == pytest.approx(4 * 1.816436352531e-04 * 0.0254**3, rel=1e-10)


@pytest.mark.parametrize(
    ("program", "unused"),
    [
        ("from erosion.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass", {"jax"}),
        (
            "import erosion, erosion.cli; erosion.alpha_max",
            {"diffrax", "matplotlib", "pandas", "pint", "rich", "scipy", "xarray"},
        ),
        # Ctrl-C is not heeded before.
        ("import erosion.__main__", {"ast", "importlib.resources", "typing", "concurrent.futures"}),
    ],
    ids=["help", "optimum", "start"],
)
def test_what_is_not_used_is_not_imported(program, unused):
    code = f"import sys; sys.path[:0] = {sys.path!r}\n{program}\nprint({unused!r} & {{*sys.modules}})"
    # Without `site`, which imports what it likes.
    done = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.endswith("set()\n")


def test_models_lists_a_bad_file_with_its_reason_and_goes_on(shell, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "a_bad.py").write_text("1/0")
    (tmp_path / "good.py").write_text('"""One of mine."""\nimport erosion\nmodel = erosion.models.Rotating()\n')
    captured = shell(["models", "--path", str(tmp_path), "--json"], 1)
    printed = captured.document["result"]["models"]
    assert "ZeroDivisionError" in printed[str(tmp_path / "a_bad.py")]["error"]
    good = {"summary": "One of mine.", "equations": "plug-in", "error": None, "own_parameters": {}}
    assert printed[str(tmp_path / "good.py")] == good
    assert captured.err == "erosion: 1 of 16 models cannot be used.\n"
    assert "run as Python" in " ".join(shell("models --help").out.replace("│", " ").split())


@pytest.fixture
def far_model(tmp_path):
    """A model file whose path has more than 150 characters, in parts that a table would fold at hyphens and spaces."""
    folder = tmp_path / "-".join(["long"] * 20) / " ".join(["name"] * 10)
    folder.mkdir(parents=True)
    return Path(shutil.copy(ROOT / "models/coulomb_tip.py", folder))


@pytest.mark.parametrize("words", ["models --path", "run --model"])
def test_a_long_path_is_never_broken(far_model, shell, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "80")
    lines = shell([*words.split(), str(far_model.parent if words.startswith("models") else far_model)]).out.splitlines()
    assert any(str(far_model) in line for line in lines)


def test_every_parameter_of_an_impact_is_an_option(shell, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    printed = shell("run --help").out
    for name, quantity in QUANTITIES.items():
        assert f" --{name} " in printed
        assert f"{quantity.symbol}, {quantity.meaning}" in printed
    assert 'v₀, impact speed: "4400 in/s".' in printed


def test_a_mass_that_fits_no_body_of_the_size_is_a_warning(shell):
    said = shell("run --r '0.3 mm' --json")
    assert said.err.startswith("warning: m does not fit r and b: ")
    assert [f"{one['level']}: {one['text']}" for one in said.document["findings"]] == said.err.splitlines()
    assert "does not fit" not in shell("run --particle 'garnet 0.3 mm'").err


def test_materials_lists_names_ranges_and_sources(shell, tmp_path, written, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    out = shell("materials").out
    assert re.search(r"4190 +4090 … 4310", out)
    assert re.search(r"hardness \[HV\].*\n.*\n.* 107 ", out)
    table = written("mine.toml", '[targets."my alloy"]\nvickers = 200\n')
    result = shell(["materials", str(table), "--json"]).document["result"]
    assert result["particles"] == []
    assert result["targets"][0]["flow_stress"] == {"value": pytest.approx(200 * 9.80665e6), "unit": "Pa"}
    assert exit_status(["materials", str(tmp_path / "none.toml")]) == 2


NAMED = ["--units", "si", "--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s"]


def test_compare_and_sweep_write_tables_for_spreadsheets(shell, tmp_path):
    table = tmp_path / "curves.csv"
    first = shell(["compare", *NAMED, "--model", "linearized,dnv:aluminium", "-o", str(table), "--json"]).document[
        "result"
    ]["models"][0]
    assert first["erosion_ratio_max"]["value"] > first["erosion_ratio"]["value"] > 1e-3
    heading, *lines = table.read_text().splitlines()
    assert heading.startswith("model,alpha [deg],volume [m^3]")
    assert heading.endswith("specific_volume [mm^3/kg],erosion_ratio [g/kg]")
    assert len(lines) == 2 * 360
    table = tmp_path / "grid.csv"
    result = shell(["sweep", *NAMED, "--alpha", "10deg,20deg", "-o", str(table), "--json"]).document["result"]
    assert result["erosion_ratio_greatest"]["value"] == pytest.approx(3.38e-3, rel=1e-2)
    assert len(table.read_text().splitlines()) == 3
    assert exit_status(["sweep", *NAMED, "--alpha", "10deg,20deg", "-o", str(table), "--workers", "2"]) == 2
    assert "warning: m does not fit r and b" in shell(["sweep", "--r", "0.2mm,0.4mm", "-o", str(table)]).err


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_bar_shows_the_work_and_how_much_of_it_is_done_on_a_terminal(monkeypatch, is_terminal):
    monkeypatch.setenv("TERM", "xterm")
    shown = io.StringIO()
    monkeypatch.setattr(shown, "isatty", lambda: is_terminal)
    monkeypatch.setattr("sys.stderr", shown)
    with progress_bar("reading") as progress:
        progress("fitting finnie", 1, 4)
    for text in ("fitting finnie", "25%"):
        assert (text in shown.getvalue()) == is_terminal
    assert is_terminal or shown.getvalue() == ""
