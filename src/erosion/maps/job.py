"""The work of a map: portions of the table are read, computed here or by a cluster, and added in their order."""

import dataclasses
import functools
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import Progress, no_progress
from erosion.cfd.impacts import Impacts, ImpactsError
from erosion.cfd.surface import Surface
from erosion.files import digest
from erosion.impacts.impact import impact
from erosion.impacts.outcomes import end_names
from erosion.joint_laws import law_digest
from erosion.maps.bodies import FRACTION, outside_range
from erosion.maps.incidence import HIT, LEFT_OUT, RECEDING, Hits, Incidence
from erosion.maps.nearness import Nearness
from erosion.maps.options import MapOptions
from erosion.maps.result import MapSource, to_dataset
from erosion.maps.tally import Portion, Tally, portion_of
from erosion.models import load_model, model_name
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import quantities
from erosion.models.registry import require_loadable
from erosion.parameters.units import conversion_factor
from erosion.storage.identity import code_version, identity, require_code
from erosion.trajectory.trajectory import SimulationError

_PORTION = 2**18  # impacts, draws times rows: enough for all cores at once, a few tens of megabytes
_WRONG_WAY = 0.9  # share of rows from behind that no table of real impacts reaches
_NAMED = 3  # rows that are too far are named, the others counted


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
        values, ends, struck = bodies.of_rows(model, hits, number), len(end_names(model)), hits
        if not is_hit.all():
            struck, values = hits.part(is_hit), {name: value[is_hit] for name, value in values.items()}
        shape = (bodies.realisations, struck.rows)
        if not struck.rows:
            empty = np.zeros(shape)
            return portion_of(hits, struck, empty, empty.astype(np.int64), np.zeros(0, bool), self.patches, ends)
        common = bodies.common(model)
        each, p = bodies.impacts(model, struck, values | common)
        results = impact(each, p, rtol=self.options.rtol)
        volume = np.asarray(results.volume) * common.get(FRACTION, bodies.cutting_fraction)
        volume, outcome = np.broadcast_to(volume, shape), np.broadcast_to(results.outcome, shape)
        return portion_of(hits, struck, volume, outcome, outside_range(model, struck), self.patches, ends)


@functools.lru_cache(maxsize=4)
def _loaded(reference: str | Path) -> CuttingModel:
    """The model by name or path, loaded once by each worker."""
    return load_model(reference)


def compute_portion(task: Task, hits: Hits, number: int, code: str) -> tuple[int, Portion]:
    """Compute a portion on a worker; returns its number too.

    Raises:
        RuntimeError: where this process computes with other code than the map was begun with.
    """
    require_code(code, "map")
    return number, task.compute(hits, number)


