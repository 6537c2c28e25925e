"""The libraries of the extra `cfd`, imported when a file needs them."""

import importlib
from typing import Any

from erosion.cfd.impacts import ImpactsError


def library(name: str) -> Any:
    """The module of that name.

    Raises:
        ImpactsError: a sentence that says how to install it, where it is missing.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:
            raise
        raise ImpactsError(
            f"Impacts of CFD runs need the package {error.name}, which is not installed: pip install 'erosion[cfd]'."
        ) from error
