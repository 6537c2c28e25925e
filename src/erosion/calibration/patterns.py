"""Patterns in residuals: what is left of data by a model of the right shape is noise.

Over the angle, noise changes its sign about every second row; fewer runs of one sign are a pattern
(Wald and Wolfowitz). Over speed and mass, the ranks of noise have no correlation with theirs (Spearman).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats

from erosion.calibration.conditions import Condition
from erosion.calibration.measurements import Measurements

_RARE = 0.01  # probability of such a pattern in noise; below it the pattern is said
_FEWEST = 10  # rows for which the probability of a correlation of ranks is known well enough
_EXACT = 1e-6  # residuals over the erosion that are rounding errors of fits, not noise
_WORDS = {"v0": "speed", "m": "mass"}


@dataclasses.dataclass(frozen=True)
class Pattern:
    """How one test of the residuals came out.

    Args:
        over: "angle", "speed" or "mass".
        statistic: runs of one sign less those expected of noise, over their standard deviation;
            over speed and mass the correlation of ranks.
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
        return self.probability < _RARE


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
