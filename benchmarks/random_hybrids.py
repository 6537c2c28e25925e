"""Random problems with random events against DOP853: `python -m benchmarks.random_hybrids --structures 60 --lanes 50`.

A structure is one program: a system, a forcing, a switch of the state, one to three events with directions and resets.
Some have doses at given times, two of them at once, a second event that happens together with the first, events that
go on, a start on an event, or a start at rest. Its lanes differ in their numbers. The reference integrates each lane by
scipy's DOP853 (rtol 1e-12, a new start at each break in t), samples every event function 20,000 times, and refines
zeros by Brent's method. A lane has no sure answer where an event function comes near zero without crossing it, or where
two events nearly coincide by chance: it is left out.

A lane is wrong if `ode.solve` ends it by another event, or at a time or state that differs by more than `--limit`, and
neither its outcome nor `inexact` says so. `--derivatives` also compares first derivatives with central differences of
fourth order of values at rtol 1e-12. A lane whose outcome or count of events changes within 2e-3 of its numbers is left
out there.
"""

import argparse
import collections
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from erosion import ode

Rates = Callable[[Any, Any, Any, Mapping[str, Any]], list]
"""(numpy or jax.numpy, t, state, numbers) → rates."""
Function = Callable[[Any, Any, Any, Mapping[str, Any]], Any]
"""(numpy or jax.numpy, t, state, numbers) → a number."""
Reset = Callable[[Any], list]

SAMPLES = 20_000
SURE = 1e-5
"""An event function whose local extremum is nearer to zero than this share of its range has no sure answer."""


@dataclass
class Happening:
    """An event of a structure: its function, or the number that is its time."""

    function: Function | None
    direction: int
    reset: Reset | None
    kind: str
    time: str = ""
    ends: bool = True
    """Without a reset; else it is recorded, and the motion goes on."""

    def event(self) -> ode.Event:
        """It, for `ode.solve`."""
        reset, function = self.reset, self.function
        after = None if reset is None else lambda t, y, args: reset(y)
        terminal = None if self.ends else False
        if function is None:
            return ode.Event(times=lambda args: args[self.time], reset=after, terminal=terminal)
        return ode.Event(lambda t, y, args: function(jnp, t, y, args), self.direction, reset=after, terminal=terminal)


@dataclass
class Structure:
    """One program and the ranges of its numbers."""

    system: str
    forcing: str
    switch: str
    rates: Rates
    start: tuple[tuple[float, float], ...]
    ranges: dict[str, tuple[float, float]]
    events: dict[str, Happening]
    t1: float
    max_events: int | None
    breaks: tuple[str, ...] = ()
    starts: str = "wait"
    together: bool = False
    """Whether the second event happens wherever the first does."""

    @property
    def label(self) -> str:
        """What makes it hard."""
        kinds = "+".join(sorted({("reset " if e.reset else "") + e.kind for e in self.events.values()}))
        more = ", together" * self.together + f", {self.starts}" * (self.starts != "wait")
        return f"{self.system}, {self.forcing}, {self.switch}, {kinds}{more}"

    def problem(self) -> ode.Problem:
        """The structure for `ode.solve`; the start is a function of the numbers."""
        size = len(self.start)
        return ode.Problem(
            y0=lambda args: [args[f"s{i}"] for i in range(size)],
            vector_field=lambda t, y, args: self.rates(jnp, t, y, args),
            events={name: each.event() for name, each in self.events.items()},
        )


