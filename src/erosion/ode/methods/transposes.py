"""The transpose of a step of any Runge-Kutta or Rosenbrock method."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Number
from erosion.ode.methods.sums import weighted
from erosion.ode.reduction import FlatState


def transposed(
    parameters: list[Number],
    b: Sequence[float] | np.ndarray,
    a: Sequence[Sequence[float] | np.ndarray],
    after: FlatState,
    pulls: Sequence[Callable[[FlatState], tuple[list[Number], FlatState]]],
    of_right: Callable[[int, FlatState, dict[int, FlatState]], FlatState],
) -> tuple[FlatState, list[Number], tuple[dict[int, FlatState], dict[int, FlatState]]]:
    """The cotangents of the start of a step and of the numbers, but for those of its end; and those of the stages.

    Args:
        parameters: of the lane, by which rates are differentiated.
        b: weights of the stages in the step.
        a: and in the state of each stage after the first.
        after: cotangents of the step's end.
        pulls: from cotangents of the rates of a stage to those of the numbers and of its state.
        of_right: the cotangents of a stage's rates, from those of what it gives, and of the rates of later stages.
    """
    gained, total = zeros(parameters), zeros(after)
    of_rights: dict[int, FlatState] = {}
    of_states: dict[int, FlatState] = {}
    for i in reversed(range(len(pulls))):
        later = range(i + 1, len(pulls))
        weights = [b[i], *(a[j - 1][i] for j in later)]
        cotangents = [
            weighted(weights, [cotangent, *(of_states[j][r] for j in later)]) for r, cotangent in enumerate(after)
        ]
        of_rights[i] = of_right(i, cotangents, of_rights)
        grads, of_states[i] = pulls[i](of_rights[i])
        gained, total = plus(gained, grads), plus(total, of_states[i])
    return total, gained, (of_rights, of_states)


def zeros(these: Sequence[Any]) -> list[Any]:
    """Cotangents of nothing."""
    return [jnp.zeros(jnp.shape(each)) for each in these]


def plus(these: Sequence[Any], those: Sequence[Any]) -> list[Any]:
    """Sums of two lists, number by number."""
    return [one + other for one, other in zip(these, those, strict=True)]
