"""Does `next_experiment` name the experiments that tell most? `python -m benchmarks.next_experiment`, half a minute.

By brute force, each candidate is simulated: a truth is drawn from the posterior, a row from the truth and its error,
and the posterior's entropy is measured with the row and without it. That is done without draws of the package: over a
fine grid of the parameters, by a likelihood that is written here. The same truths and errors of the row serve all
candidates, so that their differences are known better than each drop.
"""

import itertools
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import erosion
from erosion.fits import NextExperiment
from erosion.fits.posterior import Posterior

SIMULATIONS = 200
ANGLES = np.deg2rad([10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0])
POINTS = {2: 120, 3: 64}  # of the grid along each parameter, by their number; with 44 of three 1.64 bit are 1.72
BEYOND = 0.5  # of the range of the draws, on both sides of it
BEST = 3
EQUAL = 1e-3  # bit; the accuracy of the package's sums
DENSITY = 2700.0
CASE = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061").replace(psi=0.5)


class Case(NamedTuple):
    """Data of one model, fitted by one or more.

    Args:
        models: the first made the data.
        free: parameters.
        error: of a row, in mg/kg and as a share.
        speeds: of the rows, and of the candidates [m/s].
        angles: of the rows [°].
    """

    models: tuple[str, ...]
    free: tuple[str, ...]
    error: tuple[float, float]
    speeds: tuple[float, ...] = (60.0, 98.0)
    angles: tuple[float, ...] = (20.0, 40.0, 70.0)


CUT, WITH_DEFORMATION = ("k", "psi"), ("k", "psi", "energy_ratio")
CASES = (
    Case(("linearized",), CUT, (20, 0.0)),
    Case(("linearized",), CUT, (5, 0.08)),
    Case(("linearized",), CUT, (0, 0.1), (80.0,)),
    Case(("finnie",), CUT, (30, 0.0), (80.0,)),
    Case(("finnie",), CUT, (5, 0.1)),
    Case(("rotating",), CUT, (20, 0.0), (80.0,)),
    Case(("rotating",), CUT, (5, 0.08)),
    Case(("linearized-deformation",), WITH_DEFORMATION, (20, 0.0)),
    Case(("linearized-deformation",), WITH_DEFORMATION, (2, 0.1)),
    Case(("finnie", "linearized"), CUT, (10, 0.15), angles=(15.0, 50.0)),
)


def deviation(erosion_: np.ndarray, error: tuple[float, float]) -> np.ndarray:
    """One standard deviation of a row."""
    return np.hypot(error[0] * 1e-6, error[1] * erosion_)


