"""Processor time a lane on six problems: `ode.solve`, heyoka, diffrax and scipy by turns, on one core.

    python -m benchmarks.ode_speed

Each contender computes at the loosest tolerance at which 99 % of its times are right to 2e-9. What a contender
compiles is not counted: of `ode.solve`, neither the quick code nor that which takes its place after a while.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.ode_accuracy import event_of
from benchmarks.ode_heyoka import one_by_one, refilled
from benchmarks.ode_problems import CASES, JAX, NUMPY, Case, Lanes, lanes_of
from benchmarks.timing import table_text
from erosion import ode

_RIGHT = 2e-9  # 99 % of the times are
_WARM = 6.0  # seconds of processor time
_TOLERANCES = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
ORDERS = ("V", "V, V′", "V, V′, V″")


class Run(NamedTuple):
    """What a contender computed.

    Args:
        t: when its lanes ended.
        event: the index of each lane's event, -1 without one.
        seconds: of processor time, without compiling.
    """

    t: np.ndarray
    event: np.ndarray
    seconds: float


class Engine(NamedTuple):
    """One that computes.

    Args:
        name: in the table.
        lanes: how many.
        at: a function of a tolerance and lanes.
    """

    name: str
    lanes: int
    at: Callable[[float, Lanes], Run]


def ours(case: Case, order: int) -> Callable[[float, Lanes], Run]:
    """`ode.solve`."""
    problem = case.problem()
    options: dict[str, Any] = {"derivatives": order, "wrt": case.wrt if order else (), "smooth": True}

    def at(tolerance: float, lanes: Lanes) -> Run:
        begin = time.process_time()
        end = ode.solve(problem, lanes, t1=case.t1, rtol=tolerance, **options)
        return Run(end.t, event_of(end, len(case.directions)), time.process_time() - begin)

    return at


def heyoka(case: Case, order: int, integrate: Callable[..., Any]) -> Callable[[float, Lanes], Run]:
    """One by one, or refilled."""

    def at(tolerance: float, lanes: Lanes) -> Run:
        ends = integrate(case, lanes, order, tolerance)
        return Run(ends.t, ends.event, ends.seconds)

    return at


def diffrax_lanes(case: Case, order: int, block: int = 64) -> Callable[[float, Lanes], Run]:
    """Those of diffrax under jit and vmap, in blocks one after another; derivatives by forward mode."""
    import diffrax
    import optimistix as optx

    directions = [None if d == 0 else d > 0 for d in case.directions.values()]

    def one(number: Any, p: Any, rtol: Any) -> Any:
        p = {**p, case.wrt: number}

        def condition(i: int) -> Callable[..., Any]:
            return lambda t, y, args, **_: jnp.asarray(case.events(JAX, t, list(y), p)[i])

        end = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: jnp.stack([jnp.asarray(r) for r in case.rates(JAX, t, list(y), p)])),
            diffrax.Dopri8(),
            t0=0.0,
            t1=case.t1,
            dt0=None,
            y0=jnp.stack([jnp.asarray(s, float) for s in case.start(JAX, p)]),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * 1e-3),
            event=diffrax.Event(
                [condition(i) for i in range(len(directions))], optx.Newton(1e-12, 1e-12), direction=directions
            ),
            adjoint=diffrax.ForwardMode() if order else diffrax.RecursiveCheckpointAdjoint(),
            max_steps=4096,
            throw=False,
        )
        hit = jnp.stack([jnp.asarray(each) for each in jax.tree.leaves(end.event_mask)])
        assert end.ts is not None
        return end.ts[-1], jnp.where(hit.any(), jnp.argmax(hit), -1)

    def lane(number: Any, p: Any, rtol: Any) -> Any:
        if order == 0:
            return one(number, p, rtol)
        t, slope, event = jax.jvp(lambda each: one(each, p, rtol), (number,), (1.0,), has_aux=True)
        return t, event, slope

    @jax.jit
    def run(p: Any, rtol: Any) -> Any:
        return jax.lax.map(lambda q: jax.vmap(lambda n, r: lane(n, r, rtol))(q[case.wrt], q), p)

    def at(tolerance: float, lanes: Lanes) -> Run:
        count = len(lanes[case.wrt]) // block * block
        p = {name: jnp.asarray(values[:count].reshape(-1, block)) for name, values in lanes.items()}
        compiled = run.lower(p, tolerance).compile()
        begin = time.process_time()
        t, event, *_ = jax.block_until_ready(compiled(p, tolerance))
        seconds = time.process_time() - begin
        return Run(np.ravel(t), np.ravel(event), seconds)

    return at


def scipy_lanes(case: Case) -> Callable[[float, Lanes], Run]:
    """`solve_ivp`, one lane after the other."""
    from scipy.integrate import solve_ivp

    def at(tolerance: float, lanes: Lanes) -> Run:
        begin = time.process_time()
        count = len(lanes[case.wrt])
        t, event = np.full(count, case.t1), np.full(count, -1)
        for i in range(count):
            p = {name: float(values[i]) for name, values in lanes.items()}
            functions = []
            for k, direction in enumerate(case.directions.values()):

                def function(t: float, s: np.ndarray, k: int = k, p: Any = p) -> Any:
                    return case.events(NUMPY, t, list(s), p)[k]

                function.direction, function.terminal = direction, True  # pyright: ignore[reportFunctionMemberAccess]
                functions.append(function)
            end = solve_ivp(
                lambda t, s, p=p: case.rates(NUMPY, t, list(s), p),
                (0.0, case.t1),
                [float(s) for s in case.start(NUMPY, p)],
                method="DOP853",
                rtol=max(tolerance, 1e-13),
                atol=tolerance * 1e-3,
                events=functions,
            )
            for k, times in enumerate(end.t_events):
                if len(times):
                    t[i], event[i] = times[-1], k
        return Run(t, event, time.process_time() - begin)

    return at


def contenders(case: Case, order: int, quick: bool) -> list[Engine]:
    """All that compute these derivatives."""
    scale = 4 if quick else 1
    rows = [
        Engine("erosion.ode", 2**15 // scale, ours(case, order)),
        Engine("heyoka, one by one", 2**12 // scale, heyoka(case, order, one_by_one)),
    ]
    if order == 0 or not quick:
        rows.append(Engine("heyoka, batch refilled", 2**12 // scale, heyoka(case, order, refilled)))
    if order < 2:
        rows.append(Engine("diffrax Dopri8", 2**9 // scale, diffrax_lanes(case, order)))
    if order == 0:
        rows.append(Engine("scipy DOP853", 32 // scale, scipy_lanes(case)))
    return rows


class Measured(NamedTuple):
    """A contender's figures.

    Args:
        tolerance: the loosest that will do; None where none does.
        micro: seconds of processor time a lane, of each turn, in millionths.
        wrong: of `lanes`.
        error: of 99 % of the times.
    """

    name: str
    tolerance: float | None
    micro: list[float]
    wrong: int
    lanes: int
    error: float


def first(lanes: Lanes, count: int) -> Lanes:
    """The first lanes."""
    return {name: values[:count] for name, values in lanes.items()}


def judged(run: Run, true: Run) -> tuple[int, float]:
    """How many lanes end otherwise, and the error of 99 % of the other times."""
    count = len(run.t)
    same = run.event == true.event[:count]
    errors = np.abs(run.t / true.t[:count] - 1)[same]
    return int((~same).sum()), float(np.percentile(errors, 99)) if same.any() else np.inf


def measured(case: Case, order: int, rounds: int, quick: bool) -> list[Measured]:
    """All contenders by turns."""
    rows = contenders(case, order, quick)
    lanes = lanes_of(case, rows[0].lanes)
    ends = one_by_one(case, lanes, 0, 1e-15)
    true = Run(ends.t, ends.event, 0.0)
    kept: list[tuple[Engine, float]] = []
    results: dict[str, Measured] = {}
    for row in rows:
        own, wrong, error = first(lanes, min(row.lanes, 1024)), 0, np.inf
        # Both of heyoka's have the same method.
        same = [kept[-1][1]] if "batch" in row.name else _TOLERANCES
        for tolerance in same:
            wrong, error = judged(row.at(tolerance, own), true)
            if error <= _RIGHT:
                kept.append((row, tolerance))
                break
        else:
            results[row.name] = Measured(row.name, None, [], wrong, len(own[case.wrt]), error)
    if kept and kept[0][0] is rows[0]:
        # Until the machine code is made with care: after a second or two of work.
        begin = time.process_time()
        while time.process_time() - begin < _WARM:
            rows[0].at(kept[0][1], lanes)
    for _ in range(rounds):
        for row, tolerance in kept:
            own = first(lanes, row.lanes)
            run = row.at(tolerance, own)
            wrong, error = judged(run, true)
            before = results[row.name].micro if row.name in results else []
            micro = [*before, 1e6 * run.seconds / len(run.t)]
            results[row.name] = Measured(row.name, tolerance, micro, wrong, len(run.t), error)
    return [results[row.name] for row in rows]


def lines(case: Case, order: int, found: Sequence[Measured]) -> list[list[str]]:
    """Rows of the table; the factor is the median of the turns' own."""
    rows = []
    for each in found:
        if not each.micro:
            rows.append([f"{case.name}, {ORDERS[order]}: {each.name}", "none", "", "", f"{each.wrong}", ""])
            continue
        factor = statistics.median(a / b for a, b in zip(each.micro, found[0].micro, strict=True))
        rows.append(
            [
                f"{case.name}, {ORDERS[order]}: {each.name}",
                f"{each.tolerance:.0e}",
                f"{statistics.median(each.micro):.3g} ({min(each.micro):.3g}–{max(each.micro):.3g})",
                f"{factor:.3g}",
                f"{each.wrong} of {each.lanes:,}",
                f"{each.error:.1e}",
            ]
        )
    return rows


