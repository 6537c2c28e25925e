"""Large arrays of a lane, which stay in memory and in loops: what they hold is what JAX computes.

Tapes: what lanes write at places of their own, and read there.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from erosion.lanes import tapes
from erosion.lanes.flatten import NotForLanesError, flatten
from erosion.lanes.lanewise import Lanewise, number

H = 29  # no multiple of a tile
RNG = np.random.default_rng(0)
WEIGHTS = {name: RNG.normal(size=shape) / 5 for name, shape in (("m", (H, H)), ("a", H), ("b", H), ("v", H))}
STRUCTS = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, np.float64), WEIGHTS)
X = RNG.normal(size=21)


def network(w, x):
    return w["v"] @ jnp.tanh(w["m"] @ jnp.tanh(w["a"] * x + w["b"]))


def sums_of_gradients(w, x):
    """Sums that two loops carry, each lane for as many rounds as it likes."""
    gradient = jax.grad(network)

    def body(at):
        i, y, total = at
        found = gradient(w, y)
        _, total = lax.while_loop(
            lambda inner: inner[0] < 3,
            lambda inner: (inner[0] + 1, jax.tree.map(lambda t, g: t + g * inner[0], inner[1], found)),
            (0, total),
        )
        return i + 1, 0.9 * y, jax.tree.map(jnp.add, total, found)

    return lax.while_loop(lambda at: at[0] < 3 + 10 * jnp.abs(x), body, (0, x, jax.tree.map(jnp.zeros_like, w)))


def exchanged(w, x):
    """A loop that writes what another array held."""
    begin = (0, w["a"], w["b"])
    return lax.while_loop(lambda at: at[0] < 5 * jnp.abs(x), lambda at: (at[0] + 1, at[2] + x, at[1] * 1.0), begin)


def moved(w, x):
    m = w["m"] * x
    parts = [m.T[3:, ::2].sum(0), m.reshape(-1)[5:40], (m + m.T).reshape(H * H), jnp.outer(w["a"], w["b"] * x).T]
    parts += [w["a"][:, None] * m, m / jnp.abs(m).sum(0, keepdims=True), np.arange(9.0)[:, None] * m[:9, :1]]
    return [*parts, jnp.einsum("ij,kj->ik", m, m), jnp.where(m > 0, m, x).sum(), jnp.linalg.norm(m, axis=1)]


def taken_apart(w, x):
    """Operations that know small arrays alone."""
    w = jax.tree.map(jnp.asarray, w)
    place = jnp.int32(jnp.abs(x) * 5)
    table = jnp.interp(x, jnp.cumsum(jnp.abs(w["a"])), w["b"])
    return jnp.max(w["m"]), w["m"][place, 3], w["a"].at[place].add(x), table


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("function", [network, jax.grad(network), sums_of_gradients, exchanged, moved, taken_apart])
def test_large_arrays_are_what_they_are_in_jax(function, own):
    """Of all lanes together, and of each lane."""
    w = jax.tree.map(lambda leaf: RNG.normal(size=(X.size, *leaf.shape)) / 5, WEIGHTS) if own else WEIGHTS
    found = jax.tree.leaves(Lanewise(function, (STRUCTS, number))(w, X))
    expected = jax.tree.leaves(jax.jit(jax.vmap(function, (0 if own else None, 0)))(w, X))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13)


def test_a_product_of_matrices_stays_a_loop():
    """A matrix of 5,000 numbers makes no larger a program than one of 500."""

    def size_of(n):
        shapes = jax.ShapeDtypeStruct((n, n), np.float64), jax.ShapeDtypeStruct((n,), np.float64), number
        closed = jax.make_jaxpr(jax.grad(lambda m, v, x: jnp.sum(jnp.tanh(m @ (v * x)))))(*shapes)
        return flatten(closed).made

    assert size_of(72) == size_of(24) < 1000


def test_an_array_that_a_loop_has_changed_is_not_read():
    """It is gone: a sentence says so, and nothing reads what is there now."""

    def function(v, x):
        def body(at):
            i, total = at
            _, inner = lax.while_loop(lambda two: two[0] < 2, lambda two: (two[0] + 1, two[1] + v), (0, total))
            return i + 1, inner + total

        return lax.while_loop(lambda at: at[0] < x, body, (0, v))[1]

    with pytest.raises(NotForLanesError, match="after a loop has changed it"):
        Lanewise(function, (STRUCTS["a"], number))


@pytest.mark.parametrize(
    "start", [lambda x: jnp.arange(float(H)), lambda x: jnp.stack([x * i for i in range(H)])], ids=["constant", "stack"]
)
def test_a_loop_reads_what_it_carries_before_it_changes(start):
    """Of two arrays that a loop carries one is kept in memory, and the other is computed from it."""

    def function(a, x):
        def body(at):
            return at[0] + 1.0, 2.0 * at[1], at[1] + 1.0

        return lax.while_loop(lambda at: at[0] < 3.0 + x, body, (0.0, a, start(x)))

    results = Lanewise(function, (STRUCTS["a"], number))(np.tile(WEIGHTS["a"], (X.size, 1)), X)
    for made, expected in zip(results, jax.jit(jax.vmap(function, (None, 0)))(WEIGHTS["a"], X), strict=True):
        np.testing.assert_allclose(made, expected, rtol=1e-12)


SPREAD = np.linspace(1.2, 9.0, 21)
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
    tape, order = np.full((SPREAD.size, LENGTH * 2), np.nan), np.random.default_rng(0).permutation(SPREAD.size)
    count, total = np.empty(SPREAD.size, np.int64), np.empty(SPREAD.size)
    Lanewise(powers, (number, number), width=width, tapes=1).run(
        [SPREAD, np.zeros(())], order, [count, total], tapes=[tape]
    )
    for x, row, n, sum_ in zip(SPREAD, tape, count, total, strict=True):
        expected = x ** np.arange(1, n // 2 + 1)
        np.testing.assert_allclose(row[:n:2], expected, rtol=1e-13)
        np.testing.assert_array_equal(row[1:n:2], -row[:n:2])
        assert expected[-1] < 1000 <= expected[-1] * x
        assert np.isnan(row[n:]).all()
        assert sum_ == 0
