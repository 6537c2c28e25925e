"""Over which speeds and diameters the form of a CFD code is to hold, and what it loses there."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from erosion.array_types import Broadcast
from erosion.exports.particle import ExportError, Particle, in_si
from erosion.models import model_name
from erosion.parameters.parameters import Parameters

ANGLES = np.deg2rad(np.arange(0.5, 90.25, 0.25))
NEAR, FAR = 0.02, 0.15
"""Misfits of a form over the maximum of a curve: above the first it is said, above the last refused."""

_HALF_TO_TWICE = np.geomspace(0.5, 2, 9)

_Erosion = Callable[[Broadcast, Broadcast, Broadcast], np.ndarray]
"""Of angle [rad], speed [m/s] and diameter [m]: the volume removed per mass of particles [m³/kg]."""


@dataclasses.dataclass(frozen=True)
class Reach:
    """Speeds [m/s] and diameters [m], ascending; `asked` where a form must hold over all of them."""

    speeds: np.ndarray
    diameters: np.ndarray
    asked: bool

    @classmethod
    def of(cls, particle: Particle, p: Parameters, v0: Any = None, d: Any = None) -> "Reach":
        """What is asked for in the units of `p`; without both, from half to twice the particle's own.

        Raises:
            ValueError: for a speed or a diameter that is not positive.
        """
        if v0 is d is None:
            return cls(_HALF_TO_TWICE * particle.speed, _HALF_TO_TWICE * particle.diameter, asked=False)
        return cls(in_si("v0", v0, p, particle.speed), in_si("d", d, p, particle.diameter), asked=True)


def more_than_own(values: np.ndarray, own: float) -> np.ndarray:
    """The speeds or diameters to which a form is fitted: from half to twice the case's where no others are given."""
    return _HALF_TO_TWICE * own if np.allclose(values, own, rtol=1e-9, atol=0) else values


@dataclasses.dataclass(frozen=True)
class Losses:
    """How far a form is off at other speeds and diameters, over the curve's greatest value there.

    Args:
        reach: the speeds and diameters.
        misfit: greatest difference over all angles, shape (diameters, speeds) [-].
        speed, diameter: of the case [m/s], [m].
    """

    reach: Reach
    misfit: np.ndarray
    speed: float
    diameter: float

    @property
    def worst(self) -> float:
        """The greatest misfit."""
        return float(self.misfit.max())

    @property
    def statement(self) -> str:
        """A sentence with the numbers."""
        speeds, diameters = self.reach.speeds, self.reach.diameters
        if self.reach.asked:
            over = f"{_range(speeds)} m/s" + (f" and {_range(1e6 * diameters)} um" if diameters.size > 1 else "")
            return f"Over {over} the form is off by up to {self.worst:.2%} of the maximum there."
        own_speed, own_size = np.argmin(np.abs(speeds - self.speed)), np.argmin(np.abs(diameters - self.diameter))
        ends = [0, -1]
        return (
            f"The form is made at {self.speed:.6g} m/s. At half and at twice this speed it is off by up to "
            f"{self.misfit[own_size, ends].max():.2%} of the maximum there, at half and at twice the diameter by up to "
            f"{self.misfit[ends, own_speed].max():.2%}."
        )


def own_curve(particle: Particle) -> np.ndarray:
    """The volume removed per mass of particles at `ANGLES`, the case's speed and diameter [m³/kg].

    Raises:
        ExportError: where nothing is removed.
    """
    erosion = particle.erosion(ANGLES, particle.speed, particle.diameter)
    if erosion.max() <= 0:
        raise ExportError(f"{model_name(particle.model)} removes nothing at any angle: it has no curve to export.")
    return erosion


def losses(code: str, form: _Erosion, particle: Particle, reach: Reach) -> Losses:
    """What a form loses.

    Args:
        code: its name, for messages.
        form: what the code computes.
        particle: what the model computes.
        reach: over which speeds and diameters.

    Raises:
        ExportError: where the form is asked to hold and is off by more than 15 % of the maximum.
    """
    speeds, diameters = reach.speeds[:, None], reach.diameters[:, None, None]
    erosion, formed = particle.erosion(ANGLES, speeds, diameters), form(ANGLES, speeds, diameters)
    greatest = erosion.max(axis=-1)
    # Where the model removes nothing, all that the form removes is lost.
    size = np.where(greatest > 0, greatest, np.maximum(formed.max(axis=-1), np.finfo(float).tiny))
    misfit = np.abs(formed - erosion).max(axis=-1) / size
    lost = Losses(reach, misfit, particle.speed, particle.diameter)
    if reach.asked and lost.worst > FAR:
        at = np.unravel_index(np.argmax(misfit), misfit.shape)
        raise ExportError(
            f"The form of {code} is made at {particle.speed:.4g} m/s, and at {reach.speeds[at[1]]:.4g} m/s and "
            f"{1e6 * reach.diameters[at[0]]:.4g} µm it is off by up to {misfit[at]:.1%} of the maximum; give a "
            "narrower range, or use a table of volumes over angle, speed and diameter (--table)."
        )
    return lost


def _range(values: np.ndarray) -> str:
    first, last = f"{values[0]:.4g}", f"{values[-1]:.4g}"
    return first if len(values) == 1 else f"{first} to {last}"
