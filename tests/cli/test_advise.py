"""`erosion advise` as a shell runs it."""

import json

import pytest

from erosion.cli import _status
from tests.cli.test_document import check

LINE = ["advise", "--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s", "--model", "finnie"]


@pytest.mark.slow
def test_advise_prints_a_table_and_writes_a_page(capsys, tmp_path):
    page, plot = tmp_path / "advice.html", tmp_path / "curves.svg"
    assert _status([*LINE, "-o", str(page), "--plot", str(plot)]) == 0
    said = capsys.readouterr()
    assert "one model, k = 2, ψ = 2" in said.out
    assert "What would narrow it" in said.out
    assert said.err == ""
    assert page.read_text().startswith("<!DOCTYPE html>")
    assert plot.read_text().startswith("<?xml")


@pytest.mark.slow
def test_advise_reads_a_case_file_and_prints_a_document(capsys, tmp_path):
    case = tmp_path / "case.toml"
    case.write_text('particle = "garnet 0.3 mm"\ntarget = "copper"\nk = 2\npsi = 2\nv0 = "80 m/s"\nalpha = "20 deg"\n')
    assert _status(["advise", str(case), "--model", "finnie", "--target", "aluminium 6061", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    check(document)
    result = document["result"]
    assert (result["particle"], result["target"], result["cutting_fraction"]) == (
        "garnet 0.3 mm",
        "aluminium 6061",
        0.5,
    )
    assert result["density"] == {"value": 2700.0, "unit": "kg/m^3"}
    assert result["curves"][0]["erosion_ratio"]["unit"] == "kg/kg"
    assert result["low"]["value"] < result["alpha"]["value"] < result["high"]["value"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--spread", "3 m"], "Option `--spread` must be an angle"),
        (["--spread", "0 deg"], "Option `--spread` must be above 0°"),
        (["--speed-spread", "2"], "Option `--speed-spread` must be at least 0"),
        (["-o", "advice.doc"], "must end in .html or .pdf"),
        (["--alpha", "20deg"], "Option `--alpha` has no meaning here"),
        (["--density", "2.7"], "Option `--density` must be a density with its unit"),
    ],
)
def test_bad_options_are_one_line(capsys, options, message):
    assert _status([*LINE, *options]) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert said.out == ""
