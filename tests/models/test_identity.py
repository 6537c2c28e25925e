import json
from pathlib import Path

import pytest

import erosion
import erosion.impacts.dataset_files
from erosion.impacts.dataset_files import StoreError, identity, package_digest, require_same
from erosion.output.files import digest
from erosion.sweeps.grid import make_grid

P = erosion.TABLE_1
MODELS = Path(__file__).parents[2] / "models"


def differing(one: dict[str, str], other: dict[str, str]) -> set[str]:
    return {name for name in one if one[name] != other[name]}


def test_an_identity_is_the_same_for_the_same_result() -> None:
    one, other = (identity({"m": erosion.load_model("rotating")}, P, tolerance="1e-9") for _ in range(2))
    assert one == other
    assert set(one) == {"version", "case", "models", "tolerance"}


def test_what_changes_the_result_changes_the_identity() -> None:
    friction = erosion.load_model(MODELS / "coulomb_tip.py")
    usual = identity({"m": friction}, P, tolerance="1e-9")
    for changed, what in [
        (identity({"m": friction}, P.replace(k=2 + 1e-15), tolerance="1e-9"), {"case"}),
        (identity({"m": friction}, P.to("si"), tolerance="1e-9"), {"case"}),
        (identity({"m": friction}, P, tolerance="1e-8"), {"tolerance"}),
        (identity({"m": friction.replace(friction=0.3)}, P, tolerance="1e-9"), {"models"}),
        (identity({"m": erosion.load_model("rotating")}, P, tolerance="1e-9"), {"models"}),
        (identity({"other": friction}, P, tolerance="1e-9"), {"models"}),
    ]:
        assert differing(usual, changed) == what
    one, other = (identity({"m": friction.replace(friction=value)}, P) for value in (0.3, 0.3 + 1e-16))
    assert differing(one, other) == {"models"}


def test_a_model_that_was_typed_has_an_identity() -> None:
    scope: dict = {"__name__": "typed"}
    exec("from erosion.models import Linearized\nclass Typed(Linearized): pass", scope)
    models = [identity({"m": model}, P)["models"] for model in (scope["Typed"](), erosion.load_model("linearized"))]
    assert models[0] == models[1]


def test_a_sweep_of_a_model_under_another_name_is_the_same() -> None:
    scope: dict = {"__name__": "typed"}
    exec("from erosion.models import Linearized\nclass A(Linearized): pass\nclass B(Linearized): pass", scope)
    models = scope["A"](), scope["B"]()
    one, other = (make_grid(model, P, {"alpha": [0.2, 0.4]}).identity for model in models)
    assert one == other
    one, other = (make_grid([model, "linearized"], P, {"alpha": [0.2, 0.4]}).identity for model in models)
    assert one != other  # the name is a label of the result


def test_an_edit_of_the_package_itself_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ode").mkdir()
    (tmp_path / "cli").mkdir()
    for name in ("ode/tableau.py", "cli/run.py"):
        (tmp_path / name).write_text("order = 8\n")
    monkeypatch.setattr(erosion.impacts.dataset_files, "_PACKAGE", tmp_path)
    before = package_digest.__wrapped__()
    (tmp_path / "cli/run.py").write_text("order = 9\n")
    assert package_digest.__wrapped__() == before
    (tmp_path / "ode/tableau.py").write_text("order = 9\n")
    assert package_digest.__wrapped__() != before
    assert package_digest() in identity({}, P)["version"]


def test_a_digest_is_of_the_bytes() -> None:
    # SHA-256 of nothing, as its standard's examples have it.
    assert digest(b"") == "e3b0c44298fc1c14"
    assert digest(b"a") != digest(b"b")


def test_a_store_of_the_same_identity_passes() -> None:
    wanted = {"case": "k = 2", "models": "m"}
    require_same(Path("out.nc"), json.dumps(wanted), wanted)
    require_same(Path("out.nc"), json.dumps(wanted).encode(), wanted)


@pytest.mark.parametrize(
    ("there", "message"),
    [
        ('{"case": "k = 3", "models": "m"}', r"another result \(of another case\); k is 3 there, and 2 here;"),
        ('{"case": "k = 3"}', r"another result \(of another case and models\)"),
        ("{", "holds something else"),
        ("[1]", "holds something else"),
        (None, "holds something else"),
        (3.0, "holds something else"),
    ],
)
def test_another_store_is_refused_by_name(there, message: str) -> None:
    with pytest.raises(StoreError, match=r"^out\.nc: is there already and holds .*; it is left as it is\.$") as caught:
        require_same(Path("out.nc"), there, {"case": "k = 2", "models": "m"})
    assert caught.match(message)
