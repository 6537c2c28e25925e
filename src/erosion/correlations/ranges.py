"""Common parts of correlations: units of erosion, targets by name, shapes of sand, and ranges of validity."""

import functools
import math
import types
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from erosion.arguments import refuse
from erosion.ode.step_control import require_float64, require_xla
from erosion.output import briefly
from erosion.results import Finding

Values = Float[Array | np.ndarray, "..."] | Int[Array | np.ndarray, "..."] | float | int
"""A number or an array; several broadcast."""

_Material = TypeVar("_Material")

UNITS = ("kg/kg", "mm3/kg", "mm3/impact")
"""Target lost per particle: mass per mass, volume per mass, volume per particle."""

_MM3 = 1e9  # mm³ in a m³


def in_units(ratio: Array, units: str, density: Values, mass: Values | None = None) -> Array:
    """The erosion in other units.

    Args:
        ratio: E, mass of target per mass of particles [kg/kg].
        units: one of `UNITS`; "mm³" is read as "mm3".
        density: of the target [kg/m³].
        mass: of a particle [kg], for "mm3/impact" alone.

    Raises:
        ValueError: for other units, or where the mass is missing or of no use.
    """
    wanted = units.replace("³", "3")
    refuse(
        "Argument ",
        (wanted not in UNITS, f"`units` must be one of {', '.join(UNITS)}, but is {briefly(units)}."),
        ((mass is not None) != (wanted == "mm3/impact"),
         "`mass` must be the mass of a particle [kg] for mm3/impact, and be left out for other units, but units are "
         f"{wanted} and mass is {briefly(mass)}."),
    )  # fmt: skip
    if wanted == "kg/kg":
        return ratio
    volume = ratio / density * _MM3
    return volume if mass is None else volume * mass


def of_table(table: Mapping[str, _Material], material: str | _Material, kind: type[_Material]) -> _Material:
    """A material by name, or the user's own.

    Raises:
        ValueError: for a name that the table lacks.
    """
    if isinstance(material, kind):
        return material
    if not isinstance(material, str) or material not in table:
        raise ValueError(
            f"Argument `material` must be one of {', '.join(table)}, or a {kind.__name__}, but is {briefly(material)}."
        )
    return table[material]


SHARPNESS: Mapping[str, float] = types.MappingProxyType({"sharp": 1.0, "semi-rounded": 0.53, "rounded": 0.2})
"""F_s [-] by the shape of sand (Edwards et al. 2000; Autodesk CFD 2023, Erosion; GEMINI geothermal suite, TULSA.py)."""


def sharpness_factor(sharpness: str | Values) -> Values:
    """F_s by name, or a number as it is; a ValueError for another name."""
    if not isinstance(sharpness, str):
        return sharpness
    if sharpness not in SHARPNESS:
        known = ", ".join(SHARPNESS)
        raise ValueError(f"Argument `sharpness` must be a number or one of {known}, but is {briefly(sharpness)}.")
    return SHARPNESS[sharpness]


class OutOfRangeWarning(UserWarning):
    """A correlation is used outside of the range that it is made for."""


@dataclass(frozen=True)
class Range:
    """The values of one quantity that a correlation is made for.

    Args:
        low, high: the least and the greatest value, in SI units and radians.
        unit: "rad", "m/s" or "m".
        source: who says so.
    """

    low: float
    high: float
    unit: str
    source: str

    def __str__(self) -> str:
        return f"{_in_words(self.low, self.unit)} to {_in_words(self.high, self.unit)}"


ALL_ANGLES = Range(0.0, math.pi / 2, "rad", "by definition")
ANGLES_ALONE: Mapping[str, Range] = types.MappingProxyType({"alpha": ALL_ANGLES})

_MEANINGS = {"alpha": "angles", "v0": "speeds", "diameter": "diameters"}
_ROUNDING = 1e-12


def warn_outside(title: str, ranges: Mapping[str, Range], **values: Values) -> None:
    """Warn where values are outside of their range, and say by how much; values that JAX traces are not known.

    Args:
        title: of the correlation.
        ranges: by the name of the argument.
        values: by the same names.

    Raises:
        PrecisionError, RuntimeError: where JAX cannot compute with these values; those that it traces wait for no
            device. See `require_xla`.
    """
    (require_float64 if any(isinstance(value, Tracer) for value in values.values()) else require_xla)()
    for name, value in values.items():
        if name not in ranges or isinstance(value, Tracer) or not np.size(value):
            continue
        span, array = ranges[name], np.asarray(value, dtype=float)
        least, greatest = float(np.nanmin(array, initial=np.inf)), float(np.nanmax(array, initial=-np.inf))
        excess = []
        if greatest > span.high * (1 + _ROUNDING):
            excess.append(f"{_in_words(greatest, span.unit)} is {greatest / span.high:.3g} times the greatest")
        if least < span.low * (1 - _ROUNDING):
            below = (
                f"{span.low / least:.3g} times less than" if least > 0 else f"{span.low - least:.3g} {span.unit} below"
            )
            excess.append(f"{_in_words(least, span.unit)} is {below} the least")
        if excess:
            # The line that called the correlation.
            warnings.warn(f"{title} is made for {_MEANINGS[name]} from {span}: {', and '.join(excess)}.",
                          OutOfRangeWarning, stacklevel=3)  # fmt: skip


def masks_outside(ranges: Mapping[str, Range], values: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Which values lie outside of the range of their argument by more than rounding, for each that has a range."""
    return {name: (value > ranges[name].high * (1 + _ROUNDING)) | (value < ranges[name].low * (1 - _ROUNDING))
            for name, value in values.items() if name in ranges}  # fmt: skip


def share_outside(
    name: str, ranges: Mapping[str, Range], values: Mapping[str, np.ndarray], counted: np.ndarray | None = None
) -> Finding | None:
    """The finding on the share of impacts outside of a correlation's range; None if there are none.

    Args:
        name: of the correlation.
        ranges: by the name of the argument.
        values: by the same names, of shapes that broadcast.
        counted: which impacts count, of their broadcast shape; all of them without it.
    """
    counts = np.asarray(True) if counted is None else counted
    masks = {key: mask & counts for key, mask in masks_outside(ranges, values).items()}
    crossed = {key: mask for key, mask in masks.items() if mask.any()}
    if not crossed:
        return None
    # Impacts that differ in nothing else are not counted one by one: their share is the same.
    share = float(np.mean(functools.reduce(np.logical_or, crossed.values())) / np.mean(counts))
    made_for = " and ".join(f"{_MEANINGS[key]} from {ranges[key]}" for key in crossed)
    code = "out_of_range" if share == 1 else "partly_out_of_range"
    return Finding(code, name, {"share": share, "made_for": made_for})


def _in_words(value: float, unit: str) -> str:
    return f"{math.degrees(value):.4g}°" if unit == "rad" else f"{value:.4g} {unit}"
