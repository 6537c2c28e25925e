"""Objectives of the search: the volume, and other integrals over the same cut.

An objective is a model with the motion of another model and another integrand. The engine
computes the integral and its derivatives as it computes any volume.
"""

import abc
from collections.abc import Callable, Mapping

import equinox as eqx
import jax.numpy as jnp

from erosion.array_types import Broadcast, ModelState
from erosion.models.base import CuttingModel, Events, Scales, Tip
from erosion.parameters.parameters import Parameters

_HAIR = 1e-8  # of the first speed into the depth


class SameMotion(CuttingModel):
    """A model's motion with another integrand, `removal_rate`."""

    motion: eqx.AbstractVar[CuttingModel]

    def initial_state(self, p: Parameters) -> ModelState:
        return self.motion.initial_state(p)

    def derivative(self, state: ModelState, p: Parameters) -> ModelState:
        return self.motion.derivative(state, p)

    def tip(self, state: ModelState, p: Parameters) -> Tip:
        return self.motion.tip(state, p)

    def events(self, state: ModelState, p: Parameters) -> Events:
        return self.motion.events(state, p)

    def scales(self, p: Parameters) -> Scales:
        return self.motion.scales(p)

    @property
    def needs_units(self) -> bool:
        return self.motion.needs_units

    @abc.abstractmethod
    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        """The integrand."""


class VolumePerMass(SameMotion):
    """V/m, the volume per mass of abrasive [volume/mass]."""

    motion: CuttingModel

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.motion.removal_rate(state, p) / p.m

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.motion.removed_at_contact(p) / p.m


class EndTime(SameMotion):
    """t_c = ∫ dt [s]."""

    motion: CuttingModel

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return jnp.ones_like(self.tip(state, p).depth)


class Depth(SameMotion):
    """The depth at which the tip first stops going deeper, ∫ d(depth) [length]."""

    motion: CuttingModel

    def events(self, state: ModelState, p: Parameters) -> Events:
        scales = self.scales(p)
        # A hair later than it is, so that rounding does not choose where the cut ends at this instant anyway: the depth
        # changes by the square of it.
        vdepth = self.tip(state, p).vdepth + _HAIR * self.tip(self.initial_state(p), p).vdepth
        return {**self.motion.events(state, p), "deepest": vdepth * scales.time / scales.length}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.tip(state, p).vdepth


Objective = Callable[[CuttingModel], CuttingModel]

OBJECTIVES: Mapping[str, Objective] = {
    "volume": lambda model: model,
    "volume per mass": VolumePerMass,
    "t_c": EndTime,
    "depth": Depth,
}
"""The objectives of `alpha_max` by name."""

MEASURES: Mapping[str, str] = {
    "volume": "volume",
    "volume per mass": "specific_volume",
    "t_c": "t_c",
    "depth": "max_depth",
}
"""The key of each objective in `erosion.parameters.quantities.RESULTS`."""
