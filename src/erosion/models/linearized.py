"""The erodent does not turn: the system that questions 1 to 8 are asked of."""

from erosion.models.base import ClosedForm
from erosion.models.closed_forms import LinearizedCut, StraightCut, with_deformation
from erosion.models.forces import ConstantRatio, ForceLaw, TanAlpha, VelocityAligned
from erosion.models.rigid import RigidErodent
from erosion.models.tips import CentreOfMassTip, TipKinematics
from erosion.models.torques import NoTorque, Torque


class Linearized(RigidErodent):
    """The tip moves as the centre of mass: m ẍ = -c y, m ÿ = -K c y.

    Args:
        force: K, by default constant; `TanAlpha()` or `VelocityAligned()` for the additional
            questions 2 and 3, or any `ForceLaw`.

    References:
        Laverty (22)-(25). Differs from the source in the reason only: what stays small is
        φ - π/2, not φ.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = NoTorque()
    kinematics: TipKinematics = CentreOfMassTip()

    def closed_form(self) -> ClosedForm | None:
        if self.torque != NoTorque() or self.kinematics != CentreOfMassTip():
            return None
        if isinstance(self.force, ConstantRatio):
            return with_deformation(LinearizedCut(), self.deformation)
        if isinstance(self.force, (TanAlpha, VelocityAligned)):
            return with_deformation(StraightCut(), self.deformation)
        return None
