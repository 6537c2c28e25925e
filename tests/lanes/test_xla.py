"""The same functions of a lane through XLA, as on a GPU."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest

from erosion.lanes.lanewise import Lanewise, XlaLanes, by_xla, number
from tests.lanes.test_lanewise import FUNCTIONS, X, Y

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("function", FUNCTIONS)
def test_both_compilers_agree(function):
    exact = Lanewise(function, (number, number))(X, Y)
    leaves = jax.tree.leaves(exact)
    results = [np.full_like(leaf, 7) for leaf in leaves]
    some = np.array([4, 0, 44])
    XlaLanes(function, (number, number)).run([X, Y], some, results)
    for result, leaf in zip(results, leaves, strict=True):
        assert result[some] == pytest.approx(leaf[some], rel=1e-12, abs=1e-12)
        assert np.array_equal(result[1], np.full_like(leaf, 7)[1])


# Without its passes of fusion XLA compiles in a tenth of the time, see `lanes/lanewise.py`.
PROGRAM = """
import jax, erosion
from erosion.lanes.lanewise import _ON_A_CPU
p = erosion.TABLE_1
hits = erosion.impact("linearized", p.replace(alpha=[0.3, 0.6, 1.1]))
slope = jax.grad(lambda alpha: erosion.volume("linearized", p.replace(alpha=alpha)))
print(*hits.volume, *hits.outcome, jax.jit(slope, compiler_options=_ON_A_CPU)(0.3))
"""


def test_impacts_and_volumes_are_the_same_by_xla():
    said = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env={**os.environ, "EROSION_ENGINE": engine},
            capture_output=True, text=True, check=True,
        ).stdout
        for engine in ("lanes", "xla")
    ]  # fmt: skip
    one, other = (np.array(text.split(), float) for text in said)
    assert one == pytest.approx(other, rel=1e-10)


def test_an_engine_that_nobody_knows_is_refused():
    process = subprocess.run(
        [sys.executable, "-c", "import erosion; erosion.impact('finnie', erosion.TABLE_1)"],
        env={**os.environ, "EROSION_ENGINE": "cuda"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "EROSION_ENGINE must be `lanes` or `xla`, but is 'cuda'." in process.stderr


def test_a_gpu_alone_does_not_make_xla_compile(monkeypatch):
    monkeypatch.delenv("EROSION_ENGINE", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert not by_xla.__wrapped__()