def states(case: Case, rounds: int, times: int = 100) -> float:
    """How many times as long 1,000 lanes take with their states at 100 times, until the last of them ends."""
    lanes, problem = lanes_of(case, 1000), case.problem()

    def seconds(ts: np.ndarray | None = None) -> float:
        begin = time.process_time()
        ode.solve(problem, lanes, t1=case.t1, rtol=1e-8, smooth=True, ts=ts)
        return time.process_time() - begin

    ts = np.linspace(0.0, ode.solve(problem, lanes, t1=case.t1, rtol=1e-8, smooth=True).t.max(), times)
    begin = time.process_time()
    while time.process_time() - begin < _WARM:
        seconds()
        seconds(ts)
    return statistics.median(seconds(ts) / seconds() for _ in range(5 * rounds))


_FIRST = """
import time
import erosion, jax, numpy
from erosion import ode
from benchmarks.ode_problems import CASES, lanes_of
case = CASES["{case}"]
lanes = lanes_of(case, 1)
begin = time.process_time()
ode.solve(case.problem(), lanes, t1=case.t1, smooth=True{options})
print(time.process_time() - begin)
"""


def first_calls(case: str, order: int, rounds: int) -> list[float]:
    """Seconds of processor time of the first call after the imports, each in a new process."""
    options = f", wrt={CASES[case].wrt!r}, derivatives={order}" if order else ""
    code = _FIRST.format(case=case, options=options)
    return [
        float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)
        for _ in range(rounds)
    ]


