"""Columns of measured data: from "volume [in^3]" to a dimension and a factor to consistent units."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from erosion.parameters.headings import (
    ANGLE_WORDS,
    ANGLES,
    MASS_WORDS,
    MASSES,
    NO_UNIT,
    SIZE_WORDS,
    SPEED_WORDS,
    SPEEDS,
    Head,
    HeaderError,
    Known,
    factor,
    matching,
    read_heads,
)
from erosion.parameters.units import Dimension, System, UnitError

REMOVALS: Mapping[str, Sequence[Dimension]] = {
    "volume": ("volume", "volume per mass"),
    "mass_loss": ("mass", "mass per mass"),
    "erosion": ("volume", "volume per mass", "mass", "mass per mass"),
}
"""The columns that may hold the erosion, with their dimensions; `erosion [-]` has units of its own."""

_LOSS_WORDS = r"vol\w*|loss\w*|lost|wear\w*|erosion\w*|eroded|remov\w*|ratio|rate|depth|abtrag|verlust|verschlei\w*"
_KNOWN: Mapping[str, Known] = {
    "angle": Known(("angle",), ANGLES, ANGLE_WORDS),
    "volume": Known(
        REMOVALS["volume"],
        ("volume loss", "wear volume", "eroded volume", "removed volume", "volume removed"),
        _LOSS_WORDS,
    ),
    "mass_loss": Known(
        REMOVALS["mass_loss"],
        ("mass loss", "weight loss", "eroded mass", "removed mass", "mass removed", "mass loss of target"),
        _LOSS_WORDS,
    ),
    "erosion": Known(
        REMOVALS["erosion"],
        ("erosion rate", "erosion ratio", "specific erosion", "erosion loss", "wear", "wear rate"),
        _LOSS_WORDS,
    ),
    "uncertainty": Known(
        REMOVALS["erosion"],
        ("standard deviation", "standard uncertainty", "std", "stdev", "std dev", "sd"),
        r"uncert\w*|std\w*|stdev|deviation|errors?|err|scatter|unsicherheit|streuung",
    ),
    "speed": Known(("speed",), (*SPEEDS, "v"), f"{SPEED_WORDS}|rpm"),
    "mass": Known(("mass",), (*MASSES, "erodent mass", "mass of erodent", "grain mass"), f"{MASS_WORDS}|{SIZE_WORDS}"),
}
_ALSO: Sequence[Dimension] = ("length", "density", "angular speed", "mass flow", "rate")
"""Conditions of a row that are the case's: sizes, densities, spins, feeds."""

_EXAMPLES = {
    "angle": "angle [deg]", "volume": "volume [mm^3]", "mass_loss": "mass_loss [mg/g]", "erosion": "erosion [-]",
    "speed": "speed [m/s]", "mass": "mass [mg]",
}  # fmt: skip
_INCH_POUND = {
    "in", "inch", "inches", "mil", "mils", "thou", "ft", "foot", "feet", "mph", "mile", "miles", "lb", "lbs", "lbm",
    "pound", "pounds", "oz", "ounce", "ounces", "grain", "grains", "slug", "slugs", "slinch",
}  # fmt: skip


class Column(NamedTuple):
    """A column: number in the file × factor = number in the unit system."""

    name: str
    dimension: Dimension
    factor: float


def system_of_unit(unit: str) -> System | None:
    """The unit system that a heading's unit belongs to, of which one word says that it is inch-pound; None for none."""
    if unit in NO_UNIT:
        return None
    return "inch-pound" if _INCH_POUND & {*re.findall(r"[^\W\d_]+", unit)} else "si"


class Header(NamedTuple):
    """The columns of a table.

    Args:
        columns: in their order; None for one that is not used.
        unused: the heads of those, without those that were to be ignored.
    """

    columns: Sequence[Column | None]
    unused: tuple[str, ...]


def read_header(cells: Sequence[str], units: System, ignore: Sequence[str] = ()) -> Header:
    """The columns of a header.

    Args:
        cells: "angle [deg]", "volume [in^3]", …
        units: the unit system to convert to.
        ignore: columns that are left out, by their names.

    Raises:
        HeaderError: for a repeated or missing column, one that is not understood, or a unit that does not fit.
    """
    heads, unused = read_heads(cells, _KNOWN, ignore=ignore, also=_ALSO)
    names = [head.name for head in heads if head is not None]
    removals = [name for name in names if name in REMOVALS]
    if "angle" not in names:
        raise HeaderError(None, "has no column `angle [deg]`")
    if len(removals) != 1:
        present = f"has {' and '.join(removals)}" if removals else "has none"
        remedy = "; Argument `ignore` may name the others" if removals else ""
        raise HeaderError(None, f"must have one column of erosion ({', '.join(REMOVALS)}), but {present}{remedy}")
    at = next(i for i, head in enumerate(heads) if head is not None and head.name == removals[0])
    removal = _column(at, heads[at], REMOVALS[removals[0]], units)
    columns: list[Column | None] = []
    for i, head in enumerate(heads):
        if head is None or i == at:
            columns.append(None if head is None else removal)
        else:
            expected = (removal.dimension,) if head.name == "uncertainty" else _KNOWN[head.name].dimensions
            columns.append(_column(i, head, expected, units))
    return Header(columns, unused)


def units_of_header(cells: Sequence[str], names: Sequence[str], ignore: Sequence[str] = ()) -> list[str]:
    """The units of some columns, in the order of `names`."""
    heads = [head for head in matching(cells, _KNOWN, ignore=ignore) if head is not None]
    return [head.unit for name in names for head in heads if head.name == name]


def _column(index: int, head: Head | None, dimensions: Sequence[Dimension], units: System) -> Column:
    assert head is not None
    name, unit = head.name, head.unit
    if name in REMOVALS and unit in ("%", "percent"):
        raise HeaderError(index, "must not be a percentage, which may be one of the target's mass; write [mg/g]")
    if unit in NO_UNIT:
        if name == "erosion" and head.alias:
            message = "must carry its unit in brackets, as [mg/g]; `erosion [-]` is known up to a factor"
            raise HeaderError(index, message)
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
            return Column(name, dimension, factor(unit, dimension, units))
        except UnitError as error:
            errors.append(str(error))
    if len(dimensions) == 1:
        raise HeaderError(index, f"the unit of `{name}` {errors[0].replace(repr('1 ' + unit), repr(unit))}")
    raise HeaderError(index, f"the unit of `{name}` must be one of {_listed(dimensions)}, but is {unit!r}")


def _listed(dimensions: Sequence[Dimension]) -> str:
    return ", ".join(dimensions[:-1]) + f" or {dimensions[-1]}"
