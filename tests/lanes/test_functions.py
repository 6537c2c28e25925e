"""Elementary functions against 80-bit references, and at the special values against NumPy.

Each is evaluated by NumPy, which rounds every product, and by lanes, which round a product and its sum once (fma) where
the processor can.

Every primitive of scalars against numpy or JAX, on lanes that hold NaN, infinities and zeros of either sign.
"""

import functools
import math
import platform

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.extend.core import Var

from erosion.lanes.functions import FUNCTIONS
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.machine import Processor

_RANDOM = np.random.default_rng(754)
_COUNT = 10_000

_NUMPY = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "round": np.rint,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
    "select_n": lambda which, no, yes: np.where(which, yes, no),
    "shift_left": np.left_shift,
    "shift_right_logical": lambda x, n: (x.view(np.uint64) >> np.uint64(n)).view(np.int64),
    "convert_element_type": lambda x, new_dtype: np.asarray(x).astype(new_dtype),
    "bitcast_convert_type": lambda x, new_dtype: x.view(new_dtype),
}


def _interpreted(jaxpr, constants, inputs):
    values = dict(zip(jaxpr.constvars + jaxpr.invars, [*constants, *inputs], strict=True))
    for equation in jaxpr.eqns:
        given = [values[v] if isinstance(v, Var) else v.val for v in equation.invars]
        inner = equation.params.get("jaxpr")
        if inner is not None:
            results = _interpreted(inner.jaxpr, inner.consts, given)
        else:
            params = {key: value for key, value in equation.params.items() if key == "new_dtype"}
            results = [_NUMPY[equation.primitive.name](*given, **params)]
        values.update(zip(equation.outvars, results, strict=True))
    return [values[v] for v in jaxpr.outvars]


def _by_numpy(name, *points):
    closed = jax.make_jaxpr(FUNCTIONS[name])(*[0.5] * len(points))
    with np.errstate(all="ignore"):
        return _interpreted(closed.jaxpr, closed.consts, points)[0]


_compiled = functools.cache(Lanewise)


def _by_lanes(name, *points, target=None):
    return _compiled(FUNCTIONS[name], (number,) * len(points), target=target)(*points)


_ENGINES = {"numpy": _by_numpy, "lanes": _by_lanes}
_OLDER = {
    f"lanes for {cpu}": functools.partial(_by_lanes, target=Processor(cpu, ""))
    for cpu in ("x86-64", "x86-64-v3")
    if "x86" in platform.machine()
}


def _uniform(low, high):
    return _RANDOM.uniform(low, high, _COUNT)


def _positive(low, high):
    """Between 2^low and 2^high, at all scales."""
    return np.exp2(_uniform(low, high))


def _scales(low, high):
    return _positive(low, high) * _RANDOM.choice([-1, 1], _COUNT)


def _quarter_turns(turns):
    """Numbers nearest to multiples of π/2, where the reduced angle has few digits left."""
    return np.rint(_uniform(-turns, turns)) * (np.pi / 2)


def _powers(x):
    """With exponents that reach from the smallest number to the largest."""
    return x, _uniform(-744, 709) / np.log(x)


_ANGLES = [_uniform(-4, 4), _scales(-1000, 20), _uniform(-(2**30), 2**30), _quarter_turns(10), _quarter_turns(2**29)]
_UNIT = [_uniform(-1, 1), _scales(-1074, 0)]
_ANY = [_uniform(-8, 8), _scales(-1074, 1023.9)]
_ANY_POSITIVE = [_uniform(0.5, 4), _positive(-1074, 1023.9)]

