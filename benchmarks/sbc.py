"""Do posteriors hold the truth as often as they say? `python -m benchmarks.sbc`, some minutes on 2 cores.

Simulation-based calibration: parameters are drawn from the priors, data from the parameters, and the posterior from
the data. Then the rank of the true value among the draws of the posterior is as often any number as any other, and
intervals of 90 % hold the truth in 90 % of the sets. A sampler that is biased, too wide or too narrow fails here.

The discrepancy is written here once more: curves μ(1 + δ) of an exponent, a power of sin α and a Gaussian process.

    S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, Validating Bayesian inference algorithms with
    simulation-based calibration, arXiv:1804.06788 (2018).
"""

import argparse
import dataclasses
import functools
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import erosion
from erosion.arguments import no_progress
from erosion.distributions import LogNormal, LogUniform
from erosion.fits import discrepancy, prediction
from erosion.fits.forward import make_forward
from erosion.fits.likelihood import make_likelihood

ROWS, ERROR = 12, 5e-6  # errors [in³], 5 % of the greatest volume at Table 1
DRAWS, THINNED = 125, 5  # of each population; every fifth is independent of the next
BINS = 20
LEVEL = 0.9

# The parameters that shape each model's curve; K = tan α leaves k without influence.
FREE = {"linearized": ("k", "psi"), "rotating": ("k", "psi"), "rotating-tan-alpha": ("r", "psi")}
PRIORS: Mapping[str, Any] = {"k": LogNormal(2.0, 0.3), "psi": LogNormal(0.04, 0.3), "r": LogNormal(0.04, 0.3)}
NOISES = {"noise": LogUniform(1e-6, 2e-5), "relative_noise": LogUniform(0.01, 0.2)}

MISSING = "linearized-deformation"  # with a discrepancy
OF_MISSING: Mapping[str, Any] = {
    "k": LogNormal(2.0, 0.3), "psi": LogNormal(0.4, 0.3), "energy_ratio": LogNormal(2.0, 0.3)
}  # fmt: skip
ANGLES, SPEEDS = (10.0, 20.0, 30.0, 45.0, 65.0, 90.0), (60.0, 98.0)  # °, m/s
SMALL = 5e-12  # m³, 2 to 10 % of a row
OF_NOISE = {"noise": LogUniform(5e-13, 2e-11), "relative_noise": LogUniform(0.01, 0.2)}


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

    def drawn(truth: Mapping[str, float], rng: np.random.Generator, of_set: int) -> Mapping[str, np.ndarray]:
        # Each set has its own angles: a jump of V(α) may lie between any two rows.
        degrees = np.sort(rng.uniform(5.0, 85.0, ROWS))
        p = dataclasses.replace(erosion.TABLE_1, alpha=np.deg2rad(degrees), **{name: truth[name] for name in free})
        volume = erosion.impact(model, p).volume
        error = np.full(ROWS, ERROR) if known else np.hypot(truth["noise"], truth["relative_noise"] * volume)
        data = {"angle [deg]": degrees, "volume [in^3]": volume + error * rng.standard_normal(ROWS)}
        data |= {"uncertainty [in^3]": error} if known else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", erosion.ConvergenceWarning)  # R̂ of 125 draws passes 1.01 by chance
            samples = erosion.posterior(
                model, erosion.TABLE_1, data, free, priors=laws, draws=DRAWS, seed=of_set
            ).samples
        return {name: samples[name].values.ravel() for name in laws}

    return _ranks(laws, drawn, sets, seed)


