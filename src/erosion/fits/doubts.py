"""What is doubtful in a fit: profiles, bounds, patterns in the residuals, and where to measure next.

A profile's interval reaches from the estimate to where the profile has risen by the quantile of its
level. Where residuals are linear in θ the profile is a parabola, and the interval is the usual
interval from standard errors. Where V(α) jumps between two rows the profile has steps, which the
slopes at the estimate do not show.

Over the angle, noise changes its sign about every second row; fewer runs of one sign are a pattern
(Wald and Wolfowitz). Over speed and mass, the fit is tested for one more exponent (Student).
Without uncertainties the rows' own scatter about a smooth curve says how large noise is: residuals of a greater
variance are a pattern too (Fisher), which few rows show where their signs say nothing.
"""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import special, stats

from erosion.fits.conditions import Condition, describe, group_numbers, is_same
from erosion.fits.least_squares import FitSolution, LeastSquares, settle
from erosion.fits.measurements import Measurements, conditions
from erosion.fits.outliers import error_sizes, far_rows
from erosion.models import BUILT_IN, SPEED_EXPONENT, SpeedExponent, model_name
from erosion.output.tables import format_number, sentences
from erosion.parameters.per_mass import far_from_tests
from erosion.parameters.quantities import ascii_unit, conversion_factor, table_scale
from erosion.results import Columns, Declared, Finding, Result, Scale, Value, found

if TYPE_CHECKING:
    from erosion.fits.calibration import Calibration


_PLAIN = 1e-4, 1e6  # sizes that are written without a power of ten


def rounded(value: float, size: float, least: int = 1) -> str:
    """A value whose last digit is the second one of its error; of four digits where that is not known.

    Args:
        value: the number.
        size: its error.
        least: digits of the value, however great its error is.
    """
    if not np.isfinite(value) or value == 0 or not (np.isfinite(size) and size > 0):
        return f"{value:.4g}"
    place = int(np.floor(np.log10(abs(value))))
    digits = max(2 - int(np.floor(np.log10(size))) + place, least)
    text = f"{value:.{digits - 1}e}"
    return f"{float(text):.{max(digits - 1 - place, 0)}f}" if _PLAIN[0] <= abs(value) < _PLAIN[1] else text


_TRIALS = 24  # a step of the profile takes 8 of them, by halving
_WIDER = 2.0  # factor per trial at most, while the end is not passed
_CLOSE = 0.02  # of an interval's half width, and of the rise that is looked for


@dataclasses.dataclass(frozen=True, repr=False)
class Profile(Result):
    """The misfit over one parameter, with all others fitted again.

    Args:
        name: of the parameter.
        values: ascending, shape (points,).
        rise: Δχ² above the best fit, shape (points,); a quadratic where the fit is linear.
        unit: of the values, empty for pure numbers.
    """

    name: str
    values: np.ndarray
    rise: np.ndarray
    unit: str = ""

    @property
    def title(self) -> str:
        """The parameter."""
        return f"profile of {self.name}"

    def declare(self) -> list[Declared]:
        """The parameter, with value and rise at each point."""
        values = Value("value", self.values, self.name, unit=ascii_unit(self.unit) or "1", scale=Scale(1.0, self.unit))
        rises = Value("rise", self.rise, "Δχ²", digits=4)
        return [Value("parameter", self.name, only="data"), Columns("points", self.title, [values, rises])]


