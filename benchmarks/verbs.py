"""Warm calls, one impact, many optima, `erosion.volume` in JAX: `python -m benchmarks.verbs`."""

import argparse
import statistics
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import by_turns, rate_text, seconds_of, table_text, time_text
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
        seconds: of a call.
    """

    size: int
    seconds: float


def verbs(scale: int, rounds: int, say: Callable[[str], None]) -> dict[str, Verb]:
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
    measures: dict[str, Callable[[], float]] = {}
    for name, count in counts.items():
        say(f"  prepare {name}, {count:,}")
        run = _run(name, count)
        run()
        measures[name] = partial(seconds_of, run, max(1, min(500, int(_TURN / seconds_of(run)))))
    seconds = by_turns(measures, rounds, say)
    return {name: Verb(count, statistics.median(seconds[name])) for name, count in counts.items()}


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
    rows = [
        [name, f"{verb.size:,}", time_text(verb.seconds), rate_text(verb.size / verb.seconds)]
        for name, verb in results.items()
    ]
    return "\n".join(
        [
            "## Warm calls: one impact, optima, `erosion.volume` inside JAX",
            "",
            "Table 1, `rotating`, in a warm process: one impact; certified optima of one call over k from 0.5 to 5 and",
            "over s from −0.5 to 0.5; volumes over ordered angles (`volume` integrates at rtol = 1e-11); and",
            "`erosion.volume` called without `jit`.",
            "",
            table_text("call | at once | time | a second", rows),
        ]
    )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verbs", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scale", type=int, default=1, help="divides the numbers of optima and impacts")
    arguments = parser.parse_args()
    print(verbs_text(verbs(arguments.scale, arguments.rounds, print)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
