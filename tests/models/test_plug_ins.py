"""The plug-ins in models/: each against a closed form or a limit, and how broken ones are refused."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.models import CentreOfMassTip, Linearized, NoTorque, Rotating
from tests.reference import closed_form

P = erosion.TABLE_1.to("si")
CASES = [P, P.replace(alpha=0.9, phidot0=0.2 * P.v0 / P.r)]
FOLDER = Path(__file__).parents[2] / "models"
FILES = sorted(FOLDER.glob("*.py"))


def parts(name):
    """The module of a plug-in, as Python has loaded it."""
    model = erosion.load_model(FOLDER / f"{name}.py")
    part = model if name == "rounded_tip" else getattr(model, "force")  # noqa: B009
    return sys.modules[type(part).__module__]


def volumes(model, cases=CASES):
    return [erosion.impact(model, p, rtol=1e-13).volume for p in cases]


@pytest.fixture(scope="module")
def rotating():
    return volumes("rotating")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_plug_in_is_short_and_needs_nothing_else(file):
    text = file.read_text()
    assert len(text.splitlines()) < 80
    imported = [node for node in ast.walk(ast.parse(text)) if isinstance(node, (ast.Import, ast.ImportFrom))]
    modules = {alias.name for node in imported for alias in node.names if isinstance(node, ast.Import)}
    assert modules <= {"erosion", "jax", "jax.numpy"}
    assert all(isinstance(node, ast.Import) for node in imported)
    for word in ("Limits:", "References:"):
        assert word in text


def test_a_lip_far_from_saturation_is_the_built_in_law(rotating):
    force = parts("saturating_lip").SaturatingLip(reach=1e7)
    assert volumes(Rotating(force=force)) == pytest.approx(rotating, rel=1e-9, abs=0)


def test_friction_is_another_flow_stress_and_force_ratio(rotating):
    tip = parts("coulomb_tip").CoulombTip
    assert volumes(Rotating(force=tip(friction=0.0))) == pytest.approx(rotating, rel=1e-12, abs=0)
    more = [1 + 0.3 * p.k for p in CASES]
    same = [p.replace(sigma=p.sigma * f, k=p.k / f) for p, f in zip(CASES, more, strict=True)]
    assert volumes(Rotating(force=tip(friction=0.3))) == pytest.approx(volumes("rotating", same), rel=1e-11, abs=0)


def test_strain_rate_has_its_two_limits(rotating):
    force = parts("rate_dependent").CowperSymonds
    # (ε̇/D)^(1/4) is 2e-11 at this D.
    assert volumes(Rotating(force=force(rate=1e48))) == pytest.approx(rotating, rel=1e-9, abs=0)
    harder = volumes("rotating", [p.replace(sigma=2 * p.sigma) for p in CASES])
    assert volumes(Rotating(force=force(exponent=1e12))) == pytest.approx(harder, rel=1e-10, abs=0)


def test_a_force_against_the_tip_cuts_straight_where_nothing_turns():
    force = parts("opposing_tip").OpposingTip
    for p in CASES:
        cut = erosion.impact(Linearized(force=force()), p, rtol=1e-13)
        assert cut.ended_by == "stop"
        assert cut.volume == pytest.approx(float(p.volume_scale * np.cos(p.alpha) / 2), rel=1e-12, abs=0)
        assert cut.t_c == pytest.approx(
            float(np.pi / 2 * np.sqrt(p.m / (p.stiffness * np.sin(p.alpha)))), rel=1e-12, abs=0
        )


@pytest.mark.parametrize("radius", [0.1, 2.0])
def test_the_shape_of_the_tip_does_not_matter_where_nothing_turns(radius):
    plug_in, exact = parts("rounded_tip"), closed_form("linearized")
    tip = plug_in.RoundedParticle(plug_in.RoundedTip(radius=radius), CentreOfMassTip(), NoTorque())
    cases = [p.replace(phidot0=0.0) for p in CASES]
    assert volumes(tip, cases) == pytest.approx([float(exact.volume(p)) for p in cases], rel=1e-11, abs=0)


FORCE = """
import erosion, jax.numpy as jnp
class F(erosion.models.ForceLaw):
    def __call__(self, state, tip, p):
        return {force}
    def typical_ratio(self, p):
        return p.k
