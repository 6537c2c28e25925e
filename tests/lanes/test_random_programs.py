"""Random functions: to the bit what NumPy computes, lane by lane, with vectors of every width, for every processor.

125 are tried each time. More, here ten thousand (seeds 1000 to 8999, and 0 to 1999 of whole numbers), take minutes:

    EROSION_RANDOM_FUNCTIONS=10000 .venv/bin/pytest -n 2 tests/lanes/test_random_programs.py
"""

import os

import jax
import numpy as np
import pytest

from erosion.lanes import passes
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.machine import Processor
from tests.lanes.interpreter import evaluate
from tests.lanes.random_programs import RandomFunction
from tests.lanes.test_lanewise import _machine

_SPECIAL = np.array([
    0.0, -0.0, 1.0, -1.0, 0.5, -2.5, np.inf, -np.inf, np.nan, 5e-324, -1e-310, 1e308, -1e308, 2.0**31, -(2.0**63),
    2.0**63, 2.0**64, 255.5, -128.0, 127.0, 3.0, 1e-40, 1e39, 63.0, 64.0, 65.0,
])  # fmt: skip
_SIZE = 8
_BLOCKS = int(os.environ.get("EROSION_RANDOM_FUNCTIONS", "125")) // 25  # of 25 functions
_TARGETS = [None, Processor("x86-64-v3", ""), Processor("x86-64", "")] if "x86" in _machine() else [None]


@pytest.mark.filterwarnings("ignore:(overflow|invalid value) encountered in cast")
@pytest.mark.parametrize("block", range(4 * _BLOCKS // 5))
def test_random_functions(block, monkeypatch):
    """Without the rule that may change a bit: one rounding of a product and a sum."""
    monkeypatch.setattr(passes, "_contract", lambda region: None)
    for seed in range(1000 + 25 * block, 1025 + 25 * block):
        compare_with_numpy(RandomFunction(seed, size=_SIZE), random_numbers(seed), seed)


def random_numbers(seed, *, exact=False):
    """Numbers of some lanes; whole ones where functions are to be exact."""
    random = np.random.default_rng(seed + 10**6)
    lanes = int(random.integers(1, 12))
    if exact:
        return [random.integers(-6, 7, lanes).astype(float) for _ in range(3)]
    return [
        np.where(
            random.random(lanes) < 0.5,
            random.choice(_SPECIAL, lanes),
            random.normal(size=lanes) * 10 ** random.uniform(-3, 3, lanes),
        )
        for _ in range(3)
    ]


@pytest.mark.parametrize("block", range(_BLOCKS // 5))
def test_random_functions_of_whole_numbers(block):
    """As the compiler is: one rounding or two give the same."""
    for seed in range(25 * block, 25 + 25 * block):
        compare_with_numpy(RandomFunction(seed, exact=True, size=_SIZE), random_numbers(seed, exact=True), seed)


def compare_with_numpy(function, numbers, seed):
    """Compare each lane's bits; the seed chooses the vectors' width and the processor."""
    closed = jax.make_jaxpr(function)(number, number, number)
    width, target = (8, 8, 8, 4, 2, 16)[seed % 6], _TARGETS[seed % len(_TARGETS)]
    results = Lanewise(function, (number,) * 3, width=width, target=target)(*numbers)
    for lane in range(numbers[0].size):
        expected = evaluate(closed, [np.float64(values[lane]) for values in numbers])
        for result, value in zip(jax.tree.leaves(results), expected, strict=True):
            assert result.dtype == value.dtype
            assert _same_bits(result[lane], value), (seed, lane)


def _same_bits(one, other):
    if other.dtype.kind != "f":
        return np.array_equal(one, other)
    nan = np.isnan(one) & np.isnan(other)
    return np.all(nan | ((one == other) & (np.signbit(one) == np.signbit(other))))


@pytest.mark.filterwarnings("ignore:(overflow|invalid value) encountered in cast")
def test_random_functions_are_xlas():
    """Where neither subnormal numbers, which XLA takes for zeros, nor a last digit decide: whole numbers, exactly."""
    for seed in range(3000, 3012):
        random = np.random.default_rng(seed)
        numbers = [random.integers(-6, 7, 9).astype(float) for _ in range(3)]
        function = RandomFunction(seed, exact=True, size=_SIZE)
        results, by_xla = Lanewise(function, (number,) * 3)(*numbers), jax.jit(function)
        for lane in range(9):
            expected = by_xla(*(values[lane] for values in numbers))
            for result, value in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
                np.testing.assert_array_equal(result[lane], np.asarray(value), f"seed {seed}, lane {lane}")