def calibrated_discrepancy(sets: int, *, known: bool, seed: int = 0) -> Ranks:
    """The same of a model with an exponent of the speed and a discrepancy, drawn as for predictions."""
    laws = {**OF_MISSING, **({} if known else OF_NOISE), **discrepancy.PRIORS}
    degrees, speeds = (part.ravel() for part in np.meshgrid(ANGLES, SPEEDS))
    case = erosion.TABLE_1.to("si").replace(v0=max(SPEEDS))

    def drawn(truth: Mapping[str, float], rng: np.random.Generator, of_set: int) -> Mapping[str, np.ndarray]:
        values = {name: truth[name] for name in ("k", "psi")}
        p = case.replace(alpha=np.deg2rad(degrees), v0=speeds, **values)
        model = erosion.load_model(MISSING).replace(energy_ratio=truth["energy_ratio"])
        mean = erosion.impact(model, p).volume * (speeds / max(SPEEDS)) ** (truth["exponent"] - 2)
        mean = mean * np.sin(np.deg2rad(degrees)) ** truth["sine_exponent"]
        missing = np.linalg.cholesky(covariance(truth, np.deg2rad(degrees), speeds)) @ rng.standard_normal(len(mean))
        error = np.full(len(mean), SMALL) if known else np.hypot(truth["noise"], truth["relative_noise"] * mean)
        volume = mean * (1 + missing) + error * rng.standard_normal(len(mean))
        data = {"angle [deg]": degrees, "speed [m/s]": speeds, "volume [m^3]": volume}
        data |= {"uncertainty [m^3]": error} if known else {}
        forward = make_forward(MISSING, case, data, [*OF_MISSING], None, 1.0)
        priors = {name: law for name, law in laws.items() if name not in discrepancy.PRIORS}
        misfit = discrepancy.Discrepant(make_likelihood(forward, priors), has_exponent=True, has_discrepancy=True)
        return prediction.drawn(misfit, np.random.default_rng(of_set), no_progress).values

    return _ranks(laws, drawn, sets, seed)


def covariance(truth: Mapping[str, Any], alpha: np.ndarray, v0: np.ndarray) -> np.ndarray:
    """Of δ at angles and speeds, and a little on the diagonal against rounding.

    Args:
        truth: the process, numbers or arrays that broadcast before (rows, rows).
        alpha: [rad], shape (rows,).
        v0: of the same shape.
    """

    def matern(distance: np.ndarray) -> np.ndarray:
        scaled = np.sqrt(5) * distance
        return (1 + scaled + scaled**2 / 3) * np.exp(-scaled)

    apart, faster = (np.abs(np.subtract.outer(part, part)) for part in (alpha, np.log(v0)))
    both = np.hypot(apart / truth["length"], faster / truth["length_speed"])
    of_angle = truth["tau_angle"] ** 2 * matern(apart / truth["length_angle"])
    return of_angle + truth["tau"] ** 2 * matern(both) + 1e-9 * np.eye(len(alpha))


_Drawn = Callable[[Mapping[str, float], np.random.Generator, int], Mapping[str, np.ndarray]]


def _ranks(laws: Mapping[str, Any], drawn: _Drawn, sets: int, seed: int) -> Ranks:
    """Of truths under their laws; `drawn` makes data of a truth, and gives draws of their posterior."""
    ranks, covered = np.empty((2, sets, len(laws)))
    for i in range(sets):
        rng = np.random.default_rng([seed, i])
        truth = {name: float(law.ppf(rng.random(1))[0]) for name, law in laws.items()}
        values = drawn(truth, rng, seed * sets + i)
        for j, (name, value) in enumerate(truth.items()):
            draws = values[name][::THINNED]
            # Between two draws any place is alike.
            ranks[i, j] = (np.sum(draws < value) + rng.random()) / (len(draws) + 1)
            low, high = np.quantile(values[name], [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            covered[i, j] = low <= value <= high
    return Ranks(tuple(laws), ranks, covered.astype(bool))


def main() -> None:
    """Print a line for each model and parameter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--models", nargs="+", default=[*FREE, "discrepancy"])
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
            of_model = calibrated_discrepancy if model == "discrepancy" else functools.partial(calibrated, model)
            result = of_model(arguments.sets, known=known, seed=arguments.seed)
            seconds = (time.perf_counter() - begun) / arguments.sets
            for name, probability, share in zip(
                result.names, result.probabilities, result.covered.mean(axis=0), strict=True
            ):
                noise = "known" if known else "sampled"
                print(f"| {model} | {noise} | {name} | {probability:.2f} | {share:.1%} | {seconds:.2f} |", flush=True)


if __name__ == "__main__":
    main()
