"""Steps of Rosenbrock methods for stiff motions, for a lane's rows with their derivatives.

A step of length h solves a linear system W u = r for each stage, with one matrix W = 1/(hγ) - J, J the Jacobian of the
rates. Rows of derivatives have the same J on their diagonal, so one LU serves them all; what couples them to the rows
before is J's own derivatives along the directions. Where the equations depend on time, time is one of the rows, and
∂f/∂t a column of J.

J is sparse: which entries may differ from zero is read from the arithmetic of the rates. The LU is written out for
them, in Markowitz's order, without pivoting. A pivot that has cancelled makes the step fail, and a shorter one follows:
its 1/(hγ) is greater.
"""

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.methods.sums import moved_by, total_by
from erosion.ode.motion import Augmented, Motion
from erosion.ode.reduction import FlatState
from erosion.ode.variational import Direction

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations

_LOOKS = (0.25, 0.75)  # of a step: where the events are asked for
_MORE_LOOKS = (0.25, 0.56, 0.75)  # the same where they may move faster than the state
_CANCELLED = 1e-13  # of its terms: a pivot this small has no digits


class RosenbrockTableau(NamedTuple):
    """Weights of a Rosenbrock method, in the form for u = γ k h.

    Args:
        gamma: γ.
        a: of the increments so far in the state of each stage after the first.
        c: of the same, over h, in the right side of each of these stages.
        b: of the increments in the step.
        error: and in its difference from the embedded solution.
        interior: and in the polynomial within a step, beside the line between its ends: of each power.
        order: of the difference, as a power of h.
    """

    gamma: float
    a: tuple[tuple[float, ...], ...]
    c: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    error: tuple[float, ...]
    interior: tuple[tuple[float, ...], ...]
    order: float


class Factors(NamedTuple):
    """An LU: its entries that are not zero by structure, row by row in the order of elimination.

    Args:
        entries: of both factors; the diagonal is that of U.
        inverse: of the diagonal.
        sound: whether no pivot has cancelled.
    """

    entries: list[Scalar]
    inverse: list[Scalar]
    sound: Flag


class Sparse:
    """LU of d - J for a fixed pattern of J.

    Args:
        pattern: which entries may differ from zero, shape (n, n).
    """

    def __init__(self, pattern: np.ndarray) -> None:
        self.order = least_fill(pattern)
        self.places = [(int(i), int(j)) for j, i in np.argwhere(pattern.T)]
        filled = (pattern | np.eye(len(pattern), dtype=bool))[np.ix_(self.order, self.order)]
        for k in range(len(pattern)):
            filled[k + 1 :, k + 1 :] |= np.outer(filled[k + 1 :, k], filled[k, k + 1 :])
        self._filled = filled
        self._at = {(int(i), int(j)): place for place, (i, j) in enumerate(np.argwhere(filled))}
        self._row = [[int(j) for j in np.flatnonzero(row)] for row in filled]

    @property
    def size(self) -> int:
        """How many operations the LU and one solution take, about."""
        below, right = np.tril(self._filled, -1).sum(0), np.triu(self._filled, 1).sum(1)
        return int(2 * (below * right).sum() + 2 * len(self._at))

    def factors(self, entries: Sequence[Scalar], d: Scalar) -> Factors:
        """The LU of d - J, from the entries of J in the order of `places`."""
        known = dict(zip(self.places, entries, strict=True))
        count, rows, inverse, sound = len(self.order), [], [], jnp.asarray(True)
        for k, i in enumerate(self.order):
            row: dict[int, Scalar] = {}
            for column in self._row[k]:
                j = self.order[column]
                if (i, j) in known:
                    row[column] = -known[i, j]
                if i == j:
                    row[column] = d + row[column] if column in row else d
            size = d + jnp.abs(known[i, i]) if (i, i) in known else d
            for pivot in [column for column in self._row[k] if column < k]:
                factor = row[pivot] = row[pivot] * inverse[pivot]
                for column, value in rows[pivot].items():
                    if column > pivot:
                        change = factor * value
                        row[column] = row[column] - change if column in row else -change
                        size = size + jnp.abs(change) if column == k else size
            sound = sound & (jnp.abs(row[k]) > _CANCELLED * size)
            inverse.append(1.0 / row[k])
            rows.append(row)
        return Factors([rows[i][j] for i in range(count) for j in self._row[i]], inverse, sound)

    def solve(self, factors: Factors, right: Sequence[Scalar]) -> list[Scalar]:
        """X of (d - J) x = right."""
        x = [right[i] for i in self.order]
        for i, columns in enumerate(self._row):
            for j in columns:
                if j < i:
                    x[i] = x[i] - factors.entries[self._at[i, j]] * x[j]
        for i in reversed(range(len(x))):
            for j in self._row[i]:
                if j > i:
                    x[i] = x[i] - factors.entries[self._at[i, j]] * x[j]
            x[i] = x[i] * factors.inverse[i]
        place = {i: k for k, i in enumerate(self.order)}
        return [x[place[i]] for i in range(len(x))]

    def solve_transposed(self, factors: Factors, right: Sequence[Scalar]) -> list[Scalar]:
        """X of (d - J)ᵀ x = right."""
        x = [right[i] for i in self.order]
        for j, columns in enumerate(self._row):
            x[j] = x[j] * factors.inverse[j]
            for i in columns:
                if i > j:
                    x[i] = x[i] - factors.entries[self._at[j, i]] * x[j]
        for j in reversed(range(len(x))):
            for i in self._row[j]:
                if i < j:
                    x[i] = x[i] - factors.entries[self._at[j, i]] * x[j]
        place = {i: k for k, i in enumerate(self.order)}
        return [x[place[i]] for i in range(len(x))]

    def add_product(self, entries: Sequence[Scalar], u: Sequence[Scalar], to: Sequence[Scalar]) -> list[Scalar]:
        """To + J u."""
        total = list(to)
        for (i, j), entry in zip(self.places, entries, strict=True):
            total[i] = total[i] + entry * u[j]
        return total


