"""Streams of particles: from laws of the parameters to the erosion of a whole jet.

Particles are drawn, computed and tallied block by block, so that memory does not grow with
their number. Independent scramblings of the same sequence give the standard errors.
"""

import dataclasses
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Progress, check_path, check_share, check_whole, no_progress, refuse
from erosion.correlations.ranges import OutOfRangeWarning
from erosion.impacts import SimulationError, end_names, identity, impact, read_netcdf, write_netcdf
from erosion.interrupts import held_off
from erosion.laws import JointLaw, JointSamples, joint_law
from erosion.models import CuttingModel, load_model, model_name, own_quantities, quantities, require_one_impact
from erosion.ode.step_control import require_float64
from erosion.output import Trace, briefly, require_writable, trace
from erosion.parameters import Parameters, require_parameters, validate
from erosion.streams.result import Stream, best_nozzle_angle, uncertainty_of
from erosion.streams.tally import Estimate, Particles, Points, Tally, sobol_indices

MISS = "miss"
"""The outcome of a particle that flies away from the surface."""

REPLICATES = 16
_BLOCK = 2**14  # particles of a replicate in one block
_SENSITIVITY_POINTS = 2**11  # of a replicate; each takes (laws + 2) impacts


class StreamInterrupted(KeyboardInterrupt):
    """Ctrl-C during a stream; `partial` is the stream of the particles computed so far, or None."""

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
    correlation: Mapping[tuple[str, str], float] | None = None,
    samples: JointSamples | Mapping[str, Any] | None = None,
    uncertain: JointLaw | JointSamples | Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    **laws: Any,
) -> Stream:
    """The erosion of a stream of particles whose parameters vary.

        from scipy import stats
        erosion.stream("rotating", p, alpha=stats.norm(0.35, 0.05), v0=stats.lognorm(0.1, scale=110))

    Args:
        model: a model, its name or its path.
        p: the case, all scalars: the values of parameters without a law, and the particle that a law of `r` scales
            (see `Particles`).
        n: particles, rounded up to a multiple of the 16 replicates; powers of 2 are best.
        seed: of the points; the same seed gives the same stream.
        points: "sobol" (scrambled, with errors that fall nearly as 1/n) or "random".
        best_angle: also find the angle of the nozzle that removes most (2 million impacts).
        sensitivities: also find the share of the variance that each law causes (30 000 impacts for each law).
        rtol: see `impact`.
        store: a netCDF file, written at the end or when interrupted. The same call goes on from
            there, also to a greater n.
        correlation: of the normal scores of `laws`, by pairs: {("v0", "r"): -0.5}; see `JointLaw`.
        samples: arrays of other parameters [SI], by name, whose samples are drawn together.
        uncertain: laws of parameters that are one number for all particles, which is not known exactly, such as those
            of the metal: `uncertain=posterior.joint_samples()`. What they do to the means does not average out; it is
            their `parameter_errors`.
        progress: called with the name of the work, how much of it is done, and how much there is.
        **laws: parameter name, of the case or the model's own, to its law from particle to particle, in SI,
            see `erosion.laws`. Laws of positive parameters of the case are restricted to x > 0; the ranges of own
            parameters are not known.

    Returns:
        Mean and total volume, means of the quantities of the model's own, erosion per mass, shares of the outcomes,
        quantiles, Sobol's sensitivity indices, and the best angle, with standard errors.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`)
            that holds something else and stays as it is.
        SimulationError: where no particle's impact could be computed.
        StreamInterrupted: after Ctrl-C.

    Warns:
        OutOfRangeWarning: where a correlation is used outside of its range, with the share of the particles.
    """
    options = StreamOptions(n, seed, points, best_angle, sensitivities, rtol, store)
    require_parameters(p)
    model = load_model(model)
    beside: dict[str, Any] = {"known": quantities(model), "shown_in": p.shown_in}
    together = joint_law(laws, correlation=correlation, samples=samples, **beside)
    result = prepare_stream(model, p, together, options, joint_law(uncertain, "uncertain", **beside)).run(progress)
    if (finding := result.outside_of_range) is not None:
        warnings.warn(finding.text, OutOfRangeWarning, stacklevel=2)
    return result


