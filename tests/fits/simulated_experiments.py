"""The entropy that a test of each candidate removes, by simulation over grids.

A truth is drawn from the posterior, a row from the truth and its error, and the posterior's entropy is measured with
the row and without it. That is done without draws of the package: over a grid of the parameters, by a likelihood
written here. The same truths and errors of the row serve all candidates within the tested angles, and all beyond them,
so that differences are known better than each drop.

What a model may lack is three grids, one for each way to read the data. Each point of the last two has exponents and
lengths of a discrepancy from their priors, and the discrepancy is integrated out by dense matrices. Beyond the tested
angles the third grid counts alone, as in predictions.
"""

import itertools
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

import erosion
from benchmarks.fits import covariance
from erosion.fits import NextExperiment
from erosion.fits.discrepancy import PRIORS
from erosion.fits.posterior import Posterior

SIMULATIONS = 200
ANGLES = np.deg2rad([10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0])
POINTS = 120  # of the grid along each of two parameters
COARSE, LACKS = (
    30,
    60,
)  # the same where a model may lack something, and draws of that at each point; they err by 0.02 bit
NOTHING = 1e-6  # of the greatest weight
BEYOND = 0.5  # of the range of the draws, on both sides of it
DENSITY = 2700.0
CASE = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061").replace(psi=0.5)


MODEL, FREE = "linearized", ("k", "psi")
ERROR = (5.0, 0.08)  # of a row, in mg/kg and as a share
SPEEDS, ROW_ANGLES = (60.0, 98.0), np.deg2rad([20.0, 40.0, 70.0])  # of the rows [m/s, rad]
WAYS = ("model", "exponent", "discrepancy")


def deviation(erosion_: np.ndarray) -> np.ndarray:
    """One standard deviation of a row."""
    return np.hypot(ERROR[0] * 1e-6, ERROR[1] * erosion_)


