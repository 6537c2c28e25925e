"""Do fits, predictions and posteriors hold the truth as often as they say, and how long do they take?

Fits: synthetic data of each model. Predictions: of laws of cutting and deformation that no model of the package is,
from data sets as laboratories have them. Posteriors: simulation-based calibration, where parameters are drawn from the
priors and data from the parameters; then the rank of the true value among the draws is as often any number as another.
The discrepancy is written here once more: curves μ(1 + δ) of an exponent, a power of sin α and a Gaussian process.

References:
    S. Talts, M. Betancourt, D. Simpson, A. Vehtari, A. Gelman, Validating Bayesian inference algorithms with
    simulation-based calibration, arXiv:1804.06788 (2018).
"""

import dataclasses
import functools
import itertools
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import erosion
from benchmarks.page import Table
from erosion import ErrorModel
from erosion.advice.result import ends
from erosion.fits import Calibration, Posterior, calibrate, discrepancy, prediction
from erosion.fits.likelihood import make_likelihood
from erosion.fits.problem import FitProblem

TITLE = "Fits, predictions and posteriors"
TEXT = """How often intervals hold the truth. Fits: synthetic sets of 50 angles with errors of 3 %, intervals of 95 %.
Predictions: of the mean, in intervals of 95 %, from sets of 5 laws that no model is, with the median of their widths
over the law. Advice: after six weighings of these laws with 8 % scatter. Findings: how often fits to data of a model,
with 10 % scatter, have one. Posteriors: intervals of 90 % of simulation-based calibration; the probability is that of
ranks as uneven, if the posteriors are right. A share counts as wrong if chance makes it less often than once in 10,000
times."""

CHANCE = 1e-4
FITTED = {
    "linearized": ("k", "psi"),
    "finnie": ("k", "psi"),
    "tan-alpha": ("psi",),
    "rotating": ("k", "psi"),
    "rotating-full-torque": ("k", "psi"),
    "rotating-tan-alpha": ("r", "psi"),
    "as-printed": ("k", "psi"),
}
"""Models and the parameters that shape their curves."""
DEGREES, STEP = np.linspace(5.0, 88.0, 50, retstep=True)
NOISE = 0.03  # of the greatest volume

ROWS, ERROR = 12, 8e-11  # errors [m³], 5 % of the greatest volume at Table 1
DRAWS, THINNED = 125, 5  # of each population; every fifth is independent of the next
BINS = 20
LEVEL = 0.9

# The parameters that shape each model's curve; K = tan α leaves k without influence.
FREE = {"linearized": ("k", "psi"), "rotating": ("k", "psi"), "rotating-tan-alpha": ("r", "psi")}
PRIORS: Mapping[str, Any] = {
    "k": stats.lognorm(0.3, scale=2.0),
    "psi": stats.lognorm(0.3, scale=0.04),
    "r": stats.lognorm(0.3, scale=1e-3),
}
NOISES = {"noise": stats.loguniform(1.6e-11, 3.3e-10), "relative_noise": stats.loguniform(0.01, 0.2)}

