"""The rigid erodent and the models made of it: linearized, Finnie's, rotating, as printed by Laverty.

    m ẍ = F_x,   m ÿ = F_y,   I φ̈ = τ        (Laverty (2), (3), (11))

A new variant is one new part, a few lines long.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Broadcast
from erosion.models.base import ClosedForm, CuttingModel, Scales, State, Tip
from erosion.models.closed_forms import FinnieCut, LinearizedCut, StraightCut, with_deformation
from erosion.models.deformation import Deformation, NoDeformation
from erosion.models.forces import (
    CentreOfMassTip,
    CircularTip,
    ConstantRatio,
    ForceLaw,
    HorizontalTorque,
    NoTorque,
    SmallAngleTip,
    TanAlpha,
    TipKinematics,
    Torque,
    VelocityAligned,
)
from erosion.models.trigonometry import UPRIGHT, sincos
from erosion.parameters.parameters import Parameters


class RigidErodent(CuttingModel):
    """Newton's law for a rigid body driven by the force at its tip; parts are fields."""

    kinematics: eqx.AbstractVar[TipKinematics]
    force: eqx.AbstractVar[ForceLaw]
    torque: eqx.AbstractVar[Torque]
    deformation: Deformation = eqx.field(default=NoDeformation(), kw_only=True)

    def initial_state(self, p: Parameters) -> State:
        sine, cosine = sincos(p.alpha)
        zero = jnp.zeros_like(sine)
        # Laverty (17), (19), (21): upright at the origin.
        return State(zero, zero, zero + UPRIGHT, p.v0 * cosine, p.v0 * sine, zero + p.phidot0)

    def derivative(self, state: State, p: Parameters) -> State:
        force = self.force(state, self.kinematics(state, p), p)
        if not isinstance(force, tuple | list) or len(force) != 2:
            given = f"{len(force)} of them" if isinstance(force, tuple | list) else "something else"
            raise TypeError(f"{type(self.force).__name__} must give two numbers, (F_x, F_y), but gives {given}")
        for number in force:
            # Numbers of Python and of JAX without a type of their own take that of what they are computed with.
            kind = np.float64 if getattr(number, "weak_type", False) else getattr(number, "dtype", np.float64)
            if kind != np.float64:
                raise TypeError(f"{type(self.force).__name__} must give numbers of type float64, but gives {kind}")
        return State(
            x=state.vx,
            y=state.vy,
            phi=state.omega,
            vx=force[0] / p.m,
            vy=force[1] / p.m,
            omega=self.torque(state, force, p) / p.moment_of_inertia,
        )

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.deformation.removed_at_contact(p)

    @property
    def removes_at_contact(self) -> bool:
        return not isinstance(self.deformation, NoDeformation)

    def tip(self, state: State, p: Parameters) -> Tip:
        return self.kinematics(state, p)

    def scales(self, p: Parameters) -> Scales:
        time = jnp.sqrt(p.m / (self.force.typical_ratio(p) * p.stiffness))
        return Scales(time, p.v0 * sincos(p.alpha)[0] * time)


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
        if type(self.force) is ConstantRatio:  # a class of a user's that derives from it may add a drag
            return with_deformation(LinearizedCut(), self.deformation)
        if type(self.force) in (TanAlpha, VelocityAligned):
            return with_deformation(StraightCut(), self.deformation)
        return None


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
