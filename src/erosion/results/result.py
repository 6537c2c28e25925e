"""The results of the package: declared once, shown to people and given to programs."""

import abc
import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

from erosion.output.tables import Record
from erosion.results import render
from erosion.results.declaration import Declared, System
from erosion.results.findings import Finding, to_attribute

if TYPE_CHECKING:
    import xarray as xr


class Result(abc.ABC):
    """A result declares its numbers; tables, HTML, JSON, CSV, a Dataset and `repr` follow from that.

    Attributes, Datasets and `repr` are in SI, angles in radians.

    Attributes:
        lines: the dimensions whose elements are the lines of CSV, or the name of columns; those of impacts without it.
    """

    lines: Sequence[str] = ()

    @property
    @abc.abstractmethod
    def title(self) -> str:
        """One line above the table."""

    @abc.abstractmethod
    def declare(self) -> Sequence[Declared]:
        """The numbers, each with all that an output needs."""

    @property
    def shown_in(self) -> System:
        """The unit system that shows the numbers in tables, JSON and CSV."""
        return "si"

    @property
    def subject(self) -> Record:
        """By name, what the numbers are of: the model, its own parameters, the case."""
        return {}

    @property
    def conclusions(self) -> Sequence[str]:
        """Conclusions from the numbers, in sentences below the table."""
        return ()

    @property
    def findings(self) -> Sequence[Finding]:
        """Findings that qualify the numbers, such as doubts, omissions, values out of range."""
        return ()

    @property
    def warnings(self) -> Sequence[str]:
        """The findings as sentences."""
        return tuple(finding.text for finding in self.findings)

    def rows(self) -> Sequence[Sequence[str]]:
        """The first table, all cells as text."""
        return self.tables()[0].rows

    def tables(self) -> list[render.PrintedTable]:
        """The tables for people."""
        return render.tables(self.title, self.declare(), self.shown_in)

    def to_dict(self) -> Record:
        """The numbers by name, in Python's own types, their units and findings; NaN and infinity stay what they are."""
        declared = self.declare()
        findings = [finding.to_dict() for finding in self.findings]
        numbers, units = render.record(declared, self.shown_in), render.units(declared, self.shown_in)
        return {**self.subject, **numbers, "units": units, "findings": findings}

    def to_csv(self) -> str:
        """The numbers as comma-separated values; a line for each impact, row of data or model, as `lines` says."""
        return render.csv(self.declare(), self.shown_in, self.lines)

    def to_dataset(self) -> "xr.Dataset":
        """The numbers in SI with their units as a Dataset, for netCDF."""
        attributes = {"findings": to_attribute(self.findings)}
        return render.dataset(self.title, self.declare(), attributes)

    def __repr__(self) -> str:
        numbers = render.summary(self.declare())
        return f"{type(self).__name__}({self.title!r}{f', {numbers}' if numbers else ''})"

    def __str__(self) -> str:
        return "\n".join(["\n\n".join(map(str, self.tables())), *self.conclusions, *self.warnings])

    def _repr_html_(self) -> str:
        sentences = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in (*self.conclusions, *self.warnings))
        return "".join(table.to_html() for table in self.tables()) + sentences
