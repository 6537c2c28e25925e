"""The job of a shop: how much abrasive, and how long."""

import dataclasses
from collections.abc import Sequence

from erosion.output.language import Language
from erosion.parameters.per_mass import two_digits


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
        numbers = {"volume": f"{self.volume * 1e6:.3g}", "abrasive": _between(ends, language)}
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
            minutes=_between(minutes, language),
            feed=f"{self.feed * 60:.3g}",
        )


def _between(ends: Sequence[float], language: Language) -> str:
    low, high = (two_digits(end) for end in ends)
    return low if low == high else language.say("{low} to {high}", low=low, high=high)
