"""Equations (16)-(21) exactly as the scenario prints them, slips included."""

from erosion.array_types import Broadcast
from erosion.models.base import State, Tip
from erosion.models.forces import ForceLaw
from erosion.models.rigid import RigidErodent
from erosion.models.tips import CentreOfMassTip, TipKinematics
from erosion.models.torques import Torque
from erosion.models.trigonometry import sincos
from erosion.parameters.parameters import Parameters


class PrintedForce(ForceLaw):
    """F_x = -c (y - r sin φ), F_y = k F_x: it pushes the erodent *forward* at contact."""

    def __call__(self, state: State, tip: Tip, p: Parameters) -> tuple[Broadcast, Broadcast]:
        horizontal = -p.stiffness * (state.y - p.r * sincos(state.phi)[0])
        return horizontal, p.k * horizontal

    def typical_ratio(self, p: Parameters) -> Broadcast:
        return p.k


class PrintedTorque(Torque):
    """τ = -r c y, from the depth of the centre of mass (Laverty (20))."""

    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        return -p.r * p.stiffness * state.y


class AsPrinted(RigidErodent):
    """The literal reading of Laverty (16)-(21), to show what it does; not for use.

    Events and volume are on the centre of mass. With φ(0) = π/2 the force is that of a
    depth -r at first contact, so the erodent is first thrown forward and down, and the
    volume only falls with the angle.
    """

    kinematics: TipKinematics = CentreOfMassTip()
    force: ForceLaw = PrintedForce()
    torque: Torque = PrintedTorque()
