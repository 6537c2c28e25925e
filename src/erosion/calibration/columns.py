"""Columns of measured data: from "volume [in^3]" to a dimension and a factor to consistent units."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from erosion.parameters.units import Dimension, System, UnitError, header_parts, read_quantity

REMOVALS: Mapping[str, Sequence[Dimension]] = {
    "volume": ("volume", "volume per mass"),
    "mass_loss": ("mass", "mass per mass"),
    "erosion": ("volume", "volume per mass", "mass", "mass per mass"),
}
"""The columns that may hold the erosion, with their dimensions; `erosion [-]` has units of its own."""

_OTHERS: Mapping[str, Sequence[Dimension]] = {"angle": ("angle",), "speed": ("speed",), "mass": ("mass",)}

COLUMNS = ("angle", *REMOVALS, "uncertainty", "speed", "mass")

_EXAMPLES = {
    "angle": "angle [deg]", "volume": "volume [mm^3]", "mass_loss": "mass_loss [mg/g]", "erosion": "erosion [-]",
    "speed": "speed [m/s]", "mass": "mass [mg]",
}  # fmt: skip
_NO_UNIT = ("", "-", "–", "1")
_INCH_POUND = {
    "in", "inch", "inches", "mil", "mils", "thou", "ft", "foot", "feet", "mph", "mile", "miles", "lb", "lbs", "lbm",
    "pound", "pounds", "oz", "ounce", "ounces", "grain", "grains", "slug", "slugs", "slinch",
}  # fmt: skip


class Column(NamedTuple):
    """A column: number in the file × factor = number in the unit system."""

    name: str
    dimension: Dimension
    factor: float


class HeaderError(ValueError):
    """A header that cannot be used.

    Args:
        index: the column, from 0; None where one is missing.
        message: a clause that follows the column's place.
    """

    def __init__(self, index: int | None, message: str):
        super().__init__(message)
        self.index = index


def system_of_unit(unit: str) -> System | None:
    """The unit system that a heading's unit belongs to, of which one word says that it is inch-pound; None for none."""
    if unit in _NO_UNIT:
        return None
    return "inch-pound" if _INCH_POUND & {*re.findall(r"[^\W\d_]+", unit)} else "si"


def read_header(cells: Sequence[str], units: System) -> list[Column | None]:
    """The columns of a header; None for a column of another name, which is not used.

    Args:
        cells: "angle [deg]", "volume [in^3]", …
        units: the unit system to convert to.

    Raises:
        HeaderError: for a repeated or missing column, or a unit that does not fit.
    """
    names, given = zip(*map(header_parts, cells), strict=True) if cells else ((), ())
    for i, name in enumerate(names):
        if name in COLUMNS and name in names[:i]:
            raise HeaderError(i, f"repeats the column `{name}`")
    removals = [name for name in names if name in REMOVALS]
    if "angle" not in names:
        raise HeaderError(None, "has no column `angle [deg]`")
    if len(removals) != 1:
        present = f"has {' and '.join(removals)}" if removals else "has none"
        raise HeaderError(None, f"must have one column of erosion ({', '.join(REMOVALS)}), but {present}")
    at = names.index(removals[0])
    removal = _column(at, names[at], given[at], REMOVALS[names[at]], units)
    columns: list[Column | None] = []
    for i, (name, unit) in enumerate(zip(names, given, strict=True)):
        if i == at:
            columns.append(removal)
        elif name not in COLUMNS:
            columns.append(None)
        elif name == "uncertainty":
            columns.append(_column(i, name, unit, (removal.dimension,), units))
        else:
            columns.append(_column(i, name, unit, _OTHERS[name], units))
    return columns


def _column(index: int, name: str, unit: str, dimensions: Sequence[Dimension], units: System) -> Column:
    if unit in _NO_UNIT:
        if name == "erosion" or tuple(dimensions) == ("1",):
            return Column(name, "1", 1.0)
        if "mass per mass" in dimensions and unit:
            return Column(name, "mass per mass", 1.0)
        example = _EXAMPLES.get(name, f"{name} [mm^3]")
        raise HeaderError(index, f"`{name}` must carry its unit in brackets, as `{example}`")
    errors = []
    for dimension in dimensions:
        try:
            # "volume [1e-4 in^3]" has a number of its own.
            return Column(name, dimension, read_quantity(unit if unit[0].isdigit() else f"1 {unit}", dimension, units))
        except UnitError as error:
            errors.append(str(error))
    if len(dimensions) == 1:
        raise HeaderError(index, f"the unit of `{name}` {errors[0].replace(repr('1 ' + unit), repr(unit))}")
    raise HeaderError(index, f"the unit of `{name}` must be one of {_listed(dimensions)}, but is {unit!r}")


def _listed(dimensions: Sequence[Dimension]) -> str:
    return ", ".join(dimensions[:-1]) + f" or {dimensions[-1]}"
