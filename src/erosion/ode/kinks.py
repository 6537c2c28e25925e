"""What a kink of the motion does to the derivatives that are carried along with it.

Steps across a kink of a rate are so short that each rate has one of two values in them: that before the kink or
that after it. So kinks need not be known: they show themselves.

The motion s' = f(s) has the derivatives s_a and s_b by two parameters; their rates are G_a and G_b. With [·] a change
across the kink:

- [f] ≠ 0: the rate jumps. Where it does depends on the parameters, so that even s_a jumps. Nothing says by how much,
  and the lane fails; see `erosion.ode.batch`, which then computes it without derivatives.
- [f] = 0: ḟ and G jump together, [G_a] = -τ_a [ḟ] with τ the time of the kink. Then s_ab jumps by [G_a] [G_b] / [ḟ].
"""

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import lax

from erosion.array_types import Flag, Scalar

_SHORT = 1e-2  # of the time scale: longer steps cross no kink that matters
_TWO_VALUED = 0.1  # of the change of a rate: so near one of both its ends are its values at the stages
_ABRUPT = 100.0  # times what a rate that changes within the time scale would: it jumps

Rows = list[Scalar]
"""The state with its derivatives, as plain numbers, one member after the other."""


@runtime_checkable
class Equations(Protocol):
    """What is needed of the integrated equations.

    Args:
        width: number of rows of the motion itself, and of each derivative.
        rate: of all rows.
        motion_rate: of the rows of the motion itself.
    """

    width: int
    rate: Callable[[Rows], Rows]
    motion_rate: Callable[[Rows], Rows]


def is_broken(problem: Equations, before: Rows, stages: list[Rows], h: Scalar, scale: Scalar) -> Flag:
    """Whether a rate of the motion itself jumps within a step.

    Args:
        problem: the equations.
        before: the state at the step's start.
        stages: the slopes of each row in the step.
        h: its length.
        scale: the time scale.
    """
    broken: Flag = jnp.asarray(False)
    for row in range(problem.width):
        change = jnp.abs(_jump(stages[row]))
        size = jnp.maximum(jnp.abs(before[row]), scale * jnp.maximum(jnp.abs(stages[row][0]), jnp.abs(stages[row][-1])))
        broken = broken | (change * scale * scale > _ABRUPT * h * size)
    return broken & (h < _SHORT * scale)


def corrected(
    problem: Equations,
    before: tuple[Rows, Rows],
    after: tuple[Rows, Rows],
    stages: list[Rows],
    h: Scalar,
    scale: Scalar,
) -> tuple[Rows, Rows]:
    """State and slope after a step, the second derivatives corrected if it crosses a kink.

    Args:
        problem: the equations, to second order.
        before: state and slope where the step begins.
        after: the same at its end.
        stages: the slopes of each row in the step.
        h: its length.
        scale: the time scale.
    """
    width, (state, slope) = problem.width, after
    jumps = [_jump(row) for row in stages[width:-width]]  # of the rates of first derivatives
    crosses = (h < _SHORT * scale) & (sum(map(jnp.abs, jumps)) > 0)

    def at_kink() -> tuple[Rows, Rows]:
        bends = [new - old for new, old in zip(_bend(problem, *after), _bend(problem, *before), strict=True)]
        sizes = [jnp.maximum(jnp.abs(u), scale * jnp.abs(k)) for u, k in zip(state[:width], slope, strict=False)]
        weights = [bend / (size * size + 1e-200) for bend, size in zip(bends, sizes, strict=True)]
        first, other = jumps[:width], jumps[-width:]
        passed = _product(weights, other) / _product(weights, bends)
        second = [u + jump * passed for u, jump in zip(state[-width:], first, strict=True)]
        moved = [*state[:-width], *second]
        return moved, problem.rate(moved)

    return lax.cond(crosses, at_kink, lambda: (state, slope))


def _product(weights: Sequence[Scalar], values: Sequence[Scalar]) -> Scalar:
    return sum(weight * value for weight, value in zip(weights, values, strict=True))


@jax.jit
def _jump(slopes: Sequence[Scalar]) -> Scalar:
    """By how much a rate jumps within a step; 0 where it takes values between its ends, as smooth rates do."""
    start, end = slopes[0], slopes[-1]
    change = end - start
    near = jnp.zeros(())
    for slope in slopes[1:-1]:
        near = jnp.maximum(near, jnp.minimum(jnp.abs(slope - start), jnp.abs(slope - end)))
    return jnp.where(near <= _TWO_VALUED * jnp.abs(change), change, 0.0)


def _bend(problem: Equations, state: Rows, slope: Rows) -> Rows:
    """The second time derivative of the motion itself."""
    width = problem.width
    return jax.jvp(problem.motion_rate, (state[:width],), (slope[:width],))[1]
