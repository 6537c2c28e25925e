"""All outputs of a declaration: tables for people, records for programs, CSV, labelled Datasets, `repr`.

Declared numbers are in SI. Tables, records and CSV show them in a unit system; Datasets and `repr` have them in SI.
"""

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from erosion.output.tables import (
    WIDTH,
    Record,
    abbreviate,
    format_number,
    is_traced,
    largest_of,
    to_csv,
    to_html,
    to_lines,
    to_plain,
    with_error,
)
from erosion.results.declaration import PLAIN, Columns, Declared, Scale, System, Value, ValueGroup

if TYPE_CHECKING:
    import xarray as xr
    from rich.text import Text

_HEADINGS = ("quantity", "", "value", "unit", "meaning")
_VALUE = _HEADINGS.index("value")
_SIGNS = "*†‡§"
_UNKNOWN = "–"
_SHARED = (1e-3, 1e6)  # numbers within these need no power of ten: a unit that values share


class PrintedTable(NamedTuple):
    """A table for people, all cells as text.

    Args:
        title: above it.
        rows: cells.
        headings: of the columns.
        numbers: the columns that are flush right.
        notes: what the signs beside numbers say, below the table.
    """

    title: str
    rows: Sequence[Sequence[str]]
    headings: Sequence[str]
    numbers: Sequence[int]
    notes: Sequence[str] = ()

    def __str__(self) -> str:
        return "\n".join(["\n".join(line.plain.rstrip() for line in self.lines()).rstrip(), *self.notes])

    def lines(self, width: int = WIDTH) -> "list[Text]":
        """The same, but for the notes, as lines of rich text for a terminal of that width in characters."""
        return to_lines(self.title, self.rows, self.headings, self.numbers, width)

    def to_html(self) -> str:
        """The same as an HTML table."""
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes)
        return to_html(self.title, self.rows, self.headings) + notes


def tables(title: str, declared: Iterable[Declared], system: System) -> list[PrintedTable]:
    """The values as rows of one table, then each group of columns as a table of its own, then those of parts."""
    values, groups, parts = _apart(_in(system, declared), "table")
    made = []
    if values:
        notes = _Notes()
        rows = [row for value, scale in zip(values, _scales(values), strict=True) for row in _rows(value, scale, notes)]
        used = [at for at, cells in enumerate(zip(*rows, strict=True)) if any(cells)]
        cells = [tuple(row[at] for at in used) for row in rows]
        made.append(PrintedTable(title, cells, [_HEADINGS[at] for at in used], [used.index(_VALUE)], notes.sentences))
    for group in groups:
        if group.values and len(group.values[0].value):
            made.append(_table(group, group.title if made else title))
    for part in parts:
        made += tables(part.title, part.values, system)
    return made


def record(declared: Iterable[Declared], system: System, *, has_units: bool = False) -> Record:
    """Numbers by name in Python's own types; with `has_units` those that have one are objects of value and unit."""
    values, groups, parts = _apart(_in(system, declared), "data")
    made: Record = {}
    for value in values:
        for name, number in _numbers(value):
            labelled = dict(zip(map(str, value.labels), number, strict=True)) if value.labels else number
            made[name] = _beside_unit(to_plain(labelled), value, has_units=has_units)
    for group in groups:
        length = len(group.values[0].value) if group.values else 0
        columns = [(name, numbers, value) for value in group.values if value.only != "table"
                   for name, numbers in _numbers(value)]  # fmt: skip
        records = [
            {name: _beside_unit(to_plain(numbers[i]), value, has_units=has_units) for name, numbers, value in columns}
            for i in range(length)
        ]
        made[group.name] = {each.pop(columns[0][0]): each for each in records} if group.keyed else records
    for part in parts:
        of_part = record(part.values, system, has_units=has_units)
        made |= {part.name: of_part} if part.name else of_part
    return made


def units(declared: Iterable[Declared], system: System) -> dict[str, str]:
    """Unit by name of the numbers of `record`, those of columns and of parts too."""
    values, groups, parts = _apart(_in(system, declared), "data")
    listed = [*values, *(value for group in groups for value in group.values)]
    made = {name: value.unit for value in listed if value.unit for name, _ in _numbers(value)}
    for part in parts:
        made = units(part.values, system) | made
    return made


def csv(declared: Iterable[Declared], system: System, lines: Sequence[str] = ()) -> str:
    """Comma-separated values with units in the headings.

    Args:
        declared: the numbers.
        system: the unit system that shows them.
        lines: the dimensions whose elements have a line each, in which single numbers stand too; those of impacts
            without it. Columns of that name stand alone.
    """
    columns: dict[str, np.ndarray] = {}
    values, groups, _ = _apart(_flat(_in(system, declared), "data"), "data")
    for group in groups:
        if [group.name] == [*lines]:
            values = [value.but(value=_column(value.value), dims=lines) for value in group.values
                      if value.only != "table"]  # fmt: skip
    for value in values:
        for name, number in _numbers(value):
            array, dims = _array(number), value.dims or ()
            is_of_line = not array.ndim or (tuple(dims) == tuple(lines) and not isinstance(number, tuple))
            if is_of_line and not value.labels and _is_storable(array):
                columns[f"{name} [{value.unit}]" if value.unit not in ("", "1") else name] = array
    shape = np.broadcast_shapes(*(array.shape for array in columns.values()))
    return to_csv({name: np.broadcast_to(array, shape).ravel().tolist() for name, array in columns.items()})