@dataclasses.dataclass(frozen=True)
class Ridge:
    """The best fits along one parameter, whose θ is held at offsets from the estimate.

    Args:
        squares, solution: the fit.
        at: index of the parameter.
        path: change of θ per unit of offset where residuals are linear, shape (names,).
    """

    squares: LeastSquares
    solution: FitSolution
    at: int
    path: np.ndarray

    def rises(self, offsets: np.ndarray, unit: float) -> np.ndarray:
        """The cost above the minimum at each offset.

        Args:
            offsets: ascending, shape (points,).
            unit: a typical rise of the cost; rises are computed to some percents of it.

        Returns:
            Shape (points,); NaN where the model fails.
        """
        rises = np.zeros(len(offsets))
        for side in (np.flatnonzero(offsets > 0), np.flatnonzero(offsets < 0)[::-1]):
            near = self.solution.theta
            for i in side:
                refit = self.refit(offsets[i], near, unit)
                near = near if refit is None else refit.theta
                rises[i] = np.nan if refit is None else refit.cost - self.solution.cost
        return rises

    def crossing(self, first: float, height: float) -> float:
        """The offset at which the cost has risen by `height`, to 2 %.

        At a step it is the far side of the step. Where the cost does not rise so far within the
        bounds, it is the bound; NaN where the model fails on the way.

        Args:
            first: the offset at which a parabola has risen by `height`; its sign gives the side.
            height: positive.
        """
        sign = np.sign(first)
        bound = self.squares.upper[self.at] if sign > 0 else self.squares.lower[self.at]
        limit = abs(bound - self.solution.theta[self.at])
        inside, outside, near = 0.0, np.inf, self.solution.theta
        trial = min(abs(first), limit)
        for _ in range(_TRIALS):
            refit = self.refit(sign * trial, near, height)
            if refit is None:
                return np.nan
            ratio = np.sqrt(max(refit.cost - self.solution.cost, 0.0) / height)  # linear where the rise is a parabola
            if abs(ratio - 1) < _CLOSE or (ratio < 1 and trial == limit):
                return sign * trial
            if ratio < 1:
                inside, near = trial, refit.theta
            else:
                outside = trial
            if outside - inside < _CLOSE * outside:
                break
            linear = trial / ratio if ratio > 0 else np.inf
            margin = 0.1 * (outside - inside)
            if outside == np.inf:
                trial = min(linear, _WIDER * trial, limit)
            elif inside + margin < linear < outside - margin:
                trial = linear
            else:
                trial = (inside + outside) / 2
        return sign * (outside if outside < np.inf else trial)

    def refit(self, offset: float, near: np.ndarray, height: float) -> FitSolution | None:
        """The best fit at an offset, from the better of two points: on the straight path, or near the last fit."""
        squares, at = self.squares, self.at
        place = self.solution.theta[at] + offset
        begins = np.array([self.solution.theta + offset * self.path, near + (place - near[at]) * self.path])
        begins = np.clip(begins, squares.lower, squares.upper)
        begin = begins[int(np.argmin(squares.thinned().costs(begins)))]
        return settle(squares, begin, at, _CLOSE * min(1.0, height / max(self.solution.cost, height)))


_ANGLES = np.deg2rad(np.arange(5.0, 90.0, 5.0))
_FACTORS = 0.5, 2.0  # of the least and the greatest speed of the data, which a laboratory may also have
_SAME_ANGLE = np.deg2rad(1.0)  # of a row that is measured already
_SEEN = 2.0  # standard deviations of a row, by which the two fits must differ there


def remedy(squares: LeastSquares, names: Sequence[str], allowed: np.ndarray, noise: float) -> Finding:
    """What to do about parameters that are left open: fix one of them, or measure where they differ.

    Args:
        squares: the model and the data.
        names: of these parameters.
        allowed: two θ, far from each other, that fit the data as well; shape (2, names).
        noise: standard deviation of a row over the greatest erosion.
    """
    for speed in _speeds(squares):
        at = {"alpha": _ANGLES} if speed is None else {"alpha": _ANGLES, "v0": np.full(_ANGLES.shape, speed)}
        first, second = squares.problem.predict_many(allowed, at)
        greatest = max(np.abs(first).max(), np.abs(second).max())
        if not greatest > 0:  # impacts failed, or there is no erosion
            continue
        differs = np.where(_measured(squares, speed), 0.0, np.abs(first - second) / (noise * greatest))
        if differs.max() >= _SEEN:
            numbers = {"parameters": names, "alpha": _ANGLES[np.argmax(differs)]}
            if speed is None:
                return Finding("fix_parameter_or_measure", "", numbers)
            numbers["condition"] = describe({"v0": speed}, squares.data.units)
            return Finding("fix_parameter_or_measure_at", "", numbers)
    return Finding("fix_parameter", "", {"parameters": names})