# The largest error [ulp] and the points of each.
_CASES = {
    "exp": (0.9, [_uniform(-1, 1), _uniform(-745, 709.7), _scales(-60, 9)]),
    "exp2": (0.8, [_uniform(-1, 1), _uniform(-1074, 1023.9), _scales(-60, 9)]),
    "expm1": (1.0, [_uniform(-2, 2), _uniform(-40, 709.7), _scales(-1074, 5)]),
    "log": (1.0, _ANY_POSITIVE),
    "log1p": (1.0, [_uniform(-1, 2), _scales(-1074, -0.01), _positive(0, 1023.9)]),
    "sin": (1.6, _ANGLES),
    "cos": (1.6, _ANGLES),
    "tan": (2.0, _ANGLES),
    "asin": (1.8, _UNIT),
    "acos": (1.2, _UNIT),
    "atan": (1.3, _ANY),
    "atan2": (1.7, [(_uniform(-1, 1), _uniform(-1, 1)), (_scales(-1074, 1023.9), _scales(-1074, 1023.9))]),
    "sinh": (1.2, [_uniform(-2, 2), _uniform(-710.4, 710.4), _scales(-1074, 9)]),
    "cosh": (1.6, [_uniform(-2, 2), _uniform(-710.4, 710.4)]),
    "tanh": (1.5, [_uniform(-2, 2), _uniform(-22, 22), _scales(-1074, 9)]),
    "asinh": (1.8, _ANY),
    "acosh": (2.0, [1 + _positive(-50, 1), _positive(0, 1023.9)]),
    "atanh": (1.9, _UNIT),
    "pow": (0.9, [*map(_powers, _ANY_POSITIVE), (_uniform(0.5, 2), _uniform(-50, 50))]),
    "cbrt": (0.6, _ANY),
    "rsqrt": (0.6, _ANY_POSITIVE),
    "logistic": (1.9, [_uniform(-2, 2), _uniform(-745, 50), _scales(-60, 9)]),
    "erf": (1.1, [_uniform(-1, 1), _uniform(-6, 6), _scales(-1074, 2)]),
    "erfc": (2.0, [_uniform(-1, 1), _uniform(-6, 27.2), _uniform(1, 2)]),
}


def _exp_of_minus_square(x):
    first = x.astype(np.float32).astype(np.longdouble)  # whose square is exact
    return np.exp(-first * first) * np.exp(-(x - first) * (x + first))


def _erf_series(x):
    """erf x = 2 e^(-x²) / √π Σ 2ⁿ x^(2n+1) / (1·3·…·(2n+1)), for |x| ≤ 1."""
    term = total = x
    for n in range(1, 40):
        term = term * x * x * 2 / (2 * n + 1)
        total = total + term
    return 2 * _exp_of_minus_square(x) / np.sqrt(np.arccos(np.longdouble(-1))) * total


def _erfc_fraction(x):
    """erfc x = e^(-x²) / √π / (x + (1/2) / (x + (2/2) / (x + (3/2) / …))), for x ≥ 1."""
    rest = x
    for n in range(300, 0, -1):
        rest = x + n / rest / 2
    return _exp_of_minus_square(x) / np.sqrt(np.arccos(np.longdouble(-1))) / rest


def _erfc(x):
    far = _erfc_fraction(np.maximum(np.abs(x), 1))
    return np.where(np.abs(x) < 1, 1 - _erf_series(np.clip(x, -1, 1)), np.where(x < 0, 2 - far, far))


def _erf(x):
    far = np.copysign(1 - _erfc_fraction(np.maximum(np.abs(x), 1)), x)
    return np.where(np.abs(x) < 1, _erf_series(np.clip(x, -1, 1)), far)


_REFERENCES = {
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh,
    "pow": np.power,
    "rsqrt": lambda x: 1 / np.sqrt(x),
    "logistic": lambda x: 1 / (1 + np.exp(-x)),
    "erf": _erf,
    "erfc": _erfc,
}


def _reference(name):
    return _REFERENCES.get(name) or getattr(np, name)


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="no 80-bit reference")
@pytest.mark.parametrize("engine", [*_ENGINES, *_OLDER])
@pytest.mark.parametrize("name", _CASES)
def test_error_in_ulp(name, engine):
    bound, cases = _CASES[name]
    points = [np.concatenate(parts) for parts in zip(*(np.atleast_2d(case) for case in cases), strict=True)]
    with np.errstate(under="ignore"):
        exact = _reference(name)(*(x.astype(np.longdouble) for x in points))
    ulp = np.ldexp(np.longdouble(1), np.maximum(np.frexp(exact)[1] - 53, -1074))
    error = np.abs((_ENGINES | _OLDER)[engine](name, *points) - exact) / ulp
    assert set(_CASES) == set(FUNCTIONS)
    assert np.max(error) <= bound, [x[np.argmax(error)] for x in points]


