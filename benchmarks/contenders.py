"""Who computes the ends of lanes: `erosion`, heyoka, diffrax and scipy, each for any problem."""

import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy.integrate import solve_ivp

import erosion
from benchmarks.heyoka_lanes import one_by_one, refilled
from benchmarks.impacts import RotatingImpact, volume_unit, with_units
from benchmarks.ode_problems import JAX, NUMPY, Case, Lanes
from erosion import ode


class Run(NamedTuple):
    """What a contender computed.

    Args:
        result: `Case.judged` of each lane.
        event: the index of each lane's event, -1 without one, -2 for no result.
        seconds: of processor time.
    """

    result: np.ndarray
    event: np.ndarray
    seconds: float


Solve = Callable[[float, Lanes], Run]
"""A function of a relative tolerance and lanes."""


def first(lanes: Lanes, count: int) -> Lanes:
    """The first lanes."""
    return {name: values[:count] for name, values in lanes.items()}


def event_of(solution: ode.Solution, events: int) -> np.ndarray:
    """The index of each lane's event, -1 without one, -2 for no result."""
    names = np.asarray(solution.outcome)
    ended = np.where(names < events, names, -1)
    return np.where(np.isin(solution.ended_by, ("failed", "unfinished", "start")), -2, ended)


def event_of_impact(hits: erosion.Impact) -> np.ndarray:
    """The same of impacts: 0 for a rebound, 1 for a stop."""
    return np.select([hits.ended_by == name for name in RotatingImpact.directions], [0, 1], -2)


def by_erosion(case: Case, order: int = 0, **options: Any) -> Solve:
    """`erosion.impact` for impacts, else `ode.solve`."""
    if isinstance(case, RotatingImpact):
        return lambda rtol, lanes: _impact(with_units(lanes), order, rtol)
    problem = case.problem()
    options |= {"derivatives": order, "wrt": case.wrt if order else (), "smooth": True}

    def solve(rtol: float, lanes: Lanes) -> Run:
        begin = time.process_time()
        end = ode.solve(problem, lanes, t1=case.t1, rtol=rtol, **options)
        seconds = time.process_time() - begin
        return Run(end.t, event_of(end, len(case.directions)), seconds)

    return solve


def _impact(p: erosion.Parameters, order: int, rtol: float) -> Run:
    begin = time.process_time()
    hits = erosion.impact("rotating", p, derivatives=order, rtol=rtol)
    seconds = time.process_time() - begin
    return Run(hits.volume / volume_unit(p), event_of_impact(hits), seconds)


def by_heyoka(case: Case, order: int = 0, *, batch: bool = False) -> Solve:
    """One lane after the other, or as many as its SIMD registers hold, refilled."""

    def solve(rtol: float, lanes: Lanes) -> Run:
        ends = (refilled if batch else one_by_one)(case, lanes, order, rtol)
        result = ends.t if case.judged == "t" else ends.rows[:, case.state.index(case.judged)]
        return Run(result, ends.event, ends.seconds)

    return solve


_SOLVERS: Mapping[str, tuple[Any, float]] = {"Dopri8": (diffrax.Dopri8, 1e-12), "Kvaerno5": (diffrax.Kvaerno5, 1e-9)}
"""And the tolerance of the search for the event."""


@functools.cache
def by_diffrax(case: Case, solver: str, block: int) -> Solve:
    """By `jit` and `vmap`, in blocks of lanes one after another.

    Where all events fall, it gets their minimum: of two events it reports the first one, not the earlier one. Bisection
    finds a single event in every lane; Newton's method, the only one for several, loses some under `vmap`.
    """
    directions = [None if d == 0 else d > 0 for d in case.directions.values()]
    is_one = len(directions) == 1 or directions == [False] * len(directions)
    method, digits = _SOLVERS[solver]

    def lane(p: Any, rtol: Any) -> Any:
        def functions(t: Any, y: Any) -> Any:
            return jnp.stack([jnp.asarray(value, float) for value in case.events(JAX, t, list(y), p)])

        def condition(i: int) -> Callable[..., Any]:
            return lambda t, y, args, **_: functions(t, y)[i]

        if is_one:
            search = optx.Bisection(digits, digits, flip="detect")
            event = diffrax.Event(lambda t, y, args, **_: jnp.min(functions(t, y)), search, direction=directions[0])
        else:
            conditions = [condition(i) for i in range(len(directions))]
            event = diffrax.Event(conditions, optx.Newton(digits, digits), direction=directions)
        end = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: jnp.stack([jnp.asarray(r) for r in case.rates(JAX, t, list(y), p)])),
            method(),
            t0=0.0,
            t1=case.t1,
            dt0=None,
            y0=jnp.stack([jnp.asarray(s, float) for s in case.start(JAX, p)]),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * case.absolute),
            event=event,
            adjoint=diffrax.ForwardMode(),
            max_steps=20_000,
            throw=False,
        )
        assert end.ts is not None
        assert end.ys is not None
        hit = jnp.stack([jnp.asarray(each) for each in jax.tree.leaves(end.event_mask)])
        which = jnp.argmin(jnp.abs(functions(end.ts[-1], end.ys[-1]))) if is_one else jnp.argmax(hit)
        result = end.ts[-1] if case.judged == "t" else end.ys[-1, case.state.index(case.judged)]
        return result, jnp.where(hit.any(), which, -1)

    @jax.jit
    def program(p: Any, rtol: Any) -> Any:
        return jax.lax.map(lambda q: jax.vmap(lane, (0, None))(q, rtol), p)

    def solve(rtol: float, lanes: Lanes) -> Run:
        p = {name: jnp.asarray(values.reshape(-1, block)) for name, values in lanes.items()}
        begin = time.process_time()
        result, event = jax.block_until_ready(program(p, rtol))
        seconds = time.process_time() - begin
        return Run(np.ravel(result), np.ravel(event), seconds)

    return solve


def by_scipy(case: Case, method: str, **options: Any) -> Solve:
    """`solve_ivp`, one lane after the other."""

    def event(i: int, direction: int, p: Any) -> Any:
        def function(t: float, s: np.ndarray) -> Any:
            return case.events(NUMPY, t, list(s), p)[i]

        function.direction, function.terminal = direction, True  # pyrefly: ignore
        return function

    def one(rtol: float, p: Mapping[str, float]) -> tuple[float, int]:
        end = solve_ivp(
            lambda t, s: case.rates(NUMPY, t, list(s), p),
            (0.0, case.t1),
            [float(s) for s in case.start(NUMPY, p)],
            method=method,
            rtol=rtol,
            atol=rtol * case.absolute,
            events=[event(i, direction, p) for i, direction in enumerate(case.directions.values())],
            **options,
        )
        which = next((i for i, times in enumerate(end.t_events) if len(times)), -1)
        return float(end.t[-1] if case.judged == "t" else end.y[case.state.index(case.judged), -1]), which

    def solve(rtol: float, lanes: Lanes) -> Run:
        begin = time.process_time()
        ends = [one(rtol, dict(zip(lanes, map(float, row), strict=True))) for row in zip(*lanes.values(), strict=True)]
        results, events = zip(*ends, strict=True)
        return Run(np.array(results), np.array(events), time.process_time() - begin)

    return solve
