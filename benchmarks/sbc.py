"""Do posteriors hold the truth as often as they say? `python -m benchmarks.sbc`, some minutes on 2 cores.

Simulation-based calibration: parameters are drawn from the priors, data from the parameters, and the posterior from
the data. Then the rank of the true value among the draws of the posterior is as often any number as any other, and
intervals of 90 % hold the truth in 90 % of the sets. A sampler that is biased, too wide or too narrow fails here.

    S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, Validating Bayesian inference algorithms with
    simulation-based calibration, arXiv:1804.06788 (2018).
"""

import argparse
import dataclasses
import time
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import erosion
from erosion.distributions import LogNormal, LogUniform

ROWS, ERROR = 12, 5e-6  # errors [in³], 5 % of the greatest volume at Table 1
DRAWS, THINNED = 125, 5  # of each population; every fifth is independent of the next
BINS = 20
LEVEL = 0.9

# The parameters that shape each model's curve; K = tan α leaves k without influence.
FREE = {"linearized": ("k", "psi"), "rotating": ("k", "psi"), "rotating-tan-alpha": ("r", "psi")}
PRIORS: Mapping[str, Any] = {"k": LogNormal(2.0, 0.3), "psi": LogNormal(0.04, 0.3), "r": LogNormal(0.04, 0.3)}
NOISES = {"noise": LogUniform(1e-6, 2e-5), "relative_noise": LogUniform(0.01, 0.2)}


class Ranks(NamedTuple):
    """Where the true values lie.

    Args:
        names: of the parameters.
        ranks: share of the draws below the true value, shape (sets, names).
        covered: whether intervals hold it, shape (sets, names).
    """

    names: tuple[str, ...]
    ranks: np.ndarray
    covered: np.ndarray

    @property
    def probabilities(self) -> np.ndarray:
        """Of ranks as uneven as these, if posteriors are right; χ² over 20 bins, shape (names,)."""
        counts = [np.histogram(column, BINS, (0, 1))[0] for column in self.ranks.T]
        return np.array([stats.chisquare(count).pvalue for count in counts])


def calibrated(model: str, sets: int, *, known: bool, seed: int = 0) -> Ranks:
    """Simulation-based calibration of one model.

    Args:
        model: its name.
        sets: number of data sets.
        known: whether the data have uncertainties; else the noise is a parameter.
        seed: of truths, data and draws.
    """
    free = FREE[model]
    laws = {name: PRIORS[name] for name in free} | ({} if known else NOISES)
    ranks, covered = np.empty((2, sets, len(laws)))
    for i in range(sets):
        rng = np.random.default_rng([seed, i])
        truth = {name: float(law.ppf(rng.random(1))[0]) for name, law in laws.items()}
        # Each set has its own angles: a jump of V(α) may lie between any two rows.
        degrees = np.sort(rng.uniform(5.0, 85.0, ROWS))
        p = dataclasses.replace(erosion.TABLE_1, alpha=np.deg2rad(degrees), **{name: truth[name] for name in free})
        volume = erosion.impact(model, p).volume
        error = np.full(ROWS, ERROR) if known else np.hypot(truth["noise"], truth["relative_noise"] * volume)
        data = {"angle [deg]": degrees, "volume [in^3]": volume + error * rng.standard_normal(ROWS)}
        data |= {"uncertainty [in^3]": error} if known else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", erosion.ConvergenceWarning)  # R̂ of 125 draws passes 1.01 by chance
            drawn = erosion.posterior(
                model, erosion.TABLE_1, data, free, priors=laws, draws=DRAWS, seed=seed * sets + i
            )
        intervals = drawn.intervals(LEVEL)
        for j, (name, value) in enumerate(truth.items()):
            draws = drawn.samples[name].values.ravel()[::THINNED]
            # Between two draws any place is alike.
            ranks[i, j] = (np.sum(draws < value) + rng.random()) / (len(draws) + 1)
            covered[i, j] = intervals[name][0] <= value <= intervals[name][1]
    return Ranks(tuple(laws), ranks, covered.astype(bool))


def main() -> None:
    """Print a line for each model and parameter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--models", nargs="+", default=list(FREE))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(f"{arguments.sets} data sets of {ROWS} rows, {4 * DRAWS} draws of each posterior\n")
    print(
        "| model | noise | parameter | probability of ranks so uneven | 90 % intervals that hold the truth | s a set |"
    )
    print("|---|---|---|---|---|---|")
    for model in arguments.models:
        for known in (True, False):
            begun = time.perf_counter()
            result = calibrated(model, arguments.sets, known=known, seed=arguments.seed)
            seconds = (time.perf_counter() - begun) / arguments.sets
            for name, probability, share in zip(
                result.names, result.probabilities, result.covered.mean(axis=0), strict=True
            ):
                noise = "known" if known else "sampled"
                print(f"| {model} | {noise} | {name} | {probability:.2f} | {share:.1%} | {seconds:.2f} |", flush=True)


if __name__ == "__main__":
    main()
