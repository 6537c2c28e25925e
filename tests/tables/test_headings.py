"""Headings of columns: their names and units, and which columns are used, left out, or refused."""

import ast
import re

import pytest

from erosion.tables import TableError, Wanted, open_table, read_meanings, written_meanings
from erosion.tables.headings import factor, heading_parts

WANTED = {
    "speed": Wanted(("speed",), ("v", "impact velocity"), "v|veloc.*"),
    "n": Wanted(("1",), ("count",), "particles?"),
}


@pytest.mark.parametrize(
    ("heading", "parts"),
    [
        ("speed [m/s]", ("speed", "m/s")),
        (" Impact Velocity (m s-1) ", ("Impact Velocity", "m s^-1")),
        ("density (kg/(m^3))", ("density", "kg/(m^3)")),
        ("v / (m/s)", ("v", "m/s")),
        ("v / m s-1", ("v", "m s^-1")),
        ("α / °", ("α", "°")),
        ("E / 10^-4 g/g", ("E", "1e-4 g/g")),
        ("E / 10⁻⁴ g/g", ("E", "1e-4 g/g")),
        ("E [10^-4 g/g]", ("E", "1e-4 g/g")),
        ("speed, m.s-1", ("speed", "m s^-1")),
        ("rate [1 / s]", ("rate", "1/s")),
        ("count", ("count", "")),
        ("angle [deg", ("angle [deg", "")),
        ("x" * 400 + " [m]", ("", "")),
        ("a" + "]" * 90, ("a" + "]" * 90, "")),
    ],
)
def test_name_and_unit(heading: str, parts: tuple[str, str]) -> None:
    assert heading_parts(heading) == parts


def test_a_unit_may_have_a_number_or_begin_with_one() -> None:
    assert factor("1e-4 m^3", "volume") == 1e-4
    assert factor("10 mm", "length") == pytest.approx(0.01)
    assert factor("1/s", "rate") == 1


def test_columns_are_used_left_out_or_refused() -> None:
    headings = ("note", "Impact_Velocity [m/s]", "count", "age [s]", "v_gas [m/s]")
    table = open_table({heading: [1.0] for heading in headings}, WANTED, ignore=("V gas",))
    assert {name: column.heading for name, column in table.columns.items()} == {"speed": headings[1], "n": "count"}
    assert table.unused == ("note", "age [s]")


@pytest.mark.parametrize(
    ("headings", "options", "words"),
    [
        *((("n", strange), {}, ("understood", strange, "`ignore`", "`columns`"))
          for strange in ("swirl [m/s]", "v_gas", "particles", "velocity ms")),
        (("v [m/s]", "speed [m/s]"), {}, ("gives `speed`", "'v [m/s]'")),
        (("v [m/s]",), {"ignore": ("w",)}, ("'w'", "`ignore`")),
        (("v [m/s]",), {"columns": {"w": "m"}}, ("'w'", "`columns`")),
        (("v [m/s]",), {"columns": {"v [m/s]": "ft/s"}}, ("has its unit", "`columns`")),
        (("v",), {}, ("must have a unit", "`columns`", '"v=m/s"')),
        (("v [kg]",), {}, ("'v [kg]'", "a speed")),
        (("count [kg]",), {}, ("'count [kg]'", "a pure number")),
        (("v [m/s]", "dose [kg]"), {"refused": {"dose": Wanted(("mass",))}}, ("'dose [kg]'", "not read")),
    ],
)  # fmt: skip
def test_a_refusal_names_the_column_and_what_helps(headings, options, words) -> None:
    with pytest.raises(TableError) as refused:
        open_table({heading: [1.0] for heading in headings}, WANTED, **options)
    assert [word for word in words if word not in str(refused.value)] == []


def test_a_column_means_what_its_user_says() -> None:
    table = open_table({"x1": [3.6], "grains": [2.0]}, WANTED, columns={"x1": "speed [km/h]", "grains": "n []"})
    assert {name: values.tolist() for name, values in table.numbers.items()} == {"speed": [1.0], "n": [2.0]}
    assert all(column.is_declared for column in table.columns.values())


@pytest.mark.parametrize("head", ["veloc, mean", 'veloc "x"', '"veloc", mean', "veloc = u", "veloc [m/s]"])
@pytest.mark.parametrize("named", [None, "vel [m/s]"])
def test_what_a_refusal_prints_can_be_typed(head: str, named: str | None) -> None:
    """The heading of the file, whatever it holds and however the user has explained it."""
    explained = {} if named is None or "[" in head else {head: named}
    with pytest.raises(TableError) as refusal:
        open_table({head: [3.0], "veloc [km/h]": [9.0]}, WANTED, columns=explained, ignore=["veloc [km/h]"])
    ignore, entry = re.findall(r"\(((['\"]).*?\2)\)(?=, or|\.$)", str(refusal.value))
    table = {head: [3.0], "count": [1.0]}
    assert open_table(table, WANTED, ignore=ast.literal_eval(ignore[0])).unused == ()
    meant = ast.literal_eval(entry[0]).replace("NAME", "speed").replace("UNIT", "m/s")
    assert open_table(table, WANTED, columns=read_meanings(meant)).numbers["speed"] == pytest.approx([3.0])


def test_meanings_are_read_as_they_are_written() -> None:
    meant = {"Loss, total": "mass_loss [mg]", '"q"': "mm", 'a "b"': "m/s", "c = d": "kg"}
    assert read_meanings(written_meanings(meant)) == meant


def test_a_meaning_may_stand_in_quotes() -> None:
    assert read_meanings('"Loss, total"="mass_loss [mg]", x="mm"') == {"Loss, total": "mass_loss [mg]", "x": "mm"}
