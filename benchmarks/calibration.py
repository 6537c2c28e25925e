"""Does calibration find the truth? `python -m benchmarks.calibration`, an hour on 2 cores.

Synthetic data with known truth, 50 angles, errors of 3 % of the greatest volume. For each model
100 seeds: are the estimates unbiased, and do 95 % intervals hold the truth? And for each kind of
curve: how often does the variant that made the data come first?
"""

import argparse
import collections
import datetime as dt
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import erosion
from erosion.fits import calibrate, rank_models

RESULTS = Path(__file__).with_name("RESULTS-calibration.md")

# The parameters that shape each model's curve. K = tan α and K = ẏ/ẋ leave k without influence; without
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
ANGLES, STEP = np.linspace(5.0, 88.0, 50, retstep=True)
NOISE = 0.03
# Kinds for which it matters that all sets have the same angles, or not.
FIXED = ("rotating", "rotating-tan-alpha", "rotating-tan-alpha-full-torque")

HEAD = """{date}, by `python -m benchmarks.calibration`. 50 angles, one drawn from each of 50 equal parts of
4.15° to 88.85°; normal errors of 3% of the greatest volume, given as uncertainties. Truth: Table 1. First guess: k = 3,
ψ = 0.06, and r = 0.05 in where r is free."""
ESTIMATES = (
    "| model | parameter | mean error | scatter | mean over its own error | median standard error | "
    "median half of the 95 % interval | which holds the truth |"
)
RANKS = "| data made by | ranked first | the best of the others |"

Record = dict[str, Any]


def synthetic(model: str, seed: int, same_angles: bool = False) -> dict[str, np.ndarray]:
    """Measurements that a model with the parameters of Table 1 would have given.

    Every set has angles of its own, one anywhere in each of 50 equal parts of the range. With
    the same angles in all sets, the truth of a model that jumps would always lie at the same
    place between the same two rows: an offset of all estimates that no noise averages out.
    """
    rng = np.random.default_rng(seed)
    degrees = ANGLES if same_angles else ANGLES + rng.uniform(-STEP / 2, STEP / 2, ANGLES.size)
    exact = np.asarray(erosion.impact(model, TRUTH.replace(alpha=np.deg2rad(degrees))).volume)
    error = np.full(degrees.size, NOISE * exact.max())
    noisy = exact + error * rng.standard_normal(degrees.size)
    return {"angle [deg]": degrees, "volume [in^3]": noisy, "uncertainty [in^3]": error}


def recover(model: str, seed: int, same_angles: bool) -> Record:
    """Estimate, standard error and interval of each parameter, from a fit to one set."""
    guess = GUESS if "r" in FREE[model] else GUESS.replace(r=TRUTH.r)
    fit = calibrate(model, guess, synthetic(model, seed, same_angles), FREE[model])
    intervals = fit.intervals()
    return {name: [fit.estimates[name], fit.standard_errors[name], *intervals[name]] for name in FREE[model]}


def rank(model: str, seed: int) -> Record:
    """Which kinds of curve come first."""
    ranking = rank_models(GUESS.replace(r=TRUTH.r), synthetic(model, 1000 + seed), ("k", "psi"), models=KINDS)
    return {"names": list(ranking.names)}


def recovery(model: str, records: Sequence[Record]) -> list[str]:
    """Lines of a table of estimates."""
    lines = []
    for name in FREE[model]:
        estimate, error, low, high = np.array([one[name] for one in records]).T / float(getattr(TRUTH, name)) - [
            [1],
            [0],
            [1],
            [1],
        ]
        bias = estimate.mean() / (estimate.std(ddof=1) / np.sqrt(len(records)))
        covered = int(np.sum((low <= 0) & (high >= 0)))
        lines.append(
            f"| {model} | {name} | {estimate.mean():+.2%} | {estimate.std(ddof=1):.2%} | {bias:+.1f} | "
            f"{np.median(error):.2%} | {np.median(high - low) / 2:.2%} | {covered} of {len(records)} |"
        )
    return lines


def first(model: str, records: Sequence[Record]) -> list[str]:
    """Line of the table of ranks."""
    won = sum(one["names"][0] == model for one in records)
    others = collections.Counter(next(name for name in one["names"] if name != model) for one in records)
    seconds = ", ".join(f"{name} {count}" for name, count in others.most_common())
    return [f"| {model} | {won} of {len(records)} | {seconds} |"]


TABLES = {
    "drawn": ("## Estimates", ESTIMATES, tuple(FREE), lambda model, seed: recover(model, seed, False), recovery),
    "same": ("## Estimates, the same angles in every set", ESTIMATES, FIXED,
             lambda model, seed: recover(model, seed, True), recovery),
    "rank": ("## Ranking by AICc, k and ψ free", RANKS, KINDS, rank, first),
}  # fmt: skip


def main() -> int:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100, help="of each model's recovery")
    parser.add_argument("--rank-seeds", type=int, default=20, help="of each kind's ranking")
    parser.add_argument("--tables", nargs="+", default=list(TABLES), choices=list(TABLES), help="only some of these")
    parser.add_argument("--only", nargs="+", default=list(FREE), metavar="MODEL", help="only some rows")
    parser.add_argument("--records", type=Path, help="where fits are kept, so that a run that was stopped can go on")
    parser.add_argument("--date", default=dt.date.today().isoformat(), help="of the run, for the report")
    arguments = parser.parse_args()
    records: dict[str, Record] = {}
    if arguments.records is not None and arguments.records.exists():
        for line in arguments.records.read_text(encoding="utf-8").splitlines():
            records.update(json.loads(line))
    lines: list[str] = []

    def say(line: str) -> None:
        lines.append(line)
        print(line, flush=True)

    say(f"# Does calibration find the truth?\n\n{HEAD.format(date=arguments.date)}")
    for table, (title, head, models, measure, summary) in TABLES.items():
        if table not in arguments.tables:
            continue
        say(f"\n{title}\n\n{head}\n|{'---|' * (head.count('|') - 1)}")
        for model in (one for one in models if one in arguments.only):
            fits = []
            for seed in range(arguments.rank_seeds if table == "rank" else arguments.seeds):
                key = f"{table}/{model}/{seed}"
                if key not in records:
                    records[key] = measure(model, seed)
                    if arguments.records is not None:
                        with arguments.records.open("a", encoding="utf-8") as file:
                            file.write(json.dumps({key: records[key]}) + "\n")
                fits.append(records[key])
            say("\n".join(summary(model, fits)))
    if set(arguments.only) == set(FREE) and set(arguments.tables) == set(TABLES):
        RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
