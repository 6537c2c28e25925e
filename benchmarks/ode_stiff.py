"""Processor time a lane on stiff problems: `ode.solve` by the Rosenbrock method, CVODE(S), Radau and Kvaerno5.

    python -m benchmarks.ode_stiff                        # the table; CVODE needs a C compiler and libsundials-dev
    python -m benchmarks.ode_stiff --plot docs/images/stiff-work-precision.svg   # of the table in RESULTS-ode.md
    python -m benchmarks.ode_stiff --check --lanes 2000   # the same events at 1e-5 as at 1e-9, errors of t and t′
    python -m benchmarks.ode_stiff --auto --lanes 2000    # "auto" beside both methods, of explicit problems as well

Contenders are measured by turns, each on lanes that end by the event; of each the least of some rounds counts. Errors
are the median of those of the event's time, against scipy's Radau at 1e-12 of the first lanes. What is compiled
is not counted.
"""

import argparse
import functools
import itertools
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.cvode import cvode
from benchmarks.ode_problems import CASES as EXPLICIT, JAX, NUMPY, Case, Lanes
from benchmarks.stiff_problems import CASES, Ignition, Oregonator, Robertson, StiffCase, VanDerPol
from benchmarks.timing import by_turns, table_text
from erosion import ode
from erosion.lanes import machine

TOLERANCES = (1e-5, 1e-7, 1e-9)
LABELS = {"t": "ode.solve", "CVODE": "CVODE, in C", "Radau": "scipy, Radau", "Kvaerno5": "diffrax, Kvaerno5"}


def radau(case: StiffCase, lanes: Lanes, rtol: float) -> np.ndarray:
    """When each lane ends by scipy's Radau; NaN where there is no event."""
    from scipy.integrate import solve_ivp

    count = len(lanes[case.wrt])
    t = np.full(count, np.nan)
    for i in range(count):
        p = {name: float(values[i]) for name, values in lanes.items()}

        def event(t: float, s: np.ndarray, p: Any = p) -> Any:
            return case.events(NUMPY, t, list(s), p)[0]

        event.direction, event.terminal = next(iter(case.directions.values())), True  # pyright: ignore[reportFunctionMemberAccess]
        end = solve_ivp(
            lambda t, s, p=p: case.rates(NUMPY, t, list(s), p),
            (0.0, case.t1),
            [float(s) for s in case.start(NUMPY, p)],
            method="Radau",
            rtol=rtol,
            atol=rtol * case.absolute,
            events=event,
        )
        if len(end.t_events[0]):
            t[i] = end.t_events[0][-1]
    return t


@functools.cache
def _problem(case: StiffCase) -> ode.Problem:
    return case.problem()


def ours(case: StiffCase, lanes: Lanes, rtol: float, order: int = 0) -> ode.Solution:
    """`ode.solve`."""
    wrt = case.wrt if order else ()
    return ode.solve(
        _problem(case),
        lanes,
        t1=case.t1,
        rtol=rtol,
        method="rosenbrock",
        smooth=True,
        wrt=wrt,
        derivatives=order,
        max_steps=100_000,  # at 1e-12
    )


def time_of(end: ode.Solution) -> np.ndarray:
    """Of the event; NaN where there is none."""
    return np.where(end.outcome == 0, end.t, np.nan)


