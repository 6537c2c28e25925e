"""A correlation as a model: compared, swept and streamed like a model of the cut."""

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable, Mapping

import equinox as eqx
import numpy as np

from erosion.arguments import Broadcast, Number, Scalar
from erosion.correlations import CORRELATIONS, FINNIE_MATERIALS
from erosion.correlations.ranges import SHARPNESS, OutOfRangeWarning, share_outside
from erosion.correlations.registry import SHAPES
from erosion.models.base import CuttingModel, Tip, fixed_parameter, own_parameter
from erosion.output import briefly
from erosion.parameters import (
    ANOTHER_METAL,
    Parameters,
    Particle,
    PerMass,
    Target,
    particle as read_particle,
    target as read_target,
)
from erosion.results import Finding


class Correlated(CuttingModel):
    """The volume of an impact is E(α, v₀) m/ρ, with a correlation's E and the target's density ρ.

    A correlation knows no motion: all of the volume is removed at contact, and the impact ends as "no-cut" at t_c = 0.
    `run`, `compare`, `sweep` and `stream` say how many of their impacts are outside of the correlation's range.

    Args:
        name: in `erosion.CORRELATIONS`.
        material: a target in the table of the correlation; its default without one.
        density: ρ of the target [kg/m³].
    """

    name: str = eqx.field(static=True)
    material: str | None = eqx.field(static=True, default=None)
    density: float = fixed_parameter(7800.0, "ρ", "density of the target", "kg/m^3")

    @property
    def label(self) -> str:
        """The name that `load_model` knows it by: "dnv", "dnv:duplex"."""
        return self.name if self.material is None else f"{self.name}:{self.material}"

    @property
    def formula(self) -> str:
        """E with its constants and its source, in words; density and others of `own_parameters` are not in it."""
        known = CORRELATIONS[self.name]
        return f"{known.in_words(self.material)}; {known.source}"

    def _factors(self, p: Parameters) -> dict[str, object]:
        """The correlation's further arguments."""
        return {} if self.material is None else {"material": self.material}

    def removed_at_contact(self, p: Parameters) -> Scalar:
        with warnings.catch_warnings():
            # Verbs warn once, with the share of their impacts: `outside_of_range`.
            warnings.simplefilter("ignore", OutOfRangeWarning)
            ratio = CORRELATIONS[self.name].erosion(p.alpha, p.v0, **self._factors(p))
        return ratio * p.m / self._density_of_ratio

    @property
    def _density_of_ratio(self) -> Number:
        """By which the ratio of masses becomes a volume [kg/m³]."""
        return self.density

    def outside_of_range(self, p: Parameters, counted: np.ndarray | None = None) -> Finding | None:
        values = {name: np.asarray(value) for name, value in self._checked(p).items()}
        return share_outside(self.label, CORRELATIONS[self.name].ranges, values, counted)

    def _checked(self, p: Parameters) -> dict[str, Broadcast]:
        """What may lie outside of a range."""
        return {"alpha": p.alpha, "v0": p.v0}

    # Depth and velocity of 0 are what the events take for "no-cut".
    def initial_state(self, p: Parameters) -> Scalar:
        return p.alpha * 0.0

    def derivative(self, state: Scalar, p: Parameters) -> Scalar:
        return state * 0.0

    def tip(self, state: Scalar, p: Parameters) -> Tip:
        return Tip(state, state, state, state)


class CorrelatedBySize(Correlated):
    """The same for a correlation that depends on the size of the particle, a sphere of the mass of the case.

    Args:
        particle_density: of the particle [kg/m³]; 2650 is quartz.
    """

    particle_density: float = fixed_parameter(2650.0, "ρ_p", "density of the particle", "kg/m^3")

    def _factors(self, p: Parameters) -> dict[str, object]:
        return {**super()._factors(p), "diameter": self._diameter(p)}

    def _checked(self, p: Parameters) -> dict[str, Broadcast]:
        return {**super()._checked(p), "diameter": self._diameter(p)}

    def _diameter(self, p: Parameters) -> Broadcast:
        volume = p.m / self.particle_density
        return (6 * volume / math.pi) ** (1 / 3)


class CorrelatedByFlowStress(Correlated):
    """The same for Finnie's form, whose volume is proportional to 1/p, whatever the density of the target.

    Args:
        flow_stress: p of the target at ψ = 2, its hardness [Pa].
    """

    flow_stress: float = fixed_parameter(FINNIE_MATERIALS["steel"].flow_stress, "p", "flow stress of the target", "Pa")

    @property
    def _density_of_ratio(self) -> Number:
        steel = FINNIE_MATERIALS["steel"]
        return steel.density * self.flow_stress / steel.flow_stress


class CorrelatedByShape(Correlated):
    """The same for a correlation with a factor of the shape of the grains.

    Args:
        sharpness: F_s [-], a number of `SHARPNESS` or another.
        is_set: whether `replace` has set it, so that the shape of a named particle does not.
    """

    sharpness: float = own_parameter(
        SHARPNESS["semi-rounded"], "F_s", "shape of the grains: 1 angular, 0.53 semi-rounded, 0.2 round", least=0.0
    )
    is_set: bool = eqx.field(static=True, default=False)

    @property
    def grains(self) -> str:
        """What the factor stands for: "angular grains"."""
        words = {SHARPNESS[sharpness]: shape for shape, sharpness in SHAPES.items()}
        factor = float(self.sharpness)
        return f"{words[factor]} grains" if factor in words else f"F_s = {factor:g}"

    def replace(self, **changes: object) -> CuttingModel:
        changed = super().replace(**changes)
        return dataclasses.replace(changed, is_set=self.is_set or "sharpness" in changes)  # pyrefly: ignore

    def _factors(self, p: Parameters) -> dict[str, object]:
        return {**super()._factors(p), "sharpness": self.sharpness}