def dataset(title: str, declared: Iterable[Declared], attributes: Mapping[str, str]) -> "xr.Dataset":
    """The values in SI as a labelled Dataset, which xarray writes to netCDF."""
    import xarray as xr  # 1.7 s that a table for a terminal does without

    values, groups, _ = _apart(_flat(_in("si", declared), "data", "file"), "data", "file")
    variables: dict[str, Any] = {}
    arrays = [value.value for value in values if not (value.dims or value.labels or isinstance(value.value, tuple))]
    impacts = np.broadcast_shapes(*map(np.shape, arrays))
    for value in values:
        dims = value.dims or ([f"{value.name}_of"] if value.labels else None)
        for name, number in _numbers(value):
            array = _array(number)
            if _is_storable(array):
                stem = "dim" if array.shape == impacts else value.name
                variables[name] = (dims or [f"{stem}_{i}" for i in range(array.ndim)], array, _attributes(value))
        if value.labels and dims:
            variables[dims[0]] = (dims, _array(value.labels))
    for group in groups:
        for value in group.values:
            if value.only == "table":
                continue
            for name, number in _numbers(value):
                variables[f"{group.name}_{name}"] = (group.name, _array(_column(number)), _attributes(value))
    return xr.Dataset(variables, attrs={"title": title, **attributes})


def summary(declared: Iterable[Declared]) -> str:
    """The values in SI as arguments of a constructor: "volume=1.66e-09, ended_by='rebound'"; all digits."""
    values = [value for value in _apart(declared, "table")[0] if value.only != "table" and value.value is not None]
    return ", ".join(f"{value.name}={_short(value.value)}" for value in values if not value.labels)


def _in(system: System, declared: Iterable[Declared]) -> Iterator[Declared]:
    """The declaration with the units of a system."""
    for item in declared:
        if isinstance(item, Columns):
            yield replace(item, values=[_with_units(value, system) for value in item.values])
        elif isinstance(item, ValueGroup):
            yield replace(item, values=[*_in(system, item.values)])
        else:
            yield _with_units(item, system)


def _with_units(value: Value, system: System) -> Value:
    """The value with the unit, its size and the scale of a system; its numbers stay in SI."""
    measure = value.measure
    if measure is None:
        return value if value.scale is not None else value.but(scale=PLAIN)
    scale = value.scale or (lambda largest: measure.scale(system, largest))
    return value.but(measure=None, unit=measure.unit(system), size=measure.size(system), scale=scale)


def _apart(declared: Iterable[Declared], *outputs: str) -> tuple[list[Value], list[Columns], list[ValueGroup]]:
    """The values, the groups of columns and the parts that outputs have."""
    listed = [item for item in declared if item.only in ("", *outputs)]
    values = [item for item in listed if isinstance(item, Value)]
    if "table" in outputs:
        values = [value for value in values if value.value is not None]
    columns = [item for item in listed if isinstance(item, Columns)]
    return values, columns, [item for item in listed if isinstance(item, ValueGroup)]


def _flat(declared: Iterable[Declared], *outputs: str, before: str = "") -> Iterator[Value | Columns]:
    """Values and columns, those of parts with the part's name before their own names and dimensions."""
    for item in declared:
        if isinstance(item, ValueGroup):
            if item.only in ("", *outputs):
                name = f"{before}{item.name}_" if item.name else before
                yield from _flat(item.values, *outputs, before=name)
        elif isinstance(item, Columns):
            yield replace(item, name=before + item.name)
        else:
            dims = None if item.dims is None else [before + dim for dim in item.dims]
            yield item.but(name=before + item.name, dims=dims)


def _numbers(value: Value) -> Iterator[tuple[str, Any]]:
    """The value and its error by name, in the value's unit."""
    yield value.name, in_unit(value.value, value.size)
    if value.error is not None:
        yield f"{value.name}_error", in_unit(value.error, value.size)


def in_unit(number: Any, size: float) -> Any:
    """Numbers in SI, and those of lists and intervals, in a unit of this size: 4400.0, not 4400.000000000001."""
    if size == 1 or number is None:
        return number
    if isinstance(number, (list, tuple)):
        return type(number)(in_unit(each, size) for each in number)
    if np.ndim(number) or is_traced(number):
        return number / size
    number = float(number)
    near = float(f"{number / size:.15g}")
    return near if near * size == number else number / size