MISSING = "linearized-deformation"  # with a discrepancy
OF_MISSING: Mapping[str, Any] = {
    "k": stats.lognorm(0.3, scale=2.0),
    "psi": stats.lognorm(0.3, scale=0.4),
    "energy_ratio": stats.lognorm(0.3, scale=2.0),
}
ANGLES, SPEEDS = (10.0, 20.0, 30.0, 45.0, 65.0, 90.0), (60.0, 98.0)  # °, m/s
SMALL = 5e-12  # m³, 2 to 10 % of a row
OF_NOISE = {"noise": stats.loguniform(5e-13, 2e-11), "relative_noise": stats.loguniform(0.01, 0.2)}


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
        data = {"angle [deg]": degrees, "volume [m^3/impact]": volume + error * rng.standard_normal(ROWS)}
        data |= {"uncertainty [m^3]": error} if known else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", erosion.ConvergenceWarning)  # R̂ of 125 draws passes 1.01 by chance
            samples = erosion.posterior(
                erosion.FitProblem(model, erosion.TABLE_1, data, free, priors=laws), draws=DRAWS, seed=of_set
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
        faster, sine = speeds / max(SPEEDS), np.sin(np.deg2rad(degrees))
        of_model = erosion.impact(model, p).volume
        mean = of_model * faster ** (truth["exponent"] - 2) * sine ** truth["sine_exponent"]
        mean += truth["normal_wear"] * np.max(of_model * faster**-2) * sine**2 * faster ** truth["exponent"]
        missing = np.linalg.cholesky(covariance(truth, np.deg2rad(degrees), speeds)) @ rng.standard_normal(len(mean))
        error = np.full(len(mean), SMALL) if known else np.hypot(truth["noise"], truth["relative_noise"] * mean)
        volume = mean * (1 + missing) + error * rng.standard_normal(len(mean))
        data = {"angle [deg]": degrees, "speed [m/s]": speeds, "volume [m^3/impact]": volume}
        data |= {"uncertainty [m^3]": error} if known else {}
        priors = {name: law for name, law in laws.items() if name not in discrepancy.PRIORS}
        problem = FitProblem(MISSING, case, data, [*OF_MISSING], priors=priors)
        misfit = discrepancy.Discrepant(make_likelihood(problem), has_exponent=True, has_discrepancy=True)
        return prediction.drawn(misfit, {}, np.random.default_rng(of_set)).values

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


FASTEST = 98.0  # m/s
STATED = ErrorModel(0.3e-6, 0.08)  # 0.3 mg/kg + 8 %
ASKED = (1.5, 2.0)  # speeds, over the fastest
TO_60 = (10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0)
WEIGHED = np.array([15.0, 30.0, 45.0, 60.0, 75.0, 90.0])
CASE = erosion.TABLE_1.to("si").replace(v0=FASTEST)
DENSITY = 8000.0

_Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _sin(degrees: np.ndarray) -> np.ndarray:
    return np.sin(np.deg2rad(degrees))


def _cos(degrees: np.ndarray) -> np.ndarray:
    return np.maximum(np.cos(np.deg2rad(degrees)), 0.0)


def _law(height: float, cut: Callable[[np.ndarray], np.ndarray], deformed: Callable[..., np.ndarray], n: float) -> _Law:
    """`height` times the cut over its greatest value, as (v/98)^n, and the deformation's part of the height."""
    top = float(cut(np.linspace(0.5, 90.0, 500)).max())
    return lambda degrees, v: height * (cut(degrees) / top * (v / FASTEST) ** n + deformed(degrees, v / FASTEST))


def _powers(a: float, b: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda degrees: _sin(degrees) ** a * _cos(degrees) ** b


def _bulk(share: float, q: float, n: float) -> Callable[..., np.ndarray]:
    return lambda degrees, v: share * _sin(degrees) ** q * v**n


def _above(share: float, threshold: float) -> Callable[..., np.ndarray]:
    """A threshold of the normal speed, over the fastest speed."""
    return lambda degrees, v: share * (np.maximum(v * _sin(degrees) - threshold, 0.0) / (1 - threshold)) ** 2


LAWS: Mapping[str, _Law] = {
    "usual cut": _law(350.0, _powers(1.2, 2.0), _bulk(0.4, 2.4, 2.5), 2.5),
    "hump": _law(300.0, lambda d: np.exp(-0.5 * ((d - 27.0) / 14.0) ** 2) * _sin(d), _bulk(0.45, 2.0, 2.3), 2.3),
    "normal speed": _law(240.0, _powers(0.7, 2.2), _bulk(0.55, 2.7, 2.7), 2.2),
    "long tail": _law(400.0, lambda d: _sin(d) / (1 + (d / 25.0) ** 2) * _cos(d) ** 0.5, _bulk(0.3, 1.8, 2.0), 2.0),
    "kink": _law(320.0, lambda d: np.minimum(d / 22.0, 1.0) * _cos(d) ** 1.7, _bulk(0.35, 2.5, 2.7), 2.7),
}

DESIGNS: Sequence[tuple[Sequence[float], int]] = (
    ((10, 15, 20, 25, 30, 40, 50, 60, 75, 90), 2),
    ((10, 20, 30, 45, 65, 90), 1),
    ((20, 25, 30, 35, 40, 45, 50, 60, 70, 80), 1),
    ((20, 30, 40, 50, 65, 80), 1),
)
"""Angles [°] at two speeds, and how often each is tested."""
RATIOS = (1.4, 1.6, 2.0)  # of the two speeds


Questions = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""By place, angles [°] and speeds [m/s]."""


def made_up(law: _Law, index: int, key: int) -> tuple[dict[str, np.ndarray], Questions]:
    """The data set `index` of a law, whose number is `key`, and what is asked of it."""
    rng = np.random.default_rng([38, key, index])
    angles, repeats = DESIGNS[index % len(DESIGNS)]
    slow = FASTEST / RATIOS[index // len(DESIGNS) % len(RATIOS)]
    degrees, speeds = (part.ravel() for part in np.meshgrid(np.repeat(angles, repeats), (slow, FASTEST)))
    true = law(degrees, speeds)
    measured = np.maximum(true + rng.standard_normal(true.size) * np.hypot(0.3, 0.08 * true), 0.3)
    inside = np.array((12.0, 22.0, 35.0, 55.0, 80.0) if angles[0] == 10 else (22.0, 35.0, 48.0, 55.0, 75.0))
    between = slow + (FASTEST - slow) * np.array([0.25, 0.8])
    asked = {"inside": (np.tile(inside, 2), np.repeat(between, len(inside)))}
    asked |= {f"{factor} × the fastest": (inside, np.full(inside.shape, factor * FASTEST)) for factor in ASKED}
    if angles[0] == 20:
        asked |= {f"at {end}°": (np.full(2, float(end)), np.array([between[0], FASTEST])) for end in (10, 90)}
    table = {"angle [deg]": degrees, "speed [m/s]": speeds, "mass_loss [mg/kg]": measured}
    return table, asked


def fitted(model: str, sets: int) -> dict[str, np.ndarray]:
    """Whether intervals of a fit hold the truth, by parameter."""
    truth, held = erosion.TABLE_1.to("si"), {name: np.zeros(sets, bool) for name in FITTED[model]}
    guess = truth.replace(k=3.0, psi=0.06, **({"r": 1.25e-3} if "r" in held else {}))
    for seed in range(sets):
        random = np.random.default_rng(seed)
        # Each set has its own angles: a jump of V(α) may lie between any two rows.
        degrees = DEGREES + random.uniform(-STEP / 2, STEP / 2, DEGREES.size)
        exact = np.asarray(erosion.impact(model, truth.replace(alpha=np.deg2rad(degrees))).volume)
        error = np.full(degrees.size, NOISE * exact.max())
        data = {"angle [deg]": degrees, "volume [m^3/impact]": exact + error * random.standard_normal(degrees.size)}
        intervals = calibrate(FitProblem(model, guess, data | {"uncertainty [m^3]": error}, FITTED[model])).intervals()
        for name, (low, high) in intervals.items():
            held[name][seed] = low <= float(getattr(truth, name)) <= high
    return held


def to_60(law: _Law, index: int, key: int) -> tuple[dict[str, np.ndarray], Questions]:
    """The same of tests that end at 60°."""
    rng = np.random.default_rng([60, key, index])
    degrees, speeds = (part.ravel() for part in np.meshgrid(TO_60, (FASTEST / RATIOS[index % len(RATIOS)], FASTEST)))
    true = law(degrees, speeds)
    measured = np.maximum(true + rng.standard_normal(true.size) * np.hypot(0.3, 0.08 * true), 0.3)
    table = {"angle [deg]": degrees, "speed [m/s]": speeds, "mass_loss [mg/kg]": measured}
    return table, {f"to 60°, at {end}°": (np.array([end]), np.array([FASTEST])) for end in (8.0, 68.0, 83.0, 90.0)}


def _drawn(table: Mapping[str, np.ndarray]) -> Posterior:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erosion.ConvergenceWarning)
        return erosion.posterior(
            erosion.FitProblem(MISSING, CASE, table, [*OF_MISSING], density=DENSITY, error=STATED), draws=150
        )


def _fitted(table: Mapping[str, np.ndarray]) -> Calibration:
    return calibrate(FitProblem(MISSING, CASE, table, [*OF_MISSING], density=DENSITY, error=STATED))


def predicted(
    fit: Callable[[Mapping[str, np.ndarray]], Posterior | Calibration], law: _Law, key: int, sets: int
) -> dict[str, np.ndarray]:
    """Whether intervals of predictions hold a law, and their widths over it, by place, shape (2, questions)."""
    held: dict[str, list[np.ndarray]] = {}
    for index, make in itertools.product(range(sets), (made_up, to_60)):
        table, asked = make(law, index, key)
        predictor = fit(table).predictor
        for place, (degrees, speeds) in asked.items():
            draws = 1e6 * predictor.draw(np.deg2rad(degrees), {"v0": speeds}, 2000)
            low, high = np.quantile(draws, [0.025, 0.975], axis=0)
            true = law(degrees, speeds)
            held.setdefault(place, []).append(np.stack([(low <= true) & (true <= high), (high - low) / true]))
    return {place: np.concatenate(each, axis=1) for place, each in held.items()}


class Advised(NamedTuple):
    """An advice after six weighings of a law.

    Args:
        share: of the greatest removal at the advised angle.
        of_cubic: the same at the top of a cubic through the weighings.
        holds: whether the amount at half the speed of the tests is in its interval.
    """

    share: float
    of_cubic: float
    holds: bool


def advised(law: _Law, key: int, index: int) -> Advised:
    """Weigh a law at six angles, fit, and ask for the angle, and for the amount at half the speed."""
    rng, fine = np.random.default_rng([61, key, index]), np.linspace(5.0, 90.0, 341)
    true = law(WEIGHED, np.full(WEIGHED.shape, FASTEST))
    measured = true * (1 + 0.08 * rng.standard_normal(true.size))
    fit = calibrate(
        FitProblem(
            MISSING,
            CASE,
            {"angle [deg]": WEIGHED, "mass_loss [mg/kg]": measured},
            [*OF_MISSING],
            density=DENSITY,
            error="8 %",
        )
    )
    options: dict[str, Any] = {"spread": 1e-3, "density": DENSITY, "models": [fit.model], "uncertain": fit}
    removed = law(fine, np.full(fine.shape, FASTEST)) / law(fine, np.full(fine.shape, FASTEST)).max()
    cubic = np.polynomial.Polynomial.fit(WEIGHED, measured, 3)(fine)
    inside = (fine >= WEIGHED[0]) & (fine <= WEIGHED[-1])
    of_cubic = float(removed[inside][np.argmax(cubic[inside])])
    share = float(np.interp(np.rad2deg(erosion.advise(fit.p, **options).alpha), fine, removed))
    slow = erosion.advise(fit.p.replace(v0=FASTEST / 2), **options)
    low, high = ends(slow.group("draws"), lambda curve: curve.at(slow.alpha))
    amount = law(np.array([np.rad2deg(slow.alpha)]), np.array([FASTEST / 2]))[0] * 1e-6
    return Advised(share, of_cubic, bool(low <= amount <= high))


def patterns(sets: int, jitter: float) -> np.ndarray:
    """Whether a fit to noise of one speed, that the rig repeats to a share, has a pattern, shape (sets,)."""
    degrees, seen = np.repeat(WEIGHED, 3), np.zeros(sets, bool)
    for seed in range(sets):
        rng = np.random.default_rng([62, seed])
        speeds = 60.0 * (1 + jitter * rng.uniform(-1, 1, degrees.size))
        fit = _noisy(degrees, speeds, 2.0, [*OF_MISSING], rng)
        seen[seed] = any(pattern.seen for pattern in erosion.check(fit).patterns)
    return seen


def exponents(sets: int, exponent: float) -> np.ndarray:
    """Whether a fit at one angle and 6 to 10 speeds names a wrong exponent of the speed, shape (sets,)."""
    seen = np.zeros(sets, bool)
    for seed in range(sets):
        rng, speeds = np.random.default_rng([63, seed]), np.geomspace(40.0, 160.0, 6 + seed % 5)
        fit = _noisy(np.full(speeds.shape, 30.0), speeds, exponent, ["psi"], rng)
        seen[seed] = any(pattern.seen and pattern.over == "speed" for pattern in erosion.check(fit).patterns)
    return seen


def _noisy(
    degrees: np.ndarray, speeds: np.ndarray, exponent: float, free: Sequence[str], rng: np.random.Generator
) -> Calibration:
    """A fit to what its model removes, as another power of the speed, with a scatter of 10 %."""
    volume = erosion.impact(MISSING, CASE.replace(alpha=np.deg2rad(degrees), v0=speeds)).volume
    volume = volume * (speeds / 60.0) ** (exponent - 2) * (1 + 0.1 * rng.standard_normal(speeds.size))
    table = {"angle [deg]": degrees, "speed [m/s]": speeds, "volume [m^3/impact]": volume}
    return calibrate(FitProblem(MISSING, CASE, table, free), starts=4)


def too_few(held: np.ndarray, level: float) -> bool:
    """Whether chance seldom makes so small a share."""
    return bool(stats.binom.cdf(held.sum(), held.size, level) < CHANCE)


def measure(quick: bool) -> Table:
    """A row for each parameter, place and posterior."""
    rows: list[list[Any]] = []
    wrong = 0

    def timed(function: Callable[[], Any], sets: int) -> tuple[Any, float]:
        begin = time.perf_counter()
        result = function()
        return result, (time.perf_counter() - begin) / sets

    sets = 2 if quick else 100
    for model in [*FITTED][: 1 if quick else None]:
        held, seconds = timed(functools.partial(fitted, model, sets), sets)
        for name, each in held.items():
            rows.append([f"fit of {model}", name, each.size, f"{each.mean():.1%}", None, seconds])
            wrong += too_few(each, 0.95)
    sets = 1 if quick else 12
    for way, fit in (("posterior", _drawn), ("fit", _fitted)):
        of_laws: dict[str, list[np.ndarray]] = {}
        begin = time.perf_counter()
        for key, law in enumerate(LAWS.values()):
            for place, each in predicted(fit, law, key, sets).items():
                of_laws.setdefault(place, []).append(each)
        seconds = (time.perf_counter() - begin) / sets / len(LAWS) / 2
        for place, parts in of_laws.items():
            each, widths = np.concatenate(parts, axis=1)
            label = f"prediction by a {way}, median width {np.median(widths):.2f}"
            rows.append([label, place, each.size, f"{each.mean():.1%}", None, seconds])
    sets = 1 if quick else 8
    answers, seconds = timed(
        lambda: [advised(law, key, i) for key, law in enumerate(LAWS.values()) for i in range(sets)], sets * len(LAWS)
    )
    shares, of_cubic, holds = (np.array(part) for part in zip(*answers, strict=True))
    rows.append(["advice after six weighings", "amount at half the speed", holds.size, f"{holds.mean():.1%}", None,
                 seconds])  # fmt: skip
    for name, each in (("the advised angle", shares), ("a cubic", of_cubic)):
        words = f"share removed: median {np.median(each):.3f}, worst {each.min():.3f}, mean {each.mean():.3f}"
        rows.append([words, name, each.size, None, None, seconds])
    sets = 2 if quick else 300
    for name, check in (
        ("a pattern at equal speeds", functools.partial(patterns, jitter=0.0)),
        ("a pattern at speeds ± 1 %", functools.partial(patterns, jitter=0.01)),
        *((f"a wrong exponent of {n:g}", functools.partial(exponents, exponent=n)) for n in (2.0, 2.5, 2.7, 2.9)),
    ):
        seen, seconds = timed(functools.partial(check, sets), sets)
        rows.append(["finding of a fit", name, sets, f"{seen.mean():.1%} seen", None, seconds])
    sets = 2 if quick else 150
    for model in [*FREE, MISSING][: 1 if quick else None]:
        of_model = calibrated_discrepancy if model == MISSING else functools.partial(calibrated, model)
        for known in (True, False):
            ranks, seconds = timed(functools.partial(of_model, sets, known=known), sets)
            for name, p, each in zip(ranks.names, ranks.probabilities, ranks.covered.T, strict=True):
                noise = "known" if known else "sampled"
                label = f"posterior of {model}, noise {noise}"
                rows.append([label, name, sets, f"{each.mean():.1%}", float(p), seconds])
                wrong += not quick and (too_few(each, LEVEL) or bool(p < CHANCE))
    return Table(["", "of", "intervals", "hold the truth", "probability", "s a set"], rows, wrong)
