"""The dimension of a number: one that has a name, or a product of those."""

import re
import types
from collections.abc import Iterator, Mapping
from typing import Literal, get_args

from erosion.output.tables import briefly

Named = Literal[
    "1", "length", "area", "volume", "mass", "time", "speed", "stress", "angle", "angular speed",
    "rate", "volume per angle", "volume per angle²", "density", "volume per mass", "mass per mass",
    "mass flux", "mass flow", "energy",
]  # fmt: skip


class Product(str):
    """A dimension that is made of others, "mass/time"; see `read_dimension`."""


Dimension = Named | Product
DIMENSIONS: tuple[Named, ...] = get_args(Named)


def read_dimension(text: str) -> Dimension:
    """A dimension by name, or as a product of names and powers: "mass/time", "M/T", "[length]^2 / [time]".

    Raises:
        ValueError: with a clause that starts with "must".
    """
    plain = text.translate(_PLAIN_POWERS).replace("**", "^")
    plain = re.sub(r"\s*([*/^])\s*", r"\1", plain.strip())
    plain = re.sub(r"\b[MLT]\b", lambda letter: _LETTERS[letter[0]], plain)
    if plain in _BY_NAME:
        return _BY_NAME[plain]
    if not all(_FACTOR.fullmatch(factor) for factor in re.split("[*/]", plain)):
        raise ValueError(
            f"must be one of {', '.join(DIMENSIONS)}, or made of them, such as 'mass/time', but is {briefly(text)}"
        )
    return Product(plain)


_PLAIN_POWERS = str.maketrans({"²": "^2", "³": "^3", "·": "*", "[": None, "]": None})
_BY_NAME: Mapping[str, Named] = {name: name for name in DIMENSIONS}
_LETTERS = types.MappingProxyType({"M": "mass", "L": "length", "T": "time"})
_FACTOR = re.compile(
    rf"(?P<name>{'|'.join(sorted(map(re.escape, DIMENSIONS), key=len, reverse=True))})(?:\^(?P<power>[23]))?"
)


def factors(dimension: Product) -> Iterator[tuple[str, Named, int]]:
    """The parts of a product: "", "*" or "/", a dimension by name, and its power."""
    for factor in re.finditer(rf"(?P<sign>^|[*/]){_FACTOR.pattern}", dimension):
        yield factor["sign"], _BY_NAME[factor["name"]], int(factor["power"] or 1)