def simulated(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A table of rows, and their conditions."""
    angle, speed = (part.ravel() for part in np.meshgrid(ROW_ANGLES, SPEEDS))
    p = CASE.replace(alpha=angle, v0=speed)
    true = erosion.PerMass(DENSITY).erosion_ratio(erosion.impact(MODEL, p).volume, p)
    weighed = true + deviation(true) * rng.standard_normal(len(angle))
    table = {"angle [rad]": angle, "speed [m/s]": speed, "mass_loss [kg/kg]": weighed}
    return table, {"alpha": angle, "v0": speed}


class Points(NamedTuple):
    """Values of the parameters, and what they say of candidates.

    Args:
        mass: of the prior, but for a constant, shape (points,).
        log: likelihood, shape (points,).
        mean: of a weighing, shape (points, candidates).
        missed: its standard deviation by a discrepancy, of the same shape.
    """

    mass: np.ndarray
    log: np.ndarray
    mean: np.ndarray
    missed: np.ndarray


def on_grid(
    posterior: Posterior, rows: Mapping[str, np.ndarray], at: Mapping[str, np.ndarray], way: str, rng: Any
) -> Points:
    """One way to read the data, over a grid that is uniform in logarithms as the priors are.

    Args:
        posterior: of the model.
        rows: the conditions of the data.
        at: those of the candidates.
        way: "model", "exponent" or "discrepancy".
        rng: of the exponents and the process.
    """
    drawn = posterior.predictor_with(way != "model").ways[way].values
    count = POINTS if way == "model" else COARSE
    axes = []
    for name in posterior.names:
        logs, (low, high) = np.log(drawn[name]), posterior.priors.laws[name].ppf(np.array([0.0, 1.0]))
        more = BEYOND * np.ptp(logs)
        axes.append(np.linspace(max(logs.min() - more, np.log(low)), min(logs.max() + more, np.log(high)), count))
    points = {name: np.exp(part.ravel()) for name, part in zip(posterior.names, np.meshgrid(*axes), strict=True)}
    both = {name: np.concatenate([rows[name], at[name]]) for name in rows}
    mean = posterior.likelihood.predict(points, both)
    faster, measured = both["v0"] / rows["v0"].max(), posterior.data.erosion
    of_tests = np.max((mean * faster**-2)[:, : len(measured)], axis=1)
    mass = np.full(len(mean), np.prod([axis[1] - axis[0] for axis in axes]))
    lacks: dict[str, np.ndarray] = {}
    if way != "model":
        mean, mass = np.repeat(mean, LACKS, axis=0), np.repeat(mass, LACKS) / LACKS
        names = [*PRIORS] if way == "discrepancy" else ["exponent"]
        lacks = {name: PRIORS[name].ppf(rng.random(len(mean))) for name in names}
        mean = mean * (both["v0"] / rows["v0"].max()) ** (lacks["exponent"][:, None] - 2)
    if way == "discrepancy":
        mean = mean * np.sin(both["alpha"]) ** lacks["sine_exponent"][:, None]
        added = lacks["normal_wear"] * np.repeat(of_tests, LACKS)
        mean = mean + added[:, None] * np.sin(both["alpha"]) ** 2 * faster ** lacks["exponent"][:, None]
    count = len(measured)
    errors = deviation(np.maximum(mean[:, :count], 0.5 * measured))  # as `errors_at` has it
    if way != "discrepancy":
        squares = ((measured - mean[:, :count]) / errors) ** 2
        log = -np.sum(np.log(errors) + squares / 2, axis=1)
        return Points(mass, log, mean[:, count:], np.zeros_like(mean[:, count:]))
    log, middle, missed = np.empty(len(mean)), mean[:, count:].copy(), np.empty_like(mean[:, count:])
    for i in np.array_split(np.arange(len(mean)), len(mean) // 2000 + 1):
        kernel = covariance({name: column[i, None, None] for name, column in lacks.items()}, **both)
        joint = kernel * mean[i, :, None] * mean[i, None, :]
        known = joint[:, :count, :count] + errors[i, :, None] ** 2 * np.eye(count)
        apart = (measured - mean[i, :count])[:, :, None]
        gain = np.linalg.solve(known, np.concatenate([apart, joint[:, :count, count:]], axis=2))
        log[i] = -0.5 * (np.linalg.slogdet(known)[1] + np.sum(apart * gain[:, :, :1], axis=(1, 2)))
        middle[i] += np.einsum("nij,ni->nj", joint[:, :count, count:], gain[:, :, 0])
        left = np.einsum("nij,nij->nj", joint[:, :count, count:], gain[:, :, 1:])
        missed[i] = np.sqrt(np.maximum(np.diagonal(joint, axis1=1, axis2=2)[:, count:] - left, 0.0))
    return Points(mass, log, middle, missed)


def drops(points: Points, rng: np.random.Generator) -> np.ndarray:
    """The drop of entropy by a simulated test of each candidate [bit], shape (simulations, candidates)."""
    weights = points.mass * np.exp(points.log - points.log.max())
    kept = weights > NOTHING * weights.max()
    mass, _, mean, missed = (part[kept] for part in points)
    weights = weights[kept] / weights[kept].sum()
    predicted, errors = mean, np.hypot(missed, deviation(mean))
    truths, normal = rng.choice(len(weights), SIMULATIONS, p=weights), rng.standard_normal(SIMULATIONS)
    gains = np.full((SIMULATIONS, predicted.shape[1]), np.nan)
    has_error = np.flatnonzero(errors.all(axis=0))  # not a share of nothing
    before, logs = _entropy(weights, mass), np.log(np.where(errors > 0, errors, 1.0))
    for (i, truth), j in itertools.product(enumerate(truths), has_error):
        row = predicted[truth, j] + errors[truth, j] * normal[i]
        log = -logs[:, j] - ((row - predicted[:, j]) / errors[:, j]) ** 2 / 2
        after = weights * np.exp(log - log.max())
        gains[i, j] = before - _entropy(after / after.sum(), mass)
    return gains


def _entropy(weights: np.ndarray, mass: np.ndarray) -> float:
    some = weights > 0
    return float(-np.sum(weights[some] * np.log2(weights[some] / mass[some])))


def compared(seed: int) -> tuple[NextExperiment, np.ndarray]:
    """What the package expects of each candidate, and what the simulations of it say."""
    rng = np.random.default_rng(seed)
    table, rows = simulated(rng)
    error = erosion.ErrorModel(ERROR[0] * 1e-6, ERROR[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erosion.ConvergenceWarning)
        source = erosion.rank_posteriors(CASE, table, FREE, models=[MODEL], density=DENSITY, error=error)
    candidates = {"alpha": ANGLES[:, None], "v0": np.array(SPEEDS)}
    answer = erosion.next_experiment(source, candidates, draws=2000, discrepancy=True)
    at = {name: answer.candidates[name] for name in rows}
    ways = [on_grid(source.posteriors[0], rows, at, way, rng) for way in WAYS]
    gains = drops(Points(*map(np.concatenate, zip(*ways, strict=True))), rng)
    angle = answer.candidates["alpha"]
    beyond = (angle < ROW_ANGLES.min()) | (angle > ROW_ANGLES.max())  # by 5° and more: no way fades here
    gains[:, beyond] = drops(ways[-1], rng)[:, beyond]
    return answer, gains
