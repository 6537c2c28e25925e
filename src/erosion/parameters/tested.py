"""The ranges of a fit's tests, which a case file keeps, and how far a question lies outside of them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from erosion.output.tables import briefly
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import System, UnitError, conversion_factor, has_unit, read_quantity

_WORDS = {"alpha": ("flattest", "steepest"), "v0": ("slowest", "fastest"), "m": ("lightest", "heaviest")}
_UNITS = {"alpha": ("deg", 180 / np.pi), "v0": ("m/s", 1.0), "m": ("kg", 1.0)}
_SAME = 0.005  # relative: of numbers that were rounded


@dataclasses.dataclass(frozen=True)
class Tested:
    """What the rows of a fit had.

    Args:
        ranges: least and greatest of "alpha" [rad], "v0" [m/s] and "m" [kg].
    """

    ranges: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, values: Mapping[str, Any], units: System) -> "Tested":
        """Of numbers or arrays by name, in a unit system."""
        in_si = _in_si(values, units)
        return cls({name: (float(np.min(rows)), float(np.max(rows))) for name, rows in in_si.items()})

    @classmethod
    def read(cls, table: Any) -> "Tested":
        """Of the field `tested` of a case file: {v0 = ["60 m/s", "90 m/s"], …}.

        Raises:
            ValueError: with a clause that starts with "must", for another table.
        """
        ranges = {}
        example = 'must be a table such as {v0 = ["60 m/s", "90 m/s"]}, of ' + ", ".join(_WORDS)
        for name, ends in table.items() if isinstance(table, dict) else [("", [])]:
            are_texts = isinstance(ends, list) and all(isinstance(end, str) and has_unit(end) for end in ends)
            if name not in _WORDS or not are_texts or len(ends) != 2:
                raise ValueError(f"{example}, but is {briefly(table)}")
            try:
                low, high = (read_quantity(end, QUANTITIES[name].dimension, "si") for end in ends)
            except UnitError as error:
                raise ValueError(str(error)) from error
            if not 0 < low <= high < np.inf:
                raise ValueError(f"{example}, but is {briefly(table)}")
            ranges[name] = low, high
        return cls(ranges)

    def dump(self) -> str:
        """The text that `read` understands."""
        listed = []
        for name, ends in self.ranges.items():
            unit, factor = _UNITS[name]
            low, high = (f'"{end * factor:.9g} {unit}"' for end in ends)
            listed.append(f"{name} = [{low}, {high}]")
        return f"{{ {', '.join(listed)} }}"

    def outside(self, values: Mapping[str, Any], units: System = "si") -> list[str]:
        """Sentences on values, numbers or arrays by name, that lie outside: "120 m/s is 1.33 × the fastest test"."""
        said, values = [], _in_si(values, units)
        for name, (low, high) in self.ranges.items():
            if name in values:
                least, most = float(np.min(values[name])), float(np.max(values[name]))
                quantity, (lower, upper) = QUANTITIES[name], _WORDS[name]
                if most > high * (1 + _SAME):
                    said.append(f"{quantity.in_words(most, 'si')} is {most / high:.3g} × the {upper} test.")
                if least < low * (1 - _SAME):
                    said.append(f"{quantity.in_words(least, 'si')} is {least / low:.3g} × the {lower} test.")
        return said


def _in_si(values: Mapping[str, Any], units: System) -> dict[str, Any]:
    return {name: np.asarray(value) * conversion_factor(QUANTITIES[name].dimension, units, "si")
            for name, value in values.items()}  # fmt: skip