@functools.cache
def kvaerno(case: StiffCase) -> Callable[[Lanes, float], Any]:
    """Times of events by diffrax under jit and vmap."""
    import diffrax
    import optimistix as optx

    (direction,) = case.directions.values()

    def lane(p: Any, rtol: Any) -> Any:
        end = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: jnp.stack([jnp.asarray(r) for r in case.rates(JAX, t, list(y), p)])),
            diffrax.Kvaerno5(),
            t0=0.0,
            t1=case.t1,
            dt0=None,
            y0=jnp.stack([jnp.asarray(s, float) for s in case.start(JAX, p)]),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * case.absolute),
            event=diffrax.Event(
                lambda t, y, args, **_: case.events(JAX, t, list(y), p)[0],
                optx.Newton(1e-9, 1e-9),
                direction=None if direction == 0 else direction > 0,
            ),
            max_steps=20_000,
            throw=False,
        )
        assert end.ts is not None
        return jnp.where(jax.tree.leaves(end.event_mask)[0], end.ts[-1], jnp.nan)

    program = jax.jit(jax.vmap(lane, (0, None)))

    def run(lanes: Lanes, rtol: float) -> np.ndarray:
        return np.asarray(program({name: jnp.asarray(v) for name, v in lanes.items()}, rtol))

    return run


def first(lanes: Lanes, count: int) -> Lanes:
    """The first lanes."""
    return {name: values[:count] for name, values in lanes.items()}


def with_event(case: StiffCase, count: int) -> Lanes:
    """Random lanes that end by the event."""
    lanes = case.sample(4 * count, np.random.default_rng(34))
    ends = ours(case, lanes, 1e-5).outcome == 0
    return first({name: values[ends] for name, values in lanes.items()}, count)


class Entrant(NamedTuple):
    """Who computes times of events.

    Args:
        lanes: how many are measured at once.
        run: times of lanes at a tolerance.
    """

    lanes: int
    run: Callable[[StiffCase, Lanes, float], Any]


CONTENDERS = {
    "t": Entrant(20_000, lambda case, lanes, rtol: time_of(ours(case, lanes, rtol))),
    "t, t′": Entrant(20_000, lambda case, lanes, rtol: time_of(ours(case, lanes, rtol, 1))),
    "t, t′, t″": Entrant(20_000, lambda case, lanes, rtol: time_of(ours(case, lanes, rtol, 2))),
    "CVODE": Entrant(100, lambda case, lanes, rtol: cvode(case, rtol, rtol * case.absolute)(lanes)[0]),
    "CVODES, t′": Entrant(100, lambda case, lanes, rtol: cvode(case, rtol, rtol * case.absolute, 1)(lanes)[0]),
    "Radau": Entrant(8, radau),
    "Kvaerno5": Entrant(8, lambda case, lanes, rtol: kvaerno(case)(lanes, rtol)),
}
SELDOM = ("Radau", "Kvaerno5")


def work(
    case: StiffCase, lanes: Lanes, keys: Sequence[tuple[str, float]], rounds: int
) -> tuple[dict[tuple[str, float], float], dict[tuple[str, float], np.ndarray]]:
    """Millionths of a second of processor time a lane by contender and tolerance, and the times of the first lanes."""
    times: dict[tuple[str, float], np.ndarray] = {}

    def measured(key: tuple[str, float]) -> Callable[[], float]:
        name, rtol = key
        most, run = CONTENDERS[name]
        some = first(lanes, most)

        def measure() -> float:
            begin = time.process_time()
            t = run(case, some, rtol)
            times[key] = np.asarray(t)
            return 1e6 * (time.process_time() - begin) / len(t)

        return measure

    for name in dict.fromkeys(name for name, _ in keys):  # compiles
        if name != "Radau":
            CONTENDERS[name].run(case, first(lanes, 8), 1e-3)
    spent = by_turns({key: measured(key) for key in keys}, rounds, seldom=[key for key in keys if key[0] in SELDOM])
    return {key: min(each) for key, each in spent.items()}, times


