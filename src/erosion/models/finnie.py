"""Finnie's own model of 1958: the turn counts to first order."""

from erosion.models.base import ClosedForm
from erosion.models.closed_forms import FinnieCut, with_deformation
from erosion.models.forces import ConstantRatio, ForceLaw
from erosion.models.rigid import RigidErodent
from erosion.models.tips import SmallAngleTip, TipKinematics
from erosion.models.torques import HorizontalTorque, Torque


class Finnie(RigidErodent):
    """The tip is at x + r (φ - π/2) and depth y; I φ̈ = r F_x slows it as it cuts.

    Args:
        force: K, by default constant.

    References:
        Finnie 1958; OpenFOAM's `ParticleErosion` is its closed form with β = ½.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = HorizontalTorque()
    kinematics: TipKinematics = SmallAngleTip()

    def closed_form(self) -> ClosedForm | None:
        parts = (self.force, self.torque, self.kinematics)
        known = parts == (ConstantRatio(), HorizontalTorque(), SmallAngleTip())
        return with_deformation(FinnieCut(), self.deformation) if known else None
