"""The transpose of a step of any Runge-Kutta or Rosenbrock method."""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Number
from erosion.ode.methods.sums import weighted
from erosion.ode.reduction import Rows


def transposed(
    numbers: list[Number],
    b: Sequence[float] | np.ndarray,
    a: Sequence[Sequence[float] | np.ndarray],
    after: Rows,
    pulls: Sequence[Callable[[Rows], tuple[list[Number], Rows]]],
    of_right: Callable[[int, Rows, dict[int, Rows]], Rows],
) -> tuple[Rows, list[Number], tuple[dict[int, Rows], dict[int, Rows]]]:
    """The cotangents of the start of a step and of the numbers, but for those of its end; and those of the stages.

    Args:
        numbers: of the lane, by which rates are differentiated.
        b: weights of the stages in the step.
        a: and in the state of each stage after the first.
        after: cotangents of the step's end.
        pulls: from cotangents of the rates of a stage to those of the numbers and of its state.
        of_right: the cotangents of a stage's rates, from those of what it gives, and of the rates of later stages.
    """
    gained, total = zeros(numbers), zeros(after)
    of_rights: dict[int, Rows] = {}
    of_states: dict[int, Rows] = {}
    for i in reversed(range(len(pulls))):
        later = range(i + 1, len(pulls))
        weights = [b[i], *(a[j - 1][i] for j in later)]
        bars = [weighted(weights, [bar, *(of_states[j][r] for j in later)]) for r, bar in enumerate(after)]
        of_rights[i] = of_right(i, bars, of_rights)
        grads, of_states[i] = pulls[i](of_rights[i])
        gained, total = plus(gained, grads), plus(total, of_states[i])
    return total, gained, (of_rights, of_states)


def zeros(these: Sequence[Any]) -> list[Any]:
    """Cotangents of nothing."""
    return [jnp.zeros(jnp.shape(each)) for each in these]


def plus(these: Sequence[Any], those: Sequence[Any]) -> list[Any]:
    """Sums of two lists, number by number."""
    return [one + other for one, other in zip(these, those, strict=True)]