def errors(times: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Relative ones of the lanes that both have."""
    count = min(len(times), len(true))
    return np.abs(times[:count] / true[:count] - 1)


def table(cases: Sequence[StiffCase], names: Sequence[str], lanes: int, true_lanes: int, rounds: int) -> str:
    """Costs and errors, by problem and tolerance."""
    judged = [name for name in LABELS if name in names]
    rows = []
    for case in cases:
        some = with_event(case, lanes)
        true = radau(case, first(some, true_lanes), 1e-12)
        micro, times = work(case, some, [(name, rtol) for rtol in TOLERANCES for name in names], rounds)
        for rtol in TOLERANCES:
            row = [f"{case.name}, {rtol:.0e}", *(f"{float(f'{micro[name, rtol]:.3g}'):,g}" for name in names)]
            row += [f"{np.median(errors(times[name, rtol], true)):.0e}" for name in judged]
            rows.append(row)
            print("  ".join(row), file=sys.stderr, flush=True)
    return table_text(" | ".join(["problem", *names, *(f"error of {name}" for name in judged)]), rows)


def check(case: StiffCase, count: int, true_lanes: int) -> list[str]:
    """A line of the table of errors: the same events, t against Radau, t′ against differences."""
    lanes = case.sample(count, np.random.default_rng(36))
    loose, usual = (ours(case, lanes, rtol, 1) for rtol in (1e-5, 1e-9))
    other = int(np.sum((loose.outcome != usual.outcome) | np.isin(usual.ended_by, ("failed", "unfinished"))))
    apart = np.nanmax(np.abs(time_of(loose) / time_of(usual) - 1))
    ends = usual.outcome == 0
    some = first({name: values[ends] for name, values in lanes.items()}, true_lanes)
    true = errors(time_of(usual)[ends][:true_lanes], radau(case, some, 1e-12))
    row = [case.name, f"{int(ends.sum()):,}", str(other), f"{apart:.0e}", largest(true)]
    row += differences(case, lanes, usual)
    print("  ".join(row), file=sys.stderr, flush=True)
    return row


def differences(case: StiffCase, lanes: Lanes, usual: ode.Solution) -> list[str]:
    """Errors of t′ against central differences of 4th order of our own times at 1e-12, and lanes without any.

    A wide step errs where times bend, as beside lanes without an event, a narrow one by rounding: the nearer counts.
    """
    ends, found = usual.outcome == 0, np.asarray(usual.along(case.wrt).t)
    error = np.full(ends.shape, np.inf)
    for h in (1e-3, 3e-5):
        steps = {
            n: time_of(ours(case, lanes | {case.wrt: lanes[case.wrt] * (1 + n * h)}, 1e-12)) for n in (-2, -1, 1, 2)
        }
        slope = (8 * (steps[1] - steps[-1]) - (steps[2] - steps[-2])) / (12 * h * lanes[case.wrt])
        error = np.fmin(error, np.abs(found / slope - 1))
    return [largest(error[ends]), str(int(np.isinf(error[ends]).sum()))]


def largest(errors: np.ndarray) -> str:
    """The median, that of 99 %, and the greatest."""
    return "/".join(f"{each:.0e}" for each in np.nanquantile(errors, (0.5, 0.99, 1.0)))


def auto(case: Case, count: int, rounds: int) -> list[list[str]]:
    """What "auto" costs beside the better of both methods, and how many of its lanes end otherwise than at 1e-11."""
    problem, lanes = case.problem(), case.sample(count, np.random.default_rng(38))

    def solved(method: str, rtol: float, order: int, lanes: Lanes = lanes) -> ode.Solution:
        wrt = case.wrt if order else ()
        return ode.solve(problem, lanes, t1=case.t1, rtol=rtol, method=method, smooth=True, wrt=wrt, derivatives=order)

    def measure(method: str, rtol: float, order: int, lanes: Lanes) -> float:
        begin = time.process_time()
        solved(method, rtol, order, lanes)
        return 1e6 * (time.process_time() - begin) / len(lanes[case.wrt])

    true = solved("auto", 1e-11, 0).outcome
    rows = []
    for order, rtol in itertools.product((0, 1), (1e-6, 1e-9)):
        end = solved("auto", rtol, order)
        row = [
            f"{case.name}, {rtol:.0e}" + ", t′" * order,
            f"{np.mean(np.asarray(end.stiff, bool)):.0%}",
            str(np.sum(end.outcome != true)),
        ]
        few = first(lanes, 64)
        explicit = solved("explicit", rtol, order, few)
        many = {"auto": lanes, "rosenbrock": lanes, "explicit": few if np.any(np.asarray(end.stiff)) else lanes}
        spent = by_turns(
            {name: functools.partial(measure, name, rtol, order, some) for name, some in many.items()}, rounds
        )
        least = {name: min(each[1:]) for name, each in spent.items()}  # the first may compile
        if np.any(np.isin(explicit.ended_by, "unfinished")):
            del least["explicit"]
        row += [f"{least[name]:.3g}" if name in least else "–" for name in ("explicit", "rosenbrock", "auto")]
        row.append(f"{least['auto'] / min(least[name] for name in least if name != 'auto'):.2f}")
        rows.append(row)
        print("  ".join(row), file=sys.stderr, flush=True)
    return rows


def measured(file: Path) -> dict[str, dict[str, list[float]]]:
    """By problem and column the numbers of the table in a file of results; NaN where there is none."""
    columns: list[str] = []
    found: dict[str, dict[str, list[float]]] = {}
    for line in file.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        if cells[0] == "problem" and "error of CVODE" in cells:
            columns = cells[1:]
        elif columns and len(cells) == len(columns) + 1:
            problem = found.setdefault(cells[0].rpartition(", ")[0], {name: [] for name in columns})
            for name, cell in zip(columns, cells[1:], strict=True):
                problem[name].append(float(cell.replace(",", "")) if cell[0].isdigit() else float("nan"))
        elif not line.startswith("|--"):
            columns = []
    return found


def plot(file: Path) -> None:
    """Draw work and precision of four problems, as they are in the results."""
    from erosion.plotting.style import house_style, new_figure, save_plot

    problems = measured(Path(__file__).with_name("RESULTS-ode.md"))
    figure = new_figure(7.2, 5.6)
    with house_style():
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for case, panel in zip((Robertson, VanDerPol, Oregonator, Ignition), panels.flat, strict=True):
            columns = problems[case.name]
            for name, label in LABELS.items():
                panel.loglog(columns[name], columns[f"error of {name}"], "o-", label=label, markersize=4)
            panel.set_title(case.name, fontsize=10)
        for panel in panels[-1]:
            panel.set_xlabel("processor time of a lane in µs")
        for panel in panels[:, 0]:
            panel.set_ylabel("relative error of t")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        save_plot(figure, file)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=20_000)
    parser.add_argument("--true", type=int, default=8, help="lanes that scipy computes at 1e-12")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--check", action="store_true", help="errors in place of costs")
    parser.add_argument("--auto", action="store_true", help='what "auto" costs beside the better method')
    parser.add_argument("--plot", type=Path, help="draw the table of the results: work and precision")
    parser.add_argument("--contenders", nargs="+", default=list(CONTENDERS), choices=list(CONTENDERS))
    parser.add_argument("cases", nargs="*", help=", ".join(CASES))
    given = parser.parse_args()
    every: dict[str, Case] = {**EXPLICIT, **CASES}
    cases = [] if given.auto else [CASES[name] for name in given.cases or CASES]
    if given.plot:
        plot(given.plot)
    elif given.auto:
        machine._LONG = 0  # no quick code: which of the two a turn meets would be chance
        found = [auto(case, given.lanes, given.rounds) for case in (every[name] for name in given.cases or every)]
        head = "problem | stiff | other events | explicit | rosenbrock | auto | auto over the better"
        print(table_text(head, list(itertools.chain(*found))))
    elif given.check:
        head = (
            "problem | events | other outcomes | t, 1e-5 to 1e-9 | t against Radau | t′ against differences | without"
        )
        print(table_text(head, [check(case, given.lanes, given.true) for case in cases]))
    else:
        print(table(cases, given.contenders, given.lanes, given.true, given.rounds))


if __name__ == "__main__":
    main()
