"""What the verbs use of the package, imported when a verb uses it: JAX alone takes a second. `lazy.pyi` lists it."""

import importlib
from pathlib import Path

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_LINES = [line.split() for line in _STUB.splitlines() if line.startswith("from ")]
_MODULE_OF = {name: module for _, module, _, name, _, _ in _LINES}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)