SYSTEMS: dict[str, tuple[Rates, tuple[tuple[float, float], ...], dict[str, tuple[float, float]], tuple[int, int]]] = {
    "oscillator": (
        lambda xp, t, y, p: [y[1], -(p["w"] ** 2) * y[0] - p["c"] * y[1]],
        ((-1.0, 1.0), (-1.0, 1.0)), {"w": (0.5, 3.0), "c": (0.0, 0.5)}, (0, 1),
    ),
    "pendulum": (
        lambda xp, t, y, p: [y[1], -xp.sin(y[0]) - p["c"] * y[1]],
        ((-2.0, 2.0), (-1.5, 1.5)), {"c": (0.0, 0.4)}, (0, 1),
    ),
    "predator": (
        lambda xp, t, y, p: [y[0] * (p["w"] - y[1]), y[1] * (y[0] - p["c"] - 0.5)],
        ((0.3, 2.0), (0.3, 2.0)), {"w": (0.5, 1.5), "c": (0.0, 0.8)}, (0, 1),
    ),
    "ballistic": (
        lambda xp, t, y, p: [y[2], y[3], -p["c"] * xp.hypot(y[2], y[3]) * y[2],
                             -1.0 - p["c"] * xp.hypot(y[2], y[3]) * y[3]],
        ((-1.0, 1.0), (0.2, 1.0), (0.5, 2.0), (0.5, 3.0)), {"c": (0.01, 0.3)}, (1, 3),
    ),
    "decay": (
        lambda xp, t, y, p: [-p["w"] * y[0], p["w"] * y[0] - p["c"] * y[1], p["c"] * y[1] - 0.3 * y[2]],
        ((0.5, 2.0), (0.0, 1.0), (0.0, 1.0)), {"w": (0.2, 2.0), "c": (0.1, 1.0)}, (0, 1),
    ),
    "duffing": (
        lambda xp, t, y, p: [y[1], y[0] - y[0] ** 3 - p["c"] * y[1]],
        ((-1.5, 1.5), (-1.0, 1.0)), {"c": (0.0, 0.3)}, (0, 1),
    ),
}  # fmt: skip

FORCINGS: dict[str, tuple[Function, dict[str, tuple[float, float]], tuple[str, ...]]] = {
    "free": (lambda xp, t, y, p: 0.0, {}, ()),
    "sine": (lambda xp, t, y, p: p["A"] * xp.sin(p["W"] * t), {"A": (0.2, 1.5), "W": (0.3, 6.0)}, ()),
    "step": (lambda xp, t, y, p: xp.where(t < p["b1"], 0.0, p["A"]), {"A": (-1.5, 1.5), "b1": (1.0, 6.0)}, ("b1",)),
    "pulse": (
        lambda xp, t, y, p: xp.where((t > p["b1"]) & (t < p["b1"] + p["d"]), p["A"] / p["d"], 0.0),
        {"A": (0.2, 1.0), "b1": (1.0, 6.0), "d": (0.005, 0.5)}, ("b1", "b1+d"),
    ),
    "ramp": (lambda xp, t, y, p: p["A"] * xp.maximum(t - p["b1"], 0.0), {"A": (-0.5, 0.5), "b1": (1.0, 6.0)}, ("b1",)),
}  # fmt: skip

SWITCHES: dict[str, Function] = {
    "smooth": lambda xp, t, y, p: 0.0,
    "abs": lambda xp, t, y, p: -0.5 * xp.abs(y[0] - p["q"]),
    "hinge": lambda xp, t, y, p: -2.0 * xp.maximum(y[0] - p["q"], 0.0),
    "jump": lambda xp, t, y, p: xp.where(y[0] > p["q"], -0.5, 0.3),
}


def level(i: int, j: int, n: int, speed: float) -> Function:
    """A state reaches a level."""
    return lambda xp, t, y, p: y[i] - p[f"l{n}"]


def sine_of_state(i: int, j: int, n: int, speed: float) -> Function:
    """A sine of a state reaches a level: many crossings, faster than the state."""
    return lambda xp, t, y, p: xp.sin(speed * y[i] - p[f"h{n}"]) - p[f"l{n}"]


def sine_of_time(i: int, j: int, n: int, speed: float) -> Function:
    """A sine of t reaches a level."""
    return lambda xp, t, y, p: xp.sin(4.0 * speed * t - p[f"h{n}"]) - p[f"l{n}"]


