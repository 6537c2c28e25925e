"""Problems by heyoka: one lane at a time, or as many as it has SIMD lanes, each refilled as it ends.

The variational equations follow from heyoka's own symbolic derivatives, along one number. The derivatives at the
event follow from those of the state by the implicit function theorem, for all contenders in the same way.
"""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import heyoka as hy
import jax
import jax.numpy as jnp
import numba
import numpy as np

from benchmarks.ode_problems import JAX, Case, Lanes, heyoka_math

_DIRECTIONS = {1: hy.event_direction.positive, -1: hy.event_direction.negative, 0: hy.event_direction.any}


class Ends(NamedTuple):
    """Where lanes ended.

    Args:
        event: its index, -1 without one.
        t: when, shape (lanes,).
        rows: state and its derivatives at a fixed time, shape (lanes, rows).
        seconds: of processor time for the lanes, after compiling.
    """

    event: np.ndarray
    t: np.ndarray
    rows: np.ndarray
    seconds: float


def system(case: Case, order: int, *, integral: bool = False) -> tuple[Any, list[Any], list[str]]:
    """The equations with those of their derivatives, the event functions, and the numbers that these need."""
    m, names = heyoka_math(), _numbers(case)
    numbers = {name: hy.par[i] for i, name in enumerate(names)}
    state: list[Any] = list(hy.make_vars(*case.state))
    rates = [hy.expression(0.0) + rate for rate in case.rates(m, hy.time, state, numbers)]
    events = case.events(m, hy.time, state, numbers)
    if integral:
        rates.append(hy.expression(0.0) + case.integral(m, hy.time, state, numbers))
        state.append(hy.make_vars("integral"))
    by = numbers.get(case.wrt)
    rows = list(zip(state, rates, strict=True))

    def along(rates: list[Any], variables: list[Any], moves: list[Any]) -> list[Any]:
        changes = []
        for rate in rates:
            total = hy.expression(0.0) if by is None else hy.diff(rate, by)
            for variable, move in zip(variables, moves, strict=True):
                total = total + hy.diff(rate, variable) * move
            changes.append(total)
        return changes

    variables, moves = state, []
    for i in range(order):
        new: list[Any] = [hy.expression(f"{variable}_{i + 1}") for variable in state]
        moves = [*moves, *new]
        rates = along(rates, variables, moves)
        rows += list(zip(new, rates, strict=True))
        variables = [*state, *moves]
    return rows, events, names


def _numbers(case: Case) -> list[str]:
    return [name for name in case.sample(1, np.random.default_rng(0)) if name not in case.only_at_start]


def starts(case: Case, lanes: Lanes, order: int, *, integral: bool = False) -> np.ndarray:
    """State and derivatives at the start, shape (lanes, rows)."""

    def value(number: Any, rest: Any) -> Any:
        state = case.start(JAX, {**rest, case.wrt: number})
        return jnp.stack([jnp.asarray(part, float) for part in state] + [jnp.zeros(())] * integral)

    functions = [value]
    for _ in range(order):
        functions.append(functools.partial(_along, functions[-1]))
    rows = [np.asarray(jax.vmap(function)(lanes[case.wrt], lanes)) for function in functions]
    return np.concatenate(rows, 1)


def _along(function: Callable[..., Any], number: Any, rest: Any) -> Any:
    return jax.jvp(lambda each: function(each, rest), (number,), (1.0,))[1]


@functools.lru_cache(maxsize=4)
def _scalar(case: Case, order: int, tolerance: float, integral: bool) -> tuple[Any, list[int], list[str]]:
    """The integrator, a place for the event that ended it, and the numbers that it needs."""
    hit = [-1]
    rows, events, names = system(case, order, integral=integral)

    def marked(i: int) -> Callable[..., bool]:
        def mark(_: Any, __: int) -> bool:
            hit[0] = i
            return False

        return mark

    integrator = hy.taylor_adaptive(
        rows,
        np.zeros(len(rows)),
        pars=np.ones(len(names)),
        tol=tolerance,
        fast_math=tolerance > 1e-14,
        compact_mode=tolerance < 1e-14,  # compiles ten times as fast; what judges need not be fast
        t_events=[
            hy.t_event(event, direction=_DIRECTIONS[direction], callback=marked(i))
            for i, (event, direction) in enumerate(zip(events, case.directions.values(), strict=True))
        ],
    )
    return integrator, hit, names


def one_by_one(case: Case, lanes: Lanes, order: int, tolerance: float, *, integral: bool = False) -> Ends:
    """Lanes one after the other."""
    integrator, hit, names = _scalar(case, order, tolerance, integral)
    first = starts(case, lanes, order, integral=integral)
    numbers = np.stack([lanes[name] for name in names] or [np.ones(len(first))], 1)[:, : len(names)]
    event, t, end = np.full(len(first), -1), np.empty(len(first)), np.empty_like(first)
    begin = time.process_time()
    for i in range(len(first)):
        integrator.time = 0.0
        integrator.reset_cooldowns()
        integrator.state[:], integrator.pars[:] = first[i], numbers[i]
        while True:
            hit[0] = -1
            integrator.propagate_until(case.t1)
            if hit[0] < 0 or integrator.time > case.at_start:
                break
        event[i], t[i], end[i] = hit[0], integrator.time, integrator.state
    return Ends(event, t, end, time.process_time() - begin)


