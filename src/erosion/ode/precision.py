"""What JAX must be able to do: double precision, always, and to compute in this process."""

import os

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


def require_xla() -> None:
    """Raise where XLA cannot compute, which the batches of the engine do without.

    Raises:
        PrecisionError: see `require_float64`.
        RuntimeError: where the device that JAX is to use is not there, or where this process was forked
            from one in which XLA has computed: its threads do not come along, and it would wait for ever.
    """
    require_float64()
    global _process
    if _process is None:
        try:
            jax.default_backend()
        except (AssertionError, RuntimeError) as error:
            asked = os.environ.get("JAX_PLATFORMS", "")
            raise RuntimeError(
                f"JAX has no device to compute on, as JAX_PLATFORMS={asked} asks for one that is not here; unset it."
            ) from error
        _process = os.getpid()
    if _process != os.getpid():
        raise RuntimeError(
            "This process was forked from one in which JAX has computed, and JAX cannot go on in it; "
            'start processes by the method "spawn": multiprocessing.get_context("spawn").'
        )


_process: int | None = None
"""The process in which XLA has started."""
