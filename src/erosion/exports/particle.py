"""The particle of a case as a CFD code knows it: a diameter, a mass, a velocity, and what an impact of it removes."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import check_unmasked
from erosion.array_types import Broadcast
from erosion.impacts.impact import impact
from erosion.models import load_model, model_name
from erosion.models.base import CuttingModel
from erosion.models.correlated import per_mass_of
from erosion.models.own_parameters import own_in_words, require_one_impact
from erosion.parameters.parameters import QUANTITIES, Parameters, are_angles, validate
from erosion.parameters.per_mass import PerMass
from erosion.parameters.quantities import RESULTS
from erosion.parameters.units import conversion_factor
from erosion.trajectory.trajectory import SimulationError
from erosion.version import __version__

_RTOL = 1e-12


class ExportError(ValueError):
    """A model that the form of a CFD code cannot hold; the message says what it would lose."""


@dataclasses.dataclass(frozen=True)
class Particle:
    """The particle of a case and its scaled copies; all numbers are in SI units.

    A copy of another diameter is a similar body: r and b grow with the diameter, m with its third power, as in
    `erosion.stream`. All copies have the spin of the case.

    Args:
        model, p: of the impacts.
        diameter: of the case's particle in the CFD code [m].
        cutting_fraction: share of the impacts that cut.
    """

    model: CuttingModel
    p: Parameters
    diameter: float
    cutting_fraction: float = 1.0

    @property
    def speed(self) -> float:
        """v₀ of the case [m/s]."""
        return float(self.p.v0)

    @property
    def density(self) -> float:
        """Of a sphere of the case's mass and this diameter [kg/m³]."""
        return float(6 * self.p.m / (np.pi * self.diameter**3))

    def volume(self, alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        """The mean volume that an impact removes [m³], of the broadcast shape.

        Raises:
            SimulationError: where an impact fails.
        """
        with np.errstate(over="ignore"):  # such an impact fails
            copies = self.p.similar(d / self.diameter)
        hits = impact(self.model, copies.replace(alpha=alpha, v0=v0), rtol=_RTOL)
        volume = np.asarray(hits.volume)
        if not np.isfinite(volume).all():
            lost = np.count_nonzero(~np.isfinite(volume))
            name = model_name(self.model)
            raise SimulationError(f"{name}: {lost:,} of {volume.size:,} impacts could not be computed.")
        return np.asarray(self.cutting_fraction * volume)

    def erosion(self, alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        """The volume removed per mass of particles [m³/kg], of the broadcast shape."""
        mass = self.p.m * (d / self.diameter) ** 3
        return np.asarray(self.volume(alpha, v0, d) / mass)

    def origin(self) -> str:
        """Lines on what an exported file comes from: model, case, and the particle's diameter."""
        own = own_in_words(self.model, units="si")
        units = {name: quantity.unit("si") for name, quantity in QUANTITIES.items() if name != "alpha"}
        numbers = {name: f"{float(getattr(self.p, name)):.6g}" for name in units}
        case = ", ".join(f"{name} = {numbers[name]}{'' if unit == '1' else f' {unit}'}" for name, unit in units.items())
        return (
            f"erosion {__version__}: {model_name(self.model)}{f' ({own})' if own else ''}\n{case}\n"
            f"The case's particle has the diameter {self.diameter:.6g} m and the density {self.density:.6g} kg/m^3."
            + ("" if self.cutting_fraction == 1 else f"\n{share_in_words(self.cutting_fraction)}")
        )


def share_in_words(cutting_fraction: float) -> str:
    """The line of an exported file on the share of the particles that cut."""
    return f"The cutting fraction {cutting_fraction:.4g} is part of what is written here."


def particle_of(
    model: CuttingModel | str | Path,
    p: Parameters,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
) -> Particle:
    """The particle of a case.

    Args:
        model: a model, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        particle_density: of the particles in the CFD code [kg/m³], whatever the units of the case; their diameter
            is that of a sphere of the case's mass. Without it the diameter is 2 r.
        cutting_fraction: the share of the particles that cut; it does not apply to correlations.

    Raises:
        ValueError: for parameters that are arrays or out of range.
    """
    model = load_model(model)
    require_one_impact(model, p)
    validate(p)
    model, in_si = model.to("si", p)
    share = per_mass_of(model, PerMass(cutting_fraction=cutting_fraction)).cutting_fraction
    if particle_density is None:
        return Particle(model, in_si, 2 * float(in_si.r), share)
    density = positive("particle_density", particle_density)
    if density.size != 1:
        raise ValueError(f"Argument `particle_density` must be a scalar, but has shape {density.shape}.")
    volume = float(in_si.m) / float(density[0])
    return Particle(model, in_si, float(np.cbrt(6 * volume / np.pi)), share)


def positive(name: str, values: Any) -> np.ndarray:
    """Positive numbers, shape (n,), ascending and each once.

    Raises:
        ValueError: naming the argument, where one is not positive and finite, or there is none.
    """
    return _checked(name, values, lambda numbers: (numbers > 0) & np.isfinite(numbers), "must be positive and finite")


def in_si(name: str, values: Any, p: Parameters, own: Any) -> np.ndarray:
    """Speeds ("v0") or diameters ("d") that are given in the units of a case, in SI units; `own` without them.

    Raises:
        ValueError: where one is not positive and finite, or there is none.
    """
    if values is None:
        return np.atleast_1d(np.asarray(own, float))
    dimension = (QUANTITIES if name in QUANTITIES else RESULTS)[name].dimension
    return positive(name, values) * conversion_factor(dimension, p.units, "si")


def angles(values: Any) -> np.ndarray:
    """Angles of attack [rad], shape (n,), ascending and each once.

    Raises:
        ValueError: where one is not in (0, π/2], or there is none.
    """
    return _checked("alpha", values, are_angles, "must be in (0, 90°]")


def _checked(name: str, values: Any, are_good: Any, condition: str) -> np.ndarray:
    check_unmasked(name, values)
    try:
        numbers = np.atleast_1d(np.asarray(values, float))
    except (TypeError, ValueError):
        raise ValueError(f"Argument `{name}` must be numbers, but is {values!r}.") from None
    if numbers.ndim != 1 or not numbers.size:
        raise ValueError(f"Argument `{name}` must be a number or a list of them, but has shape {numbers.shape}.")
    good = are_good(numbers)
    if not good.all():
        bad = float(numbers[~good][0])
        shown = f"{np.rad2deg(bad):g}°" if name == "alpha" else f"{bad:g}"
        raise ValueError(f"Argument `{name}` {condition}, but has {shown}.")
    return np.unique(numbers)


def commented(text: str, mark: str) -> str:
    """The lines of a text, each behind a mark of comments."""
    return "".join(f"{mark} {line}\n" for line in text.splitlines())
