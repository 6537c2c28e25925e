"""From hits to impacts of a model: how the case's body follows the size of a row's particle, and its spin."""

import dataclasses
import math

import numpy as np

from erosion.cfd.impacts import ImpactsError
from erosion.correlations import CORRELATIONS
from erosion.distributions import Distribution
from erosion.maps.incidence import Hits
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated, CorrelatedBySize
from erosion.parameters.parameters import Parameters
from erosion.parameters.units import conversion_factor

SCALINGS = ("similar", "none")
SPINS = ("column", "case", "none")


@dataclasses.dataclass(frozen=True)
class Bodies:
    """The particles of a table as bodies of a case.

    Speed, angle and mass are always the row's. The other parameters follow from the case, which describes one
    particle: that of the case's mass, or of `diameter` where it is given.

    Args:
        p: the case, all scalars.
        scaling: "similar": a particle that is g times as large as the case's has g times its r and b. "none": all
            particles have the case's r and b.
        diameter: of the sphere in the CFD run that has the case's r and b [length]. Without it the case's particle
            is the one of the case's mass, so that g is the cube root of the ratio of masses.
        spin: "column", "case" (its φ̇₀), "none", or a law of φ̇₀; None takes the table's spin, and the case's where
            the table has none.
        seed: of the numbers drawn from a law.
    """

    p: Parameters
    scaling: str = "similar"
    diameter: float | None = None
    spin: str | Distribution | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.scaling not in SCALINGS:
            raise ValueError(f"Argument `scaling` must be one of {', '.join(SCALINGS)}, but is {self.scaling!r}.")
        if not (self.spin is None or isinstance(self.spin, Distribution) or self.spin in SPINS):
            known = ", ".join(SPINS)
            raise ValueError(f"Argument `spin` must be {known} or a law such as normal(0, 1e4), but is {self.spin!r}.")
        if self.diameter is not None and self.scaling == "none":
            raise ValueError("Argument `diameter` must be left out where all particles have the case's r and b.")

    def impacts(self, model: CuttingModel, hits: Hits, spin: np.ndarray) -> tuple[CuttingModel, Parameters]:
        """Model and case of rows that hit, and of their spins [rad/s]."""
        units = self.p.units
        mass = hits.mass * conversion_factor("mass", "si", units)
        growth = self._growth(mass, hits.diameter)
        p = dataclasses.replace(
            self.p,
            r=self.p.r * growth,
            b=self.p.b * growth,
            m=mass,
            v0=hits.speed * conversion_factor("speed", "si", units),
            alpha=hits.alpha,
            phidot0=spin,
        )
        if isinstance(model, CorrelatedBySize):
            # The table knows the size, for which the case alone has but a density to guess from.
            model = model.replace(erodent_density=6 * hits.mass / (math.pi * hits.diameter**3))
        return model, p

    def spins(self, hits: Hits, portion: int) -> np.ndarray:
        """φ̇₀ of all rows of a portion [rad/s]; numbers are drawn for rows that are left out as well.

        Raises:
            ImpactsError: where the column that is asked for is not there.
        """
        if isinstance(self.spin, Distribution):
            return self.spin.ppf(np.random.default_rng([self.seed, portion]).uniform(2.0**-53, 1.0, hits.rows))
        if self.spin == "none":
            return np.zeros(hits.rows)
        if self.spin == "case":
            return np.full(hits.rows, float(self.p.phidot0))
        if self.spin == "column" and np.isnan(hits.spin).any():
            raise ImpactsError("Argument `spin` must be a law, case or none, as the table has no column of it.")
        return np.where(np.isnan(hits.spin), float(self.p.phidot0), hits.spin)

    def _growth(self, mass: np.ndarray, diameter: np.ndarray) -> np.ndarray:
        """Size of each particle over that of the case's."""
        if self.scaling == "none":
            return np.ones_like(mass)
        if self.diameter is None:
            return np.cbrt(mass / float(self.p.m))
        return diameter * (conversion_factor("length", "si", self.p.units) / self.diameter)


def outside_range(model: CuttingModel, hits: Hits) -> np.ndarray:
    """Whether rows are outside the range of a correlation; False for other models."""
    outside = np.zeros(hits.rows, bool)
    if isinstance(model, Correlated):
        columns = {"alpha": hits.alpha, "v0": hits.speed, "diameter": hits.diameter}
        for name, span in CORRELATIONS[model.name].ranges.items():
            if name in columns:
                outside |= span.excludes(columns[name])
    return outside
