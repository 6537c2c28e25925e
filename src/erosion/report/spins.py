"""Angles of greatest removal over the spin, for both torques."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from erosion.optimum import Optimum, alpha_max
from erosion.parameters import Parameters
from erosion.plotting.families import BestAngles

TORQUES = {"rotating": "torque r Fₓ", "rotating-full-torque": "torque of both components"}
"""What the models of a body that turns are called, by their names."""

_SPINS = np.round(np.linspace(-0.9, 0.9, 37), 3)  # s = r φ̇₀/v₀, in steps of 0.05
_TOLD = (-0.9, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 0.9)


@dataclass(frozen=True)
class Spins:
    """Optima of a model over s = r φ̇₀/v₀; arrays have shape (spins,)."""

    s: np.ndarray
    optimum: Optimum

    @property
    def told(self) -> np.ndarray:
        """Which of them the page tells in a table."""
        return np.flatnonzero(np.isin(self.s, _TOLD))

    @property
    def jumps(self) -> int:
        """How many of the maxima sit at a jump of V(α)."""
        return int(np.sum(self.optimum.kind == "jump"))

    def best_angles(self, label: str) -> BestAngles:
        """For a figure."""
        return BestAngles(label, self.s, self.optimum.alpha, self.optimum.kind == "jump")

    def numbers(self) -> dict[str, Any]:
        """For numbers.json."""
        found = self.optimum
        return {
            "s": [float(s) for s in self.s],
            "alpha_max": [float(alpha) for alpha in found.alpha],
            "volume_max": [float(volume) for volume in found.volume],
            "kind": [str(kind) for kind in found.kind],
            "side": [str(side) for side in found.side],
            "attained": [bool(attained) for attained in found.attained],
            "ended_by": [str(end) for end in found.ended_by],
        }


def over_spins(model: str, p: Parameters) -> Spins:
    """The case with every spin of the sweep instead of its own."""
    return Spins(_SPINS, alpha_max(model, p.replace(phidot0=_SPINS * float(p.v0 / p.r))))
