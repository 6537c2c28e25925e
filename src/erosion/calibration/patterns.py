"""Patterns in residuals: what is left of data by a model of the right shape is noise.

Over the angle, noise changes its sign about every second row; fewer runs of one sign are a pattern
(Wald and Wolfowitz). Over speed and mass, the ranks of noise have no correlation with theirs (Spearman).
Without uncertainties the rows' own scatter about a smooth curve says how large noise is: residuals of a greater
variance are a pattern too (Fisher), which few rows show where their signs say nothing.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats

from erosion.calibration.conditions import Condition
from erosion.calibration.measurements import Measurements
from erosion.parameters.scales import table_scale
from erosion.tables import format_number

RARE = 0.01  # probability of such a pattern in noise; below it the pattern is said
_FEWEST = 10  # rows for which the probability of a correlation of ranks is known well enough
_EXACT = 1e-6  # residuals over the erosion that are rounding errors of fits, not noise
_WORDS = {"v0": "speed", "m": "mass"}
_SMOOTH = 3  # degree of the polynomial in the angle that a curve of erosion with one maximum is near to


@dataclasses.dataclass(frozen=True)
class Pattern:
    """How one test of the residuals came out.

    Args:
        over: "angle", "speed" or "mass"; "scatter" for the size of the residuals.
        statistic: runs of one sign less those expected of noise, over their standard deviation;
            over speed and mass the correlation of ranks; of the size the ratio of the variances.
        probability: that noise has such a pattern or a clearer one.
        sentence: on what is seen.
    """

    over: str
    statistic: float
    probability: float
    sentence: str

    @property
    def seen(self) -> bool:
        """Whether noise alone would seldom look so."""
        return self.probability < RARE


def find_patterns(data: Measurements, residuals: np.ndarray, groups: Sequence[Condition]) -> tuple[Pattern, ...]:
    """The tests that can be made.

    Args:
        data: the measurements.
        residuals: measured less fitted, over their standard deviations, shape (rows,).
        groups: rows of one speed and mass.
    """
    tests = [_over_angle(data, residuals, groups)]
    tests += [_over(name, values, residuals) for name, values in data.conditions.items() if name != "alpha"]
    return tuple(test for test in tests if test is not None)


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
    residuals = data.erosion - fitted
    variance, of_scatter = float(np.sum(residuals**2)) / freedom, squares / scatter_freedom
    ratio, probability = variances_differ((variance, freedom), (of_scatter, scatter_freedom), data.erosion)
    scale = table_scale(data.dimension, data.units, float(np.sqrt(variance)))
    sizes = [format_number(np.sqrt(square), 3, scale.size) for square in (variance, of_scatter)]
    return Pattern("scatter", ratio, probability, (
        f"The residuals are {scale.beside(sizes[0])}, the rows scatter about a smooth curve by "
        f"{scale.beside(sizes[1])} (probability {probability:.1g}): {worst_row(data, fitted, groups)}."
    ))  # fmt: skip


def variances_differ(first: tuple[float, int], second: tuple[float, int], erosion: np.ndarray) -> tuple[float, float]:
    """The ratio of two variances, each with its degrees of freedom, and the probability that noise makes it as great.

    Variances that are rounding errors of the `erosion` are alike.
    """
    least = float(np.mean((_EXACT * erosion) ** 2))
    ratio = max(first[0], least) / max(second[0], least)
    return ratio, float(stats.f.sf(ratio, first[1], second[1]))


def worst_row(data: Measurements, fitted: np.ndarray, groups: Sequence[Condition]) -> str:
    """The row that is furthest from the fit: "at 90° the fit has 0 mg/kg, the data have 95 mg/kg"."""
    deviation = 1.0 if data.uncertainty is None else data.uncertainty
    row = int(np.argmax(np.abs((data.erosion - fitted) / deviation)))
    scale = table_scale(data.dimension, data.units, float(np.abs(data.erosion).max()))
    of_fit, of_data = (scale.beside(format_number(value, 3, scale.size)) for value in (fitted[row], data.erosion[row]))
    label = next((group.label for group in groups if row in group.rows), "")
    where = f"{np.rad2deg(data.angle[row]):.3g}°{f' and {label}' if label else ''}"
    return f"at {where} the fit has {of_fit}, the data have {of_data}"


def are_noise(residuals: np.ndarray, erosion: np.ndarray) -> bool:
    """Whether residuals are more than rounding errors."""
    return float(np.linalg.norm(residuals)) > _EXACT * float(np.linalg.norm(erosion))


def _over_angle(data: Measurements, residuals: np.ndarray, groups: Sequence[Condition]) -> Pattern | None:
    """The runs test, within each group."""
    runs, expected, variance = 0, 0.0, 0.0
    longest: tuple[int, np.ndarray, str] = (0, np.empty(0, int), "")
    for group in groups:
        rows = group.rows[np.argsort(data.angle[group.rows], kind="stable")]
        rows = rows[residuals[rows] != 0]
        if len(rows) < 2:
            continue
        above = residuals[rows] > 0
        parts = np.split(rows, np.flatnonzero(above[1:] != above[:-1]) + 1)
        n, product = len(rows), 2.0 * above.sum() * (~above).sum()
        runs += len(parts)
        expected += 1 + product / n
        variance += product * (product - n) / (n**2 * (n - 1))
        part = max(parts, key=len)
        longest = max(longest, (len(part), part, group.label), key=lambda run: run[0])
    if longest[0] == 0:
        return None
    if variance == 0:  # one sign in each group: noise has either sign at even odds
        steps = sum(len(group.rows) - 1 for group in groups)
        expected, variance = len(groups) + steps / 2, steps / 4
    statistic = (runs - expected) / np.sqrt(variance)
    probability = float(stats.norm.cdf(statistic + 0.5 / np.sqrt(variance)))  # a count is half a step wide
    first, last = np.rad2deg(data.angle[longest[1][[0, -1]]])
    side = "above" if residuals[longest[1][0]] > 0 else "below"
    where = f" at {longest[2]}" if longest[2] else ""
    return Pattern("angle", float(statistic), probability, (
        f"The residuals show a pattern over the angle: {_counted(runs)} of one sign, where noise makes "
        f"{expected:.0f} ± {np.sqrt(variance):.0f} (probability {probability:.1g}). From {first:.3g}° to {last:.3g}°"
        f"{where} the data lie {side} the fit."
    ))  # fmt: skip


def _counted(runs: int) -> str:
    return "1 run" if runs == 1 else f"{runs} runs"


def _over(name: str, values: np.ndarray, residuals: np.ndarray) -> Pattern | None:
    """The correlation of ranks with speed or mass."""
    if len(values) < _FEWEST or np.ptp(values) == 0 or np.ptp(residuals) == 0:
        return None
    correlation, probability = np.asarray(stats.spearmanr(values, residuals)).tolist()
    word = _WORDS[name]
    moves, compares = ("rise", "more") if correlation > 0 else ("fall", "less")
    return Pattern(word, correlation, probability, (
        f"The residuals {moves} with the {word} (correlation of ranks {correlation:.2f}, probability "
        f"{probability:.1g}): the data grow {compares} with the {word} than the fit."
    ))  # fmt: skip
