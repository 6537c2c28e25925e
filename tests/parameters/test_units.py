import math
from typing import get_args

import pytest

from erosion.parameters.units import (
    _EXAMPLES,
    _PINT_UNITS,
    SYSTEMS,
    Dimension,
    UnitError,
    _registry,
    ascii_unit,
    conversion_factor,
    derivative_unit,
    has_unit,
    read_quantity,
    unit_name,
)


def test_unit_names_are_as_a_person_writes_them():
    assert unit_name("mass", "inch-pound") == "slinch"
    assert unit_name("stress", "inch-pound") == "lbf/in²"
    assert unit_name("volume", "si") == "m³"
    assert unit_name("1", "si") == ""


def test_unit_names_are_as_programs_read_them() -> None:
    """pint reads every one of them as the unit that it names."""
    for system in SYSTEMS:
        for dimension in get_args(Dimension):
            unit = _registry().parse_units(_PINT_UNITS[system][dimension] or "dimensionless")
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


def test_conversions_are_pints():
    for dimension in get_args(Dimension):
        one = _registry().Quantity(1.0, _PINT_UNITS["inch-pound"][dimension])
        factor = one.to(_PINT_UNITS["si"][dimension]).magnitude
        assert conversion_factor(dimension, "inch-pound", "si") == pytest.approx(factor, rel=1e-14)
        assert conversion_factor(dimension, "si", "inch-pound") == pytest.approx(1 / factor, rel=1e-14)
        assert conversion_factor(dimension, "si", "si") == 1


def test_each_system_is_consistent() -> None:
    """The conversion of a product is the product of the conversions: lbf is slinch·in/s², in both systems."""
    factor = {dimension: conversion_factor(dimension, "inch-pound", "si") for dimension in get_args(Dimension)}
    assert factor["area"] == pytest.approx(factor["length"] ** 2, rel=1e-15)
    assert factor["volume"] == pytest.approx(factor["length"] ** 3, rel=1e-15)
    assert factor["speed"] == factor["length"]
    assert factor["stress"] == pytest.approx(factor["mass"] / factor["length"], rel=1e-15)
    assert factor["density"] * factor["volume per mass"] == pytest.approx(1, rel=1e-15)
    assert {factor[name] for name in ("1", "time", "angle", "angular speed", "rate", "mass per mass")} == {1.0}


def test_spins_may_be_in_turns():
    assert read_quantity("60 rpm", "angular speed", "si") == pytest.approx(2 * math.pi)
    assert read_quantity("360 deg/s", "angular speed", "si") == pytest.approx(2 * math.pi)
    assert read_quantity("0.5 turn", "angle", "si") == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4400", 4400.0),
        (" +1.5e3 ", 1500.0),
        (".5 ft/s", 6.0),
        ("1e3in/s", 1000.0),
        ("111.76 m/s", 4400.0),
        ("1 1/s*inch", 1.0),
        ("inf", math.inf),
    ],
)
def test_speeds_are_read(text: str, value: float) -> None:
    assert read_quantity(text, "speed", "inch-pound") == pytest.approx(value, rel=1e-14)


def test_the_examples_in_messages_can_be_read() -> None:
    for system in SYSTEMS:
        for dimension, example in _EXAMPLES[system].items():
            assert has_unit(example.strip('"'))
            assert math.isfinite(read_quantity(example.strip('"'), dimension, system))  # type: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("text", "has"),
    [("20 deg", True), ("20", False), ("20 ", False), ("1e3", False), ("1e3 in", True), ("fast", False)],
)
def test_a_unit_is_seen(text: str, has: bool) -> None:
    assert has_unit(text) == has


@pytest.mark.parametrize(
    ("text", "dimension", "message"),
    [
        ("4400 kg", "speed", r"^must be a speed such as \"110 m/s\", but is '4400 kg', of dimension \[mass\]$"),
        ("20 deg", "1", r"^must be a pure number such as 2, but is '20 deg'$"),
        ("3 Hz", "angular speed", r"^must be an angular speed such as \"1000 rad/s\", but is '3 Hz'$"),
        ("3 rpm", "rate", r"^must be a rate such as"),
        ("44 00 m/s", "speed", "but '44 00 m/s' cannot be read"),
        ("100,5 m/s", "speed", "but '100,5 m/s' cannot be read; a number has a point, no comma$"),
        ("1,5", "1", "but '1,5' cannot be read; a number has a point, no comma$"),
        ("fast", "speed", "but 'fast' cannot be read$"),
        ("1 furlongs per", "speed", "cannot be read"),
        ("1 m/", "speed", "cannot be read"),
        ("1 m**(9**9)", "speed", "must be a speed"),
        ("", "speed", "but '' cannot be read"),
    ],
)
def test_what_is_no_such_quantity_is_refused(text: str, dimension: Dimension, message: str) -> None:
    with pytest.raises(UnitError, match=message):
        read_quantity(text, dimension, "si")
