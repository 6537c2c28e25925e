"""The particles of a stream, and the counts, moments and indices that sum them up.

Tallies of parts add up to the tally of the whole, so a stream of any length needs the memory
of one block.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import xarray as xr
from scipy.special import stdtrit
from scipy.stats import qmc

from erosion.arguments import refuse
from erosion.laws import JointLaw
from erosion.models import CuttingModel, ranges, with_values
from erosion.parameters import STEEPEST, Parameters


@dataclasses.dataclass(frozen=True)
class Particles:
    """Model and case, and the laws of their parameters; `draw` makes particles, `impacts` aims them.

    Where `r` varies, particles are scaled copies of the case's particle: b grows with r and m
    with r³, unless b and m have laws of their own.

    Angles need no cut-off. A particle at more than 90° comes from the other side: it is the
    mirror image of a particle at 180° - α with the opposite spin. A particle below 0° (or above
    180°) flies away from the surface and misses it.

    Args:
        model: the model of the cut.
        p: the case, all scalars.
        laws: of parameters of the case or the model's own, from particle to particle.
        uncertain: the same for parameters that are one number for all particles, which is not known exactly.

    Raises:
        ValueError, TypeError: for laws that make no sense; there must be one of either kind.
    """

    model: CuttingModel
    p: Parameters
    laws: JointLaw
    uncertain: JointLaw = dataclasses.field(default_factory=JointLaw)

    def __post_init__(self) -> None:
        if not self.names:
            raise ValueError("Arguments must include a law, such as v0=scipy.stats.norm(110, 10); there is none.")
        both = [name for name in self.uncertain.names if name in self.laws.names]
        refuse(
            "Argument `uncertain` must ",
            (both,
             f"name parameters without another law, but {', '.join(both[:1])} has one from particle to particle."),
            ("cutting_fraction" in self.names,
             "leave out `cutting_fraction`: volumes of a stream are those of particles that cut, whose share is a "
             "number."),
        )  # fmt: skip
        # So that an own parameter that cannot be an array is refused before anything is computed.
        self.impacts(self._medians)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that vary or are uncertain."""
        return self.laws.names + self.uncertain.names

    @functools.cached_property
    def _of_particle(self) -> JointLaw:
        return self.laws.within(ranges(self.model))

    @functools.cached_property
    def _of_all(self) -> JointLaw:
        return self.uncertain.within(ranges(self.model))

    @functools.cached_property
    def inputs(self) -> dict[tuple[str, ...], int]:
        """Independent inputs, the parameters of each, and its uniform numbers."""
        return self._of_particle.inputs | self._of_all.inputs

    @property
    def dimension(self) -> int:
        """How many uniform numbers a particle is made from."""
        return sum(self.inputs.values())

    def draw(self, points: np.ndarray, draws: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """The parameters that vary or are uncertain; each particle gets uncertain ones of its own without `draws`.

        Args:
            points: in (0, 1), shape (…, dimension); with `draws` without the numbers of the uncertain parameters.
            draws: in (0, 1), for the same particles with each draw of the uncertain parameters, shape (draws, 1, those
                of the uncertain parameters).

        Returns:
            Values by name, shape (…); the laws of positive parameters are restricted to x > 0.
        """
        own = self._of_particle.dimension
        uncertain = points[..., own:] if draws is None else draws
        return self._grown(self._of_particle.draw(points[..., :own]) | self._of_all.draw(uncertain))

    @property
    def dimensions(self) -> tuple[int, int]:
        """How many uniform numbers the laws from particle to particle take, and the uncertain parameters."""
        return self._of_particle.dimension, self._of_all.dimension

    def _grown(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The same, with width and mass of scaled particles where the size varies."""
        if "r" in values:
            scaled = self.p.similar(values["r"] / float(self.p.r))
            for name in ("b", "m"):
                values.setdefault(name, np.asarray(getattr(scaled, name)))
        return values

    @property
    def nozzle(self) -> float:
        """The nozzle's angle [rad]: the median of the angles, or the case's."""
        return self._medians["alpha"].item() if "alpha" in self.names else float(self.p.alpha)

    @property
    def typical(self) -> tuple[CuttingModel, Parameters]:
        """Model and case of one particle with each law at its median."""
        return self.impacts({name: value.reshape(()) for name, value in self._medians.items()})[:2]

    @functools.cached_property
    def _medians(self) -> dict[str, np.ndarray]:
        """One particle, each law at its median; shape (1,)."""
        return self._grown(self._of_particle.medians | self._of_all.medians)

    def impacts(
        self, values: Mapping[str, np.ndarray], nozzle: float | np.ndarray | None = None
    ) -> tuple[CuttingModel, Parameters, np.ndarray]:
        """The particles as impacts, and whether they hit the surface.

        Args:
            values: from `draw`.
            nozzle: turn the nozzle to this angle, or to several that broadcast against the
                particles [rad]; the deviations from it stay.

        Returns:
            Model, parameters in range, and the mask of the hits, of their shape. A miss gets an angle of 90°.
        """
        shape = np.broadcast_shapes(*(value.shape for value in values.values()))
        alpha = np.broadcast_to(values.get("alpha", np.asarray(self.p.alpha)), shape)
        if nozzle is not None:
            alpha = nozzle + (alpha - self.nozzle)
        hits = np.asarray((alpha > 0) & (alpha < np.pi))
        mirrored = alpha > STEEPEST
        folded = np.where(hits, np.where(mirrored, np.pi - alpha, alpha), STEEPEST)
        spin = values.get("phidot0", np.asarray(self.p.phidot0))
        changes = {**values, "alpha": folded, "phidot0": np.where(mirrored, -spin, spin)}
        return *with_values(self.model, self.p, changes), hits


_LOWEST = -24  # decades of the volume over V*; smaller volumes are in the first bin
_HIGHEST = 6
_PER_DECADE = 1000
BIN_RATIO = 10 ** (1 / _PER_DECADE)
"""Upper over lower edge of a histogram bin: half of a bin, 0.12 %, is the accuracy of a quantile."""


_DIMENSIONS = {
    "counted": ("replicate",),
    "mean": ("replicate",),
    "squares": ("replicate",),
    "mass": ("replicate",),
    "ends": ("replicate", "end"),
    "bins": ("bin",),
}


@dataclasses.dataclass(frozen=True)
class Mean:
    """The mean of a number over the particles of each replicate for which it is known.

    Args:
        counted: number of these particles, shape (replicates,).
        mean: of their numbers, shape (replicates,).
    """

    counted: np.ndarray
    mean: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "Mean":
        """Of particles, shape (replicates, n); NaN is not known."""
        known = np.isfinite(values)
        counted = known.sum(axis=1)
        return cls(counted, np.where(known, values, 0.0).sum(axis=1) / np.maximum(counted, 1))

    def __add__(self, other: "Mean") -> "Mean":
        """Of the particles of both."""
        counted = self.counted + other.counted
        share = other.counted / np.maximum(counted, 1)
        return Mean(counted, self.mean + (other.mean - self.mean) * share)


@dataclasses.dataclass(frozen=True)
class Tally:
    """Sums over particles, in independent replicates.

    Args:
        scale: V* of the case, the unit of the histogram [m³].
        drawn: number of particles of each replicate.
        counted: number of particles with a volume (not "failed" or "unfinished"), shape (replicates,).
        mean: mean of their volumes [m³], shape (replicates,).
        squares: sum of squared deviations from the mean [m⁶], shape (replicates,).
        mass: sum of their masses [kg], shape (replicates,).
        ends: number of particles by how their cut ended, shape (replicates, ends).
        bins: number of particles by the logarithm of their volume, shape (bins,); the first bin
            holds those that remove nothing.
        own: means of the quantities of the model's own, by name.
    """

    scale: float
    drawn: int
    counted: np.ndarray
    mean: np.ndarray
    squares: np.ndarray
    mass: np.ndarray
    ends: np.ndarray
    bins: np.ndarray
    own: Mapping[str, Mean] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        volume: np.ndarray,
        mass: np.ndarray,
        ended_by: np.ndarray,
        ends: Sequence[str],
        scale: float,
        own: Mapping[str, np.ndarray] | None = None,
    ) -> "Tally":
        """The tally of particles; volumes [m³], masses [kg], outcomes and own quantities: (replicates, n)."""
        computed = np.isfinite(volume)
        counted = computed.sum(axis=1)
        volume = np.where(computed, volume, 0.0)
        mean = volume.sum(axis=1) / np.maximum(counted, 1)
        return cls(
            scale=scale,
            drawn=volume.shape[1],
            counted=counted,
            mean=mean,
            squares=np.where(computed, (volume - mean[:, None]) ** 2, 0.0).sum(axis=1),
            mass=np.where(computed, mass, 0.0).sum(axis=1),
            ends=np.stack([(ended_by == end).sum(axis=1) for end in ends], axis=1),
            bins=_count(volume[computed] / scale),
            own={name: Mean.of(values) for name, values in (own or {}).items()},
        )

    def __add__(self, other: "Tally") -> "Tally":
        """The tally of all particles (moments after Chan, Golub and LeVeque, 1983)."""
        counted = self.counted + other.counted
        share = other.counted / np.maximum(counted, 1)
        difference = other.mean - self.mean
        return Tally(
            scale=self.scale,
            drawn=self.drawn + other.drawn,
            counted=counted,
            mean=self.mean + difference * share,
            squares=self.squares + other.squares + difference**2 * self.counted * share,
            mass=self.mass + other.mass,
            ends=self.ends + other.ends,
            bins=self.bins + other.bins,
            own={name: mean + other.own[name] for name, mean in self.own.items()},
        )

    def to_dataset(self) -> xr.Dataset:
        """The tally as a Dataset; `from_dataset` restores it to the last bit."""
        variables = {name: (dims, getattr(self, name)) for name, dims in _DIMENSIONS.items()}
        for name, mean in self.own.items():
            variables |= {f"replicate_{part}_{name}": (("replicate",), values) for part, values in vars(mean).items()}
        return xr.Dataset(variables, attrs={"scale": self.scale, "drawn": self.drawn})

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, own: Iterable[str] = ()) -> "Tally":
        """The tally of a Dataset with the variables and attributes of `to_dataset`; `own` names own quantities."""
        arrays = {name: dataset[name].values for name in _DIMENSIONS}
        fields = [field.name for field in dataclasses.fields(Mean)]
        means = {name: Mean(**{part: dataset[f"replicate_{part}_{name}"].values for part in fields}) for name in own}
        return cls(scale=float(dataset.attrs["scale"]), drawn=int(dataset.attrs["drawn"]), own=means, **arrays)

    @property
    def deviation(self) -> float:
        """The standard deviation of the volume from particle to particle [m³]."""
        total = self.counted.sum()
        mean = self.counted @ self.mean / total
        return float(np.sqrt((self.squares.sum() + self.counted @ (self.mean - mean) ** 2) / total))

    def quantile(self, share: float) -> float:
        """The volume that this share of the particles does not exceed [m³], to half a bin."""
        reached = np.cumsum(self.bins)
        index = int(np.searchsorted(reached, share * reached[-1]))
        return 0.0 if index == 0 else float(self.scale * 10 ** (_LOWEST + (index - 0.5) / _PER_DECADE))

    def histogram(self, bins: int = 60) -> tuple[np.ndarray, np.ndarray]:
        """Edges [m³], even in the logarithm, shape (m + 1,), and shares of the particles, shape (m,).

        Particles that remove nothing are in no bin. The bins span the middle 99.8 % of the others.
        """
        cutting = self.bins[1:]
        reached = np.cumsum(cutting) / max(cutting.sum(), 1)
        first, last = (int(np.searchsorted(reached, share)) for share in (0.001, 0.999))
        width = max(1, -(-(last + 1 - first) // bins))
        count = -(-(last + 1 - first) // width)
        counts = np.zeros(count * width, np.int64)
        part = cutting[first : first + count * width]
        counts[: len(part)] = part
        edges = self.scale * 10.0 ** (_LOWEST + (first + width * np.arange(count + 1)) / _PER_DECADE)
        return edges, counts.reshape(count, width).sum(axis=1) / max(self.bins.sum(), 1)


def _count(volume: np.ndarray) -> np.ndarray:
    """The histogram of volumes over V*, shape (bins,)."""
    bins = (_HIGHEST - _LOWEST) * _PER_DECADE
    removed = volume[volume > 0]
    index = np.clip(((np.log10(removed) - _LOWEST) * _PER_DECADE).astype(np.int64), 0, bins - 1)
    counts = np.bincount(index + 1, minlength=bins + 1)
    counts[0] = len(volume) - len(removed)
    return counts


class Points:
    """Points of the unit cube, in independent sequences.

    Args:
        kind: "sobol" (scrambled) or "random".
        dimension: of the cube.
        seed: of all sequences.
        sequences: number of sequences.
        skip: number of points of each sequence that were taken before.
    """

    def __init__(self, kind: str, dimension: int, seed: int, sequences: int, skip: int = 0) -> None:
        self._dimension = dimension
        generators = [np.random.PCG64(child) for child in np.random.SeedSequence(seed).spawn(sequences)]
        if kind == "random":
            # Each number takes one step of the generator.
            self._random = [np.random.Generator(bits.advance(skip * dimension)) for bits in generators]
            self._sobol = []
            return
        self._random = []
        self._sobol = [qmc.Sobol(dimension, scramble=True, rng=np.random.Generator(bits)) for bits in generators]
        for sampler in self._sobol if skip else []:
            sampler.fast_forward(skip)

    def take(self, count: int) -> np.ndarray:
        """The next points of each sequence, shape (sequences, count, dimension), in (0, 1)."""
        # Neither 0 nor 1 may come out: random numbers are multiples of 2⁻⁵³, Sobol points of 2⁻³⁰.
        if self._random:
            return np.stack([generator.random((count, self._dimension)) for generator in self._random]) + 2.0**-54
        return np.stack([sampler.random(count) for sampler in self._sobol]) + 2.0**-31


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with its standard error, from independent replicates.

    Args:
        value: the estimate.
        error: its standard error: the standard deviation of the replicates over the root of their number.
        low, high: the 95 % confidence interval, by Student's t.
    """

    value: float
    error: float
    low: float
    high: float

    @classmethod
    def of(cls, replicates: np.ndarray, value: float | None = None) -> "Estimate":
        """From one number a replicate, shape (n,), n ≥ 2; `value` takes the place of their mean."""
        n = len(replicates)
        centre = float(np.mean(replicates)) if value is None else value
        error = float(np.std(replicates, ddof=1)) / math.sqrt(n)
        half = float(stdtrit(n - 1, 0.975)) * error
        return cls(centre, error, centre - half, centre + half)


def sobol_indices(
    function: Callable[[np.ndarray], np.ndarray], sizes: Sequence[int], n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The shares of a function's variance that each input causes alone, and with its interactions.

    Numbers of one input, as tied parameters have, change together: the index is that of the group.

    Args:
        function: from points of the unit cube, shape (n, numbers), to values, shape (n,).
        sizes: how many numbers each input has.
        n: points, a power of 2; the function is computed for (inputs + 2) times as many.
        rng: of the points' scrambling.

    Returns:
        First-order and total indices, each of shape (inputs,); NaN for a function without variance.

    References:
        A. Saltelli et al., Variance based sensitivity analysis of model output, Comput. Phys. Commun. 181 (2010)
        259-270: first order as in their table 2 (b), total after Jansen, (f).
    """
    numbers = sum(sizes)
    points = np.clip(qmc.Sobol(2 * numbers, rng=rng, bits=64).random(n), 2.0**-31, 1 - 2.0**-31)
    one, other = points[:, :numbers], points[:, numbers:]
    ends = np.cumsum([0, *sizes])
    mixed = np.repeat(one[None], len(sizes), axis=0)
    for i, (begin, end) in enumerate(itertools.pairwise(ends)):
        mixed[i, :, begin:end] = other[:, begin:end]
    values = function(np.concatenate([one, other, *mixed])).reshape(-1, n)
    # The first-order estimate has less noise about the mean.
    values = values - values[:2].mean()
    of_one, of_other, of_mixed = values[0], values[1], values[2:]
    variance = values[:2].var()
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.mean(of_other * (of_mixed - of_one), axis=1) / variance
        total = np.mean((of_one - of_mixed) ** 2, axis=1) / (2 * variance)
    return first, total
