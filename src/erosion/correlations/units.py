"""The units in which a correlation gives the erosion, and the types of its arguments."""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from jaxtyping import Array, Float, Int

Values = Float[Array | np.ndarray, "..."] | Int[Array | np.ndarray, "..."] | float | int
"""A number or an array; several broadcast."""

_Material = TypeVar("_Material")

UNITS = ("kg/kg", "mm3/kg", "mm3/impact")
"""Target lost per erodent: mass per mass, volume per mass, volume per particle."""

_MM3 = 1e9  # mm³ in a m³


def in_units(ratio: Array, units: str, density: Values, mass: Values | None = None) -> Array:
    """The erosion in other units.

    Args:
        ratio: E, mass of target per mass of erodent [kg/kg].
        units: one of `UNITS`; "mm³" is read as "mm3".
        density: of the target [kg/m³].
        mass: of a particle [kg], for "mm3/impact" alone.

    Raises:
        ValueError: for other units, or where the mass is missing or of no use.
    """
    wanted = units.replace("³", "3")
    if wanted not in UNITS:
        raise ValueError(f"Argument `units` must be one of {', '.join(UNITS)}, but is {units!r}.")
    if (mass is not None) != (wanted == "mm3/impact"):
        raise ValueError(
            "Argument `mass` must be the mass of a particle [kg] for mm3/impact, and be left out for other units, "
            f"but units are {wanted} and mass is {mass!r}."
        )
    if wanted == "kg/kg":
        return ratio
    volume = ratio / density * _MM3
    return volume if mass is None else volume * mass


def of_table(table: Mapping[str, _Material], material: str | _Material, kind: type[_Material]) -> _Material:
    """A material by name, or the user's own.

    Raises:
        ValueError: for a name that the table lacks.
    """
    if isinstance(material, kind):
        return material
    if not isinstance(material, str) or material not in table:
        raise ValueError(
            f"Argument `material` must be one of {', '.join(table)}, or a {kind.__name__}, but is {material!r}."
        )
    return table[material]
