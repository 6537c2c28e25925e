"""`check`: tests of the residuals of a fit.

Over the angle, noise changes its sign about every second row; fewer runs of one sign are a pattern
(Wald and Wolfowitz). Over speed and mass, the fit is tested for one more exponent (Student).
Without uncertainties the rows' own scatter about a smooth curve says how large noise is: residuals of a greater
variance are a pattern too (Fisher), which few rows show where their signs say nothing. Repeats say how large noise is
with any model (Fisher).
"""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import special, stats

from erosion.fits.conditions import Condition, group_numbers
from erosion.fits.measurements import Measurements, conditions
from erosion.fits.outliers import error_sizes
from erosion.output.tables import format_number
from erosion.parameters.quantities import table_scale
from erosion.results import Columns, Declared, Finding, Result, Value

if TYPE_CHECKING:
    from erosion.fits.calibration import Calibration

RARE = 0.01  # probability of such a pattern in noise; below it the pattern is said
_REFITS = 5  # of a fit with one more exponent, from the fit without it
_UNUSUAL = 0.03  # the same of an exponent: six speeds with a scatter of 10 % would seldom show one otherwise
_EXACT = 1e-6  # residuals over the erosion that are rounding errors of fits, not noise
_WORDS = {"v0": "speed", "m": "mass"}
_SMOOTH = 3  # degree of the polynomial in the angle that a curve of erosion with one maximum is near to


@dataclasses.dataclass(frozen=True)
class Pattern:
    """The result of one test of the residuals.

    Args:
        over: "angle", "speed" or "mass"; "scatter" for the size of the residuals.
        statistic: runs of one sign less those expected of noise, over their standard deviation;
            over speed and mass the exponent that the fit lacks; of the size the ratio of the variances.
        probability: that noise has such a pattern or a clearer one.
        finding: what is said of it where it is seen.
        level: probability below which that is.
    """

    over: str
    statistic: float
    probability: float
    finding: Finding
    level: float = RARE

    @property
    def seen(self) -> bool:
        """Whether noise alone would seldom look so."""
        return self.probability < self.level


def is_beyond_scatter(fit: "Calibration") -> bool:
    """Whether the residuals are greater than the rows' scatter, where no uncertainties are given."""
    pattern = _scatter(fit)
    return pattern is not None and pattern.seen


def _scatter(fit: "Calibration") -> Pattern | None:
    """Fisher's test of the residuals' variance against that of the rows about smooth curves.

    None for too few rows, for given uncertainties and for rounding errors. A robust loss lets rows be far off, which
    the test takes for a miss: None for it, too.
    """
    data, fitted, freedom, squares, scatter_freedom = fit.data, fit.fitted, fit.degrees_of_freedom, 0.0, 0
    if data.uncertainty is not None or fit.squares.loss != "linear" or not _are_noise(fit):
        return None
    for group in conditions(data):
        angle, erosion = data.angle[group.rows], data.erosion[group.rows]
        degree = min(_SMOOTH, len(np.unique(angle)) - 1)
        if len(erosion) > degree + 1:
            smooth = np.polynomial.Polynomial.fit(angle, erosion, degree)
            squares += float(np.sum((erosion - smooth(angle)) ** 2))
            scatter_freedom += len(erosion) - degree - 1
    if scatter_freedom == 0:
        return None
    residuals = data.over_errors(data.erosion - fitted) * data.deviation
    variance, of_scatter = float(np.sum(residuals**2)) / freedom, squares / scatter_freedom
    ratio, probability = variances_differ((variance, freedom), (of_scatter, scatter_freedom), data.erosion)
    scale = table_scale(data.dimension, data.shown_in, float(np.sqrt(variance)))
    residual, scatter = (
        scale.beside(format_number(np.sqrt(square), 3, scale.size)) for square in (variance, of_scatter)
    )
    numbers = {"residual": residual, "scatter": scatter, "probability": probability, **worst_row(data, fitted)}
    return Pattern("scatter", ratio, probability, Finding("misfit_beyond_scatter", "", numbers))


def variances_differ(first: tuple[float, int], second: tuple[float, int], erosion: np.ndarray) -> tuple[float, float]:
    """The ratio of two variances, each with its degrees of freedom, and the probability that noise makes it as great.

    Variances that are rounding errors of the `erosion` are alike.
    """
    least = float(np.mean((_EXACT * erosion) ** 2))
    ratio = max(first[0], least) / max(second[0], least)
    return ratio, float(stats.f.sf(ratio, first[1], second[1]))


