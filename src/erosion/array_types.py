"""Types of numbers, by how many there are; where JAX traces, its tracers are of these types as well."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, PyTreeDef, Real, Shaped

Scalar = Real[Array | np.ndarray, ""] | float | int
"""One real number."""

Flag = Bool[Array | np.ndarray, ""] | np.bool_ | bool
"""One truth value."""

Number = Shaped[Array | np.ndarray, "..."] | float | int
"""One number of a model or case, or a small array of them, of any type."""

Broadcast = Real[Array | np.ndarray, "..."] | float | int
"""A real number, or an array that holds one for each of many impacts and broadcasts with others."""

ModelState = PyTree
"""A model's own state: any pytree of real numbers, or of arrays (times,) of them."""

PerLane = Shaped[np.ndarray, "..."]
"""An array (lanes, …) of each lane's number or small array, or a single one that all lanes share."""

Indices = Int[np.ndarray, "_"]
"""Indices of lanes, or of other things in one row."""

Numbers = Float[np.ndarray, "_"]
"""A number of each row, face or other thing."""

Vectors = Float[np.ndarray, "_ 3"]
"""A vector of each row, face or other thing."""

if TYPE_CHECKING:
    Structure = Any
    PerImpact = Any
else:
    # What JAX knows of a pytree beside its leaves; it is C++ without types.
    Structure = PyTreeDef
    # A result of each impact: an array of the parameters' shape, or one number, word or tuple; None if not asked for.
    PerImpact = np.ndarray | np.generic | Array | float | int | str | tuple | None
