"""From a table of impacts to the wear of each face: `erosion.erosion_map`.

The table is read and computed in portions of a fixed number of rows, so that memory does not grow with it. In this
process portions follow one another, each on all cores; the workers of a Dask cluster compute one each.
"""

import dataclasses
import functools
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import Progress, check_tolerance, check_whole, no_progress
from erosion.cfd.impacts import Impacts, ImpactsError
from erosion.cfd.surface import Surface
from erosion.distributions import Distribution
from erosion.engine.impact import impact
from erosion.engine.outcomes import end_names
from erosion.maps.bodies import Bodies, outside_range
from erosion.maps.incidence import HIT, LEFT_OUT, RECEDING, Hits, Incidence
from erosion.maps.result import MapSource, to_dataset
from erosion.maps.tally import Portion, Tally, portion_of
from erosion.models import load_model, model_name
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated
from erosion.models.own_parameters import require_one_impact
from erosion.models.registry import PLUG_IN
from erosion.parameters.parameters import Parameters, validate
from erosion.parameters.precision import require_float64
from erosion.parameters.units import conversion_factor
from erosion.storage.identity import code_version
from erosion.trajectory.trajectory import SimulationError

_PORTION = 2**18  # rows: enough for all cores at once, a few tens of megabytes
_WRONG_WAY = 0.9  # share of rows from behind that no table of real impacts reaches
_NAMED = 3  # rows that are too far are named, the others counted


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
    limit: float | None = None,
    duration: float | None = None,
    seed: int = 0,
    rtol: float = 1e-9,
    progress: Progress = no_progress,
) -> xr.Dataset:
    """Compute the wear of each face of a surface by the impacts of a CFD run.

        impacts = erosion.read_impacts("bend")
        surface = erosion.read_surface("bend", patch="wall")
        wear = erosion.erosion_map("rotating", p, impacts, surface)
        wear["depth"].max()

    Speed, angle of attack and mass are those of each row. The other parameters come from the case, whose r and b
    follow the size of a row's particle. Rows that name no face go to the nearest one. While a Dask cluster is active,
    its workers compute; the result has the same bits.

    Args:
        model: a model, its name or path; a correlation such as "dnv:duplex" too.
        p: the case, all scalars. Its v0, alpha and m are replaced by those of each row.
        impacts: see `read_impacts`.
        surface: see `read_surface`; None for totals alone, of a table with speeds and angles.
        scaling: "similar": a particle that is g times as large as the case's has g times its r and b.
            "none": all particles have the case's r and b.
        diameter: of the sphere that stands for the case's particle in the CFD run [length]. Without it, a particle of
            the case's mass is the case's particle, and g is the cube root of the ratio of masses.
        spin: "column" of the table, "case" (its φ̇₀ for all), "none", or a law of φ̇₀ from `erosion.distributions`.
            Without it, the table's spin, and the case's if the table has none.
        restitution: (e, μ) if the table holds velocities after the rebound: U_n = -U_n'/e, U_t = U_t'/(1 - μ).
        target_density: for mass [density]; without it that of a correlation, else no mass is computed.
        limit: greatest distance between a face and a row that names none [length]; farther rows are left out.
        duration: time that the impacts cover [s]; without it that of the table.
        seed: of the numbers drawn from a law of the spin.
        rtol: see `impact`.
        progress: called with "map", the number of rows that are done, and of all (0 if not known).

    Returns:
        Over "face": volume, depth, impacts, particles, erodent (mass that hits), erosion, alpha_mean, v0_mean,
        relative_error; mass, depth_rate, depth_per_year and mass_flux where density and duration are known. Over
        "patch": the totals; over "end": how impacts end. Numbers are in the units of `p`.
        `relative_error` is the standard error over the volume, √(Σ(wV)²)/ΣwV, of rows that are independent draws.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a table (`ImpactsError`) that cannot be used;
            it names file and row.
        SimulationError: where no impact could be computed.
    """
    options = MapOptions(
        bodies=Bodies(p, scaling, diameter, spin, seed),
        restitution=restitution,
        target_density=target_density,
        limit=limit,
        duration=duration,
        rtol=rtol,
    )
    return prepare_map(model, impacts, surface, options).run(progress)


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """The case, and how a map is made of it; see `erosion_map`.

    Raises:
        ValueError, TypeError: for an option that makes no sense.
    """

    bodies: Bodies
    restitution: tuple[float, float] | None = None
    target_density: float | None = None
    limit: float | None = None
    duration: float | None = None
    rtol: float = 1e-9

    def __post_init__(self) -> None:
        object.__setattr__(self, "rtol", check_tolerance(self.rtol))
        check_whole("seed", self.bodies.seed, 0)
        validate(self.bodies.p)
        numbers = {name: getattr(self, name) for name in ("target_density", "limit", "duration")}
        for name, value in {**numbers, "diameter": self.bodies.diameter}.items():
            if value is not None and not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
                raise ValueError(f"Argument `{name}` must be positive and finite, but is {value!r}.")
        if self.restitution is not None:
            _check_restitution(self.restitution)


