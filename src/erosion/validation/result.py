"""Published and computed numbers side by side."""

import dataclasses
from typing import Any

from erosion.tables import Result, to_plain
from erosion.validation.facts import KINDS, Fact

HEADINGS = ("quantity", "published", "here", "unit", "off", "source")

OF_TESTS = ("measured", "correlation")
"""The kinds of facts that say something of nature."""

_NEAR = 0.1  # off by less is near
_FAR = 2.0  # times as much or as little; what is farther off is told as a factor
_DIGITS = 4


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A published number, and the package's.

    Args:
        fact: what is published.
        computed: what a model or a correlation gives [unit of the fact].
    """

    fact: Fact
    computed: float

    @property
    def ratio(self) -> float:
        """Computed over published [-]."""
        return self.computed / self.fact.published

    @property
    def within(self) -> bool | None:
        """Whether the two agree within the error that the source states; None where it states none."""
        error = self.fact.error
        return None if error is None else abs(self.computed - self.fact.published) <= error

    @property
    def off(self) -> str:
        """By how much the computed number is off, in words."""
        if self.ratio > _FAR or 0 < self.ratio < 1 / _FAR:
            return f"×{self.ratio:.3g}"
        percent = 100 * (self.ratio - 1)
        # Numbers are printed with six digits or so: less than a thousandth of a percent says nothing.
        return "0 %" if abs(percent) < 1e-3 else f"{percent:+.2g} %" if abs(percent) < 99.5 else f"{percent:+.0f} %"


@dataclasses.dataclass(frozen=True, repr=False)
class Validation(Result):
    """All published facts beside what the package gives.

    Args:
        comparisons: what was measured first.
    """

    comparisons: tuple[Comparison, ...]

    @property
    def title(self) -> str:
        """How many facts."""
        return f"{len(self.comparisons)} published numbers, and what this package gives"

    @property
    def headings(self) -> tuple[str, ...]:
        """The columns of the table."""
        return HEADINGS

    @property
    def sources(self) -> tuple[str, ...]:
        """Kind and source of the numbers, each once, in the order in which the table numbers them."""
        return tuple(dict.fromkeys(_source(comparison.fact) for comparison in self.comparisons))

    def rows(self) -> list[tuple[str, ...]]:
        """A line for each fact; "✗" marks what is off by more than the stated error."""
        return [
            (
                comparison.fact.name,
                _number(comparison.fact.published),
                _number(comparison.computed),
                _unit(comparison.fact.unit),
                comparison.off + (" ✗" if comparison.within is False else ""),
                f"[{self.sources.index(_source(comparison.fact)) + 1}]",
            )
            for comparison in self.comparisons
        ]

    @property
    def statements(self) -> tuple[str, ...]:
        """The sources, what agrees and what does not, and what this means."""
        stated = [comparison for comparison in self.comparisons if comparison.within is not None]
        agreeing = sum(bool(comparison.within) for comparison in stated)
        tested = [comparison for comparison in self.comparisons if comparison.fact.kind in OF_TESTS]
        near = sum(abs(comparison.ratio - 1) <= _NEAR for comparison in tested)
        far = sum(not 1 / _FAR <= comparison.ratio <= _FAR for comparison in tested)
        return (
            *(f"[{i}] {source}" for i, source in enumerate(self.sources, 1)),
            f"{agreeing} of {len(stated)} numbers agree within the error or tolerance that their source states; "
            f"{len(self.comparisons) - len(stated)} sources state none.",
            f"Of {len(tested)} numbers that were measured or come from fits to tests, {near} are off by {_NEAR:.0%} or "
            f"less, {far} by more than a factor of {_FAR:.0f}.",
            "Formulas, constants and test values show that something is computed as published, not that it is right. "
            "This table validates no model.",
        )

    def to_dict(self) -> dict[str, Any]:
        """Every fact, with published and computed numbers and their unit."""
        return to_plain({"facts": [_described(comparison) for comparison in self.comparisons]})

    def __repr__(self) -> str:
        return f"Validation({self.title!r})"


def _described(comparison: Comparison) -> dict[str, Any]:
    fact = comparison.fact
    return {
        "name": fact.name,
        "published": {"value": fact.published, "unit": fact.unit},
        "error": None if fact.error is None else {"value": fact.error, "unit": fact.unit},
        "computed": {"value": comparison.computed, "unit": fact.unit},
        "by": fact.by,
        "within": comparison.within,
        "kind": fact.kind,
        "meaning": KINDS[fact.kind],
        "source": fact.source,
        "note": fact.note,
    }


def _source(fact: Fact) -> str:
    return f"{fact.kind}: {fact.source}"


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _unit(unit: str) -> str:
    """As people write it: µm³."""
    if unit == "1":
        return ""
    return unit.replace("um", "µm").replace("us", "µs").replace("^3", "³")
