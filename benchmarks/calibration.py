"""Does calibration find the truth? `python -m benchmarks.calibration`, some 30 minutes on 2 cores.

Synthetic data with known truth, 50 angles, errors of 3 % of the greatest volume. For each model
100 seeds: are the estimates unbiased, and do 95 % intervals hold the truth? And for each kind of
curve: how often does the variant that made the data come first?
"""

import argparse
import datetime as dt
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import erosion
from erosion.calibration import Calibration, calibrate, rank_models

RESULTS = Path(__file__).with_name("RESULTS-calibration.md")

# What each model's curve depends on. K = tan α and K = ẏ/ẋ leave k without influence; without
# rotation nothing but the height of the curve is left.
FREE = {
    "linearized": ("k", "psi"),
    "tan-alpha": ("psi",),
    "velocity-aligned": ("psi",),
    "finnie": ("k", "psi"),
    "rotating": ("k", "psi"),
    "rotating-full-torque": ("k", "psi"),
    "rotating-tan-alpha": ("r", "psi"),
    "rotating-velocity-aligned": ("r", "psi"),
    "rotating-tan-alpha-full-torque": ("r", "psi"),
    "rotating-velocity-aligned-full-torque": ("r", "psi"),
    "as-printed": ("k", "psi"),
}
# One model of each kind of curve: `finnie` with 3k is `linearized`, K = ẏ/ẋ is K = tan α.
KINDS = ("linearized", "tan-alpha", "rotating", "rotating-full-torque", "rotating-tan-alpha",
         "rotating-tan-alpha-full-torque", "as-printed")  # fmt: skip

TRUTH = erosion.TABLE_1
GUESS = TRUTH.replace(k=3.0, psi=0.06, r=0.05)
ANGLES = np.linspace(5.0, 88.0, 50)
NOISE = 0.03
STARTS = 12
RANK_STARTS = 6


def synthetic(model: str, seed: int) -> dict[str, np.ndarray]:
    """Measurements that a model with the parameters of Table 1 would have given."""
    exact = np.asarray(erosion.impact(model, TRUTH.replace(alpha=np.deg2rad(ANGLES))).volume)
    error = np.full(len(ANGLES), NOISE * exact.max())
    noisy = exact + error * np.random.default_rng(seed).standard_normal(len(ANGLES))
    return {"angle [deg]": ANGLES, "volume [in^3]": noisy, "uncertainty [in^3]": error}


def covered(fits: Sequence[Calibration], name: str, level: float = 0.95) -> int:
    """In how many fits the interval holds the truth."""
    truth = float(getattr(TRUTH, name))
    ranges = [one.intervals(level)[name] for one in fits]
    return sum(low <= truth <= high for low, high in ranges)


def recovery(model: str, seeds: int) -> list[str]:
    """Lines of the table of estimates for one model."""
    guess = GUESS if "r" in FREE[model] else GUESS.replace(r=TRUTH.r)
    fits = [calibrate(model, guess, synthetic(model, seed), FREE[model], starts=STARTS) for seed in range(seeds)]
    lines = []
    for name in FREE[model]:
        truth = float(getattr(TRUTH, name))
        off = np.array([one.estimates[name] for one in fits]) / truth - 1
        error = np.array([one.standard_errors[name] for one in fits]) / truth
        bias = off.mean() / (off.std(ddof=1) / np.sqrt(seeds))
        lines.append(
            f"| {model} | {name} | {off.mean():+.2%} | {off.std(ddof=1):.2%} | {np.median(error):.2%} | {bias:+.1f} | "
            f"{covered(fits, name)} of {seeds} |"
        )
    return lines


def first(truth: str, seeds: int) -> str:
    """Line of the table of ranks for data made by one model."""
    won = 0
    others: dict[str, int] = {}
    for seed in range(seeds):
        ranking = rank_models(GUESS.replace(r=TRUTH.r), synthetic(truth, 1000 + seed), ("k", "psi"), models=KINDS,
                              starts=RANK_STARTS)  # fmt: skip
        won += ranking.names[0] == truth
        second = next(name for name in ranking.names if name != truth)
        others[second] = others.get(second, 0) + 1
    seconds = ", ".join(f"{name} {count}" for name, count in sorted(others.items(), key=lambda item: -item[1]))
    return f"| {truth} | {won} of {seeds} | {seconds} |"


def main() -> int:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100, help="of each model's recovery")
    parser.add_argument("--rank-seeds", type=int, default=20, help="of each kind's ranking")
    parser.add_argument(
        "--part", choices=("estimates", "ranking"), default="", help="both without it; a part writes no file"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="MODEL")
    parser.add_argument("--date", default=dt.date.today().isoformat(), help="of the run, for the report")
    arguments = parser.parse_args()
    lines: list[str] = []

    def say(line: str) -> None:
        lines.append(line)
        print(line, flush=True)

    begin = time.perf_counter()
    say("# Does calibration find the truth?\n")
    say(f"{arguments.date}, by `python -m benchmarks.calibration`. {len(ANGLES)} angles from {ANGLES[0]:g}° to "
        f"{ANGLES[-1]:g}°, normal errors of {NOISE:.0%} of the greatest volume, given as uncertainties. "
        f"Truth: Table 1. First guess: k = 3, ψ = 0.06, and r = 0.05 in where r is free.\n")  # fmt: skip
    wanted = arguments.only or list(FREE)
    if arguments.part != "ranking":
        say("## Estimates\n")
        say(
            "| model | parameter | mean error | their scatter | median standard error | "
            "mean error over its own error | 95 % interval holds the truth |"
        )
        say("|---|---|---|---|---|---|---|")
        for model in (one for one in FREE if one in wanted):
            for line in recovery(model, arguments.seeds):
                say(line)
    if arguments.part != "estimates":
        say("\n## Ranking by AICc, k and ψ free\n")
        say("| data made by | ranked first | the best of the others |")
        say("|---|---|---|")
        for kind in (one for one in KINDS if one in wanted):
            say(first(kind, arguments.rank_seeds))
    print(f"{time.perf_counter() - begin:.0f} s on {os.cpu_count()} cores", file=sys.stderr)
    if not (arguments.only or arguments.part):
        RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
