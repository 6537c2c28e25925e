import numpy as np
import pytest

from erosion.streams.tally import Estimate, Points


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_points_go_on_where_they_stopped(kind: str) -> None:
    whole = Points(kind, 3, 7, 2).take(64)
    np.testing.assert_array_equal(Points(kind, 3, 7, 2, skip=16).take(16), whole[:, 16:32])
    assert ((whole > 0) & (whole < 1)).all()


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_a_seed_has_its_own_points_and_so_has_each_sequence(kind: str) -> None:
    one, again, other = (Points(kind, 2, seed, 2).take(8) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one, again)
    assert not (one == other).any()
    assert not (one[0] == one[1]).any()


def test_sobol_points_lie_evenly() -> None:
    """2ⁿ of them: one in each interval of 2⁻ⁿ, along every axis."""
    for sequence in Points("sobol", 3, 5, 2).take(64):
        for axis in sequence.T:
            np.testing.assert_array_equal(np.sort((axis * 64).astype(int)), np.arange(64))


def test_an_estimate_is_students() -> None:
    mean = Estimate.of(np.array([1.0, 2.0, 3.0, 4.0]))
    assert mean.value == 2.5
    assert mean.error == pytest.approx(np.sqrt(5 / 3) / 2)
    # t of three degrees of freedom, 97.5 %.
    assert (mean.low, mean.high) == pytest.approx((2.5 - 3.182446 * mean.error, 2.5 + 3.182446 * mean.error), rel=1e-6)


def test_a_value_of_its_own_moves_the_interval_not_the_error() -> None:
    mean, moved = (Estimate.of(np.array([1.0, 3.0]), value) for value in (None, 7.0))
    assert (moved.value, moved.error) == (7, mean.error)
    assert moved.high - 7 == pytest.approx(mean.high - 2)