def _check_restitution(pair: Any) -> None:
    """Refuse what is no (e, μ)."""
    numbers = isinstance(pair, (tuple, list)) and all(isinstance(value, (int, float, np.number)) for value in pair)
    if not (numbers and len(pair) == 2 and 0 < pair[0] <= 1 and 0 <= pair[1] < 1):
        raise ValueError(
            "Argument `restitution` must be (e, μ) with e in (0, 1] and μ in [0, 1), as the wall of the CFD run has "
            f"them, but is {pair!r}."
        )


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


@dataclasses.dataclass(frozen=True)
class Task:
    """What is the same for all portions of a map; workers get a copy.

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
        model, bodies = self.model, self.options.bodies
        is_hit = hits.fate == HIT
        struck = hits.part(is_hit)
        spin = bodies.spins(hits, number)[is_hit]
        ends = len(end_names(model))
        if not struck.rows:
            return portion_of(hits, spin, np.zeros(0, np.int64), np.zeros(0, bool), self.patches, ends)
        each, p = bodies.impacts(model, struck, spin)
        results = impact(each, p, rtol=self.options.rtol)
        volume, outcome = np.asarray(results.volume), np.asarray(results.outcome)
        return portion_of(hits, volume, outcome, outside_range(model, struck), self.patches, ends)


@functools.lru_cache(maxsize=4)
def _loaded(reference: str | Path) -> CuttingModel:
    """The model by name or path, loaded once by each worker."""
    return load_model(reference)


def compute_portion(task: Task, hits: Hits, number: int, code: str) -> tuple[int, Portion]:
    """Compute a portion on a worker; returns its number too.

    Raises:
        RuntimeError: where this process computes with other code than the map was begun with.
    """
    require_float64()
    if code_version() != code:
        raise RuntimeError(f"A worker has {code_version()}, but the map was begun with {code}.")
    return number, task.compute(hits, number)


@dataclasses.dataclass(frozen=True)
class MapJob:
    """A map whose arguments are checked."""

    task: Task
    impacts: Impacts
    surface: Surface | None

    def run(self, progress: Progress = no_progress) -> xr.Dataset:
        """Read and compute the table; progress and errors as of `erosion_map`."""
        task, faces = self.task, 1 if self.surface is None else self.surface.faces
        ends = end_names(task.model)
        tally = Tally(faces, task.patches, len(ends))
        far: list[str] = []

        def add(portion: Portion) -> None:
            tally.add(portion)
            progress("map", tally.rows, self.impacts.rows or 0)

        self._compute(self._portions(far), add)
        self._require_hits(tally)
        if not tally.impacts.any():
            raise SimulationError(f"{model_name(task.model)}: of {tally.hits:,} impacts none could be computed.")
        source = MapSource(task.model, task.options.bodies, self.impacts, self.surface, self._in_words(), tuple(far))
        duration = task.options.duration or self.impacts.duration
        return to_dataset(tally, source, ends, task.options.target_density, duration)

    def _compute(self, portions: Iterator[Hits], add: Any) -> None:
        """Compute all portions, and add them in their order."""
        # Without the import there is no active cluster.
        client = None
        if "distributed" in sys.modules:
            from erosion.cluster import active_client, run_blocks

            client = active_client()
        if client is None:
            for number, hits in enumerate(portions):
                add(self.task.compute(hits, number))
            return
        self._require_path()
        code, waiting = code_version(), dict[int, Portion]()
        following = 0

        def done(result: tuple[int, Portion]) -> None:
            nonlocal following
            waiting[result[0]] = result[1]
            while following in waiting:
                add(waiting.pop(following))
                following += 1

        run_blocks(client, compute_portion, ((self.task, hits, i, code) for i, hits in enumerate(portions)), done)

    def _portions(self, far: list[str]) -> Iterator[Hits]:
        """All rows in portions of a fixed number, the last one of what is left; `far` gets rows that are too far."""
        options = self.task.options
        factor = conversion_factor("length", options.bodies.p.units, "si")
        limit = None if options.limit is None else options.limit * factor
        incidence = Incidence(self.surface, self.impacts.mesh_faces, options.restitution, limit)
        held, count, is_first = list[Hits](), 0, True
        for block in self.impacts.blocks(_PORTION):
            hits = incidence.hits(block)
            far += incidence.too_far(block, hits, _NAMED - len(far))
            begin = 0
            while begin < hits.rows:
                part = hits.part(slice(begin, begin + _PORTION - count))
                held.append(part)
                begin, count = begin + part.rows, count + part.rows
                if count == _PORTION:
                    portion = Hits.joined(held)
                    if is_first:
                        self._require_right_way(np.bincount(portion.fate, minlength=1 + len(LEFT_OUT)))
                    yield portion
                    held, count, is_first = [], 0, False
        if held:
            yield Hits.joined(held)

    def _require_right_way(self, fates: np.ndarray) -> None:
        """Refuse a table in which nearly all rows come from behind."""
        receding, hits = int(fates[RECEDING]), int(fates[HIT])
        if receding <= _WRONG_WAY * (receding + hits):
            return
        share = f"{self.impacts.title}: in {receding:,} of {receding + hits:,} rows n·U"
        if self.task.options.restitution is not None:
            raise ImpactsError(
                f"{share} is positive: these look like velocities before the rebound. Leave `restitution` out."
            )
        raise ImpactsError(
            f"{share} is not positive: these look like velocities after the rebound, as openfoam.org 11 to 14 writes "
            "them. Give `restitution` = (e, μ) of the wall; or a surface whose normals point out of the fluid, if "
            "these point into it."
        )

    def _require_hits(self, tally: Tally) -> None:
        """Refuse a table of which no row hits."""
        title = self.impacts.title
        if not tally.rows:
            raise ImpactsError(f"{title}: must hold impacts, but holds none.")
        self._require_right_way(tally.fates)
        if tally.hits:
            return
        reasons = {name: int(tally.fates[1 + i]) for i, name in enumerate(LEFT_OUT)}
        words = ", and ".join(f"{count:,} {LEFT_OUT[name]}" for name, count in reasons.items() if count)
        raise ImpactsError(f"{title}: of {tally.rows:,} rows none hits: {words}.")

    def _in_words(self) -> str:
        """The options that are not the default."""
        options, bodies = self.task.options, self.task.options.bodies
        given = {
            "scaling": bodies.scaling if bodies.scaling != "similar" else None,
            "diameter": bodies.diameter,
            "spin": bodies.spin,
            "seed": bodies.seed if isinstance(bodies.spin, Distribution) else None,
            **{name: getattr(options, name) for name in ("restitution", "target_density", "limit", "duration")},
        }
        return ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)

    def _require_path(self) -> None:
        """A plug-in's class is known to this process alone: workers load the plug-in by its path."""
        import cloudpickle

        if isinstance(self.task.reference, CuttingModel) and PLUG_IN.encode() in cloudpickle.dumps(self.task.reference):
            raise ValueError(
                "Argument `model` must be the path of a plug-in where a cluster computes, but is a model of one."
            )