def product(i: int, j: int, n: int, speed: float) -> Function:
    """The product of two states reaches a level."""
    return lambda xp, t, y, p: y[i] * y[j] - p[f"l{n}"]


def circle(i: int, j: int, n: int, speed: float) -> Function:
    """Two states enter or leave a circle."""
    return lambda xp, t, y, p: (y[i] - p[f"l{n}"]) ** 2 + (y[j] - 0.3) ** 2 - 0.16


def turned(n: int) -> Reset:
    """State n changes its sign and loses a part."""
    return lambda y: [-0.7 * each if k == n else each for k, each in enumerate(y)]


def lifted(n: int) -> Reset:
    """State n is raised."""
    return lambda y: [each + 0.4 if k == n else each for k, each in enumerate(y)]


def drawn(seed: int) -> Structure:
    """A structure that is random, and the same for the same seed."""
    dice = np.random.default_rng(seed)
    system = str(dice.choice(list(SYSTEMS)))
    forcing = str(dice.choice(list(FORCINGS), p=[0.4, 0.15, 0.15, 0.15, 0.15]))
    switch = str(dice.choice(list(SWITCHES), p=[0.55, 0.15, 0.15, 0.15]))
    if system in ("predator", "decay"):  # a jump of their rates could hold an amount at the switch
        forcing, switch = "free", "smooth"
    rates, start, ranges, (position, velocity) = SYSTEMS[system]
    (force, force_ranges, breaks), extra = FORCINGS[forcing], SWITCHES[switch]

    def total(xp: Any, t: Any, y: Any, p: Mapping[str, Any]) -> list:
        all_rates = list(rates(xp, t, y, p))
        all_rates[velocity] = all_rates[velocity] + force(xp, t, y, p) + extra(xp, t, y, p)
        return all_rates

    ranges = ranges | force_ranges | {"q": (-0.5, 0.5)}
    if forcing in ("step", "pulse", "ramp") and system in ("oscillator", "pendulum", "duffing") and dice.random() < 0.3:
        start, switch = ((0.0, 0.0),) * 2, switch + " at rest"  # until the forcing begins, unless the switch moves it
    events: dict[str, Happening] = {}
    chained = bool(dice.random() < 0.4)
    for index in range(int(dice.integers(1, 4))):
        make = (level, sine_of_state, sine_of_time, product, circle)[dice.choice(5, p=[0.35, 0.2, 0.2, 0.1, 0.15])]
        i, j = (int(n) for n in dice.choice(len(start), 2, replace=False))
        speed = float(np.exp(dice.uniform(0.0, math.log(15.0))))
        ranges[f"l{index}"], ranges[f"h{index}"] = (-0.9, 0.9), (0.0, 6.28)
        reset = (turned(velocity), lifted(position))[dice.integers(2)] if chained and index == 0 else None
        direction = int(dice.choice([-1, 0, 1]))
        events[f"e{index}"] = Happening(make(i, j, index, speed), direction, reset, make.__name__.replace("_", " "))
    structure = Structure(
        system, forcing, switch, total, start, ranges, events, float(dice.uniform(6.0, 20.0)),
        int(dice.integers(2, 6)) if chained else None, breaks,
    )  # fmt: skip
    if chained:
        _add_events(structure, dice, position, velocity)
    return structure


def _add_events(structure: Structure, dice: np.random.Generator, position: int, velocity: int) -> None:
    """Some of: a second event that happens with the first, one that goes on, doses, a start on the first event."""
    events, ranges = structure.events, structure.ranges
    first = events["e0"]
    if dice.random() < 0.3:
        # Its reset must leave the first event's function at zero, or it would not happen as well.
        index, other = (position, velocity) if dice.random() < 0.5 else (velocity, position)
        factor, direction = float(dice.uniform(0.5, 3.0)), first.direction or -1
        once = Happening(lambda xp, t, y, p: y[index] - p["l0"], direction, lifted(other), "level")
        reset = (lifted(other), turned(other))[dice.integers(2)]
        again = Happening(lambda xp, t, y, p: factor * (y[index] - p["l0"]), direction, reset, "level")
        rest = {name: each for name, each in events.items() if name != "e0"}
        structure.together = True
        events.clear()
        events.update({"e0": once, "twin": again} | rest)
    if dice.random() < 0.3 and "e1" in events:
        events["e1"].ends = False
    for index in range(int(dice.choice(3, p=[0.5, 0.25, 0.25]))):
        ranges["d0"] = (0.5, structure.t1 - 0.5)
        events[f"dose{index}"] = Happening(None, 0, lifted((position, velocity)[index]), "dose", time="d0", ends=False)
    if dice.random() < 0.25 and events["e0"].direction and not structure.together:
        structure.starts = "fire"


