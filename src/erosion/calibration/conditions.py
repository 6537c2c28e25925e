"""Groups of rows that were measured at one speed and mass: a curve each, and the speeds that exports may have."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from erosion.calibration.measurements import Measurements
from erosion.parameters.quantities import QUANTITIES
from erosion.parameters.units import System

MOST = 12  # groups that a figure can tell apart
_DIGITS = 3  # speeds and masses that agree to so many are the same


class Condition(NamedTuple):
    """Rows of one speed and mass.

    Args:
        rows: their indexes, shape (n,).
        values: "v0" and "m", where the data has them.
        label: "v₀ = 30 m/s"; empty where the data has neither.
    """

    rows: np.ndarray
    values: Mapping[str, float]
    label: str


def conditions(data: Measurements, most: int | None = None) -> list[Condition]:
    """The groups, by ascending speed and mass.

    Args:
        data: the measurements.
        most: where there are more groups, rows of similar energy m v₀² are put together.
    """
    given = {name: values for name, values in data.conditions.items() if name != "alpha"}
    if not given:
        return [Condition(np.arange(len(data)), {}, "")]
    columns = np.stack(list(given.values()), axis=1)
    size = 10.0 ** (np.floor(np.log10(columns)) + 1 - _DIGITS)
    levels, group = np.unique(np.round(columns / size) * size, axis=0, return_inverse=True)
    count = len(levels)
    if most is None or count <= most:
        together, sign = [[i] for i in range(count)], "="
    else:
        powers = [2 if name == "v0" else 1 for name in given]
        together, sign = np.array_split(np.argsort(np.prod(levels**powers, axis=1), kind="stable"), most), "≈"
    parts = [np.flatnonzero(np.isin(group.ravel(), [*part])) for part in together]
    # The value itself where all rows have it: a mean would round.
    middles = [{name: float(np.sort(values[rows])[len(rows) // 2]) for name, values in given.items()} for rows in parts]
    varying = [name for name in given if len({middle[name] for middle in middles}) > 1] or list(given)
    return [
        Condition(rows, middle, describe({name: middle[name] for name in varying}, data.units, sign))
        for rows, middle in zip(parts, middles, strict=True)
    ]


def describe(values: Mapping[str, float], units: System, sign: str = "=") -> str:
    """Parameters in words: "v₀ = 30 m/s, m = 37 µg"."""
    return ", ".join(
        f"{QUANTITIES[name].symbol} {sign} {QUANTITIES[name].in_words(value, units)}" for name, value in values.items()
    )
