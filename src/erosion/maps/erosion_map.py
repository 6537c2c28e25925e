"""From a table of impacts to the wear of each face: `erosion.erosion_map`.

The table is read and computed in portions of a fixed number of rows, so that memory does not grow with it. In this
process portions follow one another, each on all cores; the workers of a Dask cluster compute one each.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import xarray as xr

from erosion.arguments import Progress, no_progress
from erosion.cfd.impacts import Impacts
from erosion.cfd.surface import Surface
from erosion.distributions import Distribution
from erosion.maps.bodies import Bodies
from erosion.maps.job import MapJob, Task
from erosion.maps.options import MapOptions
from erosion.models import load_model
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated
from erosion.models.own_parameters import require_one_impact
from erosion.parameters.parameters import Parameters
from erosion.parameters.precision import require_float64
from erosion.parameters.units import conversion_factor


def erosion_map(
    model: CuttingModel | str | Path,
    p: Parameters,
    impacts: Impacts,
    surface: Surface | None = None,
    *,
    scaling: str = "similar",
    diameter: float | None = None,
    spin: str | Distribution | None = None,
    restitution: tuple[float, float] | None = None,
    target_density: float | None = None,
    cutting_fraction: float = 1.0,
    limit: float | None = None,
    seed: int = 0,
    rtol: float = 1e-9,
    progress: Progress = no_progress,
) -> xr.Dataset:
    """Compute the wear of each face of a surface by the impacts of a CFD run.

        impacts, surface = erosion.read_impacts("bend"), erosion.read_surface("bend", patch="wall")
        wear = erosion.erosion_map("rotating", p, impacts, surface)

    Speed, angle of attack and mass are each row's, the rest is the case's. Rows that name no face go to the nearest
    one. While a Dask cluster is active, its workers compute; the result has the same bits.

    Args:
        model: a model, its name or path; a correlation such as "dnv:duplex" too.
        p: the case, all scalars. Its v0, alpha and m are replaced by those of each row.
        impacts: see `read_impacts`.
        surface: see `read_surface`; None for totals alone, of speeds and angles.
        scaling: "similar": a particle g times as large as the case's has g times its r and b. "none": all have these.
        diameter: of the case's particle as a sphere of the CFD run [length]. Without it g is the cube root of the
            ratio of masses.
        spin: "column" of the table, "case" (its φ̇₀), "none", or a law from `erosion.distributions`. Without it the
            table's spin, and the case's if the table has none.
        restitution: (e, μ) if the table holds velocities after the rebound: U_n = -U_n'/e, U_t = U_t'/(1 - μ).
        target_density: for mass [density]; without it that of a correlation, else no mass is computed.
        cutting_fraction: the share of the particles that cut; volumes and all that follows from them are multiplied
            by it. It does not apply to correlations, which are fits to all particles.
        limit: greatest distance between a face and a row that names none [length]; farther rows are left out.
        seed: of the numbers drawn from a law of the spin.
        rtol: see `impact`.
        progress: called with "map", the number of rows that are done, and of all (0 if not known).

    Returns:
        Over "face": volume, depth, impacts, particles, erodent (mass that hits), erosion, alpha_mean, v0_mean,
        relative_error (of the volume, √(Σ(wV)²)/ΣwV); mass, depth_rate, depth_per_year and mass_flux where density and
        the table's duration are known. Over "patch" the totals, over "end" how impacts end. In the units of `p`.

    Raises:
        ValueError: for arguments that make no sense, and a table (`ImpactsError`, with file and row) of no use.
        SimulationError: where no impact could be computed.
    """
    bodies = Bodies(p, scaling, diameter, spin, seed)
    options = MapOptions(bodies, restitution, target_density, limit, rtol, cutting_fraction)
    return prepare_map(model, impacts, surface, options).run(progress)


def prepare_map(
    model: CuttingModel | str | Path,
    impacts: Impacts,
    surface: Surface | None,
    options: MapOptions,
    own: Mapping[str, float] | None = None,
) -> "MapJob":
    """Check everything of a map that can be known before reading; arguments and errors as of `erosion_map`.

    Args:
        model: see `erosion_map`.
        impacts: the table.
        surface: see `erosion_map`.
        options: the case and all else.
        own: values of the model's own parameters.
    """
    require_float64()
    if not isinstance(impacts, Impacts):
        raise TypeError(f"Argument `impacts` must be what `read_impacts` returns, but is {impacts!r}.")
    if surface is not None and not isinstance(surface, Surface):
        raise TypeError(f"Argument `surface` must be what `read_surface` returns, but is {surface!r}.")
    loaded = load_model(model).replace(**(own or {}))
    require_one_impact(loaded, options.bodies.p)
    if isinstance(loaded, Correlated) and options.target_density is None:
        factor = conversion_factor("density", "si", options.bodies.p.units)
        options = dataclasses.replace(options, target_density=float(loaded.density) * factor)
    return MapJob(Task(model, own or {}, options, 1 if surface is None else len(surface.patches)), impacts, surface)
