"""Particle, target, density and the share that cuts, at the command line of each verb and in case files."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.cli import exit_status
from erosion.parameters.case_files import dump_case
from tests.documents import Shell, findings

NAMES = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061"]
SHARE = ["--cutting-fraction", "0.03"]
CASE = """units = "si"
particle = "garnet 0.3 mm"
target = "aluminium 6061"
cutting_fraction = 0.03
k = 2
v0 = 100
alpha = "20 deg"
"""
AT = ["--units", "si", "--k", "2", "--v0", "100 m/s"]
ANGLE = ["--alpha", "20 deg"]


@pytest.fixture(autouse=True)
def in_folder(in_folder: Path) -> Path:
    (in_folder / "case.toml").write_text(CASE)
    return in_folder


def document(words: list[str], shell: Shell) -> dict[str, Any]:
    return shell([*words, "--json"]).document


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "--sigma", "300 MPa"], True),
        (["optimum", "--sigma", "1040 MPa"], False),  # within what the table spans
        (["run", "--sigma", "300 MPa", "--psi", "7"], False),
        (["stream", "--n", "256", "--no-best-angle", "--sigma", "normal(300 MPa, 10 MPa)"], True),
        (["stream", "--n", "256", "--no-best-angle", "--sigma", "normal(1040 MPa, 10 MPa)"], False),
        (["stream", "--n", "256", "--no-best-angle", "--sigma", "normal(300 MPa, 10 MPa)", "--psi", "7"], False),
        (["sweep", "-o", "table.csv", "--sigma", "300 MPa, 1000 MPa"], True),
        (["compare", "--model", "linearized,dnv", "--sigma", "300 MPa"], True),
    ],
)
def test_another_flow_stress_beside_a_metals_psi_is_said(words: list[str], says: bool, shell: Shell) -> None:
    assert shell([*words, *NAMES, *AT]).err.count("ψ = 2 of aluminium 6061 stays beside another flow stress") == says


FITTED = (
    CASE
    + """model = "linearized-deformation"
