"""Statements on the abrasive: its hardness, a comparison with another one, and the amount for a job."""

import dataclasses
from collections.abc import Iterable, Sequence

from erosion.correlations.families import DIAMETER_EXPONENT
from erosion.correlations.ranges import SHARPNESS
from erosion.correlations.registry import HARD_ENOUGH, SHAPES, oka_normal
from erosion.parameters import VICKERS, Particle, Target, two_digits

_OKA = "oka:"


def hardness_ratio(particle: Particle, target: Target) -> float | None:
    """Hardness of the abrasive over that of the metal; None where it is not known."""
    return None if particle.vickers is None else particle.vickers * VICKERS / target.hardness


def hardness_sentence(particle: Particle, target: Target, name: str) -> str:
    """The effect of the abrasive's hardness on the amounts."""
    ratio = hardness_ratio(particle, target)
    if ratio is None:
        return (
            f"{name}: its hardness is not known here and enters no number; below about 1.2 times that of the "
            "metal it would remove much less (Pintaude 2010)."
        )
    if ratio < HARD_ENOUGH:
        return (
            f"{name}: only {ratio:.2g} times as hard as the metal. Below about 1.2 times an abrasive hardly scratches "
            "(Pintaude 2010): the amounts are too large."
        )
    return (
        f"{name}: {ratio:.2g} times as hard as the metal. Above about 1.2 times (Pintaude 2010) tests find no effect "
        "of the abrasive's hardness (Feng and Ball 1999), and it enters no number here."
    )


def size_and_shape(particle: Particle, other: Particle) -> tuple[float, float] | None:
    """The ratio of the other's removal to the particle's, per kilogramme, by size and by shape.

    The size counts to the power 0.19 (Oka), the shape as E/CRC's factor; None where a shape is not known.
    """
    if not {particle.shape, other.shape} <= SHAPES.keys():
        return None
    first, second = (SHARPNESS[SHAPES[grit.shape]] for grit in (particle, other))
    return (other.size / particle.size) ** DIAMETER_EXPONENT, second / first


def oka_ratio(particle: Particle, other: Particle, target: Target, v0: float) -> float | None:
    """The same at 90° by Oka's tests, where they had both abrasives and the metal."""
    metals = [name.removeprefix(_OKA) for name in target.correlations if name.startswith(_OKA)]
    if not (particle.oka and other.oka and metals):
        return None
    return oka_normal(other.oka, v0, other.size, metals[0]) / oka_normal(particle.oka, v0, particle.size, metals[0])


def comparison(particle: Particle, other: Particle, target: Target, v0: float, names: tuple[str, str]) -> str:
    """Whether another abrasive removes more of a metal, and by what; with the `names` of both."""
    factors, both = size_and_shape(particle, other), f"{names[1]} instead of {names[0]}"
    ratios = [hardness_ratio(grit, target) for grit in (particle, other)]
    soft = [name for name, ratio in zip(names, ratios, strict=True) if ratio is not None and ratio < HARD_ENOUGH]
    if soft:
        return f"{both}: no ratio can be told, for {soft[0]} is less than 1.2 times as hard as the metal."
    if factors is None or None in ratios:
        return f"{both}: no ratio can be told, for a shape or a hardness is not known."
    size, shape = factors
    ratio = f"{size * shape:.2g}"
    amount = "about as much" if ratio == "1" else f"about {ratio} times as much"
    text = (
        f"{both}: {amount} for a kilogramme, {size:.2f} times by the size (diameter to the power 0.19, Oka 2005) and "
        f"{shape:.2f} times by the shape (E/CRC). Both are more than 1.2 times as hard as the metal, so that hardness "
        "changes little (Feng and Ball 1999)."
    )
    oka = oka_ratio(particle, other, target, v0)
    return text if oka is None else f"{text} In tests of Oka at 90° it is {oka:.2g} times."


@dataclasses.dataclass(frozen=True)
class Job:
    """A depth to remove from an area.

    Args:
        area: [m²].
        depth: [m].
        feed: abrasive that leaves the nozzle [kg/s], or None.
    """

    area: float
    depth: float
    feed: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("area", self.area), ("depth", self.depth), ("feed", self.feed)):
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"Argument `{name}` must be positive, but is {value:g}.")

    @property
    def volume(self) -> float:
        """Of the metal to remove [m³]."""
        return self.area * self.depth

    def abrasive(self, erosion: Sequence[float]) -> tuple[float, float]:
        """The least and the greatest mass of particles [kg], by the erosion at the angle [m³/kg]."""
        return self.volume / max(erosion), self.volume / min(erosion)

    def sentence(self, erosion: Sequence[float], density: float | None) -> str:
        """Volume, abrasive and time; `density` of the target [kg/m³]."""
        ends = self.abrasive(erosion)
        metal = f"{self.area:.3g} m² by {self.depth * 1e6:.3g} µm are {self.volume * 1e6:.3g} cm³ of metal"
        if density is not None:
            metal += f", {self.volume * density:.3g} kg"
        text = f"{metal}: that takes {between(map(two_digits, ends))} kg of abrasive"
        if self.feed is None:
            return f"{text}."
        minutes = between(two_digits(mass / self.feed / 60) for mass in ends)
        return f"{text}, {minutes} minutes at {self.feed * 60:.3g} kg/min."


def between(texts: Iterable[str]) -> str:
    """From the first to the last of some texts in order; one text where they are the same."""
    texts = list(texts)
    low, high = texts[0], texts[-1]
    return low if low == high else f"{low} to {high}"
