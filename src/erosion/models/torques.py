"""What turns a rigid erodent: the moment of the force on its tip about the centre of mass."""

import abc

import equinox as eqx
import jax.numpy as jnp

from erosion.array_types import Broadcast
from erosion.models.base import State
from erosion.models.trigonometry import orientation
from erosion.parameters.parameters import Parameters


class Torque(eqx.Module):
    """The contact force's moment about the centre of mass."""

    @abc.abstractmethod
    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        """τ [force × length], positive counter-clockwise."""


class NoTorque(Torque):
    """The body keeps its spin."""

    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        return jnp.zeros_like(force[0])


class HorizontalTorque(Torque):
    """τ = r F_x: the tip stays below the centre of mass *on average* (Laverty (20)).

    Laverty (20) takes the force from the depth of the centre of mass; here torque and force
    come from the depth of the tip. (15) has the opposite sign, against its own Figure 5.
    """

    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        return p.r * force[0]


class FullTorque(Torque):
    """τ = r sin φ F_x + r cos φ F_y: the moment of both components at the tip."""

    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        _, sine, cosine = orientation(state.phi)
        return p.r * (sine * force[0] + cosine * force[1])