set = { energy_ratio = 9.0, threshold = "8 m/s" }
"""
)


def test_another_cutting_fraction_than_that_of_a_case_file_is_said(shell: Shell, in_folder: Path) -> None:
    (in_folder / "fitted.toml").write_text(FITTED)
    words = {
        "run": [], "optimum": [], "sweep": ["--alpha", "0.2, 0.3", "-o", "table.csv"],
        "stream": [*JET[:3], "--alpha", "normal(20deg, 3deg)"],
        "compare": ["--model", "linearized,finnie"], "advise": [],
    }  # fmt: skip
    for verb, more in words.items():
        says = "--cutting-fraction takes the place of cutting_fraction = 0.03 in fitted.toml"
        printed = shell([verb, "fitted.toml", *more, "--cutting-fraction", "0.5"])
        assert (verb, printed.err.count(says)) == (verb, 1)
    assert "takes the place" not in shell("run fitted.toml --cutting-fraction 0.03").err


def test_a_fitted_model_keeps_its_own_parameters_among_others(shell: Shell, in_folder: Path) -> None:
    (in_folder / "fitted.toml").write_text(FITTED)
    alone = document(["run", "fitted.toml", "--alpha", "60 deg"], shell)["result"]["volume"]["value"]
    both = ["--model", "linearized,linearized-deformation"]
    compared = document(["compare", "fitted.toml", "--alpha", "60 deg", *both], shell)["result"]["models"]
    assert compared[1]["volume"]["value"] == pytest.approx(alone, rel=1e-9, abs=0)
    assert exit_status(["sweep", "fitted.toml", "--alpha", "60 deg, 70 deg", "-o", "table.csv", *both]) == 0
    (row,) = [line for line in Path("table.csv").read_text().splitlines() if line.startswith("linearized-def")][:1]
    assert float(row.split(",")[2]) == pytest.approx(alone, rel=1e-9, abs=0)


IMPACTS = "count,diameter [um],speed [m/s],angle [deg]\n1,300,100,20\n1,300,100,40\n"
JET = ["--n", "256", "--no-best-angle", "--phidot0", "normal(0 rad/s, 1 rad/s)"]
VERBS = {
    "run": (["run"], ANGLE),
    "optimum": (["optimum"], []),
    "compare": (["compare", "--model", "linearized,finnie"], ANGLE),
    "sweep": (["sweep", "-o", "table.csv", "--phidot0", "0,1 rad/s"], ANGLE),
    "stream": (["stream", *JET], ANGLE),
    "advise": (["advise", "--model", "linearized"], []),
}


FAR = ("above_tests", "below_tests")


@pytest.mark.parametrize("verb", VERBS)
def test_a_case_file_says_the_same_as_options(verb: str, shell: Shell) -> None:
    words, angle = VERBS[verb]
    by_options = document([*words, *NAMES, *AT, *angle, *SHARE], shell)
    by_file = document([words[0], "case.toml", *words[1:]], shell)
    for key in ("result", "findings"):
        # Printed commands name the file, or the options.
        one, other = (
            re.sub("“erosion [^”]*”", "", json.dumps(given[key], ensure_ascii=False)) for given in (by_options, by_file)
        )
        assert one == other
    assert "erosion_ratio" in json.dumps(by_file["result"])
    assert not findings(by_file, *FAR) or verb == "advise"


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_that_weighs_says_where_erosion_is_far_from_tests(verb: str, shell: Shell) -> None:
    words, angle = VERBS[verb]
    share = ["--cutting-fraction", "0.9"]
    (far,) = findings(
        document([*words, *NAMES, "--v0", "100 m/s", *angle, *share], shell), "above_tests", "below_tests"
    )
    assert (far["code"], far["numbers"]["unit"]) == ("above_tests", "g/kg")
    (far,) = findings(document([*words, *angle, *share], shell), *FAR)
    assert (far["code"], far["numbers"]["unit"]) == ("above_tests", "mm³/kg")
    # Nobody asks for amounts of the scenario's case, but advice is about them.
    assert bool(findings(document([*words, *angle], shell), *FAR)) == (verb == "advise")


def test_calibrate_takes_the_density_of_the_target(shell: Shell) -> None:
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061")
    alpha = np.deg2rad([10.0, 20, 30, 45, 60])
    volume = np.asarray(erosion.impact("linearized", p.replace(alpha=alpha, k=2.5)).volume)
    loss = 0.25 * 2700 * volume / float(p.m) * 1e6
    rows = [f"{float(np.rad2deg(a))!r},{v!r},{v * 0.01!r}" for a, v in zip(alpha.tolist(), loss.tolist(), strict=True)]
    Path("data.csv").write_text("angle [deg],mass_loss [mg/kg],uncertainty [mg/kg]\n" + "\n".join(rows))
    words = ["calibrate", "data.csv", "--free", "k", "--starts", "2"]
    fits = []
    for of_target in (
        [*NAMES, "--units", "si", "--cutting-fraction", "0.25"],
        ["mine.toml"],
        [*NAMES[:2], "--sigma", f"{float(p.sigma)!r} Pa", "--psi", "2", "--units", "si",
         "--cutting-fraction", "0.25", "--density", "2.7 g/cm^3"],
    ):  # fmt: skip
        Path("mine.toml").write_text(CASE.replace("0.03", "0.25").replace("v0 = 100", f"v0 = {float(p.v0)!r}"))
        fits.append(document([*words, *of_target, "--write-case", "fitted.toml"], shell)["result"])
    for fit in fits:
        assert fit["estimates"]["k"]["value"] == pytest.approx(2.5, rel=1e-6)
        assert fit["cutting_fraction"] == 0.25
    assert "density" in shell([*words, "--units", "si"], 2).err
    # The file that calibrate writes has what g/kg need.
    weighed = document(["run", "fitted.toml"], shell)["result"]
    assert weighed["erosion_ratio"]["value"] == pytest.approx(float(np.interp(20, np.rad2deg(alpha), loss)) * 1e-6)


def test_map_takes_densities_and_the_share_from_names_and_case_files(shell: Shell) -> None:
    Path("hits.csv").write_text(IMPACTS)
    by_options = document(["map", "hits.csv", *NAMES, "--units", "si", "--k", "2", *SHARE], shell)["result"]
    assert by_options == document(["map", "hits.csv", "case.toml"], shell)["result"]
    whole = document(["map", "hits.csv", *NAMES, "--units", "si", "--k", "2"], shell)["result"]
    for name in ("total_volume", "total_mass", "total_erosion_ratio"):
        assert by_options[name]["value"] == pytest.approx(0.03 * whole[name]["value"], rel=1e-12)
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061").replace(v0=100.0)
    hits = erosion.impact("linearized", p.replace(alpha=np.deg2rad([20.0, 40.0])))
    assert whole["total_mass"]["value"] == pytest.approx(2700 * float(np.sum(hits.volume)), rel=1e-9)
    assert whole["total_particle_mass"]["value"] == pytest.approx(2 * float(p.m), rel=1e-9)
    # A correlation is made for a metal of its own, and for all particles.
    dnv = document(["map", "hits.csv", *NAMES, *SHARE, "--units", "si", "--model", "dnv"], shell)["result"]
    alone = document(["map", "hits.csv", *NAMES[:2], "--units", "si", "--model", "dnv:aluminium"], shell)["result"]
    assert dnv["total_mass"] == alone["total_mass"]


def test_export_writes_the_share_that_cuts(shell: Shell) -> None:
    axes = ["--angles", "20deg", "--speeds", "100 m/s", "--diameters", "0.3 mm"]
    for path, words in (("whole.csv", [*NAMES, *AT]), ("part.csv", ["case.toml"])):
        assert exit_status(["export", "--model", "linearized", "--table", path, *axes, *words]) == 0
    (whole,), (part,) = (
        list(csv.DictReader(Path(path).read_text().splitlines())) for path in ("whole.csv", "part.csv")
    )
    assert float(part["volume [m^3]"]) == pytest.approx(0.03 * float(whole["volume [m^3]"]), rel=1e-9)
    forms = [
        document(["export", "--model", "finnie", "--openfoam", path, *words], shell)["result"]["openfoam"]
        for path, words in (("whole.txt", [*NAMES, *AT]), ("part.txt", ["case.toml"]))
    ]
    assert forms[1]["p"]["value"] == pytest.approx(forms[0]["p"]["value"] / 0.03, rel=1e-6)
    assert "cutting fraction 0.03 is part of what is written here" in Path("part.txt").read_text()
    assert "cutting fraction" not in Path("whole.txt").read_text()


def test_bare_numbers_need_a_unit_system(shell, written):
    named = ["run", "--particle", "garnet 0.3 mm", "--json"]
    for words in (named, ["run", "--target", "copper"]):
        assert "Option `--v0` must have a unit" in shell([*words, "--v0", "100"], 2).err
    assert _case([*named, "--units", "si", "--v0", "100"], shell)["v0"] == {"value": 100.0, "unit": "m/s"}
    assert _case([*named, "--v0", "4400 in/s"], shell)["v0"] == {"value": pytest.approx(111.76), "unit": "m/s"}
    assert _case([*named, "--units", "inch-pound", "--v0", "4400"], shell)["v0"] == {"value": 4400.0, "unit": "in/s"}
    case = written("case.toml", dump_case(erosion.TABLE_1))
    assert _case([*named, str(case), "--v0", "4400"], shell)["v0"]["unit"] == "in/s"


def _case(line, shell):
    return shell(line).document["case"]["parameters"]