def least_fill(pattern: np.ndarray) -> list[int]:
    """Markowitz's order of the diagonal: each pivot makes as few new entries as can be."""
    filled = pattern | np.eye(len(pattern), dtype=bool)
    left, order = list(range(len(pattern))), []
    while left:
        best = min(left, key=lambda k: (filled[left, k].sum() - 1) * (filled[k, left].sum() - 1))
        left.remove(best)
        order.append(best)
        for i in left:
            if filled[i, best]:
                filled[i] |= filled[best]
    return order


def columns_together(pattern: np.ndarray) -> list[list[int]]:
    """The columns that are not zero in groups: no two of a group have an entry in one row, so one tangent finds all."""
    groups: list[tuple[list[int], np.ndarray]] = []
    for j in map(int, np.flatnonzero(pattern.any(0))):
        for members, rows in groups:
            if not (rows & pattern[:, j]).any():
                members.append(j)
                rows |= pattern[:, j]
                break
        else:
            groups.append(([j], pattern[:, j].copy()))
    return [members for members, _ in groups]


class Stages(NamedTuple):
    """What a step has computed on its way.

    Args:
        increments: of each row, one for each stage.
        rates: of each row, at the states of the stages.
        entries: of the Jacobian.
        sound: whether its LU is.
    """

    increments: list[FlatState]
    rates: list[FlatState]
    entries: list[Scalar]
    sound: Flag