def simulated(case: Case, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A table of the case, and its conditions."""
    angle, speed = (part.ravel() for part in np.meshgrid(np.deg2rad(case.angles), case.speeds))
    p = CASE.replace(alpha=angle, v0=speed)
    true = erosion.PerMass(DENSITY).erosion_ratio(erosion.impact(case.models[0], p).volume, p)
    weighed = true + deviation(true, case.error) * rng.standard_normal(len(angle))
    table = {"angle [rad]": angle, "speed [m/s]": speed, "mass_loss [kg/kg]": weighed}
    return table, {"alpha": angle, "v0": speed}


def on_grid(
    posterior: Posterior, rows: Mapping[str, np.ndarray], case: Case
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The parameters at the points of a grid, uniform in their logarithms as the priors are, and log-likelihoods."""
    axes = []
    for name in posterior.names:
        logs, (low, high) = (
            np.log(posterior.samples[name].values),
            posterior.priors.laws[name].ppf(np.array([0.0, 1.0])),
        )
        more = BEYOND * np.ptp(logs)
        ends = max(logs.min() - more, np.log(low)), min(logs.max() + more, np.log(high))
        axes.append(np.linspace(*ends, POINTS[len(posterior.names)]))
    points = {name: np.exp(part.ravel()) for name, part in zip(posterior.names, np.meshgrid(*axes), strict=True)}
    predicted = posterior.likelihood.predict(points, rows)
    errors = deviation(np.maximum(predicted, 0.5 * posterior.data.erosion), case.error)  # as `errors_at` has it
    volume = np.sum(np.log([np.ptp(axis) for axis in axes]))  # of a cell, but for a constant
    squares = ((posterior.data.erosion - predicted) / errors) ** 2
    return points, volume - np.sum(np.log(errors) + squares / 2, axis=1)


def drops(weights: np.ndarray, predicted: np.ndarray, errors: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The drop of entropy by a simulated row of each candidate [bit], shape (simulations, candidates)."""
    kept = weights > 1e-12 * weights.max()
    weights, predicted, errors = weights[kept] / weights[kept].sum(), predicted[kept], errors[kept]
    truths, normal = rng.choice(len(weights), SIMULATIONS, p=weights), rng.standard_normal(SIMULATIONS)
    gains = np.full((SIMULATIONS, predicted.shape[1]), np.nan)
    has_error = np.flatnonzero(errors.all(axis=0))  # not a share of nothing
    before, logs = _entropy(weights), np.log(np.where(errors > 0, errors, 1.0))
    for (i, truth), j in itertools.product(enumerate(truths), has_error):
        row = predicted[truth, j] + errors[truth, j] * normal[i]
        log = -logs[:, j] - ((row - predicted[:, j]) / errors[:, j]) ** 2 / 2
        after = weights * np.exp(log - log.max())
        gains[i, j] = before - _entropy(after / after.sum())
    return gains


def _entropy(weights: np.ndarray) -> float:
    some = weights[weights > 0]
    return float(-np.sum(some * np.log2(some)))


def compared(case: Case, seed: int) -> tuple[NextExperiment, np.ndarray]:
    """What the package expects of each candidate, and what the simulations of it say."""
    rng = np.random.default_rng(seed)
    table, rows = simulated(case, rng)
    error = erosion.ErrorModel(case.error[0] * 1e-6, case.error[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erosion.ConvergenceWarning)
        source = erosion.rank_posteriors(CASE, table, case.free, models=case.models, density=DENSITY, error=error)
    answer = erosion.next_experiment(source, {"alpha": ANGLES[:, None], "v0": np.array(case.speeds)}, draws=2000)
    logs, predicted = [], []
    for posterior in source.posteriors:
        points, log = on_grid(posterior, rows, case)
        logs.append(log)
        predicted.append(posterior.likelihood.predict(points, answer.candidates))
    log, curves = np.concatenate(logs), np.concatenate(predicted)
    return answer, drops(np.exp(log - log.max()), curves, deviation(curves, case.error), rng)


def main() -> None:
    """Print a line for each case."""
    print("| model | error | next_experiment [bit] | simulated [bit] | best three |\n|---|---|---|---|---|")
    same = ties = 0
    for seed, case in enumerate(CASES):
        answer, gains = compared(case, seed)
        mean, error = gains.mean(axis=0), gains.std(axis=0, ddof=1) / np.sqrt(len(gains))
        expected, found = answer.order[:BEST], np.argsort(-mean)[:BEST]
        at = answer.candidates
        where = [f"{v0:.0f} m/s {angle:.0f}°" for v0, angle in zip(at["v0"], np.rad2deg(at["alpha"]), strict=True)]
        words = (", ".join(f"{where[i]} {answer.total[i]:.3f}" for i in expected),
                 ", ".join(f"{where[i]} {mean[i]:.3f} ± {error[i]:.3f}" for i in found))  # fmt: skip
        steps = [gains[:, i] - gains[:, j] for i, j in zip(found, expected, strict=True) if i != j]
        sizes = [f"{step.mean():.4f} ± {step.std(ddof=1) / np.sqrt(len(step)):.4f}" for step in steps]
        equal = all(abs(step.mean()) < EQUAL for step in steps)
        same, ties = same + (not steps), ties + (bool(steps) and equal)
        verdict = f"{'equal' if equal else 'other'} candidates, simulated differences {', '.join(sizes)} bit"
        verdict = verdict if steps else "same order"
        shares = f"{case.error[0]:g} mg/kg + {100 * case.error[1]:g} %"
        print(f"| {', '.join(case.models)} | {shares} | {words[0]} | {words[1]} | {verdict} |", flush=True)
    print(f"\n{same} of {len(CASES)} cases have the same order of the best three, {ties} but for equal candidates.")


if __name__ == "__main__":
    main()
