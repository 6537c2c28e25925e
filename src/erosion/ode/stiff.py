"""What the integrator does otherwise by the method for stiff motions: the first step, the error, and the end.

An explicit step may be as short as one likes. A step that is to damp what is stiff may not: so the last one begins
where the one before it ended and reaches the event, with the length that Newton's method finds. At the event the rates
of stiff rows are known badly, as an error of the state counts there times an eigenvalue. So nothing is differentiated
along the flow there, but by the length of the last step.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Scalar
from erosion.ode.crossings import Ends
from erosion.ode.extended import Extended
from erosion.ode.reduction import Rows
from erosion.ode.rosenbrock import Rodas, Stages
from erosion.ode.variational import Derivatives, Motion, OfMotion, Variational

_FIRST = 0.1  # of the time in which a number of the state changes by its own size, alone or by its own feedback
_TINY = 1e-200  # keeps 0/0 away
_ROUNDING = 1e-15  # of the terms of a rate
NEAR = 0.1  # of the last step: Newton's method moves its end by less
_SHORTEST = 1e-14  # of the time scale: the last step of a lane that takes none
_POWER = 1.6  # an error of 5th order brought to the 8th, whose root the step control takes


def rodas_of(problem: Extended) -> Rodas:
    """The method of a problem that has it."""
    assert problem.rodas is not None
    return problem.rodas


def first_step(problem: Extended, initial: Rows, slope: Rows) -> Scalar:
    """A length in which little happens."""
    motion = zip(initial[: problem.width], slope, strict=False)
    times = [jnp.where(u == 0, jnp.inf, jnp.abs(u) / (jnp.abs(k) + _TINY)) for u, k in motion]
    own = zip(rodas_of(problem).sparse.places, rodas_of(problem).entries(initial), strict=True)
    times += [1.0 / (jnp.abs(entry) + _TINY) for (i, j), entry in own if i == j]
    return _FIRST * functools.reduce(jnp.minimum, times, jnp.asarray(jnp.inf))


def error_of(
    problem: Extended, least: Rows, apart: Scalar, rows: tuple[Rows, Rows], stages: Stages, h: Scalar, rtol: Scalar
) -> Scalar:
    """The largest error of a row relative to its size, over the tolerance, as the step control wants it.

    A row need not be known better than relative to its greatest size so far, nor than rounding of the terms of its
    rate allows. The size of a derivative's row is at least that of the row which it differentiates.

    Args:
        problem: the equations.
        least: the sizes of the rows of the motion itself below which they need not be known.
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
    floors = zip(problem.sizes, least, rounding, strict=True)
    sizes: list[Scalar] = [jnp.maximum(jnp.maximum(np.float64(a), b), c) for a, b, c in floors]
    error, of_motion = 0.0 * h, sizes
    for first in range(0, len(after), width):
        if first:
            sizes = [apart * size for size in of_motion]
        for i in range(width):
            row = first + i
            sizes[i] = jnp.maximum(jnp.maximum(jnp.abs(before[row]), jnp.abs(after[row])), sizes[i])
            error = jnp.maximum(error, jnp.abs(stages.increments[row][-1]) / sizes[i])
        of_motion = of_motion if first else list(sizes)
    error = jnp.where(stages.sound, error / rtol, jnp.inf)
    return jnp.exp(_POWER * jnp.log(error + 1e-30))


class LastStep(NamedTuple):
    """The end of a lane as a function of the length of its last step.

    Args:
        problem: the equations.
        rows: at the end, with derivatives at a fixed time.
        rates: their derivatives by the step's length.
        curves: the second ones, of the rows of the motion itself.
    """

    problem: Extended
    rows: Rows
    rates: Rows
    curves: Rows

    @property
    def equations(self) -> Variational:
        """Of the lane."""
        return self.problem.equations

    def here(self, function: OfMotion) -> Derivatives:
        """A function of state and motion, with its derivatives at a fixed time."""
        return self.problem.equations.of(function, self.problem.members(self.rows))

    def rate(self, function: OfMotion) -> Derivatives:
        """The same of its time derivative."""

        def of(rows: Rows) -> Derivatives:
            return self.problem.equations.of(function, self.problem.members(rows))

        return jax.jvp(of, (self.rows,), (self.rates,))[1]

    def curve(self, function: OfMotion) -> Scalar:
        """The second time derivative of its value."""
        width, equations = self.problem.width, self.problem.equations
        here: Motion = equations.at(equations.numbers)

        def value(rows: Rows) -> Scalar:
            (at,) = self.problem.members(rows)
            return function(at, here)

        def rate(rows: Rows, rates: Rows) -> Scalar:
            return jax.jvp(value, (rows,), (rates,))[1]

        return jax.jvp(rate, (self.rows[:width], self.rates[:width]), (self.rates[:width], self.curves))[1]

    def amplification(self, event: OfMotion, rate: Scalar, time: Scalar) -> Scalar:
        """By how much more the event's time errs, relative to itself, than the state."""
        width, equations = self.problem.width, self.problem.equations
        here: Motion = equations.at(equations.numbers)
        rows = self.rows[:width]

        def value(rows: Rows) -> Scalar:
            (at,) = self.problem.members(rows)
            return event(at, here)

        error: Scalar = 0.0 * time
        for i, row in enumerate(rows):
            slope = jax.jvp(lambda x, i=i: value([*rows[:i], x, *rows[i + 1 :]]), (row,), (jnp.ones(()),))[1]
            error = error + jnp.abs(slope * row)
        return jnp.maximum(1.0, jnp.where(rate * time == 0, 1.0, error / jnp.abs(rate * time)))


def last_step(problem: Extended, state: Rows, slope: Rows, h: Scalar) -> LastStep:
    """The step of a length, with its derivatives by that."""
    width, one = problem.width, jnp.ones(())

    def rows(h: Scalar) -> Rows:
        return rodas_of(problem).step(state, slope, h)[0]

    def values(h: Scalar) -> Rows:
        return rodas_of(problem).step(state[:width], slope[:width], h)[0]

    at, rates = jax.jvp(rows, (h,), (one,))
    if problem.order < 2:
        return LastStep(problem, at, rates, [0.0 * row for row in at[:width]])
    curves = jax.jvp(lambda h: jax.jvp(values, (h,), (one,))[1], (h,), (one,))[1]
    return LastStep(problem, at, rates, curves)


def events_after(problem: Extended, state: Rows, slope: Rows, h: Scalar) -> list[Ends]:
    """The event functions after a step of a length, and their derivatives by it."""
    width = problem.width

    def events(h: Scalar) -> Sequence[Scalar]:
        return problem.events(rodas_of(problem).step(state[:width], slope[:width], h)[0])

    values, rates = jax.jvp(events, (h,), (jnp.ones(()),))
    return [Ends(*pair) for pair in zip(values, rates, strict=True)]


def length_of(left: Scalar, scale: Scalar) -> Scalar:
    """The length of the last step; a lane that takes none may take its derivatives by a very short one."""
    return jnp.where(left > 0, left, _SHORTEST * scale)