def numbers_of(structure: Structure, count: int, seed: int) -> dict[str, np.ndarray]:
    """Random numbers of each lane, the start among them."""
    dice = np.random.default_rng([seed, 1])
    ranges = structure.ranges | {f"s{i}": each for i, each in enumerate(structure.start)}
    return {name: dice.uniform(low, high, count) for name, (low, high) in ranges.items()}


@dataclass
class Truth:
    """How a lane ends, by the reference; `sure` is False where a graze or a coincidence leaves it open."""

    outcome: str
    t: float
    y: np.ndarray
    sure: bool = True


def piece(structure: Structure, p: Mapping[str, float], begin: float, end: float, state: np.ndarray) -> Any:
    """The solution of scipy between two breaks in t; the rates at its ends are those inside it."""
    low, high = begin + 1e-13 * (end - begin), end - 1e-13 * (end - begin)
    return solve_ivp(
        lambda t, y: structure.rates(np, min(max(t, low), high), y, p),
        (begin, end), state, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True, max_step=0.05,
    )  # fmt: skip


def falls(row: np.ndarray, direction: int) -> np.ndarray:
    """Where a sampled event function crosses zero in its direction, once it has been on the side before its event."""
    crossings = []
    for sign in (-1, 1):
        if direction in (0, sign):
            h = -sign * row
            h = np.where((np.arange(h.size) == 0) & (np.abs(h) <= 1e-9 * max(np.ptp(h), 1e-12)), 0.0, h)
            crossings.append(np.flatnonzero((h[:-1] > 0) & (h[1:] <= 0)))
    return np.sort(np.concatenate(crossings))


def grazes(row: np.ndarray, until: int) -> bool:
    """Whether a sampled function comes near zero without crossing it, or starts near it, before a sample."""
    near, size = SURE * max(np.ptp(row), 1e-12), np.abs(row[1:-1])
    least = (size <= np.abs(row[:-2])) & (size <= np.abs(row[2:])) & (row[:-2] * row[2:] > 0)
    return bool((size[: until + 3][least[: until + 3]] < near).any() or 1e-4 * near < abs(row[0]) < near)


