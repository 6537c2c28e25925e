"""The posterior beside other samplers, and Sobol's indices beside SALib: `python -m benchmarks.samplers`.

The likelihood and the priors are typed here once more, for dynesty (nested sampling: also the evidence) and for emcee.
Means must agree within the Monte-Carlo errors of both, deviations within a tenth, ln Z within 0.2 and the errors.
"""

import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import dynesty
import emcee
import numpy as np
from SALib.analyze import sobol as analysis
from SALib.sample import sobol as sampling

import erosion
from erosion.distributions import LogNormal, Normal, Uniform

MODEL, FREE = "rotating", ("k", "psi")
TRUTH = {"k": 2.0, "psi": 0.04}
PRIORS: Mapping[str, Any] = {"k": Uniform(0.5, 5.0), "psi": Uniform(0.01, 0.2)}
ROWS, ERROR = 15, 3e-6  # in³
INPUTS: Mapping[str, Any] = {
    "alpha": Normal(0.45, 0.05),
    "v0": LogNormal(4400.0, 0.1),
    "k": Uniform(1.5, 2.5),
    "energy_ratio": Uniform(1.0, 2.0),
}


class Estimate(NamedTuple):
    """What a sampler says.

    Args:
        name: of the sampler.
        mean: of each parameter.
        deviation: of each parameter.
        error: of each mean.
        log_evidence: and its error; None where it has none.
        seconds: that it took.
    """

    name: str
    mean: np.ndarray
    deviation: np.ndarray
    error: np.ndarray
    log_evidence: tuple[float, float] | None
    seconds: float

    def __str__(self) -> str:
        numbers = ", ".join(
            f"{name} {mean:.4g} ± {deviation:.3g} (mean to {error:.1g})"
            for name, mean, deviation, error in zip(FREE, self.mean, self.deviation, self.error, strict=True)
        )
        evidence = "" if self.log_evidence is None else "; ln Z {:.2f} ± {:.2f}".format(*self.log_evidence)
        return f"{self.name:24s} {numbers}{evidence}; {self.seconds:.0f} s"


def made_up_rows() -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] and volumes [in³] with errors."""
    rng = np.random.default_rng(1958)
    alpha = np.deg2rad(np.sort(rng.uniform(5.0, 85.0, ROWS)))
    exact = erosion.impact(MODEL, erosion.TABLE_1.replace(alpha=alpha, **TRUTH)).volume
    return alpha, np.asarray(exact) + ERROR * rng.standard_normal(ROWS)


def log_likelihood(alpha: np.ndarray, volume: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Of points, shape (n, parameters): independent normal errors, known."""

    def of(points: np.ndarray) -> np.ndarray:
        values = {name: column[:, None] for name, column in zip(FREE, np.atleast_2d(points).T, strict=True)}
        expected = erosion.impact(MODEL, erosion.TABLE_1.replace(alpha=alpha, **values)).volume
        return np.sum(-0.5 * ((volume - expected) / ERROR) ** 2 - np.log(ERROR * np.sqrt(2 * np.pi)), axis=-1)

    return of


def own(alpha: np.ndarray, volume: np.ndarray) -> Estimate:
    """The package's."""
    begun = time.perf_counter()
    data = {"angle [rad]": alpha, "volume [in^3]": volume, "uncertainty [in^3]": np.full(ROWS, ERROR)}
    posterior = erosion.posterior(MODEL, erosion.TABLE_1, data, free=FREE, priors=PRIORS, seed=1)
    draws = np.stack([np.ravel(posterior.samples[name]) for name in FREE])
    populations = np.stack([posterior.samples[name] for name in FREE]).mean(axis=-1)
    error = populations.std(axis=-1, ddof=1) / np.sqrt(populations.shape[-1])
    evidence = float(posterior.log_evidence), float(posterior.log_evidence_error)
    return Estimate("erosion", draws.mean(1), draws.std(1), error, evidence, time.perf_counter() - begun)


