"""The erodent turns as it cuts (Laverty's additional question 1)."""

from erosion.models.forces import ConstantRatio, ForceLaw
from erosion.models.rigid import RigidErodent
from erosion.models.tips import CircularTip, TipKinematics
from erosion.models.torques import HorizontalTorque, Torque


class Rotating(RigidErodent):
    """The tip circles the centre of mass, and the contact force turns the body.

    m ẍ = -c d,  m ÿ = -K c d,  I φ̈ = τ,  d = y - r (1 - sin φ).

    Args:
        force: K, by default constant; `TanAlpha()` or `VelocityAligned()` for the additional
            questions 2 and 3, or any `ForceLaw`.
        torque: `HorizontalTorque()` (r F_x, the scenario's) or `FullTorque()`.

    References:
        Laverty (16)-(21). Differs from the source: the depth of the tip is y - r (1 - sin φ),
        not y - r sin φ; the torque uses that depth and has the sign of (20); the volume is
        cut by the tip's own path.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = HorizontalTorque()
    kinematics: TipKinematics = CircularTip()
