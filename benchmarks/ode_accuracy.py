"""Ends, times, states, integrals and derivatives of random lanes of six problems, against heyoka at 1e-15.

python -m benchmarks.ode_accuracy --lanes 100000
"""

import argparse
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.ode_heyoka import Ends, at_the_event, one_by_one
from benchmarks.ode_problems import CASES, NUMPY, Case, Lanes, lanes_of
from benchmarks.timing import table_text
from erosion import ode

JUDGE = 1e-15  # heyoka's tolerance
_ZERO = 1e-9  # of its size: a part that is zero by definition
_LEAST = 1e-5  # of its size: a part that decays to less need not be known relative to itself


class Errors(NamedTuple):
    """Of one problem and order: lanes with a wrong event, those without a result, and errors at 99 % and the greatest.

    Errors are relative; those of states, integrals and derivatives to the greater of the value and its median size.
    """

    wrong: int
    without: int
    time: tuple[float, float]
    parts: tuple[float, float]
    derivatives: list[tuple[float, float]]


def columns(case: Case, solution: ode.Solution, order: int, *, integral: bool) -> list[np.ndarray]:
    """What `at_the_event` gives, from a solution."""
    parts: list[Any] = [solution, *(solution.along(*[case.wrt] * i) for i in range(1, order + 1))]
    return [
        np.stack([part.t, *(part.y[name] for name in case.state)] + [part.integrals["integral"]] * integral, 1)
        for part in parts
    ]


def event_of(solution: ode.Solution, events: int) -> np.ndarray:
    """The index of each lane's event, -1 without one, -2 for no result."""
    names = np.asarray(solution.outcome)
    ended = np.where(names < events, names, -1)
    return np.where(np.isin(solution.ended_by, ("failed", "unfinished", "start")), -2, ended)


def relative(found: np.ndarray, true: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Errors of columns, relative to the greatest of the value, the column's median and a little of its size."""
    median = np.nanmedian(np.abs(true), axis=0)
    # What an event function fixes is zero there, or its derivative is.
    kept = (median > _ZERO * size) & (size > _ZERO * size.max())
    return np.abs(found - true)[:, kept] / np.maximum(np.abs(true), np.maximum(median, _LEAST * size))[:, kept]


def sizes_of(case: Case, lanes: Lanes, values: np.ndarray) -> np.ndarray:
    """Of time, state and integral: a part that decays to nothing is wanted relative to the size that it had."""
    begin = np.abs(np.stack([np.zeros(len(values)), *case.start(NUMPY, lanes), np.zeros(len(values))], 1))
    return np.median(np.maximum(begin, np.abs(values)), axis=0)


def at99(errors: np.ndarray) -> tuple[float, float]:
    """At 99 % of the lanes, and the greatest; of columns the worst."""
    errors = np.nan_to_num(errors, nan=np.inf).reshape(len(errors), -1).max(axis=1)
    return float(np.percentile(errors, 99)), float(errors.max(initial=0.0))


def judged(case: Case, lanes: Lanes, true: Ends, order: int, solution: ode.Solution) -> Errors:
    """The errors of a solution."""
    event = event_of(solution, len(case.directions))
    values = at_the_event(case, lanes, true, order, integral=True)
    found = columns(case, solution, order, integral=True)
    same = event == true.event
    time_errors = np.abs(found[0][same, 0] - values[0][same, 0]) / np.abs(values[0][same, 0])
    sizes = sizes_of(case, lanes, values[0])
    parts = [
        relative(a[same], b[same], sizes / np.median(np.abs(lanes[case.wrt])) ** i)
        for i, (a, b) in enumerate(zip(found, values, strict=True))
    ]
    return Errors(
        int((~same & (event != -2)).sum()),
        int((event == -2).sum()),
        at99(time_errors),
        at99(parts[0]),
        [at99(part) for part in parts[1:]],
    )


def checked_by_scipy(case: Case, p: dict[str, float], events: np.ndarray) -> tuple[int, float]:
    """The first event of one lane by DOP853 at 1e-13."""
    from scipy.integrate import solve_ivp

    functions = []
    for i, direction in enumerate(case.directions.values()):

        def function(t: float, s: np.ndarray, i: int = i) -> Any:
            return case.events(NUMPY, t, list(s), p)[i]

        function.direction = direction  # pyright: ignore[reportFunctionMemberAccess]
        functions.append(function)
    end = solve_ivp(
        lambda t, s: case.rates(NUMPY, t, list(s), p),
        (0.0, case.t1),
        [float(x) for x in case.start(NUMPY, p)],
        method="DOP853",
        rtol=1e-13,
        atol=1e-15,
        max_step=case.t1 / 2000,
        events=functions,
    )
    # An event at the start is the section on which the lane begins.
    times = [np.min(ts[ts > 1e-9], initial=np.inf) for ts in end.t_events]
    first = int(np.argmin(times))
    return (first, float(times[first])) if np.isfinite(times[first]) else (-1, case.t1)


def measured(names: list[str], count: int, orders: tuple[int, ...], derivative_lanes: int) -> Iterator[list[str]]:
    """A row for each problem and order."""
    for name in names:
        case = CASES[name]
        problem = case.problem(integral=True)
        for order in orders:
            lanes = lanes_of(case, count if order == 0 else derivative_lanes)
            begin = time.process_time()
            true = one_by_one(case, lanes, order, JUDGE, integral=True)
            judge = time.process_time() - begin
            options: dict[str, Any] = {"derivatives": order, "wrt": case.wrt if order else (), "smooth": True}
            solution = ode.solve(problem, lanes, t1=case.t1, **options)
            event = event_of(solution, len(case.directions))
            true, wrong_judge = _mended(case, lanes, true, event)
            errors = judged(case, lanes, true, order, solution)
            found = [*errors.derivatives, *[None] * (2 - order)]
            texts = [f"{each[0]:.1e} ({each[1]:.0e})" if each else "" for each in (errors.time, errors.parts, *found)]
            yield [
                f"{case.name}, {('V', 'V′', 'V″')[order]}",
                f"{len(true.event):,}",
                str(errors.wrong),
                str(errors.without),
                *texts,
                str(wrong_judge),
                f"{judge:.0f} s",
            ]


def _mended(case: Case, lanes: Lanes, true: Ends, event: np.ndarray) -> tuple[Ends, int]:
    """The judge's events where scipy agrees with them; where it does not, the judge is wrong."""
    wrong = 0
    truth = true.event.copy()
    for i in np.flatnonzero((event != true.event) & (event != -2)):
        first, when = checked_by_scipy(case, {key: float(value[i]) for key, value in lanes.items()}, event)
        print(f"    lane {i}: {event[i]}, heyoka {true.event[i]} at {true.t[i]:.12g}, scipy {first} at {when:.12g}")
        if first != true.event[i]:
            wrong, truth[i] = wrong + 1, -3 if first != event[i] else first
    kept = truth == true.event
    return true._replace(event=np.where(kept, true.event, truth)), wrong


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, default=100_000)
    parser.add_argument("--derivative-lanes", type=int, default=2000)
    parser.add_argument("--only", nargs="+", default=list(CASES))
    parser.add_argument("--orders", nargs="+", type=int, default=[0, 1, 2])
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows = []
    for row in measured(given.only, given.lanes, tuple(given.orders), given.derivative_lanes):
        print(" | ".join(row), flush=True)
        rows.append(row)
    head = (
        "problem | lanes | wrong | no result | t 99 % (max) | state, integral | first | second | heyoka wrong | judge"
    )
    print(table_text(head, rows))


if __name__ == "__main__":
    main()
