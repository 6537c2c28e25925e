"""How cuts end over angle and spin, and the angle of greatest removal over the spin."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from erosion.parameters.parameters import Parameters
from erosion.plotting.curves import leaps
from erosion.plotting.families import BestAngles
from erosion.sweeps.grid import in_words
from erosion.sweeps.studies import regimes
from erosion.tables import Record

TORQUES = {"rotating": "torque r Fₓ", "rotating-full-torque": "torque of both components"}
"""The titles of the models of a body that turns, by name."""

_SPINS = np.round(np.linspace(-0.9, 0.9, 37), 3)  # s = r φ̇₀/v₀, in steps of 0.05
_TOLD = (-0.9, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 0.9)


@dataclass(frozen=True)
class Spins:
    """Results of a model over angle and spin; arrays have shape (spins,).

    Args:
        map: the dataset of `regimes`.
        s: r φ̇₀/v₀.
        alpha: of the greatest removal [rad], NaN where nothing is removed.
        volume: there.
        kind, ended_by: there, as in `Optimum`.
    """

    map: xr.Dataset
    s: np.ndarray
    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray
    ended_by: np.ndarray

    @property
    def rows(self) -> list[Record]:
        """The maxima at the spins that the page lists in a table."""
        columns = ("s", "alpha", "kind", "ended_by")
        maxima = zip(self.s, self.alpha, self.kind, self.ended_by, strict=True)
        return [dict(zip(columns, maximum, strict=True)) for maximum in maxima if maximum[0] in _TOLD]

    def at(self, i: int) -> Record:
        """The spin and the greatest volume of a row."""
        return {"s": float(self.s[i]), "volume": float(self.volume[i])}

    @property
    def jumps(self) -> int:
        """How many of the maxima are at a jump of V(α)."""
        return int(np.sum(self.kind == "jump"))

    @property
    def leaps(self) -> int:
        """At how many spins another maximum becomes the greatest."""
        return leaps(np.rad2deg(self.alpha)).size

    def best_angles(self, label: str) -> BestAngles:
        """For a figure."""
        return BestAngles(label, self.s, self.alpha, self.kind == "jump")

    def numbers(self) -> Record:
        """For numbers.json."""
        return {
            "s": self.s.tolist(),
            "alpha_max": self.alpha.tolist(),
            "volume_max": self.volume.tolist(),
            "kind": self.kind.tolist(),
            "ended_by": self.ended_by.tolist(),
        }


def over_spins(model: str, p: Parameters) -> Spins:
    """The case with all spins of the sweep instead of its own spin."""
    dataset = regimes(model, p, phidot0=_SPINS * float(p.v0 / p.r))
    return Spins(
        map=dataset,
        s=_SPINS,
        alpha=dataset.alpha_max.values,
        volume=dataset.volume_max.values,
        kind=in_words(dataset.alpha_max_kind),
        ended_by=in_words(dataset.alpha_max_ended_by),
    )
