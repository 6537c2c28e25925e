"""A rigid erodent, composed: where the tip is × what force acts there × what torque × what deforms.

    m ẍ = F_x,   m ÿ = F_y,   I φ̈ = τ        (Laverty (2), (3), (11))

A new variant is one new part, a few lines long.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.array_types import Broadcast
from erosion.models.base import CuttingModel, Scales, State, Tip
from erosion.models.deformation import Deformation, NoDeformation
from erosion.models.forces import ForceLaw
from erosion.models.tips import TipKinematics
from erosion.models.torques import Torque
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