def _measured(squares: LeastSquares, speed: float | None) -> np.ndarray:
    """Whether the data has a row at each of `_ANGLES` and this speed, of the shape of `_ANGLES`."""
    rows = squares.data.conditions
    near = np.abs(_ANGLES[:, None] - rows["alpha"]) < _SAME_ANGLE
    if speed is not None and "v0" in rows:
        near &= is_same(rows["v0"], speed)
    return near.any(axis=1)


def _speeds(squares: LeastSquares) -> list[float | None]:
    """The speeds to think of: first those of the data, or of the case (None); then a lower and a greater one."""
    if "v0" in squares.problem.free:
        return [None]
    measured = [group.values["v0"] for group in conditions(squares.data, most=3) if "v0" in group.values]
    known = measured or [float(squares.problem.p.v0)]
    return [*(measured or [None]), _FACTORS[0] * min(known), _FACTORS[1] * max(known)]


RARE = 0.01  # probability of such a pattern in noise; below it the pattern is said
_REFITS = 5  # of a fit with one more exponent, from the fit without it
_UNUSUAL = 0.03  # the same of an exponent: six speeds with a scatter of 10 % would seldom show one otherwise
_EXACT = 1e-6  # residuals over the erosion that are rounding errors of fits, not noise
_WORDS = {"v0": "speed", "m": "mass"}
_SMOOTH = 3  # degree of the polynomial in the angle that a curve of erosion with one maximum is near to


@dataclasses.dataclass(frozen=True)
class Pattern:
    """How one test of the residuals came out.

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


def find_patterns(data: Measurements, residuals: np.ndarray, groups: Sequence[Condition]) -> tuple[Pattern, ...]:
    """The tests that can be made.

    Args:
        data: the measurements.
        residuals: measured less fitted, over their standard deviations, shape (rows,).
        groups: rows of one speed and mass.
    """
    over_angle = _over_angle(data, residuals, groups)
    return () if over_angle is None else (over_angle,)


def beyond_scatter(data: Measurements, fitted: np.ndarray, freedom: int, groups: Sequence[Condition]) -> Pattern | None:
    """Fisher's test of the residuals' variance against that of the rows about smooth curves; None for too few rows.

    Args:
        data: the measurements.
        fitted: the erosion of the fit, shape (rows,).
        freedom: rows less the determined combinations of parameters.
        groups: rows of one speed and mass.
    """
    squares, scatter_freedom = 0.0, 0
    for group in groups:
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
    scale = table_scale(data.dimension, data.units, float(np.sqrt(variance)))
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
        freedom: of the scatter.
    """

    ratio: float
    probability: float
    scatter: float
    freedom: int


def lack_of_fit(data: Measurements, fitted: np.ndarray, rank: int) -> LackOfFit | None:
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
    unit = 1.0 if data.uncertainty is not None else float(data.deviation[0])
    size = unit * float(np.sqrt(scatter / freedom))
    return LackOfFit(ratio, float(stats.f.sf(ratio, of_means, freedom)), size, freedom)


def are_noise(residuals: np.ndarray, erosion: np.ndarray) -> bool:
    """Whether residuals are more than rounding errors."""
    return float(np.linalg.norm(residuals)) > _EXACT * float(np.linalg.norm(erosion))


def _over_angle(data: Measurements, residuals: np.ndarray, groups: Sequence[Condition]) -> Pattern | None:
    """The runs test, within each group."""
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


