"""Streams of particles: distributions of the parameters to the erosion of a whole jet.

Particles are drawn, computed, tallied and forgotten block by block, so that memory does not
grow with their number. Independent scramblings of the same sequence give the standard errors.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from erosion.arguments import check_path, check_tolerance, check_whole
from erosion.engine.impact import impact
from erosion.engine.outcomes import end_names
from erosion.files import require_writable
from erosion.models import load_model, model_name
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import require_one_impact
from erosion.parameters.parameters import Parameters, validate
from erosion.parameters.precision import require_float64
from erosion.storage.identity import identity
from erosion.storage.netcdf import read_netcdf, write_netcdf
from erosion.streams.nozzle import best_nozzle_angle
from erosion.streams.particles import Particles
from erosion.streams.replicates import Estimate, Points
from erosion.streams.result import Stream
from erosion.streams.tally import Tally
from erosion.trajectory.trajectory import SimulationError

MISS = "miss"
"""What becomes of a particle that flies away from the surface."""

REPLICATES = 16
_BLOCK = 2**14  # particles of a replicate in one round
_SENSITIVITY_POINTS = 2**11  # of a replicate; each takes as many impacts times (laws + 2)


class StreamInterrupted(KeyboardInterrupt):
    """Ctrl-C during a stream; `partial` is the stream of what had been computed, or None."""

    def __init__(self, message: str, partial: Stream | None) -> None:
        super().__init__(message)
        self.partial = partial


def stream(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    n: int = 2**20,
    seed: int = 0,
    points: str = "sobol",
    best_angle: bool = True,
    sensitivities: bool = True,
    rtol: float = 1e-9,
    store: str | Path | None = None,
    progress: Callable[[str, int, int], object] | None = None,
    **distributions: Any,
) -> Stream:
    """The erosion of a stream of particles whose parameters vary.

        from erosion.distributions import LogNormal, Normal
        erosion.stream("rotating", p, alpha=Normal(0.35, 0.05), v0=LogNormal(4400, 0.1))

    Args:
        model: a model, its name or its path.
        p: the case, all scalars: what has no distribution, and for a distribution of `r` the
            particle that is scaled (see `Particles`).
        n: particles, rounded up to a multiple of the 16 replicates; powers of 2 are best.
        seed: of the points; the same seed gives the same stream.
        points: "sobol" (scrambled, with errors that fall nearly as 1/n) or "random".
        best_angle: also look for the angle of the nozzle that removes most (2 million impacts).
        sensitivities: also tell which law the variance comes from (30 000 impacts for each law).
        rtol: see `impact`.
        store: a netCDF file, written at the end or when interrupted. The same call goes on from
            it, also to a greater n.
        progress: called with what is being done, how much of it is, and how much there is.
        **distributions: parameter name, of the case or the model's own, to its law, see
            `erosion.distributions`. Laws of positive parameters of the case are restricted to x > 0;
            of own parameters no range is known.

    Returns:
        Mean and total volume, erosion per mass, how the particles end, quantiles, Sobol's
        sensitivity indices, and the best angle, with standard errors.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`)
            that holds something else, which is left as it is.
        SimulationError: where no particle's impact could be computed.
        StreamInterrupted: after Ctrl-C.
    """
    job = prepare_stream(
        model,
        p,
        n=n,
        seed=seed,
        points=points,
        best_angle=best_angle,
        sensitivities=sensitivities,
        rtol=rtol,
        store=store,
        **distributions,
    )
    return job.run(progress)


def prepare_stream(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    n: int = 2**20,
    seed: int = 0,
    points: str = "sobol",
    best_angle: bool = True,
    sensitivities: bool = True,
    rtol: float = 1e-9,
    store: str | Path | None = None,
    **distributions: Any,
) -> "StreamJob":
    """Everything of a stream that can be known before computing; arguments and errors as of `stream`."""
    require_float64()
    model = load_model(model)
    validate(p)
    require_one_impact(model, p)
    particles = Particles(model, p, distributions)
    n, seed, rtol = check_whole("n", n, 1), check_whole("seed", seed, 0), check_tolerance(rtol)
    path = None if store is None else check_path("store", store)
    _check(points, path)
    known: dict[str, str] = {}
    begun = None
    if path is not None:
        laws = ", ".join(f"{name} {law!r}" for name, law in distributions.items())
        known = identity({"stream": model}, p, distributions=laws, points=f"{points} {seed}, {rtol}")
        if path.exists():
            begun = Tally.from_dataset(read_netcdf(path, known))
        require_writable(path)
    return StreamJob(particles, n, seed, points, best_angle, sensitivities, rtol, path, known, begun)


@dataclasses.dataclass(frozen=True)
class StreamJob:
    """A stream whose arguments make sense.

    Args:
        particles: model and case, and their laws.
        n, seed, points, best_angle, sensitivities, rtol: see `stream`.
        path: of the store, if there is one.
        known: the store's identity.
        begun: what the store holds already.
    """

    particles: Particles
    n: int
    seed: int
    points: str
    best_angle: bool
    sensitivities: bool
    rtol: float
    path: Path | None
    known: Mapping[str, str]
    begun: Tally | None

    def run(self, progress: Callable[[str, int, int], object] | None = None) -> Stream:
        """Compute it; progress and errors as of `stream`."""
        particles, tally = self.particles, self.begun
        ends = (MISS, *end_names(particles.model))
        report = progress or (lambda what, done, total: None)
        whole = -(-self.n // REPLICATES)
        drawn = 0 if tally is None else tally.drawn
        supply = Points(self.points, len(particles.laws), self.seed, REPLICATES, skip=drawn)
        try:
            while drawn < whole:
                # Sobol points come in powers of 2; of the last block some may be left.
                block = supply.take(_BLOCK)[:, : whole - drawn]
                part = _tally(particles, block, ends, self.rtol)
                tally = part if tally is None else tally + part
                drawn = tally.drawn
                report("stream", drawn * REPLICATES, whole * REPLICATES)
            assert tally is not None
            if not tally.counted.any():
                raise SimulationError(
                    f"{model_name(particles.model)}: of {drawn * REPLICATES:,} particles none could be computed."
                )
            indices = _sensitivities(particles, self.seed, self.rtol) if self.sensitivities else None
            nozzle = None
            if self.best_angle:
                turned = functools.partial(report, "angles")
                nozzle = best_nozzle_angle(particles, self.points, self.seed, rtol=self.rtol, progress=turned)
        except KeyboardInterrupt:
            if tally is None:
                raise StreamInterrupted(
                    f"interrupted before any of {whole * REPLICATES:,} particles was computed", None
                ) from None
            partial = Stream(particles, tally, ends)
            self._save(partial)
            where = "give a store to go on from there another time"
            if self.path is not None:
                where = f"{self.path} holds them; the same command goes on from there"
            raise StreamInterrupted(
                f"interrupted after {partial.n:,} of {whole * REPLICATES:,} particles; {where}", partial
            ) from None
        result = Stream(particles, tally, ends, nozzle, indices)
        self._save(result)
        return result

    def _save(self, result: Stream) -> None:
        if self.path is not None:
            write_netcdf(result.to_dataset(), self.path, self.known)


def _check(points: str, path: Path | None) -> None:
    if points not in ("sobol", "random"):
        raise ValueError(f'Argument `points` must be "sobol" or "random", but is {points!r}.')
    if path is not None and path.suffix != ".nc":
        raise ValueError(f"Argument `store` must end in .nc, but is {path}.")


def _tally(particles: Particles, points: np.ndarray, ends: tuple[str, ...], rtol: float) -> Tally:
    """Of one block of points, shape (replicates, n, laws)."""
    model, p, hits = particles.impacts(particles.draw(points))
    results = impact(model, p, rtol=rtol)
    mass = np.broadcast_to(np.asarray(p.m), hits.shape)
    ended_by = np.where(hits, results.ended_by, MISS)
    scale = float(particles.typical[1].volume_scale)
    return Tally.of(np.where(hits, results.volume, 0.0), mass, ended_by, ends, scale)


def _sensitivities(particles: Particles, seed: int, rtol: float) -> dict[str, tuple[Estimate, Estimate]] | None:
    """Sobol's indices, each from independent replicates (Saltelli et al., 2010)."""
    if len(particles.laws) == 1:
        return None

    def volume(points: np.ndarray) -> np.ndarray:
        model, p, hits = particles.impacts(particles.draw(points.T))
        return np.where(hits, np.nan_to_num(impact(model, p, rtol=rtol).volume), 0.0)

    uniform = [stats.uniform(2.0**-31, 1 - 2.0**-30)] * len(particles.laws)
    # Other points than the stream's, so that their errors have nothing to do with each other.
    seeds = np.random.SeedSequence([seed, 1]).spawn(REPLICATES)
    indices = [
        stats.sobol_indices(func=volume, n=_SENSITIVITY_POINTS, dists=uniform, rng=np.random.default_rng(one))
        for one in seeds
    ]
    first, total = (np.array([getattr(one, name) for one in indices]) for name in ("first_order", "total_order"))
    if not np.isfinite(total).all():
        return None
    return {name: (Estimate.of(first[:, i]), Estimate.of(total[:, i])) for i, name in enumerate(particles.laws)}
