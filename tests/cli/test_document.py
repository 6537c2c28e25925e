"""The JSON document of every verb, against the schema that comes with the package.

The same case in inch-pound and in SI: every verb gives the same numbers and the same sentences.
"""

import functools
import importlib.resources
import json
import math
import re
from pathlib import Path
from typing import Any

import jax
import jsonschema
import numpy as np
import pandas as pd
import pint
import pytest

import erosion
from erosion.parameters import System
from tests.documents import Shell

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads(importlib.resources.files("erosion.cli").joinpath("document.schema.json").read_text())
CASE = str(ROOT / "examples/table-1-si.toml")


def check(document) -> None:
    jsonschema.Draft202012Validator(SCHEMA).validate(document)


@pytest.fixture
def document(shell):
    """A verb's document, checked."""

    def of(*arguments: str, status: int = 0):
        printed = shell([*arguments, "--json"], status).document
        check(printed)
        assert printed["verb"] == arguments[0]
        assert printed["version"] == erosion.__version__
        return printed

    return of


def test_the_schema_is_one_and_refuses(document) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    good = document("run")
    for wrong in ({**good, "more": 1}, {**good, "result": {**good["result"], "volume": 1.0}},
                  {**good, "findings": "none"}, {key: good[key] for key in good if key != "seed"}):  # fmt: skip
        with pytest.raises(jsonschema.ValidationError):
            check(wrong)


def test_run(document) -> None:
    printed = document("run", CASE, "--model", "rotating")
    assert printed["case"]["name"] == "table-1-si"
    assert printed["case"]["file"] == CASE
    assert printed["case"]["parameters"]["r"] == {"value": 0.001016, "unit": "m"}
    assert printed["units"] == "si"
    assert printed["model"] == {"name": "rotating", "own_parameters": {}}
    result = printed["result"]
    p = erosion.load_case(CASE)
    assert result["volume"] == {"value": pytest.approx(erosion.simulate("rotating", p).volume, rel=1e-8), "unit": "m^3"}
    assert result["dvolume"]["unit"] == "m^3/rad"
    assert result["ended_by"] == "rebound"


def test_warnings_are_in_the_document_and_on_stderr(shell) -> None:
    said = shell("run --model rotating-tan-alpha --json")
    document = said.document
    check(document)
    assert said.err == "".join(f"{one['level']}: {one['text']}\n" for one in document["findings"])


BOTH: dict[System, str] = {"inch-pound": "inch-pound.toml", "si": "si.toml"}
"""Files of the case by the unit system that shows it; their quantities are the same to the last bit."""
IMPACTS = "count,diameter [um],density [kg/m^3],speed [m/s],angle [deg]\n" + "".join(
    f"1,{diameter},2650,{speed},{angle}\n" for diameter, speed, angle in [(150, 25, 15), (200, 30, 30), (300, 260, 50)]
)
WEIGHED = ["--density", "2.7 g/cm^3", "--cutting-fraction", "0.5"]
VERBS = {
    "run": ["run", *WEIGHED],
    "run of a correlation": ["run", "--model", "oka:aluminium", "--v0", "260 m/s"],
    "run with wear by deformation": ["run", "--model", "rotating-deformation", "--set", "threshold=5 m/s", *WEIGHED],
    "optimum": ["optimum", "--model", "finnie", "--sensitivities", *WEIGHED],
    "compare": ["compare", "--model", "linearized,finnie,dnv", "--v0", "260 m/s", "--cutting-fraction", "0.5"],
    "sweep": ["sweep", "--model", "linearized,ecrc", "--v0", "100 m/s, 300 m/s", "--derivatives", "2", "-o", "out.csv",
              "--cutting-fraction", "0.5"],
    "stream": ["stream", "--model", "dnv", "--v0", "lognormal(220 m/s, 0.2)", "--n", "256", "--no-best-angle"],
    "stream of a model": ["stream", "--alpha", "normal(20deg, 3deg)", "--n", "1024", *WEIGHED],
    "map": ["map", "impacts.csv", *WEIGHED, "--duration", "60 s", "-o", "out.csv"],
    "map of a correlation": ["map", "impacts.csv", "--model", "dnv:aluminium", "-o", "out.csv"],
    "advise": ["advise", "--model", "linearized", *WEIGHED],
    "calibrate": ["calibrate", "tests.csv", "--free", "k", "--starts", "2", *WEIGHED[:2]],
    "posterior": ["posterior", "tests.csv", "--free", "sigma", "--prior", "sigma=lognormal(1.4 GPa, 0.2)", "--draws",
                  "125", "-o", "draws.nc", *WEIGHED[:2]],
    "export": ["export", "--fluent", "angles.txt", "--table", "out.csv", "--particle-density", "2650 kg/m^3",
               "--angles", "20deg,40deg", "--speeds", "100 m/s, 120 m/s", "--diameters", "1 mm"],
}  # fmt: skip
AFTER = {"posterior": ["predict", "draws.nc", "--alpha", "20deg,40deg", "--v0", "60 m/s", "-o", "out.csv"]}
"""What reads the file of another verb."""


