"""Ranges: the angles of attack, and axes as text, as the command line and case files write them.

"1deg : 90deg : 90"           90 values, evenly from 1° to 90°
"100 m/s : 1000 m/s : 5 : log"  5 values at even ratios
"20deg, 30deg, 45deg"         these values
"""

import numpy as np

from erosion.parameters.units import Dimension, System, UnitError, read_quantity, shown

STEEPEST = np.pi / 2  # rad; the angle of attack of a perpendicular impact
_LONGEST_COUNT = 100  # digits; Python reads no number of more than a few thousand
QUARTER_DEGREES = np.linspace(0, STEEPEST, 361)[1:]
"""Every quarter of a degree up to 90°, shape (360,) [rad]."""


def read_axis(value: object, dimension: Dimension, system: System) -> np.ndarray:
    """The values of an axis, shape (n,), or of a single quantity, shape ().

    Args:
        value: text as above, a number in the units of `system`, or a list of quantities.
        dimension: of the parameter.
        system: the unit system of bare numbers and of the result.

    Raises:
        UnitError: with a clause that starts with "must", to follow the axis's name.
    """
    if isinstance(value, str) and ":" in value:
        return _range(value, dimension, system)
    if isinstance(value, str):
        value = [part.strip() for part in value.split(",")] if "," in value else value
    if isinstance(value, (list, tuple)):
        if not value:
            raise UnitError("must hold values, but is empty")
        return np.array([_one(part, dimension, system) for part in value])
    return np.array(_one(value, dimension, system))


def _range(text: str, dimension: Dimension, system: System) -> np.ndarray:
    first, last, number, *spacing = (part.strip() for part in text.split(":")) if text.count(":") > 1 else ("",) * 3
    if not number.isdecimal() or len(number) > _LONGEST_COUNT or int(number) < 2 or spacing not in ([], ["log"]):
        raise UnitError(f'must be "first : last : count", with ": log" for even ratios, but is {shown(text)}')
    begin, end = (read_quantity(part, dimension, system) for part in (first, last))
    if not np.isfinite([begin, end]).all():
        raise UnitError(f"must have finite ends, but is {shown(text)}")
    if spacing and begin * end <= 0:
        raise UnitError(f"must have ends of one sign, other than zero, for even ratios, but is {shown(text)}")
    try:
        return (np.geomspace if spacing else np.linspace)(begin, end, int(number))
    except (MemoryError, ValueError) as error:
        raise UnitError(f"must have values that fit into the memory, but is {shown(text)}") from error


def _one(value: object, dimension: Dimension, system: System) -> float:
    if isinstance(value, str):
        return read_quantity(value, dimension, system)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    raise UnitError(f"must be numbers or quantities in quotes, but has {value!r}")
