"""Lanes that are alike, put side by side: a block takes as many steps as its slowest lane."""

import itertools
from collections.abc import Sequence

import numpy as np


def alike_together(leaves: Sequence[np.ndarray], tile: int) -> np.ndarray:
    """An order of lanes in which each `tile` of neighbours has similar parameters.

    Sorts the lanes by one parameter and cuts them into strips, each strip by the next
    parameter, and so on round, until a strip is a tile.

    Args:
        leaves: for each parameter an array (lanes,); at least one.
        tile: lanes of a block.

    Returns:
        Indices of lanes, shape (lanes,).
    """
    order = np.arange(leaves[0].size)
    varying = [leaf for leaf in leaves if leaf.min() != leaf.max()]

    def cut(some: np.ndarray, depth: int) -> None:
        tiles = -(-some.size // tile)
        # As many strips for each parameter whose turn is still to come.
        turn = depth % len(varying)
        strips = max(round(tiles ** (1 / (len(varying) - turn))), 2)
        # numpy sorts with the processor's vectors where stability is not asked for.
        some[:] = some[np.argsort(varying[turn][some])]
        if strips < tiles:
            ends = [round(i * tiles / strips) * tile for i in range(strips + 1)]
            for begin, end in itertools.pairwise(ends):
                cut(some[begin:end], depth + 1)

    if varying:
        cut(order, 0)
    return order
