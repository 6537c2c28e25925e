"""From a removed volume to the erosion that engineers measure: volume, and mass, per mass of abrasive."""

import types
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from erosion.array_types import PerImpact
from erosion.parameters.materials import target
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import DIGITS, RESULTS
from erosion.parameters.scales import Scale
from erosion.parameters.units import conversion_factor, has_unit, read_quantity, shown
from erosion.tables import Row, format_number, largest_of

PER_MASS_SCALES: Mapping[str, Scale] = types.MappingProxyType(
    {"specific_volume": Scale(1e-9, "mm³/kg"), "erosion_ratio": Scale(1e-3, "g/kg")}
)
"""The units in which erosion per mass of abrasive reads well, whatever the units of the case."""

# DNVGL-RP-O501 (2015), table 3-1, fits K vⁿ to tests: at 100 m/s 0.23 g/kg for aluminium, 0.32 g/kg for steels.
# n is 2.3 and 2.6 there. Tests of single alloys and grits spread about that by a factor of three.
_TESTED = (1e-4, 1e-3)  # kg/kg at `_TESTED_SPEED`
_TESTED_SPEED, _TESTED_EXPONENT = 100.0, 2.4  # m/s, -
_FAR = 3.0  # outside of the tests by this factor


@dataclass(frozen=True)
class PerMass:
    """How a particle's volume becomes erosion per mass of abrasive.

    A model's volume is that of a particle that cuts. Of a jet only some particles do: the others roll, plough or turn
    their flat side. Finnie put their share at about one half; COMSOL 6.2 takes a tenth. Volumes stay those
    of a particle that cuts, erosion per mass of abrasive is that of all particles.

        erosion.PerMass(density=2700, cutting_fraction=0.5).erosion_ratio(best.volume, best.p)  # kg/kg

    Args:
        density: of the target [kg/m³], whatever the units of the case; None where it is not known.
        cutting_fraction: the share of the particles that cut, in (0, 1].

    Raises:
        ValueError: for a number out of range.

    References:
        I. Finnie, Proc. 3rd U.S. Natl. Congr. Appl. Mech., 1958, 527-532; Wear 3 (1960) 87-103.
    """

    density: float | int | None = None
    cutting_fraction: float | int = 1.0

    def __post_init__(self) -> None:
        if self.density is not None and not 0 < self.density < np.inf:
            raise ValueError(f"Argument `density` must be positive and finite, but is {self.density!r}.")
        if not 0 < self.cutting_fraction <= 1:
            raise ValueError(
                f"Argument `cutting_fraction` must be above 0 and at most 1, but is {self.cutting_fraction!r}."
            )
        object.__setattr__(self, "density", None if self.density is None else float(self.density))
        object.__setattr__(self, "cutting_fraction", float(self.cutting_fraction))

    @classmethod
    def on(cls, name: str, cutting_fraction: float = 1.0) -> "PerMass":
        """For a target by name; see `erosion.target`."""
        return cls(target(name).density, cutting_fraction)

    def specific_volume(self, volume: Any, p: Parameters) -> PerImpact:
        """Removed volume per mass of abrasive [m³/kg], of volumes in the units of `p`; they broadcast with p.m."""
        ratio = np.asarray(volume) / np.asarray(p.m)
        return self.cutting_fraction * ratio * conversion_factor("volume per mass", p.units, "si")

    def erosion_ratio(self, volume: Any, p: Parameters) -> PerImpact:
        """Mass loss per mass of abrasive [kg/kg], of volumes in the units of `p`; they broadcast with p.m.

        Raises:
            ValueError: without a density.
        """
        if self.density is None:
            raise ValueError("Argument `density` must be given for a mass loss, but is None.")
        return self.density * self.specific_volume(volume, p)

    def rows(self, volume: Any, p: Parameters) -> list[Row]:
        """Volume and, where the density is known, mass per mass of abrasive, as table rows in mm³/kg and g/kg."""
        numbers = {name: (value, PER_MASS_SCALES[name]) for name, value in self.to_dict(volume, p).items()}
        return [
            Row(name, RESULTS[name].symbol, format_number(value, DIGITS, scale.size), scale.unit, self.meaning_of(name))
            for name, (value, scale) in numbers.items()
        ]

    def meaning_of(self, name: str) -> str:
        """What a result per mass of abrasive is, and the share of the particles that cut, where it is not all."""
        some = "" if self.cutting_fraction == 1 else f"; {self.cutting_fraction:g} of the particles cut"
        return RESULTS[name].meaning + some

    def to_dict(self, volume: Any, p: Parameters) -> dict[str, Any]:
        """`specific_volume` [m³/kg] and, where the density is known, `erosion_ratio` [kg/kg]."""
        numbers: dict[str, Any] = {"specific_volume": self.specific_volume(volume, p)}
        if self.density is not None:
            numbers["erosion_ratio"] = self.erosion_ratio(volume, p)
        return numbers

    def warning(self, volume: Any, p: Parameters) -> str | None:
        """One sentence where the greatest erosion ratio is far from what tests find at this speed, else None."""
        if self.density is None:
            return None
        speed = float(np.max(np.asarray(p.v0))) * conversion_factor("speed", p.units, "si")
        ratio = largest_of(self.erosion_ratio(volume, p))
        low, high = (end * (speed / _TESTED_SPEED) ** _TESTED_EXPONENT for end in _TESTED)
        if ratio == 0 or low / _FAR <= ratio <= high * _FAR:
            return None
        return (
            f"{ratio * 1e3:.2g} g/kg is far from what tests on ductile metals find at {speed:.3g} m/s, about "
            f"{low * 1e3:.2g} to {high * 1e3:.2g} g/kg (fits to tests: DNVGL-RP-O501, 2015, table 3-1); "
            "only some particles cut, and the product of σ and ψ is known to a factor of two at best."
        )


PER_MASS_UNITS = {name: RESULTS[name].unit("si") for name in ("specific_volume", "erosion_ratio")}
"""The units of `PerMass.to_dict`, as programs read them."""


def read_density(text: Any) -> float:
    """A density of a target as text, with its unit [kg/m³].

    Raises:
        ValueError: with a clause that starts with "must", to follow the field's name.
    """
    if not isinstance(text, str) or not has_unit(text):
        raise ValueError(f'must be a density with its unit, such as "2.7 g/cm^3", but is {shown(text)}')
    return read_quantity(text, "density", "si")
