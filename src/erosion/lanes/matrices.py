"""Linear systems, decompositions and sorting of small arrays, in plain JAX: every step of them is written out."""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.extend.core import jaxpr_as_fun


def _of_each(function: Callable[..., Any], arrays: tuple[Array, ...], axes: int) -> Any:
    """The function of arrays with `axes` axes each, for all along the axes before these, one after another."""
    shape = arrays[0].shape[:-axes]
    results = [function(*(array[index] for array in arrays)) for index in np.ndindex(shape)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves).reshape(*shape, *leaves[0].shape), *results)


def _lu(a: Array, **_: Any) -> tuple[Array, Array, Array]:
    """Elimination with the greatest pivots: L and U in one array, with whom each row was exchanged, the rows' order."""
    return _of_each(_eliminated, (a,), 2)


def _eliminated(a: Array) -> tuple[Array, Array, Array]:
    order = jnp.arange(len(a), dtype=jnp.int32)
    pivots = []
    for i in range(min(a.shape)):
        pivot = i + jnp.argmax(jnp.abs(a[i:, i])).astype(jnp.int32)
        a, order = _exchanged(a, i, pivot), _exchanged(order, i, pivot)
        # A column of zeros is left as it is, as by LAPACK.
        factors = a[i + 1 :, i] / jnp.where(a[i, i] == 0, 1, a[i, i])
        a = a.at[i + 1 :, i].set(factors).at[i + 1 :, i + 1 :].add(-factors[:, None] * a[i, i + 1 :])
        pivots.append(pivot)
    return a, jnp.stack(pivots), order


def _exchanged(rows: Array, i: int, other: Array) -> Array:
    """Row i and another one below exchanged."""
    chosen = [(j, other == j) for j in range(i + 1, len(rows))]
    row = functools.reduce(lambda row, choice: jnp.where(choice[1], rows[choice[0]], row), chosen, rows[i])
    below = [jnp.where(is_other, rows[i], rows[j]) for j, is_other in chosen]
    return jnp.stack([*rows[:i], row, *below])


def _order_of_rows(pivots: Array, *, permutation_size: int) -> Array:
    """The order of rows after the exchanges."""

    def ordered(pivots: Array) -> Array:
        order = jnp.arange(permutation_size, dtype=jnp.int32)
        for i in range(pivots.size):
            order = _exchanged(order, i, pivots[i])
        return order

    return _of_each(ordered, (pivots,), 1)


def _triangular(
    a: Array, b: Array, *, left_side: bool, lower: bool, transpose_a: bool, unit_diagonal: bool, **_: Any
) -> Array:
    """X of A X = B, or of X A = B, by substitution."""

    def solved(a: Array, b: Array) -> Array:
        # Xᵀ solves the system on the left of Aᵀ.
        a, b = (a.T if transpose_a == left_side else a), (b if left_side else b.T)
        forward = lower != (transpose_a == left_side)
        rows: dict[int, Array] = {}
        for i in range(len(a)) if forward else reversed(range(len(a))):
            rest = functools.reduce(lambda rest, j: rest - a[i, j] * rows[j], rows, b[i])
            rows[i] = rest if unit_diagonal else rest / a[i, i]
        x = jnp.stack([rows[i] for i in range(len(a))])
        return x if left_side else x.T

    return _of_each(solved, (a, b), 2)


def _cholesky(a: Array, **_: Any) -> Array:
    """L of A = L Lᵀ; NaN where A is not positive definite."""

    def factor(a: Array) -> Array:
        rows = [[jnp.zeros((), a.dtype)] * len(a) for _ in a]
        for j in range(len(a)):
            for i in range(j, len(a)):
                rest = functools.reduce(lambda rest, k: rest - rows[i][k] * rows[j][k], range(j), a[i, j])
                rows[i][j] = jnp.sqrt(rest) if i == j else rest / rows[j][j]
        whole = jnp.array(rows)
        return jnp.where(jnp.isnan(whole).any(), jnp.nan, whole)

    return _of_each(factor, (a,), 2)


def _sort(*arrays: Array, dimension: int, num_keys: int, **_: Any) -> list[Array]:
    """Sorted together by the first `num_keys`; equal ones keep their order, and NaN comes last."""
    rows = [list(jnp.moveaxis(array, dimension, 0)) for array in arrays]
    count = len(rows[0])
    for end in range(count - 1, 0, -1):
        for i in range(end):
            pairs = [(row[i], row[i + 1]) for row in rows]
            swap = functools.reduce(
                lambda later, pair: _is_less(pair[1], pair[0]) | (~_is_less(pair[0], pair[1]) & later),
                reversed(pairs[:num_keys]),
                jnp.zeros(pairs[0][0].shape, bool),
            )
            for row, (first, second) in zip(rows, pairs, strict=True):
                row[i], row[i + 1] = jnp.where(swap, second, first), jnp.where(swap, first, second)
    return [jnp.moveaxis(jnp.stack(row), 0, dimension) for row in rows]


def _is_less(x: Array, y: Array) -> Array:
    less = x < y
    return less | (~jnp.isnan(x) & jnp.isnan(y)) if jnp.issubdtype(x.dtype, jnp.floating) else less


def _top_k(array: Array, *, axis: int, **params: Any) -> list[Array]:
    """The greatest k, and their places; NaN is the greatest."""
    places = lax.broadcasted_iota(jnp.int32, array.shape, axis)
    exact = not jnp.issubdtype(array.dtype, jnp.floating)
    keys = [~array] if exact else [(~jnp.isnan(array)).astype(jnp.int32), -array]
    *_, values, places = _sort(*keys, array, places, dimension=axis, num_keys=len(keys))
    return [lax.slice_in_dim(part, 0, params["k"], axis=axis) for part in (values, places)]


def _linear_solve(*inputs: Array, **params: Any) -> list[Array]:
    """By the given solver of the system itself."""
    const_lengths, jaxprs = params["const_lengths"], params["jaxprs"]
    begin = const_lengths.matvec + const_lengths.vecmat
    constants, right = inputs[begin : begin + const_lengths.solve], inputs[sum(const_lengths) :]
    return jaxpr_as_fun(jaxprs.solve)(*constants, *right)


MATRICES: Mapping[str, Callable[..., Any]] = {
    "cholesky": _cholesky,
    "custom_linear_solve": _linear_solve,
    "lu": _lu,
    "lu_pivots_to_permutation": _order_of_rows,
    "sort": _sort,
    "top_k": _top_k,
    "triangular_solve": _triangular,
}
"""JAX's primitives, by their name, in terms of others."""
