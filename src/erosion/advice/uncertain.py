"""What is not known exactly in an advice: laws of k, ψ and others, of a fit or a posterior for example."""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from erosion.calibration.forward import FACTORS, FRACTION
from erosion.joint_laws import SHARE, LawSet, Member, Rows, require_units
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated
from erosion.models.own_parameters import own_parameters, quantities, ranges, with_values
from erosion.parameters.parameters import Parameters
from erosion.parameters.scales import table_scale
from erosion.parameters.units import System
from erosion.streams.replicates import Points
from erosion.tables import format_number

DRAWS = 64
_OF_METAL = ("k", "psi", "sigma", "phidot0", "inertia", FRACTION)  # the particle and the jet are given


@dataclasses.dataclass(frozen=True)
class Uncertain:
    """Laws of what is one number for all particles, but not known.

    Args:
        laws: `Distribution` by parameter: of the metal's, of a model's own, or "cutting_fraction"; those of a joint law
            (`Posterior.rows_of_draws`) all together.
        source: words for where they come from; without it they are made from the laws.
        values: the median of each parameter, and where 95 % of its law lies: "k = 1.29 (1.03 … 1.61)".
    """

    laws: Mapping[str, Any]
    source: str = ""
    values: tuple[str, ...] = ()

    def __str__(self) -> str:
        joints = [law.joint for law in self.laws.values() if isinstance(law, Member)]
        tables = dict.fromkeys(joint.source for joint in joints if isinstance(joint, Rows))
        return self.source or ", ".join(tables) or f"the laws of {', '.join(self.laws)}"

    def checked(self, models: Mapping[str, CuttingModel], units: System) -> "Uncertain":
        """The same with `values`, in units for tables.

        Raises:
            ValueError: where a model does not have one of the parameters, or the laws make no sense.
        """
        if not self.laws:
            raise ValueError("Argument `uncertain` must have a law, but has none.")
        require_units(self.laws, units)
        if all(isinstance(model, Correlated) for model in models.values()):
            raise ValueError("Argument `models` must have one that takes what is uncertain; a correlation does not.")
        self.require_of_metal(models)
        for model in models.values():
            self._set(model)
        return dataclasses.replace(self, values=tuple(self._values(models, units)))

    def require_of_metal(self, models: Mapping[str, CuttingModel], where: str = "Argument `uncertain`") -> None:
        """A `ValueError` that begins with `where` for a law of what the metal and a model do not have."""
        for name, model in models.items():
            known = (*_OF_METAL, *own_parameters(model))
            if strange := [parameter for parameter in self.laws if parameter not in known]:
                wanted = f"parameters of the metal or of {name} ({', '.join(known)})"
                raise ValueError(f"{where} must name {wanted}, but has {strange[0]}.")

    def _values(self, models: Mapping[str, CuttingModel], units: System) -> Iterator[str]:
        known = dict(FACTORS)
        for model in models.values():
            known |= quantities(model)
        for name, law in self.laws.items():
            low, middle, high = (float(value) for value in law.ppf(np.array([0.025, 0.5, 0.975])))
            scale = table_scale(known[name].dimension, units, abs(middle))
            ends = [format_number(value, 3, scale.size) for value in (middle, low, high)]
            yield f"{known[name].symbol} = {ends[0]} ({ends[1]} … {ends[2]}) {scale.unit}".rstrip()

    def middle(self, model: CuttingModel, p: Parameters) -> tuple[CuttingModel, Parameters]:
        """Model and case with each law at its median."""
        medians = {name: float(value[0]) for name, value in self._set(model).middle.items() if name != FRACTION}
        return with_values(model, p, medians)

    @functools.cached_property
    def fraction(self) -> float | None:
        """The median share of the particles that cut, where it is uncertain."""
        return float(self.laws[FRACTION].ppf(np.array([0.5]))[0]) if FRACTION in self.laws else None

    def draws(self, model: CuttingModel) -> dict[str, np.ndarray]:
        """The parameters of the draws, shape (DRAWS,) each; always the same."""
        laws = self._set(model)
        return laws.draw(Points("sobol", laws.dimension, 0, 1).take(DRAWS)[0])

    def _set(self, model: CuttingModel) -> LawSet:
        return LawSet(self.laws, {**ranges(model), FRACTION: SHARE})
