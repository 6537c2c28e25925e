"""Types and checks of arguments that many verbs take: arrays, tolerances, whole numbers, paths, progress."""

import contextlib
import decimal
import fractions
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, PyTreeDef, Real, Shaped

from erosion.output.tables import briefly

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


Progress = Callable[[str, int, int], object]
"""A function that is called with the name of the work, how much of it is done, and how much there is."""

NUMBERS = (int, float, np.integer, np.floating)
"""The types of a real number."""
_REAL = (*NUMBERS, decimal.Decimal, fractions.Fraction)


def check_order(derivatives: Any) -> int:
    """How many derivatives: 0, 1 or 2."""
    if isinstance(derivatives, bool) or not isinstance(derivatives, (int, np.integer)) or derivatives not in (0, 1, 2):
        raise ValueError(f"Argument `derivatives` must be 0, 1 or 2, but is {briefly(derivatives)}.")
    return int(derivatives)


def check_share(name: str, value: Any) -> float:
    """The argument, a tolerance or a probability, as a float; a `ValueError` where it is not in (0, 1)."""
    if not isinstance(value, NUMBERS) or not 0 < value < 1:
        raise ValueError(f"Argument `{name}` must be in (0, 1), but is {briefly(value)}.")
    return float(value)


def check_whole(name: str, value: Any, least: int) -> int:
    """The argument as an int; a `ValueError` where it is no whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"Argument `{name}` must be a whole number of at least {least}, but is {briefly(value)}.")
    return int(value)


def as_names(argument: str, given: Any) -> tuple[str, ...]:
    """One name or several as a tuple; a `TypeError` where they are something else."""
    names = (given,) if isinstance(given, str) or not isinstance(given, Iterable) else tuple(given)
    if not all(isinstance(name, str) for name in names):
        raise TypeError(f"Argument `{argument}` must be a name or a list of names, but is {briefly(given)}.")
    return names


def as_pair(pair: Any) -> tuple[float, float]:
    """Two numbers, such as the ends of a range, as floats; NaN where it is something else."""
    try:
        first, second = (float(number) for number in pair)
    except (TypeError, ValueError):
        return np.nan, np.nan
    return first, second


def check_scalars(values: Mapping[str, Any], instead: str = "") -> None:
    """A `ValueError` that names the first argument that is an array; `instead` ends it: what takes arrays."""
    for name, value in values.items():
        if shape := np.shape(value):
            raise ValueError(f"Argument `{name}` must be a scalar here, but has shape {shape}{instead}.")


def refuse(lead: str, *table: tuple[object, str], kind: type[Exception] = ValueError) -> None:
    """Raise an error where a condition of a table is true: `lead`, and then the clause beside the first of them."""
    for condition, clause in table:
        if condition:
            raise kind(f"{lead}{clause}")


def check_unmasked(name: str, value: Any) -> None:
    """A `ValueError` where values are masked: all that computes with arrays ignores the mask."""
    if np.ma.is_masked(value):
        raise ValueError(f"Argument `{name}` must have no masked values; leave them out, or fill them with NaN.")


def unit_of_labels(values: Any) -> str:
    """The unit that an array of xarray, pandas, netCDF4 or h5py says it is in; empty where it says none."""
    attributes = getattr(values, "attrs", None)
    unit = attributes.get("units", "") if isinstance(attributes, Mapping) else getattr(values, "units", "")
    unit = unit.decode(errors="replace") if isinstance(unit, bytes) else unit
    return ("1" if unit == "dimensionless" else unit) if isinstance(unit, str) else ""


def real_numbers(name: str, values: Any, *, unit: str = "") -> np.ndarray:
    """Values as an array of float64, `None` as NaN.

    Args:
        name: of the argument.
        values: the numbers.
        unit: that arrays with labels may say they are in.

    Raises:
        ValueError: for masked and complex values, quantities with units, texts and dates, of which numpy makes numbers.
    """
    check_unmasked(name, values)
    parts = values if isinstance(values, (list, tuple)) else [values]
    array = np.empty(0, str)
    for part in parts:
        if not isinstance(part, _REAL) and unit_of_labels(part) not in ("", unit or "1"):
            raise ValueError(
                f"Argument `{name}` must hold numbers without units, but is in {briefly(unit_of_labels(part))}: "
                "give its `.to_numpy()` in the unit that is meant."
            )
    held = (
        thing for part in parts for thing in (part, getattr(part, "data", None) if hasattr(part, "attrs") else None)
    )
    if not any(hasattr(type(thing), name) for thing in held for name in ("magnitude", "unit")):
        with contextlib.suppress(TypeError, ValueError):  # lists of several lengths
            array = np.asarray(values)
    if array.dtype.kind == "O" and all(part is None or isinstance(part, _REAL) for part in array.flat):
        array = array.astype(float)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"Argument `{name}` must hold real numbers without units, but holds {briefly(values)}.")
    return array.astype(float)


def check_path(name: str, value: Any) -> Path:
    """The argument as a path; a `TypeError` or `ValueError` where it cannot be one."""
    if not isinstance(value, (str, Path)):
        raise TypeError(f"Argument `{name}` must be a path, but is {briefly(value)}.")
    if "\0" in str(value):
        raise ValueError(f"Argument `{name}` must be a path, but {str(value)!r} holds a zero byte.")
    return Path(value)


def no_progress(work: str, done: int, total: int) -> None:
    """Ignore the progress: the default of `progress`."""
