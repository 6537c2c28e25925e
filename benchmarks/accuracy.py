"""Errors of ends, times, states, integrals and derivatives of random lanes, against heyoka at 1e-15."""

from typing import Any

import numpy as np

import erosion
from benchmarks.contenders import by_scipy, event_of, event_of_impact, first
from benchmarks.heyoka_lanes import Ends, at_the_event, one_by_one
from benchmarks.impacts import RotatingImpact, volume_unit, with_units
from benchmarks.ode_problems import CASES, NUMPY, Case, Lanes, lanes_of
from benchmarks.page import Table
from erosion import ode

TITLE = "Accuracy"
TEXT = """At the default `rtol`, 1e-9: relative errors of 20,000 random lanes at their events against heyoka at 1e-15,
at 99 % of the lanes and at worst. The values are the volume of an impact, else the state and an integral; those that
pass through zero are relative to their median size. "Wrong" counts other events; where the two programs differ, scipy
at 1e-13 decides."""

_ZERO = 1e-9  # of its size: a part that is zero by definition
_LEAST = 1e-5  # of its size: a part that decays to less need not be known relative to itself

Columns = list[np.ndarray]


def of_problem(case: Case, lanes: Lanes, order: int) -> tuple[np.ndarray, Columns]:
    """Events, and for each derivative the columns of `at_the_event`, by `ode.solve`."""
    problem = case.problem(integral=True)
    wrt = case.wrt if order else ()
    solution = ode.solve(problem, lanes, t1=case.t1, derivatives=order, wrt=wrt, smooth=True)
    parts: list[Any] = [solution, *(solution.along(*[case.wrt] * i) for i in range(1, order + 1))]
    columns = [
        np.stack([part.t, *(part.y[name] for name in case.state), part.integrals["integral"]], 1) for part in parts
    ]
    return event_of(solution, len(case.directions)), columns


def of_impacts(lanes: Lanes, order: int) -> tuple[np.ndarray, Columns]:
    """The same by `erosion.impact`: the volume alone."""
    p = with_units(lanes)
    hits = erosion.impact("rotating", p, derivatives=order)
    volumes = [hits.volume, hits.dvolume, hits.d2volume][: order + 1]
    return event_of_impact(hits), [np.asarray(volume)[:, None] / volume_unit(p) for volume in volumes]


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


def errors(case: Case, lanes: Lanes, order: int) -> tuple[int, list[tuple[float, float]]]:
    """Lanes with a wrong event or none, and for each derivative the error at 99 % and the greatest."""
    true = one_by_one(case, lanes, order, 1e-15, integral=True)
    values = at_the_event(case, lanes, true, order, integral=True)
    sizes = sizes_of(case, lanes, values[0])
    if isinstance(case, RotatingImpact):
        event, found = of_impacts(lanes, order)
        column = [1 + case.state.index("volume")]
        values, sizes = [value[:, column] for value in values], sizes[column]
    else:
        event, found = of_problem(case, lanes, order)
    same = event == true.event
    by = np.median(np.abs(lanes[case.wrt]))
    parts = [
        relative(a[same], b[same], sizes / by**i).max(axis=1)
        for i, (a, b) in enumerate(zip(found, values, strict=True))
    ]
    return wrong(case, lanes, true, event), [(float(np.percentile(part, 99)), float(part.max())) for part in parts]


def wrong(case: Case, lanes: Lanes, true: Ends, event: np.ndarray) -> int:
    """How many lanes have another event than heyoka and scipy, or no result."""
    differ = np.flatnonzero(event != true.event)
    if not differ.size:
        return 0
    exact = by_scipy(case, "DOP853", max_step=case.t1 / 2000)
    decided = exact(1e-13, {name: values[differ] for name, values in lanes.items()})
    return int(np.sum(decided.event != event[differ]))


def measure(quick: bool) -> Table:
    """One row a problem: values of many lanes, derivatives of fewer."""
    count = 500 if quick else 20_000
    rows, total = [], 0
    for case in (RotatingImpact(), *CASES.values()):
        lanes = lanes_of(case, count)
        of_values, plain = errors(case, lanes, 0)
        of_derivatives, (_, slope, bend) = errors(case, first(lanes, count // 20), 2)
        total += of_values + of_derivatives
        pairs = [f"{error[0]:.1e}, {error[1]:.1e}" for error in (*plain, slope, bend)]
        rows.append([case.name, of_values + of_derivatives, *pairs])
    head = ["problem", "wrong", "values: 99 %, worst", "first derivatives", "second derivatives"]
    return Table(head, rows, total)
