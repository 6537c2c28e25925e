"""The removed volume as a number that JAX can trace: `erosion.volume`."""

from pathlib import Path

from erosion.array_types import Scalar
from erosion.impacts.lanes import split
from erosion.models import load_model
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import require_one_impact
from erosion.ode.precision import require_float64
from erosion.ode.traced import traced_end
from erosion.parameters.parameters import Parameters

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
    require_one_impact(model, p, "; for many impacts use `erosion.impact`, or `jax.vmap`")
    layout, numbers = split(model, p)
    return traced_end(layout, numbers, _RTOL)[0][_VOLUME]
