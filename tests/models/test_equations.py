"""A model is what it computes: stores and programs tell apart what computes something else, and only that."""

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.impacts.batch import split
from erosion.models.equations import equations_of, model_digest
from tests.impacts.test_force_laws import TableOfDepth

P = erosion.TABLE_1
DEPTHS = np.linspace(0, 1, 5000)

HEAD = """
import functools, os, types, math
import equinox as eqx, jax, jax.numpy as jnp, numpy as np
import erosion
from erosion.models import ForceLaw, Rotating, Linearized
"""
LAW = """
class Law(ForceLaw):
    '''A law.'''
    {fields}
    def __call__(self, state, tip, p):
        {first}
        force = {force}
        return force, {ratio} * force
    def typical_ratio(self, p):
        return {typical}
model = Rotating(force=Law({given}))
"""
USUAL = {
    "fields": "pass", "first": "pass", "force": "-p.stiffness * tip.depth", "ratio": "p.k", "typical": "p.k",
    "given": "",
}  # fmt: skip


def law(before: str = "", after: str = "", **parts: str) -> str:
    return HEAD + before + LAW.format(**(USUAL | parts)) + after


def model_of(text: str) -> erosion.CuttingModel:
    """What a cell of a notebook makes; each has a place of its own for its names."""
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(text, scope)
    return scope["model"]


WRAPPED = """
def timed(function):
    @functools.wraps(function)
    def call(*arguments):
        return {factor} * function(*arguments)
    return call
@timed
def ratio(k): return k
"""
INSIDE = """
def make(a):
    class Law(ForceLaw):
        def __call__(self, state, tip, p):
            force = -a * p.stiffness * tip.depth
            return force, p.k * force
        def typical_ratio(self, p): return p.k
    return Law()
model = Rotating(force=make({a}))
"""
SLOTTED = """
class Settings:
    __slots__ = ("gain",)
    def __init__(self, gain): self.gain = gain
settings = Settings({gain})
"""
STATIC = {"fields": "power: object = eqx.field(static=True, default={})", "force": "-p.stiffness * tip.depth * {}"}
CUSTOM = """
@jax.custom_jvp
def ratio(k): return k
@ratio.defjvp
def _(primals, tangents): return primals[0], {slope} * tangents[0]
"""
EVENTS = """
class Own(Linearized):
    def events(self, state, p):
        tip = self.tip(state, p)
        return {{"rebound": tip.depth / self.scales(p).length, "{name}": {stop}}}
model = Own()
"""


def static(value: str, force: str) -> str:
    return law(
        fields=f"power: object = eqx.field(static=True, default={value})", force=f"-p.stiffness * tip.depth * {force}"
    )


