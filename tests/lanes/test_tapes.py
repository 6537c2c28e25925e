"""Tapes: what lanes write at places of their own, and read there."""

import numpy as np
import pytest
from jax import lax

from erosion.lanes import lanewise, tapes
from erosion.lanes.flatten import NotForLanesError
from erosion.lanes.lanewise import Lanewise, number

X = np.linspace(1.2, 9.0, 21)
LENGTH = 40


def powers(x, token):
    """x, x², … up to 1000, and their sum as it is read again."""

    def writes(at):
        n, power, token = at
        return n + 2, power * x, tapes.write(0, token, n, power, -power)

    count, _, token = lax.while_loop(lambda at: at[1] < 1000, writes, (0, x, token))
    _, total = lax.while_loop(
        lambda at: at[0] < count, lambda at: (at[0] + 1, at[1] + tapes.read(0, token, at[0])), (0, token)
    )
    return count, total


@pytest.mark.parametrize("width", [1, 8])
def test_a_lane_writes_its_own_tape_and_reads_it(width):
    """Lanes that write no more leave theirs alone, in any order of lanes."""
    tape, order = np.full((X.size, LENGTH * 2), np.nan), np.random.default_rng(0).permutation(X.size)
    count, total = np.empty(X.size, np.int64), np.empty(X.size)
    Lanewise(powers, (number, number), width=width, tapes=1).run([X, np.zeros(())], order, [count, total], tapes=[tape])
    for x, row, n, sum_ in zip(X, tape, count, total, strict=True):
        expected = x ** np.arange(1, n // 2 + 1)
        np.testing.assert_allclose(row[:n:2], expected, rtol=1e-13)
        np.testing.assert_array_equal(row[1:n:2], -row[:n:2])
        assert expected[-1] < 1000 <= expected[-1] * x
        assert np.isnan(row[n:]).all()
        assert sum_ == 0


def test_xla_has_no_tapes(monkeypatch):
    """A sentence says so before anything runs."""
    monkeypatch.setattr(lanewise, "by_xla", lambda: True)
    with pytest.raises(NotForLanesError, match="tapes"):
        lanewise.compile_lanes(powers, (number, number), tapes=1)
