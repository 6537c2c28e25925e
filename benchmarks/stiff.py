"""Processor time of a lane of stiff problems: `ode.solve`, scipy's Radau and diffrax' Kvaerno5 by turns."""

import numpy as np

from benchmarks.contenders import Run, Solve, by_diffrax, by_erosion, by_scipy, first
from benchmarks.ode_problems import Lanes
from benchmarks.page import Table
from benchmarks.stiff_problems import Ignition, Oregonator, Robertson, StiffCase, VanDerPol
from benchmarks.timing import by_turns, warm
from erosion import ode

TITLE = "Stiff problems"
TEXT = """Lanes that end at an event, at a tolerance of 1e-7: time of a lane by the Rosenbrock method, and the times of
others over it; `method="auto"` has to find out that lanes are stiff. Errors are the medians of those of the event's
time against Radau at 1e-12."""

RTOL, WARM = 1e-7, 4.0
CASES = (Robertson(), VanDerPol(), Oregonator(), Ignition())


def with_event(case: StiffCase, count: int) -> Lanes:
    """Random lanes that end at the event."""
    lanes = case.sample(4 * count, np.random.default_rng(34))
    ends = ode.solve(case.problem(), lanes, t1=case.t1, rtol=1e-5, method="rosenbrock", smooth=True).outcome == 0
    return first({name: values[ends] for name, values in lanes.items()}, count)


def measure(quick: bool) -> Table:
    """Each contender on as many lanes as it computes in a second or so."""
    rows = []
    for case in CASES[:1] if quick else CASES:
        lanes = with_event(case, 1000 if quick else 10_000)
        contenders: dict[str, tuple[int, Solve]] = {
            "erosion, rosenbrock": (len(lanes[case.wrt]), by_erosion(case, method="rosenbrock")),
            "erosion, auto": (len(lanes[case.wrt]), by_erosion(case, method="auto")),
            "erosion, first derivatives": (len(lanes[case.wrt]), by_erosion(case, 1, method="rosenbrock")),
            "scipy, Radau": (4, by_scipy(case, "Radau")),
            "diffrax, Kvaerno5": (4, by_diffrax(case, "Kvaerno5", 4)),
        }
        true = by_scipy(case, "Radau")(1e-12, first(lanes, 4)).result
        last: dict[str, Run] = {}

        def timed(
            name: str, contenders: dict[str, tuple[int, Solve]] = contenders, lanes: Lanes = lanes, last: dict = last
        ) -> float:
            count, solve = contenders[name]
            last[name] = solve(RTOL, first(lanes, count))
            return last[name].seconds / count

        for name in contenders:
            timed(name)
            if name.startswith("erosion"):
                warm(lambda name=name: timed(name), 0.2 if quick else WARM)
        times = by_turns({name: lambda name=name: timed(name) for name in contenders}, 2 if quick else 3)
        errors = [
            float(np.median(np.abs(last[name].result[:4] / true - 1)))
            for name in ("erosion, rosenbrock", "scipy, Radau", "diffrax, Kvaerno5")
        ]
        own, *others = times.values()
        rows.append([case.name, 1e6 * own.median, *(each.ratio for each in others), *errors])
    head = ["erosion, µs", "auto", "first derivatives", "scipy, Radau", "diffrax, Kvaerno5"]
    return Table(["problem", *head, "error", "Radau's", "Kvaerno5's"], rows)