DIFFERENT = {
    "a class made in a function, by its argument": (HEAD + INSIDE.format(a=1.0), HEAD + INSIDE.format(a=1.5)),
    "a wrapped function": tuple(law(WRAPPED.format(factor=f), ratio="ratio(p.k)") for f in (1.0, 1.5)),
    "slots": tuple(law(SLOTTED.format(gain=g), ratio="settings.gain * p.k") for g in (1.0, 1.5)),
    "the last bit of a global number": tuple(law(f"GAIN = {g}", ratio="GAIN * p.k") for g in (1.1, 1.1 + 2.3e-16)),
    "the end of a long global array": tuple(
        law(f"A = np.append(np.ones(5000), {g})", ratio="jnp.sum(A) / 5000 * p.k") for g in (1.0, 1.5)
    ),
    "a closure": tuple(
        law(f"def times(g): return lambda k: g * k\nf = times({g})", ratio="f(p.k)") for g in (1.0, 1.5)
    ),
    "an environment variable": (
        law(
            "os.environ['EROSION_TEST_GAIN'] = '1.0'",
            first="g = float(os.environ['EROSION_TEST_GAIN'])",
            ratio="g * p.k",
        ),
        law(
            "os.environ['EROSION_TEST_GAIN'] = '1.5'",
            first="g = float(os.environ['EROSION_TEST_GAIN'])",
            ratio="g * p.k",
        ),
    ),
    "a sign": (law(), law(ratio="-p.k")),
    "another parameter": (law(ratio="p.k"), law(ratio="p.inertia")),
    "the order of a quotient": (law(ratio="p.k / p.inertia"), law(ratio="p.inertia / p.k")),
    "which of two products comes first in a sum": (
        law(ratio="(p.k * p.inertia + p.psi * p.k)"),
        law(ratio="(p.psi * p.k + p.k * p.inertia)"),
    ),
    "brackets": (law(ratio="(p.k + (p.psi + p.inertia))"), law(ratio="((p.k + p.psi) + p.inertia)")),
    "a branch": (
        law(ratio="jnp.where(tip.depth > p.r, 1.0, p.k)"),
        law(ratio="jnp.where(tip.depth > 2 * p.r, 1.0, p.k)"),
    ),
    "a branch's case": tuple(
        law(ratio=f"jax.lax.cond(tip.depth > p.r, lambda k: {g} * k, lambda k: k, p.k)") for g in (1.5, 2.0)
    ),
    "the rounds of a loop": tuple(law(ratio=f"jax.lax.fori_loop(0, {n}, lambda i, k: 1.01 * k, p.k)") for n in (3, 4)),
    "what a loop does": tuple(law(ratio=f"jax.lax.fori_loop(0, 3, lambda i, k: {g} * k, p.k)") for g in (1.01, 1.02)),
    "the time scale": (law(), law(typical="2 * p.k")),
    "a rule for the derivative": tuple(law(CUSTOM.format(slope=s), ratio="ratio(p.k)") for s in (1.0, 2.0)),
    "an event's name": tuple(HEAD + EVENTS.format(name=n, stop="tip.vx / p.v0") for n in ("stop", "halt")),
    "an event's function": tuple(HEAD + EVENTS.format(name="stop", stop=f"tip.vx / p.v0 - {g}") for g in (0.0, 0.1)),
    "a static 2 and 2.0": (
        static("2", "isinstance(self.power, int) + 1"),
        static("2.0", "isinstance(self.power, int) + 1"),
    ),
    "a static True and 1": (
        static("True", "(2 if self.power is True else 3)"),
        static("1", "(2 if self.power is True else 3)"),
    ),
    "a static 0.0 and -0.0": (
        static("0.0", "(2 + math.copysign(1, self.power))"),
        static("-0.0", "(2 + math.copysign(1, self.power))"),
    ),
    "a static tuple of 2 and 2.0": (
        static("(2,)", "(isinstance(self.power[0], int) + 1)"),
        static("(2.0,)", "(isinstance(self.power[0], int) + 1)"),
    ),
    "a rule of equinox": tuple(
        law(
            "@eqx.filter_custom_jvp\ndef f(k): return k\n@f.def_jvp\n"
            f"def _(primals, tangents): return primals[0], {g} * tangents[0]",
            ratio="f(p.alpha) * p.k",
        )
        for g in (1.0, 2.0)
    ),
    "a rule for a function of a library": tuple(
        law(f"f = jax.custom_jvp(jnp.sin)\nf.defjvps(lambda t, a, k: {g} * t)", ratio="f(p.alpha) * p.k")
        for g in (1.0, 2.0)
    ),
    "a library's rule": (
        law(ratio="jax.nn.relu(p.alpha - 0.3) * p.k"),
        law(ratio="jnp.maximum(p.alpha - 0.3, 0) * p.k"),
    ),
    "a static set, by its order": tuple(
        static(f"frozenset({s})", "(1 + next(iter(self.power)))") for s in ("[8, 0]", "[0, 8]")
    ),
    "what a static dataclass keeps beside its fields": tuple(
        law(
            "import dataclasses\n@dataclasses.dataclass(frozen=True)\nclass D:\n    g: dataclasses.InitVar\n"
            "    def __post_init__(self, g): object.__setattr__(self, 'gain', g)",
            fields=f"d: object = eqx.field(static=True, default=D({g}))",
            ratio="self.d.gain * p.k",
        )
        for g in (1.0, 1.5)
    ),
    "a cast to single precision": (law(ratio="jnp.asarray(p.k, jnp.float32).astype(float)"), law()),
    "single precision of a constant": (law(ratio="np.float64(np.float32(1.1)) * p.k"), law(ratio="1.1 * p.k")),
    "what is removed at contact": tuple(
        HEAD + f"class Own(Linearized):\n    def removed_at_contact(self, p): return {g} * p.r ** 3\nmodel = Own()"
        for g in (0.0, 1.0)
    ),
}

