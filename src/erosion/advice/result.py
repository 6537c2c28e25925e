"""What `advise` finds: curves of erosion over the nozzle's angle, the advised angle, and sentences on them."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from erosion.parameters.materials import Particle, Target
from erosion.parameters.parameters import Parameters
from erosion.parameters.per_mass import PER_MASS_SCALES, PerMass
from erosion.parameters.scales import Scale
from erosion.tables import Record, Result, to_plain

NOZZLE_ANGLES = np.deg2rad(np.arange(1.0, 90.5, 0.5))
"""The angles of the nozzle that are compared [rad]."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """Erosion by a jet over the angle of the nozzle, by one model or correlation.

    Args:
        name: of the model or correlation.
        group: "models", "k", "psi" or "correlations": what differs within the group.
        setting: what differs from the case, "k = 1", or "".
        erosion: volume per mass of abrasive at `NOZZLE_ANGLES`, shape (n,) [m³/kg].
        density: of the target [kg/m³], or None.
        fits: whether the absolute numbers are made for this target.
        single: of a model as it is, the best angle of attack of one particle without the spread of the jet [rad].
    """

    name: str
    group: str
    setting: str
    erosion: np.ndarray
    density: float | None
    fits: bool = True
    single: float | None = None

    @functools.cached_property
    def best(self) -> float:
        """The angle of the nozzle that removes most [rad], by the parabola through the three highest points."""
        top = int(np.clip(np.argmax(self.erosion), 1, self.erosion.size - 2))
        before, at, after = self.erosion[top - 1 : top + 2]
        bend = before - 2 * at + after
        shift = 0.0 if bend == 0 else float(np.clip(0.5 * (before - after) / bend, -1, 1))
        return float(NOZZLE_ANGLES[top] + shift * (NOZZLE_ANGLES[1] - NOZZLE_ANGLES[0]))

    @property
    def shares(self) -> np.ndarray:
        """Erosion over its greatest value, shape (n,)."""
        return self.erosion / self.erosion.max()

    def share(self, alpha: float) -> float:
        """Erosion at an angle of the nozzle over its greatest value."""
        return float(np.interp(alpha, NOZZLE_ANGLES, self.shares))

    def at(self, alpha: float) -> float:
        """Erosion at an angle of the nozzle: mass per mass [kg/kg], or volume per mass [m³/kg] without a density."""
        return float(np.interp(alpha, NOZZLE_ANGLES, self.erosion)) * (self.density or 1.0)


@dataclasses.dataclass(frozen=True)
class Advice(Result):
    """A nozzle's angle, and what speaks for it.

    Args:
        p: the case; its angle is not used.
        spread: standard deviation of the angles in the jet [rad].
        speed_spread: standard deviation of the logarithm of the speeds.
        per_mass: density of the target, share of the particles that cut.
        curves: every model, its variations, and every correlation.
        particle, target: where they were named.
        outside: sentences on correlations that are used outside of their range.
    """

    p: Parameters
    spread: float
    speed_spread: float
    per_mass: PerMass
    curves: tuple[Curve, ...]
    particle: Particle | None = None
    target: Target | None = None
    outside: tuple[str, ...] = ()

    @functools.cached_property
    def alpha(self) -> float:
        """The advised angle of the nozzle [rad], where the curve that loses most loses least."""
        return float(NOZZLE_ANGLES[int(np.argmax(self.worst_shares))])

    @property
    def worst_shares(self) -> np.ndarray:
        """At each angle the least of all curves' shares of their own greatest erosion, shape (n,)."""
        return np.min([curve.shares for curve in self.curves], axis=0)

    @property
    def low(self) -> float:
        """The least of the curves' own best angles [rad]."""
        return min(curve.best for curve in self.curves)

    @property
    def high(self) -> float:
        """The greatest of the curves' own best angles [rad]."""
        return max(curve.best for curve in self.curves)

    @property
    def worst(self) -> float:
        """The share of its own greatest erosion that every curve reaches at the advised angle."""
        return min(curve.share(self.alpha) for curve in self.curves)

    def group(self, name: str) -> list[Curve]:
        """The curves of a group; those of "k" and "psi" beside the models as they are."""
        return [curve for curve in self.curves if curve.group == name]

    @property
    def title(self) -> str:
        """Particle, target and speed."""
        speed = float(self.p.to("si").v0)
        of = f"{self.particle or 'the particle of the case'} on {self.target or 'the target of the case'}"
        return f"{of[0].upper()}{of[1:]} at {speed:.4g} m/s: {degrees(self.alpha)}"

    @property
    def headings(self) -> Sequence[str]:
        """The columns of the table."""
        at = degrees(self.alpha)
        return "what varies", "best nozzle angle", f"share at {at}", f"erosion at {at} [{self.unit}]"

    @property
    def unit(self) -> str:
        """Of erosion in the table, "g/kg", or "mm³/kg" where the density is not known."""
        return self._scale.unit

    @property
    def _scale(self) -> Scale:
        return PER_MASS_SCALES["specific_volume" if self.per_mass.density is None else "erosion_ratio"]

    def rows(self) -> list[tuple[str, ...]]:
        """What varies, the range of best angles, and what the advised angle gives."""
        models = self.group("models")
        count = "one model" if len(models) == 1 else f"{len(models)} models"
        rows = [self._row(f"{count}, k = {float(self.p.k):g}, ψ = {float(self.p.psi):g}", models)]
        for name, symbol in (("k", "k"), ("psi", "ψ")):
            varied = self.group(name)
            if varied:
                ends = list(dict.fromkeys(curve.setting.partition(" = ")[2] for curve in varied))
                rows.append(self._row(f"{symbol} from {ends[0]} to {ends[-1]}", varied))
        correlations = self.group("correlations")
        if correlations:
            rows.append(self._row(f"{len(correlations)} correlations of tests", correlations))
        singles = np.array([curve.single for curve in models], float)
        rows.append(("the models without the spread of the jet", between(singles), "", ""))
        return rows

    def _row(self, what: str, curves: Sequence[Curve]) -> tuple[str, ...]:
        best = between(np.array([curve.best for curve in curves]))
        least = min(curve.share(self.alpha) for curve in curves)
        return what, best, f"at least {least:.0%}", self.span([curve for curve in curves if curve.fits])

    def span(self, curves: Sequence[Curve]) -> str:
        """The least and the greatest erosion of curves at the advised angle, as text."""
        if not curves:
            return "–"
        ends = [curve.at(self.alpha) / self._scale.size for curve in curves]
        low, high = (f"{float(f'{end:.2g}'):g}" for end in (min(ends), max(ends)))
        return low if low == high else f"{low} to {high}"

    @property
    def statements(self) -> list[str]:
        """The advice in sentences."""
        sentences = [
            f"Set the nozzle to {degrees(self.alpha)} from the surface. There every model and correlation removes at "
            f"least {self.worst:.0%} of what it removes at its own best angle; these best angles lie from "
            f"{degrees(self.low)} to {degrees(self.high)}.",
            self._amount(),
            self._narrowing(),
        ]
        if self.particle is not None and self.particle.shape == "round":
            sentences.append("The models take a sharp edge; round particles plough more and cut less, so expect less.")
        return sentences

    def _amount(self) -> str:
        models = [curve for curve in self.curves if curve.group != "correlations"]
        fraction = self.per_mass.cutting_fraction
        text = f"The models remove {self.span(models)} {self.unit} there if {fraction:.3g} of the particles cut"
        fitting = [curve for curve in self.group("correlations") if curve.fits]
        if fitting:
            text += f", and the correlations for this metal {self.span(fitting)} {self.unit}: trust these more"
        if self.per_mass.density is None:
            text += "; name the target, or give its density, for g/kg"
        return text + "."

    def _narrowing(self) -> str:
        """What would narrow the range of best angles most."""
        models = self.group("models")
        spans = {"the choice of the model": _width(models)}
        for name, symbol in (("k", "the force ratio k"), ("psi", "the contact ratio ψ")):
            widths = [_width([*self.group(name), model], model.name) for model in models]
            spans[symbol] = max(widths, default=0.0)
        widest = max(spans, key=lambda name: spans[name])
        return (
            f"What would narrow it: {widest} moves the best angle of the models most, by up to "
            f"{degrees(spans[widest])}. Weigh the loss at four angles (15°, 30°, 45°, 60°) with your own abrasive and "
            "metal; “erosion calibrate” then chooses the model and fits k and ψ."
        )

    def to_dict(self) -> Record:
        """The advised angle, the ranges and every curve's best angle and erosion there; angles in rad."""
        curves = [
            {"name": curve.name, "group": curve.group, "setting": curve.setting, "alpha_max": curve.best,
             "single_alpha_max": curve.single, "share": curve.share(self.alpha), "fits": curve.fits,
             ("specific_volume" if curve.density is None else "erosion_ratio"): curve.at(self.alpha)}
            for curve in self.curves
        ]  # fmt: skip
        numbers: dict[str, Any] = {
            "alpha": self.alpha, "low": self.low, "high": self.high, "worst_share": self.worst,
            "spread": self.spread, "speed_spread": self.speed_spread,
            "density": self.per_mass.density, "cutting_fraction": self.per_mass.cutting_fraction,
            "particle": None if self.particle is None else str(self.particle),
            "target": None if self.target is None else str(self.target),
            "curves": curves, "statements": self.statements,
        }  # fmt: skip
        return to_plain(numbers)


UNITS = {
    **dict.fromkeys(("alpha", "low", "high", "spread", "alpha_max", "single_alpha_max"), "rad"),
    "erosion_ratio": "kg/kg", "specific_volume": "m^3/kg", "density": "kg/m^3",
}  # fmt: skip
"""The units of `Advice.to_dict`, as programs read them."""


def degrees(alpha: float) -> str:
    """An angle for people: "27°"; of less than 10° with a decimal."""
    value = float(np.rad2deg(alpha))
    return f"{value:.1f}°" if value < 9.95 else f"{value:.0f}°"


def between(angles: np.ndarray) -> str:
    """The least and the greatest of some angles, as text."""
    low, high = degrees(float(angles.min())), degrees(float(angles.max()))
    return low if low == high else f"{low} to {high}"


def _width(curves: Sequence[Curve], name: str | None = None) -> float:
    """Between the least and the greatest best angle of curves, of one name where it is given [rad]."""
    best = [curve.best for curve in curves if name in (None, curve.name)]
    return max(best) - min(best) if best else 0.0
