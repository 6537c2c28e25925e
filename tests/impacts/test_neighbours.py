"""An impact's result depends on its own numbers alone, whatever is computed beside it."""

import itertools

import numpy as np
import pytest

import erosion
from erosion.lanes.lanewise import WIDTH


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
@pytest.mark.parametrize(("model", "order"), [*zip(erosion.available_models(), itertools.cycle([2, 1, 0]))])
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
