"""Conditions of tests: speeds and masses that differ by the scatter of a rig are the same."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from erosion.parameters import QUANTITIES, InSI, System

MOST = 12  # groups that a figure can tell apart


@dataclasses.dataclass(frozen=True)
class _Scatter:
    """How far apart the values of one group lie, as differences of logarithms."""

    gap: float = 0.02  # rigs repeat a speed to 1 or 2 %
    width: float = 0.1  # of a group: speeds without gaps are a continuum, which is cut into parts


SCATTER = _Scatter()


@dataclasses.dataclass(frozen=True)
class Condition:
    """Rows of one speed and mass.

    Args:
        rows: their indexes, shape (n,).
        values: "v0" and "m", the medians of the rows [SI], where the data have them.
        label: "v₀ = 30 m/s"; empty where the data have neither.
    """

    rows: np.ndarray
    values: InSI
    label: str


def group_numbers(values: np.ndarray) -> np.ndarray:
    """The group of each value, numbered by ascending values: a gap of more than 2 % begins another group.

    A group that spans more than 10 % is cut into parts of one width.

    Args:
        values: positive, shape (n,).
    """
    order = np.argsort(values, kind="stable")
    logs = np.log(values[order])
    begins = np.append(True, np.diff(logs) > SCATTER.gap)
    part = np.cumsum(begins) - 1
    first, last = logs[begins], logs[np.append(begins[1:], True)]
    parts = np.ceil((last - first) / SCATTER.width)[part]
    inside = np.floor(parts * (logs - first[part]) / np.maximum((last - first)[part], np.finfo(float).tiny))
    _, numbers = np.unique(np.stack([part, np.minimum(inside, np.maximum(parts - 1, 0))]), axis=1, return_inverse=True)
    groups = np.empty(len(values), int)
    groups[order] = numbers.ravel()
    return groups


def are_apart(values: np.ndarray, groups: np.ndarray) -> bool:
    """Whether a gap lies between any two groups, so that none is a part of a continuum."""
    order = np.argsort(values, kind="stable")
    steps = np.diff(np.log(values[order]))
    return bool((steps[np.diff(groups[order]) > 0] > SCATTER.gap).all())


def is_same(first: np.ndarray | float, second: np.ndarray | float) -> np.ndarray:
    """Whether speeds or masses are the same but for the scatter of a rig."""
    return np.abs(np.log(first) - np.log(second)) <= SCATTER.gap


def describe(values: Mapping[str, float], system: System, sign: str = "=") -> str:
    """Parameters in words: "v₀ = 30 m/s, m = 37 µg"."""
    return ", ".join(
        f"{QUANTITIES[name].symbol} {sign} {QUANTITIES[name].in_words(value, system)}" for name, value in values.items()
    )
