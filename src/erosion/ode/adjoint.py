"""The derivatives of one number by all arguments of a lane: its steps are gone through backwards.

A lane that was integrated forwards has left its steps on a tape. What a number L at the lane's end changes by, where
the state s there changes, are the cotangents s̄; a step back turns them into those of the state before it, and adds
what L changes by with the arguments on the way. A step of the Runge-Kutta method is

    Y_i = y + h Σ a_ij k_j,   k_i = f(Y_i),   y' = y + h Σ b_i k_i,

and its transpose, for the cotangents λ of y',

    k̄_i = h (b_i λ + Σ a_ji Ȳ_j),   Ȳ_i = f_y(Y_i)ᵀ k̄_i,   ȳ = λ + Σ Ȳ_i,   p̄ = Σ f_p(Y_i)ᵀ k̄_i.

A step of the Rosenbrock method, of which `rodas5p` has the coefficients, solves W u_i = r_i with W = d - J(y),

    r_i = f(Y_i) + Σ c_ij u_j / h,   Y_i = y + Σ a_ij u_j,   y' = y + Σ b_i u_i,

and its transpose solves Wᵀ w_i = ū_i, which is r̄_i: Ȳ_i = f_y(Y_i)ᵀ w_i, and ū_j gains a_ij Ȳ_i + c_ij w_i / h. The
cotangents of the entries of J are those of Σ w_i u_iᵀ.

The steps are those that the value needs. Where it rests, or hardly depends on what is fast, they may be far too long
for the cotangents. The Ȳ of the second stage tells by how much these err: the stage's weight b is zero, and of its
Ȳ only products of seven Jacobians are left, h⁷, where λ errs by h⁹. Of a Rosenbrock step the embedded solution tells,
transposed as well. Derivatives of a lane in which the error is too great are NaN.

A state at a time within a step is that of a shorter step from the same start, so its cotangents go back through that.
After an event a given time is later in its motion where the event is sooner: what a number changes by with the time
since the event is taken from the cotangent of the event's time.

At an event g = 0 the time is a function of state and arguments, dt = -dg/ġ: with F the rates there, and t̄ the
cotangent of the time, s̄ gains -(t̄ + s̄·F)/ġ g_s, and p̄ the same times g_p. Of a stiff motion F is what the state
changes by with the length of the last step; see `methods.rosenbrock`. A reset is transposed as it is.

References:
    J. M. Sanz-Serna, SIAM Review 58 (2016) 3-33, for the transpose of a Runge-Kutta method.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.arguments import Number, Scalar
from erosion.lanes import tapes
from erosion.ode import tape
from erosion.ode.lane_equations import LaneEquations
from erosion.ode.methods.base import BackStep
from erosion.ode.methods.transposes import plus, zeros
from erosion.ode.reduction import FlatState
from erosion.ode.signature import Signature
from erosion.ode.step_control import ARRIVED
from erosion.ode.switches import motion_of

_TINY = 1e-200  # keeps 0/0 away


_BACK_TIMES, _COTANGENTS = 1, 2
"""Tapes beside that of the steps: times, which all lanes share; for each the cotangents of a lane's outputs there."""


class _Backward(NamedTuple):
    """On the way back.

    Args:
        row: of the tape, the next one.
        state: cotangents of the state there.
        time: the cotangent of the time so far.
        sums: cotangents of the numbers.
        greatest: the greatest size so far of each row's cotangent.
        error: the greatest relative error of a cotangent in a step.
        step_end: when the next step on the way ends, since the lane began.
        due: how many times are left.
        there: cotangents of the state where that step begins, of those at times within it.
    """

    row: Scalar
    state: FlatState
    time: Scalar
    sums: list[Number]
    greatest: FlatState
    error: Scalar
    step_end: Scalar
    due: Scalar
    there: FlatState


def pulled_back(
    signature: Signature,
    parameters: Sequence[Number],
    rtol: Scalar,
    count: Scalar,
    cotangents: Sequence[Scalar],
    token: Scalar,
    due: Scalar | None = None,
) -> list[Number]:
    """The derivatives of a number by the lane's real numbers, shapes as of these.

    Args:
        signature: of the lane.
        parameters: of the lane.
        rtol: with which it was integrated.
        count: rows of its tape.
        cotangents: by what the number changes with the lane's time, and with each of its outputs.
        token: see `erosion.lanes.tapes`.
        due: how many times the lane reaches, whose states count as well; None where none do.
    """
    adjoint = _Adjoint(signature, parameters, token, timed=due is not None)
    gradient, error = adjoint.pulled_back(count, cotangents[0], list(cotangents[1:]), due)
    most = adjoint.steps.most(rtol)
    return [jnp.where(error <= most, each, jnp.nan) for each in gradient]


