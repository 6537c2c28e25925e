"""What an abrasive does to the amounts, and whether another would remove more."""

from erosion.correlations.abrasives import HARD_ENOUGH, SHAPES, oka_normal
from erosion.correlations.families import DIAMETER_EXPONENT
from erosion.correlations.ranges import SHARPNESS
from erosion.output.language import Language
from erosion.parameters.materials import VICKERS, Particle, Target

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
    text = say(
        "{other} instead of {particle}: about {ratio} times as much for a kilogramme, {size} by the size (diameter "
        "to the power 0.19, Oka 2005) and {shape} by the shape (E/CRC); both are more than 1.2 times as hard as the "
        "metal, so that hardness changes little (Feng and Ball 1999).",
        **numbers,
        ratio=f"{size * shape:.3g}",
        size=f"{size:.3g}",
        shape=f"{shape:.2g}",
    )
    oka = oka_ratio(particle, other, target, v0)
    if oka is None:
        return text
    return f"{text} {say('In tests of Oka at 90° it is {ratio} times.', ratio=f'{oka:.2g}')}"