SAME = {
    "a docstring": (law(), law().replace("A law.", "Another text.")),
    "the name of the class": (
        law(),
        law().replace("Law(", "Another(").replace("class Another(ForceAnother(", "class Another(ForceLaw("),
    ),
    "names of variables": (law(), law().replace("force,", "f,").replace("force =", "f =").replace("* force", "* f")),
    "a helper's name": (
        law("def f(k): return 1.5 * k", ratio="f(p.k)"),
        law("def g(k): return 1.5 * k", ratio="g(p.k)"),
    ),
    "a lambda and a function": (
        law("def f(k): return 1.5 * k", ratio="f(p.k)"),
        law("f = lambda k: 1.5 * k", ratio="f(p.k)"),
    ),
    "a closure and a global": (
        law("GAIN = 1.5", ratio="GAIN * p.k"),
        law("def t(g): return lambda k: g * k\nf = t(1.5)", ratio="f(p.k)"),
    ),
    "a number of numpy": (law(ratio="1.5 * p.k"), law(ratio="np.float64(1.5) * p.k")),
    "jnp.square": (law(ratio="p.k ** 2"), law(ratio="jnp.square(p.k)")),
    "functions and operators": (law(ratio="(p.k * p.psi)"), law(ratio="jnp.multiply(p.k, p.psi)")),
    "what is not used": (law(), law(first="unused = jnp.sin(p.k) + 3")),
    "the order of statements": (
        law(first="a = jnp.sin(p.k); b = jnp.cos(p.psi)", ratio="(a - b)"),
        law(first="b = jnp.cos(p.psi); a = jnp.sin(p.k)", ratio="(a - b)"),
    ),
    "computed twice": (law(first="a = jnp.sin(p.k)", ratio="(a * a)"), law(ratio="(jnp.sin(p.k) * jnp.sin(p.k))")),
    "jit": (law("def f(k): return 1.5 * k", ratio="f(p.k)"), law("@jax.jit\ndef f(k): return 1.5 * k", ratio="f(p.k)")),
    "jit in jit": (
        law("@jax.jit\ndef f(k): return 1.5 * k", ratio="f(p.k)"),
        law("@jax.jit\ndef g(k): return 1.5 * k\n@jax.jit\ndef f(k): return g(k)", ratio="f(p.k)"),
    ),
    "checkpoint": (
        law("def f(k): return 1.5 * k", ratio="f(p.k)"),
        law("f = jax.checkpoint(lambda k: 1.5 * k)", ratio="f(p.k)"),
    ),
    "a static field and a number": (
        law(ratio="1.5 * p.k"),
        law(fields="gain: float = eqx.field(static=True, default=1.5)", ratio="self.gain * p.k"),
    ),
    "an inherited method": (law(), law(after="class Child(Law): pass\nmodel = Rotating(force=Child())")),
    "a class in a function": (HEAD + INSIDE.format(a=1.0), HEAD + INSIDE.format(a=1.0)),
    "where and select": (
        law(ratio="jnp.where(tip.depth > p.r, 1.0, p.k)"),
        law(ratio="jax.lax.select(tip.depth > p.r, jnp.float64(1.0), p.k)"),
    ),
    "a tuple and a list": (law(), law().replace("return force, p.k * force", "return (force, p.k * force)")),
    "a type conversion that changes nothing": (law(), law(ratio="jnp.asarray(p.k, jnp.float64)")),
    "the file it comes from": (law(), law(before="\n" * 20)),
    "a rule for the derivative": (
        law(CUSTOM.format(slope=1.5), ratio="ratio(p.k)"),
        law(CUSTOM.format(slope=1.5).replace("def _", "def rule"), ratio="ratio(p.k)"),
    ),
}


