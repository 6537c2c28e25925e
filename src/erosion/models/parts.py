"""The parts of a rigid particle: where its tip is, which force and torque act there, and what deformation removes.

Wear by deformation is what the normal motion of an impact removes, beside the cut:

    V_D = m (v₀ sin α - v_th)₊² / (2 ε)

The energy of the normal motion above the elastic threshold v_th goes into deforming the target, and
each ε of it removes a unit of volume. A cut at 90° removes nothing, but tests at 90° find about half of the
greatest erosion: that is this term.

References:
    J. G. A. Bitter, Wear 6 (1963) 5-21, 169-190; J. H. Neilson and A. Gilchrist, Wear 11 (1968) 111-122,
    equations (5) and (6). They add the term to Finnie's cut as it is done here.
"""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from erosion.arguments import Broadcast
from erosion.models.base import State, Tip, own_parameter
from erosion.parameters import Parameters

UPRIGHT = np.pi / 2  # φ at contact [rad]

# π/2 in three parts; the first two have 33 significant bits, so that their products with
# the number of quarter turns (below 2^20) are exact.
_PI_2_HIGH = float.fromhex("0x1.921fb544p+0")
_PI_2_MIDDLE = float.fromhex("0x1.0b4611a6p-34")
_PI_2_LOW = float.fromhex("0x1.3198a2e037073p-69")

# On [-π/4, π/4] the first omitted terms are below 5e-17 (sin) and 2e-18 (cos).
_SIN = [(-1) ** n / math.factorial(2 * n + 1) for n in range(8)]
_COS = [(-1) ** n / math.factorial(2 * n) for n in range(9)]

_Pair = tuple[Array, Array]


@jax.custom_jvp
@jax.jit
def sincos(angle: Broadcast) -> _Pair:
    """Sine and cosine of `angle` [rad] between -10⁶ and 10⁶, to within 2 ulp of 1.

    Differentiable to any order; traceable.
    """
    turns = jnp.round(angle * (2 / np.pi))
    rest = ((angle - turns * _PI_2_HIGH) - turns * _PI_2_MIDDLE) - turns * _PI_2_LOW
    square = rest * rest
    sine = rest * _polynomial(_SIN, square)
    cosine = _polynomial(_COS, square)
    quarter = turns - 4 * jnp.floor(turns / 4)
    odd = (quarter == 1) | (quarter == 3)
    sine, cosine = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(quarter >= 2, -sine, sine), jnp.where((quarter == 1) | (quarter == 2), -cosine, cosine)


@sincos.defjvp
def _sincos_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    (angle,), (rate,) = primals, tangents
    sine, cosine = sincos(angle)
    return (sine, cosine), (cosine * rate, -sine * rate)


def _polynomial(coefficients: list[float], x: Broadcast) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def orientation(phi: Broadcast) -> tuple[Array, Array, Array]:
    """1 - sin φ, sin φ and cos φ, from half the turn: the first keeps its digits near φ = π/2."""
    sine, cosine = sincos((phi - UPRIGHT) / 2)
    lifted = 2 * sine * sine
    return lifted, 1 - lifted, -2 * sine * cosine


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
    """Place of the tip as a function of the body's motion."""

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


class Deformation(eqx.Module):
    """The volume that an impact removes by deforming the target."""

    @abc.abstractmethod
    def removed_at_contact(self, p: Parameters) -> Broadcast:
        """V_D [m³]."""


class NoDeformation(Deformation):
    """The cut alone."""

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return 0.0


class EnergyOfNormalMotion(Deformation):
    """V_D = m (v₀ sin α - v_th)₊² / (2 ε), for a threshold v_th and any ε.

    It is NaN, and so the impact fails, unless ε > 0 and v_th ≥ 0.
    """

    threshold: eqx.AbstractVar[float]

    @abc.abstractmethod
    def energy(self, p: Parameters) -> Broadcast:
        """ε [Pa], the energy that removes a unit of volume."""

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        normal = p.v0 * sincos(p.alpha)[0]
        # Where the threshold is not reached the derivatives are zero as well.
        above = jnp.where(normal > self.threshold, normal - self.threshold, 0.0)
        energy = self.energy(p)
        allowed = (energy > 0) & (self.threshold >= 0)
        return jnp.where(allowed, p.m * above**2 / (2 * energy), jnp.nan)


class DeformationWear(EnergyOfNormalMotion):
    """V_D with numbers of the target: `DeformationWear(specific_energy=3e9, threshold=9.0)` in a case in SI.

    Args:
        specific_energy: ε, the deformation wear factor [Pa], > 0.
        threshold: v_th, the normal speed below which an impact is elastic [m/s], ≥ 0.
    """

    specific_energy: float = own_parameter(3e9, "ε", "deformation wear factor", "stress", least=0.0)
    threshold: float = own_parameter(0.0, "v_th", "normal speed that deforms nothing", "speed", least=0.0)

    def energy(self, p: Parameters) -> Broadcast:
        return self.specific_energy


class ProportionalDeformationWear(EnergyOfNormalMotion):
    """V_D with ε = e σψ, so that one number serves for every unit system, target and size.

    The cut scales on V* = m v₀²/(σψ) and so does this term: e alone says how much of the erosion at
    the best angle is left at 90°. With `linearized` the angle functions of DNV, E/CRC and Oka ask for 1.4 to 1.9
    (docs/models.md), with a body that turns for three times as much.

    Args:
        energy_ratio: e = ε/(σψ) [-], > 0.
        threshold: v_th [m/s], ≥ 0.
    """

    energy_ratio: float = own_parameter(1.6, "e", "deformation wear factor over σψ", least=0.0)
    threshold: float = own_parameter(0.0, "v_th", "normal speed that deforms nothing", "speed", least=0.0)

    def energy(self, p: Parameters) -> Broadcast:
        return self.energy_ratio * p.sigma * p.psi
