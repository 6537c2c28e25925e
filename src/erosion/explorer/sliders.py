"""The range of each parameter's slider, and the number that belongs to each position."""

import re
from typing import NamedTuple

import numpy as np

from erosion.explorer.state import Case
from erosion.parameters.quantities import QUANTITIES
from erosion.parameters.units import unit_name

_FACTOR = 20.0  # a slider reaches from 1/20 to 20 times the first value, if this value is positive
_DIGITS = 4  # of the numbers that a slider sets


class Range(NamedTuple):
    """Ends and step of a slider, in units of its position."""

    low: float
    high: float
    step: float


ANGLES = Range(0.25, 90.0, 0.25)  # degrees
SPINS = Range(-1.0, 1.0, 0.01)  # s = r φ̇₀/v₀
# Exponents of `_FACTOR`, which multiplies the first value. If the first value of an own parameter is not positive:
# distances from the first value, as shares of its size; of a value of 0, as shares of the case's parameter of the
# same dimension: a speed reaches from -v₀ to v₀.
FACTORS = Range(-1.0, 1.0, 0.005)
SPIN_PRESETS = (-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5)


def range_of(name: str) -> Range:
    """The positions of a parameter's slider."""
    return {"alpha": ANGLES, "phidot0": SPINS}.get(name, FACTORS)


def position(name: str, case: Case, first: Case) -> float:
    """The position of a parameter's slider; a number out of range puts the slider at its end.

    Args:
        name: the parameter.
        case: the case that is shown.
        first: the case at the middle of all sliders, in the same units.
    """
    numbers, ends = case.numbers(), range_of(name)
    middle = first.numbers()[name]
    if name == "alpha":
        at = np.rad2deg(numbers["alpha"])
    elif name == "phidot0":
        at = numbers["phidot0"] * numbers["r"] / numbers["v0"]
    elif middle <= 0:
        at = (numbers[name] - middle) / _size(name, first)
    else:
        at = np.log(numbers[name] / middle) / np.log(_FACTOR) if numbers[name] > 0 else ends.low
    return float(np.clip(at, ends.low, ends.high))


def at_position(name: str, at: float, case: Case, first: Case) -> Case:
    """Set a parameter to the number at its slider's position, rounded to few digits."""
    if name == "alpha":
        return case.replace(alpha=float(np.deg2rad(_rounded(at))))
    if name == "phidot0":
        return with_spin(at, case)
    middle = first.numbers()[name]
    moved = middle * _FACTOR**at if middle > 0 else middle + at * _size(name, first)
    least = next((number.least for number in case.own if number.key == name), 0.0)
    return case.replace(**{name: middle if at == 0 else max(_rounded(moved), least)})


def with_spin(s: float, case: Case) -> Case:
    """Set the spin to s = r φ̇₀/v₀."""
    numbers = case.numbers()
    return case.replace(phidot0=_rounded(s * numbers["v0"] / numbers["r"]))


def text_of(name: str, case: Case) -> str:
    """The text of a parameter's entry; angles are in degrees."""
    number = case.numbers()[name]
    text = f"{np.rad2deg(number) if _is_angle(name, case) else number:.6g}"
    return re.sub(r"e([+-])0*", lambda sign: "e" + sign[1].strip("+"), text)


def unit_of(name: str, case: Case) -> str:
    """The unit of the number that `text_of` shows."""
    return "°" if _is_angle(name, case) else unit_name(case.quantities()[name].dimension, case.units)


def _is_angle(name: str, case: Case) -> bool:
    return case.quantities()[name].dimension == "angle"


def _size(name: str, first: Case) -> float:
    numbers, dimension = first.numbers(), first.quantities()[name].dimension
    alike = (numbers[other] for other, quantity in QUANTITIES.items() if quantity.dimension == dimension != "1")
    return abs(numbers[name]) or next(alike, 1.0)


def _rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")
