"""`erosion.erosion_map`: from a table of impacts to the wear of each face, portion by portion.

The table is read and computed in portions of a fixed number of rows, so that memory does not grow with it. In this
process portions follow one another, each on all cores; the workers of a Dask cluster compute one each.
"""

import dataclasses
import functools
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import Progress, no_progress
from erosion.cfd.incidence import HIT, LEFT_OUT, RECEDING, Hits, Incidence, Nearness
from erosion.cfd.map_result import Sand, to_dataset
from erosion.cfd.options import FRACTION, ROWS, MapOptions
from erosion.cfd.rows import ImpactBlock, Impacts, ImpactsError
from erosion.cfd.surface import Surface
from erosion.cfd.table_summary import TableSummary
from erosion.cfd.tally import FaceTally, Portion, portion_of
from erosion.correlations import CORRELATIONS
from erosion.correlations.ranges import masks_outside
from erosion.impacts import (
    SimulationError,
    code_version,
    count_turned,
    end_names,
    finding_of_turned,
    identity,
    impact,
    model_in_words,
    provenance,
    pushed_forward,
    require_code,
)
from erosion.laws import JointLaw, JointSamples, joint_law
from erosion.models import (
    Correlated,
    CuttingModel,
    load_model,
    model_name,
    quantities,
    require_loadable,
    require_one_impact,
)
from erosion.ode.step_control import require_float64
from erosion.output import briefly, digest
from erosion.parameters import RESULTS, Parameters, readable_scale, require_parameters, si_numbers
from erosion.results import Finding, stated, to_attribute

_PORTION = 2**18  # impacts, draws times rows: enough for all cores at once, a few tens of megabytes
_LITTLE = 0.13  # of the sand injected: radii for diameters leave 1/8 of what hits, g under kg 1/1000
_WRONG_WAY = 0.9  # share of rows from behind that no table of real impacts reaches


@dataclasses.dataclass(frozen=True)
class MapTask:
    """The common inputs of all portions of a map; workers get a copy.

    Args:
        reference: the model, or its name or path.
        own: values of its own parameters.
        options: see `MapOptions`.
        patches: number of the surface's patches.
    """

    reference: CuttingModel | str | Path
    own: Mapping[str, float]
    options: MapOptions
    patches: int

    @property
    def model(self) -> CuttingModel:
        """The model with its own parameters."""
        loaded = self.reference if isinstance(self.reference, CuttingModel) else _loaded(self.reference)
        return loaded.replace(**self.own)

    def compute(self, hits: Hits, number: int) -> Portion:
        """The sums of portion `number`."""
        model, options, struck = self.model, self.options, hits
        values, is_hit = options.of_rows(model, hits, number), hits.fate == HIT
        if not is_hit.all():
            struck, values = hits.part(is_hit), {name: value[is_hit] for name, value in values.items()}
        volume = outcome = np.zeros((options.realisations, struck.rows), np.int64)
        turned = np.zeros(2, np.int64)
        if struck.rows:
            common = options.common(model)
            results = impact(*options.impacts(model, struck, values | common), rtol=options.rtol)
            removed = np.asarray(results.volume) * common.get(FRACTION, options.cutting_fraction)
            volume, outcome = (np.broadcast_to(array, volume.shape) for array in (removed, results.outcome))
            turned = count_turned(results.model, results.p)
        outside = np.zeros(struck.rows, bool)
        if isinstance(model, Correlated):
            columns = {"alpha": struck.alpha, "v0": struck.speed, "diameter": struck.diameter}
            outside = np.any([*masks_outside(CORRELATIONS[model.name].ranges, columns).values()], axis=0)
        return portion_of(hits, struck, volume, outcome, outside, turned, self.patches, len(end_names(model)))


@functools.lru_cache(maxsize=4)
def _loaded(reference: str | Path) -> CuttingModel:
    """The model by name or path, loaded once by each worker."""
    return load_model(reference)


def compute_portion(task: MapTask, hits: Hits, number: int, code: str) -> tuple[int, Portion]:
    """Compute a portion on a worker; returns its number too.

    Raises:
        RuntimeError: where this process computes with other code than the map was begun with.
    """
    require_code(code, "map")
    return number, task.compute(hits, number)


