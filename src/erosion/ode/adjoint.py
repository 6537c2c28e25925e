"""The derivatives of one number by all arguments of a lane: its steps are gone through backwards.

A lane that was integrated forwards has left its steps on a tape. What a number L at the lane's end changes by, where
the state s there changes, are the cotangents s̄; a step back turns them into those of the state before it, and adds
what L changes by with the arguments on the way. A step of the Runge-Kutta method is

    Y_i = y + h Σ a_ij k_j,   k_i = f(Y_i),   y' = y + h Σ b_i k_i,

and its transpose, for the cotangents λ of y',

    k̄_i = h (b_i λ + Σ a_ji Ȳ_j),   Ȳ_i = f_y(Y_i)ᵀ k̄_i,   ȳ = λ + Σ Ȳ_i,   p̄ = Σ f_p(Y_i)ᵀ k̄_i.

A step of the Rosenbrock method, of which `rosenbrock` has the coefficients, solves W u_i = r_i with W = d - J(y),

    r_i = f(Y_i) + Σ c_ij u_j / h,   Y_i = y + Σ a_ij u_j,   y' = y + Σ b_i u_i,

and its transpose solves Wᵀ w_i = ū_i, which is r̄_i: Ȳ_i = f_y(Y_i)ᵀ w_i, and ū_j gains a_ij Ȳ_i + c_ij w_i / h. The
cotangents of the entries of J are those of Σ w_i u_iᵀ.

The steps are those that the value needs. Where it rests, or hardly depends on what is fast, they may be far too long
for the cotangents. The Ȳ of the second stage tells by how much these err: the stage's weight b is zero, and of its
Ȳ only products of seven Jacobians are left, h⁷, where λ errs by h⁹. Of a Rosenbrock step the embedded solution tells,
transposed as well. Derivatives of a lane in which the error is too great are NaN.

A state at a time within a step is that of a shorter step from the same start, so its cotangents go back through that.

At an event g = 0 the time is a function of state and arguments, dt = -dg/ġ: with F the rates there, and t̄ the
cotangent of the time, s̄ gains -(t̄ + s̄·F)/ġ g_s, and p̄ the same times g_p. Of a stiff motion F is what the state
changes by with the length of the last step; see `stiff`. A reset is transposed as it is.

References:
    J. M. Sanz-Serna, SIAM Review 58 (2016) 3-33, for the transpose of a Runge-Kutta method.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Number, Scalar
from erosion.lanes import tapes
from erosion.ode import rosenbrock, stiff, tape
from erosion.ode.extended import Extended
from erosion.ode.integrator import resets
from erosion.ode.reduction import Rows, motion_of
from erosion.ode.step_control import ARRIVED, A, B, weighted
from erosion.ode.variational import Layout

_STAGES = len(A)  # that at a step's end is not one of them
# A cotangent is not known that errs by so many tolerances of the greatest that it had, which counts as so much of the
# greatest effect of a row by its own size, at least. A power brings an estimate of 7th order to the 9th. That for stiff
# motions, of 4th order, is far greater than the error, and counts effects alone.
_LOST, _LEAST, _POWER = 1e3, 1e-6, 9 / 7
_LOST_STIFF, _LOST_AT_MOST, _LEAST_STIFF = 1e6, 0.01, 1.0
_TINY = 1e-200  # keeps 0/0 away


STEPS, TIMES, BARS = 0, 1, 2
"""Tapes: steps; times, rising, which all lanes share; for each time the cotangents of a lane's outputs there."""


class _Back(NamedTuple):
    """On the way back.

    Args:
        row: of the tape, the next one.
        state: cotangents of the state there.
        time: the cotangent of the time so far.
        sums: cotangents of the numbers.
        greatest: the greatest size so far of each row's cotangent.
        error: the greatest relative error of a cotangent in a step.
        until: when the next step on the way ends, since the start of a lane of one motion.
        due: how many times are left.
        there: cotangents of the state where that step begins, of those at times within it.
    """

    row: Scalar
    state: Rows
    time: Scalar
    sums: list[Number]
    greatest: Rows
    error: Scalar
    until: Scalar
    due: Scalar
    there: Rows


