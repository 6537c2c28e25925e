"""Units in which numbers read well."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from erosion.parameters.units import SYSTEMS, Dimension, System, unit_name


class Scale(NamedTuple):
    """A unit that makes numbers readable: the number in the base unit, divided by `size`, is the number in `unit`."""

    size: float
    unit: str


_NAMED: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    **{("time", units): (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)) for units in SYSTEMS},
    ("length", "si"): (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)),
    ("volume", "si"): (("m³", 1.0), ("mm³", 1e-9), ("µm³", 1e-18)),
}


def superscript(exponent: int) -> str:
    """An integer in superscript digits: "⁻⁴"."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def readable_scale(dimension: Dimension, units: System, largest: float) -> Scale:
    """The unit in which numbers up to `largest` read well: "µs", "mm", "10⁻³ in", "10⁻⁴ in³".

    Args:
        dimension: the dimension of the numbers.
        units: the unit system of `largest`.
        largest: the greatest magnitude to show; 0 or a number that is not finite gives the
            base unit.
    """
    base = unit_name(dimension, units)
    if not (math.isfinite(largest) and largest > 0):
        return Scale(1.0, base)
    for unit, size in _NAMED.get((dimension, units), ()):
        if (0.05 if dimension == "volume" else 0.5) <= largest / size < 1e3:
            return Scale(size, unit)
    if 0.5 <= largest < (1e5 if dimension in ("speed", "1") else 1e3):
        return Scale(1.0, base)
    exponent = math.floor(math.log10(largest) + 1e-9)
    exponent -= 0 if dimension == "volume" else exponent % 3
    return Scale(10.0**exponent, f"10{superscript(exponent)} {base}".strip())
