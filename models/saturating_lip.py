"""A lip that stops growing: the contact height saturates with the depth of the tip.

Laverty takes the height of the contact, lip included, proportional to the tip's depth,
l = ψ y_tip. A lip does not grow for ever: material flows aside or breaks off. Here

    l = ψ L tanh(depth/L),   F_x = -σ b l,   F_y = k F_x,

which is the source's law for depths far below L and a constant force far above it.

Limits: L is not measured; it is given as a multiple of the distance r from the centre of mass to
the tip. L → ∞ gives the built-in `rotating` back.

References:
    Variant of Laverty (12), (14), whose l = ψ y_tip is its limit for shallow cuts.
"""

import jax.numpy as jnp

import erosion


class SaturatingLip(erosion.models.ForceLaw):
    """F_x = -σ b ψ L tanh(depth/L), F_y = k F_x, with L = `reach` · r."""

    reach: float = erosion.own_parameter(0.5, "L/r", "depth at which the lip stops growing, over r")

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        limit = self.reach * p.r
        horizontal = -p.stiffness * limit * jnp.tanh(tip.depth / limit)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        """k, as in the source."""
        return p.k


model = erosion.models.Rotating(force=SaturatingLip())
