"""Measured erosion over angles: tables in memory and CSV files, with columns of many names and units.

    angle [deg], volume [in^3/impact], uncertainty [in^3]
    20,          1.8e-4,               2e-6

Cells are separated by commas, or by semicolons or tabs, and then a comma in a number is a
decimal comma. Lines that start with # are comments. Columns of other names are not used, unless they may be one of
those that are: such a table is refused. A row without one of its numbers ("n.a.", an empty cell) is left out, and
`Measurements.notes` names it.
"""

import contextlib
import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.fits.conditions import Condition, are_apart, describe, group_numbers
from erosion.fits.errors import ErrorModel, of_which, without_common
from erosion.fits.tables import KNOWN, REFUSED, REMOVALS, MeasurementError, are_shares, is_per_impact, removal_of
from erosion.output.tables import briefly, first_of, format_number, largest_of, list_item
from erosion.parameters.parameters import are_angles
from erosion.parameters.quantities import (
    RESULTS,
    Dimension,
    InSI,
    Quantity,
    Scale,
    System,
    about,
    ascii_unit,
    check_system,
    has_unit,
    known_scales,
    read_quantity,
    table_scale,
    unit_name,
)
from erosion.tables import Column, Table, TableError, open_table, read_meanings, written_meanings
from erosion.tables.headings import NO_UNIT, scale_of
from erosion.tables.text import TAB

_QUANTITY_OF: dict[Dimension, str] = {
    "volume": "volume", "volume per mass": "specific_volume", "mass": "mass_loss",
    "mass per mass": "erosion_ratio", "1": "relative_erosion",
}  # fmt: skip

_INCH_POUND = {
    "in", "inch", "inches", "mil", "mils", "thou", "ft", "foot", "feet", "mph", "mile", "miles", "lb", "lbs", "lbm",
    "pound", "pounds", "oz", "ounce", "ounces", "grain", "grains", "slug", "slugs", "slinch",
}  # fmt: skip
_MOST_SPEEDS = 50
_HEAVIEST = 0.02  # kg; a ball of steel of 17 mm, but less than the sand of a test


