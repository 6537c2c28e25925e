"""Problems as lanes of the integrator, without the functions that users call."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from erosion.ode.batch import integrate
from erosion.ode.integrator import LaneEnd
from erosion.ode.problem import Problem, is_number, struct_of
from erosion.ode.signature import Options, Signature


def lanes_of(problem: Problem, args: Any, options: Options | None = None) -> tuple[Signature, list[Any]]:
    """Signature and parameters of one lane."""
    leaves, structure = jax.tree.flatten(args)
    parameters = [leaf for leaf in leaves if is_number(leaf)]
    structs = [struct_of(number) for number in parameters]
    equations = problem.equations(args, structs)
    assert equations.error is None
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    shapes, dtypes = tuple(one.shape for one in structs), tuple(one.dtype.name for one in structs)
    return Signature(problem, structure, rest, shapes, dtypes, options or Options(), equations), parameters


def ended(problem: Problem, args: Any, places: Sequence[int] = (), rtol: float = 1e-9) -> tuple[str, LaneEnd]:
    """How one lane ends, and its results; with first derivatives where there is a place."""
    signature, parameters = lanes_of(problem, args)
    arrays = [np.asarray(number) for number in parameters]
    results = integrate(signature, arrays, 1, len(places), tuple(places), rtol)
    return signature.end_names[results.outcome[0]], results


def alike(found: Any, expected: Any, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Compare all numbers of two trees."""
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)