@dataclasses.dataclass(frozen=True)
class MapJob:
    """A map whose arguments are checked."""

    task: MapTask
    impacts: Impacts
    surface: Surface | None

    def identity(self) -> dict[str, str]:
        """All inputs of the map, in words; reads all files of the table.

        Raises:
            ValueError: for a model that computes by what only this process knows.
        """
        surface = "none"
        if self.surface is not None:
            arrays = (self.surface.points, self.surface.corners, self.surface.ends, self.surface.patch)
            surface = digest(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
        options = self.task.options
        return identity(
            {"map": self.task.model},
            options.p,
            table=f"{self.impacts.title} {self.impacts.identity()}",
            surface=surface,
            options=f"{options.in_words()}; rtol = {options.rtol} {options.laws.digest} {options.uncertain.digest}",
        )

    def run(self, progress: Progress = no_progress) -> xr.Dataset:
        """Read and compute the table; progress and errors as of `erosion_map`."""
        if self.surface is not None and not self.surface.is_facing:
            return dataclasses.replace(self, surface=self._turned(self.surface)).run(progress)
        task, table, surface, options = self.task, self.impacts, self.surface, self.task.options
        ends = end_names(task.model)
        tally = FaceTally(1 if surface is None else surface.faces, options.realisations)
        nearness, summary = Nearness(surface, self._limit), TableSummary()

        def add(portion: Portion) -> None:
            tally.add(portion)
            progress("map", tally.rows, table.rows or 0)

        self._compute(self._portions(nearness, summary), add)
        self._require_hits(tally)
        if not tally.sums["impacts"].any():
            raise SimulationError(f"{model_name(task.model)}: of {tally.hits:,} impacts none could be computed.")
        sand = self._sand(tally, summary)
        is_told = options.injected != ROWS and bool(options.injected or table.injected)
        read_as = summary.lines(table, tally, surface, sand.injected if is_told else None)
        attributes = provenance(
            "a map",
            options.p,
            **model_in_words(task.model, but=options.names),
            table=table.title,
            surface="" if surface is None else surface.title,
            surface_unit="" if surface is None else surface.unit,
            options=options.in_words(),
            constants=options.constants_in_words(task.model),
            rows_beyond_limit=nearness.far_in_words(),
            duration_from=sand.duration_from,
            injected_from=sand.injected_from,
            read_as="\n".join(read_as),
            findings=to_attribute(
                (
                    *map(stated, table.warnings),
                    *summary.findings(tally, surface),
                    *sand.findings,
                    *filter(None, [finding_of_turned(tally.counts["turned"])]),
                    *([Finding("pushed_forward")] if pushed_forward(task.model, options.p) else ()),
                )
            ),
        )
        has_range = isinstance(task.model, Correlated)
        return to_dataset(tally, options, surface, sand, ends, attributes, has_range=has_range)

    def __post_init__(self) -> None:
        """Refuse weights and sand that nobody says, and a sheet of two layers, before anything is read."""
        options, table, surface = self.task.options, self.impacts, self.surface
        if not table.has_weights and options.each_row is None and options.injected is None:
            raise ValueError(
                f"{table.title} has no column of the number of particles that a row stands for: Argument `each_row` "
                'must say it, such as "1 particle", or Argument `injected` the mass of all sand.'
            )
        if table.has_weights and options.each_row is not None:
            raise ValueError(f"Argument `each_row` must be left out, as {table.title} has a weight of each row.")
        if surface is not None and surface.doubled.size and surface.mesh_face is None:
            raise ImpactsError(
                f"{surface.title}: {surface.doubled.size:,} faces lie on others, as both sides of a sheet: keep one "
                f"side of them, the first are {', '.join(map(str, surface.doubled[:3]))}."
            )
        given = options.injected == ROWS or options.injected_in(table.duration)
        if given or options.sand_rate is None or table.injected or table.has_parcels:
            return
        raise ValueError(
            f"Argument `sand_rate` needs the mass of sand that was injected in the run, which {table.title} does not "
            'say: Argument `injected` must give it, such as "2 g", or "rows" if each row is another parcel.'
        )

    def _sand(self, tally: FaceTally, summary: TableSummary) -> Sand:
        """The mass of sand in the run, and the time that it is taken for."""
        options, table, parcels = self.task.options, self.impacts, tally.parcels
        duration, duration_from, of_duration = summary.duration_of(table, tally.rows)
        findings = [*of_duration]
        known, particle_mass = float(parcels.mass.sum()), float(tally.sums["particle_mass"].sum())
        given = options.injected_in(duration)
        rows = float(tally.counts["lost_mass"].sum()) if options.injected == ROWS else None
        sources = {"as given": given, "all rows of the table": rows, "as the case of the run says": table.injected,
                   f"the {len(parcels.known):,} parcels of the table, each once": known or None}  # fmt: skip
        injected_from, injected = next(((name, mass) for name, mass in sources.items() if mass), ("", None))
        if changing := int((parcels.mass > 1.001 * parcels.least_mass).sum()):
            numbers = {"changing": changing, "parcels": len(parcels.known)}
            findings.append(Finding("parcels_change_mass", numbers=numbers))
        if injected is not None and known > 1.001 * injected:
            findings.append(Finding("parcels_above_injected", numbers={"parcels": known, "injected": injected}))
        elif injected is not None and not table.has_parcels and particle_mass > 1.001 * injected:
            findings.append(Finding("hits_above_injected", numbers={"ratio": particle_mass / injected}))
        elif given and (come := known or float(tally.counts["lost_mass"].sum())) < _LITTLE * given:
            findings.append(Finding("hits_far_below_injected", numbers={"ratio": come / given}))
        elif rows:
            findings.append(Finding("each_row_is_sand"))
        elif given is None and table.injected is None and options.sand_rate is not None:
            findings.append(Finding("only_hits_are_sand"))
        if options.sand_rate is not None and injected is not None:
            duration = injected / options.sand_rate
            mass = readable_scale("mass", "si", injected)
            duration_from = f"in which {mass.beside(f'{injected / mass.size:.4g}')} of sand come"
        return Sand(duration, duration_from, injected, injected_from, tuple(findings))

    def _compute(self, portions: Iterator[Hits], add: Callable[[Portion], None]) -> None:
        """Compute all portions, and add them in their order."""
        # Without the import there is no active cluster.
        if "distributed" in sys.modules:
            from erosion.impacts.cluster import active_client

            if (client := active_client()) is not None:
                self._compute_on(client, portions, add)
                return
        for number, hits in enumerate(portions):
            add(self.task.compute(hits, number))

    def _compute_on(self, client: Any, portions: Iterator[Hits], add: Callable[[Portion], None]) -> None:
        """The same by the workers of a cluster."""
        from erosion.impacts.cluster import run_blocks

        require_loadable(self.task.reference)
        code, waiting = code_version(), dict[int, Portion]()
        following = 0

        def done(result: tuple[int, Portion]) -> None:
            nonlocal following
            waiting[result[0]] = result[1]
            while following in waiting:
                add(waiting.pop(following))
                following += 1

        run_blocks(client, compute_portion, ((self.task, hits, i, code) for i, hits in enumerate(portions)), done)

    @property
    def _limit(self) -> float | None:
        """In metres."""
        return self.task.options.limit

    def _portions(self, nearness: Nearness, summary: TableSummary) -> Iterator[Hits]:
        """All rows, noted by `nearness` and `summary`, in portions of a fixed number, the last one of what is left."""
        options = self.task.options
        incidence = Incidence(self.surface, self.impacts.mesh_faces, options.restitution, self._limit)
        blocks, rows = self.impacts.blocks(_PORTION), max(1, _PORTION // options.realisations)
        try:
            held, count, is_first = list[Hits](), 0, True
            for block in blocks:
                hits = incidence.hits(self._weighed(block))
                nearness.add(block, hits)
                summary.add(block, hits)
                begin = 0
                while begin < hits.rows:
                    part = hits.part(slice(begin, begin + rows - count))
                    held.append(part)
                    begin, count = begin + part.rows, count + part.rows
                    if count == rows:
                        portion = Hits.joined(held)
                        if is_first:
                            nearness.require(self.impacts.title)
                            self._require_right_way(np.bincount(portion.fate, minlength=1 + len(LEFT_OUT)))
                        yield portion
                        held, count, is_first = [], 0, False
            nearness.require(self.impacts.title)
            if held:
                yield Hits.joined(held)
        finally:
            # A reader may read ahead in a thread, which must end before the process does.
            if isinstance(blocks, Generator):
                blocks.close()

    def _weighed(self, block: ImpactBlock) -> ImpactBlock:
        """The block with the particles that each row stands for."""
        particles = self.task.options.particles
        return block if particles == 1 else dataclasses.replace(block, count=block.count * particles)

    def _turned(self, surface: Surface) -> Surface:
        """The surface, each connected part of it turned so that most rows approach it."""
        part, is_against = surface.parts
        surface = dataclasses.replace(surface.reversed(is_against), is_facing=True)
        incidence = Incidence(surface, self.impacts.mesh_faces, self.task.options.restitution, self._limit)
        votes = np.zeros(part.max() + 1)
        for block in self.impacts.blocks(_PORTION):
            if block.velocity is None:
                return surface
            hits = incidence.hits(block)
            meets = np.isin(hits.fate, (HIT, RECEDING))
            votes += np.bincount(part[hits.face], np.where(hits.fate == HIT, 1.0, -1.0) * meets, len(votes))
        return surface.reversed((votes < 0)[part])

    def _require_right_way(self, fates: np.ndarray) -> None:
        """Refuse a table in which nearly all rows come from behind."""
        receding, hits = int(fates[RECEDING]), int(fates[HIT])
        if receding <= _WRONG_WAY * (receding + hits):
            return
        share = f"{self.impacts.title}: in {receding:,} of {receding + hits:,} rows n·U"
        if self.task.options.restitution is not None:
            raise ImpactsError(
                f"{share} is positive: these look like velocities before the rebound. Argument `restitution` must be "
                "left out."
            )
        raise ImpactsError(
            f"{share} is not positive: these look like velocities after the rebound, as openfoam.org 11 to 14 writes "
            "them: Argument `restitution` must then be (e, μ) of the wall, which undoes it."
        )

    def _require_hits(self, tally: FaceTally) -> None:
        """Refuse a table of which no row hits."""
        title = self.impacts.title
        if not tally.rows:
            raise ImpactsError(f"{title}: must hold impacts, but holds none.")
        fates, mass = tally.counts["fates"], tally.counts["lost_mass"]  # of rows that hit, too
        if not mass.any() or (tally.hits and not mass[HIT]):
            which = "that hits " if mass.any() else ""
            raise ImpactsError(f"{title}: every row {which}has the weight 0, so no particle hits.")
        self._require_right_way(fates)
        if not tally.hits:
            reasons = zip(fates[1:], LEFT_OUT.values(), strict=True)
            words = ", and ".join(f"{count:,} {reason}" for count, reason in reasons if count)
            raise ImpactsError(f"{title}: of {tally.rows:,} rows none hits: {words}.")


def erosion_map(
    model: CuttingModel | str | Path,
    p: Parameters,
    impacts: Impacts,
    surface: Surface | None = None,
    *,
    scaling: str = "similar",
    diameter: float | None = None,
    spin: Any = None,
    restitution: tuple[float, float] | None = None,
    density: float | None = None,
    limit: float | None = None,
    seed: int = 0,
    rtol: float = 1e-9,
    correlation: Mapping[tuple[str, str], float] | None = None,
    samples: JointSamples | Mapping[str, Any] | None = None,
    uncertain: JointLaw | JointSamples | Mapping[str, Any] | None = None,
    draws: int = 64,
    cutting_fraction: float = 1.0,
    sand_rate: float | str | None = None,
    injected: float | str | None = None,
    each_row: str | None = None,
    progress: Progress = no_progress,
    **laws: Any,
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
        diameter: of the case's particle as a sphere of the CFD run [m]; else g is the cube root of mass ratios.
        spin: "column" of the table, "case" (its φ̇₀), "none", or a law; else the table's, the case's if there is none.
        restitution: (e, μ) if the table holds velocities after the rebound: U_n = -U_n'/e, U_t = U_t'/(1 - μ).
        density: of the target [kg/m³]; without it that of a correlation, else no mass.
        limit: greatest distance of a row from its face [m]; farther rows are left out. Without it a share of the
            surface's width, the particle's diameter, and what a curved wall is off its facets; see docs/cfd.md.
        seed: of the numbers drawn from laws.
        rtol: see `impact`.
        correlation: of the normal scores of `laws`, by pairs; see `JointLaw`.
        samples: see `stream`.
        uncertain: laws of what is one number for all impacts but not known, {"k": scipy.stats.norm(2, 0.1)},
            "cutting_fraction" too, or `posterior.joint_samples()`. What it does to the wear does not average out over
            impacts.
        draws: of what is uncertain; for each all impacts are computed. 64 know an error to 9 %.
        cutting_fraction: the share of the particles that cut, by which volumes are multiplied.
        sand_rate: for rates of wear, the sand that comes: "100 kg/day", "50 ppm of 12 kg/s" (by mass), or [kg/s]. The
            run then stands for the time in which so much sand comes as is `injected` in it.
        injected: the mass of sand of the run, hits or not: "2 g", "0.1 g/s" (times the run's duration), or [kg]; or
            "rows", each another parcel; else what OpenFOAM's case says, else the table's parcels, each once.
        each_row: what a row stands for in a table without weights: "1 particle", or another number of them.
        progress: called with "map", the number of rows that are done, and of all (0 if not known).
        **laws: parameter to its law from impact to impact, in the place of the case's value; see `stream`.

    Returns:
        Over "face": volume, depth, impacts, particles, particle_mass (mass that hits), erosion, alpha_mean, v0_mean,
        relative_error (of the volume, √(Σ(wV)²)/ΣwV, where the bounces of a parcel, if it has a number, are one); mass,
        depth_rate, depth_per_year, mass_per_year and mass_flux where density and duration are known. Over "patch" the
        totals, injected_ratio (mass loss per sand injected) too, over "end" how impacts end. In SI.
        If something is uncertain: means over the draws, and `relative_error` = √(sampling_error² + parameter_error²).

    Raises:
        ValueError: for arguments that make no sense, and a table (`ImpactsError`, with file and row) of no use, or on
            whose surface it does not lie, as in other units.
        SimulationError: where no impact could be computed.
    """
    require_parameters(p)
    beside: dict[str, Any] = {"known": quantities(load_model(model)), "shown_in": p.shown_in}
    together = joint_law(laws, correlation=correlation, samples=samples, **beside)
    sizes: dict[str, Any] = {
        name: si_numbers(name, size, RESULTS["d"], p.shown_in)
        for name, size in (("diameter", diameter), ("limit", limit))
        if size is not None
    }
    options = MapOptions(
        p, scaling, sizes.get("diameter"), spin, restitution, density, sizes.get("limit"), seed, rtol,
        joint_law(uncertain, "uncertain", **beside), draws,
        cutting_fraction, sand_rate, injected, together, each_row,
    )  # fmt: skip
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
        raise TypeError(f"Argument `impacts` must be what `read_impacts` returns, but is {briefly(impacts)}.")
    if surface is not None and not isinstance(surface, Surface):
        raise TypeError(f"Argument `surface` must be what `read_surface` returns, but is {briefly(surface)}.")
    loaded = load_model(model).replace(**(own or {}))
    require_one_impact(loaded, options.p)
    options.check_laws(loaded)
    if isinstance(loaded, Correlated) and options.density is None:
        options = dataclasses.replace(options, density=float(loaded.density))
    return MapJob(MapTask(model, own or {}, options, 1 if surface is None else len(surface.patches)), impacts, surface)
