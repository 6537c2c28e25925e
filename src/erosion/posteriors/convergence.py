"""Whether draws are good: R̂ of ranks and effective numbers, by ArviZ."""

import numpy as np

from erosion.extras import library

RHAT = 1.01
"""The greatest R̂ of draws that agree (Vehtari et al. 2021)."""

EFFECTIVE = 100
"""The fewest effective draws of a chain, by which R̂ can be trusted (Vehtari et al. 2021)."""


def rhats(draws: np.ndarray) -> np.ndarray:
    """R̂ of ranks, shape (chains, draws, names) -> (names,): the spread of all chains over that of one.

    References:
        A. Vehtari, A. Gelman, D. Simpson, B. Carpenter, P.-C. Bürkner, Rank-normalization, folding, and localization:
        an improved R̂ for assessing convergence of MCMC, Bayesian Analysis 16 (2021) 667-718.
    """
    return _of_each(draws, "rhat")


def effective(draws: np.ndarray) -> np.ndarray:
    """The number of independent draws that say as much of the middle, shape (chains, draws, names) -> (names,)."""
    return _of_each(draws, "ess")


def _of_each(draws: np.ndarray, name: str) -> np.ndarray:
    function = getattr(library("arviz_stats.base.array", "posterior").array_stats, name)
    # Draws that are all the same have no R̂: of a law of one value.
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array([float(function(part, chain_axis=0, draw_axis=1)) for part in np.moveaxis(draws, -1, 0)])
