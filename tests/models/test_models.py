"""The registered models, their closed forms, and what a store knows them by."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
import erosion.impacts.dataset_files
from erosion import models
from erosion.impacts.dataset_files import StoreError, identity, package_digest, require_same
from erosion.models.registry import model_name
from erosion.sweeps.grid import make_grid
from tests.reference import closed_form, relative_volume

P = erosion.TABLE_1


def test_each_model_has_the_name_of_its_entry():
    for name in erosion.available_models():
        assert model_name(erosion.load_model(name)) == name


def test_a_variant_is_a_choice_of_parts():
    mine = models.Rotating(force=models.TanAlpha(), torque=models.FullTorque())
    assert model_name(mine) == "rotating-tan-alpha-full-torque"
    assert erosion.load_model(mine) is mine
    assert models.Rotating().closed_form() is None
    assert models.Finnie(force=models.TanAlpha()).closed_form() is None


def test_maxima_of_the_closed_forms():
    # tests/golden-numbers.md, in in³.
    for name, degrees, volume in (
        ("linearized", 31.717474411, 2.135029315836e-4),
        ("finnie", 16.845033763, 1.045953579327e-4),
    ):
        exact = closed_form(name)
        best = exact.alpha_max(P)
        assert np.rad2deg(float(best)) == pytest.approx(degrees, abs=1e-9)
        assert float(exact.volume(P.replace(alpha=best))) == pytest.approx(volume * 0.0254**3, rel=1e-12, abs=0)
    assert np.isnan(closed_form("tan-alpha").alpha_max(P))


@pytest.mark.parametrize("s", [-0.8, -0.3, 0.2, 0.9])
def test_maximum_of_finnie_with_spin(s):
    exact = closed_form("finnie")
    p = P.replace(phidot0=s * P.v0 / P.r)
    best = exact.alpha_max(p)
    at_best = p.replace(alpha=best)
    assert float(exact.dvolume(at_best)) == pytest.approx(0, abs=1e-13 * float(exact.volume(at_best)))
    scan = exact.volume(p.replace(alpha=np.linspace(1e-3, np.pi / 2, 20001)))
    assert float(exact.volume(at_best)) >= float(np.max(scan))


@pytest.mark.parametrize("name", ["linearized", "finnie"])
def test_closed_forms_are_those_of_the_reference(name):
    """Of `finnie` also OpenFOAM's: sin 2α - (6/K) sin²α for tan α < K/6, (K/6) cos²α above."""
    alphas, ratios = np.linspace(0.01, 1.5, 50)[:, None], np.array([0.4, 2.0, 5.0])
    p = P.replace(alpha=alphas, k=ratios, phidot0=0.2 * P.v0 / P.r)
    expected = P.volume_scale * relative_volume(name, alphas, ratios, 0.2)
    assert np.asarray(closed_form(name).volume(p)) == pytest.approx(np.asarray(expected), rel=1e-12, abs=0)


def test_entry_points_are_found(tmp_path, monkeypatch):
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[erosion.models]\ntheirs = erosion.models:Rotating\nbroken = nowhere:model\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert erosion.load_model("theirs") == models.Rotating()
    assert "ModuleNotFoundError" in str(erosion.available_models()["broken"].error)
    with pytest.raises(erosion.ModelError, match=r"'broken'.*ModuleNotFoundError"):
        erosion.load_model("broken")


def test_sincos_is_accurate_and_differentiable():
    x = np.concatenate([np.linspace(-40, 40, 100_001), np.pi / 2 * np.arange(-20, 21)])
    sine, cosine = jax.jit(erosion.sincos)(x)
    assert np.abs(sine - np.sin(x)).max() < 3e-16
    assert np.abs(cosine - np.cos(x)).max() < 3e-16
    assert erosion.sincos(jnp.pi / 2)[0] == 1.0  # so that the tip starts exactly at the surface
    curvature = jax.grad(jax.grad(lambda a: erosion.sincos(a)[0]))
    assert curvature(1.3) == pytest.approx(-np.sin(1.3), rel=1e-15, abs=0)


def test_files_are_listed_by_path(tmp_path):
    (tmp_path / "one.py").write_text('"""One of mine."""\nimport erosion\nmodel = erosion.models.Rotating()\n')
    found = erosion.available_models(tmp_path)
    assert found[str(tmp_path / "one.py")].summary == "One of mine."
    with pytest.raises(erosion.ModelError, match="no such file or folder"):
        erosion.available_models(tmp_path / "nowhere")


MODELS = Path(__file__).parents[2] / "models"


def differing(one: dict[str, str], other: dict[str, str]) -> set[str]:
    return {name for name in one if one[name] != other[name]}


def test_an_identity_is_the_same_for_the_same_result() -> None:
    one, other = (identity({"m": erosion.load_model("rotating")}, P, tolerance="1e-9") for _ in range(2))
    assert one == other
    assert set(one) == {"version", "case", "models", "tolerance"}
    assert package_digest() in one["version"]


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
