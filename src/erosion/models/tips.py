"""Where the tip of a rigid erodent is, given the body's motion."""

import abc

import equinox as eqx

from erosion.models.base import State, Tip
from erosion.models.trigonometry import UPRIGHT, orientation
from erosion.parameters.parameters import Parameters


class TipKinematics(eqx.Module):
    """Where the tip is, given the body's motion."""

    @abc.abstractmethod
    def __call__(self, state: State, p: Parameters) -> Tip:
        """The tip's position and velocity."""


class CentreOfMassTip(TipKinematics):
    """The tip moves as the centre of mass does: the body does not turn (Laverty (22)-(25))."""

    def __call__(self, state: State, p: Parameters) -> Tip:
        return Tip(state.x, state.y, state.vx, state.vy)


class CircularTip(TipKinematics):
    """The tip circles the centre of mass: x_tip = x - r cos φ, depth = y - r (1 - sin φ).

    Laverty (13) prints the depth as y - r sin φ, which is -r at first contact.
    """

    def __call__(self, state: State, p: Parameters) -> Tip:
        lifted, sine, cosine = orientation(state.phi)
        swing = p.r * state.omega
        return Tip(
            x=state.x - p.r * cosine,
            depth=state.y - p.r * lifted,
            vx=state.vx + swing * sine,
            vdepth=state.vy + swing * cosine,
        )


class SmallAngleTip(TipKinematics):
    """The tip to first order in the turn: x_tip = x + r (φ - π/2), depth = y (Finnie 1958)."""

    def __call__(self, state: State, p: Parameters) -> Tip:
        return Tip(state.x + p.r * (state.phi - UPRIGHT), state.y, state.vx + p.r * state.omega, state.vy)
