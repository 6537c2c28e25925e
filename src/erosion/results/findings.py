"""Findings: what a reader of numbers must know, as data; the texts stand in `findings.toml`, by code."""

import dataclasses
import functools
import importlib.resources
import json
import math
import string
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from erosion.output.tables import Record, to_plain

LEVELS = ("note", "warning")
"""A note says how something was read or done, a warning which numbers may be wrong or missing."""

STATED = "stated"
"""The code of a sentence that comes from outside of the package: its text is the number `text`."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One statement about numbers: a code with numbers; `text` is the sentence.

    Args:
        code: a table of `findings.toml`.
        about: the model, file, column or patch that it concerns.
        numbers: by name, what the text needs: numbers, words, and lists of them; angles in rad, shares of 1.

    Raises:
        ValueError: for a code that is unknown.
    """

    code: str
    about: str = ""
    numbers: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.code not in catalogue():
            raise ValueError(f"Argument `code` must be a table of findings.toml, but is {self.code!r}.")
        object.__setattr__(self, "numbers", to_plain(self.numbers))

    @property
    def level(self) -> str:
        """One of `LEVELS`."""
        return catalogue()[self.code]["level"]

    @property
    def text(self) -> str:
        """The sentence in English."""
        template = catalogue()[self.code]["text"]
        before = "" if "{about}" in template or not self.about else f"{self.about}: "
        return before + _WORDS.format(template, about=self.about, **self.numbers)

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> Record:
        """Code, level, about, numbers and text."""
        return {name: getattr(self, name) for name in ("code", "level", "about", "numbers", "text")}


def stated(text: str, about: str = "") -> Finding:
    """The finding of a sentence from outside of the package, or of a part that has no codes."""
    return Finding(STATED, about, {"text": text})


def found(*table: tuple[object, Finding]) -> tuple[Finding, ...]:
    """The findings of a table of conditions, each with its finding, whose condition is true."""
    return tuple(finding for condition, finding in table if condition)


def unique(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings, each once, in their order."""
    kept: list[Finding] = []
    for finding in findings:
        if finding not in kept:
            kept.append(finding)
    return tuple(kept)


def to_attribute(findings: Iterable[Finding]) -> str:
    """Findings as an attribute of a file, JSON; empty without any."""
    parts = [finding.to_dict() for finding in findings]
    return json.dumps(parts, ensure_ascii=False) if parts else ""


def from_attribute(text: str) -> tuple[Finding, ...]:
    """The findings of an attribute that `to_attribute` made."""
    return tuple(Finding(one["code"], one["about"], one["numbers"]) for one in json.loads(text or "[]"))


@functools.cache
def catalogue() -> Mapping[str, Mapping[str, str]]:
    """Level and text of each code."""
    return tomllib.loads((importlib.resources.files("erosion.results") / "findings.toml").read_text(encoding="utf-8"))


class _Words(string.Formatter):
    """Format strings with lists, degrees (`.1f°`), per cent (`.3g%`), digits alone (`.2~`), quotes (`q`)."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, str):
            return repr(value) if format_spec == "q" else super().format_field(value, format_spec)
        if isinstance(value, Sequence):
            parts = [self.format_field(part, format_spec) for part in value]
            return ("; " if any("," in part for part in parts) else ", ").join(parts)
        if format_spec.endswith("°"):
            return f"{math.degrees(value):{format_spec[:-1]}}°"
        if format_spec.endswith(("g%", "f%")):
            return f"{100 * value:{format_spec[:-1]}} %"
        if format_spec.endswith("~"):  # without the powers of ten of "g"
            return f"{float(format(value, format_spec[:-1] + 'g')):g}"
        return super().format_field(value, format_spec)


_WORDS = _Words()
