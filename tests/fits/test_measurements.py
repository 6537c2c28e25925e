"""Tables of measurements: read right, or refused with file, line and column."""

import time

import numpy as np
import pytest

from erosion.fits import MeasurementError, Measurements, read_measurements
from erosion.fits.measurements import unit_system

HEAD = "angle [deg], volume [in^3], uncertainty [in^3]\n"


def test_a_plain_table(table):
    found = read_measurements(table(HEAD + "20, 1.8e-4, 2e-6\n30, 2.1e-4, 3e-6\n"), "inch-pound")
    np.testing.assert_allclose(found.angle, np.deg2rad([20, 30]))
    np.testing.assert_allclose(found.erosion, [1.8e-4, 2.1e-4])
    assert found.uncertainty is not None
    np.testing.assert_allclose(found.uncertainty, [2e-6, 3e-6])
    assert (found.dimension, found.free_scale, found.per_mass, len(found)) == ("volume", False, False, 2)
    assert found.source == "data.csv"


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (HEAD + "20,1.5,1\n30,2,1\n", "utf-8-sig"),
        ((HEAD + "20,1.5,1\n30,2,1\n").replace("\n", "\r\n"), "utf-8"),
        ("# from the lab\n\n" + HEAD + "\n20,1.5,1\n# later\n30,2,1\n,,\n", "utf-8"),
        (HEAD.replace(",", ";") + "20,0;1,5;1\n30;2;1,0\n", "utf-8"),
        (HEAD.replace(", ", "\t") + "20\t1,5\t1\n30\t2.0\t1\n", "utf-8"),
        ('"angle [deg]","Volume [in^3]","UNCERTAINTY [in^3]"\n"20","1.5","1"\n30,2,1', "utf-8"),
        ('"# sand, 60 m/s",,\n' + HEAD + '20,1.5,1\n  # a spare, not used\n"# nor, this",,\n30,2,1\n', "utf-8"),
    ],
    ids=["byte order mark", "CRLF", "comments and blanks", "decimal commas", "tabs", "quotes", "quoted comments"],
)
def test_what_spreadsheets_write(table, text, encoding):
    found = read_measurements(table(text, encoding), "inch-pound")
    np.testing.assert_allclose(np.rad2deg(found.angle), [20, 30])
    np.testing.assert_allclose(found.erosion, [1.5, 2])


SLINCH = 175.126835246  # kg


@pytest.mark.parametrize(
    ("column", "dimension", "factor"),
    [
        ("volume [mm^3]", "volume", 1 / 25.4**3),
        ("volume [1e-4 in^3]", "volume", 1e-4),
        ("volume [mm^3/g]", "volume per mass", 1 / 25.4**3 * 1e3 * SLINCH),
        ("mass_loss [mg]", "mass", 1e-6 / SLINCH),
        ("mass loss [mg/g]", "mass per mass", 1e-3),
        ("mass_loss [-]", "mass per mass", 1.0),
        ("erosion [mg/g]", "mass per mass", 1e-3),
        ("erosion [in^3]", "volume", 1.0),
        ("erosion [-]", "1", 1.0),
        ("erosion", "1", 1.0),
    ],
)
def test_units_say_what_was_measured(table, column, dimension, factor):
    found = read_measurements(table(f"angle [rad],{column},speed [m/s],mass [g]\n0.5,3,100,2\n"), "inch-pound")
    assert found.dimension == dimension
    assert found.erosion == pytest.approx(3 * factor, rel=1e-9)
    assert found.speed == pytest.approx(100 / 0.0254)
    assert found.mass == pytest.approx(2e-3 / SLINCH)
    assert set(found.conditions) == {"alpha", "v0", "m"}


@pytest.mark.slow
def test_a_million_rows_are_read_and_the_last_one_is_checked(table):
    rows = "".join(f"{1 + i % 89},{i % 97}.25e-6,1e-6\n" for i in range(10**6))
    begin = time.perf_counter()
    assert len(read_measurements(table(HEAD + rows), "si")) == 10**6
    # 1 s on an idle machine; the checks of types in tests and a busy machine cost some.
    assert time.perf_counter() - begin < 20
    with pytest.raises(MeasurementError, match="line 1000002, column 1"):
        read_measurements(table(HEAD + rows + "90.5,1,1\n"), "si")


def test_columns_of_other_names_are_not_used_and_named(table):
    text = "run,angle [deg],volume [in^3],operator,time [s]\nA1,20,1.5,Ann,\nA2,30,2,Bob,7\n"
    measured = read_measurements(table(text), "inch-pound")
    np.testing.assert_allclose(measured.erosion, [1.5, 2])
    assert measured.unused == ("run", "operator", "time [s]")
    with pytest.raises(MeasurementError, match=r"line 2, column 3 \(volume \[in\^3\]\) must be a number, but is 'x'"):
        read_measurements(table(text.replace("1.5", "x")), "inch-pound")
    columns = {"run": ["A1", "A2"], "angle [deg]": [20, 30], "erosion [-]": [1, 2]}
    assert read_measurements(columns, "si").unused == ("run",)


def test_columns_in_memory():
    found = read_measurements({"angle [deg]": [20, 30], "erosion [-]": np.array([1, 2])}, "si")
    np.testing.assert_allclose(np.rad2deg(found.angle), [20, 30])
    assert read_measurements(found, "si") is found
    with pytest.raises(MeasurementError, match="must be in inch-pound units, as the case is, but is si"):
        read_measurements(found, "inch-pound")


def test_thinning_draws_rows():
    n = 1001
    whole = Measurements(np.linspace(0.1, 1, n), np.arange(n) * 1.0, "volume", np.ones(n), None, None, "si", "x")
    thin = whole.thinned(500)
    assert len(thin) == len(set(thin.erosion)) == 500
    np.testing.assert_allclose(thin.angle, whole.angle[thin.erosion.astype(int)])
    np.testing.assert_array_equal(thin.erosion, whole.thinned(500).erosion)
    assert thin.speed is None
    assert whole.thinned(n) is whole


@pytest.mark.parametrize(
    ("text", "system"),
    [
        (HEAD + "20,1,1\n", "inch-pound"),
        ("# a laboratory\nangle [deg]; volume [1e-4 in3]\n20;1\n", "inch-pound"),
        ("angle [deg], volume [mm^3], speed [ft/s]\n20,1,1\n", "si"),
        ("angle [deg], mass_loss [mg/kg]\n20,1\n", "si"),
        ("angle [deg], mass_loss [oz/lb]\n20,1\n", "inch-pound"),
        ("angle [deg], erosion [-], speed [ft/s]\n20,1,1\n", "inch-pound"),
        ("angle [deg], erosion [-]\n20,1\n", None),
        ("angle [deg], " + "x" * 200_000 + "\n", None),
        ("", None),
    ],
)
def test_the_units_of_the_erosion_tell_the_system(table, text, system):
    assert unit_system(table(text)) == system


def test_what_cannot_be_read_is_of_no_unit_system(tmp_path):
    assert unit_system(tmp_path / "nowhere.csv") is None
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    assert unit_system(tmp_path / "bytes.csv") is None
