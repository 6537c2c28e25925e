"""What is assumed of each parameter before the data: laws, and the map from normal numbers to values.

Every parameter is a function of one standard normal number, value = law⁻¹(Φ(z)). In z the prior of all parameters is
the same, so that one sampler fits all, and only the inverse distribution of a law is needed.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from erosion.calibration.forward import FACTORS, FRACTION, SCALE, Forward
from erosion.calibration.least_squares import default_width
from erosion.distributions import Distribution, LogUniform, Uniform
from erosion.models.own_parameters import own_parameters, quantities
from erosion.parameters.quantities import Quantity

NOISE = "noise"
"""The standard deviation of a row, a parameter where the data give no uncertainties."""

_SIGNED = "alpha", "phidot0"
_NOISES = 1e-4, 10.0  # of the typical erosion: from the digits of a balance to a model that explains nothing
_OUTSIDE = 0.01  # share of a law that may lie outside of a parameter's range
_MIDDLE = 0.5


@dataclasses.dataclass(frozen=True)
class Priors:
    """The laws of all sampled parameters.

    Args:
        laws: by parameter; "noise" is the last where the data give no uncertainties.
        chosen: the parameters whose laws the user gave; the others are defaults.
        ranges: by parameter, the shares of its law that lie below the parameter's range and up to its end.
    """

    laws: Mapping[str, Any]
    chosen: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]

    @property
    def names(self) -> tuple[str, ...]:
        """The sampled parameters."""
        return tuple(self.laws)

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters at standard normal numbers.

        Args:
            points: shape (…, names).

        Returns:
            Values by name, each of shape (…).
        """
        values = {}
        for (name, law), z in zip(self.laws.items(), np.moveaxis(points, -1, 0), strict=True):
            low, high = self.ranges[name]
            values[name] = np.asarray(law.ppf(low + (high - low) * special.ndtr(z)), float)
        return values

    def in_words(self, name: str, quantity: Quantity, units: Any) -> str:
        """A law as a person reads it."""
        law = self.laws[name]
        if isinstance(law, Distribution):
            return law.in_words(quantity.dimension, units)
        numbers = [f"{value:.5g}" for value in law.args] + [f"{key}={value:.5g}" for key, value in law.kwds.items()]
        return f"{law.dist.name}({', '.join(numbers)})"


def make_priors(forward: Forward, given: Mapping[str, Any]) -> Priors:
    """The laws that are given, and for all other parameters the default ones.

    The default is as wide as a fit looks for a parameter: all factors from 1/100 to 100 of the case's value are alike;
    a spin may differ from the case's by 2 v₀/r; a share of particles is anything up to 1. The scale of data in units of
    its own, and the noise, have a size that only the data know: their defaults are wide laws about it.

    Raises:
        ValueError, TypeError: for laws of parameters that are not free, or that do not fit the parameter.
    """
    names = (*forward.names, NOISE) if forward.data.uncertainty is None else forward.names
    for name in given:
        if name not in names:
            raise ValueError(f"Argument `priors` must name free parameters ({', '.join(names)}), but has {name!r}.")
    laws = {name: given[name] if name in given else _default(forward, name) for name in names}
    ranges = {
        name: _checked(name, law, _least(forward, name), 1.0 if name == FRACTION else np.inf)
        for name, law in laws.items()
    }
    return Priors(laws, tuple(name for name in names if name in given), ranges)


def sampled_quantities(forward: Forward) -> dict[str, Quantity]:
    """Symbol, meaning and dimension of all parameters that may be sampled."""
    noise = Quantity("s_n", "standard deviation of a row", forward.data.dimension)
    return {**quantities(forward.model), **FACTORS, NOISE: noise}


def _default(forward: Forward, name: str) -> Distribution:
    if name == FRACTION:
        return Uniform(0.0, 1.0)
    if name == NOISE:
        typical = float(np.sqrt(np.mean(forward.data.erosion**2)))
        return LogUniform(_NOISES[0] * typical, _NOISES[1] * typical)
    at = forward.names.index(name)
    start, width = forward.start[at], default_width(forward)[at]
    if name == SCALE:
        start = np.log(_scale_of(forward))
    low, high = forward.limits[at]
    low, high = (start - width if low == -np.inf else low), (start + width if high == np.inf else high)
    law = LogUniform if forward.logarithmic[at] else Uniform
    return law(float(forward.from_theta(name, low)), float(forward.from_theta(name, high)))


def _scale_of(forward: Forward) -> float:
    """Measured over computed erosion of the case."""
    computed = np.nan_to_num(forward.predict_many(forward.start[None], forward.data.conditions)[0])
    size = float(np.sqrt(np.mean(computed**2)))
    return float(np.sqrt(np.mean(forward.data.erosion**2))) / size if size > 0 else 1.0


def _least(forward: Forward, name: str) -> float:
    own = own_parameters(forward.model)
    return own[name].least if name in own else -np.inf if name in _SIGNED else 0.0


def _checked(name: str, law: Any, least: float, greatest: float) -> tuple[float, float]:
    """The shares of a law below the ends of the parameter's range.

    Raises:
        TypeError: for what is no law of one number.
        ValueError: for a law of which a hundredth or more lies outside.
    """
    if not (hasattr(law, "ppf") and hasattr(law, "cdf")):
        raise TypeError(
            f"Argument `priors` must give {name} a distribution such as Uniform(0.01, 0.2), but gives {law!r}."
        )
    middle = np.asarray(law.ppf(np.array([_MIDDLE])), float)
    if middle.shape != (1,) or not np.isfinite(middle[0]):
        raise ValueError(f"Argument `priors` must give {name} one finite number for each share, but {law} does not.")
    below = 0.0 if least == -np.inf else float(law.cdf(least))
    above = 1.0 if greatest == np.inf else float(law.cdf(greatest))
    if below + (1 - above) > _OUTSIDE:
        wish = f"above {least:g}" if greatest == np.inf else f"in ({least:g}, {greatest:g}]"
        raise ValueError(
            f"Argument `priors` must give {name} values {wish}, but {below + 1 - above:.1%} of {law} is not."
        )
    return below, above


def at_ends(share: float, names: Sequence[str], points: np.ndarray) -> dict[str, tuple[float, float]]:
    """By parameter, the shares of draws in the lowest and in the highest part of its prior.

    Args:
        share: of the prior in each of these parts.
        names: of the parameters.
        points: standard normal numbers, shape (…, names).
    """
    shares = special.ndtr(points).reshape(-1, len(names))
    below, above = (shares < share).mean(axis=0), (shares > 1 - share).mean(axis=0)
    return {name: (float(low), float(high)) for name, low, high in zip(names, below, above, strict=True)}