def pulled_back(
    layout: Layout,
    numbers: Sequence[Number],
    rtol: Scalar,
    count: Scalar,
    bars: Sequence[Scalar],
    token: Scalar,
    due: Scalar | None = None,
) -> list[Number]:
    """The derivatives of a number by the lane's real numbers, shapes as of these.

    Args:
        layout: of the lane.
        numbers: of the lane.
        rtol: with which it was integrated.
        count: rows of its tape.
        bars: by what the number changes with the lane's time, and with each of its outputs.
        token: see `erosion.lanes.tapes`.
        due: how many times the lane, which has no resets, reaches, whose states count as well; None where none do.
    """
    adjoint = _Adjoint(layout, numbers, token, timed=due is not None)
    gradient, error = adjoint.pulled_back(count, bars[0], list(bars[1:]), due)
    is_stiff = adjoint.problem.rodas is not None
    most = jnp.minimum(_LOST_STIFF * rtol, _LOST_AT_MOST) if is_stiff else (_LOST * rtol) ** (1 / _POWER)
    return [jnp.where(error <= most, each, jnp.nan) for each in gradient]


class _Step(NamedTuple):
    """A step that is gone back through.

    Args:
        end: the state there; nothing of a stiff motion.
        slope: the rates where it began.
        back: from cotangents at its end those at its start, what those of the numbers gain, and errors of the former.
    """

    end: Rows
    slope: Rows
    back: Callable[[Rows], tuple[Rows, list[Number], Rows]]