@pytest.fixture(autouse=True)
def _the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EROSION_TEST_GAIN", "1.0")
    monkeypatch.setitem(sys.modules, "helpers_of_test", None)


# Many pairs share a model.
@functools.cache
def digests(text: str) -> tuple[str, Any]:
    """What a store, and what the programs know a model by."""
    model = model_of(text)
    store = model_digest(model)
    return store, split(model, P)[0]


@pytest.mark.parametrize("name", DIFFERENT)
def test_stores_and_programs_tell_apart(name: str) -> None:
    one, other = map(digests, DIFFERENT[name])
    assert one[0] != other[0]
    assert one[1] != other[1]


@pytest.mark.parametrize("name", SAME)
def test_stores_and_programs_do_not_tell_apart(name: str) -> None:
    one, other = map(digests, SAME[name])
    assert one[0] == other[0]
    assert one[1] == other[1]


CHANGES = {
    "a helper": ("def f(k): return k", "f(p.k)", "def f(k): return 1.5 * k"),
    "a helper's helper": ("def g(k): return k\ndef f(k): return g(k)", "f(p.k)", "def g(k): return 1.5 * k"),
    "a helper within a wrapper": (WRAPPED.format(factor=1.0) + "\ng = ratio", "g(p.k)", "g = lambda k: 1.5 * k"),
    "a number": ("GAIN = 1.0", "GAIN * p.k", "GAIN = 1.5"),
    "a number of a helper": ("GAIN = 1.0\ndef f(k): return GAIN * k", "f(p.k)", "GAIN = 1.5"),
    "an item of a table": ("T = {'a': [1.0]}", "T['a'][0] * p.k", "T['a'][0] = 1.5"),
    "a new item": ("T = [1.0]", "sum(T) * p.k", "T.append(0.5)"),
    "an array in place": ("A = np.array([1.0])", "A[0] * p.k", "A[0] = 1.5"),
    "a namespace": ("S = types.SimpleNamespace(g=1.0)", "S.g * p.k", "S.g = 1.5"),
    "a namespace that a helper is given": (
        "S = types.SimpleNamespace(g=1.0)\ndef f(s, k): return s.g * k",
        "f(S, p.k)",
        "S.g = 1.5",
    ),
    "slots": (SLOTTED.format(gain=1.0), "settings.gain * p.k", "settings.gain = 1.5"),
    "an attribute of the class": ("", "getattr(type(self), 'gain', 1.0) * p.k", "Law.gain = 1.5"),
    "a method of the class": ("", "self.typical_ratio(p)", "Law.typical_ratio = lambda self, p: 1.5 * p.k"),
    "a class that it makes": (
        "class S:\n    def f(self, k): return k",
        "S().f(p.k)",
        "class S:\n    def f(self, k): return 1.5 * k",
    ),
    "a method of a class that it makes": (
        "class S:\n    def f(self, k): return k",
        "S().f(p.k)",
        "S.f = lambda self, k: 1.5 * k",
    ),
    "code, as autoreload does": ("def f(k): return k", "f(p.k)", "f.__code__ = (lambda k: 1.5 * k).__code__"),
    "a default": ("def f(k, g=1.0): return g * k", "f(p.k)", "f.__defaults__ = (1.5,)"),
    "what a closure holds": (
        "def make():\n    g = 1.0\n    def f(k): return g * k\n    def put(x):\n        nonlocal g\n        g = x\n"
        "    return f, put\nf, put = make()",
        "f(p.k)",
        "put(1.5)",
    ),
    "a module's function": (
        "import sys\nsys.modules['helpers_of_test'] = helpers = types.ModuleType('helpers_of_test')\n"
        "helpers.__file__ = '/home/user/helpers.py'\nexec('def f(k): return k', helpers.__dict__)",
        "helpers.f(p.k)",
        "exec('def f(k): return 1.5 * k', helpers.__dict__)",
    ),
    "a module of no file": ("m = types.ModuleType('m')\nm.g = 1.0", "m.g * p.k", "m.g = 1.5"),
    "a module's function that is imported in a method": (
        "import sys\nsys.modules['helpers_of_test'] = helpers = types.ModuleType('helpers_of_test')\n"
        "helpers.__file__ = '/home/user/helpers.py'\nexec('def f(k): return k', helpers.__dict__)\n"
        "def helped(k):\n    from helpers_of_test import f\n    return f(k)",
        "helped(p.k)",
        "exec('def f(k): return 1.5 * k', helpers.__dict__)",
    ),
    "a name that hides one of Python's": ("", "abs(p.k)", "abs = lambda k: 1.5 * k"),
    "an environment variable": (
        "",
        "float(os.environ['EROSION_TEST_GAIN']) * p.k",
        "os.environ['EROSION_TEST_GAIN'] = '1.5'",
    ),
    "a static function's helper": (
        "def g(k): return k\nf = functools.partial(lambda k: g(k))",
        "f(p.k)",
        "def g(k): return 1.5 * k",
    ),
    "a helper that a helper's __init__ calls": (
        "def g(): return 1.0\nclass S:\n    def __init__(self): self.g = g()",
        "S().g * p.k",
        "def g(): return 1.5",
    ),
    "a helper under vmap": (
        "def f(k): return k\ndef g(k): return f(k)\nh = jax.vmap(g)",
        "h(jnp.stack([p.k]))[0]",
        "def f(k): return 1.5 * k",
    ),
    "a helper under grad": (
        "def f(k): return k * k\ndef g(k): return f(k)\nh = jax.grad(g)",
        "h(p.k)",
        "def f(k): return k",
    ),
    "a helper under jit": ("def f(k): return k\n@jax.jit\ndef g(k): return f(k)", "g(p.k)", "def f(k): return 1.5 * k"),
    "a rule of derivatives": (CUSTOM.format(slope=1.0), "ratio(p.k)", "ratio.defjvp(lambda p, t: (p[0], 2.0 * t[0]))"),
    "an attribute of a function": ("def f(k): return f.g * k\nf.g = 1.0", "f(p.k)", "f.g = 1.5"),
    "an attribute that is new": ("S = types.SimpleNamespace()", "getattr(S, 'g', 1.0) * p.k", "S.g = 1.5"),
    "a default that an instance hides": ("class S:\n    g = 1.0\ns = S()", "s.g * p.k", "s.g = 1.5"),
    "a global by globals()": ("GAIN = 1.0", "globals()['GAIN'] * p.k", "GAIN = 1.5"),
    "the environment by a name": (
        "NAME = 'EROSION_TEST_GAIN'",
        "float(os.environ[NAME]) * p.k",
        "os.environ[NAME] = '1.5'",
    ),
    "a body of a loop": (
        "def f(k): return k\ndef body(i, k): return f(k)",
        "jax.lax.fori_loop(0, 3, body, p.k)",
        "def f(k): return 1.5 * k",
    ),
    "a helper in jnp.where": (
        "def f(k): return k",
        "jnp.where(tip.depth > 0, f(p.k), p.k)",
        "def f(k): return 1.5 * k",
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_defined_anew_counts_at_once(name: str) -> None:
    before, ratio, change = CHANGES[name]
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(law(before, ratio=ratio), scope)
    model = scope["model"]
    usual, program = equations_of(model), split(model, P)[0]
    assert equations_of(model) is usual
    exec(change, scope)
    assert equations_of(model).digest != usual.digest
    assert split(model, P)[0] != program


GIVES: dict[str, Callable[[Any], Any]] = {
    "impact": lambda model: erosion.impact(model, P).volume,
    "alpha_max": lambda model: erosion.alpha_max(model, P).alpha,
    "simulate": lambda model: erosion.simulate(model, P).volume,
    "sweep": lambda model: erosion.sweep(model, P, alpha=[0.2, 0.4]).volume.values.sum(),
    "stream": lambda model: erosion.stream(model, P, n=64, best_angle=False, k=stats.norm(2, 0.1)).total_volume,
}


@pytest.mark.parametrize("verb", GIVES)
def test_every_verb_follows_the_newest_code(verb: str) -> None:
    gives = GIVES[verb]
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(law("def f(k): return k", ratio="f(p.k)"), scope)
    usual = np.asarray(gives(scope["model"]))
    exec("def f(k): return 1.5 * k", scope)
    anew = np.asarray(gives(scope["model"]))
    np.testing.assert_array_equal(anew, np.asarray(gives(model_of(law("def f(k): return 1.5 * k", ratio="f(p.k)")))))
    assert not np.array_equal(usual, anew)
    exec("def f(k): return k", scope)
    np.testing.assert_array_equal(np.asarray(gives(scope["model"])), usual)


@pytest.mark.parametrize(
    ("place", "kind"),
    [(0, lambda f: f), (1, lambda f: f), (0, functools.partialmethod), (0, eqx.filter_jit)],
    ids=["of its class", "of the class that it inherits from", "partialmethod", "filter_jit"],
)
def test_a_method_of_the_package_that_someone_replaces_counts(
    place: int, kind: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    rate = erosion.models.Rotating.removal_rate
    usual, identity = erosion.impact("rotating", P), model_digest(erosion.load_model("rotating"))
    with monkeypatch.context() as patch:
        patch.setattr(
            erosion.models.Rotating.__mro__[place],
            "removal_rate",
            kind(lambda self, state, p: 2 * rate(self, state, p)),
        )
        assert model_digest(erosion.load_model("rotating")) != identity
        assert erosion.impact("rotating", P).volume == pytest.approx(2 * usual.volume)
        assert erosion.volume("rotating", P) == pytest.approx(2 * usual.volume)
        assert erosion.sweep("rotating", P, alpha=[P.alpha]).volume[0] == pytest.approx(2 * usual.volume)
    assert erosion.impact("rotating", P).volume == usual.volume
    assert model_digest(erosion.load_model("rotating")) == identity


def test_numbers_are_part_of_a_stores_identity_to_the_last_bit() -> None:
    def table(values: np.ndarray) -> erosion.CuttingModel:
        return erosion.models.Rotating(force=TableOfDepth(DEPTHS, values))

    changed = DEPTHS.copy()
    changed[2500] = np.nextafter(changed[2500], np.inf)
    assert model_digest(table(DEPTHS)) == model_digest(table(DEPTHS.copy()))
    assert model_digest(table(DEPTHS)) != model_digest(table(changed))
    tip = erosion.load_model(Path(__file__).parents[2] / "models" / "coulomb_tip.py")
    assert model_digest(tip.replace(friction=0.3)) != model_digest(tip.replace(friction=0.3 + 1e-16))
    # Of one program are both, which takes such numbers as arguments.
    assert split(table(DEPTHS), P)[0] == split(table(changed), P)[0]


def test_the_target_of_a_correlation_counts() -> None:
    assert model_digest(erosion.load_model("dnv:duplex")) != model_digest(erosion.load_model("dnv"))


def test_a_model_that_calls_back_into_python_has_no_identity() -> None:
    text = law(ratio="jax.pure_callback(lambda k: k, jax.ShapeDtypeStruct((), float), p.k)")
    with pytest.raises(ValueError, match="Argument `model` must compute by JAX alone where a store is given"):
        model_digest(model_of(text))


def test_code_that_is_redefined_under_a_program_of_jax_spoils_no_other_model() -> None:
    scope: dict[str, Any] = {"__name__": "__main__"}
    exec(law("def f(k): return k", ratio="f(p.k)"), scope)
    compiled = jax.jit(lambda a: erosion.volume(scope["model"], P.replace(alpha=a))).lower(0.3).compile()
    exec("def f(k): return 1.25 * k", scope)
    case = P.replace(alpha=0.3)
    assert float(compiled(0.3)) == erosion.volume(model_of(law(ratio="1.25 * p.k")), case)
    unrelated = erosion.volume(model_of(law()), case)
    assert float(unrelated) == pytest.approx(erosion.simulate("rotating", case).volume, rel=1e-9)
