"""From free parameters to predicted erosion, with exact derivatives.

Positive parameters q are fitted as θ = log q, the spin φ̇₀ as θ = φ̇₀ r/v₀ (of the case): then
steps are of order 1 whatever the units, and nothing leaves its range.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from erosion.calibration.measurements import Measurements
from erosion.kernel import Impact, impact
from erosion.model import CuttingModel
from erosion.parameters import QUANTITIES, Parameters

SCALE = "scale"
"""The name of the factor between the model's volume and erosion in units of its own."""


@dataclasses.dataclass(frozen=True)
class Forward:
    """What a model predicts for the kind of erosion that was measured.

    Args:
        model: any model.
        p: the case; its values are kept for all that is neither free nor in the data.
        free: the free parameters.
        data: what was measured, of which only the kind counts here.
        density: of the target [density]; needed where mass losses were measured.
    """

    model: CuttingModel
    p: Parameters
    free: tuple[str, ...]
    data: Measurements
    density: float | None

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters, and the scale where that is free too."""
        return (*self.free, SCALE) if self.data.free_scale else self.free

    @property
    def logarithmic(self) -> np.ndarray:
        """Which θ are logarithms, shape (names,)."""
        return np.array([name != "phidot0" for name in self.names])

    @property
    def start(self) -> np.ndarray:
        """θ of the case, shape (names,); of the scale 0."""
        return self.theta({**{name: float(getattr(self.p, name)) for name in self.free}, SCALE: 1.0})

    def theta(self, values: Mapping[str, float]) -> np.ndarray:
        """θ of parameter values."""
        return np.array([self.to_theta(name, values[name]) for name in self.names])

    def to_theta(self, name: str, value: float) -> float:
        """One parameter's θ."""
        return value / self._spin_unit if name == "phidot0" else float(np.log(value))

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """The parameters at θ, by name."""
        return {name: float(self.from_theta(name, one)) for name, one in zip(self.names, theta, strict=True)}

    def from_theta(self, name: str, theta: Any) -> Any:
        """One parameter's value, or several, of the shape of `theta`."""
        return theta * self._spin_unit if name == "phidot0" else np.exp(theta)

    def slopes(self, theta: np.ndarray) -> np.ndarray:
        """dq/dθ, shape (names,)."""
        values = self.values(theta)
        return np.array([self._spin_unit if name == "phidot0" else values[name] for name in self.names])

    def parameters(self, theta: np.ndarray) -> Parameters:
        """The case with the free parameters at θ."""
        values = self.values(theta)
        return self.p.replace(**{name: values[name] for name in self.free})

    def predict(self, theta: np.ndarray, conditions: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The erosion at θ and its derivatives.

        Args:
            theta: shape (names,).
            conditions: parameters that vary from row to row, each of shape (rows,).

        Returns:
            Erosion, shape (rows,), and ∂/∂θ, shape (rows, names); NaN where an impact failed.
        """
        found, factor = self._impacts(self.values(theta), conditions)
        erosion = found.volume * factor
        slopes = self.slopes(theta)[: len(self.free)]
        rates = [found.dvolume[:, i] * slope * factor for i, slope in enumerate(slopes)]
        if self.data.per_mass and "m" in self.free:
            rates[self.free.index("m")] = rates[self.free.index("m")] - erosion
        if self.data.free_scale:
            rates.append(erosion)
        return erosion, np.stack(rates, axis=-1)

    def predict_many(self, thetas: np.ndarray, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """The erosion at several θ at once, much faster than one by one.

        Args:
            thetas: shape (points, names).
            conditions: as for `predict`.

        Returns:
            Erosion, shape (points, rows); NaN where an impact failed.
        """
        columns = zip(self.names, thetas.T, strict=True)
        found, factor = self._impacts(
            {name: self.from_theta(name, column[:, None]) for name, column in columns}, conditions
        )
        return found.volume * factor

    def _impacts(self, values: Mapping[str, Any], conditions: Mapping[str, np.ndarray]) -> tuple[Impact, Any]:
        """The impacts at parameter values, and what turns volume into the erosion that was measured."""
        p = self.p.replace(**{name: values[name] for name in self.free}).replace(**conditions)
        # Always with derivatives: then one compiled program serves all.
        found = impact(self.model, p, derivatives=1, wrt=self.free)
        factor = 1.0
        if self.data.needs_density and self.density is not None:
            factor = self.density
        if self.data.per_mass:
            factor = factor / np.asarray(p.m)
        if self.data.free_scale:
            factor = factor * values[SCALE]
        return found, factor

    @property
    def _spin_unit(self) -> float:
        return float(self.p.v0 / self.p.r)


def check_free(free: Sequence[str], data: Measurements) -> tuple[str, ...]:
    """The names of the parameters to fit.

    Raises:
        ValueError: for a name that is no parameter, or one that the data fixes.
    """
    if not isinstance(free, Sequence):
        raise TypeError(f"Argument `free` must be a list of parameters, but is {free!r}.")
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if not isinstance(name, str) or name not in QUANTITIES:
            raise ValueError(f"Argument `free` must name parameters ({', '.join(QUANTITIES)}), but has {name!r}.")
        if name == "alpha" or name in data.conditions:
            raise ValueError(f"Argument `free` must not name `{name}`: the data has a column of it.")
    if not names or len(set(names)) != len(names):
        raise ValueError(f"Argument `free` must name one or several different parameters, but is {free!r}.")
    return names
