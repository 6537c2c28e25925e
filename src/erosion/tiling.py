"""Lanes that are alike, put side by side: a block takes as many steps as its slowest lane."""

from collections.abc import Sequence

import numpy as np


def alike_together(leaves: Sequence[np.ndarray], tile: int) -> np.ndarray:
    """An order of lanes in which each `tile` of neighbours has similar parameters.

    Halves the lanes at the median of one parameter, each half at that of the next, and so on
    (a k-d tree), until a half is a tile.

    Args:
        leaves: for each parameter an array (lanes,); at least one.
        tile: lanes of a block.

    Returns:
        Indices of lanes, shape (lanes,).
    """
    order = np.arange(leaves[0].size)
    varying = [leaf for leaf in leaves if leaf.min() != leaf.max()]
    if len(varying) == 1:
        # Fast where they are in order, as they often are.
        return np.argsort(varying[0], kind="stable")

    def halve(some: np.ndarray, depth: int) -> None:
        half = -(-some.size // (2 * tile)) * tile
        if half >= some.size:
            return
        leaf = varying[depth % len(varying)]
        some[:] = some[np.argpartition(leaf[some], half)]
        halve(some[:half], depth + 1)
        halve(some[half:], depth + 1)

    if varying:
        halve(order, 0)
    return order