def per_mass_of(model: CuttingModel, per_mass: PerMass) -> PerMass:
    """How a model's volume becomes erosion per mass: a correlation has a density and all particles in it already.

    Raises:
        ValueError: for the density of another metal than the correlation's.
    """
    if not isinstance(model, Correlated):
        return per_mass
    own = float(model.density)
    if per_mass.density is not None and not 1 / ANOTHER_METAL <= per_mass.density / own <= ANOTHER_METAL:
        raise ValueError(
            f"Argument `density` must be that of the target of {model.label}, {own:g} kg/m³, but is "
            f"{per_mass.density:g} kg/m³: leave it out, or choose a correlation for that target."
        )
    return PerMass(own)


def made_for(
    model: CuttingModel, target: str | Target | None = None, particle: str | Particle | None = None
) -> CuttingModel:
    """A model for a target and a particle that have names: of a correlation the member of its family made for them.

        made_for(erosion.load_model("dnv"), "aluminium 6061")  # dnv:aluminium

    Finnie's form takes the constants of any target. A correlation that depends on the size of the particle takes the
    density of the particle, one with a factor of the shape of the grains that of its shape, unless
    `model.replace(sharpness=…)` has set it. Other models stay as they are: target and particle are in the case.

    Args:
        model: any model.
        target: a name or a `Target`; None leaves the correlation's own.
        particle: a name with a size or a `Particle`; None leaves quartz, and the correlation's usual shape.

    Raises:
        ValueError: where the family has no constants for this target, or the model names another of its targets.
    """
    if not isinstance(model, Correlated):
        return model
    made = model if target is None else _of_target(model, read_target(target))
    if isinstance(model, CorrelatedByShape) and model.is_set:
        return made.replace(sharpness=model.sharpness)
    grit = None if particle is None else read_particle(particle)
    if grit is not None and isinstance(made, CorrelatedBySize):
        made = made.replace(particle_density=grit.density)
    if grit is not None and isinstance(made, CorrelatedByShape) and grit.shape in SHAPES:
        made = dataclasses.replace(made, sharpness=SHARPNESS[SHAPES[grit.shape]])
    return made


def members(name: str, target: Target) -> list[str]:
    """The correlations of a family that tests of this target stand behind, the usual one first: ["dnv:aluminium"].

    Raises:
        ValueError: for a target of a table of one's own that names what is no correlation.
    """
    # The two editions of a standard have one table of targets.
    table, found = CORRELATIONS[name].materials, list[str]()
    for listed in target.correlations:
        family, _, material = listed.partition(":")
        if family not in CORRELATIONS or (material and material not in CORRELATIONS[family].materials):
            raise ValueError(
                f"Target {target}: field `correlations` must name correlations, but has {briefly(listed)}."
            )
        if family == name or (table and CORRELATIONS[family].materials is table):
            found.append(f"{name}:{material}" if material else name)
    return found


def _of_target(model: Correlated, target: Target) -> Correlated:
    if isinstance(model, CorrelatedByFlowStress) and model.material is None:
        if target.density is None:
            raise ValueError(f"Model {model.label!r}: needs the density of {target}, which its table must have.")
        return CorrelatedByFlowStress(model.name, None, target.density, target.hardness)
    fitting = members(model.name, target)
    if model.label in fitting:
        return model
    if model.material is None and fitting:
        return correlated(model.name, fitting[0].partition(":")[2])
    table = CORRELATIONS[model.name].materials
    if fitting:
        known = f"of it, {', '.join(fitting)} is made for that"
    else:
        known = f"it has {', '.join(table)}" if table else f"it is made for {CORRELATIONS[model.name].valid_for}"
    raise ValueError(
        f"Model {model.label!r}: is not made for the target {target}; {known}. Leave one out, the target or the model."
    )


def correlated(name: str, material: str | None = None) -> Correlated:
    """A correlation as a model.

        erosion.compare(["rotating", erosion.models.correlated("dnv", "duplex")], p)

    `erosion.load_model("dnv:duplex")` gives the same; every verb takes that name.

    Args:
        name: in `erosion.CORRELATIONS`.
        material: a target in the table of the correlation; its default without one.

    Returns:
        A model with the own parameter `density`, `particle_density` where the size counts, `sharpness` where the
        shape does, and `flow_stress` where that is a constant of the correlation.

    Raises:
        ValueError: for an unknown correlation or material.
    """
    if name not in CORRELATIONS:
        raise ValueError(f"Argument `name` must be one of {', '.join(CORRELATIONS)}, but is {briefly(name)}.")
    correlation = CORRELATIONS[name]
    if material is not None and material not in correlation.materials:
        known = ", ".join(correlation.materials) or "left out for this correlation"
        raise ValueError(f"Argument `material` must be one of {known}, but is {briefly(material)}.")
    density = correlation.density if material is None else correlation.materials[material].density
    return _KINDS.get(name, Correlated)(name, material, density)


_KINDS: Mapping[str, Callable[..., Correlated]] = {
    "oka": CorrelatedBySize,
    "finnie-cfd": CorrelatedByFlowStress,
    "ecrc": CorrelatedByShape,
    "mclaury": CorrelatedByShape,
    "arabnejad": functools.partial(CorrelatedByShape, sharpness=SHARPNESS["sharp"]),
}
