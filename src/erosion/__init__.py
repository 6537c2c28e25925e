"""How a rigid particle cuts a ductile surface, and at which angle it removes most.

The public names load on first use, so that `erosion --help` need not wait for JAX; `__init__.pyi`
lists them. Importing the package turns JAX's 64-bit mode on (before JAX is loaded, if it is not yet).
"""

import gc
import importlib
import os
import sys

from erosion.version import __version__ as __version__


def _public_names() -> dict[str, str]:
    """Each public name, and the module that defines it."""
    # `ast`, `importlib.resources` and `typing` take longer to import than all else here: Ctrl-C would come
    # before the command can heed it.
    stub = __loader__.get_data(__file__ + "i").decode()  # pyrefly: ignore
    lines = [line.split() for line in stub.splitlines() if line.startswith("from ")]
    return {name: module for _, module, _, name, _, _ in lines}


_MODULE_OF = _public_names()

__all__ = list(_MODULE_OF)  # pyrefly: ignore


def _turn_float64_on() -> None:
    # An explicit JAX_ENABLE_X64=0 is left alone: the first computation says what to do.
    if "JAX_ENABLE_X64" in os.environ:
        return
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ["JAX_ENABLE_X64"] = "1"


_turn_float64_on()


def _import(module: str) -> object:
    # An import makes very many objects, none of them garbage: to look for it takes a third of the time.
    was_on = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        if was_on:
            gc.enable()


def __getattr__(name: str) -> object:
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'erosion' has no attribute {name!r}")
    value = _import(f"erosion.{name}") if module == "erosion" else getattr(_import(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
