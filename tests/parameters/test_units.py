"""Quantities: units, numbers as text, units in which numbers read well, and axes.

Heads of columns: name, unit, quantity.
"""

import functools
import itertools
import math

import numpy as np
import pytest

from erosion.parameters.quantities import (
    DIMENSIONS,
    QUANTITIES,
    SYSTEMS,
    Dimension,
    UnitError,
    _pint_unit,
    _registry,
    ascii_unit,
    declare_derivative,
    declare_result,
    derivative_unit,
    has_unit,
    read_axis,
    read_dimension,
    read_quantity,
    readable_scale,
    table_scale,
    unit_name,
    unit_size,
)
from erosion.results import render
from erosion.tables.headings import factor

_PRODUCTS = ("mass/time", "1/speed", "stress * time²", "energy/speed/mass flow^2", "[mass] * [length]**2")
_ALL: list[Dimension] = [*DIMENSIONS, *map(read_dimension, _PRODUCTS)]


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("M/T", "mass/time"),
        ("[mass] / [time]", "mass/time"),
        ("L**2·mass", "length^2*mass"),
        ("1/angular speed", "1/angular speed"),
        (" stress ", "stress"),
    ],
)
def test_dimensions_are_read(text: str, dimension: str) -> None:
    assert read_dimension(text) == dimension


def test_numbers_of_products_have_their_unit() -> None:
    drag = read_dimension("mass/time")
    assert read_quantity("2 g/ms", drag, "si") == 2
    assert read_quantity("1", drag, "inch-pound") == pytest.approx(175.126835246, rel=1e-11)
    assert unit_name(read_dimension("stress/speed^2"), "si") == "Pa/(m/s)²"


def test_unit_names_are_as_persons_and_programs_write_them() -> None:
    """pint reads every one of them as the unit that it names."""
    assert unit_name("stress", "inch-pound") == "lbf/in²"
    for system, dimension in itertools.product(SYSTEMS, _ALL):
        unit = _registry().parse_units(_pint_unit(dimension, system) or "dimensionless")
        name = ascii_unit(unit_name(dimension, system))
        assert name.isascii()
        assert _registry().parse_units("dimensionless" if name == "1" else name) == unit


@pytest.mark.parametrize(
    ("of", "by", "unit"),
    [
        ("volume", ["angle"], "in³/rad"),
        ("volume", ["angle", "angle"], "in³/rad²"),
        ("volume", ["angle", "speed"], "in³/rad/(in/s)"),
        ("volume", ["speed", "speed"], "in³/(in/s)²"),
        ("volume", ["1", "angle"], "in³/rad"),
        ("volume", ["1"], "in³"),
        ("time", ["volume"], "s/(in³)"),
    ],
)
def test_derivatives_have_units_of_both(of: Dimension, by: list[Dimension], unit: str) -> None:
    assert derivative_unit(of, by, "inch-pound") == unit


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("4400", "speed", 111.76),
        (" +1.5e3 ", "speed", 38.1),
        (".5 ft/s", "speed", 0.1524),
        ("1e3in/s", "speed", 25.4),
        ("111.76 m/s", "speed", 111.76),
        ("1 1/s*inch", "speed", 0.0254),
        ("inf", "speed", math.inf),
        ("60 rpm", "angular speed", 2 * math.pi),
        ("360 deg/s", "angular speed", 2 * math.pi),
        ("0.5 turn", "angle", math.pi),
    ],
)
def test_quantities_are_read(text: str, dimension: Dimension, value: float) -> None:
    assert read_quantity(text, dimension, "inch-pound") == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("dimension", [dimension for dimension in _ALL if dimension != "1"])
def test_sizes_are_those_of_the_units_names(dimension: Dimension) -> None:
    one = float(_registry().convert(1, _pint_unit(dimension, "inch-pound"), _pint_unit(dimension, "si")))
    assert unit_size(dimension, "inch-pound") == pytest.approx(one, rel=1e-14)
    assert unit_size(dimension, "si") == 1
    assert read_quantity(f"2 {ascii_unit(unit_name(dimension, 'inch-pound'))}", dimension) == pytest.approx(2 * one)


@pytest.mark.parametrize(
    ("text", "has"),
    [("20 deg", True), ("20", False), ("20 ", False), ("1e3", False), ("1e3 in", True), ("fast", False)],
)
def test_a_unit_is_seen(text: str, has: bool) -> None:
    assert has_unit(text) == has


