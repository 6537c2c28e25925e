"""Functions that a large program calls: the same results as where they are written out, and less to write."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from erosion.lanes import flatten, passes, tapes
from erosion.lanes.graph import Loop
from erosion.lanes.lanewise import Lanewise, number
from tests.lanes.random_programs import RandomFunction
from tests.lanes.test_interrupts import assert_stops
from tests.lanes.test_random_programs import compare_with_numpy, random_numbers


@pytest.fixture
def with_subroutines(monkeypatch):
    """As if every program were large, and every function worth a call."""
    monkeypatch.setattr(flatten, "WHOLE", -1)
    monkeypatch.setattr(flatten, "_WORTH_A_CALL", 1)


class _CalledAgain:
    """A random function, called in a row, in a loop, in a branch, and by another function."""

    def __init__(self, seed: int, *, exact: bool) -> None:
        function = RandomFunction(seed, exact=exact, size=5)
        self.called = jax.jit(lambda *numbers: [x for x in function(*numbers) if x.shape == ()])

    def __call__(self, x, y, z):
        first = self.called(x, y, z)
        twice = jax.jit(lambda x, y: [*self.called(x, y, z), *self.called(y, x, z)])

        def again(carried):
            count, _ = carried
            more = self.called(x, y, count)
            chosen = lax.cond(count > 1, lambda: twice(y, count), lambda: twice(count, x))
            return count + 1, [*more, *chosen]

        _, numbers = lax.while_loop(lambda carried: carried[0] < 3 - (z > 0), again, (0.0, [*first, *twice(z, y)]))
        return numbers


@pytest.mark.filterwarnings("ignore:(overflow|invalid value) encountered in cast")
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_a_function_gives_the_same_bits_wherever_it_is_called(seed, exact, with_subroutines, monkeypatch):
    if not exact:
        monkeypatch.setattr(passes, "_contract", lambda region: None)
    function = _CalledAgain(seed, exact=exact)
    closed = jax.make_jaxpr(function)(number, number, number)
    assert flatten.flatten(closed).functions
    compare_with_numpy(function, random_numbers(seed, exact=exact), seed)


def test_a_function_is_written_once(with_subroutines):
    @jax.jit
    def slow(x, y):
        return jnp.sin(x * y) + x

    def lane(x, y):
        for _ in range(10):
            x = slow(x, y)
        return x

    graph = flatten.flatten(jax.make_jaxpr(lane)(number, number))
    (of_slow,) = [function for function in graph.functions if len(function.calls) == 9]  # the first is written out
    assert len(of_slow.arguments) == 1  # y is known to the whole lane
    x, y = np.linspace(-3.0, 3.0, 19), np.linspace(0.1, 2.0, 19)
    expected = x
    for _ in range(10):
        expected = np.sin(expected * y) + expected
    np.testing.assert_allclose(Lanewise(lane, (number, number))(x, y), expected, rtol=1e-13)


def test_what_no_argument_changes_is_computed_outside(with_subroutines):
    @jax.jit
    def of_both(x, y):
        return x * jnp.exp(y), jnp.exp(y)

    def lane(x, y):
        pairs = [of_both(x + i, y) for i in range(4)]
        return [one for one, _ in pairs], pairs[-1][1]

    functions = flatten.flatten(jax.make_jaxpr(lane)(number, number)).functions
    assert ["fmul"] in [[getattr(step, "op", None) for step in function.body.steps] for function in functions]
    several, last = Lanewise(lane, (number, number))(np.arange(3.0), np.ones(3))
    np.testing.assert_allclose(several[3], np.e * (np.arange(3.0) + 3), rtol=1e-15)
    np.testing.assert_allclose(last, np.e)


def test_large_arrays_and_tapes_stay_where_they_are(with_subroutines):
    weights = np.random.default_rng(0).normal(size=(5, 5))

    @jax.jit
    def step(weights, count, token, x):
        x = jnp.tanh(weights @ jnp.stack([x, 1.0, x, -x, 0.5])).sum()
        return x, tapes.write(0, token, count, x)

    def lane(weights, token, x):
        def again(carried):
            count, x, token = carried
            x, token = step(weights, count, token, x)
            x, token = step(weights, count + 1, token, x)
            return count + 2, x, token

        _, x, token = lax.while_loop(lambda carried: carried[0] < 6, again, (0, x, token))
        return x, token

    compiled = Lanewise(lane, (jax.ShapeDtypeStruct((5, 5), float), number, number), tapes=1)
    starts, tape = np.linspace(-1.0, 1.0, 9), np.empty((9, 6))
    results = [np.empty(9), np.empty(9)]
    compiled.run([weights, np.zeros(9), starts], np.arange(9), results, tapes=[tape])
    x = starts
    for i in range(6):
        x = np.tanh(weights @ np.stack([x, 1.0 + 0 * x, x, -x, 0.5 + 0 * x])).sum(0)
        np.testing.assert_allclose(tape[:, i], x, rtol=1e-13)
    np.testing.assert_allclose(results[0], x, rtol=1e-13)


def test_calls_with_an_array_in_memory_and_with_its_numbers(with_subroutines):
    @jax.jit
    def weighted(array, x):
        return jnp.sum(array * jnp.sin(x * array))

    def lane(array, x):
        apart = jnp.cumsum(array)
        return [weighted(each, x + i) for i in range(3) for each in (array, apart)]

    array, x = np.linspace(-1.0, 1.0, 16), np.linspace(-3.0, 3.0, 19)
    results = Lanewise(lane, (jax.ShapeDtypeStruct(array.shape, float), number))(array, x)
    for i, (of_array, of_sums) in enumerate(zip(results[::2], results[1::2], strict=True)):
        for one, each in ((of_array, array), (of_sums, np.cumsum(array))):
            expected = np.sum(each * np.sin((x[:, None] + i) * each), axis=1)
            np.testing.assert_allclose(one, expected, rtol=1e-12, atol=1e-13)


def test_the_word_that_stops_the_code_reaches_a_loop_in_a_function(with_subroutines):
    @jax.jit
    def power_above_8(x):
        return lax.while_loop(lambda power: power < 8.0, lambda power: power * x, x)

    def lane(x, token):
        token = tapes.write(0, token, 0, power_above_8(x + 1.0))  # written out
        return power_above_8(x), token

    (function,) = flatten.flatten(jax.make_jaxpr(lane)(number, number)).functions
    assert any(isinstance(step, Loop) for step in function.body.steps)
    assert_stops(lane, 1.0)
