"""Independent sequences of points, and estimates whose errors come from the spread of the sequences."""

import dataclasses
import math

import numpy as np
from scipy.special import stdtrit
from scipy.stats import qmc


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
