"""Processor time of a lane on one core: `erosion`, heyoka, diffrax and scipy by turns, each as exact as the others."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.contenders import Run, Solve, by_diffrax, by_erosion, by_heyoka, by_scipy, first
from benchmarks.impacts import RotatingImpact
from benchmarks.ode_problems import CASES, Case, Lanes, lanes_of
from benchmarks.page import Table
from benchmarks.timing import by_turns, warm

TITLE = "Speed beside others"
TEXT = """Random lanes, each integrated to its event: processor time of a lane by
erosion, warm, on one core, and the times of others over that. Each has the loosest tolerance at which 99 % of its
results (the volume of an impact, else the time of the event) are within 2e-9 of heyoka's at 1e-15 ("none": 1e-12 is
not enough); lanes with another event, or off by 1e-6, are wrong. "Refilled" replaces each lane of
heyoka's SIMD batch as soon as it has ended. diffrax is Dopri8 under `vmap`, and loses an event function that falls
below zero and returns within a step. scipy is DOP853; it does not leave the section on which the three bodies
begin."""

REFILLED = "heyoka, refilled"
RIGHT, FAR = 2e-9, 1e-6
TOLERANCES = (1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
WARM = 4.0  # seconds until optimised code runs


class Contender(NamedTuple):
    """One who computes.

    Args:
        name: in the table.
        lanes: how many are timed.
        solve: computes them.
    """

    name: str
    lanes: int
    solve: Solve


def contenders(case: Case, order: int, quick: bool) -> list[Contender]:
    """Those that compute so many derivatives."""
    scale = 8 if quick else 1
    rows = [
        Contender("erosion", 2**15 // scale, by_erosion(case, order)),
        Contender("heyoka", 2**12 // scale, by_heyoka(case, order)),
        Contender(REFILLED, 2**15 // scale, by_heyoka(case, order, batch=True)),
    ]
    if order == 0:
        rows.append(Contender("diffrax", 2**9 // scale, by_diffrax(case, "Dopri8", 64)))
        rows.append(Contender("scipy", 2**5 // scale, by_scipy(case, "DOP853")))
    return rows


def judged(run: Run, true: Run) -> tuple[int, float]:
    """How many lanes have another event or are off by 1e-6, and the error of 99 % of the others."""
    count = len(run.result)
    errors = np.abs(run.result / true.result[:count] - 1)
    right = (run.event == true.event[:count]) & (errors < FAR)
    return int((~right).sum()), float(np.percentile(errors[right], 99)) if right.any() else np.inf


def tolerance_of(solve: Solve, lanes: Lanes, true: Run) -> float | None:
    """The loosest that is exact enough."""
    return next((rtol for rtol in TOLERANCES if judged(solve(rtol, lanes), true)[1] <= RIGHT), None)


def compared(case: Case, order: int, rounds: int, quick: bool) -> tuple[list[Any], int]:
    """A row of the table, and how many lanes of erosion are wrong."""
    rows = {row.name: row for row in contenders(case, order, quick)}
    lanes = lanes_of(case, rows["erosion"].lanes)
    true = by_heyoka(case)(1e-15, lanes)
    tolerances = {
        name: tolerance_of(row.solve, first(lanes, min(row.lanes, 1024)), true)
        for name, row in rows.items()
        if name != REFILLED
    }
    tolerances[REFILLED] = tolerances["heyoka"]  # the same method
    last: dict[str, Run] = {}

    def measure(name: str) -> float:
        last[name] = rows[name].solve(tolerances[name] or RIGHT, first(lanes, rows[name].lanes))
        return last[name].seconds / rows[name].lanes

    able = [name for name in rows if tolerances[name]]
    for name in able:
        measure(name)
    warm(lambda: measure("erosion"), 0.5 if quick else WARM)
    times = by_turns({name: lambda name=name: measure(name) for name in able}, rounds)
    cells: list[Any] = [case.name, order, 1e6 * times["erosion"].median]
    for name in ("heyoka", REFILLED, "diffrax", "scipy"):
        if name not in able:
            cells.append("none" if name in rows else None)
            continue
        wrong, ratio = judged(last[name], true)[0], times[name].ratio
        cells.append(f"{ratio:,.3g} ({wrong / rows[name].lanes:.1%} wrong)" if wrong else ratio)
    return cells, judged(last["erosion"], true)[0]


def measure(quick: bool) -> Table:
    """All problems; two derivatives of the impact and of one other."""
    impact = RotatingImpact()
    plan: list[tuple[Case, int]] = [(impact, 0), (impact, 2)]
    if not quick:
        plan += [*((case, 0) for case in CASES.values()), (CASES["Lorenz"], 2)]
    rows, wrong = zip(*(compared(case, order, 2 if quick else 3, quick) for case, order in plan), strict=True)
    return Table(["problem", "derivatives", "erosion, µs", "heyoka", REFILLED, "diffrax", "scipy"], [*rows], sum(wrong))
