"""From a removed volume to the erosion that engineers measure: volume, and mass, per mass of particles."""

import math
import sys
import types
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from erosion.arguments import PerImpact
from erosion.output.tables import briefly, first_of
from erosion.parameters.materials import target
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import RESULTS, Scale, has_unit, read_quantity
from erosion.results import Finding, Value

PER_MASS_SCALES: Mapping[str, Scale] = types.MappingProxyType(
    {"specific_volume": Scale(1e-9, "mm³/kg"), "erosion_ratio": Scale(1e-3, "g/kg")}
)
"""The units in which erosion per mass of particles reads well, whatever the units of the case."""

BEYOND_TESTS = "more than ten times what tests find"
"""The mark of an amount in tables; see `FarFromTests.is_beyond`."""

# DNVGL-RP-O501 (2015), table 3-1, fits K vⁿ to tests: at 100 m/s 0.23 g/kg for aluminium, 0.32 g/kg for steels.
# n is 2.3 and 2.6 there. Tests of single alloys and grits spread about that by a factor of three.
_TESTED = (1e-4, 1e-3)  # kg/kg at `_TESTED_SPEED`
_TESTED_SPEED, _TESTED_EXPONENT = 100.0, 2.4  # m/s, -
_TESTED_DENSITIES = (2700.0, 7800.0)  # kg/m³, the aluminium and the steels of that table
_FAR = 3.0  # outside of the tests by this factor
_BEYOND = 10.0  # above the greatest of all tests by this factor
_NAMED = 3  # models that a sentence names
_LEAST_DENSITY = 1e-9  # kg/m³, far below that of any gas at which anything is cut
_LEAST_SHARE = 1e-9  # one particle in a thousand million; erosion by far fewer is lost in rounding


@dataclass(frozen=True)
class PerMass:
    """The conversion of a particle's volume to erosion per mass of particles.

    A model's volume is that of a particle that cuts. Of a jet only some particles do: the others roll, plough or turn
    their flat side. Finnie put their share at about one half; COMSOL 6.2 takes a tenth. Volumes stay those
    of a particle that cuts, erosion per mass of particles is that of all particles.

        erosion.PerMass(density=2700, cutting_fraction=0.5).erosion_ratio(best.volume, best.p)  # kg/kg

    Args:
        density: of the target [kg/m³], whatever the units of the case; None where it is not known.
        cutting_fraction: the share of the particles that cut, from 1e-9 to 1.

    Raises:
        TypeError: for what is no number.
        ValueError: for a number out of range.

    References:
        I. Finnie, Proc. 3rd U.S. Natl. Congr. Appl. Mech., 1958, 527-532; Wear 3 (1960) 87-103.
    """

    density: float | int | None = None
    cutting_fraction: float | int = 1.0

    def __post_init__(self) -> None:
        limits = {
            "density": (_LEAST_DENSITY, sys.float_info.max, "positive and finite", " kg/m³"),
            "cutting_fraction": (_LEAST_SHARE, 1.0, "above 0 and at most 1", ""),
        }
        for name, (least, greatest, wish, unit) in limits.items():
            given = getattr(self, name)
            if name == "density" and given is None:
                continue
            if not isinstance(given, Real):
                raise TypeError(f"Argument `{name}` must be a number, but is {briefly(given)}.")
            number = float(given)
            if not least <= number <= greatest:
                wish = f"at least {least:g}{unit}" if 0 < number < least else wish
                raise ValueError(f"Argument `{name}` must be {wish}, but is {briefly(given)}.")
            object.__setattr__(self, name, number)

    @classmethod
    def on(cls, name: str, cutting_fraction: float = 1.0) -> "PerMass":
        """For a target by name; see `erosion.target`."""
        return cls(target(name).density, cutting_fraction)

    def specific_volume(self, volume: Any, p: Parameters) -> PerImpact:
        """Removed volume per mass of particles [m³/kg], of volumes [m³]; they broadcast with p.m."""
        return self.cutting_fraction * (np.asarray(volume) / np.asarray(p.m))

    def erosion_ratio(self, volume: Any, p: Parameters) -> PerImpact:
        """Mass loss per mass of particles [kg/kg], of volumes [m³]; they broadcast with p.m.

        Raises:
            ValueError: without a density.
        """
        if self.density is None:
            raise ValueError("Argument `density` must be given for a mass loss, but is None.")
        return self.density * self.specific_volume(volume, p)

    def declare(self, volume: Any, p: Parameters) -> list[Value]:
        """Volume and, where the density is known, mass per mass of particles; in tables in mm³/kg and g/kg."""
        is_beyond = self.is_beyond_tests(volume, p)
        return [
            RESULTS[name].in_si(
                name, value, scale=PER_MASS_SCALES[name], meaning=self.meaning_of(name, is_beyond=is_beyond)
            )
            for name, value in self.to_dict(volume, p).items()
        ]

    def meaning_of(self, name: str, *, is_beyond: bool = False) -> str:
        """The meaning of a result per mass, with the share of the particles that cut, and the mark beyond tests."""
        some = "" if self.cutting_fraction == 1 else f"; {self.cutting_fraction:g} of the particles cut"
        return RESULTS[name].meaning + some + (f"; {BEYOND_TESTS}" if is_beyond else "")

    def to_dict(self, volume: Any, p: Parameters) -> dict[str, Any]:
        """`specific_volume` [m³/kg] and, where the density is known, `erosion_ratio` [kg/kg]."""
        numbers: dict[str, Any] = {"specific_volume": self.specific_volume(volume, p)}
        if self.density is not None:
            numbers["erosion_ratio"] = self.erosion_ratio(volume, p)
        return numbers

    def finding(self, volume: Any, p: Parameters) -> Finding | None:
        """The finding where the greatest erosion is far from what tests find at this speed, else None.

        None without a density and a cutting fraction, too: the numbers are then those of a scenario. Volumes
        [m³] broadcast with p.m and p.v0; the greatest is that over the speed's power.
        """
        far = self.far_from_tests(volume, p)
        return far.finding() if far else None

    @property
    def is_given(self) -> bool:
        """Whether an amount is asked for; without a density and a share of its own, cuts of a scenario are compared."""
        return self.density is not None or self.cutting_fraction != 1

    def far_from_tests(self, volume: Any, p: Parameters, *, of_any: bool = False) -> "FarFromTests | None":
        """The same in numbers; with `of_any` also where no amount is asked for."""
        is_asked = of_any or self.is_given
        return far_from_tests(self.specific_volume(volume, p), p.v0, self.density) if is_asked else None

    def is_beyond_tests(self, volume: Any, p: Parameters) -> bool:
        """Whether the greatest erosion is more than ten times what any test finds; see `FarFromTests.is_beyond`."""
        far = self.far_from_tests(volume, p, of_any=True)
        return far is not None and far.is_beyond


