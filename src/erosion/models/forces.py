"""The parts of a rigid erodent: the force on its tip, the torque that turns it, and where the tip is."""

import abc

import equinox as eqx
import jax.numpy as jnp

from erosion.arguments import Broadcast
from erosion.models.base import State, Tip
from erosion.models.trigonometry import UPRIGHT, orientation, sincos
from erosion.parameters.parameters import Parameters


class ForceLaw(eqx.Module):
    """The contact force on the tip."""

    @abc.abstractmethod
    def __call__(self, state: State, tip: Tip, p: Parameters) -> tuple[Broadcast, Broadcast]:
        """(F_x, F_y) [force]; both oppose the cut, so they are negative at first."""

    @abc.abstractmethod
    def typical_ratio(self, p: Parameters) -> Broadcast:
        """K of F_y ≈ -K c · depth, at contact or nearly so, > 0; it sets the time scale √(m/(K c))."""


class ForceRatio(ForceLaw):
    """Perfectly plastic contact: F_x = -c · depth (Laverty (12)) and F_y = K F_x."""

    def __call__(self, state: State, tip: Tip, p: Parameters) -> tuple[Broadcast, Broadcast]:
        horizontal = -p.stiffness * tip.depth
        return horizontal, self.ratio(state, p) * horizontal

    @abc.abstractmethod
    def ratio(self, state: State, p: Parameters) -> Broadcast:
        """K = F_y/F_x [-]."""


class ConstantRatio(ForceRatio):
    """K = k (Laverty (14))."""

    def ratio(self, state: State, p: Parameters) -> Broadcast:
        return p.k

    def typical_ratio(self, p: Parameters) -> Broadcast:
        return p.k


class TanAlpha(ForceRatio):
    """K = tan α: the force opposes the velocity of impact (additional question 2)."""

    def ratio(self, state: State, p: Parameters) -> Broadcast:
        return _tan(p.alpha)

    def typical_ratio(self, p: Parameters) -> Broadcast:
        return _tan(p.alpha)


class VelocityAligned(ForceRatio):
    """K = ẏ/ẋ of the centre of mass: the force opposes its velocity (Laverty (29)).

    The force then never turns the velocity, d(ẏ/ẋ)/dt = 0, so that K = tan α throughout;
    but the quotient is 0/0 where the cut ends, both velocities vanishing together. The guard
    adds to numerator and denominator a little of their values at contact. On the solution
    that leaves the quotient as it is, and off it rounding is damped, not amplified.
    """

    def ratio(self, state: State, p: Parameters) -> Broadcast:
        sine, cosine = sincos(p.alpha)
        guard = (0.1 * p.v0) ** 2
        return (state.vx * state.vy + guard * sine * cosine) / (state.vx**2 + guard * cosine**2)

    def typical_ratio(self, p: Parameters) -> Broadcast:
        return _tan(p.alpha)


def _tan(angle: Broadcast) -> Broadcast:
    sine, cosine = sincos(angle)
    return sine / cosine


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
