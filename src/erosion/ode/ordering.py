"""An order of lanes in which neighbours are similar: a vector takes as many steps as its slowest lane."""

from collections.abc import Sequence

import numpy as np

_KEYS = 2**16  # whole numbers of two bytes, which numpy sorts digit by digit
_BINS = 2**12
_CROWDED = 1 / 16  # share of the lanes in one bin, above which lanes are ranked instead


def alike_together(numbers: Sequence[np.ndarray], group: int) -> np.ndarray:
    """An order of lanes in which each `group` of neighbours has similar numbers.

    The first number's quantiles cut the lanes into strips. The next number's quantiles cut each strip, in
    alternating direction, so that the next strip begins near the end of this one.

    Args:
        numbers: arrays (lanes,); at least one.
        group: lanes of a vector.

    Returns:
        Indices of lanes, shape (lanes,).
    """
    lanes = numbers[0].size
    varying = [leaf for leaf in numbers if leaf.min() != leaf.max()]
    key = np.zeros(lanes, np.int64)
    strips = max(round((lanes / group) ** (1 / max(len(varying), 1))), 1)
    for i, leaf in enumerate(varying):
        # The last one sorts what is left within a strip.
        parts = strips if i < len(varying) - 1 else max(_KEYS // strips**i, 1)
        part = _quantile(leaf, parts)
        key = key * parts + np.where(key & 1, parts - 1 - part, part)
    return np.argsort(np.minimum(key, _KEYS - 1).astype(np.uint16), kind="stable")


def _quantile(leaf: np.ndarray, parts: int) -> np.ndarray:
    """To which of `parts` quantiles each number belongs."""
    low, high = leaf.min(), leaf.max()
    with np.errstate(all="ignore"):
        width = high - low
        scale = (_BINS - 1) / width
        if parts <= _BINS and np.isfinite(width) and np.isfinite(scale):
            bins = ((leaf - low) * scale).astype(np.intp)
            counts = np.bincount(bins, minlength=_BINS)
            if counts.max() <= _CROWDED * leaf.size:
                middle = np.cumsum(counts) - counts / 2
                return (middle * (parts / leaf.size)).astype(np.int64)[bins]
    # By rank: for numbers that lie close together, and those that are not finite.
    rank = np.empty(leaf.size, np.int64)
    rank[np.argsort(leaf)] = np.arange(leaf.size)
    return rank * parts // leaf.size
