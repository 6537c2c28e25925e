"""A rounded tip, like that of a spherical indenter: the contact gets wider as it gets deeper.

A tip of radius R at depth d has a contact 2√(2Rd) wide (to first order in d/R), so that its groove
has the cross-section A(d) = (4/3)√(2R) d^(3/2). It takes the place of b · depth in force and volume:

    F_x = -σ ψ A(d),   F_y = k F_x,   dV/dt = A(d) ẋ_tip.

Any A is allowed: A = b d, a tip of constant width, is the source's law. b plays no part here.

Limits: meant for d < R. At depths below a hundredth of R, A is rounded off, A ∝ d², so that the
second derivatives of V exist. Without rotation V does not depend on A at all: with σψ A = -F_x it
is V = (m/2σψ)(ẋ(0)² - ẋ(t_c)²), and a rebound reverses ẏ whatever A. So R matters only to a body
that turns, and V of `linearized` is the exact one of this tip too.

References:
    Width of the contact: D. Tabor, *The Hardness of Metals*, 1951 (Brinell's indenter); force and
    volume: Laverty (12), (14), (27) with A(d) for b · y.
"""

import jax.numpy as jnp

import erosion


class RoundedTip(erosion.models.ForceLaw):
    """F_x = -σ ψ A(depth), F_y = k F_x, with the tip's radius R = `radius` · r."""

    radius: float = erosion.own_parameter(0.5, "R/r", "radius of the tip over r")

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        horizontal = -p.sigma * p.psi * self._section(tip.depth, p)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        """F_y/(-c · depth) at a depth of R/4."""
        depth = self.radius * p.r / 4
        return p.k * self._section(depth, p) / (p.b * depth)

    def _section(self, depth, p):
        """A(d), the cross-section of the groove: (4/3)√(2R) d² (d² + δ²)^(-1/4) with δ = R/100."""
        radius = self.radius * p.r
        return 4 / 3 * jnp.sqrt(2 * radius) * depth**2 / (depth**2 + (radius / 100) ** 2) ** 0.25


class RoundedParticle(erosion.models.RigidParticle):
    """A body that turns as `Rotating` does, and cuts with its rounded tip."""

    force: erosion.models.ForceLaw = RoundedTip()
    kinematics: erosion.models.TipKinematics = erosion.models.CircularTip()
    torque: erosion.models.Torque = erosion.models.HorizontalTorque()

    def removal_rate(self, state, p):
        """dV/dt = A(d) ẋ_tip, with A = -F_x/(σψ)."""
        tip = self.tip(state, p)
        return -self.force(state, tip, p)[0] / (p.sigma * p.psi) * tip.vx


model = RoundedParticle()
