"""Counts, moments and a histogram of the particles of a stream.

Tallies of parts add up to the tally of the whole, so a stream of any length needs the memory
of one block.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import xarray as xr

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
class Tally:
    """Sums over particles, in independent replicates.

    Args:
        scale: V* of the case, the unit of the histogram [volume].
        drawn: number of particles of each replicate.
        counted: number of particles with a volume (not "failed" or "unfinished"), shape (replicates,).
        mean: mean of their volumes [volume], shape (replicates,).
        squares: sum of squared deviations from the mean [volume²], shape (replicates,).
        mass: sum of their masses [mass], shape (replicates,).
        ends: number of particles by how their cut ended, shape (replicates, ends).
        bins: number of particles by the logarithm of their volume, shape (bins,); the first bin
            holds those that remove nothing.
    """

    scale: float
    drawn: int
    counted: np.ndarray
    mean: np.ndarray
    squares: np.ndarray
    mass: np.ndarray
    ends: np.ndarray
    bins: np.ndarray

    @classmethod
    def of(
        cls, volume: np.ndarray, mass: np.ndarray, ended_by: np.ndarray, ends: Sequence[str], scale: float
    ) -> "Tally":
        """The tally of particles; volumes [volume], masses [mass] and outcomes have the shape (replicates, n)."""
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
        )

    def to_dataset(self) -> xr.Dataset:
        """The tally as a Dataset; `from_dataset` restores it to the last bit."""
        variables = {name: (dims, getattr(self, name)) for name, dims in _DIMENSIONS.items()}
        return xr.Dataset(variables, attrs={"scale": self.scale, "drawn": self.drawn})

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> "Tally":
        """The tally of a Dataset with the variables and attributes of `to_dataset`."""
        arrays = {name: dataset[name].values for name in _DIMENSIONS}
        return cls(scale=float(dataset.attrs["scale"]), drawn=int(dataset.attrs["drawn"]), **arrays)

    @property
    def deviation(self) -> float:
        """The standard deviation of the volume from particle to particle [volume]."""
        total = self.counted.sum()
        mean = self.counted @ self.mean / total
        return float(np.sqrt((self.squares.sum() + self.counted @ (self.mean - mean) ** 2) / total))

    def quantile(self, share: float) -> float:
        """The volume that this share of the particles does not exceed [volume], to half a bin."""
        reached = np.cumsum(self.bins)
        index = int(np.searchsorted(reached, share * reached[-1]))
        return 0.0 if index == 0 else float(self.scale * 10 ** (_LOWEST + (index - 0.5) / _PER_DECADE))

    def histogram(self, bins: int = 60) -> tuple[np.ndarray, np.ndarray]:
        """Edges [volume], even in the logarithm, shape (m + 1,), and shares of the particles, shape (m,).

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
