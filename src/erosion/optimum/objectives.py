"""What may be greatest or least over the angle: other scalars of the same cut.

An objective is a model that moves as another does but integrates something else, so that
the engine gives it, its derivatives and its end like any volume.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from erosion.models.base import CuttingModel, Scales, Tip
from erosion.parameters.parameters import Parameters


class SameMotion(CuttingModel):
    """A model's motion with another integrand, `removal_rate`."""

    motion: eqx.AbstractVar[CuttingModel]

    def initial_state(self, p: Parameters) -> Any:
        return self.motion.initial_state(p)

    def derivative(self, state: Any, p: Parameters) -> Any:
        return self.motion.derivative(state, p)

    def tip(self, state: Any, p: Parameters) -> Tip:
        return self.motion.tip(state, p)

    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        return self.motion.events(state, p)

    def scales(self, p: Parameters) -> Scales:
        return self.motion.scales(p)

    @abc.abstractmethod
    def removal_rate(self, state: Any, p: Parameters) -> Any:
        """The integrand."""


class VolumePerMass(SameMotion):
    """V/m: removal per mass of abrasive."""

    motion: CuttingModel

    def removal_rate(self, state: Any, p: Parameters) -> Any:
        return self.motion.removal_rate(state, p) / p.m


class EndTime(SameMotion):
    """t_c = ∫ dt."""

    motion: CuttingModel

    def removal_rate(self, state: Any, p: Parameters) -> Any:
        return jnp.ones_like(self.tip(state, p).depth)


class Depth(SameMotion):
    """The depth at which the tip first stops going deeper, ∫ d(depth)."""

    motion: CuttingModel

    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        scales = self.scales(p)
        return {**self.motion.events(state, p), "deepest": self.tip(state, p).vdepth * scales.time / scales.length}

    def removal_rate(self, state: Any, p: Parameters) -> Any:
        return self.tip(state, p).vdepth


Objective = Callable[[CuttingModel], CuttingModel]

OBJECTIVES: Mapping[str, Objective] = {
    "volume": lambda model: model,
    "volume per mass": VolumePerMass,
    "t_c": EndTime,
    "depth": Depth,
}
"""What `alpha_max` can be asked about, by name."""

MEASURES: Mapping[str, str] = {
    "volume": "volume",
    "volume per mass": "specific_volume",
    "t_c": "t_c",
    "depth": "max_depth",
}
"""Which of `erosion.parameters.quantities.RESULTS` each of them is."""
