"""The published facts, from the file that comes with the package."""

import functools
import importlib.resources
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

KINDS: Mapping[str, str] = {
    "measured": "measured",
    "correlation": "a published fit to tests, evaluated",
    "formula": "a published formula, evaluated",
    "constant": "documented by a program",
    "test value": "of a program's tests",
}
"""What a fact may be, from what says most of nature to what says least."""


@dataclass(frozen=True)
class Fact:
    """A published number, and what of the package is to give it.

    Args:
        name: of the quantity, in a few words.
        published: the number [`unit`].
        unit: as programs read it; "1" for a pure number.
        kind: a key of `KINDS`.
        source: who, where, and the page or file.
        computes: a key of `COMPUTATIONS`.
        by: the model or the correlation that gives the number here.
        error: of the number, as the source states it [`unit`]; None where it states none.
        note: what else has to be known.
        given: the arguments of the computation.
    """

    name: str
    published: float
    unit: str
    kind: str
    source: str
    computes: str
    by: str
    error: float | None = None
    note: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)


@functools.cache
def published_facts() -> tuple[Fact, ...]:
    """All facts, in the order of the file `erosion/validation/facts.toml`."""
    text = importlib.resources.files("erosion.validation").joinpath("facts.toml").read_text("utf-8")
    return tuple(Fact(**entry) for entry in tomllib.loads(text)["fact"])
