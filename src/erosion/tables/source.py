"""The interface of a file or an object to the reader: headings, and columns of numbers in blocks of rows."""

import abc
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

Numbers = Mapping[str, np.ndarray]
"""Columns by heading, float64, NaN where a cell has no number; each shape (rows,)."""

BLOCK_BYTES = 1 << 22
"""What is read at once."""


class TableError(ValueError):
    """A table that cannot be used; says which file, which row, and what to do."""


class Source(abc.ABC):
    """A table whose columns are numbers or texts.

    Attributes:
        title: file or argument, for messages.
        headings: of the columns, as they are written.
        units: of columns by heading, where the file gives them beside the headings.
        rows: their number; None where only reading all of them tells it.
        notes: sentences on how the file is read.
    """

    title: str
    headings: Sequence[str]
    units: Mapping[str, str]
    rows: int | None = None
    notes: tuple[str, ...] = ()

    @abc.abstractmethod
    def blocks(self, headings: Sequence[str]) -> Iterator[Numbers]:
        """The numbers of some columns, some thousand rows at a time.

        Raises:
            TableError: naming the first row that cannot be read.
        """

    def check(self, headings: Sequence[str]) -> None:
        """Refuse columns of which the beginning shows that they cannot be read; by default there are none."""
        return

    def place(self, row: int) -> str:
        """A row, counted from 0, as its reader finds it."""
        return f"row {row + 1:,}"

    def lines(self, rows: np.ndarray) -> np.ndarray | None:
        """The lines of rows, counted from 0, that were read, shape (n,); None where the source has no lines."""
        return None