def worst_row(data: Measurements, fitted: np.ndarray) -> dict[str, str]:
    """The row that is furthest from the fit, and what fit and data have there, for findings."""
    deviation = 1.0 if data.uncertainty is None else data.whole_error
    row = int(np.argmax(np.abs((data.erosion - fitted) / deviation)))
    label = data.condition_of(row)
    where = f"{np.rad2deg(data.angle[row]):.3g}°{f', {label}' if label else ''}"
    return {"row": where, "fitted": data.in_words(fitted[row]), "measured": data.in_words(data.erosion[row])}


class LackOfFit(NamedTuple):
    """The misfit of repeats' means against the scatter of repeats, which no model can explain.

    Args:
        ratio: of the two variances, F.
        probability: that a model that is right has such a ratio or a greater one.
        scatter: root of the repeats' variance, over the stated errors if there are any [of the data without].
        scatter_in_words: the same with its unit.
    """

    ratio: float
    probability: float
    scatter: float
    scatter_in_words: str


def _lack_of_fit(data: Measurements, fitted: np.ndarray, rank: int) -> LackOfFit | None:
    """Fisher's test by repeats; None where too few rows or conditions are repeated.

    Args:
        data: the measurements.
        fitted: the erosion of the fit, shape (rows,).
        rank: the determined combinations of parameters.
    """
    places, weight, residuals = data.repeats, data.deviation**-2, data.erosion - fitted
    means = (np.bincount(places, weight * residuals) / np.bincount(places, weight))[places]
    distinct = int(places.max()) + 1
    freedom, of_means = len(data) - distinct, distinct - rank
    scatter, misfit = (float(np.sum(data.over_errors(part) ** 2)) for part in (residuals - means, means))
    if freedom < 1 or of_means < 1 or not scatter > 0:
        return None
    ratio = float(misfit / of_means / (scatter / freedom))
    size = float(np.sqrt(scatter / freedom))
    if data.uncertainty is not None:
        in_words = f"{size:.2g} stated errors"
    else:
        size *= float(data.deviation[0])
        scale = data.scale_of(size)
        in_words = scale.beside(format_number(size, 3, scale.size))
    return LackOfFit(ratio, float(stats.f.sf(ratio, of_means, freedom)), size, in_words)


def _are_noise(fit: "Calibration") -> bool:
    """Whether residuals are more than rounding errors."""
    return float(np.linalg.norm(fit.residuals)) > _EXACT * float(np.linalg.norm(fit.data.erosion))


def over_angle(data: Measurements, residuals: np.ndarray, groups: Sequence[Condition]) -> Pattern | None:
    """The runs test, within each group; None where it cannot be made.

    Args:
        data: the measurements.
        residuals: measured less fitted, over their standard deviations, shape (rows,).
        groups: rows of one speed and mass.
    """
    runs, steps, counted, expected, variance = list[tuple[np.ndarray, str]](), 0, 0, 0.0, 0.0
    has_both_signs = False
    for group in groups:
        rows = group.rows[np.argsort(data.angle[group.rows], kind="stable")]
        rows = rows[residuals[rows] != 0]
        if len(rows) > 1:
            above = residuals[rows] > 0
            runs += [(run, group.label) for run in np.split(rows, np.flatnonzero(above[1:] != above[:-1]) + 1)]
            has_both_signs |= bool(above.any() and not above.all())
            n, product = len(rows), 2.0 * above.sum() * (~above).sum()
            expected += 1 + product / n
            variance += product * (product - n) / (n**2 * (n - 1))
            steps += n - 1
            counted += 1
    if not runs or (variance == 0 and has_both_signs):
        return None
    if variance == 0:  # one sign in each group: noise has either sign at even odds
        expected, variance = counted + steps / 2, steps / 4
    statistic = (len(runs) - expected) / np.sqrt(variance)
    probability = float(stats.norm.cdf(statistic + 0.5 / np.sqrt(variance)))  # a count is half a step wide
    longest, label = max(runs, key=lambda run: len(run[0]))
    first, last = data.angle[longest[[0, -1]]]
    numbers = {"runs": len(runs), "expected": expected, "deviation": np.sqrt(variance), "probability": probability,
               "first": first, "last": last, "side": "above" if residuals[longest[0]] > 0 else "below"}  # fmt: skip
    return Pattern("angle", float(statistic), probability, Finding("pattern_over_angle", label, numbers))


