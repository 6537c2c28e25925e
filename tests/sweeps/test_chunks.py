"""Blocks of a grid: they cover it once, are of a useful size, and lie as memory does."""

import inspect
import math
from collections.abc import Sequence

import numpy as np
import pytest

from erosion.sweeps.grid import block_shape, regions

NAMES = ("alpha", "k", "v0")


def lengths_of(shape: Sequence[int]) -> dict[str, int]:
    return dict(zip(NAMES, shape, strict=False))


@pytest.mark.parametrize("usual", [1, 7, 1000, 10**6])
@pytest.mark.parametrize("shape", [(1,), (100,), (3, 50), (10, 20, 30)])
def test_blocks_cover_the_grid_once(usual: int, shape: tuple[int, ...]) -> None:
    block = block_shape(lengths_of(shape), None, 1, usual)
    assert min(usual, math.prod(shape)) / 4 <= math.prod(block) <= max(usual, 1)
    covered = np.zeros(shape, int)
    for region in regions(shape, block):
        assert covered[region].size > 0
        covered[region] += 1
    assert (covered == 1).all()


@pytest.mark.parametrize(
    ("lengths", "chunks", "least", "usual", "block"),
    [
        # The last dimensions stay whole: a block is one piece of memory, or as few as may be.
        (lengths_of((10, 20, 30)), None, 1, 6000, (10, 20, 30)),
        (lengths_of((10, 20, 30)), None, 1, 2999, (4, 20, 30)),
        (lengths_of((10, 20, 30)), None, 1, 100, (1, 3, 30)),
        # Pieces of about one length: 3 of 34 rather than 2 of 40 and one of 20.
        (lengths_of((100,)), None, 1, 40, (34,)),
        # No block holds two models.
        ({"model": 3, "alpha": 10}, None, 1, 1000, (1, 10)),
        ({"model": 3, "alpha": 10}, {"model": 2, "alpha": 5}, 1, 1000, (1, 5)),
        # Chunks are what the user wants; the whole grid may be smaller than the least block.
        (lengths_of((300, 100)), {"alpha": 100}, 10_000, 0, (100, 100)),
        (lengths_of((300, 100)), {"alpha": 1000, "k": 50}, 10_000, 0, (300, 50)),
        (lengths_of((3,)), {"alpha": 3}, 10_000, 0, (3,)),
    ],
)
def test_the_shape_of_a_block(lengths, chunks, least, usual, block) -> None:
    assert block_shape(lengths, chunks, least, usual) == block


def test_regions_come_in_the_order_of_memory() -> None:
    numbers = np.arange(7 * 5).reshape(7, 5)
    assert [numbers[region].flat[0] for region in regions((7, 5), (3, 2))] == [0, 2, 4, 15, 17, 19, 30, 32, 34]


@pytest.mark.parametrize(
    ("chunks", "error", "message"),
    [
        ({"alpha": 99}, ValueError, "at least 10,000 impacts, but makes blocks of 9,900"),
        ({"beta": 1}, ValueError, r"name dimensions \(alpha, k\), but has 'beta'"),
        ({"alpha": 0}, ValueError, "positive whole numbers, but has alpha=0"),
        ({"alpha": True}, ValueError, "positive whole numbers, but has alpha=True"),
        ({"alpha": 2.5}, ValueError, r"positive whole numbers, but has alpha=2\.5"),
        (100, TypeError, "must give lengths by dimension, but is 100"),
    ],
)
def test_chunks_must_be_of_use(chunks, error: type[Exception], message: str) -> None:
    # Outside of the tests nothing checks types before.
    with pytest.raises(error, match=message):
        inspect.unwrap(block_shape)(lengths_of((300, 100)), chunks, 10_000, 0)
