"""The blocks of a grid, each of which is computed and stored as one piece."""

import functools
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

Region = tuple[slice, ...]
"""The place of a block in its grid: one slice for each dimension."""


@runtime_checkable
class AnyGrid(Protocol):
    """What is computed and stored block by block: a grid of impacts, or of lanes of any problem."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        ...

    @property
    def lengths(self) -> dict[str, int]:
        """Length of each dimension, by name."""
        ...

    @property
    def labels(self) -> dict[str, np.ndarray]:
        """The values along each dimension, by name."""
        ...

    @functools.cached_property
    def identity(self) -> dict[str, str]:
        """In words, what the numbers depend on."""
        ...

    def __getitem__(self, region: Region) -> "AnyGrid":
        """The block of a region."""
        ...

    def variables(self) -> Mapping[str, Any]:
        """The arrays, each a `Variable`; `ended_by` comes last, and its code 0 means that nothing is computed."""
        ...

    def solve(self) -> dict[str, np.ndarray]:
        """Compute all of it, by name."""
        ...

    def labelled(self, values: Mapping[str, Any]) -> "xr.Dataset":
        """Arrays of the grid's shape as a Dataset."""
        ...

    def require_portable(self) -> None:
        """Refuse what the workers of a cluster cannot load."""
        ...


def block_shape(
    lengths: Mapping[str, int], chunks: Mapping[str, int] | None, least: int, usual: int
) -> tuple[int, ...]:
    """The shape of blocks: the last dimensions whole, up to `usual` impacts.

    Args:
        lengths: of the dimensions of the grid.
        chunks: lengths of blocks by dimension, from the user; other dimensions stay whole. None: choose.
        least: impacts that a block must have, if the grid has as many.
        usual: impacts that a block should have.

    Raises:
        ValueError: for an unknown dimension, a length that is no positive number, or blocks
            that are too small.
    """
    # Each model compiles to a program of its own, so a block has one model.
    longest = {dim: 1 if dim == "model" else n for dim, n in lengths.items()}
    if chunks is None:
        room, block = usual, {}
        for dim in reversed(list(longest)):
            pieces = math.ceil(longest[dim] / max(room, 1))
            block[dim] = math.ceil(longest[dim] / pieces)
            room //= block[dim]
        return tuple(block[dim] for dim in longest)
    if not isinstance(chunks, Mapping):
        raise TypeError(f"Argument `chunks` must give lengths by dimension, but is {chunks!r}.")
    for dim, length in chunks.items():
        if dim not in longest:
            raise ValueError(f"Argument `chunks` must name dimensions ({', '.join(longest)}), but has {dim!r}.")
        if not isinstance(length, int) or isinstance(length, bool) or length < 1:
            raise ValueError(f"Argument `chunks` must give positive whole numbers, but has {dim}={length!r}.")
    shape = tuple(min(chunks.get(dim, longest[dim]), longest[dim]) for dim in longest)
    if math.prod(shape) < min(least, math.prod(longest.values())):
        raise ValueError(
            f"Argument `chunks` must make blocks of at least {least:,} impacts, but makes blocks of "
            f"{math.prod(shape):,}."
        )
    return shape


def regions(shape: Sequence[int], block: Sequence[int]) -> Iterator[Region]:
    """The regions of all blocks, in the order of memory."""
    cuts = [
        [slice(begin, min(begin + step, n)) for begin in range(0, n, step)]
        for n, step in zip(shape, block, strict=True)
    ]
    return itertools.product(*cuts)