@dataclasses.dataclass(frozen=True)
class Measurements:
    """Erosion at several angles; every array has the shape (n,).

    Args:
        angle: α [rad].
        erosion: the removal per impact or per mass of particles [SI], as `dimension` says.
        dimension: "volume", "volume per mass", "mass", "mass per mass"; or "1" for units of
            its own, known up to a factor.
        uncertainty: one standard deviation of each `erosion`, or None where unknown; see `weighed`.
        speed: impact speed of each row [m/s]; None for the case's.
        mass: mass of each particle [kg]; None for the case's.
        shown_in: the unit system that shows them.
        source: the file's name, for titles.
        unused: the headings of the columns that are not used.
        error: what the uncertainties are made of; without it the two parts that come nearest to them.
        parts: absolute and relative part of each uncertainty, shape (n, 2); None where it is one number.
        lines: of the file, of each row; None for tables in memory.
        notes: sentences on how the table was read: rows that are left out, its characters.
        unit: of `erosion` in the table; empty where numbers do not read well in it.
        path: of the file, for commands that read it again; None for a table in memory.
        reading: how the table was read, as it was given: by argument of `read_measurements`, for commands that read it
            again.
        speeds: which speed each row has, of those whose rows share an error, shape (n,); None without such an error.
        common: this error over the row's own at the erosion that is expected, see `weighed`; None without one.
    """

    angle: np.ndarray
    erosion: np.ndarray
    dimension: Dimension
    uncertainty: np.ndarray | None
    speed: np.ndarray | None
    mass: np.ndarray | None
    shown_in: System = dataclasses.field(kw_only=True)
    source: str = dataclasses.field(kw_only=True)
    unused: tuple[str, ...] = ()
    error: ErrorModel | None = None
    parts: np.ndarray | None = None
    lines: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    unit: str = ""
    path: Path | None = None
    reading: Mapping[str, str] = dataclasses.field(default_factory=dict)
    speeds: np.ndarray | None = None
    common: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.error is None and self.uncertainty is not None:
            object.__setattr__(self, "error", ErrorModel.nearest(self.erosion, self.uncertainty))

    def __len__(self) -> int:
        return len(self.angle)

    @property
    def quantity(self) -> Quantity:
        """Symbol and meaning of `erosion`, for labels."""
        return RESULTS[_QUANTITY_OF[self.dimension]]

    @property
    def erosion_unit(self) -> str:
        """The unit of `erosion`, as programs read it."""
        return ascii_unit(unit_name(self.dimension, "si"))

    @functools.cached_property
    def scale(self) -> Scale:
        """The unit of erosion in tables and figures, the table's own or one in which its numbers read well."""
        if self.unit:
            return scale_of(self.unit, self.dimension)
        return table_scale(self.dimension, self.shown_in, largest_of(self.erosion))

    def in_words(self, erosion: float) -> str:
        """An erosion in the unit of the table: "240 mg/kg"."""
        return self.scale.beside(format_number(erosion, 3, self.scale.size))

    def scale_of(self, size: float) -> Scale:
        """The table's own unit where it is one of the case's system, else one in which a size reads well."""
        units = {scale.unit for scale in known_scales(self.dimension, self.shown_in)}
        is_own = bool(self.unit) and self.scale.unit in units
        return self.scale if is_own else table_scale(self.dimension, self.shown_in, size)

    def in_unit(self, unit: str) -> "Measurements":
        """Return the rows with a unit such as "g/kg", in which tables and figures show their erosion.

        Raises:
            ValueError: for a unit of something else, or with a number; a clause that starts with "must".
        """
        unit = unit.strip()
        if not unit or unit[0].isdigit():
            raise ValueError(f"must be a unit, without a number, but is {briefly(unit)}")
        scale_of(unit, self.dimension)
        return dataclasses.replace(self, unit=unit)

    @property
    def deviation(self) -> np.ndarray:
        """The scale of the residuals, shape (n,), which is a typical erosion where rows have no uncertainties."""
        if self.uncertainty is not None:
            return self.uncertainty
        return np.full(len(self), np.sqrt(np.mean(self.erosion**2)))

    @property
    def free_scale(self) -> bool:
        """Whether the erosion is known up to a factor only."""
        return self.dimension == "1"

    @property
    def per_mass(self) -> bool:
        """Whether the erosion is that of a mass of particles, not of one impact."""
        return self.dimension in ("volume per mass", "mass per mass")

    @property
    def needs_density(self) -> bool:
        """Whether the target's mass was measured, not its volume."""
        return self.dimension in ("mass", "mass per mass")

    @property
    def conditions(self) -> dict[str, np.ndarray]:
        """The impact's parameters that vary from row to row, by name."""
        return {"alpha": self.angle, **self.varied}

    @property
    def varied(self) -> dict[str, np.ndarray]:
        """Speeds and masses of the rows, by name; those that the data have."""
        given = {"v0": self.speed, "m": self.mass}
        return {name: values for name, values in given.items() if values is not None}

    @functools.cached_property
    def groups(self) -> np.ndarray:
        """The condition of each row, by ascending speed and mass, shape (n,); see `group_numbers`."""
        return self._numbered([group_numbers(values) for values in self.varied.values()])

    @functools.cached_property
    def repeats(self) -> np.ndarray:
        """A number for each angle of each condition, shape (n,), equal for rows that repeat each other."""
        return self._numbered([self.groups, self.angle])

    @functools.cached_property
    def has_one_speed(self) -> bool:
        """Whether all rows are of one speed."""
        return self.speed is None or not group_numbers(self.speed).any()

    @functools.cached_property
    def usual(self) -> Mapping[str, Any]:
        """Speed and mass of most rows, the greatest among equals, where the data have them."""
        return max(conditions(self), key=lambda group: (len(group.rows), *group.values.values())).values

    def _numbered(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """A number for each row, the same for rows that are alike in all columns."""
        if not columns:
            return np.zeros(len(self), int)
        return np.unique(np.stack(columns), axis=1, return_inverse=True)[1].ravel()

    def condition_of(self, row: int) -> str:
        """The condition of a row in words: "v₀ = 60 m/s"."""
        return next(group.label for group in conditions(self) if row in group.rows)

    def row_in_words(self, row: int) -> str:
        """A row as its reader finds it: "line 7" of a file; rows of tables in memory count from 0."""
        return f"row {row}" if self.lines is None else f"line {self.lines[row]}"

    def where(self, row: int) -> str:
        """A row with its angle and condition: "line 7 (30°, v₀ = 60 m/s)"."""
        label = self.condition_of(row)
        return f"{self.row_in_words(row)} ({np.rad2deg(self.angle[row]):.3g}°{', ' * bool(label)}{label})"

    def at_conditions(self) -> tuple[np.ndarray, np.ndarray]:
        """The distinct conditions, shape (parameters, conditions), and the one of each row, shape (n,)."""
        values, places = np.unique(np.stack(list(self.conditions.values())), axis=1, return_inverse=True)
        return values, places.ravel()

    def with_error(self, error: "ErrorModel | float | str | None") -> "Measurements":
        """Return the rows with the uncertainties of an error model.

        Args:
            error: a model, a text such as "0.3 mg/kg + 8 %", or a standard deviation [of the erosion]; None leaves the
                rows as they are. That of each speed alone leaves them their own, and is kept beside another.

        Raises:
            MeasurementError: for rows that have uncertainties already, for an error of zero, and for a common error of
                rows that have no speed in common.
        """
        if error is None:
            return self
        given = error
        if isinstance(error, str):
            with about("Argument `error`", MeasurementError):
                error = ErrorModel.read(error, self.dimension)
        if not isinstance(error, ErrorModel):
            error = ErrorModel(error)
        said = self._declared(error)
        is_as_given = isinstance(given, str) and said == error
        reading = {**self.reading, "error": given if is_as_given else said.in_words(self.dimension, self.shown_in)}
        if self.uncertainty is not None and error.has_own:
            raise MeasurementError(
                f"Argument `error` must be left out, but for that of each speed: {self.source} has a column of "
                "uncertainties."
            )
        if error.common:
            own = error if error.has_own else self.error or error
            error = dataclasses.replace(own, common=error.common)
            if self.uncertainty is not None or not error.has_own:
                return dataclasses.replace(self, error=error, speeds=self._speeds(), reading=reading)
        elif self.error is not None:
            error = dataclasses.replace(error, common=self.error.common)
        parts = np.tile([error.absolute, error.relative], (len(self), 1))
        speeds = self._speeds() if error.common else None
        rows = dataclasses.replace(self, error=error, parts=parts, speeds=speeds, reading=reading).weighed()
        if not rows.deviation.all():
            raise MeasurementError("Argument `error` must have an absolute part, as there are rows without erosion.")
        return rows

    def _declared(self, error: ErrorModel) -> ErrorModel:
        """An error with the part of the one before it that it leaves: that of the rows, or that of each speed."""
        if "error" not in self.reading:
            return error
        before = ErrorModel.read(self.reading["error"], self.dimension)
        return dataclasses.replace(error if error.has_own else before, common=error.common or before.common)

    def weighed(self, expected: np.ndarray | None = None, scatter: Any = None) -> "Measurements":
        """Return the rows with relative errors of this erosion, or of the mean of repeats.

        The common error is of an expected erosion alone: of the measured one it explains a model that misses by far.

        Args:
            expected: shape (n,).
            scatter: the rows' own error where no uncertainties are known, a number or of shape (n,).
        """
        errors = {}
        if self.parts is not None:
            mean = (np.bincount(self.repeats, self.erosion) / np.bincount(self.repeats))[self.repeats]
            of = of_which(mean if expected is None else expected, mean)
            errors["uncertainty"] = np.hypot(self.parts[:, 0], self.parts[:, 1] * of)
        if self.share_of_speeds and expected is not None:
            own = errors.get("uncertainty", self.deviation if scatter is None else scatter)
            errors["common"] = self.share_of_speeds * np.abs(expected) / own
        return dataclasses.replace(self, **errors)

    @property
    def share_of_speeds(self) -> float:
        """The share of the erosion by which all rows of a speed are off together; 0 without."""
        return 0.0 if self.error is None else self.error.common

    def _speeds(self) -> np.ndarray:
        """Which speed each row has, shape (n,).

        Raises:
            MeasurementError: where no two rows have one speed, or it is not clear which do.
        """
        if self.speed is None:
            return np.zeros(len(self), int)
        groups = group_numbers(self.speed)
        count, must = int(groups.max()) + 1, "Argument `error` must have no part of each speed, as"
        if count == len(self):
            raise MeasurementError(f"{must} no two rows are of one speed.")
        if count > _MOST_SPEEDS or not are_apart(self.speed, groups):
            raise MeasurementError(f"{must} the rows' speeds are no groups.")
        return groups

    def over_errors(self, of_rows: np.ndarray) -> np.ndarray:
        """Numbers of rows, such as residuals, over their errors, without what rows of one speed have in common.

        Args:
            of_rows: shape (…, n).
        """
        scaled = of_rows / self.deviation
        return (
            scaled if self.speeds is None or self.common is None else without_common(scaled, self.common, self.speeds)
        )

    @property
    def log_determinant(self) -> float:
        """The logarithm of the determinant of the covariance of the rows' errors."""
        logs = 2 * float(np.sum(np.log(self.deviation)))
        if self.speeds is None or self.common is None:
            return logs
        return logs + float(np.sum(np.log1p(np.bincount(self.speeds, self.common**2))))

    @property
    def whole_error(self) -> np.ndarray:
        """One standard deviation of each row, its own error and that of its speed, shape (n,); see `deviation`."""
        return np.hypot(self.deviation, self.share_of_speeds * self.erosion)

    def thinned(self, most: int) -> "Measurements":
        """At most `most` rows, drawn at random but always the same."""
        return self if len(self) <= most else self.of_rows(self.some(most))

    def some(self, most: int) -> np.ndarray:
        """The indexes of these rows."""
        if len(self) <= most:
            return np.arange(len(self))
        return np.sort(np.random.default_rng(0).choice(len(self), most, replace=False))

    def has_tests_of(self, other: "Measurements") -> bool:
        """Whether both have the same erosion at the same conditions, whatever its errors are."""
        of_each = [{"erosion": data.erosion, **data.conditions} for data in (self, other)]
        is_alike = self.dimension == other.dimension and len({*map(tuple, of_each)}) == 1
        return is_alike and all(np.array_equal(column, of_each[1][name]) for name, column in of_each[0].items())

    def of_rows(self, rows: np.ndarray) -> "Measurements":
        """Some rows, by their indexes."""
        columns = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        arrays = {name: values[rows] for name, values in columns.items() if isinstance(values, np.ndarray)}
        return dataclasses.replace(self, **arrays)


def read_measurements(
    data: Any,
    shown_in: str = "si",
    *,
    ignore: Sequence[str] = (),
    error: ErrorModel | float | str | None = None,
    per: str | None = None,
    columns: str | Mapping[str, str] | None = None,
    sep: str | None = None,
    decimal: str | None = None,
) -> Measurements:
    """Measured erosion from a file, or from columns in memory.

    Args:
        data: the path of a table (text, Parquet, Feather, Excel), or columns by header ({"angle [deg]": …, "volume
            [in^3/impact]": …}, a table of pandas, a Dataset of xarray), or `Measurements`. The columns are `angle`; one
            of `volume`, `mass_loss`, `erosion`; and at will `uncertainty`, `speed`, `mass`.
            Each carries its unit; volume and mass loss may be per impact ([mm^3/impact], [mg/impact]), per
            mass of particles ([mm^3/g], [mg/g]), or amounts ([mm^3], [mg]) with `per`; `erosion [-]` is known up to a
            factor.
            A column of another name that may be one of these is refused; `unused` of the result names all others.
        shown_in: the unit system that shows them; the numbers are in SI.
        ignore: columns that are left out, by their names: ("v_gas",).
        error: of rows without uncertainties: "0.3 mg/kg + 8 %", an `ErrorModel`, or a number in SI; and of
            any "5 % of each speed", by which all rows of a speed are off together.
        per: what removes an amount such as [mg]: "impact", or the mass of abrasive of each row, such as "100 g".
        columns: units of columns that carry none, and meanings of those whose names are not understood: "v=m/s,
            Abtrag=mass_loss [mg/g]", the same as a mapping, or a TOML file.
        sep: what separates the cells of a text: ",", ";", "tab" or " "; its header shows it otherwise.
        decimal: the mark of decimals of a text, "." or ","; its numbers show it otherwise.

    Raises:
        MeasurementError: one sentence with the table, the row and the column.
    """
    system = check_system(shown_in, "shown_in")
    if isinstance(data, Measurements):
        if per is not None:
            raise MeasurementError("Argument `per` must be left out for `Measurements`, which say what removes them.")
        return (data if data.shown_in == system else dataclasses.replace(data, shown_in=system)).with_error(error)
    try:
        table = open_table(
            data, KNOWN, columns=read_meanings(columns), ignore=ignore, sep=sep, decimal=decimal, refused=REFUSED
        )
        measured = _measurements(table, removal_of(table), system, per)
    except TableError as problem:
        raise MeasurementError(str(problem)) from problem
    path = Path(data) if isinstance(data, (str, Path)) else None
    source = path.name if path else "data"
    meanings = columns if columns is None or isinstance(columns, str) else written_meanings(columns)
    left_out = ignore if isinstance(ignore, str) else ",".join(map(list_item, ignore))
    between = TAB if sep == "\t" else sep
    given = {"per": per, "columns": meanings, "ignore": left_out, "sep": between, "decimal": decimal}
    reading = {name: text for name, text in given.items() if text}
    return dataclasses.replace(measured, path=path, reading=reading, source=source).with_error(error)


def unit_system(path: Path, columns: str | Mapping[str, str] | None = None, **options: Any) -> System | None:
    """The unit system of a file: that of its erosion's unit, or, where that has none, of its speed's or mass's.

    Arguments are those of `read_measurements`.

    None where no heading has a unit, and for what is no file, as a pipe is, or no table: reading it says what is wrong.
    """
    if not path.is_file():
        return None
    with contextlib.suppress(TableError):
        used = open_table(path, KNOWN, columns=read_meanings(columns), refused=REFUSED, **options).columns
        units = [used[name].unit for name in (*REMOVALS, "speed", "mass") if name in used]
        known = [{*re.findall(r"[^\W\d_]+", unit)} for unit in units if unit not in NO_UNIT]
        return None if not known else "inch-pound" if _INCH_POUND & known[0] else "si"
    return None


def _measurements(table: Table, removal: str, system: System, per: str | None) -> Measurements:
    """The measurements of a table, every number in its range.

    Args:
        table: that is understood.
        removal: its column of erosion.
        system: that shows them.
        per: see `read_measurements`.
    """
    columns, numbers = table.columns, table.numbers
    dimension, unit, abrasive = _removed_by(table, columns[removal], per)
    if not numbers["angle"].size:
        raise TableError(f"{table.title} has no rows of data.")
    missing = np.isnan(np.stack([*numbers.values()]))
    kept = ~missing.any(axis=0)
    if not kept.any():
        raise TableError(f"{table.title} has no row with all of its numbers.")
    notes = (*table.source.notes, *_left_out(missing, table))
    rows = np.flatnonzero(kept)
    arrays: dict[str, Any] = {name: values[rows] for name, values in numbers.items()}
    for name, values in arrays.items():
        good, must = np.isfinite(values), "must be a finite number"
        if name == "angle":
            good, must = are_angles(values), "must be above 0° and at most 90°"
        elif name == "mass":
            good, must = good & (values > 0) & (values <= _HEAVIEST), "must be the mass of one particle, at most 20 g"
        elif name != removal:
            good, must = good & (values > 0), "must be positive and finite"
        if not np.all(good):
            row = int(np.argmin(good))
            number = values[row] / columns[name].factor
            raise TableError(f"{table.place(int(rows[row]), name)} {must}, but is {number:g}.")
    if "uncertainty" in columns and are_shares(columns["uncertainty"]):
        shares = arrays["uncertainty"]
        arrays["uncertainty"] = shares * np.abs(arrays[removal])
        arrays["parts"] = np.stack([np.zeros(len(shares)), shares], axis=1)
        if not arrays["uncertainty"].all():
            row = int(np.argmin(np.abs(arrays[removal])))
            raise TableError(f"{table.place(int(rows[row]))} must have an absolute uncertainty, as it has no erosion.")
    reads_well = _LEAST_SHOWN <= largest_of(arrays[removal]) / columns[removal].factor < _MOST_SHOWN
    arrays |= {name: arrays[name] / abrasive for name in (removal, "uncertainty") if name in arrays}
    conditions: dict[str, Any] = {name: arrays.get(name) for name in ("uncertainty", "speed", "mass", "parts")}
    return Measurements(
        angle=arrays["angle"],
        erosion=arrays[removal],
        dimension=dimension,
        **conditions,
        shown_in=system,
        source=table.title,
        unused=table.unused,
        lines=table.lines(rows),
        notes=notes,
        unit="" if unit in NO_UNIT or unit[0].isdigit() or not reads_well else unit,
    ).weighed()


_PER_MASS: Mapping[Dimension, Dimension] = {"volume": "volume per mass", "mass": "mass per mass"}
_OF_IMPACT = re.compile(r"([^\W\d][^\s*/()]*)(?:\s*/\s*|\s+per\s+)impacts?")  # "mm^3/impact", and of that mm^3


def _removed_by(table: Table, column: Column, per: str | None) -> tuple[Dimension, str, float]:
    """Dimension and unit of the erosion of a column, and the mass of abrasive [kg] that it is divided by; 1 without.

    Raises:
        TableError: for an amount of which neither the heading nor `per` says what removes it.
    """
    must = 'must be "impact" or a mass of abrasive such as "100 g"'
    if not isinstance(per, str | None):
        raise TableError(f"Argument `per` {must}, but is {briefly(per)}.")
    per, unit, place = per and per.strip(), column.unit, f"{table.title}: column {column.heading.strip()!r}"
    said, uncertainty = is_per_impact(column), table.columns.get("uncertainty")
    if column.dimension not in _PER_MASS or said:
        if per not in (None, "impact" if said else None):
            raise TableError(f"{place} says what removes it, so Argument `per` must be left out.")
        # A unit that is written in another way is not taken apart.
        amount = _OF_IMPACT.fullmatch(unit)
        return column.dimension, unit if not said else amount[1] if amount else "", 1.0
    if uncertainty is not None and is_per_impact(uncertainty) and per != "impact":
        raise TableError(
            f"{table.title}: column {uncertainty.heading.strip()!r} is per impact, so {column.heading.strip()!r} must "
            "be, too."
        )
    if per is None:
        raise TableError(
            f'{place} is an amount: Argument `per` must be "impact" or the mass of abrasive of each row, such as '
            f'"100 g"; or the unit says it, as [{unit}/impact].'
        )
    if per == "impact":
        return column.dimension, unit, 1.0
    with about("Argument `per`", TableError):
        if not has_unit(per):
            raise ValueError(f"{must}, but is {briefly(per)}")
        abrasive = read_quantity(per, "mass")
        if not 0 < abrasive < np.inf:
            raise ValueError(f"must be positive and finite, but is {briefly(per)}")
    return _PER_MASS[column.dimension], "", abrasive


_LEAST_SHOWN, _MOST_SHOWN = 1e-3, 1e6  # of numbers that read well
_NAMED = 8  # rows that a note lists


def _left_out(missing: np.ndarray, table: Table) -> list[str]:
    """A sentence on the rows in which a number is missing, shape (columns, rows); none where all are there."""
    rows = np.flatnonzero(missing.any(axis=0))
    if not len(rows):
        return []
    headings = [column.heading.strip() for column in table.columns.values()]
    words = [f"{table.source.place(row)} ({headings[int(np.argmax(missing[:, row]))]})" for row in rows.tolist()]
    which = "a row is" if len(rows) == 1 else f"{len(rows):,} rows are"
    return [f"{table.title}: {which} left out, where a number is missing: {', '.join(first_of(words, _NAMED))}."]


def conditions(data: Measurements, most: int | None = None) -> list[Condition]:
    """The groups, by ascending speed and mass.

    Args:
        data: the measurements.
        most: where there are more groups, rows of similar energy m v₀² are put together.
    """
    varied = data.varied
    if not varied:
        return [Condition(np.arange(len(data)), InSI(), "")]
    count = int(data.groups.max()) + 1
    # The value itself where all rows have it: a mean would round.
    medians = [_medians(varied, np.flatnonzero(data.groups == group)) for group in range(count)]
    if most is None or count <= most:
        together, sign = [[group] for group in range(count)], "="
    else:
        energies = [median.get("m", 1.0) * median.get("v0", 1.0) ** 2 for median in medians]
        together, sign = np.array_split(np.argsort(energies, kind="stable"), most), "≈"
    parts = [np.flatnonzero(np.isin(data.groups, [*part])) for part in together]
    middles = [_medians(varied, rows) for rows in parts]
    varying = [name for name in varied if len({middle[name] for middle in middles}) > 1] or list(varied)
    return [
        Condition(rows, middle, describe({name: middle[name] for name in varying}, data.shown_in, sign))
        for rows, middle in zip(parts, middles, strict=True)
    ]


def _medians(columns: Mapping[str, np.ndarray], rows: np.ndarray) -> InSI:
    return InSI({name: float(np.sort(values[rows])[len(rows) // 2]) for name, values in columns.items()})
