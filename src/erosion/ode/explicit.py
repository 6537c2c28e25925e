"""A step of Prince and Dormand's 8th-order pair, and its error."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Scalar
from erosion.ode.extended import Extended
from erosion.ode.reduction import Rows
from erosion.ode.step_control import B_CHECK, B_ERROR, A, B, eighth_root, moved_by, weighted

_CHECK = 0.1  # of the second estimate, brought to the first one's order; benchmarks/TUNING.md
_LOOKS = (5, 9)  # stages at 0.15 and 0.92 of a step: a cubic that errs between them errs at one of them
_FAST = 1.0  # over an eigenvalue is a step at least that a fast part of the motion makes short
_LONGER = 0.5  # times as long a step at least would do for the method for stiff motions
_TOLD = 1e-4  # tolerances: stages that differ by less say nothing about eigenvalues
_TINY = 1e-200  # keeps 0/0 away
SOON = 1e-3  # of the time scale: what a row changes within it counts as its size
APART = 1e-6  # of a row's size is the least size of its derivatives, by a change of a number by its own size
NOISE = 1e-15  # of a row's size: what rounding leaves in its derivatives
LEAST = 1e-8  # of the greatest size that a row has had: a smaller one need not be known relative to itself


def step(
    problem: Extended, state: Rows, slope: Rows, h: Scalar
) -> tuple[Rows, list[Rows], list[tuple[float, list[Scalar]]]]:
    """The state after a step of 8th order, each row's slopes at the stages, and the events at two stages."""
    stages, within = [[k] for k in slope], []
    for i, weights in enumerate(A[:-1]):
        at = [moved_by(weights, u, h, ks) for u, ks in zip(state, stages, strict=True)]
        if i in _LOOKS:
            within.append((float(weights.sum()), problem.events(at)))
        for ks, k in zip(stages, problem.rate(at), strict=True):
            ks.append(k)
    return [moved_by(B, u, h, ks) for u, ks in zip(state, stages, strict=True)], stages, within


def error_of(
    problem: Extended,
    greatest: Rows,
    rows: tuple[Rows, Rows],
    stages: list[Rows],
    h: Scalar,
    scales: tuple[Scalar, Scalar],
    rtol: Scalar,
) -> Scalar:
    """The largest error of a row, relative to the row's size in this step.

    The size of a derivative's row is at least that of the row which it differentiates. What a row soon changes
    by counts as well: a row that starts as a power of time has the same relative error in any first step.

    Args:
        problem: the equations.
        greatest: the greatest size so far of each row of the motion itself, where the whole state is wanted.
        rows: before and after the step.
        stages: the slopes of each row in the step.
        h: its length.
        scales: the time scale, and that of a row at zero.
        rtol: the tolerance, for the rounding of derivatives.
    """
    before, state = rows
    sizes: list[Scalar] = [np.float64(size) for size in problem.sizes]
    for i, size in enumerate(greatest):
        sizes[i] = jnp.maximum(sizes[i], LEAST * size)
    error = check = 0.0 * h
    # A step far too long may end in a slope that is far greater than all within it, which the estimate knows.
    late = -2 if problem.options.clock else -1
    integrals = range(problem.width - problem.integrals, problem.width)
    of_motion = sizes
    for first in range(0, len(state), problem.width):
        member = range(first, first + problem.width)
        if first and problem.options.clock and problem.layout.problem.typical is None:
            # A number may matter far less than by its own size, and its derivatives are wanted all the same.
            sizes = [jnp.maximum(APART, NOISE / rtol) * size for size in of_motion]
        for i, row in enumerate(member):
            scale = scales[0] if scales[0] is scales[1] else jnp.where(before[row] == 0, scales[1], scales[0])
            moved = jnp.maximum(jnp.abs(h * stages[row][0]), jnp.abs(SOON * scale * stages[row][late]))
            sizes[i] = _size(before[row], state[row], moved, sizes[i])
        # What another step of this length would add to an integral counts as well: most lanes go on.
        for i in integrals:
            sizes[i] = sizes[i] + jnp.abs(h * stages[first + i][late])
        for row, size in zip(member, sizes, strict=True):
            error = jnp.maximum(error, _estimate(tuple(B_ERROR), h, stages[row], size))
        # The estimate of what is wanted is mostly the largest by far. Where it passes through zero by chance
        # it hides an error, but a second estimate is not zero at the same place.
        for i in range(problem.width) if problem.options.whole else integrals:
            check = jnp.maximum(check, _estimate(tuple(B_CHECK), h, stages[first + i], sizes[i]))
        of_motion = of_motion if first else list(sizes)
    return jnp.maximum(error, _CHECK * check * eighth_root(check))


@jax.jit
def _size(before: Scalar, after: Scalar, moved: Scalar, least: Scalar) -> Scalar:
    return jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), jnp.maximum(moved, least))


@functools.partial(jax.jit, static_argnums=0)
def _estimate(weights: tuple[float, ...], h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
    return jnp.abs(h * weighted(weights, slopes)) / size


def stiffness(
    problem: Extended, greatest: Rows, rows: tuple[Rows, Rows], stages: list[Rows], h: Scalar, rtol: Scalar
) -> Scalar:
    """1 where the fastest part of a smooth motion makes a step short, -1 where it does not, 0 where it is not known.

    Two stages are near the step's end. Their slopes differ by an eigenvalue times their difference. How smooth the
    motion is shows in how much its slopes change: a step of a method of 5th order could be about rtol^0.2 over the
    root of that change times as long.

    Args:
        problem: the equations.
        greatest: the greatest size so far of each row of the motion itself.
        rows: before and after the step.
        stages: the slopes of each row in the step.
        h: its length.
        rtol: the tolerance.
    """
    apart = slopes = change = 0.0 * h
    sizes: list[Scalar] = [LEAST * size for size in greatest]
    for i, (before, after, ks) in enumerate(zip(*rows, stages, strict=True)):
        own = i % problem.width
        size = jnp.maximum(jnp.maximum(jnp.abs(before), jnp.abs(after)), sizes[own]) + _TINY
        change = jnp.maximum(change, jnp.abs(h * (ks[-1] - ks[0])) / size)
        if i == own:
            one, other = (moved_by(A[j], before, h, ks[: j + 1]) for j in (-3, -2))
            apart = jnp.maximum(apart, jnp.abs(other - one) / size)
            slopes = jnp.maximum(slopes, jnp.abs(h * (ks[len(A) - 1] - ks[len(A) - 2])) / size)
            sizes[own] = jnp.maximum(APART, NOISE / rtol) * size
    smooth = (_LONGER * _LONGER * change) ** 5 < rtol * rtol
    # Differences of rounding say nothing.
    return jnp.where(apart > _TOLD * rtol, jnp.where(smooth & (slopes > _FAST * apart), 1.0, -1.0), 0.0)


def short_step(problem: Extended, state: Rows, slope: Rows, h: Scalar) -> Rows:
    """The state a short time after: the classical method of fourth order."""

    def after(weight: float, slopes: Rows) -> Rows:
        return [moved_by(np.array([weight]), u, h, [k]) for u, k in zip(state, slopes, strict=True)]

    second = problem.rate(after(1 / 2, slope))
    third = problem.rate(after(1 / 2, second))
    fourth = problem.rate(after(1.0, third))
    weights = np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6])
    return [moved_by(weights, u, h, ks) for u, *ks in zip(state, slope, second, third, fourth, strict=True)]
