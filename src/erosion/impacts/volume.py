"""The removed volume as a number that JAX can trace: `erosion.volume`; model and case as lanes of `erosion.ode`."""

import dataclasses
import functools
from pathlib import Path

import jax
import numpy as np
from jax import Array
from jax.core import Tracer

from erosion.arguments import Number, PerImpact, Scalar
from erosion.models import load_model
from erosion.models.base import CuttingModel, units_within
from erosion.models.equations import CUT, Case, whole_cut
from erosion.models.own_parameters import own_parameters, require_one_impact
from erosion.ode.problem import Equations, is_number
from erosion.ode.step_control import require_float64
from erosion.ode.traced import Wanted, traced_end
from erosion.ode.variational import Layout, Options
from erosion.parameters.parameters import QUANTITIES, TABLE_1, Parameters, require_concrete
from erosion.parameters.quantities import System

_NAMES = tuple(QUANTITIES)


def layout_of(model: CuttingModel, p: Parameters, *, whole: bool = False) -> Layout:
    """The layout of model and case, which are made of the ten parameters and the model's own numbers.

    Args:
        model: the model.
        p: the case.
        whole: with a clock, the whole state at the end, and the quantities of the model's own.
    """
    case = Case(_of_units(units_within(model, p)), model)
    equations = CUT.equations(case, ())
    leaves, structure = jax.tree.flatten(case)
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    problem, options = (whole_cut(model), Options(clock=True, whole=True)) if whole else (CUT, Options())
    return Layout(problem, structure, rest, *_shapes(equations), options, equations)


# Each call of a user makes a layout, and what its parts have in common takes longer than the rest.
@functools.cache
def _of_units(units: System) -> Parameters:
    """Any parameters of a unit system: a layout knows no numbers."""
    return dataclasses.replace(TABLE_1, units=units)


@functools.lru_cache(maxsize=256)
def _shapes(equations: Equations) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
    """Shape and type of each number, for one lane."""
    return tuple(n.shape for n in equations.numbers), tuple(n.dtype.name for n in equations.numbers)


def split(model: CuttingModel, p: Parameters) -> tuple[Layout, list[PerImpact]]:
    """Layout and numbers of many impacts.

    The parameters of the case and the model's own may be arrays, with one number for each impact.
    Any other array is part of the model, the same for all impacts.
    """
    numbers = [getattr(p, name) for name in _NAMES] + [leaf for leaf in jax.tree.leaves(model) if is_number(leaf)]
    return layout_of(model, p), [_array(number) for number in numbers]


def _array(leaf: Number) -> Array | np.ndarray:
    """As a numpy array, unless JAX is tracing it."""
    return leaf if isinstance(leaf, Tracer) else np.asarray(leaf)


def lanes_of(model: CuttingModel, p: Parameters) -> tuple[Layout, list[np.ndarray], tuple[int, ...]]:
    """Layout, numbers and their broadcast shape; each number has one axis of lanes, or all lanes share it."""
    layout, numbers = split(model, p)
    require_concrete(dict(zip(names_of(model), numbers, strict=True)))
    varies = [number.ndim > 0 and shape == () for number, shape in zip(numbers, layout.shapes, strict=True)]
    if not any(varies):
        return layout, numbers, ()
    try:
        shape = np.broadcast_shapes(*(number.shape for number, many in zip(numbers, varies, strict=True) if many))
    except ValueError:
        shapes = ", ".join(str(number.shape) for number, many in zip(numbers, varies, strict=True) if many)
        raise ValueError(
            f"The model's own parameters must broadcast with the case's, but shapes are {shapes}."
        ) from None
    flat = [
        number if not many else number.reshape(()) if number.size == 1 else np.broadcast_to(number, shape).reshape(-1)
        for number, many in zip(numbers, varies, strict=True)
    ]
    return layout, flat, shape


def names_of(model: CuttingModel) -> tuple[str, ...]:
    """The name of each number of model and case; "" of an array that is none of the model's own parameters."""
    own = {parameter.leaf: name for name, parameter in own_parameters(model).items()}
    return _NAMES + tuple(own.get(i, "") for i, leaf in enumerate(jax.tree.leaves(model)) if is_number(leaf))


def element_of(model: CuttingModel, name: str) -> int:
    """The place of a parameter among the elements of all numbers."""
    if name in QUANTITIES:
        return _NAMES.index(name)
    own = own_parameters(model)
    scalars = {parameter.leaf for parameter in own.values()}
    before = jax.tree.leaves(model)[: own[name].leaf]
    return len(_NAMES) + sum(1 if i in scalars else np.size(leaf) for i, leaf in enumerate(before) if is_number(leaf))


_RTOL = 1e-11
_VOLUME = 1  # after the time


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
    require_one_impact(model, p, "; for many impacts use `erosion.impact`, or `jax.vmap`", traced=True)
    layout, numbers = split(model, p)
    return traced_end(Wanted(layout, _RTOL), numbers)[0][_VOLUME]
