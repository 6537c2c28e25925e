"""The removed volume as a number that JAX can trace: `erosion.volume`."""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from erosion.array_types import Number, Scalar
from erosion.engine.batch import integrate, integrate_along
from erosion.engine.integrator import solve
from erosion.engine.leaves import Layout, split
from erosion.engine.variational import Derivatives
from erosion.lanes.choice import by_xla
from erosion.models import load_model
from erosion.models.base import CuttingModel
from erosion.models.equations import Equations
from erosion.models.own_parameters import require_one_impact
from erosion.parameters.parameters import Parameters
from erosion.parameters.precision import require_float64

_RTOL = 1e-11


def volume(model: CuttingModel | str | Path, p: Parameters) -> Scalar:
    """The removed volume of one impact, as a traceable number.

    Use it inside `jit`, `vmap`, `grad`, `jacfwd`, `hessian` and their compositions up to second order,
    with respect to any leaf of `p` or of the model, arrays included. Event times are differentiated
    exactly. Nothing is checked here: an impact that fails gives NaN, a derivative that does not exist is NaN
    (`erosion.impact` says where, by `no_derivatives`), and parameters out of range (see `validate`) give
    numbers without meaning.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters, all scalars.

    Returns:
        V [volume], a scalar.
    """
    require_float64()
    model = load_model(model)
    require_one_impact(model, p, "; for many impacts use `erosion.impact`, or `jax.vmap`")
    layout, numbers = split(model, p)
    return _volume(layout, [jnp.asarray(number, dtype) for number, dtype in zip(numbers, layout.dtypes, strict=True)])


# For each derivative the places of one or two elements, see `Variational`.
_Places = tuple[tuple[int, ...], ...]
# What JAX gives to a rule of derivatives: the numbers, or their tangents, of which some are symbols for zero.
_Numbers = tuple[list[PyTree]]
_ValueAndRate = tuple[Array, Array]


def _solve(layout: Layout, numbers: Sequence[Number], order: int, places: _Places) -> Array:
    """V, or the derivatives along each of the directions, shape (directions,)."""
    if by_xla():
        rows = jnp.asarray(places, float)
        solve_along = functools.partial(solve, layout, list(numbers), rtol=_RTOL, order=order)
        if not places:
            return solve_along(()).volume.value
        return jax.vmap(lambda row: solve_along(tuple(row)).volume)(rows)[1 if order == 1 else 3]
    shape = jax.ShapeDtypeStruct((len(places),) if places else (), np.float64)
    return jax.pure_callback(
        _callback(layout, layout.equations, order, places), shape, *numbers, vmap_method="expand_dims"
    )


@functools.lru_cache(maxsize=256)
def _callback(layout: Layout, equations: Equations, order: int, places: _Places) -> Callable[..., np.ndarray]:
    """The same object each time, as JAX compiles a program for each; but each model follows its own code."""
    return functools.partial(_on_host, layout, order, places)


def _on_host(layout: Layout, order: int, places: _Places, *given: Number) -> np.ndarray:
    """`_solve` by the batch, for numbers that may have axes of `vmap` before their own."""
    arrays = [np.asarray(number) for number in given]
    leading = [array.shape[: array.ndim - len(shape)] for array, shape in zip(arrays, layout.shapes, strict=True)]
    batch = np.broadcast_shapes(*leading)
    lanes = math.prod(batch)
    numbers = [
        array.reshape(shape)
        if math.prod(before) == 1
        else np.broadcast_to(array, (*batch, *shape)).reshape(lanes, *shape)
        for array, before, shape in zip(arrays, leading, layout.shapes, strict=True)
    ]
    if not places:
        return integrate(layout, numbers, lanes, 0, (), _RTOL).volume.value.reshape(batch)
    results: Derivatives = integrate_along(layout, numbers, lanes, order, np.array(places, float).T, _RTOL).volume
    part = results.first if order == 1 else results.second
    return part.reshape(*batch, len(places))


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _volume(layout: Layout, numbers: list[Number]) -> Array:
    return _solve(layout, numbers, 0, ())


@functools.partial(_volume.defjvp, symbolic_zeros=True)
def _volume_jvp(layout: Layout, primals: _Numbers, tangents: _Numbers) -> _ValueAndRate:
    (numbers,), (rates,) = primals, tangents
    moving, moved = _moving(layout, rates)
    return _volume(layout, numbers), _slopes(layout, moving, numbers) @ moved


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _slopes(layout: Layout, elements: tuple[int, ...], numbers: list[Number]) -> Array:
    """∂V/∂(element i) for each i of `elements`."""
    return _solve(layout, numbers, 1, tuple((i,) for i in elements))


@functools.partial(_slopes.defjvp, symbolic_zeros=True)
def _slopes_jvp(layout: Layout, elements: tuple[int, ...], primals: _Numbers, tangents: _Numbers) -> _ValueAndRate:
    (numbers,), (rates,) = primals, tangents
    moving, moved = _moving(layout, rates)
    return _slopes(layout, elements, numbers), _curvatures(layout, elements, moving, numbers) @ moved


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _curvatures(layout: Layout, elements: tuple[int, ...], others: tuple[int, ...], numbers: list[Number]) -> Array:
    """∂²V/∂(element i)∂(element j) for each i of `elements` and j of `others`."""
    # One direction twice is cheaper than a pair.
    alone = elements == others and len(elements) == 1
    pairs = (elements,) if alone else tuple(itertools.product(elements, others))
    return _solve(layout, numbers, 2, pairs).reshape(len(elements), len(others))


@_curvatures.defjvp
def _curvatures_jvp(
    layout: Layout, elements: tuple[int, ...], others: tuple[int, ...], primals: _Numbers, tangents: _Numbers
) -> NoReturn:
    raise NotImplementedError("erosion.volume has derivatives up to the second; the third is not available.")


def _moving(layout: Layout, rates: list[PyTree]) -> tuple[tuple[int, ...], Array]:
    """The elements whose tangents are not zero by construction, and these tangents."""
    zero = jax.custom_derivatives.SymbolicZero
    moving = [i for i, rate in enumerate(rates) if not isinstance(rate, zero)]
    elements = [j for i in moving for j in range(layout.offsets[i], layout.offsets[i + 1])]
    return tuple(elements), jnp.concatenate([jnp.ravel(jnp.asarray(rates[i])) for i in moving])
