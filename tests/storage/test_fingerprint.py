"""What tells one model's store from another's: every number and all code, however short its words are."""

import dataclasses
import functools
import importlib
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
import erosion.storage.fingerprint
from erosion.distributions import Normal, Samples
from erosion.storage.fingerprint import fingerprint, package_digest
from erosion.storage.identity import identity
from tests.engine.test_force_laws import Table

P = erosion.TABLE_1
DEPTHS = np.linspace(0, 1, 5000)


def table(values: np.ndarray) -> erosion.CuttingModel:
    return erosion.models.Rotating(force=Table(DEPTHS, values))


class Weights(eqx.Module):
    layers: Any
    static: Any = eqx.field(static=True, default=None)


def changed(values: np.ndarray, at: int) -> np.ndarray:
    values = values.copy()
    values[at] = np.nextafter(values[at], np.inf)
    return values


def network(seed: int, activation: Callable = jax.nn.relu) -> eqx.nn.MLP:
    return eqx.nn.MLP(2, 1, 64, 2, activation=activation, key=jax.random.key(seed))


def doubled(x: Any) -> Any:
    return 2 * x


def times(factor: float) -> Callable:
    return lambda x: factor * x


# Made by the tests: to import this module is to collect it, and a network has JAX compile.
PAIRS = {
    "the last bit in the middle of a long array": lambda: (table(DEPTHS), table(changed(DEPTHS, 2500))),
    "an array within a tuple": lambda: (Weights((DEPTHS,)), Weights((changed(DEPTHS, 7),))),
    "an array within a dictionary": lambda: (Weights({"a": DEPTHS}), Weights({"a": changed(DEPTHS, 7)})),
    "an array of JAX": lambda: (Weights(jnp.arange(5000.0)), Weights(jnp.arange(5000.0).at[2500].set(0.0))),
    "the weights of a network": lambda: (network(0), network(1)),
    "the activation of a network": lambda: (network(0), network(0, jax.nn.tanh)),
    "what a closure holds": lambda: (Weights(times(2.0)), Weights(times(3.0))),
    "what a partial function holds": lambda: (
        Weights(functools.partial(doubled, 1)),
        Weights(functools.partial(doubled, 2)),
    ),
    "the line of a function without a name": lambda: (Weights(lambda x: x), Weights(times(2.0))),
    "a static field": lambda: (Weights(1.0, static="a"), Weights(1.0, static="b")),
    "the type of a number": lambda: (Weights(np.float32(1)), Weights(np.float64(1))),
    "the shape of an array": lambda: (Weights(np.zeros((2, 3))), Weights(np.zeros((3, 2)))),
    "the sign of zero": lambda: (Weights(0.0), Weights(-0.0)),
    "samples": lambda: (Samples(DEPTHS), Samples(changed(DEPTHS, 2500))),
    "the number of a law": lambda: (Normal(1, 0.1), Normal(1, 0.1 + 1e-17)),
    "objects within an array": lambda: (Weights(np.array([1.0, None])), Weights(np.array([2.0, None]))),
}


@pytest.mark.parametrize("name", PAIRS)
def test_things_that_differ_have_different_fingerprints(name: str) -> None:
    one, other = PAIRS[name]()
    assert fingerprint(one) == fingerprint(one)
    assert fingerprint(one) != fingerprint(other)


def test_the_same_thing_made_twice_has_one_fingerprint() -> None:
    assert fingerprint(table(DEPTHS)) == fingerprint(table(DEPTHS.copy()))
    assert fingerprint(network(3)) == fingerprint(network(3))
    assert fingerprint(Weights(times(2.0))) == fingerprint(Weights(times(2.0)))
    assert fingerprint(Normal(1, 2)) == fingerprint(Normal(1.0, 2.0))


def test_an_identity_holds_the_fingerprint_of_every_model() -> None:
    one, other = (identity({"m": model}, P)["models"] for model in (table(DEPTHS), table(changed(DEPTHS, 2500))))
    assert one != other


LAW = """
import dataclasses, numpy as np
from helper import middle
from erosion.distributions import Distribution

@dataclasses.dataclass(frozen=True)
class Mine(Distribution):
    mean: float

    def ppf(self, u):
        return {formula}

    def cdf(self, x):
        return float(x >= self.mean)
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], Any]]:
    """Makes a module of a text, beside a helper of another text, and imports both anew."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(text: str, helper: str = "def middle(u): return u") -> Any:
        for name, content in (("mine", text), ("helper", helper)):
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(content))
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        return importlib.import_module("mine")

    yield make
    for name in ("mine", "helper"):
        sys.modules.pop(name, None)


def test_a_users_law_is_known_by_its_code_and_that_of_its_helpers(module: Callable[..., Any]) -> None:
    usual = fingerprint(module(LAW.format(formula="self.mean + u")).Mine(1.0), "v0")
    assert fingerprint(module(LAW.format(formula="self.mean + u")).Mine(1.0), "v0") == usual
    assert fingerprint(module(LAW.format(formula="self.mean - u")).Mine(1.0), "v0") != usual
    assert fingerprint(module(LAW.format(formula="self.mean + u"), "def middle(u): return -u").Mine(1.0)) != usual


@pytest.mark.slow
def test_a_stream_of_another_law_of_the_same_name_is_refused(module: Callable[..., Any], tmp_path: Path) -> None:
    def run(formula: str) -> None:
        law = module(LAW.format(formula=formula)).Mine(4400.0)
        erosion.stream("linearized", P, n=64, best_angle=False, v0=law, store=tmp_path / "jet.nc")

    run("self.mean + 10 * u")
    run("self.mean + 10 * u")
    with pytest.raises(ValueError, match="another result \\(of another distributions\\)"):
        run("self.mean + 20 * u")


def test_an_edit_of_the_package_itself_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "engine").mkdir()
    (tmp_path / "cli").mkdir()
    for name in ("engine/tableau.py", "cli/run.py"):
        (tmp_path / name).write_text("order = 8\n")
    monkeypatch.setattr(erosion.storage.fingerprint, "_PACKAGE", tmp_path)
    before = package_digest.__wrapped__()
    (tmp_path / "cli/run.py").write_text("order = 9\n")
    assert package_digest.__wrapped__() == before
    (tmp_path / "engine/tableau.py").write_text("order = 9\n")
    assert package_digest.__wrapped__() != before
    assert package_digest() in identity({}, P)["version"]


def test_what_has_no_digest_is_refused_by_name() -> None:
    scope: dict[str, Any] = {"__name__": "typed"}
    exec("import dataclasses\n@dataclasses.dataclass\nclass Typed:\n  x: float = 1.0\n\ndef f(x): return x", scope)
    for thing in (scope["Typed"](), scope["f"], Weights(scope["f"])):
        with pytest.raises(ValueError, match="Argument `v0` must come from a file where a store is given, but"):
            fingerprint(thing, "v0")
    with pytest.raises(ValueError, match="Argument `model` must hold numbers and functions where a store is given"):
        fingerprint(Weights(object()))


def test_a_thing_that_holds_itself_has_a_fingerprint() -> None:
    @dataclasses.dataclass
    class Ring:
        inside: Any = None

    ring = Ring()
    ring.inside = [ring]
    assert fingerprint(ring) == fingerprint(ring)