@dataclasses.dataclass(frozen=True)
class MapJob:
    """A map whose arguments are checked."""

    task: Task
    impacts: Impacts
    surface: Surface | None

    def identity(self) -> dict[str, str]:
        """What the map depends on, in words; all files of the table are read for it.

        Raises:
            ValueError: for a model that computes by what only this process knows.
        """
        surface = "none"
        if self.surface is not None:
            arrays = (self.surface.points, self.surface.corners, self.surface.ends, self.surface.patch)
            surface = digest(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
        table = f"{self.impacts.title} {self.impacts.identity()}"
        bodies = self.task.options.bodies
        laws = "".join(f" {name} {law_digest(law)}" for name, law in {**bodies.laws, **bodies.uncertain}.items())
        options = f"{self._in_words()}; rtol = {self.task.options.rtol}{laws}"
        return identity({"map": self.task.model}, bodies.p, table=table, surface=surface, options=options)

    def laws_in_words(self) -> dict[str, str]:
        """By parameter, its law as a person reads it: "normal(2, 0.1)", "uncertain normal(2, 0.1)"."""
        bodies, known = self.task.options.bodies, quantities(self.task.model)
        words = {}
        for name, law in {**bodies.laws, **bodies.uncertain}.items():
            dimension = known[name].dimension if name in known else "1"
            kind = "uncertain " if name in bodies.uncertain else ""
            words[name] = kind + law.in_words(dimension, bodies.p.units)
        return words

    def run(self, progress: Progress = no_progress) -> xr.Dataset:
        """Read and compute the table; progress and errors as of `erosion_map`."""
        task, faces = self.task, 1 if self.surface is None else self.surface.faces
        ends = end_names(task.model)
        tally = Tally(faces, task.patches, len(ends), task.options.bodies.realisations)
        nearness = None if self.surface is None else Nearness(self.surface, self._limit)
        far: list[str] = []

        def add(portion: Portion) -> None:
            tally.add(portion)
            progress("map", tally.rows, self.impacts.rows or 0)

        self._compute(self._portions(nearness, far), add)
        self._require_hits(tally)
        if not tally.impacts.any():
            raise SimulationError(f"{model_name(task.model)}: of {tally.hits:,} impacts none could be computed.")
        notes = self.impacts.notes if nearness is None else (*self.impacts.notes, *nearness.sentences())
        rows = "" if nearness is None else nearness.far_in_words(far)
        source = MapSource(task.model, task.options.bodies, self.impacts, self.surface, self._in_words(), notes, rows)
        return to_dataset(tally, source, ends, task.options.density)

    def _compute(self, portions: Iterator[Hits], add: Callable[[Portion], None]) -> None:
        """Compute all portions, and add them in their order."""
        # Without the import there is no active cluster.
        if "distributed" in sys.modules:
            from erosion.cluster import active_client

            if (client := active_client()) is not None:
                self._compute_on(client, portions, add)
                return
        for number, hits in enumerate(portions):
            add(self.task.compute(hits, number))

    def _compute_on(self, client: Any, portions: Iterator[Hits], add: Callable[[Portion], None]) -> None:
        """The same by the workers of a cluster."""
        from erosion.cluster import run_blocks

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
        options = self.task.options
        factor = conversion_factor("length", options.bodies.p.units, "si")
        return None if options.limit is None else options.limit * factor

    def _portions(self, nearness: Nearness | None, far: list[str]) -> Iterator[Hits]:
        """All rows in portions of a fixed number, the last one of what is left.

        Args:
            nearness: takes note of all rows; None without a surface.
            far: gets the first rows that are too far.
        """
        options = self.task.options
        incidence = Incidence(self.surface, self.impacts.mesh_faces, options.restitution, self._limit)
        blocks, rows = self.impacts.blocks(_PORTION), max(1, _PORTION // options.bodies.realisations)
        try:
            held, count, is_first = list[Hits](), 0, True
            for block in blocks:
                hits = incidence.hits(block)
                far += incidence.too_far(block, hits, _NAMED - len(far))
                if nearness is not None:
                    nearness.add(block, hits)
                begin = 0
                while begin < hits.rows:
                    part = hits.part(slice(begin, begin + rows - count))
                    held.append(part)
                    begin, count = begin + part.rows, count + part.rows
                    if count == rows:
                        portion = Hits.joined(held)
                        if is_first:
                            self._require_right_place(nearness)
                            self._require_right_way(np.bincount(portion.fate, minlength=1 + len(LEFT_OUT)))
                        yield portion
                        held, count, is_first = [], 0, False
            self._require_right_place(nearness)
            if held:
                yield Hits.joined(held)
        finally:
            # A reader may read ahead in a thread, which must end before the process does.
            if isinstance(blocks, Generator):
                blocks.close()

    def _require_right_place(self, nearness: Nearness | None) -> None:
        """Refuse a surface on which the rows do not lie."""
        if nearness is not None:
            nearness.require(self.impacts.title)

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
            "them. Argument `restitution` must then be (e, μ) of the wall, which undoes it. Or the surface's normals "
            "point into the fluid, but must point out of it: Argument `reverse` turns them."
        )

    def _require_hits(self, tally: Tally) -> None:
        """Refuse a table of which no row hits."""
        title = self.impacts.title
        if not tally.rows:
            raise ImpactsError(f"{title}: must hold impacts, but holds none.")
        if not tally.lost_mass.any():  # with that of the rows that hit
            raise ImpactsError(f"{title}: every row has the weight 0, so there are no particles.")
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
            **bodies.laws,
            **{f"uncertain {name}": law for name, law in bodies.uncertain.items()},
            "draws": bodies.draws if bodies.uncertain else None,
            "seed": bodies.seed_used,
            "cutting_fraction": None if bodies.cutting_fraction == 1 else bodies.cutting_fraction,
            **{name: getattr(options, name) for name in ("restitution", "density", "limit")},
        }
        return ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)
