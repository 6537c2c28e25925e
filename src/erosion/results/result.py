"""The results of the package: a table for people, numbers by name for programs."""

import abc
import html
from collections.abc import Sequence

from erosion.output.tables import HEADINGS, Record, to_html, to_lines, to_plain
from erosion.results.findings import Finding


class Result(abc.ABC):
    """A result that prints as a table, shows as one in a notebook, and is numbers by name for programs."""

    @property
    @abc.abstractmethod
    def title(self) -> str:
        """One line above the table."""

    @abc.abstractmethod
    def rows(self) -> Sequence[Sequence[str]]:
        """The table, all cells as text."""

    @property
    def headings(self) -> Sequence[str]:
        """The columns of the table."""
        return HEADINGS

    @property
    def conclusions(self) -> Sequence[str]:
        """What the numbers say, in sentences below the table."""
        return ()

    @property
    def findings(self) -> Sequence[Finding]:
        """What a reader of the numbers must know: what is doubtful, left out or out of range."""
        return ()

    @property
    def warnings(self) -> Sequence[str]:
        """The findings as sentences."""
        return tuple(finding.text for finding in self.findings)

    def to_dict(self) -> Record:
        """The numbers by name, in Python's own types; NaN and infinity stay what they are."""
        return to_plain(self)

    def __repr__(self) -> str:  # of a class that wants no other
        return f"{type(self).__name__}({self.title!r})"

    def __str__(self) -> str:
        table = "\n".join(line.plain.rstrip() for line in to_lines(self.title, self.rows(), self.headings)).rstrip()
        return "\n".join([table, *self.conclusions, *self.warnings])

    def _repr_html_(self) -> str:
        sentences = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in (*self.conclusions, *self.warnings))
        return to_html(self.title, self.rows(), self.headings) + sentences