def of_dynesty(likelihood: Callable[[np.ndarray], np.ndarray]) -> Estimate:
    """Nested sampling with 500 live points."""
    begun = time.perf_counter()
    make: Any = dynesty.NestedSampler  # its metaclass reads the arguments
    sampler = make(
        lambda point: float(likelihood(point)[0]),
        lambda cube: np.array([PRIORS[name].ppf(share) for name, share in zip(FREE, cube, strict=True)]).ravel(),
        len(FREE),
        nlive=500,
        rstate=np.random.default_rng(1),
    )
    sampler.run_nested(print_progress=False)
    results: Any = sampler.results
    mean, covariance = dynesty.utils.mean_and_cov(results.samples, results.importance_weights())
    deviation = np.sqrt(np.diag(covariance))
    weights = results.importance_weights()
    error = deviation * np.sqrt(np.sum(weights**2))
    evidence = float(results.logz[-1]), float(results.logzerr[-1])
    return Estimate("dynesty", mean, deviation, error, evidence, time.perf_counter() - begun)


def of_emcee(likelihood: Callable[[np.ndarray], np.ndarray]) -> Estimate:
    """An ensemble of 32 walkers from the prior's middle, 4000 steps, of which the first 1000 are left out."""
    begun = time.perf_counter()
    low, high = (np.array([float(PRIORS[name].ppf(share)) for name in FREE]) for share in (0.0, 1.0))

    def log_posterior(points: np.ndarray) -> np.ndarray:
        inside = np.all((points > low) & (points < high), axis=1)
        values = np.full(len(points), -np.inf)
        if inside.any():
            values[inside] = likelihood(points[inside])
        return values

    np.random.seed(1)  # noqa: NPY002 (emcee takes its numbers there)
    sampler = emcee.EnsembleSampler(32, len(FREE), log_posterior, vectorize=True)
    sampler.run_mcmc(low + (high - low) * np.random.default_rng(2).uniform(0.2, 0.6, (32, len(FREE))), 4000)
    draws: Any = sampler.get_chain(discard=1000, flat=True)
    deviation = draws.std(axis=0)
    error = deviation * np.sqrt(sampler.get_autocorr_time(discard=1000) / len(draws))
    return Estimate("emcee", draws.mean(axis=0), deviation, error, None, time.perf_counter() - begun)


def agree(first: Estimate, other: Estimate) -> bool:
    """Whether two samplers draw from one posterior, as far as can be told."""
    apart = np.abs(first.mean - other.mean) <= 4 * np.hypot(first.error, other.error)
    alike = np.abs(np.log(first.deviation / other.deviation)) <= 0.1
    if first.log_evidence is None or other.log_evidence is None:
        return bool(apart.all() and alike.all())
    (value, error), (expected, its_error) = first.log_evidence, other.log_evidence
    return bool(apart.all() and alike.all() and abs(value - expected) <= 0.2 + 2 * np.hypot(error, its_error))


def indices() -> bool:
    """Total indices of four independent inputs, here and by SALib; whether they agree."""
    model = "linearized-deformation"
    stream = erosion.stream(model, erosion.TABLE_1, n=2**17, seed=1, **INPUTS)
    assert stream.sensitivities is not None
    own = {name: total.value for name, (_, total) in stream.sensitivities.items()}
    problem = {"num_vars": len(INPUTS), "names": list(INPUTS), "bounds": [[0.0, 1.0]] * len(INPUTS)}
    shares = sampling.sample(problem, 2**14, calc_second_order=False, seed=1)
    # Sobol's first point is 0, where a normal law has no value.
    shares = np.clip(shares, 1e-9, 1 - 1e-9)
    values = {name: np.asarray(law.ppf(column)) for (name, law), column in zip(INPUTS.items(), shares.T, strict=True)}
    energy_ratio = values.pop("energy_ratio")
    loaded = erosion.load_model(model).replace(energy_ratio=energy_ratio)
    volume = np.asarray(erosion.impact(loaded, erosion.TABLE_1.replace(**values)).volume)
    result = analysis.analyze(problem, volume, calc_second_order=False, seed=1)
    right = True
    for i, name in enumerate(INPUTS):
        total, error = result["ST"][i], result["ST_conf"][i]
        right &= abs(own[name] - total) <= 2 * error
        print(f"total index of {name:14s} {own[name]:.4f}, by SALib {total:.4f} ± {error:.4f}")
    return right


def main() -> int:
    """Print all; 1 where they disagree."""
    alpha, volume = made_up_rows()
    likelihood = log_likelihood(alpha, volume)
    estimate = own(alpha, volume)
    print(estimate, flush=True)
    right = True
    for other in (of_dynesty(likelihood), of_emcee(likelihood)):
        right &= agree(estimate, other)
        print(other, flush=True)
    return 0 if indices() and right else 1


if __name__ == "__main__":
    sys.exit(main())