@numba.njit
def _refill(
    ended: np.ndarray,
    state: np.ndarray,
    pars: np.ndarray,
    times: np.ndarray,
    code: np.ndarray,
    lanes: np.ndarray,
    starts: np.ndarray,
    numbers: np.ndarray,
    event: np.ndarray,
    t: np.ndarray,
    end: np.ndarray,
    following: int,
) -> tuple[int, int]:
    """Store the lanes that ended, and give them the next ones."""
    stored = 0
    for k in range(ended.size):
        if ended[k]:
            ended[k], i = False, lanes[k]
            if i >= 0:
                t[i], event[i], end[i] = times[k], code[k], state[:, k]
                stored += 1
            lanes[k] = following if following < len(starts) else -1
            i = max(lanes[k], 0)
            state[:, k], pars[:, k], times[k], code[k] = starts[i], numbers[i], 0.0, -1
            following += 1
    return following, stored


@functools.lru_cache(maxsize=4)
def _batch(case: Case, order: int, tolerance: float, width: int) -> tuple[Any, np.ndarray, np.ndarray, list[str]]:
    """The integrator, whether its lanes ended and by which event, and the numbers that it needs."""
    rows, events, names = system(case, order)
    ended, code = np.zeros(width, bool), np.full(width, -1)

    def marked(i: int) -> Callable[..., bool]:
        def mark(integrator: Any, _: int, lane: int) -> bool:
            if integrator.time[lane] > case.at_start:
                ended[lane], code[lane] = True, i
            return True

        return mark

    integrator = hy.taylor_adaptive_batch(
        rows,
        np.zeros((len(rows), width)),
        pars=np.ones((len(names), width)),
        tol=tolerance,
        fast_math=True,
        t_events=[
            hy.t_event_batch(event, direction=_DIRECTIONS[direction], callback=marked(i))
            for i, (event, direction) in enumerate(zip(events, case.directions.values(), strict=True))
        ],
    )
    return integrator, ended, code, names


def refilled(case: Case, lanes: Lanes, order: int, tolerance: float, width: int = 0) -> Ends:
    """As many lanes at once as the batch has, each replaced by the next as soon as it has ended."""
    width = width or (16 if order else 64)
    integrator, ended, code, names = _batch(case, order, tolerance, width)
    first = starts(case, lanes, order)
    numbers = np.stack([lanes[name] for name in names] or [np.ones(len(first))], 1)
    results = np.full(len(first), -1), np.empty(len(first)), np.empty_like(first)
    times, which = np.zeros(width), np.full(width, -1)
    state, pars = integrator.state, integrator.pars
    ended[:] = False
    _refill(ended, state, pars, times, code, which, first, numbers, *results, 0)  # compiles it
    begin = time.process_time()
    ended[:], left = True, len(first)
    following, _ = _refill(ended, state, pars, times, code, which, first, numbers, *results, 0)
    changed = True
    while left:
        if changed:
            integrator.set_time(times)
            integrator.reset_cooldowns()
        integrator.step(max_delta_t=case.t1 - times)
        times = np.array(integrator.time)
        ended[times >= case.t1] = True
        changed = bool(ended.any())
        if changed:
            following, stored = _refill(ended, state, pars, times, code, which, first, numbers, *results, following)
            left -= stored
    return Ends(*results, time.process_time() - begin)


def at_the_event(case: Case, lanes: Lanes, ends: Ends, order: int, *, integral: bool = False) -> list[np.ndarray]:
    """For each derivative from 0 to `order`: time, state and integral at the event, shape (lanes, 1 + unknowns)."""
    count = len(case.state) + integral

    def one(parts: Any, t: Any, p: Any, event: Any) -> Any:
        def rates(s: Any, t: Any, q: Any) -> Any:
            unknowns = list(s[: len(case.state)])
            more = [case.integral(JAX, t, unknowns, q)] if integral else []
            return jnp.stack([jnp.asarray(r, float) for r in (*case.rates(JAX, t, unknowns, q), *more)])

        def flown(step: Any, later: Any) -> Any:
            """The state at another number and a later time, to second order in both."""
            q = {**p, case.wrt: p[case.wrt] + step}
            s = sum(part * step**i / (1, 1, 2)[i] for i, part in enumerate(parts))
            flow = rates(s, t, q)
            bend = jax.jvp(lambda s, t: rates(s, t, q), (s, t), (flow, 1.0))[1]
            return s + later * flow + later * later / 2 * bend

        def function(step: Any, later: Any) -> Any:
            q = {**p, case.wrt: p[case.wrt] + step}
            values = case.events(JAX, t + later, list(flown(step, later)[: len(case.state)]), q)
            return jnp.stack([jnp.asarray(value, float) for value in values])[jnp.maximum(event, 0)]

        (by, slope) = jax.grad(function, (0, 1))(0.0, 0.0)
        ((aa, ab), (_, bb)) = jax.hessian(function, (0, 1))(0.0, 0.0)
        first = jnp.where(event < 0, 0.0, -by / slope)
        second = jnp.where(event < 0, 0.0, -(aa + 2 * ab * first + bb * first * first) / slope)

        def outputs(step: Any) -> Any:
            later = first * step + second * step * step / 2
            return jnp.concatenate([(t + later)[None], flown(step, later)])

        def slope_of(function: Any) -> Any:
            return lambda step: jax.jvp(function, (step,), (1.0,))[1]

        functions = [outputs]
        for _ in range(order):
            functions.append(slope_of(functions[-1]))
        return [each(0.0) for each in functions]

    parts = [ends.rows[:, i * count : (i + 1) * count] for i in range(order + 1)]
    found = jax.jit(jax.vmap(one))(parts, ends.t, {key: jnp.asarray(value) for key, value in lanes.items()}, ends.event)
    return [np.asarray(part) for part in found]
