"""What an abrasive does to the amounts, whether another would remove more, and how much of it a job takes."""

import dataclasses
from collections.abc import Iterable, Sequence

from erosion.correlations.families import DIAMETER_EXPONENT
from erosion.correlations.ranges import SHARPNESS
from erosion.correlations.registry import HARD_ENOUGH, SHAPES, oka_normal
from erosion.output import Language
from erosion.parameters import VICKERS, Particle, Target, two_digits

_OKA = "oka:"


def hardness_ratio(particle: Particle, target: Target) -> float | None:
    """Hardness of the abrasive over that of the metal; None where it is not known."""
    return None if particle.vickers is None else particle.vickers * VICKERS / target.hardness


def hardness_sentence(particle: Particle, target: Target, name: str, language: Language) -> str:
    """What the abrasive's hardness does to the amounts."""
    say, ratio = language.say, hardness_ratio(particle, target)
    if ratio is None:
        return say(
            "{particle}: its hardness is not known here and enters no number; below about 1.2 times that of the "
            "metal it would remove much less (Pintaude 2010).",
            particle=name,
        )
    numbers = {"particle": name, "ratio": f"{ratio:.2g}"}
    if ratio < HARD_ENOUGH:
        return say(
            "{particle}: only {ratio} times as hard as the metal. Below about 1.2 times an abrasive hardly scratches "
            "(Pintaude 2010): the amounts are too large.",
            **numbers,
        )
    return say(
        "{particle}: {ratio} times as hard as the metal. Above about 1.2 times (Pintaude 2010) tests find no effect "
        "of the abrasive's hardness (Feng and Ball 1999), and it enters no number here.",
        **numbers,
    )


def size_and_shape(particle: Particle, other: Particle) -> tuple[float, float] | None:
    """What the other removes over what the particle removes, per kilogramme, by size and by shape.

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


def comparison(
    particle: Particle, other: Particle, target: Target, v0: float, names: tuple[str, str], language: Language
) -> str:
    """Whether another abrasive removes more of a metal, and by what; `names` of both in the language."""
    say, factors = language.say, size_and_shape(particle, other)
    numbers = {"particle": names[0], "other": names[1]}
    ratios = [hardness_ratio(grit, target) for grit in (particle, other)]
    soft = [name for name, ratio in zip(names, ratios, strict=True) if ratio is not None and ratio < HARD_ENOUGH]
    if soft or factors is None or None in ratios:
        because = (
            say("{particle} is less than 1.2 times as hard as the metal", particle=soft[0])
            if soft
            else language.text("a shape or a hardness is not known")
        )
        return say("{other} instead of {particle}: no ratio can be told, for {because}.", **numbers, because=because)
    size, shape = factors
    ratio = f"{size * shape:.2g}"
    text = say(
        "{other} instead of {particle}: {amount} for a kilogramme, {size} times by the size (diameter to the power "
        "0.19, Oka 2005) and {shape} times by the shape (E/CRC). Both are more than 1.2 times as hard as the metal, so "
        "that hardness changes little (Feng and Ball 1999).",
        **numbers,
        amount=language.text("about as much") if ratio == "1" else say("about {ratio} times as much", ratio=ratio),
        size=f"{size:.2f}",
        shape=f"{shape:.2f}",
    )
    oka = oka_ratio(particle, other, target, v0)
    if oka is None:
        return text
    return f"{text} {say('In tests of Oka at 90° it is {ratio} times.', ratio=f'{oka:.2g}')}"


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
        """The least and the greatest mass of abrasive [kg], by the erosion at the angle [m³/kg]."""
        return self.volume / max(erosion), self.volume / min(erosion)

    def sentence(self, erosion: Sequence[float], density: float | None, language: Language) -> str:
        """Volume, abrasive and time; `density` of the target [kg/m³]."""
        say, ends = language.say, self.abrasive(erosion)
        numbers = {"volume": f"{self.volume * 1e6:.3g}", "abrasive": between(map(two_digits, ends), language)}
        numbers |= {"area": f"{self.area:.3g}", "depth": f"{self.depth * 1e6:.3g}"}
        metal = say("{area} m² by {depth} µm are {volume} cm³ of metal", **numbers)
        if density is not None:
            metal = say("{metal}, {mass} kg", metal=metal, mass=f"{self.volume * density:.3g}")
        if self.feed is None:
            return say("{metal}: that takes {abrasive} kg of abrasive.", metal=metal, abrasive=numbers["abrasive"])
        minutes = [mass / self.feed / 60 for mass in ends]
        return say(
            "{metal}: that takes {abrasive} kg of abrasive, {minutes} minutes at {feed} kg/min.",
            metal=metal,
            abrasive=numbers["abrasive"],
            minutes=between(map(two_digits, minutes), language),
            feed=f"{self.feed * 60:.3g}",
        )


def between(texts: Iterable[str], language: Language) -> str:
    """From the first to the last of some texts in order; one text where they are the same."""
    texts = list(texts)
    low, high = texts[0], texts[-1]
    return language.number(low) if low == high else language.say("{low} to {high}", low=low, high=high)
