"""A flow stress that grows with the rate of strain, after Cowper and Symonds.

Metals resist fast deformation more: σ_d = σ (1 + (ε̇/D)^(1/q)). The source's law with it is

    F_x = -σ_d b ψ · depth,   F_y = k F_x,   ε̇ = √(ẋ_tip² + ḋ²)/r,   d the tip's depth.

ε̇ is **defined** as the speed of the tip over r, the distance from the centre of mass to the tip and
so the size of the particle. Other lengths could be meant: over the contact height ψ · depth, as in
indentation, it would be infinite at first contact. Rates below a thousandth of v₀/r count as that,
which keeps derivatives finite where the tip stands still.

Limits: D → ∞ gives the built-in `rotating`, q → ∞ `rotating` at the flow stress 2σ. D = 6500/s and
q = 4 are usual for aluminium, 40.4/s and 5 for mild steel, both measured up to about 10³/s; at
v₀/r = 1.1·10⁵/s (Table 1) the law is extrapolated a hundredfold.

References:
    G. R. Cowper and P. S. Symonds, Brown University, Division of Applied Mathematics, report 28,
    1957; values of D and q as in N. Jones, *Structural Impact*, chapter 8. Laverty (12), (14).
"""

import jax.numpy as jnp

import erosion


class CowperSymonds(erosion.models.ForceLaw):
    """F_x = -σ (1 + (ε̇/D)^(1/q)) b ψ · depth, F_y = k F_x, with D = `rate` [1/s], q = `exponent`."""

    rate: float = erosion.own_parameter(6500.0, "D", "rate of strain that doubles the flow stress", "rate")
    exponent: float = erosion.own_parameter(4.0, "q", "exponent of the rate of strain")

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        horizontal = -p.stiffness * self._hardening(tip.vx**2 + tip.vdepth**2, p) * tip.depth
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        """F_y/(-c · depth) at contact: k times the hardening at the speed of impact."""
        return p.k * self._hardening(p.v0**2, p)

    def _hardening(self, square, p):
        strain_rate = jnp.sqrt(square + (1e-3 * p.v0) ** 2) / p.r
        return 1 + (strain_rate / self.rate) ** (1 / self.exponent)


model = erosion.models.Rotating(force=CowperSymonds())
