"""What models call of `jax.numpy`, `jax.nn` and `jax.scipy`: right, or refused by name.

Each version of JAX writes these functions by other primitives.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.scipy import special, stats

from erosion.lanes.flatten import NotForLanesError
from erosion.lanes.lanewise import Lanewise

X = np.linspace(0.05, 0.95, 16)
number = jax.ShapeDtypeStruct((), np.float64)


def _array(x, size=3):
    return jnp.stack([x, x * x + 0.1, 1 + x, 2 - x][:size])


def _matrix(x, size=4):
    """One whose rows have to be exchanged, and which is not symmetric."""
    rows = np.random.default_rng(size).normal(size=(2, size, size))
    return jnp.where(jnp.eye(size) > 0, 0.0, rows[0]) + x * rows[1]


def _ties(x):
    """Equal numbers, no numbers, and both zeros."""
    return jnp.stack([x, jnp.nan * x, 0.5 + 0 * x, -0.0 * x, x, 0.5 - 0 * x, jnp.nan * x, 0.0 * x])


def _of_name(module, names, call):
    functions = [(f"{module.__name__}.{name}", getattr(module, name)) for name in names.split()]
    return {name: lambda x, function=function: call(function, x) for name, function in functions}


_OF_A_NUMBER = (
    "log10 log2 log1p exp2 expm1 sinc signbit cbrt deg2rad square sign rint trunc positive reciprocal nan_to_num "
    "isnan degrees angle modf frexp"
)
_OF_TWO = (
    "hypot heaviside logaddexp logaddexp2 copysign fmod mod remainder floor_divide power float_power arctan2 "
    "maximum fmax divmod true_divide"
)
_OF_AN_ARRAY = (
    "sum prod mean std var max min ptp argmax argmin cumsum cumprod diff any all nanmax flip trapezoid average "
    "count_nonzero ediff1d nansum vander diag"
)
_ACTIVATIONS = (
    "relu gelu silu softplus sigmoid elu selu celu leaky_relu log_sigmoid hard_tanh mish squareplus soft_sign"
)

FUNCTIONS = {
    **_of_name(jnp, _OF_A_NUMBER, lambda function, x: function(x)),
    **_of_name(jnp, _OF_TWO, lambda function, x: function(x, 0.7)),
    **_of_name(jnp, _OF_AN_ARRAY, lambda function, x: function(_array(x))),
    **_of_name(jax.nn, _ACTIVATIONS, lambda function, x: function(x)),
    **_of_name(jax.nn, "softmax logsumexp log_softmax standardize", lambda function, x: function(_array(x))),
    **_of_name(special, "erf erfc expit ndtr logit entr", lambda function, x: function(x)),
    "xlogy": lambda x: special.xlogy(x, x),
    "norm.pdf": stats.norm.pdf,
    "polyval": lambda x: jnp.polyval(jnp.asarray([1.0, 2.0, 3.0]), x),
    "polyval of 12": lambda x: jnp.polyval(jnp.arange(12.0) + x, x),
    "interp": lambda x: jnp.interp(x, jnp.arange(4.0), jnp.arange(4.0) ** 2, left=0.0, right=1.0),
    "searchsorted": lambda x: jnp.searchsorted(jnp.arange(40.0), 20 * x),
    "digitize": lambda x: jnp.digitize(x, jnp.arange(4.0)),
    "clip": lambda x: jnp.clip(x, 0.1, 0.5),
    "piecewise": lambda x: jnp.piecewise(x, [x < 0.3, x >= 0.3], [lambda u: u, lambda u: u**2]),
    "select": lambda x: jnp.select([x < 0.3, x < 0.6], [x, 2 * x], 3 * x),
    "ldexp": lambda x: jnp.ldexp(x, 3),
    "norm": lambda x: jnp.linalg.norm(_array(x)),
    "det": lambda x: jnp.linalg.det(jnp.array([[2.0, x], [x, 3.0]])),
    "dot": lambda x: _array(x) @ _array(x),
    "cross": lambda x: jnp.cross(_array(x), _array(x)[::-1]),
    "einsum": lambda x: jnp.einsum("i,j->ij", _array(x), _array(x)),
    "kron": lambda x: jnp.kron(_array(x), _array(x)),
    "trace": lambda x: jnp.trace(jnp.outer(_array(x), _array(x))),
    "tril": lambda x: jnp.tril(jnp.outer(_array(x), _array(x))),
    "array": lambda x: jnp.array([x, 2.0]),
    "linspace": lambda x: jnp.linspace(x, 1, 5),
    "geomspace": lambda x: jnp.geomspace(x, 1, 5),
    "repeat": lambda x: jnp.repeat(_array(x), 2),
    "meshgrid": lambda x: jnp.meshgrid(_array(x), _array(x)),
    "nonzero": lambda x: jnp.nonzero(_array(x) > 0.5, size=2)[0],
    "at.divide": lambda x: _array(x).at[1].divide(x),
    "at.apply": lambda x: _array(x).at[1].apply(jnp.sin),
    "vmap": lambda x: jax.vmap(lambda u: jnp.sin(u) * x)(_array(x)),
    "map": lambda x: lax.map(lambda u: u * x, _array(x)),
    "associative_scan": lambda x: lax.associative_scan(jnp.add, _array(x)),
    "checkpoint": lambda x: jax.checkpoint(jnp.sin)(x),
    "solve": lambda x: jnp.linalg.solve(_matrix(x), jnp.arange(4.0)),
    "solve, transposed": lambda x: jax.vjp(lambda b: jnp.linalg.solve(_matrix(x), b), jnp.arange(4.0))[1](_array(x, 4)),
    "solve, derivative": lambda x: jax.hessian(lambda x: jnp.linalg.solve(_matrix(x), jnp.arange(4.0)))(x),
    "solve, many": lambda x: jnp.linalg.solve(jnp.stack([_matrix(x), _matrix(1 - x)]), jnp.ones((2, 4, 3))),
    "inv": lambda x: jnp.linalg.inv(_matrix(x, 6)),
    "inv of a singular one": lambda x: jnp.linalg.inv(jnp.outer(_array(x), jnp.zeros(3))),
    "lu of a wide one": lambda x: jax.scipy.linalg.lu(_matrix(x, 5)[:3]),
    "lu of a tall one": lambda x: jax.scipy.linalg.lu(_matrix(x, 5)[:, :3]),
    "slogdet": lambda x: jnp.linalg.slogdet(_matrix(x)),
    "cholesky": lambda x: jnp.linalg.cholesky(_matrix(x) @ _matrix(x).T + jnp.eye(4)),
    "cholesky of no such one": lambda x: jnp.linalg.cholesky(-jnp.eye(3) * x),
    "cho_solve": lambda x: jax.scipy.linalg.cho_solve(
        jax.scipy.linalg.cho_factor(_matrix(x) @ _matrix(x).T + jnp.eye(4), lower=True), jnp.ones(4)
    ),
    "solve_triangular": lambda x: [
        jax.scipy.linalg.solve_triangular(_matrix(x), jnp.ones((4, 2)), trans=trans, lower=lower, unit_diagonal=unit)
        for trans in (0, 1)
        for lower in (False, True)
        for unit in (False, True)
    ],
    "triangular_solve on the right": lambda x: [
        lax.linalg.triangular_solve(_matrix(x), jnp.ones((2, 4)), lower=lower, transpose_a=transpose)
        for lower in (False, True)
        for transpose in (False, True)
    ],
    "sort": lambda x: jnp.sort(_ties(x)),
    "sort downwards": lambda x: jnp.sort(_ties(x), descending=True),
    "argsort": lambda x: jnp.argsort(_ties(x)),
    "lexsort": lambda x: jnp.lexsort((_ties(x), jnp.round(_ties(1 - x)))),
    "sort of columns": lambda x: jnp.sort(_matrix(x), axis=0),
    "sort of whole numbers": lambda x: jnp.sort((_array(x) * 10).astype(int)),
    "median": lambda x: jnp.median(_array(x)),
    "percentile": lambda x: jnp.percentile(_array(x), 30.0),
    "top_k": lambda x: lax.top_k(_ties(x), 5),
    "top_k of bytes": lambda x: [
        lax.top_k(jnp.array(numbers, dtype) + (0 * x).astype(dtype), 2)
        for numbers, dtype in (([0, 5, 9], jnp.uint8), ([-128, 5, 9], jnp.int8))
    ],
    "top_k of whole numbers": lambda x: lax.top_k((_array(x) * 10).astype(int), 2),
    "derivative of a branch": lambda x: jax.grad(lambda u: lax.cond(u > 0.5, lambda u: u**2, lambda u: u**3, u))(x),
    "hessian": lambda x: jax.hessian(lambda u: jnp.asin(u) * jnp.atanh(u))(0.5 * x),
}

REFUSED = {
    "nextafter": lambda x: jnp.nextafter(x, 0.7),
    "conv_general_dilated": lambda x: jnp.convolve(_array(x), _array(x)),
    "lgamma": special.gammaln,
    "erf_inv": special.erfinv,
    "bessel_i0e": jnp.i0,
    "qr": lambda x: jnp.linalg.qr(_matrix(x))[1],
}


@pytest.mark.parametrize("first", range(12))
def test_functions_of_jax_are_jaxs(first):
    """Twelve programs of twelve functions: each alone takes both compilers three times as long."""

    def function(x):
        return {name: FUNCTIONS[name](x) for name in [*FUNCTIONS][first::12]}

    results, expected = Lanewise(function, (number,))(X), jax.jit(jax.vmap(function))(X)
    assert jax.tree.structure(results) == jax.tree.structure(expected)
    for (path, leaf), other in zip(jax.tree.leaves_with_path(results), jax.tree.leaves(expected), strict=True):
        assert leaf.dtype == other.dtype, path
        assert leaf == pytest.approx(np.asarray(other), rel=1e-12, abs=1e-13, nan_ok=True), path


@pytest.mark.parametrize("primitive", REFUSED)
def test_what_lanes_cannot_do_is_refused_by_name(primitive):
    with pytest.raises(NotForLanesError, match=f"`{primitive}`, which lanes cannot do: "):
        Lanewise(REFUSED[primitive], (number,))
