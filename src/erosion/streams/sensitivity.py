"""Sobol's indices of inputs of one or several uniform numbers each."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import qmc


def sobol_indices(
    function: Callable[[np.ndarray], np.ndarray], sizes: Sequence[int], n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The shares of a function's variance that each input causes alone, and with its interactions.

    Numbers of one input, as a joint law has, change together: the index is that of the group.

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