@dataclasses.dataclass(frozen=True)
class StreamOptions:
    """Options of a stream; see `stream`.

    Raises:
        ValueError, TypeError: for an option that makes no sense.
    """

    n: int = 2**20
    seed: int = 0
    points: str = "sobol"
    best_angle: bool = True
    sensitivities: bool = True
    rtol: float = 1e-9
    store: str | Path | None = None

    def __post_init__(self) -> None:
        # Of whatever type numbers come, a store's identity must have the same words.
        object.__setattr__(self, "n", check_whole("n", self.n, 1))
        object.__setattr__(self, "seed", check_whole("seed", self.seed, 0))
        object.__setattr__(self, "rtol", check_share("rtol", self.rtol))
        refuse(
            "Argument ",
            (
                self.points not in ("sobol", "random"),
                f'`points` must be "sobol" or "random", but is {briefly(self.points)}.',
            ),
            (self.path is not None and self.path.suffix != ".nc", f"`store` must end in .nc, but is {self.path}."),
        )

    @property
    def path(self) -> Path | None:
        """The path of the store."""
        return None if self.store is None else check_path("store", self.store)


def prepare_stream(
    model: CuttingModel | str | Path,
    p: Parameters,
    laws: JointLaw,
    options: StreamOptions,
    uncertain: JointLaw,
) -> "StreamJob":
    """Check everything of a stream that can be known before computing; arguments and errors as of `stream`."""
    require_float64()
    model = load_model(model)
    validate(p)
    require_one_impact(model, p)
    particles = Particles(model, p, laws, uncertain)
    path = options.path
    if path is None:
        return StreamJob(particles, options, {}, None, None)
    points = f"{options.points} {options.seed}, {options.rtol}"
    own = own_quantities(type(model))
    # A store without the means of own quantities cannot go on.
    means = {"own_quantities": ", ".join(own)} if own else {}
    of_all = f"{laws.digest}, uncertain {uncertain.digest}"
    described = identity({"stream": model}, p, laws=of_all, points=points, **means)
    since = trace(path)
    begun = None if since is None else Tally.from_dataset(read_netcdf(path, described), own)
    require_writable(path)
    return StreamJob(particles, options, described, begun, since)