@dataclass(frozen=True)
class FarFromTests:
    """An erosion that is far from what tests find.

    Args:
        amount: the erosion, in `unit`.
        unit: "g/kg", or "mm³/kg" where the target's density is not known.
        speed: of the impacts [m/s].
        least, greatest: what tests find at this speed, in `unit`.
    """

    amount: float
    unit: str
    speed: float
    least: float
    greatest: float

    @property
    def is_above(self) -> bool:
        """Whether tests find less."""
        return self.amount > self.greatest

    @property
    def is_beyond(self) -> bool:
        """Whether it is more than ten times what any test finds: no amount to tell anyone, and marked in tables."""
        return self.amount > _BEYOND * self.greatest

    def finding(self, about: str = "") -> Finding:
        """The same for a reader, about models by name."""
        return Finding("above_tests" if self.is_above else "below_tests", about, asdict(self))


def models_far_from_tests(weights: Mapping[str, PerMass], volumes: Mapping[str, Any], p: Parameters) -> list[Finding]:
    """Findings on the models whose erosion is far from what tests find; models on the same side of it share one.

    Args:
        weights: by model; a model alone may have the name "".
        volumes: by model; see `PerMass.warning`.
        p: the case.
    """
    far = {name: said for name, weight in weights.items()
           if (said := weight.far_from_tests(volumes[name], p)) is not None}  # fmt: skip
    groups: dict[FarFromTests, list[str]] = {}
    for name, said in far.items():
        groups.setdefault(replace(said, amount=math.copysign(math.inf, said.is_above - 0.5)), []).append(name)
    findings = []
    for names in groups.values():
        greatest = max((far[name] for name in names), key=lambda said: said.amount)
        findings.append(greatest.finding(", ".join(first_of(names, _NAMED))))
    return findings


def far_from_tests(
    specific_volume: Any, speed: Any, density: float | None, factor: float = _FAR
) -> FarFromTests | None:
    """The greatest erosion, where it is far from what tests find at its speed.

    Args:
        specific_volume: removed volume per mass of particles [m³/kg]; it broadcasts with `speed`.
        speed: of the impacts [m/s].
        density: of the target [kg/m³]; None where it is not known. Then the range is that of all metals tested.
        factor: by which it must be outside of the tests.
    """
    removed, speed = np.broadcast_arrays(np.asarray(specific_volume, float), np.asarray(speed, float))
    usual = (speed / _TESTED_SPEED) ** _TESTED_EXPONENT
    finite = np.isfinite(removed) & (removed > 0)
    if not finite.any():
        return None
    at = int(np.argmax(np.where(finite, removed / usual, 0.0)))
    lightest, heaviest = _TESTED_DENSITIES if density is None else (density, density)
    low, high = _TESTED[0] * usual.flat[at] / heaviest, _TESTED[1] * usual.flat[at] / lightest
    if low / factor <= removed.flat[at] <= high * factor:
        return None
    size, unit = PER_MASS_SCALES["specific_volume" if density is None else "erosion_ratio"]
    size = size / (density or 1.0)
    numbers = (removed.flat[at] / size, low / size, high / size)
    amount, least, greatest = map(float, numbers)
    return FarFromTests(amount, unit, float(speed.flat[at]), least, greatest)


def two_digits(number: float) -> str:
    """An amount to two digits, for a sentence."""
    return f"{float(f'{number:.2g}'):g}"


def read_density(text: Any) -> float:
    """A density as text, with its unit [kg/m³].

    Raises:
        ValueError: with a clause that starts with "must", to follow the field's name.
    """
    if not isinstance(text, str) or not has_unit(text):
        raise ValueError(f'must be a density with its unit, such as "2.7 g/cm^3", but is {briefly(text)}')
    return read_quantity(text, "density")
