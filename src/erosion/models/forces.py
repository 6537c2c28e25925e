"""The force of the target on the tip."""

import abc

import equinox as eqx

from erosion.array_types import Broadcast
from erosion.models.base import State, Tip
from erosion.models.trigonometry import sincos
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