_SIZES = [0.0, 0.5, 1.0, 2.0, 3.0, 4.5, 2.0**53 - 1, 1e15, 1e300, 2.0**-1022, np.inf]
_SPECIAL = [*_SIZES, *(-x for x in _SIZES), np.nan, 5e-324, -5e-324, 2.0**-1030]


@pytest.mark.parametrize("engine", _ENGINES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_special_values_are_numpys(name, engine):
    special = [x for x in _SPECIAL if name not in ("sin", "cos", "tan") or not 2.0**30 < abs(x) < np.inf]
    points = [np.ravel(x) for x in np.meshgrid(*[special] * (2 if name in ("pow", "atan2") else 1))]
    with np.errstate(all="ignore"):
        exact = np.vectorize(getattr(math, name))(*points) if name in ("erf", "erfc") else _reference(name)(*points)
    result = _ENGINES[engine](name, *points)
    assert np.allclose(result, exact, rtol=1e-15, atol=1e-323, equal_nan=True)
    assert np.array_equal(np.signbit(result)[exact == exact], np.signbit(exact)[exact == exact])


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_angles_too_large_to_reduce_have_no_result(name):
    assert np.all(np.isnan(_by_numpy(name, np.array([2.0**30 + 1, -1e300]))))


_EDGES = [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 1.5, 2.5, -2.5, np.inf, -np.inf, np.nan, 5e-324, -1e-310, 1e308, -1e308]
_DRAWS = np.random.default_rng(1958)
X, Y = (
    np.concatenate([np.repeat(_EDGES, len(_EDGES)), _DRAWS.normal(size=300) * 10 ** _DRAWS.uniform(-3, 3, 300)]),
    np.concatenate([np.tile(_EDGES, len(_EDGES)), _DRAWS.normal(size=300) * 10 ** _DRAWS.uniform(-3, 3, 300)]),
)
WHOLE = jax.ShapeDtypeStruct((), np.int64)
M = np.concatenate([np.array([0, 1, -1, 2, -2, 63, 64, 65, 7, -7, 64, 100]), _DRAWS.integers(-1000, 1000, 90)])
N = np.concatenate([np.array([0, 0, 0, -1, 1, 1, 2, 3, -3, 3, 2**62, -(2**63)]), _DRAWS.integers(-9, 9, 90)])


def _same_bits(one, other):
    nan = np.isnan(one) & np.isnan(other)
    return np.all(nan | ((one == other) & (np.signbit(one) == np.signbit(other))))


_ARITHMETIC = [
    (lax.add, np.add), (lax.sub, np.subtract), (lax.mul, np.multiply), (lax.div, np.divide),
    (lambda x, y: lax.neg(x), lambda x, y: -x), (lambda x, y: lax.abs(x), lambda x, y: np.abs(x)),
    (lambda x, y: lax.sqrt(x), lambda x, y: np.sqrt(x)), (lambda x, y: lax.floor(x), lambda x, y: np.floor(x)),
    (lambda x, y: lax.ceil(x), lambda x, y: np.ceil(x)), (lambda x, y: jnp.round(x), lambda x, y: np.round(x)),
    (lambda x, y: lax.sign(x), lambda x, y: np.where(x == 0, x, np.sign(x))),
    (lambda x, y: lax.square(x), lambda x, y: x * x), (lambda x, y: x**3, lambda x, y: x * x * x),
    (lambda x, y: x**-2, lambda x, y: 1 / (x * x)),
    (lambda x, y: jnp.where(x < y, x, y), lambda x, y: np.where(x < y, x, y)),
    (lambda x, y: jnp.isfinite(x), lambda x, y: np.isfinite(x)), (lambda x, y: jnp.isnan(x), lambda x, y: np.isnan(x)),
    (jnp.equal, np.equal), (jnp.not_equal, np.not_equal), (jnp.less, np.less), (jnp.less_equal, np.less_equal),
    (jnp.greater, np.greater), (jnp.greater_equal, np.greater_equal),
]  # fmt: skip


def test_arithmetic_to_the_bit():
    results = Lanewise(lambda x, y: [function(x, y) for function, _ in _ARITHMETIC], (number, number))(X, Y)
    with np.errstate(all="ignore"):
        for i, (result, (_, exact)) in enumerate(zip(results, _ARITHMETIC, strict=True)):
            expected = exact(X, Y)
            assert result.dtype == expected.dtype
            assert _same_bits(result, expected), i


def test_a_product_and_a_sum_are_rounded_once():
    result = Lanewise(lambda x, y: x * y + x, (number, number))(X, Y)
    with np.errstate(all="ignore"):
        wide = X.astype(np.longdouble) * Y + X
        good = np.isfinite(wide) & (np.abs(wide) > 1e-300) & (np.abs(wide) < 1e300)
        assert np.allclose(result[good], wide[good].astype(float), rtol=2.3e-16, atol=0)


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


_OF_WHOLE_NUMBERS = [
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
]  # fmt: skip


def test_whole_numbers_are_jaxs():
    def each(i, j):
        return [function(i, j) for function in _OF_WHOLE_NUMBERS]

    results, expected = Lanewise(each, (WHOLE, WHOLE))(M, N), jax.jit(jax.vmap(each))(M, N)
    for i, (result, other) in enumerate(zip(results, expected, strict=True)):
        assert result.dtype == other.dtype
        np.testing.assert_array_equal(result, other, str(i))


def test_conversions_are_jaxs():
    kinds = [np.int64, np.int32, np.int8, np.uint8, np.float32, bool]

    def each(x):
        return [x.astype(kind) for kind in kinds]

    # XLA takes subnormal numbers for zeros.
    x = X[(np.abs(X) > 1e-300) | ~(np.abs(X) > 0)]
    for result, expected in zip(Lanewise(each, (number,))(x), jax.jit(jax.vmap(each))(x), strict=True):
        np.testing.assert_array_equal(result, expected)


def test_bits_of_a_number():
    result = Lanewise(lambda x: lax.bitcast_convert_type(x, np.int64), (number,))(X)
    assert np.array_equal(result, X.view(np.int64))
    back = Lanewise(lambda i: lax.bitcast_convert_type(i, np.float64), (WHOLE,))(M)
    assert _same_bits(back, M.view(np.float64))


@pytest.mark.parametrize("known", [True, False])
def test_a_quotient_in_a_loop_is_that_of_the_division(known):
    """49 · (1/49) is less than 1: a comparison or a rounding, direct or later, sees the last digit."""

    def decided(quotient):
        compared = [
            jnp.where(compare(quotient, 1.0), 2.0, 0.0) + jnp.where(compare(quotient - 1.0, 0.0), 1.0, 0.0)
            for compare in (jnp.greater_equal, jnp.equal, jnp.less)
        ]
        return jnp.stack(
            compared + [near(quotient) + near(quotient - 1.0) for near in (jnp.floor, jnp.ceil, jnp.trunc)]
        )

    def in_a_loop(x, y):
        y = 49.0 if known else y
        return lax.fori_loop(0, 100, lambda i, s: jnp.where(i < 99, s + 1, decided((x + 0 * s[0]) / y)), jnp.zeros(6))

    x, y = np.arange(2000.0), np.full(2000, 49.0) if known else np.maximum(np.arange(2000.0), 1.0)
    np.testing.assert_array_equal(Lanewise(in_a_loop, (number, number))(x, y), np.asarray(decided(x / y)).T)


@pytest.mark.parametrize("divisor", [5e-324, 1e-310, 49.0, 0.7, 2.0**1023])
def test_a_quotient_by_what_a_loop_does_not_change_is_a_quotient(divisor):
    def in_a_loop(x, y):
        return lax.fori_loop(0, 100, lambda _, s: (s[1] / y, s[1]), (x, x))[0]

    with np.errstate(all="ignore"):
        assert np.array_equal(Lanewise(in_a_loop, (number, number))(X, divisor), X / divisor, equal_nan=True)
