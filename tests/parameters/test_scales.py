"""Units in which numbers read well."""

import numpy as np
import pytest

from erosion.parameters.quantities import QUANTITIES, derivative_row, quantity_row, result_row
from erosion.parameters.scales import readable_scale, table_scale


@pytest.mark.parametrize(
    ("dimension", "units", "largest", "size", "unit"),
    [
        ("time", "inch-pound", 6.6e-5, 1e-6, "µs"),
        ("time", "si", 0.0, 1.0, "s"),
        ("length", "inch-pound", 0.032, 1e-3, "mil"),
        ("length", "inch-pound", 2e-4, 1e-6, "µin"),
        ("length", "inch-pound", 2e-9, 1e-9, "10⁻³ µin"),
        ("length", "si", 8e-4, 1e-3, "mm"),
        ("length", "si", 2e-12, 1e-12, "10⁻³ nm"),
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
    scale = readable_scale(dimension, units, largest)
    assert scale.unit == unit
    assert scale.size == pytest.approx(size, rel=1e-15)


@pytest.mark.parametrize(
    ("dimension", "units", "largest", "unit"),
    [
        ("length", "inch-pound", 0.032, "in"),  # a figure's axis has mil
        ("stress", "inch-pound", 2e5, "lbf/in²"),
        ("volume", "si", 2e-11, "mm³"),
        ("volume", "inch-pound", 1e-4, "10⁻⁴ in³"),
        ("1", "si", 1e-9, ""),
    ],
)
def test_tables_need_fewer_powers_of_ten(dimension, units, largest, unit) -> None:
    assert table_scale(dimension, units, largest).unit == unit


def test_rows_are_in_units_that_people_read() -> None:
    assert quantity_row("alpha", QUANTITIES["alpha"], np.deg2rad(31.7174744), "si")[2:4] == ("31.717", "°")
    assert result_row("volume", 1.66178821e-9, "si")[2:4] == ("1.66179", "mm³")
    assert result_row("volume", np.nan, "si")[2:4] == ("nan", "m³")
    assert result_row("t_c", np.array([1e-6, np.nan, 5e-5]), "si")[2:4] == ("[3] 1 … 50", "µs")
    mixed = derivative_row("d2volume", 2e-9, [QUANTITIES["alpha"], QUANTITIES["phidot0"]], "si")
    assert mixed[2:4] == (f"{2 * np.pi / 180:.6g}", "mm³/°/(rad/s)")


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
    assert QUANTITIES[name].in_words(value, units) == words


def test_a_power_of_ten_counts_for_the_error_too() -> None:
    assert table_scale("volume", "inch-pound", 3.1e-7).beside("3.1 ± 2.5") == "(3.1 ± 2.5)·10⁻⁷ in³"
    assert table_scale("speed", "si", 30.0).beside("30 ± 2") == "30 ± 2 m/s"


@pytest.mark.parametrize("largest", [5e-324, 1e-310, 1e305, 1.7e308])
def test_numbers_at_the_ends_of_what_a_float_holds_are_in_the_base_unit(largest) -> None:
    for dimension in ("mass", "length", "volume", "volume per angle"):
        for scale in (table_scale(dimension, "si", largest), readable_scale(dimension, "inch-pound", largest)):
            assert 0 < scale.size < np.inf
