"""Words on what is doubtful in a fit: parameters left open, bounds, errors that mislead, patterns."""

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from erosion.calibration.advice import advise
from erosion.calibration.conditions import conditions
from erosion.calibration.numbers import rounded
from erosion.parameters.per_mass import far_from_tests, two_digits
from erosion.parameters.units import conversion_factor

if TYPE_CHECKING:
    from erosion.calibration.result import Calibration

LEVEL = 0.95  # of the intervals that standard errors are compared with
_FACTOR = 1.5  # by which the two may differ without a warning
_OPEN = np.log(20.0)  # width of an interval in θ, from which on a parameter is not decided
_TOGETHER = 0.9  # correlation of parameters that are left open together
_TOUCH = 1e-6  # of θ, and of an interval
_ANOTHER_ORDER = 100.0  # by which rows are far from all tests: measured ones may well be outside by a few
POOR = 1e-3  # probability of a greater χ² by random errors; below it the model does not fit


def bounds_touched(fit: "Calibration", level: float) -> dict[str, tuple[str, ...]]:
    """By parameter, what lies at a bound: "estimate at lower", "interval at upper"; only those that touch one."""
    theta, problem, touched = fit.solution.theta, fit.problem, {}
    for at, name in enumerate(fit.names):
        if name in fit.undetermined:
            continue
        ends = fit.ends(level)[at]
        sides = (("lower", problem.lower[at], ends[0]), ("upper", problem.upper[at], ends[1]))
        marks = [f"estimate at {side}" for side, bound, _ in sides if abs(theta[at] - bound) < _TOUCH]
        marks += [f"interval at {side}" for side, bound, end in sides if abs(theta[at] + end - bound) < _TOUCH]
        if marks:
            touched[name] = tuple(marks)
    return touched


def undecided(fit: "Calibration") -> tuple[str, ...]:
    """The parameters whose intervals are so wide that their estimates say little."""
    touched, names = bounds_touched(fit, LEVEL), []
    for at, name in enumerate(fit.names):
        low, high = fit.ends(LEVEL)[at]
        wide = high - low > _OPEN
        if not fit.problem.forward.logarithmic[at]:
            wide = {"interval at lower", "interval at upper"} <= {*touched.get(name, ())}
        if wide and name not in fit.undetermined:
            names.append(name)
    return tuple(names)


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
    touched = bounds_touched(fit, level).get(name, ())
    distances = estimate - low, high - estimate
    alike = _is_alike(np.sqrt(fit.rise(level)) * error, distances)
    # Each end to the digits of its own distance, so that the estimate is seen to lie between them; but the distance to
    # a bound that the estimate touches is rounding.
    sizes = [high - low if alike or distance < _TOUCH * (high - low) else distance for distance in distances]
    ends = [
        ("not known" if np.isnan(end) else rounded(end, size_of_end, 2))
        + (f" ({side} bound)" if f"interval at {side}" in touched else "")
        for side, end, size_of_end in zip(("lower", "upper"), (low, high), sizes, strict=True)
    ]
    # Where the model does not fit, its errors come from uncertainties that do not explain the residuals.
    condition = ", if the model were right" if is_poor(fit) else ""
    interval = f"{level:.0%}{condition}: {' … '.join(ends)}"
    if name in fit.undecided:
        return rounded(estimate, np.inf), f"not decided by these data; {interval}"
    for side in ("lower", "upper"):
        if f"estimate at {side}" in touched:
            return rounded(estimate, np.inf), f"at its {side} bound; {interval}"
    if not alike:
        nearest = min((size_of_end for size_of_end in sizes if size_of_end > 0), default=np.inf)
        return rounded(estimate, nearest), f"{interval}; a ± of the slopes at the fit would mislead"
    return f"{rounded(estimate, error)} ± {rounded(error, error)}", interval


def _is_alike(width: float, distances: tuple[float, float]) -> bool:
    """Whether the width of the standard error says the same as the interval, on either side of the estimate."""
    return all(width <= _FACTOR * distance <= _FACTOR**2 * width for distance in distances)


def is_poor(fit: "Calibration") -> bool:
    """Whether the given uncertainties cannot explain the misfit."""
    freedom = fit.degrees_of_freedom
    return fit.data.uncertainty is not None and freedom > 0 and bool(stats.chi2.sf(fit.chi2, freedom) < POOR)


def is_beyond_scatter(fit: "Calibration") -> bool:
    """Whether the residuals are greater than the rows' scatter, where no uncertainties are given."""
    return any(pattern.over == "scatter" and pattern.seen for pattern in fit.patterns)


def sentences(fit: "Calibration") -> tuple[str, ...]:
    """All of them; none for a good fit."""
    poor = [
        f"The model does not fit within the uncertainties: χ² is {fit.chi2:.4g} for {fit.degrees_of_freedom} degrees "
        "of freedom. The errors and intervals hold only if the model were right."
    ]
    patterns = [pattern.sentence for pattern in fit.patterns if pattern.seen]
    if any(pattern.over == "speed" and pattern.seen for pattern in fit.patterns):
        patterns += _of_speed(fit)
    open_ones = (*_undetermined(fit), *_undecided(fit), *_at_bounds(fit))
    return (*_far_from_tests(fit), *open_ones, *(poor if is_poor(fit) else ()), *patterns)


