"""Every primitive of scalars against numpy or JAX, on lanes that hold NaN, infinities and zeros of either sign."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from erosion.lanes.lanewise import Lanewise, number

_SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, np.inf, -np.inf, np.nan, 5e-324, -1e-310, 1e308, -1e308]
_RANDOM = np.random.default_rng(1958)
X, Y = (
    np.concatenate([np.repeat(_SPECIAL, len(_SPECIAL)), _RANDOM.normal(size=300) * 10 ** _RANDOM.uniform(-3, 3, 300)]),
    np.concatenate([np.tile(_SPECIAL, len(_SPECIAL)), _RANDOM.normal(size=300) * 10 ** _RANDOM.uniform(-3, 3, 300)]),
)
WHOLE = jax.ShapeDtypeStruct((), np.int64)
M = np.concatenate([np.array([0, 1, -1, 2, -2, 63, 64, 65, 7, -7]), _RANDOM.integers(-1000, 1000, 90)])
N = np.concatenate([np.array([0, 0, 0, -1, 1, 1, 2, 3, -3, 3]), _RANDOM.integers(-9, 9, 90)])


def _same_bits(one, other):
    nan = np.isnan(one) & np.isnan(other)
    return np.all(nan | ((one == other) & (np.signbit(one) == np.signbit(other))))


@pytest.mark.parametrize(
    ("function", "exact"),
    [
        (lax.add, np.add), (lax.sub, np.subtract), (lax.mul, np.multiply), (lax.div, np.divide),
        (lambda x, y: lax.neg(x), lambda x, y: -x), (lambda x, y: lax.abs(x), lambda x, y: np.abs(x)),
        (lambda x, y: lax.sqrt(x), lambda x, y: np.sqrt(x)), (lambda x, y: lax.floor(x), lambda x, y: np.floor(x)),
        (lambda x, y: lax.ceil(x), lambda x, y: np.ceil(x)), (lambda x, y: jnp.round(x), lambda x, y: np.round(x)),
        (lambda x, y: lax.sign(x), lambda x, y: np.where(x == 0, x, np.sign(x))),
        (lambda x, y: lax.square(x), lambda x, y: x * x), (lambda x, y: x**3, lambda x, y: x * x * x),
        (lambda x, y: x**-2, lambda x, y: 1 / (x * x)),
        (lambda x, y: jnp.where(x < y, x, y), lambda x, y: np.where(x < y, x, y)),
        (lambda x, y: x * y + x, None),
    ],
)  # fmt: skip
def test_arithmetic_to_the_bit(function, exact):
    result = Lanewise(function, (number, number))(X, Y)
    if exact is None:
        # One rounding instead of two, from exact products.
        with np.errstate(all="ignore"):
            wide = X.astype(np.longdouble) * Y + X
            good = np.isfinite(wide) & (np.abs(wide) > 1e-300) & (np.abs(wide) < 1e300)
            assert np.allclose(result[good], wide[good].astype(float), rtol=2.3e-16, atol=0)
        return
    with np.errstate(all="ignore"):
        assert _same_bits(result, exact(X, Y))


@pytest.mark.parametrize("name", ["remainder", "fmod", "floor_divide"])
def test_remainders_are_numpys(name):
    result = Lanewise(getattr(jnp, name), (number, number))(X, Y)
    expected = np.asarray(getattr(jnp, name)(X, Y))
    # XLA takes subnormal numbers for zeros.
    usual = ~((np.abs(X) < 1e-300) & (X != 0) | (np.abs(Y) < 1e-300) & (Y != 0))
    assert np.array_equal(result[usual], expected[usual], equal_nan=True)


def test_numbers_without_a_sign_may_be_constants():
    def function(i):
        return i.astype(np.uint8) + np.uint8(200), i.astype(np.uint64) + np.uint64(2**63 + 5)

    for one, other in zip(Lanewise(function, (WHOLE,))(M), jax.vmap(function)(M), strict=True):
        assert np.array_equal(one, other)


def test_functions_of_single_precision_are_rounded_from_double():
    result = Lanewise(lambda x: jnp.exp(x.astype(np.float32)), (number,))(np.linspace(-3, 3, 20))
    assert result.dtype == np.float32
    assert np.array_equal(result, np.exp(np.linspace(-3, 3, 20).astype(np.float32).astype(float)).astype(np.float32))


@pytest.mark.parametrize("name", ["maximum", "minimum"])
def test_extremes_are_numpys_but_for_zeros(name):
    result = Lanewise(getattr(jnp, name), (number, number))(X, Y)
    with np.errstate(invalid="ignore"):
        assert np.array_equal(result, getattr(np, name)(X, Y), equal_nan=True)


@pytest.mark.parametrize("name", ["equal", "not_equal", "less", "less_equal", "greater", "greater_equal"])
def test_comparisons(name):
    result = Lanewise(getattr(jnp, name), (number, number))(X, Y)
    assert result.dtype == bool
    assert np.array_equal(result, getattr(np, name)(X, Y))


def test_what_is_finite():
    assert np.array_equal(Lanewise(jnp.isfinite, (number,))(X), np.isfinite(X))
    assert np.array_equal(Lanewise(jnp.isnan, (number,))(X), np.isnan(X))


@pytest.mark.parametrize(
    "function",
    [
        lambda i, j: i + j, lambda i, j: i - j, lambda i, j: i * j, lax.div, lax.rem, jnp.maximum, jnp.minimum,
        lambda i, j: lax.neg(i), lambda i, j: lax.abs(i), lambda i, j: lax.sign(i), lambda i, j: i & j,
        lambda i, j: i | j, lambda i, j: i ^ j, lambda i, j: ~i, lambda i, j: i < j, lambda i, j: i == j,
        lambda i, j: lax.shift_left(j, i), lambda i, j: lax.shift_right_arithmetic(j, i),
        lambda i, j: lax.shift_right_logical(j, i), lambda i, j: jnp.clip(i, -3, j),
        lambda i, j: i // j, lambda i, j: i**2,
        lambda i, j: i.astype(np.int8), lambda i, j: i.astype(np.uint32) // np.uint32(2),
        lambda i, j: i.astype(np.int32) * j.astype(np.int32), lambda i, j: (i > j) & (j > 0),
        lambda i, j: (i > j) ^ (j > 0),
        lambda i, j: lax.select_n(jnp.clip(i, 0, 2).astype(np.int32), i, j, i + j), lambda i, j: i.astype(bool),
        lambda i, j: i.astype(np.uint8) < j.astype(np.uint8), lambda i, j: (i > j).astype(np.int32) - 1,
    ],
)  # fmt: skip
def test_whole_numbers_are_jaxs(function):
    result = Lanewise(function, (WHOLE, WHOLE))(M, N)
    expected = np.asarray(jax.jit(jax.vmap(function))(M, N))
    assert result.dtype == expected.dtype
    assert np.array_equal(result, expected)


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.int8, np.uint8, np.float32, bool])
def test_conversions_are_jaxs(kind):
    def function(x):
        return x.astype(kind)

    # XLA takes subnormal numbers for zeros.
    x = X[(np.abs(X) > 1e-300) | ~(np.abs(X) > 0)]
    result, expected = Lanewise(function, (number,))(x), np.asarray(jax.vmap(function)(x))
    assert np.array_equal(result, expected, equal_nan=kind is np.float32)


def test_bits_of_a_number():
    result = Lanewise(lambda x: lax.bitcast_convert_type(x, np.int64), (number,))(X)
    assert np.array_equal(result, X.view(np.int64))
    back = Lanewise(lambda i: lax.bitcast_convert_type(i, np.float64), (WHOLE,))(M)
    assert _same_bits(back, M.view(np.float64))


def test_a_quotient_by_what_a_loop_does_not_change_is_a_product():
    # The one place where a bit may differ: a product with the reciprocal, computed before the loop.
    def halved(x, y):
        return lax.fori_loop(0, 100, lambda _, s: s / y, x)

    x, y = np.abs(X[-300:]), 1 + np.abs(Y[-300:]) * 1e-3
    result = Lanewise(halved, (number, number))(x, y)
    assert np.allclose(result, x / y**100, rtol=1e-13)
    by_constant = Lanewise(lambda x: lax.fori_loop(0, 100, lambda _, s: s / 49.0, x), (number,))(x)
    for _ in range(100):
        x = x * (1 / 49)
    assert _same_bits(by_constant, x)
