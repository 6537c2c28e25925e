"""The blocks of a grid, each of which is computed and stored as one piece."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

Region = tuple[slice, ...]
"""The place of a block in its grid: one slice for each dimension."""


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