def reference(structure: Structure, p: Mapping[str, float]) -> Truth:
    """A lane by DOP853."""
    names, events = list(structure.events), list(structure.events.values())
    most = structure.max_events or math.inf
    t, y, count, sure = 0.0, np.array([p[f"s{i}"] for i in range(len(structure.start))]), 0, True
    breaks = sorted({p["b1"] if each == "b1" else p["b1"] + p["d"] for each in structure.breaks})
    at_start = [
        index for index, each in enumerate(events)
        if each.function is not None and each.direction and each.direction * each.function(np, t, y, p) >= 0.0
    ]  # fmt: skip
    happens = at_start if structure.starts == "fire" else []
    while True:
        before = y
        for place, index in enumerate(happens):
            event = events[index]
            if event.function is not None and t == 0.0:
                # At the start the reset of one event may take another back.
                sure &= event.direction * event.function(np, t, y, p) >= 0.0
            elif event.function is not None and place:
                # Of events at once those happen whose functions pass zero still after the resets before them.
                later = y + 1e-6 * np.array(structure.rates(np, t, y, p))
                passed = event.function(np, t + 1e-6, later, p) - event.function(np, t, y, p)
                if event.direction * passed <= 0.0:
                    continue
            count += 1
            if (event.reset is None and event.ends) or count == most:
                return Truth(names[index], t, y, sure)
            y = y if event.reset is None else np.array([float(each) for each in event.reset(y)])
        # A reset that takes another function across zero may fire that event at once.
        sides = [
            [each.function(np, t, state, p) for state in (before, y)]
            for index, each in enumerate(events)
            if each.function is not None and index not in happens
        ]
        sure &= not happens or all(one * other > 0 or one == other for one, other in sides)
        times, values, pieces, begin, state = [], [], [], t, y
        doses = sorted(p[each.time] for each in events if each.time and p[each.time] > t)
        until = doses[0] if doses else structure.t1
        for end in [*(each for each in breaks if t < each < until), until]:
            made = piece(structure, p, begin, end, state)
            if not made.success or not np.abs(made.y).max() < 1e6:
                return Truth("none", math.nan, y, sure=False)
            samples = np.linspace(begin, end, max(int(SAMPLES * (end - begin) / structure.t1), 200))
            rows = made.sol(samples)
            times.append(samples)
            values.append([
                np.ones(samples.shape) if each.function is None
                else np.broadcast_to(each.function(np, samples, rows, p), samples.shape)
                for each in events
            ])  # fmt: skip
            pieces.append((end, made.sol))
            begin, state = end, made.y[:, -1]
        time, sampled = np.concatenate(times), np.concatenate(values, 1)

        def at(now: float, pieces: Any = pieces) -> np.ndarray:
            return next(sol for end, sol in pieces if now <= end)(now)

        found = [(until, index) for index, each in enumerate(events) if each.time and p[each.time] == until]
        for index, event in enumerate(events):
            if event.function is None:
                continue
            crossing = falls(sampled[index], event.direction)
            sure &= not grazes(sampled[index], int(crossing[0]) if crossing.size else time.size)
            if crossing.size:
                low, high = time[crossing[0]], time[crossing[0] + 1]
                zero = brentq(
                    lambda now, event=event, at=at: event.function(np, now, at(now), p), low, high, xtol=1e-14
                )
                found.append((zero, index))
        if not found:
            return Truth("t1", structure.t1, state, sure)
        t = min(found)[0]
        happens = sorted(index for each, index in found if each - t <= 1e-11)
        pair = [n for n in happens if names[n] in ("e0", "twin")] if structure.together else []
        allowed = pair if len(pair) == 2 else [n for n in happens if events[n].time]
        sure &= happens == allowed or len(happens) == 1
        sure &= all(
            abs(t - each) > 1e-6 for each in [*(other for other, n in found if n not in happens), structure.t1, *breaks]
        )
        y = at(t)


