import numpy as np
import pytest

import erosion
from erosion.engine.ordering import alike_together
from erosion.lanes.lanewise import WIDTH


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


def test_the_order_of_impacts_does_not_matter() -> None:
    """Bit for bit: a lane's neighbours have no say in its result."""
    rng = np.random.default_rng(3)
    count = 30 * WIDTH + 7
    p = erosion.TABLE_1.replace(alpha=rng.uniform(0.05, 1.5, count), phidot0=rng.uniform(-4e4, 4e4, count))
    shuffled = rng.permutation(count)
    one = erosion.impact("rotating", p)
    other = erosion.impact("rotating", p.replace(alpha=p.alpha[shuffled], phidot0=p.phidot0[shuffled]))
    assert np.array_equal(other.volume, one.volume[shuffled], equal_nan=True)
    assert np.array_equal(other.t_c, one.t_c[shuffled], equal_nan=True)
    assert np.array_equal(other.ended_by, one.ended_by[shuffled])
    # A few lanes alone, so that no other order is at work in them.
    for i in (0, count // 2, count - 1):
        assert erosion.impact("rotating", p.replace(alpha=p.alpha[i], phidot0=p.phidot0[i])).volume == one.volume[i]


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("model", erosion.available_models())
def test_the_place_in_a_block_does_not_matter(model: str, order: int) -> None:
    """Bit for bit: a block of equal lanes has equal results, and so has one lane among others."""
    rng = np.random.default_rng(order)
    count = 48
    p = erosion.TABLE_1.replace(
        alpha=rng.uniform(0.05, 1.5, count), phidot0=rng.uniform(-4e4, 4e4, count), k=rng.uniform(0.5, 3.0, count)
    )
    repeated = p.replace(**{name: np.repeat(getattr(p, name), WIDTH) for name in ("alpha", "phidot0", "k")})
    one, many = (erosion.impact(model, each, derivatives=order) for each in (p, repeated))
    for name in ("volume", "t_c", "dvolume", "d2volume")[: 2 + order]:
        each = getattr(many, name).reshape(count, WIDTH)
        assert np.array_equal(each, np.broadcast_to(getattr(one, name)[:, None], each.shape), equal_nan=True), name


def test_numbers_farther_apart_than_any_float_are_put_in_order() -> None:
    values = np.linspace(-1.0, 1.0, 1000) * 1.7e308
    order = alike_together([values, np.arange(1000.0)], 8)
    assert np.array_equal(np.sort(order), np.arange(1000))
