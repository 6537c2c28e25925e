"""What the verbs use of the package, imported when a verb uses it: JAX alone takes a second. `lazy.pyi` lists it."""

import importlib

_STUB = __loader__.get_data(__file__ + "i").decode()  # pyright: ignore[reportOptionalMemberAccess]
_LINES = [line.split() for line in _STUB.splitlines() if line.startswith("from ")]
_MODULE_OF = {name: module for _, module, _, name, _, _ in _LINES}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)