def bounces(lanes: int, rounds: int) -> list[list[float]]:
    """Millionths of a second a flight of ten, for 0, 1 and 2 derivatives."""
    ball = ode.Problem(
        y0=lambda args: {"y": args["height"], "v": 0.0 * args["height"]},
        vector_field=lambda t, y, args: {"y": y["v"], "v": -9.81 + 0.0 * y["y"]},
        events={
            "ground": ode.Event(
                lambda t, y, args: y["y"],
                direction=-1,
                reset=lambda t, y, args: {"y": 0.0 * y["y"], "v": -args["restitution"] * y["v"]},
            )
        },
    )
    random = np.random.default_rng(0)
    args = {"height": random.uniform(1, 5, lanes), "restitution": random.uniform(0.6, 0.95, lanes)}
    found: list[list[float]] = [[], [], []]
    for i in range(rounds + 1):
        for order in range(3):
            begin = time.process_time()
            wrt = "restitution" if order else ()
            end = ode.solve(ball, args, t1=1e3, max_events=10, wrt=wrt, derivatives=order)
            assert np.all(end.count == 10)
            if i:
                found[order].append(1e6 * (time.process_time() - begin) / lanes / 10)
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=list(CASES))
    parser.add_argument("--orders", nargs="+", type=int, default=[0, 1, 2])
    given = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    rows = []
    for name in given.only:
        for order in given.orders:
            more = lines(CASES[name], order, measured(CASES[name], order, given.rounds, given.quick))
            print("\n".join(" | ".join(row) for row in more), flush=True)
            rows += more
    print(table_text("problem: contender | rtol | µs a lane, median (min–max) | × | wrong | t, 99 %", rows))
    times = [[CASES[name].name, f"{states(CASES[name], given.rounds):.2f}"] for name in given.only]
    print(table_text("states at 100 times | over the end alone", times), flush=True)
    head = "first call after the imports | V, s | V, V′, V″, s"
    calls = [
        [CASES[case].name, *(f"{statistics.median(first_calls(case, order, given.rounds)):.2f}" for order in (0, 2))]
        for case in ("Ballistic", "ThreeBodies", "HodgkinHuxley")
    ]
    print(table_text(head, calls), flush=True)
    flights = bounces(2**14, given.rounds)
    texts = [f"{statistics.median(each):.2f} ({min(each):.2f}–{max(each):.2f})" for each in flights]
    print(table_text("µs a flight of ten bounces | V | V, V′ | V, V′, V″", [["ball", *texts]]))


if __name__ == "__main__":
    main()
