"""Findings of a fit: bounds, misleading errors, undetermined parameters, and where to measure next."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from erosion.fits.conditions import describe, is_same
from erosion.fits.least_squares import LeastSquares
from erosion.fits.measurements import conditions
from erosion.fits.outliers import findings_of_outliers
from erosion.fits.residual_checks import check
from erosion.impacts import finding_of_turned
from erosion.models import BUILT_IN, SPEED_EXPONENT, SpeedExponent, model_name
from erosion.output.tables import sentences
from erosion.parameters.per_mass import far_from_tests
from erosion.parameters.quantities import InSI
from erosion.results import Finding, found

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


_ANGLES = np.deg2rad(np.arange(5.0, 90.0, 5.0))
_FACTORS = 0.5, 2.0  # of the least and the greatest speed of the data, which a laboratory may also have
_SAME_ANGLE = np.deg2rad(1.0)  # of a row that is measured already
_SEEN = 2.0  # standard deviations of a row, by which the two fits must differ there


def remedy(squares: LeastSquares, names: Sequence[str], allowed: np.ndarray, noise: float) -> Finding:
    """The remedy for undetermined parameters: fix one of them, or measure where they differ.

    Args:
        squares: the model and the data.
        names: of these parameters.
        allowed: two θ, far from each other, that fit the data as well; shape (2, names).
        noise: standard deviation of a row over the greatest erosion.
    """
    about = ", ".join(names)
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
                return Finding("fix_parameter_or_measure", about, numbers)
            numbers["condition"] = describe({"v0": speed}, squares.data.shown_in)
            return Finding("fix_parameter_or_measure_at", about, numbers)
    return Finding("fix_parameter", about, {"parameters": names})


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


def doubts(fit: "Calibration") -> tuple[Finding, ...]:
    """All that is doubtful; nothing for a good fit."""
    checks = check(fit)
    of_speed = [said for pattern in checks.patterns if pattern.over == "speed" and pattern.seen
                for said in _of_speed(fit, pattern.statistic)]  # fmt: skip
    misfit = Finding("misfit_beyond_errors", "", {"chi2": fit.chi2, "freedom": fit.degrees_of_freedom})
    open_ones = (*_undetermined(fit), *_undecided(fit), *_at_bounds(fit))
    turned = fit.problem.count_turned(fit.estimates, fit.data.conditions)
    told = filter(None, [finding_of_turned(turned, fit.data.source)])
    return (*told, *_far_from_tests(fit), *open_ones, *found((is_poor(fit), misfit)), *findings_of_outliers(fit),
            *checks.findings, *of_speed)  # fmt: skip


def _far_from_tests(fit: "Calibration") -> list[Finding]:
    """Rows of another order than all tests, where the density is known: those of a whole test often."""
    data, p, density = fit.data, fit.p, fit.problem.density
    if density is None or data.free_scale:
        return []
    mass = p.m if data.mass is None else data.mass
    speed = p.v0 if data.speed is None else data.speed
    removed = data.erosion / (density if data.needs_density else 1.0) / (1.0 if data.per_mass else mass)
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
    sums = [float(fit.curve(data.angle, InSI(v0=speed))[0].sum()) for speed in (speeds.min(), speeds.max())]
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
        said += [Finding("parameters_not_decided", ", ".join(group), {"parameters": group}), advice]
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
