import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion.compiler import for_speed
from erosion.kernels import Kernel, one_function


def test_one_function_may_leave_arguments_unused():
    """XLA ends the process where in a loop it compiles a function that does not use one of its arguments."""
    raise_ = Kernel(lambda x: jnp.stack([jnp.sqrt(x[0] + 1), x[1] * 2]))

    @functools.partial(jax.jit, compiler_options=for_speed())
    def thrice(x, unused):
        function = one_function(lambda x, unused: raise_(raise_(x)))
        return jax.lax.while_loop(lambda c: jnp.any(c[0] < 3), lambda c: (c[0] + 1, function(c[1], unused)), (0, x))[1]

    x = np.stack([np.linspace(0.0, 1.0, 64), np.ones(64)])
    expected = x[0]
    for _ in range(6):
        expected = np.sqrt(expected + 1)
    found = thrice(x, np.ones((3, 64)))
    assert found[0] == pytest.approx(expected, rel=1e-15)
    assert np.array_equal(found[1], 64 * x[1])


def test_one_function_takes_loops():
    halve = Kernel(lambda x: x / 2)
    loop = one_function(
        lambda x: jax.lax.while_loop(lambda x: jnp.any(x > 1), lambda x: jnp.where(x > 1, halve(x), x), x)
    )
    x = np.arange(1.0, 65.0)
    assert np.array_equal(jax.jit(loop)(x), x / 2.0 ** np.ceil(np.log2(x)))
