"""The columns of tables of measurements."""

import difflib
from collections.abc import Mapping, Sequence

from erosion.output import briefly
from erosion.parameters import Dimension, UnitError, read_removal
from erosion.tables import Column, Table, TableError
from erosion.tables.headings import (
    ANGLE_WORDS,
    ANGLES,
    MASS_WORDS,
    MASSES,
    NO_UNIT,
    SIZE_WORDS,
    SPEED_WORDS,
    SPEEDS,
    Wanted,
    factor,
    heading_parts,
)


class MeasurementError(ValueError):
    """Data that cannot be used; the message names the table, row and column."""


REMOVALS: Mapping[str, Sequence[Dimension]] = {
    "volume": ("volume", "volume per mass"),
    "mass_loss": ("mass", "mass per mass"),
    "erosion": ("volume", "volume per mass", "mass", "mass per mass", "1"),
}
"""The columns that may hold the erosion, with their dimensions; `erosion [-]` has units of its own."""

_PERCENT = ("%", "percent")


class _Removed(Wanted):
    """What is removed; its unit may be per impact."""

    def factor(self, unit: str, dimension: Dimension) -> float:
        """See `Wanted`."""
        return factor(unit, dimension, read_removal)


class Removal(_Removed):
    """An erosion, per impact, per mass of particles, or known up to a factor."""

    @property
    def example(self) -> str:
        """See `Wanted`."""
        return "mg/impact" if self.dimensions[0] == "mass" else "mm^3/impact"

    def measure(self, unit: str, *, is_alias: bool) -> tuple[Dimension, float] | None:
        """See `Wanted`."""
        if unit in _PERCENT:
            raise UnitError("must not be a percentage, which may be one of the target's mass; write [mg/g]")
        if "1" in self.dimensions and unit in NO_UNIT:
            return None if is_alias else ("1", 1.0)
        return super().measure(unit, is_alias=is_alias)


class UncertaintyColumn(_Removed):
    """The standard deviation of an erosion, in its unit or as a share of it."""

    def measure(self, unit: str, *, is_alias: bool) -> tuple[Dimension, float] | None:
        """See `Wanted`."""
        return ("1", 0.01) if unit in _PERCENT else super().measure(unit, is_alias=is_alias)


def is_per_impact(column: Column) -> bool:
    """Whether the unit of a column of erosion, or of its uncertainty, says "per impact"."""
    return "impact" in column.unit


def are_shares(column: Column) -> bool:
    """Whether the uncertainties of a column are shares of the erosion."""
    return column.unit in _PERCENT


_LOSS_WORDS = r"vol\w*|loss\w*|lost|wear\w*|erosion\w*|eroded|remov\w*|ratio|rate|depth|abtrag|verlust|verschlei\w*"
KNOWN: Mapping[str, Wanted] = {
    "angle": Wanted(("angle",), ANGLES, ANGLE_WORDS),
    "volume": Removal(
        REMOVALS["volume"],
        ("volume loss", "wear volume", "eroded volume", "removed volume", "volume removed"),
        _LOSS_WORDS,
    ),
    "mass_loss": Removal(
        REMOVALS["mass_loss"],
        ("mass loss", "weight loss", "eroded mass", "removed mass", "mass removed", "mass loss of target"),
        _LOSS_WORDS,
    ),
    "erosion": Removal(
        REMOVALS["erosion"],
        ("erosion rate", "erosion ratio", "specific erosion", "erosion loss", "wear", "wear rate"),
        _LOSS_WORDS,
    ),
    "uncertainty": UncertaintyColumn(
        REMOVALS["erosion"],
        ("standard deviation", "standard uncertainty", "std", "stdev", "std dev", "sd"),
        r"uncert\w*|std\w*|stdev|deviation|errors?|err|scatter|unsicherheit|streuung",
    ),
    "speed": Wanted(("speed",), (*SPEEDS, "v"), f"{SPEED_WORDS}|rpm"),
    "mass": Wanted(("mass",), (*MASSES, "erodent mass", "mass of erodent", "grain mass"), f"{MASS_WORDS}|{SIZE_WORDS}"),
}
REFUSED = {"condition": Wanted(("length", "density", "angular speed", "mass flow", "rate"))}
"""Conditions of a row that are the case's: sizes, densities, spins, feeds."""


def removal_of(table: Table) -> str:
    """The column of the erosion of a table that has all columns it needs.

    Raises:
        TableError: for a missing column, several erosions, and an uncertainty in another unit than the erosion.
    """
    if "angle" not in table.columns:
        raise TableError(f"{table.title}: has no column `angle [deg]`{_instead(table.source.headings)}.")
    removals = [name for name in table.columns if name in REMOVALS]
    if len(removals) != 1:
        present = f"has {' and '.join(removals)}" if removals else "has none"
        remedy = "; Argument `ignore` may name the others" if removals else ""
        raise TableError(
            f"{table.title}: must have one column of erosion ({', '.join(REMOVALS)}), but {present}{remedy}."
        )
    removal, uncertainty = table.columns[removals[0]], table.columns.get("uncertainty")
    if uncertainty and not are_shares(uncertainty) and uncertainty.dimension != removal.dimension:
        raise TableError(
            f"{table.title}: column {uncertainty.heading.strip()!r} must have the unit of a {removal.dimension}, as "
            f"{removal.heading.strip()!r} has, or %."
        )
    return removals[0]


def _instead(headings: Sequence[str]) -> str:
    """The columns that a table has in place of the one that is looked for, as a clause."""
    listed = [heading.strip() for heading in headings if heading.strip()]
    names = {heading_parts(heading)[0].lower(): heading for heading in listed}
    near = difflib.get_close_matches("angle", names, 1, 0.5) or difflib.get_close_matches("impact angle", names, 1, 0.5)
    nearest = f"; {briefly(names[near[0]])} comes nearest to it" if near else ""
    return f"; its columns are {briefly(', '.join(listed))}{nearest}"
