"""Symbol, meaning and dimension of every number, and ranges of them as text.

The module loads without JAX, so that the command line can make its options from it.

"1deg : 90deg : 90"           90 values, evenly from 1° to 90°
"100 m/s : 1000 m/s : 5 : log"  5 values at even ratios
"20deg, 30deg, 45deg"         these values
"""

import re
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from erosion.parameters.scales import readable_scale, table_scale
from erosion.parameters.units import (
    Dimension,
    System,
    UnitError,
    ascii_unit,
    derivative_unit,
    read_quantity,
    shown,
    unit_name,
)

if TYPE_CHECKING:
    from erosion.output.tables import Row


DIGITS = 6  # in tables: the numerical errors are smaller by far, those of the physics far greater
ANGLE_DIGITS = 5  # 31.717°


@dataclass(frozen=True)
class Quantity:
    """A symbol, its meaning and its dimension.

    Args:
        fixed: the unit of what is in the same one in both unit systems, and so converted by none; its dimension is "1".
    """

    symbol: str
    meaning: str
    dimension: Dimension
    fixed: str = ""

    def label(self, units: System) -> str:
        """An axis label: "v₀  impact speed [in/s]"."""
        unit = unit_name(self.dimension, units)
        return f"{self.symbol}  {self.meaning}" + (f" [{unit}]" if unit else "")

    def unit(self, units: System) -> str:
        """The unit as programs read it: "in^3", "1" for a pure number."""
        return self.fixed or ascii_unit(unit_name(self.dimension, units))

    def in_words(self, value: float, units: System, digits: int = 4) -> str:
        """A number of it with the unit in which it reads well: "30 m/s", "40°", "110.2·10⁻⁶ lb"."""
        scale = table_scale(self.dimension, units, abs(value))
        return scale.beside(f"{value / scale.size:.{digits}g}")

    def attributes(self, units: System) -> dict[str, str]:
        """The same as attributes of a labelled array, in the words of the CF conventions."""
        return {"long_name": self.meaning, "symbol": self.symbol, "units": self.unit(units)}


QUANTITIES: Mapping[str, Quantity] = types.MappingProxyType(
    {
        "k": Quantity("k", "force ratio", "1"),
        "psi": Quantity("ψ", "contact height over depth", "1"),
        "r": Quantity("r", "centre of mass to tip", "length"),
        "b": Quantity("b", "width of the erodent", "length"),
        "m": Quantity("m", "mass of the erodent", "mass"),
        "v0": Quantity("v₀", "impact speed", "speed"),
        "sigma": Quantity("σ", "flow stress", "stress"),
        "alpha": Quantity("α", "angle of attack", "angle"),
        "phidot0": Quantity("φ̇₀", "initial spin", "angular speed"),
        "inertia": Quantity("β", "moment of inertia over m r²", "1"),
    }
)
"""The parameters of an impact, in the order of the constructor of `Parameters`."""

RESULTS = {
    "t_c": Quantity("t_c", "end of the cut", "time"),
    "volume": Quantity("V", "removed volume", "volume"),
    "volume_at_contact": Quantity("V(0)", "removed at contact, beside the cut", "volume"),
    "dvolume": Quantity("dV/dα", "change of volume with angle", "volume per angle"),
    "d2volume": Quantity("d²V/dα²", "its own change with angle", "volume per angle²"),
    "alpha_max": Quantity("α_max", "angle of attack that removes most", "angle"),
    "volume_max": Quantity("V_max", "volume removed at that angle", "volume"),
    "mean_volume": Quantity("V̄", "removed volume of a particle, mean of the stream", "volume"),
    "deviation": Quantity("s", "standard deviation of V from particle to particle", "volume"),
    "mean_mass": Quantity("m̄", "mass of a particle, mean of the stream", "mass"),
    "total_volume": Quantity("ΣV", "removed by all the particles computed", "volume"),
    "erosion": Quantity("E", "removed volume per unit mass of abrasive", "volume per mass"),
    "max_depth": Quantity("d_max", "greatest depth of the tip", "length"),
    "turn": Quantity("Δφ", "how far the body turned", "angle"),
    "specific_volume": Quantity("V/m", "removed volume per mass of erodent", "volume per mass"),
    "mass_loss": Quantity("Δm", "mass loss per impact", "mass"),
    "erosion_ratio": Quantity("Δm/m", "mass loss per mass of erodent", "mass per mass"),
    "relative_erosion": Quantity("E", "erosion, in units of its own", "1"),
    "d": Quantity("d", "diameter of the particle in a CFD code", "length"),
    "e_n": Quantity("e_n", "normal speed of the centre of mass after the impact over that before", "1"),
    "e_t": Quantity("e_t", "tangential velocity of the centre of mass after the impact over that before", "1"),
    "vx": Quantity("ẋ", "velocity of the centre of mass along the surface", "speed"),
    "vy": Quantity("ẏ", "velocity of the centre of mass into the target", "speed"),
    "spin": Quantity("φ̇", "spin after the impact", "angular speed"),
}


def quantity_row(name: str, quantity: Quantity, value: object, units: System) -> "Row":
    """A number, or an array, as a table row in a unit that reads well.

    Args:
        name: the first cell.
        quantity: what the number is.
        value: in the units of `units`.
        units: the unit system.
    """
    from erosion.output.tables import Row, format_number, largest_of

    scale = table_scale(quantity.dimension, units, largest_of(value))
    digits = ANGLE_DIGITS if quantity.dimension == "angle" else DIGITS
    return Row(name, quantity.symbol, format_number(value, digits, scale.size), scale.unit, quantity.meaning)


def result_row(name: str, value: object, units: System) -> "Row":
    """One result as a table row."""
    return quantity_row(name, RESULTS[name], value, units)


def contact_rows(volume: object, units: System) -> "list[Row]":
    """The volume removed at contact as a table row; no row where it is zero."""
    from erosion.output.tables import largest_of

    return [result_row("volume_at_contact", volume, units)] if largest_of(volume) else []


def derivative_row(name: str, value: object, by: Sequence[Quantity], units: System) -> "Row":
    """The volume's derivative with respect to one or two parameters as a table row; per degree, not per radian."""
    from erosion.output.tables import Row, format_number

    same = len(by) == 2 and by[0] == by[1]
    power = "²" if len(by) == 2 else ""
    below = f"∂{by[0].symbol}²" if same else "".join(f"∂{quantity.symbol}" for quantity in by)
    unit = derivative_unit(RESULTS["volume"].dimension, [quantity.dimension for quantity in by], units)
    angles = sum(quantity.dimension == "angle" for quantity in by)
    size = 1 / readable_scale("angle", units, 1.0).size ** angles
    unit = re.sub(r"/rad(²?)(?=/|$)", r"/°\1", unit)
    if units == "si":
        size, unit = size * 1e-9, unit.replace("m³", "mm³", 1)
    meaning = "change of volume with " + " and ".join(dict.fromkeys(quantity.meaning for quantity in by))
    return Row(name, f"∂{power}V/{below}", format_number(value, DIGITS, size), unit, meaning)


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