class _Adjoint:
    def __init__(self, layout: Layout, numbers: Sequence[Number], token: Scalar, *, timed: bool) -> None:
        self.problem = Extended(layout, numbers, 0, ())
        self.token, self.width, self.timed, self.outputs = token, self.problem.width, timed, layout.rows - 1
        self.is_real = [dtype == "float64" for dtype in layout.dtypes]
        self.all = list(numbers)
        self.numbers = [number for number, real in zip(numbers, self.is_real, strict=True) if real]
        self.motion = motion_of(layout)

        def rate(numbers: list[Number], rows: Rows) -> Rows:
            return jax.tree.leaves(self._at(numbers).rate(self._member(rows)))

        # Each is traced once for all the places where it is called.
        self._rate = jax.jit(rate)
        if self.problem.rodas is not None:
            rodas = self.problem.rodas
            self._entries = jax.jit(lambda numbers, rows: rodas.entries(rows, self._with_whole(numbers)))
            self._solve, self._solve_transposed = jax.jit(rodas.sparse.solve), jax.jit(rodas.sparse.solve_transposed)

    def _at(self, numbers: list[Number]) -> Any:
        return self.motion(self._with_whole(numbers))

    def _with_whole(self, numbers: list[Number]) -> list[Number]:
        """All numbers of the lane, from the real ones."""
        rest = iter(numbers)
        return [next(rest) if real else one for one, real in zip(self.all, self.is_real, strict=True)]

    def _member(self, rows: Rows) -> Any:
        (member,) = self.problem.members(rows)
        return member

    def pulled_back(
        self, count: Scalar, time: Scalar, outputs: Rows, due: Scalar | None
    ) -> tuple[list[Number], Scalar]:
        """The derivatives, and their error."""
        last = lax.convert_element_type(count, int) - 1
        at_end = tape.read(self.token, last, self.width)
        sums, state = self._from_outputs(at_end.state, outputs)
        until, left = 0.0 * time, lax.convert_element_type(0.0 * time if due is None else due, int)
        if self.timed:
            until = self._end(last)
        greatest: Rows = [jnp.abs(bar) for bar in state]
        back = _Back(last, state, time, sums, greatest, 0.0 * time, until, left, _zeros(state))
        if self.problem.chains:
            back = lax.while_loop(
                lambda back: back.row >= 0, lambda back: self._steps(self._event(back, is_last=back.row == last)), back
            )
        else:
            back = self._steps(self._event(back, is_last=jnp.asarray(True)))
        _, pull = jax.vjp(lambda numbers: jax.tree.leaves(self._start(numbers)), self.numbers)
        # A time before the first step, which a lane that ends at its start has not.
        error = jnp.where(back.due > 0, jnp.inf, back.error)
        return _plus(back.sums, pull(back.state)[0]), error

    def _from_outputs(self, rows: Rows, bars: Rows) -> tuple[list[Number], Rows]:
        """Cotangents of the numbers and of the state, from those of the outputs there."""
        _, pull = jax.vjp(lambda numbers, rows: self._at(numbers).outputs(self._member(rows)), self.numbers, rows)
        return pull(bars)

    def _end(self, last: Scalar) -> Scalar:
        """When the lane ends, since its start."""

        def longer(at: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            row, time = at
            entry = tape.read(self.token, row, self.width)
            return row + 1, time + jnp.where(entry.code == tape.STEP, entry.length, 0.0)

        return lax.while_loop(lambda at: at[0] < last, longer, (0 * last, jnp.zeros(())))[1]

    def _start(self, numbers: list[Number]) -> Any:
        state, integrals = self._at(numbers).initial()
        return state, [jnp.asarray(begin, float) for begin in integrals]

    def _event(self, back: _Back, *, is_last: Scalar) -> _Back:
        """Before the event of a motion, from after it."""
        # Lanes that are done go on beside others, and read the first row.
        digits, event, rows = tape.read(self.token, jnp.maximum(back.row, 0), self.width)
        state, sums = back.state, back.sums
        if self.problem.chains:
            happens = [jnp.floor(digits / 2.0**i) % 2 == 1 for i in range(len(self.problem.directions))]

            def both(numbers: list[Number], rows: Rows) -> tuple[Rows, Rows]:
                met, after = resets(happens, self._member(rows), self._at(numbers))
                return jax.tree.leaves(met), jax.tree.leaves(after)

            _, pull = jax.vjp(both, self.numbers, rows)
            met = [jnp.where(is_last, bar, 0.0) for bar in state]
            grads, state = pull((met, [jnp.where(is_last, 0.0, bar) for bar in state]))
            sums = _plus(sums, grads)
        flow = self._flow(back.row, rows)
        total = back.time + _dot(state, flow)

        def events(numbers: list[Number], rows: Rows) -> list[Scalar]:
            return self._at(numbers).events(self._member(rows))

        _, falls = jax.jvp(lambda rows: events(self.numbers, rows), (rows,), (flow,))
        _, pull = jax.vjp(events, self.numbers, rows)
        grads, more = pull([jnp.where(event == i, -total / fall, 0.0) for i, fall in enumerate(falls)])
        sums, state = _plus(sums, grads), _plus(state, more)
        time = back.time
        if self.problem.options.clock:
            # A lane without an event ends at a given time, and what came before took of it.
            of_clock = jnp.where(event == ARRIVED, total, 0.0)
            _, pull = jax.vjp(lambda numbers: self._at(numbers).clock.t1 - self._at(numbers).clock.t0, self.numbers)
            sums, time = _plus(sums, pull(of_clock)[0]), time - of_clock
        greatest: Rows = list(map(jnp.maximum, back.greatest, map(jnp.abs, state)))
        return back._replace(row=back.row - 1, state=state, time=time, sums=sums, greatest=greatest)

    def _flow(self, event: Scalar, rows: Rows) -> Rows:
        """What the state at an event changes by with its time."""
        if self.problem.rodas is None:
            return self._rate(self.numbers, rows)
        last = tape.read(self.token, jnp.maximum(event - 1, 0), self.width)
        h = stiff.length_of(last.length, self.problem.time_scale)
        return stiff.last_step(self.problem, last.state, self._rate(self.numbers, last.state), [], h).rates

    def _steps(self, back: _Back) -> _Back:
        """Where a motion began, from its event."""
        one = self._step if self.problem.rodas is None else self._stiff_step

        def step(at: tuple[_Back, tape.Entry]) -> tuple[_Back, tape.Entry]:
            back, row = at
            after = self._at_time(back, row) if self.timed else self._before(back, row, one(row))
            return after, tape.read(self.token, jnp.maximum(after.row, 0), self.width)

        def goes_on(at: tuple[_Back, tape.Entry]) -> Scalar:
            back, row = at
            return (back.row >= 0) & (row.code == tape.STEP)

        return lax.while_loop(goes_on, step, (back, tape.read(self.token, jnp.maximum(back.row, 0), self.width)))[0]

    def _before(self, back: _Back, row: tape.Entry, step: _Step) -> _Back:
        """Where a step began, from its end."""
        state, gained, errors = step.back(back.state)
        if self.timed:
            state = _plus(state, back.there)
        greatest: Rows = list(map(jnp.maximum, back.greatest, map(jnp.abs, state)))
        moved = [jnp.abs(row.length * k) for k in step.slope]
        sizes = list(map(jnp.maximum, map(jnp.abs, row.state), moved))
        most = functools.reduce(jnp.maximum, [bar * size for bar, size in zip(greatest, sizes, strict=True)])
        error, share = back.error, _LEAST if self.problem.rodas is None else _LEAST_STIFF
        for e, bar, size in zip(errors, greatest, sizes, strict=True):
            least = jnp.where(size > 0, share * most / (size + _TINY), 0.0)
            error = jnp.maximum(error, jnp.abs(e) / (jnp.maximum(bar, least) + _TINY))
        return back._replace(
            row=back.row - 1, state=state, sums=_plus(back.sums, gained), greatest=greatest, error=error,
            until=back.until - row.length, there=_zeros(back.there),
        )  # fmt: skip

    def _at_time(self, back: _Back, row: tape.Entry) -> _Back:
        """The same, or the cotangents there of the last time within the step, if one is left.

        Both take a step from the same start, which is written once.
        """
        place = jnp.maximum(back.due - 1, 0)
        time = tapes.read(TIMES, np.zeros(()), place) - self.problem.clock.t0
        passed = time - (back.until - row.length)
        within = (back.due > 0) & ((passed > 0) | (back.row == 0))
        step = self._step(row._replace(length=jnp.where(within, jnp.clip(passed, 0.0, row.length), row.length)))
        count = self.outputs
        bars = [tapes.read(BARS, self.token, place * count + i) for i in range(count)]
        of_outputs, there = self._from_outputs(step.end, bars)
        of_time = _dot(there, self._rate(self.numbers, step.end))
        _, pull = jax.vjp(lambda numbers: self._at(numbers).clock.t0, self.numbers)
        state = [jnp.where(within, bar, other) for bar, other in zip(there, back.state, strict=True)]
        before = self._before(
            back._replace(state=state, there=[jnp.where(within, 0.0, bar) for bar in back.there]), row, step
        )
        # At a given time it is later since the start, where that is earlier.
        at_time = back._replace(
            sums=_plus(before.sums, _plus(of_outputs, pull(-of_time)[0])),
            due=back.due - 1, there=_plus(back.there, before.state), error=before.error,
        )  # fmt: skip
        return jax.tree.map(functools.partial(jnp.where, within), at_time, before)

    def _step(self, row: tape.Entry) -> _Step:
        h, slopes, pulls = row.length, [[] for _ in row.state], []
        for i in range(_STAGES):
            rows = [u + h * weighted(A[i - 1], ks) if i else u for u, ks in zip(row.state, slopes, strict=True)]
            rates, pull = jax.vjp(self._rate, self.numbers, rows)
            pulls.append(pull)
            for ks, k in zip(slopes, rates, strict=True):
                ks.append(k)

        def back(after: Rows) -> tuple[Rows, list[Number], Rows]:
            total, gained, (_, of_states) = self._transposed(
                B, A, after, pulls, lambda _, bars, __: [h * bar for bar in bars]
            )
            # Of the second stage's cotangents nothing but terms of 7th order is left.
            return _plus(after, total), gained, of_states[1]

        end: Rows = [u + h * weighted(B, ks) for u, ks in zip(row.state, slopes, strict=True)]
        return _Step(end, [ks[0] for ks in slopes], back)

    def _transposed(
        self,
        b: Sequence[float] | np.ndarray,
        a: Sequence[Sequence[float] | np.ndarray],
        after: Rows,
        pulls: Sequence[Callable[[Rows], tuple[list[Number], Rows]]],
        of_right: Callable[[int, Rows, dict[int, Rows]], Rows],
    ) -> tuple[Rows, list[Number], tuple[dict[int, Rows], dict[int, Rows]]]:
        """The cotangents of the start of a step and of the numbers, but for those of its end; and those of the stages.

        Args:
            b: weights of the stages in the step.
            a: and in the state of each stage after the first.
            after: cotangents of the step's end.
            pulls: from cotangents of the rates of a stage to those of the numbers and of its state.
            of_right: the cotangents of a stage's rates, from those of what it gives, and of the rates of later stages.
        """
        gained, total = _zeros(self.numbers), _zeros(after)
        of_rights: dict[int, Rows] = {}
        of_states: dict[int, Rows] = {}
        for i in reversed(range(len(pulls))):
            later = range(i + 1, len(pulls))
            weights = [b[i], *(a[j - 1][i] for j in later)]
            bars = [weighted(weights, [bar, *(of_states[j][r] for j in later)]) for r, bar in enumerate(after)]
            of_rights[i] = of_right(i, bars, of_rights)
            grads, of_states[i] = pulls[i](of_rights[i])
            gained, total = _plus(gained, grads), _plus(total, of_states[i])
        return total, gained, (of_rights, of_states)

    def _stiff_step(self, row: tape.Entry) -> _Step:
        """The same by the Rosenbrock method; a motion that ends where it began takes no step."""
        rodas, steps = stiff.rodas_of(self.problem), row.length > 0
        inverse = 1.0 / stiff.length_of(row.length, self.problem.time_scale)
        entries, pull_entries = jax.vjp(self._entries, self.numbers, row.state)
        factors = rodas.factors(entries, inverse * (1 / rosenbrock.GAMMA))
        slope: Rows = []
        increments, pulls = [], []
        for a, c in zip(((), *rosenbrock.A), ((), *rosenbrock.C), strict=True):
            so_far = list(zip(*increments, strict=True)) or [()] * self.width
            rows = [u + weighted(a, us) if a else u for u, us in zip(row.state, so_far, strict=True)]
            right, pull = jax.vjp(self._rate, self.numbers, rows)
            slope = slope or right
            if c:
                right = [r + inverse * weighted(c, us) for r, us in zip(right, so_far, strict=True)]
            increments.append(self._solve(factors, right))
            pulls.append(pull)
        count = len(increments)

        def of_right(i: int, bars: Rows, of_rights: dict[int, Rows]) -> Rows:
            later = range(i + 1, count)
            others = [rosenbrock.C[j - 1][i] for j in later]
            if others:
                rights = ([of_rights[j][r] for j in later] for r in range(self.width))
                bars = [bar + inverse * weighted(others, each) for bar, each in zip(bars, rights, strict=True)]
            return self._solve_transposed(factors, bars)

        def transposed(b: Sequence[float], after: Rows) -> tuple[Rows, list[Number]]:
            total, gained, (of_rights, _) = self._transposed(b, rosenbrock.A, after, pulls, of_right)
            of_entries = [
                sum((of_rights[k][i] * increments[k][j] for k in range(count)), jnp.zeros(()))
                for i, j in rodas.sparse.places
            ]
            grads, of_state = pull_entries(of_entries)
            return _plus(total, of_state), _plus(gained, grads)

        def back(after: Rows) -> tuple[Rows, list[Number], Rows]:
            moved, gained = transposed(rosenbrock.B, after)
            # What is damped within the step is no error of what comes before: W^-T d takes it away.
            errors = self._solve_transposed(factors, transposed((*[0.0] * (count - 1), 1.0), after)[0])
            results = _plus(after, moved), gained, [inverse * (1 / rosenbrock.GAMMA) * e for e in errors]
            nothing = list(after), _zeros(gained), _zeros(after)
            return jax.tree.map(functools.partial(jnp.where, steps), results, nothing)

        return _Step([], slope, back)


def _zeros(these: Sequence[Any]) -> list[Any]:
    return [jnp.zeros(jnp.shape(each)) for each in these]


def _plus(these: Sequence[Any], those: Sequence[Any]) -> list[Any]:
    return [one + other for one, other in zip(these, those, strict=True)]


def _dot(these: Rows, those: Rows) -> Scalar:
    return sum((one * other for one, other in zip(these, those, strict=True)), jnp.zeros(()))
