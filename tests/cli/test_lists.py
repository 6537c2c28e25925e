"""Lists and models on the command line."""

import inspect
import re
from pathlib import Path

import pytest

from erosion.cli import _status, app
from erosion.cli.options import chosen_models, read_list, read_models
from erosion.models import usable_models
from tests.documents import Shell


def test_a_list_has_commas_between_its_items():
    assert read_list("k, psi ,,r") == ["k", "psi", "r"]
    with pytest.raises(ValueError, match="must list one item or more, but is ' , '"):
        read_list(" , ")


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


@pytest.mark.parametrize("name", ["-o", "--output", "--output="])
def test_an_output_has_one_name_and_a_letter(name, tmp_path, shell):
    out = str(tmp_path / "out.nc")
    words = [name + out] if name.endswith("=") else [name, out]
    assert shell(["sweep", "--alpha", "20deg, 30deg", *words, "--json"]).result["output"] == out


@pytest.mark.parametrize(
    "words",
    [
        "compare --models finnie",
        "sweep --alpha 5deg:9deg:3 --out x.nc",
        "run --material copper",
        "calibrate sand.csv --target-density 1",
        "map rows.csv --erodent-density 1",
        "map rows.csv --spin none",
    ],
)
def test_no_option_has_an_older_name(words, shell):
    assert f"Option `{words.split()[-2]}` is unknown." in shell(words.split(), 2).err


@pytest.mark.parametrize("words", [["20deg : 30deg"], ["20deg,30deg"], ["20deg", "30deg"]])
def test_a_range_of_angles_is_one_text_or_two(words, shell):
    best = shell(["optimum", "--alpha-range", *words, "--json"]).result
    assert (best["kind"], best["alpha"]) == ("boundary", pytest.approx(0.5235987755982988))


@pytest.mark.parametrize("verb", [name for name in app if not name.startswith("-")])
def test_help_has_no_line_that_80_columns_would_fold(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert _status([verb, "--help"]) == 0
    assert max(map(len, inspect.cleandoc(app[verb].default_command.__doc__ or "").splitlines())) <= 80


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
        {name for argument in app[verb].assemble_argument_collection() for name in argument.names} if verb else set()
    )
    said = {"--alpha", "--v0", "--case", *re.findall(r"--[\w-]+", "\n".join(lines))}  # the data give them
    assert {name for name in known if name.startswith("--")} <= said


@pytest.mark.parametrize("verb", ["calibrate", "map"])
def test_each_parameter_of_the_case_is_named_and_taken(verb, shell):
    printed = shell([verb, "--help"]).out
    for name in ("k", "psi", "r", "b", "m", "sigma", "phidot0", "inertia"):
        assert f"--{name}" in printed
    assert "Option `--sigma` must be a stress" in shell([verb, "nowhere.csv", "--sigma", "1 m"], 2).err


@pytest.mark.parametrize("verb", ["compare", "calibrate tests.csv"])
def test_two_names_of_one_model_are_refused(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tests.csv").write_text("angle [deg],mass_loss [mg/kg]\n10,2\n30,3\n60,2.5\n")
    names = ["--model", "dnv,dnv:carbon-steel", "--target", "carbon steel 1018", "--units", "si"]
    assert "`dnv` and `dnv:carbon-steel` are the same here" in shell([*verb.split(), *names], 2).err