model = erosion.models.Linearized(force=F())
"""
ROTATING = "import erosion\nclass M(erosion.models.Rotating):\n  "
BROKEN: dict[str, tuple[str | bytes | None, str]] = {
    "no file": (None, "no such model file"),
    "import": ("1/0", "ZeroDivisionError"),
    "a module that is missing": ("import nowhere_to_be_found", "ModuleNotFoundError"),
    "no text": (b"\xff\xfe", "SyntaxError"),
    "a zero byte": (b"model = \0", "cannot be imported"),
    "no Python": ("def f(:\n", "SyntaxError"),
    "an encoding": ("# coding: nonsense\n", "SyntaxError"),
    "too deep": ("(" * 100_000, "cannot be imported"),
    "without a word": ("raise KeyError\n", "KeyError"),
    "recursion": ("def f(): f()\nf()\n", "RecursionError"),
    "empty": ("", "`model`"),
    "a number": ("model = 3", "CuttingModel"),
    "makes a number": ("def model(): return 3", "CuttingModel"),
    "lacks": (
        "import erosion\nclass Half(erosion.CuttingModel):\n  def derivative(self, state, p): return state\n",
        "`initial_state`, `tip`",
    ),
    "parts": (
        "import erosion\nclass M(erosion.models.RigidParticle):\n  force: erosion.models.ForceLaw\n",
        "TypeError",
    ),
    "shape": (FORCE.format(force="jnp.zeros(2), jnp.zeros(2)"), "`derivative`"),
    "raises": (FORCE.format(force="tip.height, 0.0"), "line 5 of mine.py: AttributeError"),
    "one force": (FORCE.format(force="-tip.depth"), "two numbers"),
    "a question of Python": (FORCE.format(force="(1.0, 1.0) if tip.depth > p.r else (0.0, 0.0)"), "`jnp.where("),
    "single precision": (FORCE.format(force="jnp.asarray(tip.depth, jnp.float32), tip.depth"), "float32"),
    "changing": (
        "calls = []\n" + FORCE.format(force="calls.append(1) or (-p.stiffness * tip.depth * len(calls), 0.0)"),
        "same at each call",
    ),
    "half-state": (ROTATING + "def derivative(self, state, p): return state.x\n", "`initial_state`"),
    "no-events": (ROTATING + "def events(self, state, p): return {}\n", "`events`"),
    "no-tip": (ROTATING + "def tip(self, state, p): return (state.x, state.y)\n", "`tip`"),
    "no-volume": (ROTATING + "def removal_rate(self, state, p): return None\n", "`removal_rate`"),
    "text": (ROTATING + "label: str = 'mine'\n", "'mine'"),
}
VERBS = {
    "run": ["--model", "{}"],
    "optimum": ["--model", "{}"],
    "compare": ["--model", "linearized", "{}"],
    "sweep": ["--model", "{}", "--alpha", "1deg:80deg:5", "-o", "out.nc"],
    "stream": ["--model", "{}", "--n", "256", "--alpha", "normal(25deg,4deg)"],
    "calibrate": ["sand.csv", "--model", "{}", "--free", "k"],
    "export": ["--model", "{}", "--openfoam", "out.nc"],
    "verify": ["{}"],
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_plug_in_is_refused_in_one_sentence(tmp_path, written, name):
    text, words = BROKEN[name]
    file = tmp_path / "mine.py" if text is None else written("mine.py", text)
    with pytest.raises(erosion.ModelError) as caught:
        erosion.load_model(file)
    said = str(caught.value)
    assert said.startswith(f"{file}: ")
    assert words in said
    assert "\n" not in said
    listed = erosion.available_models(tmp_path)
    assert text is None or str(listed[str(file)].error) == said
    assert listed["rotating"].error is None
    assert erosion.load_model("rotating") == Rotating()


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_says_it_in_one_line(tmp_path, written, monkeypatch, shell, verb):
    monkeypatch.chdir(tmp_path)
    written("mine.py", BROKEN["shape"][0])
    written("sand.csv", "angle [deg], volume [in^3/impact]\n10,1e-4\n20,1.8e-4\n30,2e-4\n")
    said = shell([verb, *(word.format("mine.py") for word in VERBS[verb])], 2).err
    assert "mine.py: `derivative`" in said
    assert said.count("\n") == 1
    assert not Path("out.nc").exists()


NAN = FORCE.format(force="jnp.log(-1 - tip.depth), 0 * tip.depth")
ENDLESS = FORCE.format(force="0 * tip.depth, 0 * tip.depth")


@pytest.mark.parametrize(
    ("verb", "text", "message"),
    [
        ("run", NAN, "the motion or the volume is not finite"),
        ("optimum", NAN, "mine.py: no impact could be computed, at any angle."),
        ("sweep", NAN, "of 5 impacts none could be computed."),
        ("stream", NAN, "of 256 particles none could be computed."),
        ("export", NAN, "impacts could not be computed."),
        ("run", ENDLESS, "no event ended the cut within"),
    ],
)
def test_what_cannot_be_computed_is_one_line_too(tmp_path, written, monkeypatch, shell, verb, text, message):
    monkeypatch.chdir(tmp_path)
    written("mine.py", text)
    said = shell([verb, *(word.format("mine.py") for word in VERBS[verb])], 1).err
    assert message in said
    assert said.count("\n") == 1


def test_a_model_that_fails_leaves_the_others_as_they_are(tmp_path):
    (tmp_path / "nan.py").write_text(NAN)
    found = erosion.sweep([str(tmp_path / "nan.py"), "linearized"], P, alpha=[0.2, 0.3])
    alone = erosion.sweep("linearized", P, alpha=[0.2, 0.3])
    assert np.isnan(found.volume[0]).all()
    assert (found.volume[1].values == alone.volume.values).all()


def test_plug_ins_of_one_class_have_names_of_their_own():
    names = [erosion.models.model_name(erosion.load_model(str(path))) for path in FILES]
    assert len(set(names)) == len(names)
    assert "Rotating(SaturatingLip)" in names
