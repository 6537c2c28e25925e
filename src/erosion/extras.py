"""Imports on use: libraries of extras, which `pip install erosion` alone does not bring, and names of the package."""

import contextlib
import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any


class MissingExtraError(ImportError):
    """A library is not installed; says how to install it."""


@contextlib.contextmanager
def extra(name: str) -> Iterator[None]:
    """Import the libraries of an extra of `pyproject.toml` within.

    Raises:
        MissingExtraError: where one is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "erosion").partition(".")[0]
        if package == "erosion":
            raise
        raise MissingExtraError(
            f"The package {package} is not installed: pip install 'particle-erosion[{name}]'.", name=package
        ) from error


def library(module: str, extra_name: str) -> Any:
    """A module of an extra; errors as of `extra`."""
    with extra(extra_name):
        return importlib.import_module(module)


def on_use(module: str, file: str) -> Callable[[str], Any]:
    """The `__getattr__` of a module whose names are imported when they are used.

    Its stub lists them; a line `from home import *` stands for the other names of `home`.
    """
    loader: Any = sys.modules[module].__loader__  # also that of a zip file
    stub = loader.get_data(f"{file}i").decode().splitlines()
    lines = [line.split() for line in stub if line.startswith("from ")]
    module_of = {name: home for _, home, _, name, *_ in lines}

    def imported(name: str) -> Any:
        home = module_of.get(name, module_of.get("*"))
        if home is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return getattr(importlib.import_module(home), name)

    return imported
