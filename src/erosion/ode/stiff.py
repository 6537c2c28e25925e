"""What the integrator does otherwise by the method for stiff motions: the first step, the error, and the end.

An explicit step may be as short as one likes. A step that is to damp what is stiff may not: so the last one begins
where the one before it ended and reaches the event, with the length that Newton's method finds. At the event the rates
of stiff rows are known badly, as an error of the state counts there times an eigenvalue. So nothing is differentiated
along the flow there, but by the length of the last step.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Scalar
from erosion.ode.crossings import Ends
from erosion.ode.explicit import LEAST
from erosion.ode.extended import Extended
from erosion.ode.reduction import Rows
from erosion.ode.rosenbrock import Rodas, Stages
from erosion.ode.variational import Along, Derivatives, OfMotion

_FIRST = 0.1  # of the time in which a number of the state changes by its own size, alone or by its own feedback
_SOONEST = 1e-9  # of the time scale: the shortest first step
_TINY, _SMALL = 1e-200, 1e-100  # keep 0/0 away, and a square above 0
_ROUNDING = 1e-15  # of the terms of a rate
NEAR = 0.1  # of the last step: Newton's method moves its end by less
_SHORTEST = 1e-14  # of the time scale: the last step of a lane that takes none
BLURRED = 1e-2  # of itself, at the tightest tolerance: a time that errs by more is not known
_SECOND = 0.1  # of its error counts in a row of second derivatives
_KNOWN = 1e2  # tolerances: what rates may err by, relative to themselves, where time is shifted
_ALONG = 0.5  # of the square of a row of derivatives is along the flow, where time is shifted with it
_POWER = 1.6  # an error of 5th order brought to the 8th, whose root the step control takes


def rodas_of(problem: Extended) -> Rodas:
    """The method of a problem that has it."""
    assert problem.rodas is not None
    return problem.rodas


def first_step(problem: Extended, initial: Rows, slope: Rows, scale: Scalar) -> Scalar:
    """A length in which little happens, but for numbers that are almost zero."""
    motion = zip(initial[: problem.width], slope, strict=False)
    times = [jnp.where(u == 0, jnp.inf, jnp.abs(u) / (jnp.abs(k) + _TINY)) for u, k in motion]
    own = zip(rodas_of(problem).sparse.places, rodas_of(problem).entries(initial), strict=True)
    times += [1.0 / (jnp.abs(entry) + _TINY) for (i, j), entry in own if i == j]
    return jnp.maximum(_FIRST * functools.reduce(jnp.minimum, times, jnp.asarray(jnp.inf)), _SOONEST * scale)


def least_sizes(problem: Extended, greatest: Rows) -> list[Scalar]:
    """Sizes of the rows of the motion itself below which these need not be known: as given, or of their greatest."""
    given = problem.options.sizes is not None
    return [np.float64(least) if given and least > _TINY else jnp.maximum(LEAST * size, _TINY)
            for least, size in zip(problem.sizes, greatest, strict=True)]  # fmt: skip


def error_of(
    problem: Extended, greatest: Rows, apart: Scalar, rows: tuple[Rows, Rows], stages: Stages, h: Scalar, rtol: Scalar
) -> Scalar:
    """The largest error of a row relative to its size, over the tolerance, as the step control wants it.

    A row need not be known better than relative to its greatest size so far, nor than rounding of the terms of its
    rate allows. The size of a derivative's row is at least that of the row which it differentiates.

    Args:
        problem: the equations.
        greatest: the greatest size so far of each row of the motion itself.
        apart: the least size of a derivative's row, of the size of that which it differentiates.
        rows: before and after the step.
        stages: of the step.
        h: its length.
        rtol: the tolerance.
    """
    before, after = rows
    width, places = problem.width, rodas_of(problem).sparse.places
    terms: list[Scalar] = [0.0 * h for _ in range(width)]
    damped = [h for _ in range(width)]
    for (i, j), entry in zip(places, stages.entries, strict=True):
        terms[i] = terms[i] + jnp.abs(entry * after[j])
        if i == j:
            damped[i] = 1.0 / (1.0 / h + jnp.abs(entry))
    rounding = [_ROUNDING / rtol * term * time for term, time in zip(terms, damped, strict=True)]
    sizes: list[Scalar] = list(map(jnp.maximum, least_sizes(problem, greatest), rounding))
    error, of_motion = 0.0 * h, sizes
    for first in range(0, len(after), width):
        if first:
            sizes = [apart * size for size in of_motion]
        for i in range(width):
            row = first + i
            sizes[i] = jnp.maximum(jnp.maximum(jnp.abs(before[row]), jnp.abs(after[row])), sizes[i])
            weight = _SECOND if problem.order == 2 and first == len(after) - width else 1.0
            error = jnp.maximum(error, weight * jnp.abs(stages.increments[row][-1]) / sizes[i])
        of_motion = of_motion if first else list(sizes)
    error = jnp.where(stages.sound, error / rtol, jnp.inf)
    return jnp.exp(_POWER * jnp.log(error + 1e-30))


def no_shift(problem: Extended) -> Rows:
    """The derivatives of the time by which a motion has been shifted so far, where it is: at none."""
    members = len(problem.initial) // problem.width
    return [0.0 * problem.time_scale] * (members - 1) if problem.rodas is not None and problem.order == 2 else []


def shifted(
    problem: Extended, greatest: Rows, state: Rows, slope: Rows, shift: Rows, stages: Stages, rtol: Scalar
) -> tuple[Rows, Rows, Rows]:
    """State, slope and shift, with derivatives at a time that is shifted with the parameters.

    Where a motion is fast its derivatives at a fixed time are huge, and those at its event the small difference of
    huge numbers. So the time at which they are taken follows the parameters, τ, such that they have no part along the
    flow f: s + f τ, and for second ones f τ″ and the chain rule. What f errs by, J times the error of the state, is
    great where the motion is stiff; there nothing is shifted.
    """
    width = problem.width
    count = width - problem.integrals
    sizes = map(jnp.maximum, least_sizes(problem, greatest)[:count], map(jnp.abs, state))
    weights = [1.0 / jnp.maximum(size, _SMALL) ** 2 for size in sizes]
    f = slope[:width]

    def product(one: Sequence[Scalar], other: Sequence[Scalar]) -> Scalar:
        return sum(w * a * b for w, a, b in zip(weights, one, other, strict=False))

    last = [row[-1] for row in stages.increments[:width]]
    unknown = rodas_of(problem).sparse.add_product(stages.entries, last, [0.0 * u for u in last])
    norm = product(f, f)
    known = (product(unknown, unknown) < (_KNOWN * rtol) ** 2 * norm) & (norm > 0)

    def without(row: Rows) -> Scalar:
        part = product(f, row)
        return jnp.where(known & (part * part > _ALONG * norm * product(row, row)), -part / norm, 0.0)

    parts = [state[i : i + width] for i in range(0, len(state), width)]
    rates = [slope[i : i + width] for i in range(0, len(state), width)]
    first = [without(part) for part in parts[1:-1]]
    ends = first[0], first[-1]
    curve = jax.jvp(problem.motion_rate, (parts[0],), (f,))[1]
    mixed = [
        second + by_one * ends[1] + by_other * ends[0] + bend * ends[0] * ends[1]
        for second, by_one, by_other, bend in zip(parts[-1], rates[1], rates[-2], curve, strict=True)
    ]
    by = [*first, without(mixed)]
    moved = [*parts[1:-1], mixed]
    rows = parts[0] + [u + k * tau for part, tau in zip(moved, by, strict=True) for u, k in zip(part, f, strict=True)]
    return rows, problem.rate(rows), [old + new for old, new in zip(shift, by, strict=True)]


class LastStep(Along):
    """The end of a lane as a function of the length of its last step.

    Args:
        problem: the equations.
        rows: at the end, with derivatives at a fixed time.
        rates: their derivatives by the step's length.
        curves: the second ones, of the rows of the motion itself.
        greatest: the greatest size so far of each of these rows.
    """

    def __init__(self, problem: Extended, rows: Rows, rates: Rows, curves: Rows, greatest: Rows) -> None:
        super().__init__(problem.equations)
        self.problem, self.rows, self.rates, self.curves, self.greatest = problem, rows, rates, curves, greatest

    @property
    def events(self) -> list[Ends]:
        """The event functions, and their derivatives by the step's length."""
        width = self.problem.width
        values, rates = jax.jvp(self.problem.events, (self.rows[:width],), (self.rates[:width],))
        return [Ends(*pair) for pair in zip(values, rates, strict=True)]

    def here(self, function: OfMotion) -> Derivatives:
        """See `Along`."""
        return self.equations.of(function, self.problem.members(self.rows))

    def rate(self, function: OfMotion) -> Derivatives:
        """See `Along`."""

        def of(rows: Rows) -> Derivatives:
            return self.equations.of(function, self.problem.members(rows))

        return jax.jvp(of, (self.rows,), (self.rates,))[1]

    def curve(self, function: OfMotion) -> Scalar:
        """See `Along`."""
        width, here = self.problem.width, self.equations.at(self.equations.numbers)

        def value(rows: Rows) -> Scalar:
            (at,) = self.problem.members(rows)
            return function(at, here)

        def rate(rows: Rows, rates: Rows) -> Scalar:
            return jax.jvp(value, (rows,), (rates,))[1]

        return jax.jvp(rate, (self.rows[:width], self.rates[:width]), (self.rates[:width], self.curves))[1]

    def amplification(self, event: OfMotion, rate: Scalar, time: Scalar) -> Scalar:
        """By how much more the event's time errs, relative to itself, than the state."""
        width, here = self.problem.width, self.equations.at(self.equations.numbers)
        rows, least = self.rows[:width], least_sizes(self.problem, self.greatest)

        def value(rows: Rows) -> Scalar:
            (at,) = self.problem.members(rows)
            return event(at, here)

        error: Scalar = 0.0 * time
        for i, row in enumerate(rows):
            slope = jax.jvp(lambda x, i=i: value([*rows[:i], x, *rows[i + 1 :]]), (row,), (jnp.ones(()),))[1]
            error = error + jnp.abs(slope) * jnp.maximum(jnp.abs(row), least[i])
        return jnp.maximum(1.0, jnp.where(rate * time == 0, 1.0, error / jnp.abs(rate * time)))


