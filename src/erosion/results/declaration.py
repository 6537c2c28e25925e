"""A declaration says what a number of a result is; `render.py` makes tables, JSON, CSV, Datasets and `repr` of it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, NamedTuple, Protocol

Output = Literal["", "table", "data", "file"]
"""Where a value stands: in all outputs, in tables for people alone, in all but these tables, or in Datasets alone."""


System = Literal["inch-pound", "si"]
"""The unit system that shows numbers."""


class Scale(NamedTuple):
    """A unit that makes numbers readable: the number in SI, divided by `size`, is the number in `unit`."""

    size: float
    unit: str

    def beside(self, number: str) -> str:
        """A number in this unit, with it: "30 m/s", "40°", "(3.1 ± 2.5)·10⁻⁷ in³"."""
        if self.unit.startswith("10"):
            return f"({number})·{self.unit}" if "±" in number else f"{number}·{self.unit}"
        return f"{number} {self.unit}".rstrip().replace(" °", "°")


PLAIN = Scale(1.0, "")


class Measure(Protocol):
    """The units that show the numbers of a quantity."""

    def unit(self, system: System) -> str:
        """The unit of a system as programs read it, "in^3"."""

    def size(self, system: System) -> float:
        """The size of that unit in SI."""

    def scale(self, system: System, largest: float) -> Scale:
        """The unit in which people read numbers up to `largest` [SI] in a table."""


class Mark(NamedTuple):
    """A statement that qualifies a number: a sign beside it in a table, and the sentence below the table.

    Args:
        where: whether it holds, for the number or for each of an array.
        note: the sentence, without a full stop.
    """

    where: Any
    note: str


@dataclass(frozen=True, eq=False)
class Value:
    """One named number, array, word or flag of a result.

    Args:
        name: as JSON, CSV and files name it.
        value: a number [SI], a word, a flag, an array of these, a pair of numbers (an interval), or None where it is
            not known.
        symbol, meaning: as tables and axes name it.
        measure: gives `unit`, `size` and `scale` in the unit system that shows the result; without it they are as
            they stand, in each system.
        unit: as programs read it, "m^3"; "1" of a pure number; "" of counts, words, flags.
        size: of that unit in SI.
        scale: the unit in which people read it, or a function that gives the one for the greatest magnitude; values
            of one unit then share it within a table where they can. None: that of `measure`.
        digits: significant ones, in tables.
        error: the standard error, of the same shape; data name it `NAME_error`.
        dims: of an array; without them an array of impacts has `dim_0`, …, an interval or an array of another shape
            dimensions by its name.
        labels: along the only dimension: a row each in a table, keys in JSON, a coordinate in files.
        marks: what qualifies it.
        only: see `Output`.
    """

    name: str
    value: Any
    symbol: str = ""
    meaning: str = ""
    unit: str = ""
    scale: Scale | Callable[[float], Scale] | None = None
    digits: int = 6
    error: Any = None
    dims: Sequence[str] | None = None
    labels: Sequence[str] | Sequence[float] = ()
    marks: Sequence[Mark] = ()
    only: Output = ""
    measure: Measure | None = None
    size: float = 1.0

    def but(self, **changes: Any) -> "Value":
        """The same with some fields changed."""
        return replace(self, **changes)


Declare = Callable[[str, Any], Value]
"""Makes a `Value` of a name and a number or an array."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Values along one dimension, a table of their own: candidates, models, checks.

    Args:
        name: as JSON and files name the dimension.
        title: above the table.
        values: arrays or lists of one length.
        keyed: whether JSON has a record by each word of the first column, in place of a list of records.
        only: see `Output`.
    """

    name: str
    title: str
    values: Sequence[Value]
    keyed: bool = False
    only: Output = ""

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        items: Sequence[Any],
        known: Mapping[str, Declare],
        hidden: Collection[str] = (),
        **more: Any,
    ) -> "Columns":
        """The fields of dataclasses of one kind as columns.

        Args:
            name: see the class.
            title: see the class.
            items: the dataclasses.
            known: by field, what declares its column; the other fields are words, counts and flags.
            hidden: fields that tables leave out.
            **more: other fields of the class.
        """
        columns = []
        for field in fields(items[0]) if items else ():
            column = known.get(field.name, Value)(field.name, [getattr(item, field.name) for item in items])
            columns.append(column.but(only="data") if field.name in hidden else column)
        return cls(name, title, columns, **more)


@dataclass(frozen=True, eq=False)
class ValueGroup:
    """Numbers that belong together: those of each parameter, or of one of several results.

    Args:
        name: of their record in JSON, and before their names in files; without one they stand among the others.
        values: what is declared.
        title: above their own tables.
        only: see `Output`.
    """

    name: str
    values: "Sequence[Declared]"
    title: str = ""
    only: Output = ""


Declared = Value | Columns | ValueGroup