def checked_derivatives(
    structure: Structure, numbers: dict[str, np.ndarray], options: dict[str, Any], end: ode.Solution
) -> collections.Counter[str]:
    """How many first derivatives of time and state agree with differences of values."""
    totals: collections.Counter[str] = collections.Counter()
    lanes, problem = next(iter(numbers.values())).size, structure.problem()
    names = ["s0", *(each for each in ("d0", "b1", "l0", "A", "w", "c") if each in numbers)][:4]
    along = ode.solve(problem, numbers, wrt=tuple(names), **options)
    said = np.broadcast_to(along.inexact, lanes)
    # Where two steps give unlike differences the lane has a kink nearby, or bends too much for them.
    steps = np.array([1e-3, 2e-4])[:, None, None]
    for name in names:
        places = np.array([-2.0, -1.0, 1.0, 2.0])[:, None] * steps
        shape = (2, 4, lanes)
        moved = {key: np.broadcast_to(each, shape) for key, each in numbers.items()} | {name: numbers[name] + places}
        stencil = ode.solve(problem, moved, rtol=1e-12, **options)
        outcomes = np.asarray(end.ended_by, str)
        same = (np.asarray(stencil.ended_by, str) == outcomes).all((0, 1))
        same &= (np.broadcast_to(stencil.count, shape) == end.count).all((0, 1))
        same &= ~np.isin(outcomes, ("failed", "unfinished", "start"))
        given = along.along(name)
        for got, value in zip([given.t, *given.y], [stencil.t, *stencil.y], strict=True):
            values = np.broadcast_to(value, shape)
            wide, near = (np.array([1.0, -8.0, 8.0, -1.0])[:, None] * values / (12 * steps)).sum(1)
            size = 1.0 + np.abs(near)
            known = same & np.isfinite(near) & (np.abs(wide - near) < 1e-6 * size)
            missing = known & np.isnan(got)
            wrong = known & (np.abs(got - near) > 1e-5 * size)
            totals["derivatives right"] += int((known & ~missing & ~wrong).sum())
            totals["derivatives NaN"] += int(missing.sum())
            totals["derivatives inexact"] += int((wrong & said).sum())
            totals["derivatives wrong"] += int((wrong & ~said).sum())
            for lane in np.flatnonzero(wrong & ~said):
                print(f"lane {lane}, by {name}: {np.broadcast_to(got, lanes)[lane]} for {near[lane]}", flush=True)
    return totals


def main() -> None:
    """Print a line for each structure with wrong lanes, and the totals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--structures", type=int, default=60)
    parser.add_argument("--lanes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=1e-6)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--derivatives", action="store_true")
    asked = parser.parse_args()
    totals: collections.Counter[str] = collections.Counter()
    rows = []
    for seed in range(asked.seed, asked.seed + asked.structures):
        structure = drawn(seed)
        numbers = numbers_of(structure, asked.lanes, seed)
        options = {"t1": structure.t1, "max_events": structure.max_events, "start": structure.starts}
        try:
            end = ode.solve(structure.problem(), numbers, **options)
        except ValueError as error:
            totals["refused"] += asked.lanes
            print(f"{seed:5} {structure.label}: refused: {error}", flush=True)
            continue
        if asked.derivatives:
            derivatives = checked_derivatives(structure, numbers, options, end)
            totals += derivatives
            if derivatives["derivatives wrong"]:
                print(f"{seed:5} {structure.label}: {dict(derivatives)}", flush=True)
        outcomes = np.broadcast_to(np.asarray(end.ended_by, str), asked.lanes)
        states = np.stack([np.broadcast_to(np.asarray(each), asked.lanes) for each in end.y])
        wrong = []
        for lane in range(asked.lanes):
            truth = reference(structure, {name: float(each[lane]) for name, each in numbers.items()})
            if not truth.sure:
                totals["left out"] += 1
                continue
            outcome, t = str(outcomes[lane]), float(np.broadcast_to(end.t, asked.lanes)[lane])
            error = max(abs(t - truth.t), float(np.max(np.abs(states[:, lane] - truth.y) / (1 + np.abs(truth.y)))))
            if outcome in ("failed", "unfinished"):
                totals[outcome] += 1
                verdict = outcome
            elif outcome == truth.outcome and error <= asked.limit:
                totals["right"] += 1
                continue
            elif bool(np.broadcast_to(end.inexact, asked.lanes)[lane]):
                totals["inexact"] += 1
                verdict = "inexact"
            else:
                totals["wrong"] += 1
                verdict = "wrong"
            wrong.append(verdict)
            rows.append({"seed": seed, "lane": lane, "label": structure.label, "verdict": verdict, "outcome": outcome,
                         "t": t, "truth": [truth.outcome, truth.t], "error": error})  # fmt: skip
        if wrong:
            print(f"{seed:5} {structure.label}: {dict(collections.Counter(wrong))}", flush=True)
        if asked.out:
            asked.out.write_text(json.dumps(rows, indent=1))
    print(dict(totals))
    sys.exit(bool(totals["wrong"] + totals["derivatives wrong"]))


if __name__ == "__main__":
    main()
