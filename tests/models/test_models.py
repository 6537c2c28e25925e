"""What is said of a model that cannot be used: the first slips of a newcomer."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
import erosion.impacts.dataset_files
from erosion import models
from erosion.impacts.dataset_files import StoreError, identity, package_digest, require_same
from erosion.models.registry import model_name
from erosion.output.files import digest
from erosion.sweeps.grid import make_grid
from tests.reference import closed_form

P = erosion.TABLE_1
FOURTEEN = {
    "linearized-deformation",
    "finnie-deformation",
    "rotating-deformation",
    "linearized", "tan-alpha", "velocity-aligned", "finnie", "as-printed", "rotating", "rotating-full-torque",
    "rotating-tan-alpha", "rotating-tan-alpha-full-torque",
    "rotating-velocity-aligned", "rotating-velocity-aligned-full-torque",
}  # fmt: skip


def test_the_fourteen_models_are_registered_under_their_names():
    assert set(erosion.available_models()) == FOURTEEN
    for name in FOURTEEN:
        assert model_name(erosion.load_model(name)) == name


def test_a_variant_is_a_choice_of_parts():
    mine = models.Rotating(force=models.TanAlpha(), torque=models.FullTorque())
    assert model_name(mine) == "rotating-tan-alpha-full-torque"
    assert erosion.load_model(mine) is mine
    assert models.Rotating().closed_form() is None
    assert models.Finnie(force=models.TanAlpha()).closed_form() is None


def test_maxima_of_the_closed_forms():
    # tests/golden-numbers.md.
    for name, degrees, volume in (
        ("linearized", 31.717474411, 2.135029315836e-4),
        ("finnie", 16.845033763, 1.045953579327e-4),
    ):
        exact = closed_form(name)
        best = exact.alpha_max(P)
        assert np.rad2deg(float(best)) == pytest.approx(degrees, abs=1e-9)
        assert float(exact.volume(P.replace(alpha=best))) == pytest.approx(volume, rel=1e-12, abs=0)
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


def test_openfoam_form_of_finnie():
    # OpenFOAM's ParticleErosion: m v²/(ψ K σ) times sin 2α - (6/K) sin²α for tan α < K/6, (K/6) cos²α above.
    alphas, k = np.linspace(0.01, 1.5, 50), 2.0
    below = np.sin(2 * alphas) - 6 / k * np.sin(alphas) ** 2
    expected = float(P.volume_scale) / k * np.where(np.tan(alphas) < k / 6, below, k / 6 * np.cos(alphas) ** 2)
    exact = closed_form("finnie")
    assert np.asarray(exact.volume(P.replace(alpha=alphas))) == pytest.approx(expected, rel=1e-13, abs=0)


def test_sincos_is_accurate_and_differentiable():
    x = np.concatenate([np.linspace(-40, 40, 100_001), np.pi / 2 * np.arange(-20, 21)])
    sine, cosine = jax.jit(erosion.sincos)(x)
    assert np.abs(sine - np.sin(x)).max() < 3e-16
    assert np.abs(cosine - np.cos(x)).max() < 3e-16
    assert erosion.sincos(jnp.pi / 2)[0] == 1.0  # so that the tip starts exactly at the surface
    curvature = jax.grad(jax.grad(lambda a: erosion.sincos(a)[0]))
    assert curvature(1.3) == pytest.approx(-np.sin(1.3), rel=1e-15, abs=0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no such model file"),
        ("1/0", "cannot be imported: ZeroDivisionError: division by zero"),
        ("import nowhere_to_be_found", "cannot be imported: ModuleNotFoundError"),
        ("x = 1", "must define `model`, or exactly one complete CuttingModel class, but has none"),
        ("model = 3", "must offer a CuttingModel, but offers 3"),
        ("def model(): return 3", "must offer a CuttingModel, but makes 3"),
        (
            "import erosion\nclass M(erosion.CuttingModel):\n  '''Half.'''\n",
            "M must have all methods of a model, but lacks `derivative`",
        ),
        (
            "import erosion\nclass M(erosion.models.RigidErodent):\n  '''No parts.'''\n"
            "  kinematics: erosion.models.TipKinematics\n  force: erosion.models.ForceLaw\n"
            "  torque: erosion.models.Torque\n",
            "cannot be made without arguments: TypeError",
        ),
    ],
)
def test_a_bad_plug_in_gets_one_sentence(tmp_path, text, message):
    file = tmp_path / "mine.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(erosion.ModelError, match=message) as caught:
        erosion.load_model(str(file))
    assert "mine.py" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert erosion.load_model("rotating") == models.Rotating()


def test_files_are_listed_by_path(tmp_path):
    (tmp_path / "one.py").write_text('"""One of mine."""\nimport erosion\nmodel = erosion.models.Rotating()\n')
    found = erosion.available_models(tmp_path)
    assert found[str(tmp_path / "one.py")].summary == "One of mine."
    (tmp_path / "two.py").write_text("1/0")
    broken = erosion.available_models(tmp_path)[str(tmp_path / "two.py")]
    assert "cannot be imported: ZeroDivisionError" in str(broken.error)
    with pytest.raises(erosion.ModelError, match="ZeroDivisionError"):
        broken.make()
    with pytest.raises(erosion.ModelError, match="no such file or folder"):
        erosion.available_models(tmp_path / "nowhere")


def test_entry_points_are_found(monkeypatch):
    from importlib.metadata import EntryPoint

    from erosion.models import registry

    group = registry.ENTRY_POINT_GROUP
    entries = [EntryPoint("theirs", "erosion.models:Rotating", group), EntryPoint("broken", "nowhere:model", group)]
    monkeypatch.setattr(registry.importlib.metadata, "entry_points", lambda group: entries)
    assert erosion.load_model("theirs") == models.Rotating()
    assert "cannot be imported" in str(erosion.available_models()["broken"].error)
    with pytest.raises(erosion.ModelError, match=r"'broken'.*cannot be imported: ModuleNotFoundError"):
        erosion.load_model("broken")


def test_a_closed_form_is_one_program(caplog):
    t = np.linspace(0.0, 1e-5, 123)  # of a length that no other test has
    with jax.log_compiles():
        closed_form("linearized").state(t, P)
    assert sum("Finished XLA compilation" in record.message for record in caplog.records) == 1


def test_a_state_shows_its_values():
    p = erosion.TABLE_1.replace(v0=100.0, alpha=0.0)
    assert repr(erosion.load_model("rotating").initial_state(p)) == (
        "State(x=0, y=0, phi=1.5707963267948966, vx=100, vy=0, omega=0)"
    )
    states = erosion.State(*(np.array([0.0, 0.5]) for _ in range(6)))
    assert repr(states).startswith("State(x=<[2] 0 … 0.5>, ")
    assert "x=ShapeDtypeStruct" in repr(jax.eval_shape(erosion.load_model("rotating").initial_state, p))


class _Asking(erosion.models.ForceLaw):
    """Asks for the value of a number, as numpy code may."""

    def __call__(self, state, tip, p):
        force = -p.stiffness * tip.depth
        if tip.depth > p.r:
            force = 2 * force
        return force, p.k * force

    def typical_ratio(self, p):
        return p.k


class _Lonely(_Asking):
    """Gives one number."""

    def __call__(self, state, tip, p):
        return -p.stiffness * tip.depth


class _Changing(_Asking):
    """Gives another force each time that it is asked."""

    calls: list = eqx.field(default_factory=list, static=True)

    def __call__(self, state, tip, p):
        self.calls.append(1)
        force = -p.stiffness * tip.depth * len(self.calls)
        return force, p.k * force


class _Rounded(_Asking):
    """Gives numbers of seven digits."""

    def __call__(self, state, tip, p):
        force = jnp.asarray(-p.stiffness * tip.depth, jnp.float32)
        return force, p.k * force


class _Constant(_Asking):
    """Gives numbers of Python."""

    def __call__(self, state, tip, p):
        return 0, -1.0


class _Silent(_Asking):
    """Raises without a word."""

    def __call__(self, state, tip, p):
        raise KeyError


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (lambda: erosion.models.Rotating(force=_Asking()), r"in line \d+ of test_models\.py: it asks for the value"),
        (lambda: erosion.models.Rotating(force=_Asking()), r"write `jnp\.where\(condition, a, b\)` for `if`"),
        (lambda: erosion.models.Rotating(force=_Lonely()), r"_Lonely must give two numbers, \(F_x, F_y\)"),
        (
            lambda: erosion.models.Rotating(force=_Changing()),
            "must give the same at each call, but its equations change",
        ),
        (
            lambda: erosion.models.Rotating(force=_Rounded()),
            "_Rounded must give numbers of type float64, but gives float32",
        ),
        (lambda: erosion.models.Rotating(force=_Silent()), r"in line \d+ of test_models\.py: KeyError\.$"),
    ],
)
def test_first_slips_are_told_with_what_to_write(model, message) -> None:
    with pytest.raises(erosion.models.ModelError, match=message):
        erosion.load_model(model())


def test_pythons_own_numbers_are_forces() -> None:
    erosion.load_model(erosion.models.Rotating(force=_Constant()))


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
