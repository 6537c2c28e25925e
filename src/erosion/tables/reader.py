"""The reader of tables: columns by the names of quantities, each with its unit, or a refusal.

A column is used if its name leaves no doubt, and it must have a unit, in its heading, in a row below, in the file's
metadata or by Argument `columns`. A column that may be a quantity, by its name or by its unit, is refused until
`columns` names it or `ignore` leaves it out. All others are left out, and the table lists them.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from erosion.output import list_item, split_list
from erosion.parameters.quantities import Dimension, UnitError
from erosion.tables.frames import open_source
from erosion.tables.headings import (
    IgnoreError,
    Wanted,
    columns_of,
    doubtful,
    heading_parts,
    ignored_columns,
    is_unit,
    matching,
)
from erosion.tables.meanings import explained
from erosion.tables.source import Source, TableError


class Column(NamedTuple):
    """A column that is used: number in the file × factor = number in the unit system.

    Args:
        heading: as the file has it.
        dimension: of the quantity.
        factor: of the unit.
        unit: as it is written.
        is_declared: whether the user gave the unit or the name.
    """

    heading: str
    dimension: Dimension
    factor: float
    unit: str = ""
    is_declared: bool = False


@dataclasses.dataclass(frozen=True)
class Table:
    """A table that is understood.

    Args:
        source: the file or object.
        columns: those that are used, by the names of quantities.
        unused: the headings of those that are not used and not ignored.
    """

    source: Source
    columns: Mapping[str, Column]
    unused: tuple[str, ...]

    @property
    def title(self) -> str:
        """File or argument."""
        return self.source.title

    def blocks(self) -> Iterator[dict[str, np.ndarray]]:
        """The numbers by quantity, some thousand rows at a time, NaN where a cell has none; each shape (rows,).

        Raises:
            TableError: naming the first row that cannot be read.
        """
        headings = list(dict.fromkeys(column.heading for column in self.columns.values()))
        for block in self.source.blocks(headings):
            yield {name: block[column.heading] * column.factor for name, column in self.columns.items()}

    @functools.cached_property
    def numbers(self) -> dict[str, np.ndarray]:
        """The numbers of all rows."""
        blocks = [*self.blocks()]
        return {name: np.concatenate([np.zeros(0), *(block[name] for block in blocks)]) for name in self.columns}

    def place(self, row: int, name: str = "") -> str:
        """A row, counted from 0, as its reader finds it, and in it the column of a quantity."""
        column = f": column `{self.columns[name].heading.strip()}`" if name else ""
        return f"{self.title}, {self.source.place(row)}{column}"

    def lines(self, rows: np.ndarray) -> np.ndarray | None:
        """The lines of some rows in the file; None for an object.

        Args:
            rows: counted from 0, shape (n,).
        """
        return self.source.lines(rows)


def open_table(
    source: Any,
    wanted: Mapping[str, Wanted] | Callable[[Sequence[str]], Mapping[str, Wanted]],
    *,
    columns: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    sep: str | None = None,
    decimal: str | None = None,
    refused: Mapping[str, Wanted] | None = None,
    remedy: str = "name it in Argument `ignore` ({0}), or say by Argument `columns` what it is ({1})",
) -> Table:
    """A table whose columns are understood; its rows are read on use.

    Args:
        source: a path, an object of pandas or xarray, a mapping of columns by heading, or a `Source`.
        wanted: the quantities, by name; or a function that makes them of the headings.
        columns: units of columns that carry none, and meanings of those that are not understood; see `read_meanings`.
        ignore: columns that are left out, by their headings or the names in them; a text is a list, see `split_list`.
        sep: what separates the cells of a text: ",", ";", "tab" or " "; the header shows it otherwise.
        decimal: the mark of decimals of a text; the numbers show it otherwise.
        refused: quantities that no column may have.
        remedy: what helps with a column that is refused, a template for its heading and for its entry in `columns`.

    Raises:
        TableError: one sentence that names the table, the column, and the argument that helps.
    """
    opened = open_source(source, sep, decimal)
    ignore = split_list(ignore) if isinstance(ignore, str) else ignore
    texts = explained(opened.title, opened.headings, columns or {})
    wanted = wanted if isinstance(wanted, Mapping) else wanted(texts)
    beside = {text: opened.units.get(head, "") for head, text in zip(opened.headings, texts, strict=True)}
    try:
        ignored = ignored_columns(opened.headings, ignore)
    except IgnoreError as error:
        raise TableError(f"{opened.title}: {error}.") from error
    found = matching(texts, wanted, ignored=ignored, units=beside)
    doubt = doubtful(texts, found, wanted, refused or {}, ignored=ignored, units=beside)
    used, lacking = dict[str, Column](), dict[str, list[str]]()
    for head, text, heading in zip(opened.headings, texts, found, strict=True):
        if heading is None:
            continue
        place = f"{opened.title}: column {head.strip()!r}"
        if heading.name in used:
            other = used[heading.name].heading.strip()
            raise TableError(
                f"{place} gives `{heading.name}`, but so does {other!r}; rename it, or "
                f"{remedy.format(*_typed(opened.headings, head, text))}."
            )
        try:
            measured = wanted[heading.name].measure(heading.unit, is_alias=heading.alias)
            other = opened.units.get(head, heading.unit)
            beside_it = wanted[heading.name].measure(other, is_alias=heading.alias)
        except UnitError as error:
            raise TableError(f"{place}: the unit {error}.") from error
        if measured is None:
            lacking.setdefault(wanted[heading.name].example, []).append(head.strip())
            continue
        if beside_it not in (None, measured):
            raise TableError(f"{place} has another unit beside its heading, {other!r}.")
        used[heading.name] = Column(head, *measured, heading.unit, text != head)
    if doubt is not None:
        head, text = opened.headings[doubt[0]], texts[doubt[0]]
        helps = remedy.format(*_typed(opened.headings, head, text))
        raise TableError(f"{opened.title}: column {head.strip()!r} {doubt[1]}; rename it, or {helps}.")
    if lacking:
        unit, (first, *_) = next(iter(lacking.items()))
        named = ", ".join(repr(head) for heads in lacking.values() for head in heads)
        meant = ", ".join(f"{','.join(map(list_item, heads))}={unit}" for unit, heads in lacking.items())
        raise TableError(
            f"{opened.title}: {named} must have a unit, as `{heading_parts(first)[0]} [{unit}]`, or from Argument "
            f"`columns`, such as {_quoted(meant)}."
        )
    opened.check([column.heading for column in used.values()])
    unused = (head.strip() for i, head in enumerate(opened.headings) if found[i] is None and i not in ignored)
    return Table(opened, used, tuple(unused))


def _typed(headings: Sequence[str], head: str, text: str) -> tuple[str, str]:
    """What is typed for a column in Argument `ignore`, and in `columns` but for the name of the quantity.

    Args:
        headings: of all columns.
        head: of the column.
        text: the same, as the user has explained it.
    """
    name, unit = heading_parts(head)[0], heading_parts(text)[1]
    named = name if len(columns_of(headings, name)) == 1 else head.strip()
    return _quoted(list_item(head.strip())), _quoted(f"{list_item(named)}=NAME [{unit if is_unit(unit) else 'UNIT'}]")


def _quoted(text: str) -> str:
    return repr(text) if '"' in text else f'"{text}"'
