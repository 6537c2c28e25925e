"""Wear by deformation: what the normal motion of an impact removes, beside the cut.

    V_D = m (v₀ sin α - v_th)₊² / (2 ε)

The energy of the normal motion above the elastic threshold v_th goes into deforming the target, and
each ε of it removes a unit of volume. A cut at 90° removes nothing, but tests at 90° find about half of the
greatest erosion: that is this term.

References:
    J. G. A. Bitter, Wear 6 (1963) 5-21, 169-190; J. H. Neilson and A. Gilchrist, Wear 11 (1968) 111-122,
    equations (5) and (6). They add the term to Finnie's cut as it is done here.
"""

import abc

import equinox as eqx
import jax.numpy as jnp

from erosion.arguments import Broadcast
from erosion.models.own_parameters import own_parameter
from erosion.models.trigonometry import sincos
from erosion.parameters.parameters import Parameters


class Deformation(eqx.Module):
    """The volume that an impact removes by deforming the target."""

    @abc.abstractmethod
    def removed_at_contact(self, p: Parameters) -> Broadcast:
        """V_D [volume]."""


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
        """ε [stress], the energy that removes a unit of volume."""

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
        specific_energy: ε, the deformation wear factor [stress], > 0, in the units of the case.
        threshold: v_th, the normal speed below which an impact is elastic [speed], ≥ 0, in the units of the case.
    """

    specific_energy: float = own_parameter(3e9, "ε", "deformation wear factor", "stress", least=0.0)
    threshold: float = own_parameter(0.0, "v_th", "normal speed that deforms nothing", "speed", least=0.0)

    def energy(self, p: Parameters) -> Broadcast:
        return self.specific_energy


class ProportionalDeformationWear(EnergyOfNormalMotion):
    """V_D with ε = e σψ, so that one number serves for every unit system, target and size.

    The cut scales on V* = m v₀²/(σψ) and so does this term: e alone says how much of the erosion at
    the best angle is left at 90°. With `linearized` the angle functions of DNV, E/CRC and Oka ask for 1.4 to 1.9
    (docs/models/deformation.md), with a body that turns for three times as much.

    Args:
        energy_ratio: e = ε/(σψ) [-], > 0.
        threshold: v_th [speed], ≥ 0, in the units of the case.
    """

    energy_ratio: float = own_parameter(1.6, "e", "deformation wear factor over σψ", least=0.0)
    threshold: float = own_parameter(0.0, "v_th", "normal speed that deforms nothing", "speed", least=0.0)

    def energy(self, p: Parameters) -> Broadcast:
        return self.energy_ratio * p.sigma * p.psi
