"""The goals that the engine was built for, and one run's ratios and differences of medians."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from benchmarks import first_answers as first
from benchmarks import verbs
from benchmarks.first_answers import First
from benchmarks.measure import Table
from benchmarks.old_engine import NEW
from benchmarks.timing import rate_text, table_text, time_text
from benchmarks.verbs import Verb


class Goal(NamedTuple):
    """One goal.

    Args:
        text: the quantity.
        goal, measured: its values, as text.
        reached: whether the measured value is as good.
    """

    text: str
    goal: str
    measured: str
    reached: bool


_AFTER_JAX = {
    first.IMPACT[0]: 0.4,
    first.IMPACT[2]: 0.6,
    first.OPTIMUM: 0.8,
    first.RUN: 0.8,
    first.RUN_OPTIMUM: 0.8,
}  # s
_OVER_SCIPY = 1.5
_EDITS = {0: ("V", 0.3), 2: ("V, V′, V″", 0.5)}  # s
_TIMES = {
    "heyoka scalar, V": 9,
    "heyoka scalar, V, V′, V″": 9,
    "heyoka batch refilled, V": 3.5,
    "heyoka batch refilled, V, V′, V″": 3,
    "scipy DOP853, V": 2500,
}
_ONE_IMPACT = {0: 0.15e-3, 2: 0.25e-3}  # s
_OPTIMA = 4000  # a second
_OVER_IMPACT = 2
_EAGER = 5e-3  # s


def goals(answers: First, random: Table, calls: Mapping[str, Verb]) -> list[Goal]:
    """All goals; `random` has the random work's rates."""
    return [*_first(answers), *_rates(random), *_warm(calls)]


def _first(answers: First) -> list[Goal]:
    results = []
    for name, most in _AFTER_JAX.items():
        after = answers.start(name) - answers.start(first.JAX)
        results.append(_at_most(f"fresh process, {name}: after `import jax`", after, most, _seconds))
    for name in (first.OPTIMUM, first.RUN_OPTIMUM):
        ratio = answers.start(name) / answers.start(first.SCIPY)
        results.append(_at_most(f"fresh process, {name}: over scipy's script", ratio, _OVER_SCIPY, _times))
    for order, (group, most) in _EDITS.items():
        results.append(_at_most(f"a model's edit to {group}", answers.edit(order), most, _seconds))
    return results


def _rates(random: Table) -> list[Goal]:
    results = []
    for name, least in _TIMES.items():
        times = random.times(name)
        if times is not None:
            results.append(Goal(f"rate over {name}", f"≥ {_times(least)}", _times(times), times >= least))
    return results


def _warm(calls: Mapping[str, Verb]) -> list[Goal]:
    results = []
    for order, most in _ONE_IMPACT.items():
        name = verbs.ONE[order]
        results.append(_at_most(f"one warm call, {name}", calls[name].seconds[NEW], most, time_text))
    for name in (verbs.OPTIMA_K, verbs.OPTIMA_SPIN):
        rate = calls[name].rate
        text = f"{name}, {calls[name].size:,} at once"
        results.append(Goal(text, f"≥ {rate_text(_OPTIMA)}/s", f"{rate_text(rate)}/s", rate >= _OPTIMA))
    ratio = calls[verbs.VMAPPED].seconds[NEW] / calls[verbs.IMPACT].seconds[NEW]
    results.append(_at_most(f"{verbs.VMAPPED} over `impact`", ratio, _OVER_IMPACT, _times))
    results.append(_at_most(verbs.EAGER, calls[verbs.EAGER].seconds[NEW], _EAGER, time_text))
    return results


def _at_most(text: str, value: float, most: float, as_text: Callable[[float], str]) -> Goal:
    return Goal(text, f"≤ {as_text(most)}", as_text(value), value <= most)


def _seconds(value: float) -> str:
    return f"{value:.2f} s"


def _times(value: float) -> str:
    return f"{rate_text(value)} ×"


def goals_text(results: list[Goal]) -> str:
    """A table, one row a goal."""
    rows = [[goal.text, goal.goal, goal.measured, "yes" if goal.reached else "**no**"] for goal in results]
    head = "Goals are meant for all impacts and repeats of `make bench` on an idle machine."
    return "\n".join(["## Goals", "", head, "", table_text("quantity | goal | measured | reached", rows)])
