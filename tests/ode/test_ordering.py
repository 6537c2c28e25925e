import numpy as np
import pytest

from erosion.ode.batch import alike_together


def _spread(values: np.ndarray, tile: int) -> float:
    """The mean range of a tile, over the range of all."""
    return float(np.mean(np.ptp(values.reshape(-1, tile), axis=1)) / np.ptp(values))


def test_tiles_are_small_in_every_parameter() -> None:
    leaves = list(np.random.default_rng(0).random((2, 64 * 64)))
    order = alike_together(leaves, 64)
    assert np.array_equal(np.sort(order), np.arange(64 * 64))
    # 64 tiles halve each of two parameters three times: an eighth of the range, hardly more.
    assert all(_spread(leaf[order], 64) < 0.2 for leaf in leaves)
    assert all(_spread(leaf, 64) > 0.9 for leaf in leaves)


@pytest.mark.parametrize("size", [1, 5, 64, 65, 1000])
def test_every_lane_has_one_place(size: int) -> None:
    random = np.random.default_rng(1).random((3, size))
    for leaves in (
        random[:1],
        random,
        np.round(random),
        np.ones((2, size)),
        np.full((1, size), np.nan),
        np.full((1, size), np.inf),
    ):
        assert np.array_equal(np.sort(alike_together(list(leaves), 64)), np.arange(size))


def test_one_parameter_is_put_in_order() -> None:
    leaf = np.random.default_rng(2).random(500)
    constant = np.ones(500)
    # To within the two bytes of a key.
    assert np.allclose(leaf[alike_together([constant, leaf], 8)], np.sort(leaf), atol=1e-4)


def test_numbers_farther_apart_than_any_float_are_put_in_order() -> None:
    values = np.linspace(-1.0, 1.0, 1000) * 1.7e308
    order = alike_together([values, np.arange(1000.0)], 8)
    assert np.array_equal(np.sort(order), np.arange(1000))