@pytest.mark.parametrize(
    ("dimension", "units", "largest", "size", "unit"),
    [
        ("time", "inch-pound", 6.6e-5, 1e-6, "µs"),
        ("time", "si", 0.0, 1.0, "s"),
        ("length", "inch-pound", 0.032, 1.0, "in"),
        ("length", "inch-pound", 2e-4, 1e-6, "µin"),
        ("length", "inch-pound", 2e-9, 1e-9, "10⁻³ µin"),
        ("length", "si", 8e-4, 1e-3, "mm"),
        ("length", "si", 2e-12, 1e-12, "pm"),
        ("speed", "inch-pound", 4400.0, 1.0, "in/s"),
        ("volume", "inch-pound", 2.1e-4, 1e-4, "10⁻⁴ in³"),
        ("volume", "inch-pound", 1e-4, 1e-4, "10⁻⁴ in³"),
        ("volume", "si", 3e-9, 1e-9, "mm³"),
        ("volume", "si", 7e-11, 1e-9, "mm³"),
        ("volume", "si", 1e-14, 1e-15, "10³ µm³"),
        ("volume", "si", 4e-11, 1e-12, "10⁻³ mm³"),
        ("volume", "si", 3e-5, 1e-6, "cm³"),
        ("volume", "si", 5e-17, 1e-18, "µm³"),
        ("area", "si", 2e-6, 1e-6, "mm²"),
        ("mass", "si", 5e-8, 1e-9, "µg"),
        ("mass", "inch-pound", 1 / 386.0885826771654, 1 / 386.0885826771654, "lb"),
        ("stress", "si", 1.4e9, 1e9, "GPa"),
        ("angle", "si", 0.35, np.pi / 180, "°"),
        ("angle", "si", 0.0, np.pi / 180, "°"),
        ("volume per mass", "si", 2e-8, 1e-9, "mm³/kg"),
        ("mass per mass", "si", 5e-5, 1e-6, "mg/kg"),
        ("volume per angle", "si", 1e-9 * 180 / np.pi, 1e-9 * 180 / np.pi, "mm³/°"),
    ],
)
def test_units_make_numbers_readable(dimension, units, largest, size, unit) -> None:
    of_system = unit_size(dimension, units)
    scale = readable_scale(dimension, units, largest * of_system)
    assert scale.unit == unit
    assert scale.size == pytest.approx(size * of_system, rel=1e-15)


@pytest.mark.parametrize(
    ("dimension", "units", "largest", "number", "words"),
    [
        ("length", "inch-pound", 0.032, "32", "32 in"),
        ("stress", "inch-pound", 2e5, "2", "2 lbf/in²"),
        ("volume", "si", 2e-11, "0.02", "0.02 mm³"),
        ("volume", "inch-pound", 3.1e-7, "3.1 ± 2.5", "(3.1 ± 2.5)·10⁻⁷ in³"),
        ("speed", "si", 30.0, "30 ± 2", "30 ± 2 m/s"),
        ("1", "si", 1e-9, "1", "1"),
    ],
)
def test_tables_need_fewer_powers_of_ten(dimension, units, largest, number, words) -> None:
    assert table_scale(dimension, units, largest * unit_size(dimension, units)).beside(number) == words


def test_rows_are_in_units_that_people_read() -> None:
    mixed = declare_derivative("d2volume", 2e-9, [QUANTITIES["alpha"], QUANTITIES["phidot0"]])
    shown = {
        QUANTITIES["alpha"].declare("alpha", np.deg2rad(31.7174744)): ("31.717", "°"),
        declare_result("volume", 1.66178821e-9): ("1.66179", "mm³"),
        declare_result("volume", np.nan): ("nan", "m³"),
        declare_result("t_c", np.array([1e-6, np.nan, 5e-5])): ("[3] 1 … 50", "µs"),
        mixed: (f"{2 * np.pi / 180:.6g}", "mm³/°/(rad/s)"),
    }
    for value, words in shown.items():
        ((row,),) = (table.rows for table in render.tables("", [value], "si"))
        assert row[2:4] == words


def test_values_of_one_unit_share_the_unit_of_a_table_where_they_can() -> None:
    lengths = [declare_result("max_depth", depth) for depth in (0.0020442, 0.0020196e-2, 1e-9)]
    (table,) = render.tables("", lengths, "si")
    assert [row[2:4] for row in table.rows] == [("2.0442", "mm"), ("0.020196", "mm"), ("1", "nm")]


@pytest.mark.parametrize(
    ("name", "value", "units", "words"),
    [
        ("v0", 30.0, "si", "30 m/s"),
        ("alpha", np.deg2rad(40.0), "si", "40°"),
        ("k", 2.0, "si", "2"),
        ("m", 3.7463e-8, "si", "37.46 µg"),
        ("m", 2.855e-7, "inch-pound", "110.2·10⁻⁶ lb"),
    ],
)
def test_a_number_in_words_has_its_unit(name, value, units, words) -> None:
    assert QUANTITIES[name].in_words(value * QUANTITIES[name].size(units), units) == words


