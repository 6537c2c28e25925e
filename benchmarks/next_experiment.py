"""Does `next_experiment` name the experiments that tell most? `python -m benchmarks.next_experiment`, some minutes.

By brute force, each candidate is simulated: a truth is drawn from the posterior, a row from the truth and its error,
and the posterior's entropy is measured with the row and without it. That is done without draws of the package: over a
fine grid of the parameters, by a likelihood that is written here. The same truths and errors of the row serve all
candidates within the tested angles, and all beyond them, so that differences are known better than each drop.

What a model may lack is three grids, one for each way to read the data. Each point of the last two has exponents and
lengths of a discrepancy from their priors, and the discrepancy is integrated out by dense matrices. Beyond the tested
angles the third grid counts alone, as in predictions.
"""

import itertools
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

import erosion
from benchmarks.sbc import covariance
from erosion.fits import NextExperiment
from erosion.fits.discrepancy import PRIORS
from erosion.fits.posterior import Posterior

SIMULATIONS = 200
ANGLES = np.deg2rad([10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0])
POINTS = {2: 120, 3: 64}  # of the grid along each parameter, by their number; with 44 of three 1.64 bit are 1.72
COARSE, LACKS = {2: 40}, 100  # the same where a model may lack something, and draws of that at each point
NOTHING = 1e-6  # of the greatest weight
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
        discrepancy: whether the model may lack something.
        weighings: of the candidates.
    """

    models: tuple[str, ...]
    free: tuple[str, ...]
    error: tuple[float, float]
    speeds: tuple[float, ...] = (60.0, 98.0)
    angles: tuple[float, ...] = (20.0, 40.0, 70.0)
    discrepancy: bool = False
    weighings: tuple[int, ...] = (1,)


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
    Case(("linearized",), CUT, (5, 0.08), discrepancy=True, weighings=(1, 5)),
    Case(("finnie",), CUT, (5, 0.05), angles=(15.0, 30.0, 50.0), discrepancy=True, weighings=(1, 5)),
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
    posterior: Posterior, rows: Mapping[str, np.ndarray], at: Mapping[str, np.ndarray], case: Case, way: str, rng: Any
) -> Points:
    """One way to read the data, over a grid that is uniform in logarithms as the priors are.

    Args:
        posterior: of the model.
        rows: the conditions of the data.
        at: those of the candidates.
        case: what is known of the errors.
        way: "model", "exponent" or "discrepancy".
        rng: of the exponents and the process.
    """
    drawn = posterior.predictor_with(way != "model").ways[way].values
    count = (POINTS if way == "model" else COARSE)[len(posterior.names)]
    axes = []
    for name in posterior.names:
        logs, (low, high) = np.log(drawn[name]), posterior.priors.laws[name].ppf(np.array([0.0, 1.0]))
        more = BEYOND * np.ptp(logs)
        axes.append(np.linspace(max(logs.min() - more, np.log(low)), min(logs.max() + more, np.log(high)), count))
    points = {name: np.exp(part.ravel()) for name, part in zip(posterior.names, np.meshgrid(*axes), strict=True)}
    both = {name: np.concatenate([rows[name], at[name]]) for name in rows}
    mean = posterior.likelihood.predict(points, both)
    mass = np.full(len(mean), np.prod([axis[1] - axis[0] for axis in axes]))
    lacks: dict[str, np.ndarray] = {}
    if way != "model":
        mean, mass = np.repeat(mean, LACKS, axis=0), np.repeat(mass, LACKS) / LACKS
        names = [*PRIORS] if way == "discrepancy" else ["exponent"]
        lacks = {name: PRIORS[name].ppf(rng.random(len(mean))) for name in names}
        mean = mean * (both["v0"] / rows["v0"].max()) ** (lacks["exponent"][:, None] - 2)
    if way == "discrepancy":
        mean = mean * np.sin(both["alpha"]) ** lacks["sine_exponent"][:, None]
    measured, count = posterior.data.erosion, len(posterior.data)
    errors = deviation(np.maximum(mean[:, :count], 0.5 * measured), case.error)  # as `errors_at` has it
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


def drops(points: Points, case: Case, rng: np.random.Generator) -> np.ndarray:
    """The drop of entropy by a simulated test of each candidate [bit], shape (simulations, weighings × candidates)."""
    weights = points.mass * np.exp(points.log - points.log.max())
    kept = weights > NOTHING * weights.max()
    mass, _, mean, missed = (part[kept] for part in points)
    weights = weights[kept] / weights[kept].sum()
    errors = deviation(mean, case.error)
    both = [np.hypot(missed, errors / np.sqrt(number)) for number in case.weighings]
    predicted, errors = np.tile(mean, len(both)), np.concatenate(both, axis=1)
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


def compared(case: Case, seed: int) -> tuple[NextExperiment, np.ndarray]:
    """What the package expects of each candidate, and what the simulations of it say."""
    rng = np.random.default_rng(seed)
    table, rows = simulated(case, rng)
    error = erosion.ErrorModel(case.error[0] * 1e-6, case.error[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erosion.ConvergenceWarning)
        source = erosion.rank_posteriors(CASE, table, case.free, models=case.models, density=DENSITY, error=error)
    candidates = {"alpha": ANGLES[:, None], "v0": np.array(case.speeds)}
    options = {"weighings": case.weighings, "discrepancy": case.discrepancy}
    answer = erosion.next_experiment(source, candidates, draws=2000, **options)
    at = {name: answer.candidates[name][: ANGLES.size * len(case.speeds)] for name in rows}
    ways = ("model", "exponent", "discrepancy") if case.discrepancy else ("model",)
    of_ways = {way: _joined([on_grid(posterior, rows, at, case, way, rng) for posterior in source.posteriors])
               for way in ways}  # fmt: skip
    gains = drops(_joined(of_ways.values()), case, rng)
    if case.discrepancy:
        angle = answer.candidates["alpha"]
        beyond = (angle < rows["alpha"].min()) | (angle > rows["alpha"].max())  # by 5° and more: no way fades here
        gains[:, beyond] = drops(of_ways["discrepancy"], case, rng)[:, beyond]
    return answer, gains


def _joined(parts: Iterable[Points]) -> Points:
    return Points(*map(np.concatenate, zip(*parts, strict=True)))


def main() -> None:
    """Print a line for each case."""
    print("| model | error | next_experiment [bit] | simulated [bit] | best three |\n|---|---|---|---|---|")
    same = ties = 0
    for seed, case in enumerate(CASES):
        answer, gains = compared(case, seed)
        mean, error = gains.mean(axis=0), gains.std(axis=0, ddof=1) / np.sqrt(len(gains))
        expected, found = np.argsort(-answer.total)[:BEST], np.argsort(-mean)[:BEST]
        at = answer.candidates
        times = np.ones(len(mean)) if answer.weighings is None else answer.weighings
        where = [f"{v0:.0f} m/s {angle:.0f}°{f' {count:.0f} times' if count > 1 else ''}"
                 for v0, angle, count in zip(at["v0"], np.rad2deg(at["alpha"]), times, strict=True)]  # fmt: skip
        words = (", ".join(f"{where[i]} {answer.total[i]:.3f}" for i in expected),
                 ", ".join(f"{where[i]} {mean[i]:.3f} ± {error[i]:.3f}" for i in found))  # fmt: skip
        steps = [gains[:, i] - gains[:, j] for i, j in zip(found, expected, strict=True) if i != j]
        sizes = [f"{step.mean():.4f} ± {step.std(ddof=1) / np.sqrt(len(step)):.4f}" for step in steps]
        equal = all(abs(step.mean()) < EQUAL for step in steps)
        same, ties = same + (not steps), ties + (bool(steps) and equal)
        verdict = f"{'equal' if equal else 'other'} candidates, simulated differences {', '.join(sizes)} bit"
        verdict = verdict if steps else "same order"
        shares = f"{case.error[0]:g} mg/kg + {100 * case.error[1]:g} %"
        models = f"{', '.join(case.models)}{' with what it may lack' if case.discrepancy else ''}"
        print(f"| {models} | {shares} | {words[0]} | {words[1]} | {verdict} |", flush=True)
    print(f"\n{same} of {len(CASES)} cases have the same order of the best three, {ties} but for equal candidates.")


if __name__ == "__main__":
    main()