def last_step(problem: Extended, state: Rows, slope: Rows, greatest: Rows, h: Scalar) -> LastStep:
    """The step of a length, with its derivatives by that."""
    width, one = problem.width, jnp.ones(())

    def rows(h: Scalar) -> Rows:
        return rodas_of(problem).step(state, slope, h)[0]

    def values(h: Scalar) -> Rows:
        return rodas_of(problem).step(state[:width], slope[:width], h)[0]

    at, rates = jax.jvp(rows, (h,), (one,))
    if problem.order < 2:
        return LastStep(problem, at, rates, [0.0 * row for row in at[:width]], greatest)
    curves = jax.jvp(lambda h: jax.jvp(values, (h,), (one,))[1], (h,), (one,))[1]
    return LastStep(problem, at, rates, curves, greatest)


def step_of(problem: Extended, state: Rows, slope: Rows, greatest: Rows, passed: Scalar) -> LastStep:
    """The state a time after a step began, 0 or later."""
    passed = jnp.where(passed > _SMALL * problem.time_scale, passed, 0.0)
    step = last_step(problem, state, slope, greatest, length_of(passed, problem.time_scale))
    rows: Rows = [jnp.where(passed > 0, new, old) for new, old in zip(step.rows, state, strict=True)]
    return LastStep(problem, rows, step.rates, step.curves, greatest)


def length_of(left: Scalar, scale: Scalar) -> Scalar:
    """The length of the last step; a lane that takes none may take its derivatives by a very short one."""
    return jnp.where(left > 0, left, _SHORTEST * scale)