def _beside_unit(number: Any, value: Value, *, has_units: bool) -> Any:
    return {"value": number, "unit": value.unit} if has_units and value.unit else number


def _attributes(value: Value) -> dict[str, str]:
    given = {"long_name": value.meaning, "symbol": value.symbol, "units": value.unit}
    return {name: text for name, text in given.items() if text}


def _column(values: Sequence[Any]) -> np.ndarray:
    """A column as an array; where a value is not known an empty word, or NaN among numbers."""
    unknown = "" if any(isinstance(value, str) for value in values) else np.nan
    return np.array([unknown if value is None else value for value in values])


def _array(value: Any) -> np.ndarray:
    array = np.asarray(value)
    # A list without elements is one of words: numbers are arrays.
    is_of_words = array.dtype.kind in "US" or (isinstance(value, list) and not value)
    return array.astype(object) if is_of_words else array


def _is_storable(array: np.ndarray) -> bool:
    """Whether files have a place for it: numbers, flags and words, but no lists in arrays."""
    return array.dtype != object or all(isinstance(each, str) for each in array.flat)


def _short(value: Any) -> str:
    if isinstance(value, (bool, np.bool_)):
        return str(bool(value))
    return repr(to_plain(value)) if isinstance(value, tuple) else abbreviate(value)


def _scales(values: Sequence[Value]) -> list[Scale]:
    """The unit of each value in a table: one for all of a unit, unless a number would need a power of ten in it."""
    largest: dict[str, float] = {}
    for value in values:
        if callable(value.scale):
            largest[value.unit] = max(largest.get(value.unit, 0.0), _size(value))

    def scale_of(value: Value) -> Scale:
        if not callable(value.scale):
            return value.scale or PLAIN
        own, shared = _size(value), value.scale(largest[value.unit])
        return shared if own == 0 or _SHARED[0] <= own / shared.size < _SHARED[1] else value.scale(own)

    return [scale_of(value) for value in values]


def _size(value: Value) -> float:
    numbers = (
        [each for each in value.value if each is not None] if isinstance(value.value, (list, tuple)) else value.value
    )
    return largest_of(numbers)


def _rows(value: Value, scale: Scale, notes: "_Notes") -> Iterator[tuple[str, ...]]:
    """A value as a row of a table, or one for each label."""
    if not value.labels:
        cell = _cell(value.value, value.error, value, scale) + notes.signs(value)
        yield value.name, value.symbol, cell, scale.unit, value.meaning
    for i, label in enumerate(value.labels):
        cell = _cell(value.value[i], None if value.error is None else value.error[i], value, scale)
        yield f"{value.name} {label}", value.symbol, cell + notes.signs(value, i), scale.unit, value.meaning


def _table(group: Columns, title: str) -> PrintedTable:
    """Columns as a table."""
    shown = [value for value in group.values if value.only != "data"]
    notes, columns, headings, numbers = _Notes(), [], [], []
    for at, (value, scale) in enumerate(zip(shown, _scales(shown), strict=True)):
        headings.append(f"{value.symbol or value.name.replace('_', ' ')}{f' [{scale.unit}]' if scale.unit else ''}")
        errors = [None] * len(value.value) if value.error is None else value.error
        columns.append([_cell(number, error, value, scale) + notes.signs(value, i)
                        for i, (number, error) in enumerate(zip(value.value, errors, strict=True))])  # fmt: skip
        if not all(isinstance(number, (str, bool, np.bool_)) for number in value.value):
            numbers.append(at)
    return PrintedTable(title, list(zip(*columns, strict=True)), headings, numbers, notes.sentences)


def _cell(number: Any, error: Any, value: Value, scale: Scale) -> str:
    """A number as text, in the unit of the table."""
    if number is None:
        return _UNKNOWN
    if is_traced(number):
        return format_number(number)
    if isinstance(number, tuple):
        return " … ".join(dict.fromkeys(_cell(end, None, value, scale) for end in number))
    array = np.asarray(number)
    if array.dtype.kind == "b":
        return f"{np.sum(array):,} of {array.size:,}" if array.ndim else "yes" if array else "no"
    if array.dtype.kind in "iu" and not array.ndim:
        return f"{array:,}"
    if error is not None and not array.ndim:
        return with_error(float(array), float(error), scale.size)
    return format_number(array, value.digits, scale.size)


class _Notes:
    """The sentences below a table, each with the sign that stands beside the numbers that it qualifies."""

    def __init__(self) -> None:
        self._signs: dict[str, str] = {}

    def signs(self, value: Value, at: int | None = None) -> str:
        """The signs of a value, or of one of its elements."""
        marks = [mark for mark in value.marks if np.any(mark.where if at is None else mark.where[at])]
        signs = [self._signs.setdefault(mark.note, _SIGNS[len(self._signs) % len(_SIGNS)]) for mark in marks]
        return f" {''.join(signs)}" if signs else ""

    @property
    def sentences(self) -> list[str]:
        return [f"{sign} {note}." for note, sign in self._signs.items()]