@dataclasses.dataclass(frozen=True)
class StreamJob:
    """A stream whose arguments are checked.

    Args:
        particles: model and case, and their laws.
        options: see `stream`.
        identity: of the store.
        begun: the tally that the store holds already.
        since: the trace of the store's file when it was read.
    """

    particles: Particles
    options: StreamOptions
    identity: Mapping[str, str]
    begun: Tally | None
    since: Trace

    def run(self, progress: Progress = no_progress) -> Stream:
        """Compute the stream; progress and errors as of `stream`."""
        tally, ends = self.begun, (MISS, *end_names(self.particles.model))
        with held_off("erosion: stops after this block; a second signal ends at once") as stop:

            def advance(work: str, done: int, total: int) -> None:
                progress(work, done, total)
                stop()

            try:
                for tally in self._tallies(ends):
                    advance("stream", tally.drawn * REPLICATES, self._total)
                result = self._evaluated(tally, ends, advance)
                stop()
            except KeyboardInterrupt:
                raise self._interrupted(tally, ends) from None
            except Exception:
                # The particles took longer to compute than to write.
                if tally is not None and tally is not self.begun:
                    self._save(Stream(self.particles, tally, ends))
                raise
            self._save(result)
        return result

    @property
    def _total(self) -> int:
        """All particles of the stream: n, rounded up to a multiple of the replicates."""
        return -(-self.options.n // REPLICATES) * REPLICATES

    def _tallies(self, ends: tuple[str, ...]) -> Iterator[Tally]:
        """The tally of all particles so far, after each block."""
        options, tally = self.options, self.begun
        drawn, wanted = 0 if tally is None else tally.drawn, self._total // REPLICATES
        points = Points(options.points, self.particles.dimension, options.seed, REPLICATES, skip=drawn)
        while drawn < wanted:
            # Sobol points come in powers of 2; the last block may have too many.
            block = points.take(_BLOCK)[:, : wanted - drawn]
            part = _tally(self.particles, block, ends, options.rtol)
            tally = part if tally is None else tally + part
            drawn = tally.drawn
            yield tally

    def _evaluated(self, tally: Tally | None, ends: tuple[str, ...], progress: Progress) -> Stream:
        """The result of all particles."""
        assert tally is not None
        particles, options = self.particles, self.options
        if not tally.counted.any():
            count = f"{tally.drawn * REPLICATES:,}"
            raise SimulationError(f"{model_name(particles.model)}: of {count} particles none could be computed.")
        indices = _sensitivities(particles, options.seed, options.rtol) if options.sensitivities else None
        nozzle = None
        if options.best_angle:
            nozzle = best_nozzle_angle(particles, options.points, options.seed, rtol=options.rtol, progress=progress)
        uncertainty = uncertainty_of(particles, options.seed, options.rtol)
        return Stream(particles, tally, ends, nozzle, indices, uncertainty=uncertainty)

    def _interrupted(self, tally: Tally | None, ends: tuple[str, ...]) -> StreamInterrupted:
        """Save the particles computed so far, and say how to go on."""
        if tally is None:
            return StreamInterrupted(f"interrupted before any of {self._total:,} particles was computed", None)
        partial = Stream(self.particles, tally, ends)
        self._save(partial)
        hint = "give a store to go on from there another time"
        if self.options.path is not None:
            hint = f"{self.options.path} holds them; the same command goes on from there"
        return StreamInterrupted(f"interrupted after {partial.n:,} of {self._total:,} particles; {hint}", partial)

    def _save(self, result: Stream) -> None:
        if self.options.path is not None:
            write_netcdf(result.to_dataset(), self.options.path, self.identity, self.since)


def _tally(particles: Particles, points: np.ndarray, ends: tuple[str, ...], rtol: float) -> Tally:
    """The tally of one block of points, shape (replicates, n, laws)."""
    model, p, hits = particles.impacts(particles.draw(points))
    results = impact(model, p, rtol=rtol)
    mass = np.broadcast_to(np.asarray(p.m), hits.shape)
    ended_by = np.where(hits, results.ended_by, MISS)
    scale = float(particles.typical[1].volume_scale)
    own = {name: np.where(hits, values, 0.0) for name, values in results.quantities.items()}
    return Tally.of(np.where(hits, results.volume, 0.0), mass, ended_by, ends, scale, own)


def _sensitivities(particles: Particles, seed: int, rtol: float) -> dict[str, tuple[Estimate, Estimate]] | None:
    """Sobol's indices (first order, total) of each input, from replicates; tied parameters are one input."""
    if len(particles.inputs) == 1:
        return None

    def volume(points: np.ndarray) -> np.ndarray:
        model, p, hits = particles.impacts(particles.draw(points))
        return np.where(hits, np.nan_to_num(impact(model, p, rtol=rtol).volume), 0.0)

    # Other points than the stream's, so that their errors are independent.
    seeds = np.random.SeedSequence([seed, 1]).spawn(REPLICATES)
    sizes = [*particles.inputs.values()]
    replicates = [sobol_indices(volume, sizes, _SENSITIVITY_POINTS, np.random.default_rng(child)) for child in seeds]
    first, total = np.swapaxes(np.array(replicates), 0, 1)
    if not np.isfinite(total).all():
        return None
    names = [", ".join(names) for names in particles.inputs]
    return {name: (Estimate.of(first[:, i]), Estimate.of(total[:, i])) for i, name in enumerate(names)}
