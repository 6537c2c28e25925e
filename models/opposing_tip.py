"""A force that opposes the motion of the tip, and is constant in magnitude at a given depth.

In the source F_x is c · depth whatever the direction of motion (Laverty (12)), and additional
question 3 lets F_y follow the motion, so that the whole force grows with the slope. Here it is the
force itself that has the magnitude c · depth, against the velocity of the tip that feels it:

    (F_x, F_y) = -c · depth · e,   e = (ẋ_tip, ḋ)/|(ẋ_tip, ḋ)|,   d the tip's depth,

and its full moment turns the body. k plays no part.

Limits: e is 0/0 where the tip comes to rest, as it does where nothing turns it. There, below a
thousandth of v₀, e turns smoothly into the direction at contact (`guard`). Straight motion stays
as it is. Of a turning body V changes by up to 5e-5, except beside a jump of V(α), where the tip
nearly comes to rest: that jump moves by up to two degrees. Without rotation
(`Linearized(force=OpposingTip())`) the cut is straight, stops at ωt = π/2 with ω² = (c/m) sin α,
and V = (V*/2) cos α exactly.

References:
    Variant of Laverty (12), (14) and (29); the closed form follows from m s̈ = -c s sin α.
"""

import jax.numpy as jnp

import erosion


class OpposingTip(erosion.models.ForceLaw):
    """A force of magnitude c · depth against the velocity of the tip; `guard` in units of v₀."""

    guard: float = 1e-3

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        sine, cosine = erosion.sincos(p.alpha)
        slow = (self.guard * p.v0) ** 2
        speed = jnp.sqrt(tip.vx**2 + tip.vdepth**2 + slow)
        along = tip.vx * speed + slow * cosine
        down = tip.vdepth * speed + slow * sine
        magnitude = p.stiffness * tip.depth / jnp.sqrt(along**2 + down**2)
        return -magnitude * along, -magnitude * down

    def typical_ratio(self, p):
        """F_y = -c · depth · sin α at contact: sin α."""
        return erosion.sincos(p.alpha)[0]


model = erosion.models.Rotating(force=OpposingTip(), torque=erosion.models.FullTorque())
