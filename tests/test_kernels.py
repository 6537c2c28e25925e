import jax
import jax.numpy as jnp
import numpy as np

from erosion.kernels import Kernel, one_function


def test_one_function_may_leave_arguments_unused():
    """XLA ends the process where it compiles a function that does not use one of its arguments."""
    square = Kernel(lambda x: x * x)
    x, unused = np.linspace(0.0, 1.0, 64), np.ones((3, 64))

    @jax.jit
    def both(x, unused, flag):
        beside = 2.0 * unused  # closed over, and not used either
        return one_function(lambda x, unused, flag: {"square": square(x), "sum": square(x) + 0.0 * beside[0]})(
            x, unused, flag
        )

    found = both(x, unused, jnp.array(True))
    assert np.array_equal(found["square"], x * x)
    assert np.array_equal(found["sum"], x * x)


def test_one_function_takes_loops():
    halve = Kernel(lambda x: x / 2)
    loop = one_function(
        lambda x: jax.lax.while_loop(lambda x: jnp.any(x > 1), lambda x: jnp.where(x > 1, halve(x), x), x)
    )
    x = np.arange(1.0, 65.0)
    assert np.array_equal(jax.jit(loop)(x), x / 2.0 ** np.ceil(np.log2(x)))