@pytest.mark.parametrize("largest", [5e-324, 1e-310, 1e305, 1.7e308])
def test_numbers_at_the_ends_of_what_a_float_holds_are_in_the_base_unit(largest) -> None:
    for dimension in ("mass", "length", "volume", "volume per angle"):
        for scale in (table_scale(dimension, "si", largest), readable_scale(dimension, "inch-pound", largest)):
            assert 0 < scale.size < np.inf


@pytest.mark.parametrize(
    ("text", "dimension", "values"),
    [
        ("0deg : 90deg : 4", "angle", np.deg2rad([0, 30, 60, 90])),
        ("1 in/s : 100 in/s : 3 : log", "speed", [0.0254, 0.254, 2.54]),
        ("20deg, 0.5", "angle", [np.deg2rad(20), 0.5]),
        (["1 ft", 3], "length", [0.3048, 0.0762]),
        ([1, 2.5], "1", [1, 2.5]),
        ("20 deg", "angle", np.deg2rad(20)),
        (2, "1", 2),
    ],
)
def test_values_are_read(text, dimension, values):
    axis = read_axis(text, dimension, "inch-pound")
    assert axis.shape == np.shape(values)
    np.testing.assert_allclose(axis, values, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("1 mil", "length", 2.54e-5),
        ("2 te/day", "mass flow", 2000 / 86400),
        ("1 pptb", "density", 0.45359237 / 158.987294928),
        ("0.5 mil", "length", 1.27e-5),
    ],
)
def test_units_of_oil_fields_are_read(text: str, dimension: Dimension, value: float) -> None:
    assert read_quantity(text, dimension, "si") == pytest.approx(value, rel=1e-12)


UNREADABLE: list[tuple[str, Dimension, str]] = [
    ("4400 kg", "speed", r"^must be a speed such as \"110 m/s\", but is '4400 kg', of dimension \[mass\]$"),
    ("20 deg", "1", r"^must be a pure number such as 2, but is '20 deg'$"),
    ("3 Hz", "angular speed", r"^must be an angular speed such as \"1000 rad/s\", but is '3 Hz'$"),
    ("3 rpm", "rate", r"^must be a rate such as"),
    ("44 00 m/s", "speed", "but '44 00 m/s' cannot be read"),
    ("100,5 m/s", "speed", "but '100,5 m/s' cannot be read; a number has a point, no comma$"),
    ("1,5", "1", "but '1,5' cannot be read; a number has a point, no comma$"),
    ("fast", "speed", "but 'fast' cannot be read$"),
    ("300 ?m", "length", "cannot be read$"),
    ("300 \N{REPLACEMENT CHARACTER}m", "length", "cannot be read$"),
    ("5 $m/s", "speed", "cannot be read$"),
    ("1 furlongs per", "speed", "cannot be read"),
    ("1 m/", "speed", "cannot be read"),
    ("1 m**(9**9)", "speed", "must be a speed"),
    ("", "speed", "but '' cannot be read"),
]
REFUSED = [
    *(
        (lambda text=text: read_dimension(text), ValueError, "'mass/time', but is")
        for text in ("", "kg/s", "mass/", "mass time", "length^0.5", "mass//time", "lengths")
    ),
    (
        lambda: read_quantity("2 kg", read_dimension("mass/time"), "inch-pound"),
        UnitError,
        "a mass/time such as \"2 slinch/s\", but is '2 kg'",
    ),
    *(
        (
            lambda number=number: factor(f"{number} mg/kg", "mass per mass"),
            UnitError,
            "of a positive, finite size",
        )
        for number in ("0", "0.0", "1e-999", "1e999")
    ),
    *(
        (functools.partial(read_quantity, text, dimension, "si"), UnitError, message)
        for text, dimension, message in UNREADABLE
    ),
    *(
        (lambda text=text: read_axis(text, "speed", "si"), UnitError, message)
        for text, message in [
            ("1:2", 'must be "first : last : count"'),
            ("1:2:1", "count"),
            ("1:2:3:cubic", "count"),
            ("-1:2:3:log", "ends of one sign"),
            ("1 kg:2:3", "must be a speed"),
            ([], "is empty"),
            ([True], "must be numbers"),
            ([[1, 2]], "must be numbers"),
        ]
    ),
]


@pytest.mark.parametrize(("read", "error", "message"), REFUSED)
def test_what_is_no_unit_quantity_or_axis_is_refused(read, error, message) -> None:
    with pytest.raises(error, match=message):
        read()