def _growth(
    data: Measurements, residuals: np.ndarray, fitted: np.ndarray, slopes: np.ndarray, name: str
) -> Pattern | None:
    """Student's test of one more exponent, of speed or mass, on the fitted erosion; None where rows cannot have one.

    Errors that are not known have an absolute and a relative part, whose ratio is averaged over its likelihoods.

    Args:
        data: the measurements.
        residuals: measured less fitted, over their standard deviations, shape (rows,).
        fitted: the erosion of the fit, shape (rows,).
        slopes: of the residuals along directions that are determined, shape (rows, directions).
        name: "v0" or "m".
    """
    values, freedom, known = data.varied[name], len(data) - slopes.shape[1] - 1, data.uncertainty is not None
    if freedom < 1 or not group_numbers(values).any():
        return None
    logs_of_values = np.log(values) - np.mean(np.log(values))
    whole = data.over_errors(fitted)
    found = []
    for size in [np.ones(len(data))] if known else error_sizes(fitted):
        mean, rates, exponent, triangle = whole / size, slopes / size[:, None], 0.0, np.eye(1)
        rows, least = residuals / size + mean, float(np.mean((_EXACT * mean) ** 2))
        for _ in range(_REFITS):
            matrix = np.column_stack([rates, mean * logs_of_values])
            basis, triangle = np.linalg.qr(matrix)
            if abs(triangle[-1, -1]) <= _EXACT * np.linalg.norm(matrix[:, -1]):  # the fit has an exponent already
                return None
            steps = np.linalg.solve(triangle, basis.T @ (rows - mean))
            exponent, power = exponent + steps[-1], np.exp(steps[-1] * logs_of_values)
            mean, rates = (mean + rates @ steps[:-1]) * power, rates * power[:, None]
        misfit = max(float(np.sum((rows - mean) ** 2)), freedom * least)
        deviation = np.sqrt(max(misfit / freedom, float(known))) / abs(triangle[-1, -1])
        law = stats.norm if known else stats.t(freedom)
        # Of the ratio, with the slopes and the exponent integrated out.
        log_likelihood = (
            -np.log(size).sum() - np.log(np.abs(np.diagonal(triangle))).sum() - freedom / 2 * np.log(misfit)
        )
        found.append((log_likelihood, exponent, deviation, 2 * float(law.sf(abs(exponent) / deviation))))
    logs, *numbers = np.array(found).T
    exponent, deviation, probability = (float(special.softmax(logs) @ column) for column in numbers)
    numbers = {"quantity": _WORDS[name], "exponent": exponent, "error": deviation, "probability": probability}
    return Pattern(_WORDS[name], exponent, probability, Finding("other_power", "", numbers), _UNUSUAL)


@dataclasses.dataclass(frozen=True, repr=False)
class ResidualChecks(Result):
    """The tests of the residuals of a fit.

    Args:
        patterns: of the tests that can be made.
        lack_of_fit: against the scatter of repeats; None without repeats, and for a robust loss.
        source: the model and the data.
    """

    lines = ("patterns",)

    patterns: tuple[Pattern, ...]
    lack_of_fit: LackOfFit | None
    source: str

    @property
    def title(self) -> str:
        """The fit."""
        return f"tests of the residuals; {self.source}"

    @property
    def of_repeats(self) -> list[Value]:
        """The test by repeats, if it can be made."""
        lack = self.lack_of_fit
        if lack is None:
            return []
        words = f"of lack of fit, probability {lack.probability:.2g}; repeats scatter by {lack.scatter_in_words}"
        return [Value("lack_of_fit", lack.ratio, "F", words, digits=5)]

    @property
    def of_patterns(self) -> Columns:
        """Statistic and probability of each test for a pattern."""
        columns = [Value(name, [getattr(pattern, name) for pattern in self.patterns], digits=3)
                   for name in ("over", "statistic", "probability", "level", "seen")]  # fmt: skip
        return Columns("patterns", "patterns in the residuals", columns)

    def declare(self) -> list[Declared]:
        """The test by repeats, and the tests for patterns."""
        return [*self.of_repeats, self.of_patterns]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The patterns that noise would seldom show."""
        return tuple(pattern.finding for pattern in self.patterns if pattern.seen)


def check(fit: "Calibration") -> ResidualChecks:
    """Test the residuals of a calibration for patterns over angle, speed and mass, and against the rows' scatter.

    Rounding errors have no patterns.

    Raises:
        TypeError: for what has no residuals, such as a posterior.
    """
    if not hasattr(fit, "residuals"):
        raise TypeError(f"Argument `fit` must be a fit of `calibrate`, but is a {type(fit).__name__}.")
    data, squares, tests = fit.data, fit.squares, [_scatter(fit)]
    if _are_noise(fit):
        weighted = data.over_errors(fit.residuals)
        tests.append(over_angle(data, weighted, conditions(data)))
        root, slopes = np.sqrt(squares.weights(weighted)), fit.solution.jacobian @ fit.identifiability.modes
        tests += [_growth(data, root * weighted, root * fit.fitted, slopes, name) for name in data.varied]
    lack = _lack_of_fit(data, fit.fitted, fit.identifiability.rank) if squares.loss == "linear" else None
    return ResidualChecks(tuple(test for test in tests if test is not None), lack, fit.title)
