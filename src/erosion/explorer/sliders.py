"""How far each parameter's slider reaches, and what its positions mean."""

import re
from typing import NamedTuple

import numpy as np

from erosion.explorer.state import Case
from erosion.parameters import QUANTITIES
from erosion.units import unit_name

_FACTOR = 20.0  # either way of the case's value
_DIGITS = 4  # of what a slider sets


class Range(NamedTuple):
    """A slider's ends and steps in its own positions."""

    low: float
    high: float
    step: float


ANGLES = Range(0.25, 90.0, 0.25)  # degrees
SPINS = Range(-1.0, 1.0, 0.01)  # s = r φ̇₀/v₀
FACTORS = Range(-1.0, 1.0, 0.005)  # powers of `_FACTOR` times the first value
SPIN_PRESETS = (-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5)


def range_of(name: str) -> Range:
    """The positions of a parameter's slider."""
    return {"alpha": ANGLES, "phidot0": SPINS}.get(name, FACTORS)


def position(name: str, case: Case, first: Case) -> float:
    """Where a parameter's slider stands; beyond an end it stands at the end.

    Args:
        name: the parameter.
        case: what is shown.
        first: the case about which the sliders reach, in the same units.
    """
    numbers = case.numbers()
    if name == "alpha":
        at = np.rad2deg(numbers["alpha"])
    elif name == "phidot0":
        at = numbers["phidot0"] * numbers["r"] / numbers["v0"]
    else:
        at = np.log(numbers[name] / first.numbers()[name]) / np.log(_FACTOR)
    ends = range_of(name)
    return float(np.clip(at, ends.low, ends.high))


def at_position(name: str, at: float, case: Case, first: Case) -> Case:
    """The case with a parameter where its slider stands, as a number of few digits."""
    if name == "alpha":
        return case.replace(alpha=float(np.deg2rad(_rounded(at))))
    if name == "phidot0":
        return with_spin(at, case)
    middle = first.numbers()[name]
    return case.replace(**{name: middle if at == 0 else _rounded(middle * _FACTOR**at)})


def with_spin(s: float, case: Case) -> Case:
    """The case with spin s = r φ̇₀/v₀."""
    numbers = case.numbers()
    return case.replace(phidot0=_rounded(s * numbers["v0"] / numbers["r"]))


def text_of(name: str, case: Case) -> str:
    """A parameter's number as its entry shows it; angles in degrees."""
    number = case.numbers()[name]
    text = f"{np.rad2deg(number) if name == 'alpha' else number:.6g}"
    return re.sub(r"e([+-])0*", lambda sign: "e" + sign[1].strip("+"), text)


def unit_of(name: str, case: Case) -> str:
    """The unit of that number."""
    return "°" if name == "alpha" else unit_name(QUANTITIES[name].dimension, case.units)


def _rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")