class RosenbrockSteps:
    """Steps of a lane's rows.

    Args:
        problem: the equations.
        tableau: of the method.
    """

    def __init__(self, problem: "LaneEquations", tableau: RosenbrockTableau) -> None:
        self.problem, self.tableau, self.width = problem, tableau, problem.width
        self.sparse = Sparse(problem.pattern)
        groups, sparse, width = columns_together(problem.pattern), self.sparse, self.width
        equations_at = problem.equations_at

        def entries(at: Augmented, motion: Motion) -> list[Scalar]:
            """The Jacobian's entries, in the order of `places`."""
            leaves, structure = jax.tree.flatten(at)
            known: dict[tuple[int, int], Scalar] = {}
            for group in groups:

                def moved(tangents: list[Scalar], group: list[int] = group) -> Any:
                    rows = list(leaves)
                    for j, tangent in zip(group, tangents, strict=True):
                        rows[j] = tangent
                    return jax.tree.leaves(motion.rate(jax.tree.unflatten(structure, rows)))

                ones = [jnp.ones(())] * len(group)
                column = jax.jvp(moved, ([leaves[j] for j in group],), (ones,))[1]
                known |= {(int(i), j): column[i] for j in group for i in np.flatnonzero(problem.pattern[:, j])}
            return [known[place] for place in sparse.places]

        # Each is traced once for all the places where it is called.
        @functools.partial(jax.jit, static_argnums=3)
        def jacobians(
            parameters: Sequence[Number], places: tuple[Direction, ...], rows: FlatState, whole: bool
        ) -> list[list[Scalar]]:
            """The entries, and where the step is of the `whole` rows, their tangents."""
            equations, value_and_tangents = equations_at(parameters, places), problem.value_and_tangents(rows)
            if not whole:
                return [entries(value_and_tangents[0], equations.at(parameters))]
            return list(equations.pack(equations.of(entries, value_and_tangents)))

        @jax.jit
        def stage(js: list[list[Scalar]], factors: Factors, d: Scalar, rate: FlatState) -> FlatState:
            return _solved(sparse, width, js, factors, d, rate)

        self._jacobians = jacobians
        self.factors, self._stage = jax.jit(sparse.factors), stage

    def entries(self, rows: FlatState, parameters: Sequence[Number] | None = None) -> list[Scalar]:
        """The entries of the Jacobian of the motion itself, with the lane's numbers or others."""
        problem = self.problem
        given = problem.parameters if parameters is None else parameters
        return self._jacobians(given, problem.places, rows[: self.width], False)[0]

    def step(self, rows: FlatState, slope: FlatState, h: Scalar) -> tuple[FlatState, Stages]:
        """The rows after a step; `rows` are those of the motion itself, or all."""
        whole = len(rows) > self.width
        inverse = 1.0 / h
        d = inverse * (1 / self.tableau.gamma)
        js = self._jacobians(self.problem.parameters, self.problem.places, rows, whole)
        factors = self.factors(js[0], lax.stop_gradient(d))
        rates: list[list[Scalar]] = [[k] for k in slope]
        increments: list[list[Scalar]] = [[u] for u in self._stage(js, factors, d, slope)]
        for a, c in zip(self.tableau.a, self.tableau.c, strict=True):
            at = [moved_by(a, y, 1.0, us) for y, us in zip(rows, increments, strict=True)]
            rate = self.problem.rate(at) if whole else self.problem.motion_rate(at)
            for ks, k in zip(rates, rate, strict=True):
                ks.append(k)
            right = [moved_by(c, k, inverse, us) for k, us in zip(rate, increments, strict=True)]
            for us, u in zip(increments, self._stage(js, factors, d, right), strict=True):
                us.append(u)
        after = [moved_by(self.tableau.b, y, 1.0, us) for y, us in zip(rows, increments, strict=True)]
        return after, Stages(increments, rates, js[0], factors.sound)

    def interior_samples(self, before: FlatState, after: FlatState, stages: Stages) -> list[tuple[float, list[Scalar]]]:
        """The events at two places within a step."""
        found: list[tuple[float, list[Scalar]]] = []
        for theta in _LOOKS if self.problem.event_set.are_slow else _MORE_LOOKS:
            rest = 1.0 - theta
            rows = []
            for y0, y1, us in zip(before[: self.width], after, stages.increments, strict=False):
                *powers, highest = [total_by(row)(us) for row in self.tableau.interior]
                bend = functools.reduce(lambda above, k: k + theta * above, reversed(powers), highest)
                rows.append(rest * y0 + theta * (y1 + rest * bend))
            found.append((theta, self.problem.events(rows)))
        return found


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _solved(
    sparse: Sparse, width: int, js: list[list[Scalar]], factors: Factors, d: Scalar, rate: FlatState
) -> FlatState:
    """U of W u = rate, part by part.

    It may be differentiated by the step's length: W depends on it by its diagonal d alone, and J does not.
    """
    parts = [rate[first : first + width] for first in range(0, len(rate), width)]
    u = [sparse.solve(factors, parts[0])]
    if len(parts) > 1:
        u.append(sparse.solve(factors, sparse.add_product(js[1], u[0], parts[1])))
    return [each for part in u for each in part]


@_solved.defjvp
def _solved_jvp(
    sparse: Sparse, width: int, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[FlatState, FlatState]:
    (js, factors, d, rate), (*_, by_d, by_rate) = primals, tangents
    u = _solved(sparse, width, js, factors, d, rate)
    right = [moved - by_d * each for moved, each in zip(by_rate, u, strict=True)]
    return u, _solved(sparse, width, js, factors, d, right)
