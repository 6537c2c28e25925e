"""From hits to impacts of a model: how the case's body follows the size of a row's particle, its spin, and laws."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import qmc

from erosion.cfd.incidence import Hits
from erosion.cfd.rows import ImpactsError
from erosion.correlations import CORRELATIONS
from erosion.correlations.ranges import masks_outside
from erosion.distributions import Distribution
from erosion.joint_laws import SHARE, LawSet, require_units
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated, CorrelatedBySize
from erosion.models.own_parameters import ranges, with_values
from erosion.parameters.parameters import Parameters
from erosion.parameters.units import conversion_factor

SCALINGS = ("similar", "none")
SPINS = ("column", "case", "none")
OF_ROWS = ("alpha", "v0", "m")
"""The parameters that each row has of its own."""
FRACTION = "cutting_fraction"
"""The share of the particles that cut, a factor of the volume; it may be uncertain as parameters of an impact may."""


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
        spin: "column", "case" (its φ̇₀), "none", or a law of φ̇₀ from impact to impact, which joins `laws`; None takes
            the table's spin, and the case's where the table has none.
        seed: of the numbers drawn from laws.
        laws: by parameter of the case or the model's own, its law from impact to impact.
        uncertain: by parameter, or "cutting_fraction", the law of one number for all impacts that is not known.
        draws: of the uncertain parameters.
        cutting_fraction: the share of the particles that cut.
    """

    p: Parameters
    scaling: str = "similar"
    diameter: float | None = None
    spin: str | Distribution | None = None
    seed: int = 0
    laws: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    uncertain: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    draws: int = 64
    cutting_fraction: float = 1.0

    def __post_init__(self) -> None:
        if self.scaling not in SCALINGS:
            raise ValueError(f"Argument `scaling` must be one of {', '.join(SCALINGS)}, but is {self.scaling!r}.")
        if not (self.spin is None or isinstance(self.spin, Distribution) or self.spin in SPINS):
            known = ", ".join(SPINS)
            raise ValueError(f"Argument `spin` must be {known} or a law such as normal(0, 1e4), but is {self.spin!r}.")
        if self.diameter is not None and self.scaling == "none":
            raise ValueError("Argument `diameter` must be left out where all particles have the case's r and b.")
        self._check_names()
        if isinstance(self.spin, Distribution):
            object.__setattr__(self, "laws", {**self.laws, "phidot0": self.spin})
            object.__setattr__(self, "spin", None)

    def _check_names(self) -> None:
        """Refuse laws of what has another value already."""
        if not isinstance(self.uncertain, Mapping):
            raise TypeError(f"Argument `uncertain` must be a mapping of parameters to laws, but is {self.uncertain!r}.")
        for name in OF_ROWS:
            if name in self.laws or name in self.uncertain:
                raise ValueError(f"Argument `{name}` must be left out: each row of the table has its own.")
        if self.spin is not None and ("phidot0" in self.laws or "phidot0" in self.uncertain):
            raise ValueError("Argument `spin` must be left out where `phidot0` has a law.")
        if both := [name for name in self.uncertain if name in self.laws]:
            raise ValueError(
                f"Argument `uncertain` must name parameters without another law, but {both[0]} has one from impact to "
                "impact."
            )
        if FRACTION in self.uncertain and self.cutting_fraction != 1:
            raise ValueError("Argument `cutting_fraction` must be left out where it is uncertain.")

    def check_laws(self, model: CuttingModel) -> None:
        """Know before anything is read that the laws make sense for the model.

        Raises:
            ValueError, TypeError: naming the first law that does not.
        """
        require_units({**self.laws, **self.uncertain}, self.p.units)
        varied, common = LawSet(self.laws, ranges(model)).middle, self.common(model)
        # So that an own parameter that cannot be an array is refused too.
        with_values(model, self.p, {name: value for name, value in (varied | common).items() if name != FRACTION})

    @property
    def seed_used(self) -> int | None:
        """The seed, where numbers are drawn."""
        return self.seed if self.laws or self.uncertain else None

    @property
    def realisations(self) -> int:
        """How many times the map is computed: once for each draw of uncertain parameters, 1 without these."""
        return self.draws if self.uncertain else 1

    def common(self, model: CuttingModel) -> dict[str, np.ndarray]:
        """The uncertain parameters, the same for all rows; each of shape (draws, 1).

        Raises:
            ValueError, TypeError: for laws that make no sense.
        """
        laws = LawSet(self.uncertain, {**ranges(model), FRACTION: SHARE})
        if not laws.dimension:
            return {}
        sampler = qmc.Sobol(laws.dimension, rng=np.random.default_rng([self.seed, 0, 1]))
        # A power of 2 is drawn, of which scrambled points are even; 0 and 1 do not come out.
        points = sampler.random_base2(math.ceil(math.log2(self.draws)))[: self.draws] + 2.0**-31
        return {name: value[:, None] for name, value in laws.draw(points).items()}

    def of_rows(self, model: CuttingModel, hits: Hits, portion: int) -> dict[str, np.ndarray]:
        """What laws and spins give each row of a portion, of shape (rows,); rows that are left out get numbers as well.

        Raises:
            ImpactsError: where the column of the spin is asked for but not there.
            ValueError, TypeError: for laws that make no sense.
        """
        laws = LawSet(self.laws, ranges(model))
        points = np.random.default_rng([self.seed, portion]).uniform(2.0**-53, 1.0, (hits.rows, laws.dimension))
        values = laws.draw(points)
        return values if "phidot0" in {**self.laws, **self.uncertain} else {**values, "phidot0": self._spins(hits)}

    def impacts(
        self, model: CuttingModel, hits: Hits, values: Mapping[str, np.ndarray]
    ) -> tuple[CuttingModel, Parameters]:
        """Model and case of rows that hit.

        Args:
            model: with its own parameters.
            hits: the rows.
            values: by parameter, φ̇₀ among them, what takes the place of the case's value: from `of_rows` for these
                rows, and from `common`.
        """
        units = self.p.units
        model, p = with_values(model, self.p, {name: value for name, value in values.items() if name != FRACTION})
        mass = hits.mass * conversion_factor("mass", "si", units)
        p = dataclasses.replace(
            p.similar(self._growth(mass, hits.diameter)),
            m=mass,
            v0=hits.speed * conversion_factor("speed", "si", units),
            alpha=hits.alpha,
        )
        if isinstance(model, CorrelatedBySize):
            # The table knows the size, for which the case alone has but a density to guess from.
            model = model.replace(particle_density=6 * hits.mass / (math.pi * hits.diameter**3))
        return model, p

    def _spins(self, hits: Hits) -> np.ndarray:
        """φ̇₀ of all rows of a portion without a law [rad/s]."""
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
    if not isinstance(model, Correlated):
        return np.zeros(hits.rows, bool)
    columns = {"alpha": hits.alpha, "v0": hits.speed, "diameter": hits.diameter}
    return np.any([*masks_outside(CORRELATIONS[model.name].ranges, columns).values()], axis=0)
