"""Coulomb friction under the tip: what presses the tip out of the target also brakes it.

The target pushes the tip back with F_x = -c · depth and up with F_y = -k c · depth (Laverty (12),
(14)). The surface under the tip, pressed on with N = |F_y|, resists its sliding with μN (Coulomb).
A cut ends as soon as the tip no longer slides forward, so that friction always points back:

    F_x = -c · depth (1 + μ k),   F_y = -k c · depth.

Limits: μ = 0 gives the built-in `rotating`. For any μ it is `rotating` at the flow stress
σ (1 + μ k) and the force ratio k/(1 + μ k): data of erosion alone cannot tell friction from these.
μ is that of dry sliding at ordinary speeds; at hundreds of m/s a melting film may lower it.

References:
    Laverty (12), (14), (16)-(21); C. A. Coulomb, *Théorie des machines simples*, 1785 (μN).
"""

import erosion


class CoulombTip(erosion.models.ForceLaw):
    """F_x = -c · depth (1 + μ k), F_y = -k c · depth, with μ = `friction`."""

    friction: float = erosion.own_parameter(0.2, "μ", "coefficient of friction")

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        ploughing = -p.stiffness * tip.depth
        lift = p.k * ploughing
        return ploughing + self.friction * lift, lift

    def typical_ratio(self, p):
        """k: F_y = -k c · depth."""
        return p.k


model = erosion.models.Rotating(force=CoulombTip())
