"""Double precision, always: a silent float32 result is a bug."""

import jax


class PrecisionError(RuntimeError):
    """JAX is running in single precision."""


def require_float64() -> None:
    """Raise where JAX would compute in float32.

    Importing `erosion` turns 64-bit mode on, so this only fails where the environment
    (`JAX_ENABLE_X64=0`) or a later `jax.config.update` has turned it off.

    Raises:
        PrecisionError: with the line that mends it.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise PrecisionError(
            "erosion needs float64, but JAX's 64-bit mode is off; unset JAX_ENABLE_X64 or call "
            'jax.config.update("jax_enable_x64", True) before computing.'
        )