class _Adjoint:
    def __init__(self, signature: Signature, parameters: Sequence[Number], token: Scalar, *, timed: bool) -> None:
        self.problem = LaneEquations(signature, parameters, 0, ())
        self.token, self.width, self.timed, self.outputs = token, self.problem.width, timed, signature.rows - 1
        self.is_real = [dtype == "float64" for dtype in signature.dtypes]
        self.all = list(parameters)
        self.parameters = [number for number, real in zip(parameters, self.is_real, strict=True) if real]
        self.motion = motion_of(signature)

        def rate(parameters: list[Number], flat_state: FlatState) -> FlatState:
            return jax.tree.leaves(self._at(parameters).rate(self._member(flat_state)))

        # Each is traced once for all the places where it is called.
        self._rate = jax.jit(rate)
        self.steps = self.problem.method.reverse(self._rate, self.parameters, self._with_whole)

    def _at(self, parameters: list[Number]) -> Any:
        return self.motion(self._with_whole(parameters))

    def _with_whole(self, parameters: list[Number]) -> list[Number]:
        """All numbers of the lane, from the real ones."""
        rest = iter(parameters)
        return [next(rest) if real else one for one, real in zip(self.all, self.is_real, strict=True)]

    def _member(self, flat_state: FlatState) -> Any:
        (member,) = self.problem.value_and_tangents(flat_state)
        return member

    def pulled_back(
        self, count: Scalar, time: Scalar, outputs: FlatState, due: Scalar | None
    ) -> tuple[list[Number], Scalar]:
        """The derivatives, and their error."""
        last = lax.convert_element_type(count, int) - 1
        at_end = tape.read(self.token, last, self.width)
        sums, state = self._from_outputs(at_end.state, outputs)
        due_times = lax.convert_element_type(0.0 * time if due is None else due, int)
        greatest: FlatState = [jnp.abs(cotangent) for cotangent in state]
        back = _Backward(last, state, time, sums, greatest, 0.0 * time, 0.0 * time, due_times, zeros(state))
        if self.problem.chains:
            back = lax.while_loop(
                lambda back: back.row >= 0, lambda back: self._steps(self._event(back, is_last=back.row == last)), back
            )
        else:
            back = self._steps(self._event(back, is_last=jnp.asarray(True)))
        _, pull = jax.vjp(lambda parameters: jax.tree.leaves(self._start(parameters)), self.parameters)
        # A time before the first step, which a lane that ends at its start has not.
        error = jnp.where(back.due > 0, jnp.inf, back.error)
        return plus(back.sums, pull(back.state)[0]), error

    def _from_outputs(self, flat_state: FlatState, cotangents: FlatState) -> tuple[list[Number], FlatState]:
        """Cotangents of the numbers and of the state, from those of the outputs there."""
        _, pull = jax.vjp(
            lambda parameters, flat_state: self._at(parameters).outputs(self._member(flat_state)),
            self.parameters,
            flat_state,
        )
        return pull(cotangents)

    def _start(self, parameters: list[Number]) -> Any:
        state, integrals = self._at(parameters).initial()
        return state, [jnp.asarray(begin, float) for begin in integrals]

    def _event(self, back: _Backward, *, is_last: Scalar) -> _Backward:
        """Before the event of a motion, from after it."""
        # Lanes that are done go on beside others, and read the first row.
        step_end, event, flat_state = tape.read(self.token, jnp.maximum(back.row, 0), self.width)
        state, sums = list(back.state), back.sums
        if self.problem.chains:

            def after(parameters: list[Number], flat_state: FlatState) -> FlatState:
                at, motion = self._member(flat_state), self._at(parameters)
                for i in self.problem.chains:
                    at = jax.tree.map(functools.partial(jnp.where, event == i), motion.after(i, at), at)
                return jax.tree.leaves(at)

            _, pull = jax.vjp(after, self.parameters, flat_state)
            grads, earlier = pull([jnp.where(is_last, 0.0, cotangent) for cotangent in state])
            state: FlatState = [
                jnp.where(is_last, cotangent, before) for cotangent, before in zip(state, earlier, strict=True)
            ]
            sums = plus(sums, grads)
        flow = self._flow(back.row, flat_state)
        total = back.time + _dot(state, flow)

        def events(parameters: list[Number], flat_state: FlatState) -> list[Scalar]:
            return self._at(parameters).events(self._member(flat_state))

        _, falls = jax.jvp(lambda flat_state: events(self.parameters, flat_state), (flat_state,), (flow,))
        _, pull = jax.vjp(events, self.parameters, flat_state)
        grads, more = pull([jnp.where(event == i, -total / fall, 0.0) for i, fall in enumerate(falls)])
        sums, state = plus(sums, grads), plus(state, more)
        time = back.time
        if self.problem.signature.has_clock:
            # A lane without an event ends at a given time, and what came before took of it.
            of_clock = jnp.where(event == ARRIVED, total, 0.0)
            _, pull = jax.vjp(
                lambda parameters: self._at(parameters).clock.t1 - self._at(parameters).clock.t0, self.parameters
            )
            sums, time = plus(sums, pull(of_clock)[0]), time - of_clock
        greatest: FlatState = list(map(jnp.maximum, back.greatest, map(jnp.abs, state)))
        return back._replace(row=back.row - 1, state=state, time=time, sums=sums, greatest=greatest, step_end=step_end)

    def _flow(self, event: Scalar, flat_state: FlatState) -> FlatState:
        """What the state at an event changes by with its time."""
        return self.steps.flow(flat_state, lambda: tape.read(self.token, jnp.maximum(event - 1, 0), self.width))

    def _steps(self, back: _Backward) -> _Backward:
        """Where a motion began, from its event."""

        def step(at: tuple[_Backward, tape.Entry]) -> tuple[_Backward, tape.Entry]:
            back, row = at
            after = self._at_time(back, row) if self.timed else self._before(back, row, self.steps.step(row))
            return after, tape.read(self.token, jnp.maximum(after.row, 0), self.width)

        def goes_on(at: tuple[_Backward, tape.Entry]) -> Scalar:
            back, row = at
            return (back.row >= 0) & (row.code == tape.STEP)

        return lax.while_loop(goes_on, step, (back, tape.read(self.token, jnp.maximum(back.row, 0), self.width)))[0]

    def _before(self, back: _Backward, row: tape.Entry, step: BackStep) -> _Backward:
        """Where a step began, from its end."""
        state, gained, errors = step.back(back.state)
        if self.timed:
            state = plus(state, back.there)
        greatest: FlatState = list(map(jnp.maximum, back.greatest, map(jnp.abs, state)))
        moved = [jnp.abs(row.length * k) for k in step.slope]
        sizes = list(map(jnp.maximum, map(jnp.abs, row.state), moved))
        most = functools.reduce(
            jnp.maximum, [cotangent * size for cotangent, size in zip(greatest, sizes, strict=True)]
        )
        error, share = back.error, self.steps.share
        for e, cotangent, size in zip(errors, greatest, sizes, strict=True):
            least = jnp.where(size > 0, share * most / (size + _TINY), 0.0)
            error = jnp.maximum(error, jnp.abs(e) / (jnp.maximum(cotangent, least) + _TINY))
        return back._replace(
            row=back.row - 1, state=state, sums=plus(back.sums, gained), greatest=greatest, error=error,
            step_end=back.step_end - row.length, there=zeros(back.there),
        )  # fmt: skip

    def _at_time(self, back: _Backward, row: tape.Entry) -> _Backward:
        """The same, or the cotangents there of the last time within the step, if one is left.

        Both take a step from the same start, which is written once.
        """
        place = jnp.maximum(back.due - 1, 0)
        time, t0 = tapes.read(_BACK_TIMES, np.zeros(()), place), self.problem.clock.t0
        before_it = tape.read(self.token, jnp.maximum(back.row - 1, 0), self.width)
        begins = (back.row > 0) & (before_it.code != tape.STEP)
        start = jnp.where(begins, before_it.length, back.step_end - row.length)
        passed = time - t0 - start
        # As where states are written, a time at an event is before its reset.
        least = jnp.where(begins, tape.ROUNDING * (jnp.abs(t0) + start), 0.0)
        within = (back.due > 0) & ((passed > least) | (back.row == 0))
        step = self.steps.step(row._replace(length=jnp.where(within, jnp.clip(passed, 0.0, row.length), row.length)))
        count = self.outputs
        cotangents = [tapes.read(_COTANGENTS, self.token, place * count + i) for i in range(count)]
        of_outputs, there = self._from_outputs(step.end, cotangents)
        of_time = _dot(there, self._rate(self.parameters, step.end))
        _, pull = jax.vjp(lambda parameters: self._at(parameters).clock.t0, self.parameters)
        state: FlatState = [
            jnp.where(within, cotangent, other) for cotangent, other in zip(there, back.state, strict=True)
        ]
        before = self._before(
            back._replace(state=state, there=[jnp.where(within, 0.0, cotangent) for cotangent in back.there]), row, step
        )
        # At a given time it is later since the start, where that is earlier.
        at_time = back._replace(
            sums=plus(before.sums, plus(of_outputs, pull(-of_time)[0])),
            time=back.time - of_time, due=back.due - 1, there=plus(back.there, before.state), error=before.error,
        )  # fmt: skip
        return jax.tree.map(functools.partial(jnp.where, within), at_time, before)


def _dot(these: FlatState, those: FlatState) -> Scalar:
    return sum((one * other for one, other in zip(these, those, strict=True)), jnp.zeros(()))
