"""From a table of impacts to the wear of each face: `erosion.erosion_map`.

The table is read and computed in portions of a fixed number of rows, so that memory does not grow with it. In this
process portions follow one another, each on all cores; the workers of a Dask cluster compute one each.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
from erosion.ode.precision import require_float64
from erosion.parameters.parameters import Parameters


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
    density: float | None = None,
    limit: float | None = None,
    seed: int = 0,
    rtol: float = 1e-9,
    uncertain: Mapping[str, Any] | None = None,
    draws: int = 64,
    cutting_fraction: float = 1.0,
    progress: Progress = no_progress,
    **distributions: Any,
) -> xr.Dataset:
    """Compute the wear of each face of a surface by the impacts of a CFD run.

        wear = erosion.erosion_map("rotating", p, erosion.read_impacts("bend"), erosion.read_surface("bend"))

    Speed, angle and mass are each row's, the rest is the case's. Rows without a face go to the nearest one. An active
    Dask cluster computes the same bits.

    Args:
        model: a model, its name or path; a correlation such as "dnv:duplex" too.
        p: the case, all scalars. Its v0, alpha and m are replaced by those of each row.
        impacts: see `read_impacts`.
        surface: see `read_surface`; None for totals alone, of speeds and angles.
        scaling: "similar": a particle g times as large as the case's has g times its r and b. "none": all have these.
        diameter: of the case's particle as a sphere of the CFD run [length]; else g is the cube root of mass ratios.
        spin: "column" of the table, "case" (its φ̇₀), "none", or a law; else the table's, the case's if there is none.
        restitution: (e, μ) if the table holds velocities after the rebound: U_n = -U_n'/e, U_t = U_t'/(1 - μ).
        density: of the target [kg/m³], whatever the units of `p`; without it that of a correlation, else no mass.
        limit: greatest distance of a row from its face [length]; farther rows are left out. Without it a share of the
            surface's width, the particle's diameter, and what a curved wall is off its facets; see docs/cfd.md.
        seed: of the numbers drawn from laws.
        rtol: see `impact`.
        uncertain: laws of what is one number for all impacts but not known, {"k": Normal(2, 0.1)}, "cutting_fraction"
            too, or `posterior.rows_of_draws()`. What it does to the wear does not average out over impacts.
        draws: of what is uncertain; for each all impacts are computed. 64 know an error to 9 %.
        cutting_fraction: the share of the particles that cut, by which volumes are multiplied.
        progress: called with "map", the number of rows that are done, and of all (0 if not known).
        **distributions: parameter to its law from impact to impact, in the place of the case's value; see `stream`.

    Returns:
        Over "face": volume, depth, impacts, particles, erodent (mass that hits), erosion, alpha_mean, v0_mean,
        relative_error (of the volume, √(Σ(wV)²)/ΣwV); mass, depth_rate, depth_per_year and mass_flux where density and
        the table's duration are known. Over "patch" the totals, over "end" how impacts end. In the units of `p`.
        If something is uncertain: means over the draws, and `relative_error` = √(sampling_error² + parameter_error²).

    Raises:
        ValueError: for arguments that make no sense, and a table (`ImpactsError`, with file and row) of no use, or on
            whose surface it does not lie, as in other units.
        SimulationError: where no impact could be computed.
    """
    bodies = Bodies(p, scaling, diameter, spin, seed, distributions, uncertain or {}, draws, cutting_fraction)
    options = MapOptions(bodies, restitution, density, limit, rtol)
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
    options.bodies.check_laws(loaded)
    if isinstance(loaded, Correlated) and options.density is None:
        options = dataclasses.replace(options, density=float(loaded.density))
    return MapJob(Task(model, own or {}, options, 1 if surface is None else len(surface.patches)), impacts, surface)
