"""The JSON document of every verb, against the schema that comes with the package."""

import importlib.resources
import json
import math
from pathlib import Path

import jsonschema
import pytest

import erosion

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads(importlib.resources.files("erosion.cli").joinpath("document.schema.json").read_text())
CASE = str(ROOT / "cases/table-1-si.toml")


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
                  {**good, "warnings": "none"}, {key: good[key] for key in good if key != "seed"}):  # fmt: skip
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


def test_optimum(document) -> None:
    printed = document("optimum", "--model", "rotating", "--sensitivities")
    result, best = printed["result"], erosion.alpha_max("rotating", erosion.TABLE_1)
    assert result["alpha"] == {"value": pytest.approx(best.alpha, abs=1e-12), "unit": "rad"}
    assert result["volume"]["unit"] == "in^3"
    assert result["d2volume"]["unit"] == "in^3/rad^2"
    assert result["jumps"][0]["alpha"] == {"value": best.jumps[0].alpha, "unit": "rad"}
    # The case is the one that was given, not the answer.
    assert printed["case"]["parameters"]["alpha"]["value"] == pytest.approx(math.radians(20))
    assert document("optimum", "--objective", "volume per mass")["result"]["value"]["unit"] == "in^3/slinch"


def test_compare(document) -> None:
    printed = document("compare", "--model", "linearized,finnie")
    assert [model["name"] for model in printed["model"]] == ["linearized", "finnie"]
    lines = printed["result"]["models"]
    assert lines[0]["volume"] == {"value": pytest.approx(1.816436352531e-4, rel=1e-9), "unit": "in^3"}
    assert printed["result"]["statements"][0].startswith("The best angle is 16.8° to 31.7° over 2 models, and 16.8° to")


def test_sweep_and_stream(document, tmp_path) -> None:
    printed = document("sweep", "--alpha", "10deg, 30deg", "-o", str(tmp_path / "out.nc"))
    assert printed["case"]["varied"] == {"alpha": "2 values"}
    assert "alpha" not in printed["case"]["parameters"]
    assert printed["result"]["volume_greatest"]["unit"] == "in^3"
    printed = document("stream", "--alpha", "normal(20deg, 3deg)", "--n", "1024", "--seed", "3", "--no-best-angle")
    assert printed["seed"] == 3
    assert printed["case"]["varied"] == {"alpha": "normal(20°, 3°)"}
    assert printed["result"]["erosion"]["unit"] == "in^3/slinch"
    assert printed["result"]["quantiles"]["unit"] == "in^3"


def test_calibrate(document, tmp_path) -> None:
    data = tmp_path / "data.csv"
    angles = [10, 15, 20, 30, 45, 60, 75]
    p = erosion.TABLE_1.to("si")
    volumes = [erosion.impact("linearized", p.replace(alpha=math.radians(angle))).volume * 1e9 for angle in angles]
    rows = "\n".join(f"{angle}, {volume:.6g}" for angle, volume in zip(angles, volumes, strict=True))
    data.write_text(f"angle [deg], volume [mm^3]\n{rows}\n")
    printed = document("calibrate", str(data), CASE, "--model", "linearized,finnie")
    # Both have the same curve, `finnie` at three times the k; rounding of the rows decides which is first.
    first, second = (model["name"] for model in printed["model"])
    assert {first, second} == {"linearized", "finnie"}
    k = {"linearized": 2.0, "finnie": 6.0}[first]
    estimates = printed["result"]["estimates"]
    assert estimates["k"] == {"value": pytest.approx(k, rel=1e-3), "unit": "1"}
    assert printed["result"]["leave_one_out"]["unit"] == "m^3"


def test_export(document, tmp_path) -> None:
    paths = {name: str(tmp_path / name) for name in ("openfoam", "fluent", "table", "restitution")}
    options = [word for name, path in paths.items() for word in (f"--{name}", path)]
    result = document("export", CASE, "--model", "finnie", *options)["result"]
    assert {name: part["file"] for name, part in result.items()} == paths
    assert result["openfoam"]["p"]["unit"] == "Pa"
    assert result["fluent"]["exponent"] == 2.0
    assert (result["table"]["angles"], result["restitution"]["speeds"]) == (36, 7)


@pytest.mark.slow
def test_models_and_verify(document) -> None:
    printed = document("models")
    assert printed["case"] is printed["units"] is printed["model"] is None
    assert set(printed["result"]["models"]) == set(erosion.available_models())
    printed = document("verify", "--model", "linearized")
    assert printed["result"]["passed"] is True
    assert printed["model"]["name"] == "linearized"


@pytest.mark.slow
def test_validate(document, tmp_path) -> None:
    printed = document("validate", "--plot", str(tmp_path / "facts.svg"))
    assert printed["case"] is printed["units"] is printed["model"] is None
    crater = next(fact for fact in printed["result"]["facts"] if fact["name"] == "Crater, 5 mm sphere, 9.99 m/s")
    assert crater["published"] == {"value": 22.961, "unit": "um"}
    assert (crater["computed"]["unit"], crater["kind"]) == ("um", "measured")
    assert (tmp_path / "facts.svg").read_bytes().startswith(b"<?xml")


def test_warnings_are_in_the_document_and_on_stderr(shell) -> None:
    said = shell("run --model rotating-tan-alpha --json")
    document = said.document
    check(document)
    assert said.err == "".join(f"warning: {message}\n" for message in document["warnings"])
