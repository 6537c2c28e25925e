"""Arguments that many verbs take: tolerances, whole numbers, paths, single numbers, progress."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

Progress = Callable[[str, int, int], object]
"""A function that is called with the name of the work, how much of it is done, and how much there is."""

_NUMBERS = (int, float, np.integer, np.floating)


def check_tolerance(rtol: Any) -> float:
    """`rtol` as a float; a `ValueError` where it is not in (0, 1)."""
    if not isinstance(rtol, _NUMBERS) or not 0 < rtol < 1:
        raise ValueError(f"Argument `rtol` must be in (0, 1), but is {rtol!r}.")
    return float(rtol)


def check_whole(name: str, value: Any, least: int) -> int:
    """The argument as an int; a `ValueError` where it is no whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"Argument `{name}` must be a whole number of at least {least}, but is {value!r}.")
    return int(value)


def check_level(level: float) -> float:
    """The level of an interval; a `ValueError` where it is no probability in (0, 1)."""
    if not 0 < level < 1:
        raise ValueError(f"Argument `level` must be in (0, 1), but is {level:g}.")
    return level


def check_scalars(values: Mapping[str, Any], instead: str = "") -> None:
    """A `ValueError` that names the first argument that is an array; `instead` ends it: what takes arrays."""
    for name, value in values.items():
        if shape := np.shape(value):
            raise ValueError(f"Argument `{name}` must be a scalar here, but has shape {shape}{instead}.")


def check_unmasked(name: str, value: Any) -> None:
    """A `ValueError` where values are masked: all that computes with arrays ignores the mask."""
    if np.ma.is_masked(value):
        raise ValueError(f"Argument `{name}` must have no masked values; leave them out, or fill them with NaN.")


def check_path(name: str, value: Any) -> Path:
    """The argument as a path; a `TypeError` or `ValueError` where it cannot be one."""
    if not isinstance(value, (str, Path)):
        raise TypeError(f"Argument `{name}` must be a path, but is {value!r}.")
    if "\0" in str(value):
        raise ValueError(f"Argument `{name}` must be a path, but {str(value)!r} holds a zero byte.")
    return Path(value)


def no_progress(work: str, done: int, total: int) -> None:
    """Ignore the progress: the default of `progress`."""
