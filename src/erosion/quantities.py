"""What numbers are called, and their units: the one source of labels for tables and axes."""

from dataclasses import dataclass
from typing import Any

from erosion.tables import Row, format_number
from erosion.units import Dimension, System, unit_name


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
    "specific_volume": Quantity("V/m", "removed volume per mass of erodent", "volume per mass"),
    "mass_loss": Quantity("Δm", "mass loss per impact", "mass"),
    "erosion_ratio": Quantity("Δm/m", "mass loss per mass of erodent", "mass per mass"),
    "erosion": Quantity("E", "erosion, in units of its own", "1"),
}


def result_row(name: str, value: Any, units: System) -> Row:
    """One result as a table row."""
    quantity = RESULTS[name]
    return Row(name, quantity.symbol, format_number(value), unit_name(quantity.dimension, units), quantity.meaning)
