"""Heads of columns: name, unit, quantity."""

import pytest

from erosion.parameters.headings import HeaderError, Known, factor, head_parts, read_heads
from erosion.parameters.quantities import UnitError

KNOWN = {
    "speed": Known(("speed",), ("v", "impact velocity"), "v|veloc.*"),
    "n": Known(("1",), ("count",), "particles?"),
}


@pytest.mark.parametrize(
    ("head", "parts"),
    [
        ("speed [m/s]", ("speed", "m/s")),
        (" Impact Velocity (m s-1) ", ("Impact Velocity", "m s^-1")),
        ("density (kg/(m^3))", ("density", "kg/(m^3)")),
        ("v / (m/s)", ("v", "m/s")),
        ("speed, m.s-1", ("speed", "m s^-1")),
        ("rate [1 / s]", ("rate", "1/s")),
        ("count", ("count", "")),
        ("angle [deg", ("angle [deg", "")),
        ("x" * 400 + " [m]", ("", "")),
        ("a" + "]" * 90, ("a" + "]" * 90, "")),
    ],
)
def test_name_and_unit(head: str, parts: tuple[str, str]) -> None:
    assert head_parts(head) == parts


def test_a_unit_may_have_a_number_or_begin_with_one() -> None:
    assert factor("1e-4 m^3", "volume", "si") == 1e-4
    assert factor("10 mm", "length", "si") == pytest.approx(0.01)
    assert factor("1/s", "rate", "si") == 1
    for number in ("0", "0.0", "1e-999", "1e999"):
        with pytest.raises(UnitError, match="must be of a positive, finite size"):
            factor(f"{number} mg/kg", "mass per mass", "si")


def test_columns_are_used_left_out_or_refused() -> None:
    heads = read_heads(["note", "Impact_Velocity [m/s]", "count", "age [s]", "v_gas [m/s]"], KNOWN, ignore=("V gas",))
    assert [head and head.name for head in heads.columns] == [None, "speed", "n", None, None]
    assert heads.unused == ("note", "age [s]")
    for strange in ("swirl [m/s]", "v_gas", "particles", "velocity ms"):
        with pytest.raises(HeaderError, match="understood") as caught:
            read_heads(["n", strange], KNOWN)
        assert caught.value.index == 1
    with pytest.raises(HeaderError, match="gives `speed`, but so does 'v'"):
        read_heads(["v", "speed [m/s]"], KNOWN)
    with pytest.raises(HeaderError, match="has no column 'w'"):
        read_heads(["v"], KNOWN, ignore=("w",))