@pytest.fixture(autouse=True)
def in_folder(in_folder: Path) -> Path:
    for system, name in BOTH.items():
        (in_folder / name).write_text(erosion.dump_case(erosion.TABLE_1.to(system)))
    (in_folder / "impacts.csv").write_text(IMPACTS)
    alpha = np.deg2rad([10.0, 20, 30, 45, 60])
    p = erosion.TABLE_1.to("si").replace(alpha=alpha, k=2.5)
    scatter = np.array([1.01, 0.98, 1.02, 0.99, 1.03])
    losses = 2700 * scatter * np.asarray(erosion.impact("linearized", p).volume) / float(p.m)
    rows = [f"{angle:.17g},{loss:.17g}\n" for angle, loss in zip(np.rad2deg(alpha), losses, strict=True)]
    (in_folder / "tests.csv").write_text("angle [deg],mass_loss [kg/kg]\n" + "".join(rows))
    return in_folder


def document_in(words: list[str], shell: Shell) -> dict[str, Any]:
    return shell([*words, "--json"]).document


def has_unit(part: Any) -> bool:
    return isinstance(part, dict) and part.keys() == {"value", "unit"}


def by_place(document: Any) -> dict[str, Any]:
    """Every number and text by its place, numbers with a unit in SI."""

    def in_si(part: Any) -> Any:
        return jax.tree.map(lambda number: number * _factor(part["unit"]), part["value"]) if has_unit(part) else part

    tree = jax.tree.map(in_si, document, is_leaf=has_unit)
    leaves = jax.tree.leaves_with_path(tree, is_leaf=lambda leaf: leaf is None)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


@functools.cache
def _factor(unit: str) -> float:
    """Of a unit over the SI unit of its dimension."""
    return float(_UNITS.Quantity(1.0, unit).to_base_units().magnitude)


_UNITS: Any = pint.UnitRegistry()
_UNITS.define("slinch = lbf * s^2 / inch")


def same(first: Any, second: Any) -> bool:
    if isinstance(first, float) and isinstance(second, float):
        # A derivative at a maximum is rounding; every other number of these cases is far above 1e-22.
        return math.isclose(first, second, rel_tol=1e-12, abs_tol=1e-22) or (math.isnan(first) and math.isnan(second))
    return in_metres(first) == in_metres(second)


def differences(first: Any, second: Any) -> dict[str, Any]:
    """The numbers and texts that are not the same, by their place."""
    one, other = by_place(first), by_place(second)
    return {at: (one.get(at), other.get(at)) for at in one | other if not same(one.get(at), other.get(at))}


def in_metres(text: Any) -> Any:
    """A sentence with its speeds in m/s and its ratios of masses in kg/kg."""
    if not isinstance(text, str):
        return text
    text = re.sub("“erosion [^”]*”", "", text)  # a printed command names the case file
    speeds = re.sub(r"([\d.]+(?:e[+-]?\d+)?) in/s\b", lambda match: f"{float(match[1]) * 0.0254:.4g} m/s", text)
    return speeds.replace("slinch/slinch", "kg/kg")


def table_in_si(path: Path) -> pd.DataFrame:
    """A table, whose headings have units; numbers in SI."""
    table = pd.read_csv(path, comment="#")
    for heading, unit in zip(table, table.columns.str.extract(r"\[(.*)\]", expand=False).fillna("1"), strict=True):
        if pd.api.types.is_numeric_dtype(table[heading]):
            table[str(heading)] *= _factor(unit)
    return table.set_axis(table.columns.str.partition(" [").get_level_values(0), axis=1)


@pytest.mark.parametrize("verb", VERBS)
def test_numbers_and_sentences_are_the_same_in_both_unit_systems(verb: str, shell: Shell, in_folder: Path) -> None:
    documents, tables = {}, {}
    for units, case in BOTH.items():
        lines = [[*VERBS[verb], case], *([AFTER[verb]] if verb in AFTER else [])]
        documents[units] = [document_in(words, shell) for words in lines]
        for document in documents[units]:
            assert document.pop("units") == units
            del document["case"]["file"], document["case"]["name"]
            # In words, in the units that show the case.
            document["result"].get("posterior", {}).pop("priors", None)
        if "out.csv" in lines[-1]:
            tables[units] = table_in_si(in_folder / "out.csv")
    assert differences(*documents.values()) == {}
    if tables:
        pd.testing.assert_frame_equal(*tables.values(), rtol=1e-12, atol=1e-22)


def test_a_map_without_a_case_is_in_si(shell: Shell) -> None:
    words = ["map", "impacts.csv", "--model", "linearized"]
    bare = document_in(words, shell)
    assert bare["units"] == "si"
    by_file = document_in([*words, BOTH["si"]], shell)
    assert differences(bare["result"], by_file["result"]) == {}
    speed = bare["result"]["total_v0_mean"]
    assert speed == {"value": pytest.approx(105.0), "unit": "m/s"}
    (far,) = (one for one in bare["findings"] if one["code"] == "above_tests")
    assert far["numbers"]["speed"] == pytest.approx(105.0)
    # Who asks for the other system gets it, of the numbers and of the same sentence.
    inches = document_in([*words, "--units", "inch-pound"], shell)
    assert inches["result"]["total_v0_mean"] == {"value": pytest.approx(105.0 / 0.0254), "unit": "in/s"}
    assert [one["text"] for one in inches["findings"]] == [one["text"] for one in bare["findings"]]
