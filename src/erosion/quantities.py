"""What numbers are called, and their units: the one source of labels for tables and axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from erosion.tables import Row, format_number
from erosion.units import Dimension, System, derivative_unit, unit_name


@dataclass(frozen=True)
class Quantity:
    """A symbol, its meaning and its dimension."""

    symbol: str
    meaning: str
    dimension: Dimension

    def label(self, units: System) -> str:
        """An axis label: "v₀  impact speed [in/s]"."""
        unit = unit_name(self.dimension, units)
        return f"{self.symbol}  {self.meaning}" + (f" [{unit}]" if unit else "")


RESULTS = {
    "t_c": Quantity("t_c", "end of the cut", "time"),
    "volume": Quantity("V", "removed volume", "volume"),
    "dvolume": Quantity("dV/dα", "change of volume with angle", "volume per angle"),
    "d2volume": Quantity("d²V/dα²", "its own change with angle", "volume per angle²"),
    "max_depth": Quantity("d_max", "greatest depth of the tip", "length"),
    "turn": Quantity("Δφ", "how far the body turned", "angle"),
}


def derivative_row(name: str, value: Any, by: Sequence[Quantity], units: System) -> Row:
    """The volume's derivative with respect to one or two parameters as a table row."""
    same = len(by) == 2 and by[0] == by[1]
    power = "²" if len(by) == 2 else ""
    below = f"∂{by[0].symbol}²" if same else "".join(f"∂{quantity.symbol}" for quantity in by)
    unit = derivative_unit(RESULTS["volume"].dimension, [quantity.dimension for quantity in by], units)
    meaning = "change of volume with " + " and ".join(dict.fromkeys(quantity.meaning for quantity in by))
    return Row(name, f"∂{power}V/{below}", format_number(value), unit, meaning)


def result_row(name: str, value: Any, units: System) -> Row:
    """One result as a table row."""
    quantity = RESULTS[name]
    return Row(name, quantity.symbol, format_number(value), unit_name(quantity.dimension, units), quantity.meaning)
