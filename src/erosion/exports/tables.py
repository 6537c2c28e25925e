"""Tables over angle, speed and diameter for codes that interpolate, as labelled arrays and as CSV."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion import tables
from erosion.exports.particle import Particle, angles, in_si, particle_of
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import QUANTITIES, RESULTS
from erosion.parameters.units import System, ascii_unit, conversion_factor, unit_name
from erosion.storage.identity import model_in_words, provenance

SHARES = np.linspace(0.5, 2, 7)  # of the case's speed and diameter: from half to twice
_ANGLES = np.deg2rad(np.arange(2.5, 91, 2.5))
_MOST_ROWS = 1_000_000
_HEADINGS = {"alpha": "angle", "v0": "speed", "d": "diameter"}


def volume_table(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha: Any = None,
    v0: Any = None,
    d: Any = None,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
) -> xr.Dataset:
    """The volume that an impact removes over diameter, speed and angle, for a table in a CFD code.

        table = erosion.volume_table("rotating", p, v0=np.linspace(20, 200, 19))
        table.volume.interp(alpha=0.4, v0=55.0)

    Particles of another diameter are similar bodies: r and b grow with d, m with its third power; the spin is the
    case's.

    Args:
        model: a model, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every 2.5° without it.
        v0: speeds, shape (n,) [speed]; seven from half to twice the case's without it.
        d: diameters, shape (n,) [length]; seven from half to twice the case's without it.
        particle_density: of the particles in the code [kg/m³]; without it the case's particle has the diameter 2 r.
        cutting_fraction: the share of the particles that cut; volumes are then the mean over all particles.

    Returns:
        `volume` [volume] over (d, v0, alpha), in the units of the case.

    Raises:
        SimulationError: where impacts fail.
        ValueError: for parameters that are arrays or out of range, and for more than a million rows.
    """
    particle = particle_of(model, p, particle_density, cutting_fraction)
    alpha = _ANGLES if alpha is None else angles(alpha)
    speeds = in_si("v0", v0, p, SHARES * particle.speed)
    diameters = in_si("d", d, p, SHARES * particle.diameter)
    require_rows(alpha.size * speeds.size * diameters.size)
    volume = particle.volume(alpha, speeds[:, None], diameters[:, None, None])
    axes = {"d": diameters, "v0": speeds, "alpha": alpha}
    return labelled(particle, p, "removed volumes", axes, {"volume": volume})


def require_rows(rows: int) -> None:
    """Refuse a table that no code would read, and no memory hold."""
    if rows > _MOST_ROWS:
        raise ValueError(
            f"Argument `alpha` must make, with the others, at most {_MOST_ROWS:,} rows, but makes {rows:,}."
        )


def labelled(
    particle: Particle, p: Parameters, content: str, axes: dict[str, np.ndarray], arrays: dict[str, np.ndarray]
) -> xr.Dataset:
    """Arrays over axes in SI units as a Dataset in the units of a case, with units and provenance.

    Args:
        particle: model and case in SI units.
        p: the case as it was given.
        content: for the title.
        axes: values by name, in the order of the dimensions.
        arrays: by name, each over all axes.
    """
    described = provenance(content, p, **model_in_words(particle.model))
    attributes = {**described, "particle_diameter": particle.diameter * conversion_factor("length", "si", p.units)}
    known = {**QUANTITIES, **RESULTS}

    def in_units(name: str, values: np.ndarray) -> tuple[np.ndarray, dict[str, str]]:
        return values * conversion_factor(known[name].dimension, "si", p.units), known[name].attributes(p.units)

    dataset = xr.Dataset(attrs=attributes, coords={name: (name, *in_units(name, v)) for name, v in axes.items()})
    for name, values in arrays.items():
        dataset[name] = (tuple(axes), *in_units(name, values))
    return dataset


def to_csv(dataset: xr.Dataset) -> str:
    """A Dataset of `labelled` as CSV: a row for each point, SI units, angles in degrees.

    "volume [m^3]" and the like are in the first row. The last axis varies fastest.
    """
    system, names = dataset.attrs["unit_system"], [str(name) for name in (*dataset.dims, *dataset.data_vars)]
    return tables.to_csv(dict(_column(name, dataset, system) for name in names))


def _column(name: str, dataset: xr.Dataset, system: System) -> tuple[str, list[str]]:
    """Heading and cells."""
    values = dataset[name].broadcast_like(dataset[next(iter(dataset.data_vars))]).transpose(*dataset.dims).values
    heading = _HEADINGS.get(name, name)
    if "flag_meanings" in dataset[name].attrs:
        words = dataset[name].attrs["flag_meanings"].split()
        return heading, [words[int(code)] for code in values.ravel()]
    dimension = {**QUANTITIES, **RESULTS}[name].dimension
    unit = ascii_unit(unit_name(dimension, "si"))
    factor = conversion_factor(dimension, system, "si")
    if dimension == "angle":
        unit, factor = "deg", 180 / np.pi
    return f"{heading} [{'-' if unit == '1' else unit}]", [f"{number:.10g}" for number in values.ravel() * factor]
