"""Libraries of extras, which `pip install erosion` alone does not bring: imported when a function needs them."""

import contextlib
import importlib
from collections.abc import Iterator
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
            f"The package {package} is not installed: pip install 'erosion[{name}]'.", name=package
        ) from error


def library(module: str, extra_name: str) -> Any:
    """A module of an extra; errors as of `extra`."""
    with extra(extra_name):
        return importlib.import_module(module)
