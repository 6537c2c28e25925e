"""Posteriors hold the truth as often as they say: a sample of what benchmarks/sbc.py measures."""

import numpy as np
import pytest

from benchmarks.sbc import Ranks, calibrated

pytestmark = pytest.mark.slow


def deviation(result: Ranks) -> np.ndarray:
    """Kolmogorov and Smirnov's distance of the ranks from uniform ones, times the root of their number."""
    ordered = np.sort(result.ranks, axis=0)
    sets = len(ordered)
    steps = np.arange(sets + 1)[:, None] / sets
    return np.sqrt(sets) * np.maximum(steps[1:] - ordered, ordered - steps[:-1]).max(axis=0)


@pytest.mark.parametrize(("model", "known"), [("linearized", False), ("rotating", True)])
def test_ranks_of_the_truth_are_uniform(model, known):
    result = calibrated(model, 40, known=known, seed=1)
    # Exceeded once in a thousand times by right posteriors. Draws twice as narrow give 2.1 and more.
    assert (deviation(result) < 1.95).all()
    # Of 40 sets 90 % intervals hold the truth in 30 or more, but for one in 500.
    assert (result.covered.sum(axis=0) >= 30).all()


def test_ranks_of_posteriors_that_are_too_narrow_are_not():
    # What the test above would see of a sampler whose draws are half as wide.
    truth, draws = np.random.default_rng(0).standard_normal((2, 40, 400))
    ranks = np.mean(0.5 * draws < truth[:, :1], axis=1)
    narrow = Ranks(("k",), ranks[:, None], np.ones((40, 1), bool))
    biased = Ranks(("k",), np.mean(draws + 0.6 < truth[:, :1], axis=1)[:, None], np.ones((40, 1), bool))
    assert deviation(biased)[0] > 1.95
    quarter = np.sort(ranks)
    assert np.mean((quarter < 0.05) | (quarter > 0.95)) > 0.25
    assert deviation(narrow)[0] > 0
