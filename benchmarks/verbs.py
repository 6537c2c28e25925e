"""Warm calls, one impact, many optima, `erosion.volume` in JAX: `python -m benchmarks.verbs`.

The old engine by turns with the new one, each in a process of its own.
"""

import argparse
import statistics
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.old_engine import NEW, OLD, both, unpacked
from benchmarks.timing import Process, by_turns, rate_text, seconds_of, table_text, time_text
from benchmarks.work import ALPHAS, SPINS

ONE = {0: "impact, V", 2: "impact, V, V′, V″"}
OPTIMA_K = "alpha_max over k"
OPTIMA_SPIN = "alpha_max over spin"
VMAPPED = "jit(vmap(volume))"
IMPACT = "impact, the same angles"
TIGHTER = "impact, rtol = 1e-11 as in volume"
EAGER = "volume, eager"

_OPTIMA, _LANES = 2000, 10**5
_TURN = 0.2  # seconds of calls in a turn


class Verb(NamedTuple):
    """A verb's medians.

    Args:
        size: optima or impacts of a call.
        seconds: of a call, by engine (`NEW`, `OLD`).
    """

    size: int
    seconds: dict[str, float]

    @property
    def rate(self) -> float:
        """A second, by the new engine."""
        return self.size / self.seconds[NEW]


def verbs(engines: Mapping[str, Process], scale: int, rounds: int, say: Callable[[str], None]) -> dict[str, Verb]:
    """Medians of every verb; `scale` divides the numbers of optima and impacts."""
    counts = {
        ONE[0]: 1,
        ONE[2]: 1,
        OPTIMA_K: _OPTIMA // scale,
        OPTIMA_SPIN: _OPTIMA // scale,
        VMAPPED: _LANES // scale,
        IMPACT: _LANES // scale,
        TIGHTER: _LANES // scale,
        EAGER: 1,
    }
    measures: dict[tuple[str, str], Callable[[], float]] = {}
    for name, count in counts.items():
        for engine, process in engines.items():
            say(f"  prepare {name}, {count:,}: {engine} engine")
            process.call(_prepare, name, count)
            measures[name, engine] = partial(process.call, _turn, name)
    seconds = by_turns(measures, rounds, say)
    return {
        name: Verb(count, {engine: statistics.median(seconds[name, engine]) for engine in engines})
        for name, count in counts.items()
    }


# Of an engine's process: what to call, and how often in a turn.
_runs: dict[str, tuple[Callable[[], Any], int]] = {}


def _prepare(name: str, count: int) -> None:
    run = _run(name, count)
    run()
    _runs[name] = run, max(1, min(500, int(_TURN / seconds_of(run))))


def _turn(name: str) -> float:
    """Seconds of a call, warm."""
    return seconds_of(*_runs[name])


def _run(name: str, count: int) -> Callable[[], Any]:
    import jax

    import erosion

    p = erosion.TABLE_1
    angles = np.linspace(*ALPHAS, count)

    def volume(alpha: Any) -> Any:
        return erosion.volume("rotating", p.replace(alpha=alpha))

    for order, one in ONE.items():
        if name == one:
            return partial(erosion.impact, "rotating", p, derivatives=order)
    if name == OPTIMA_K:
        return partial(erosion.alpha_max, "rotating", p.replace(k=np.linspace(0.5, 5, count)))
    if name == OPTIMA_SPIN:
        spins = np.linspace(*SPINS, count) * float(p.v0 / p.r)
        return partial(erosion.alpha_max, "rotating", p.replace(phidot0=spins))
    if name == VMAPPED:
        together = jax.jit(jax.vmap(volume))
        return lambda: together(angles).block_until_ready()
    if name == EAGER:
        return lambda: volume(0.4).block_until_ready()
    rtol = 1e-11 if name == TIGHTER else 1e-9
    return partial(erosion.impact, "rotating", p.replace(alpha=angles), rtol=rtol)


def verbs_text(results: Mapping[str, Verb]) -> str:
    """A table, one row a verb."""
    rows = []
    for name, verb in results.items():
        new, old = verb.seconds[NEW], verb.seconds.get(OLD)
        compared = [time_text(old), f"{old / new:.3g}"] if old else ["", ""]
        rows.append([name, f"{verb.size:,}", time_text(new), rate_text(verb.rate), *compared])
    return "\n".join(
        [
            "## Warm calls: one impact, optima, `erosion.volume` inside JAX",
            "",
            "Table 1, `rotating`, in a warm process: one impact; certified optima of one call over k from 0.5 to 5 and",
            "over s from −0.5 to 0.5; volumes over ordered angles (`volume` integrates at rtol = 1e-11); and",
            "`erosion.volume` called without `jit`. The old engine in a process of its own, by turns.",
            "",
            table_text("call | at once | new engine | a second | old engine | ×", rows),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verbs", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=int, default=1, help="divides the numbers of optima and impacts")
    parser.add_argument("--no-old", action="store_true", help="without the old engine")
    arguments = parser.parse_args()
    with unpacked(not arguments.no_old) as source, both(source) as engines:
        print(verbs_text(verbs(engines, arguments.scale, arguments.rounds, print)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