def _far_from_tests(fit: "Calibration") -> list[str]:
    """A sentence on rows of another order than all tests, where the density is known: those of a whole test often."""
    data, p, density = fit.data, fit.p.to("si"), fit.problem.forward.density
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
    of_one = "" if data.per_mass else " A volume or a mass loss that is not “per mass” must be that of one impact."
    return [f"{data.source}: {two_digits(far.amount)} {far.rest.partition(';')[0].rstrip('.')}.{of_one}"]


def _of_speed(fit: "Calibration") -> list[str]:
    """The exponents of the speed in the model and in the data, with advice, where speeds alone tell rows apart."""
    data, groups = fit.data, conditions(fit.data)
    if "m" in data.conditions or len(groups) < 2:
        return []
    weight = fit.fitted / fit.problem.deviation**2
    heights = [weight[group.rows] @ data.erosion[group.rows] / (weight[group.rows] @ fit.fitted[group.rows])
               for group in groups]  # fmt: skip
    if not min(heights) > 0:
        return []
    speeds = np.array([group.values["v0"] for group in groups])
    of_data = np.polyfit(np.log(speeds), np.log(heights), 1)[0]
    sums = [float(fit.curve(data.angle, {"v0": speed})[0].sum()) for speed in (speeds.min(), speeds.max())]
    of_model = np.log(sums[1] / sums[0]) / np.log(speeds.max() / speeds.min())
    alone = min(len(group.rows) for group in groups) > len(fit.names)
    exponents = f"the model removes as v₀^{of_model:.3g}, these data as v₀^{of_model + of_data:.3g}."
    # With a threshold, which all speeds share, the erosion grows faster than as v₀².
    held = [name for name in fit.problem.forward.own_thresholds if of_data > 0 and name not in fit.names]
    ways = [f"free {', '.join(held)}"] * bool(held) + ["fit each speed alone"] * alone
    said = f"{' or '.join(ways)}: {exponents}" if ways else exponents
    return [f"{said[0].upper()}{said[1:]}"]


def _undetermined(fit: "Calibration") -> list[str]:
    """What the data does not determine at all, with advice."""
    said, problem, theta = [], fit.problem, fit.solution.theta
    for group in fit.identifiability.groups:
        step = group.direction / np.abs(group.direction).max()
        allowed = np.array([_moved(theta, sign * step, problem.lower, problem.upper) for sign in (-1.0, 1.0)])
        said.append(f"{group.statement} {advise(problem, group.names, allowed, fit.noise)}")
    return said


def _moved(theta: np.ndarray, step: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """θ after a step, or as much of the step as the bounds allow."""
    room = np.where(step > 0, upper - theta, theta - lower)[step != 0] / np.abs(step[step != 0])
    return theta + min(1.0, float(room.min())) * step


def _undecided(fit: "Calibration") -> list[str]:
    """What the data hardly determines, with advice: parameters that are left open together share a sentence."""
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
        advice = advise(fit.problem, group, fit.allowed(at), fit.noise)
        which = f"between {', '.join(group[:-1])} and {group[-1]}" if len(group) > 1 else group[0]
        said.append(f"The data do not decide {which}: {advice[0].lower()}{advice[1:]}")
    return said


def _at_bounds(fit: "Calibration") -> list[str]:
    """Bounds that are touched, and standard errors that mislead."""
    said, touched = [], bounds_touched(fit, LEVEL)
    for at, name in enumerate(fit.names):
        if name in fit.undetermined:
            continue
        marks = touched.get(name, ())
        bound = {side: fit.in_words(name, fit.bounds[name][i], 6) for i, side in enumerate(("lower", "upper"))}
        estimate = next((side for side in bound if f"estimate at {side}" in marks), None)
        ends = [side for side in bound if f"interval at {side}" in marks]
        if estimate is not None:
            said.append(f"{name} is at its {estimate} bound, {bound[estimate]}: its error means nothing.")
        elif ends:
            places = " and ".join(f"its {side} bound, {bound[side]}" for side in ends)
            said.append(f"The interval of {name} ends at {places}: the data do not end it there.")
        elif name not in fit.undecided:
            said += _misshapen(fit, at)
    return said


def _misshapen(fit: "Calibration", at: int) -> list[str]:
    """A sentence where the standard error differs from the interval."""
    name, (low, high) = fit.names[at], fit.ends(LEVEL)[at]
    if np.isnan(high - low):
        return [f"The interval of {name} has an end that is not known: the model fails on the way to it."]
    width = 2 * np.sqrt(fit.rise(LEVEL) * fit.covariance_of_theta[at, at])
    if _FACTOR * (high - low) < width:
        return [f"{name} is known better than its standard error says (V(α) jumps, or a bound): see its interval."]
    if high - low > _FACTOR * width:
        return [f"{name} is known less well than its standard error says: see its interval."]
    return []
