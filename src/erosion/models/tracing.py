"""Functions that JAX takes as a whole."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax

_Function = TypeVar("_Function", bound=Callable[..., Any])


def traced_once(function: _Function) -> _Function:
    """The function as one program: `jax.jit`, with a method's signature left as it is.

    Within other programs it is traced once for arguments of one kind, however many places and
    derivatives ask for it; outside, its operations are not compiled one by one.
    """
    return cast(_Function, jax.jit(function))
