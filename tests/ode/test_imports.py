"""The integrator alone needs few packages."""

import subprocess
import sys

import numpy as np
import pytest

_HIDDEN = """
import sys
from importlib.metadata import packages_distributions

others = set(packages_distributions()) - {core}


class Without:
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        return None if name.partition(".")[0] in others else self.finder.find_spec(name, path, target)


sys.meta_path[:] = map(Without, sys.meta_path)
"""

_FALL = """
import jax
from erosion import ode

fall = ode.Problem(
    y0={"y": 10.0, "v": 0.0},
    vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"]},
    events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
)
end = ode.solve(fall, {"g": 9.81}, t1=100.0, wrt="g")
assert end.ended_by == "ground" and not end.warnings
assert "equinox" not in sys.modules
print(float(jax.grad(lambda g: ode.solve(fall, {"g": g}, t1=100.0).t)(9.81)))
"""

# Of these scipy, ml_dtypes and opt_einsum are JAX's, and wadler_lindig is jaxtyping's.
_CORE = {
    "equinox",
    "erosion",
    "jax",
    "jaxlib",
    "jaxtyping",
    "llvmlite",
    "ml_dtypes",
    "numpy",
    "opt_einsum",
    "platformdirs",
    "scipy",
    "wadler_lindig",
}


def test_a_problem_is_solved_by_the_core_alone():
    """Units, tables, figures and the command line stand beside the integrator."""
    code = _HIDDEN.replace("{core}", repr(_CORE)) + _FALL
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(-np.sqrt(5 / 9.81**3), rel=1e-8)
