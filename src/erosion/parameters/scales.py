"""Units in which numbers read well: µs, mm, mm³, mil, degrees, and else powers of ten of the nearest of them."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from erosion.parameters.units import SYSTEMS, Dimension, System, conversion_factor, unit_name


class Scale(NamedTuple):
    """A unit that makes numbers readable: the number in the base unit, divided by `size`, is the number in `unit`."""

    size: float
    unit: str

    def beside(self, number: str) -> str:
        """A number in this unit, with it: "30 m/s", "40°", "(3.1 ± 2.5)·10⁻⁷ in³"."""
        if self.unit.startswith("10"):
            return f"({number})·{self.unit}" if "±" in number else f"{number}·{self.unit}"
        return f"{number} {self.unit}".rstrip().replace(" °", "°")


_DEGREE = math.pi / 180
_POUND = 0.45359237 / conversion_factor("mass", "inch-pound", "si")  # lb in slinch

_NAMED: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    **{("time", units): (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)) for units in SYSTEMS},
    **{("mass per mass", units): (("g/kg", 1e-3), ("mg/kg", 1e-6), ("µg/kg", 1e-9)) for units in SYSTEMS},
    ("length", "si"): (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)),
    ("area", "si"): (("m²", 1.0), ("mm²", 1e-6), ("µm²", 1e-12)),
    ("volume", "si"): (("m³", 1.0), ("mm³", 1e-9), ("µm³", 1e-18)),
    ("mass", "si"): (("kg", 1.0), ("g", 1e-3), ("mg", 1e-6), ("µg", 1e-9), ("ng", 1e-12)),
    ("stress", "si"): (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3), ("Pa", 1.0)),
    ("volume per mass", "si"): (("mm³/g", 1e-6), ("mm³/kg", 1e-9)),
}
_RARE: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    ("length", "inch-pound"): (("mil", 1e-3), ("µin", 1e-6)),
    ("volume", "si"): (("cm³", 1e-6),),
}
"""Units for numbers that would need a power of ten otherwise."""
_BASES: Mapping[tuple[str, str], tuple[str, float]] = {
    **{("angle", units): ("°", _DEGREE) for units in SYSTEMS},
    ("mass", "inch-pound"): ("lb", _POUND),
    ("volume per mass", "inch-pound"): ("in³/lb", 1 / _POUND),
}
"""Units that readers expect instead of the consistent unit."""
_ANY_SIZE = ("1", "angle", "speed", "angular speed", "rate", "density")
"""Dimensions whose numbers read well without prefixes over many powers of ten."""
_PER_ANGLE = {"volume per angle": ("°", _DEGREE), "volume per angle²": ("°²", _DEGREE**2)}


def known_scales(dimension: Dimension, units: System) -> list[Scale]:
    """The units in which a reader may give numbers of a dimension: the consistent one first, then others by name."""
    key = (dimension, units)
    named = (*_NAMED.get(key, ()), *_RARE.get(key, ()), *([_BASES[key]] if key in _BASES else ()))
    sizes = {unit_name(dimension, units): 1.0} | dict(named)
    return [Scale(size, unit) for unit, size in sizes.items()]


def superscript(exponent: int) -> str:
    """An integer in superscript digits: "⁻⁴"."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def readable_scale(dimension: Dimension, units: System, largest: float) -> Scale:
    """The unit in which numbers up to `largest` read well: "µs", "mm", "°", "mil", "10⁻⁴ in³/°".

    Args:
        dimension: the dimension of the numbers.
        units: the unit system of `largest`.
        largest: the greatest magnitude to show; 0 or a number that is not finite gives the
            base unit.
    """
    return _scale(dimension, units, largest, (0.5, 1e3))


def table_scale(dimension: Dimension, units: System, largest: float) -> Scale:
    """As `readable_scale`, for a table: numbers from a thousandth to a million need no power of ten."""
    return Scale(1.0, "") if dimension == "1" else _scale(dimension, units, largest, (1e-3, 1e6))


def _scale(dimension: Dimension, units: System, largest: float, plain: tuple[float, float]) -> Scale:
    """See `readable_scale`; numbers within `plain` need no power of ten."""
    if dimension in _PER_ANGLE:
        below, angle = _PER_ANGLE[dimension]
        volume = _scale("volume", units, largest * angle, plain)
        return Scale(volume.size / angle, f"{volume.unit}/{below}")
    base, size = _BASES.get((dimension, units), (unit_name(dimension, units), 1.0))
    if not (math.isfinite(largest) and largest > 0) or dimension == "angle":
        return Scale(size, base)
    named = _NAMED.get((dimension, units), ())
    # A volume has a thousand times as many digits between two prefixes.
    ideal = (0.05 if dimension == "volume" else 0.5, 1e3)
    for low, high in (ideal, plain):
        for unit, unit_size in named:
            if low <= largest / unit_size < high:
                return Scale(unit_size, unit)
    greatest = 1e5 if dimension in _ANY_SIZE else 1e3
    if plain[0] <= largest / size < max(greatest, plain[1]):
        return Scale(size, base)
    # Powers of ten of volumes in in³, as the source has them, are not in steps of three.
    step = 3 if named or dimension != "volume" else 1
    scales = [
        (step * math.floor((math.log10(largest / unit_size) + 1e-9) / step), unit, unit_size)
        for unit, unit_size in ((base, size), *named, *_RARE.get((dimension, units), ()))
        if 1e-300 < largest / unit_size < 1e300  # the power of ten, and its inverse, are numbers
    ]
    if not scales:
        return Scale(size, base)
    exponent, unit, unit_size = min(scales, key=lambda scale: abs(scale[0]))
    # A division by a whole power of ten rounds once.
    factor = unit_size * 10.0**exponent if exponent > 0 else unit_size / 10.0**-exponent
    return Scale(factor, f"10{superscript(exponent)} {unit}".strip() if exponent else unit)