def growth(
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


LEVEL = 0.95  # of the intervals that standard errors are compared with
_FACTOR = 1.5  # by which the two may differ without a warning
OPEN = np.log(20.0)  # width of an interval in θ, from which on a parameter is not decided
_TOGETHER = 0.9  # correlation of parameters that are left open together
TOUCH = 1e-6  # of θ, and of an interval
_ANOTHER_ORDER = 100.0  # by which rows are far from all tests: measured ones may well be outside by a few
POOR = 1e-3  # probability of a greater χ² by random errors; below it the model does not fit


def in_words(fit: "Calibration", name: str, level: float, size: float) -> tuple[str, str]:
    """The estimate with its error where that means something, and its interval with the bounds that it touches.

    Args:
        fit: the fit.
        name: of the parameter.
        level: of the interval.
        size: of the unit in which numbers are shown.
    """
    estimate, error = fit.estimates[name] / size, fit.standard_errors[name] / size
    if name in fit.undetermined:
        return rounded(estimate, np.inf), "not determined by these data"
    low, high = (end / size for end in fit.intervals(level)[name])
    touched = fit.bounds_touched(level).get(name, ())
    distances, width = (estimate - low, high - estimate), np.sqrt(fit.rise(level)) * error
    alike = all(width <= _FACTOR * distance <= _FACTOR**2 * width for distance in distances)
    # Each end to the digits of its own distance, so that the estimate is seen to lie between them; but the distance to
    # a bound that the estimate touches is rounding.
    sizes = [high - low if alike or distance < TOUCH * (high - low) else distance for distance in distances]
    ends = [
        ("not known" if np.isnan(end) else rounded(end, size_of_end, 2))
        + (f" ({side} bound)" if f"interval at {side}" in touched else "")
        for side, end, size_of_end in zip(("lower", "upper"), (low, high), sizes, strict=True)
    ]
    # Where the model does not fit, its errors come from uncertainties that do not explain the residuals.
    interval = f"{level:.0%}{', if the model were right' if is_poor(fit) else ''}: {' … '.join(ends)}"
    open_words = sentences(
        (name in fit.undecided, "not decided by these data"),
        *((f"estimate at {side}" in touched, f"at its {side} bound") for side in ("lower", "upper")),
    )
    if open_words:
        return rounded(estimate, np.inf), f"{open_words[0]}; {interval}"
    if alike:
        return f"{rounded(estimate, error)} ± {rounded(error, error)}", interval
    nearest = min((size_of_end for size_of_end in sizes if size_of_end > 0), default=np.inf)
    return rounded(estimate, nearest), f"{interval}; a ± of the slopes at the fit would mislead"


def is_poor(fit: "Calibration") -> bool:
    """Whether the given uncertainties cannot explain the misfit."""
    freedom = fit.degrees_of_freedom
    return fit.data.uncertainty is not None and freedom > 0 and bool(stats.chi2.sf(fit.chi2, freedom) < POOR)


def is_beyond_scatter(fit: "Calibration") -> bool:
    """Whether the residuals are greater than the rows' scatter, where no uncertainties are given."""
    return any(pattern.over == "scatter" and pattern.seen for pattern in fit.patterns)


def doubts(fit: "Calibration") -> tuple[Finding, ...]:
    """All that is doubtful; nothing for a good fit."""
    patterns = [pattern for pattern in fit.patterns if pattern.seen]
    of_speed = [said for pattern in patterns if pattern.over == "speed" for said in _of_speed(fit, pattern.statistic)]
    misfit = Finding("misfit_beyond_errors", "", {"chi2": fit.chi2, "freedom": fit.degrees_of_freedom})
    open_ones = (*_undetermined(fit), *_undecided(fit), *_at_bounds(fit))
    return (*_far_from_tests(fit), *open_ones, *found((is_poor(fit), misfit)), *far_rows(fit),
            *(pattern.finding for pattern in patterns), *of_speed)  # fmt: skip


def _far_from_tests(fit: "Calibration") -> list[Finding]:
    """Rows of another order than all tests, where the density is known: those of a whole test often."""
    data, p, density = fit.data, fit.p.to("si"), fit.problem.density
    if density is None or data.free_scale:
        return []
    density *= conversion_factor("density", data.units, "si")
    mass = p.m if data.mass is None else data.mass * conversion_factor("mass", data.units, "si")
    speed = p.v0 if data.speed is None else data.speed * conversion_factor("speed", data.units, "si")
    removed = data.erosion * conversion_factor(data.dimension, data.units, "si")
    removed = removed / (density if data.needs_density else 1.0) / (1.0 if data.per_mass else mass)
    far = far_from_tests(removed, speed, density, _ANOTHER_ORDER)
    if far is None:
        return []
    code = "other_order" if data.per_mass else "other_order_of_one"
    return [Finding(code, data.source, dataclasses.asdict(far))]


def _of_speed(fit: "Calibration", lacking: float) -> tuple[Finding, ...]:
    """The exponents of the speed in the model and in the data, with advice.

    Args:
        fit: the fit.
        lacking: the exponent that the fit lacks.
    """
    data, problem, groups = fit.data, fit.problem, conditions(fit.data)
    speeds = data.varied["v0"]
    sums = [float(fit.curve(data.angle, {"v0": speed})[0].sum()) for speed in (speeds.min(), speeds.max())]
    of_model = np.log(sums[1] / sums[0]) / np.log(speeds.max() / speeds.min())
    # With a threshold, which all speeds share, the erosion grows faster than as v₀².
    held = [name for name in problem.own_thresholds if lacking > 0 and name not in fit.names]
    held += [SPEED_EXPONENT] * (isinstance(problem.model, SpeedExponent) and SPEED_EXPONENT not in fit.names)
    name, is_alone = model_name(problem.model), min(len(group.rows) for group in groups) > len(fit.names)
    return found(
        (True, Finding("power_of_speed", name, {"of_model": of_model, "of_data": of_model + lacking})),
        (held, Finding("free_for_speed", name, {"parameters": held})),
        (is_alone, Finding("fit_each_speed")),
        (name in BUILT_IN, Finding("model_with_exponent", name)),
    )


def _undetermined(fit: "Calibration") -> list[Finding]:
    """What the data does not determine at all, with advice."""
    said, squares, theta = [], fit.squares, fit.solution.theta
    for group in fit.identifiability.groups:
        step = group.direction / np.abs(group.direction).max()
        allowed = np.array([_moved(theta, sign * step, squares.lower, squares.upper) for sign in (-1.0, 1.0)])
        said += [group.finding, remedy(squares, group.names, allowed, fit.noise)]
    return said


def _moved(theta: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """θ after a step, or as much of the step as the bounds allow."""
    room = np.where(step > 0, upper - theta, theta - lower)[step != 0] / np.abs(step[step != 0])
    return theta + min(1.0, float(room.min())) * step


def _undecided(fit: "Calibration") -> list[Finding]:
    """What the data hardly determines, with advice: parameters that are left open together share a finding."""
    open_names = list(fit.undecided)
    said = []
    while open_names:
        at = fit.names.index(open_names[0])
        covariance = fit.covariance_of_theta
        with np.errstate(invalid="ignore", divide="ignore"):
            correlation = covariance[at] / np.sqrt(covariance[at, at] * np.diag(covariance))
        together = [name for name in open_names if abs(correlation[fit.names.index(name)]) > _TOGETHER]
        group = [open_names[0], *(name for name in together if name != open_names[0])]
        open_names = [name for name in open_names if name not in group]
        advice = remedy(fit.squares, group, fit.allowed(at), fit.noise)
        said += [Finding("parameters_not_decided", "", {"parameters": group}), advice]
    return said


def _at_bounds(fit: "Calibration") -> list[Finding]:
    """Bounds that are touched, and standard errors that mislead: the first of these of each parameter."""
    said, touched = list[Finding](), fit.bounds_touched()
    for at, name in enumerate(fit.names):
        if name in fit.undetermined:
            continue
        low, high = fit.ends(LEVEL)[at]
        width, marks = 2 * np.sqrt(fit.rise(LEVEL) * fit.covariance_of_theta[at, at]), touched.get(name, ())
        sides = dict(zip(("lower", "upper"), fit.bounds[name], strict=True))
        at_bounds = {of: [{"side": side, "bound": fit.in_words(name, bound, 6)}
                          for side, bound in sides.items() if f"{of} at {side}" in marks]
                     for of in ("estimate", "interval")}  # fmt: skip
        if at_bounds["estimate"]:
            said += [Finding("estimate_at_bound", name, numbers) for numbers in at_bounds["estimate"]]
        elif at_bounds["interval"]:
            said += [Finding("interval_at_bound", name, numbers) for numbers in at_bounds["interval"]]
        elif name not in fit.undecided:  # of which more is said
            said += found(
                (np.isnan(high - low), Finding("interval_without_end", name)),
                (_FACTOR * (high - low) < width, Finding("error_too_great", name)),
                (high - low > _FACTOR * width, Finding("error_too_small", name)),
            )[:1]
    return said
