"""A correlation as a model: compared, swept and streamed like a model of the cut."""

import math
import warnings

import equinox as eqx
import numpy as np

from erosion.array_types import Broadcast, Scalar
from erosion.correlations import CORRELATIONS
from erosion.correlations.ranges import OutOfRangeWarning, outside_in_words
from erosion.models.base import CuttingModel, Tip
from erosion.models.own_parameters import own_parameter
from erosion.parameters.parameters import Parameters
from erosion.parameters.per_mass import PerMass
from erosion.parameters.units import conversion_factor


class Correlated(CuttingModel):
    """The volume of an impact is E(α, v₀) m/ρ, with a correlation's E and the target's density ρ.

    A correlation knows no motion: all of the volume is removed at contact, and the impact ends as "no-cut" at t_c = 0.
    `run`, `compare`, `sweep` and `stream` say how many of their impacts are outside of the correlation's range.

    Args:
        name: in `erosion.CORRELATIONS`.
        material: a target in the table of the correlation; its default without one.
        density: ρ of the target [kg/m³], whatever the units of the case.
    """

    name: str = eqx.field(static=True)
    material: str | None = eqx.field(static=True, default=None)
    density: float = own_parameter(7800.0, "ρ", "density of the target [kg/m³]")

    @property
    def label(self) -> str:
        """The name that `load_model` knows it by: "dnv", "dnv:duplex"."""
        return self.name if self.material is None else f"{self.name}:{self.material}"

    def _factors(self, p: Parameters) -> dict[str, object]:
        """The correlation's further arguments."""
        return {} if self.material is None else {"material": self.material}

    def removed_at_contact(self, p: Parameters) -> Scalar:
        speed = p.v0 * conversion_factor("speed", p.units, "si")
        mass = p.m * conversion_factor("mass", p.units, "si")
        with warnings.catch_warnings():
            # Verbs warn once, with the share of their impacts: `outside_of_range`.
            warnings.simplefilter("ignore", OutOfRangeWarning)
            ratio = CORRELATIONS[self.name].erosion(p.alpha, speed, **self._factors(p))
        return ratio * mass / self.density * conversion_factor("volume", "si", p.units)

    def outside_of_range(self, p: Parameters, counted: np.ndarray | None = None) -> str | None:
        values = {name: np.asarray(value) for name, value in self._checked(p).items()}
        return outside_in_words(self.label, CORRELATIONS[self.name].ranges, values, counted)

    def _checked(self, p: Parameters) -> dict[str, Broadcast]:
        """What may lie outside of a range, in SI units."""
        return {"alpha": p.alpha, "v0": p.v0 * conversion_factor("speed", p.units, "si")}

    @property
    def needs_units(self) -> bool:
        return True  # a correlation is in m/s and kg

    # Depth and velocity of 0 are what the events take for "no-cut".
    def initial_state(self, p: Parameters) -> Scalar:
        return p.alpha * 0.0

    def derivative(self, state: Scalar, p: Parameters) -> Scalar:
        return state * 0.0

    def tip(self, state: Scalar, p: Parameters) -> Tip:
        return Tip(state, state, state, state)


class CorrelatedBySize(Correlated):
    """The same for a correlation that depends on the size of the erodent, a sphere of the mass of the case.

    Args:
        particle_density: of the erodent [kg/m³], whatever the units of the case; 2650 is quartz.
    """

    particle_density: float = own_parameter(2650.0, "ρ_p", "density of the erodent [kg/m³]")

    def _factors(self, p: Parameters) -> dict[str, object]:
        return {**super()._factors(p), "diameter": self._diameter(p)}

    def _checked(self, p: Parameters) -> dict[str, Broadcast]:
        return {**super()._checked(p), "diameter": self._diameter(p)}

    def _diameter(self, p: Parameters) -> Broadcast:
        volume = p.m * conversion_factor("mass", p.units, "si") / self.particle_density
        return (6 * volume / math.pi) ** (1 / 3)


def per_mass_of(model: CuttingModel, per_mass: PerMass) -> PerMass:
    """How a model's volume becomes erosion per mass: a correlation has a density and all particles in it already."""
    return PerMass(float(model.density)) if isinstance(model, Correlated) else per_mass


def correlated(name: str, material: str | None = None) -> Correlated:
    """A correlation as a model.

        erosion.compare(["rotating", erosion.models.correlated("dnv", "duplex")], p)

    `erosion.load_model("dnv:duplex")` gives the same; every verb takes that name.

    Args:
        name: in `erosion.CORRELATIONS`.
        material: a target in the table of the correlation; its default without one.

    Returns:
        A model with the own parameter `density`, and `particle_density` where the size counts.

    Raises:
        ValueError: for an unknown correlation or material.
    """
    if name not in CORRELATIONS:
        raise ValueError(f"Argument `name` must be one of {', '.join(CORRELATIONS)}, but is {name!r}.")
    correlation = CORRELATIONS[name]
    if material is not None and material not in correlation.materials:
        known = ", ".join(correlation.materials) or "left out for this correlation"
        raise ValueError(f"Argument `material` must be one of {known}, but is {material!r}.")
    density = correlation.density if material is None else correlation.materials[material].density
    kind = CorrelatedBySize if name == "oka" else Correlated
    return kind(name, material, density)
