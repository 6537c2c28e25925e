"""Tables of measurements: read right, or refused with file, line and column; names that people give to columns.

Errors as laboratories have them: read, given as a column or by option, nearest to a column, drawn anew.
"""

import dataclasses
import math
import re

import numpy as np
import pytest
from scipy import stats

from erosion import (
    TABLE_1,
    ErrorModel,
    FitProblem,
    MeasurementError,
    Measurements,
    calibrate,
    check,
    impact,
    read_measurements,
)
from erosion.fits.likelihood import make_likelihood
from erosion.fits.measurements import unit_system
from erosion.parameters.quantities import UnitError

SI = TABLE_1.to("si")

INCH3 = 0.0254**3  # m³
HEAD = "angle [deg], volume [in^3/impact], uncertainty [in^3]\n"


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (HEAD + "20,1.5,1\n30,2,1\n", "utf-8"),
        (HEAD + "20,1.5,1\n30,2,1\n", "utf-8-sig"),
        ((HEAD + "20,1.5,1\n30,2,1\n").replace("\n", "\r\n"), "utf-8"),
        ("# from the lab\n\n" + HEAD + "\n20,1.5,1\n# later\n30,2,1\n,,\n", "utf-8"),
        (HEAD.replace(",", ";") + "20,0;1,5;1\n30;2;1,0\n", "utf-8"),
        (HEAD.replace(", ", "\t") + "20\t1,5\t1\n30\t2,0\t1\n", "utf-8"),
        ('"angle [deg]","Volume [in^3/impact]","UNCERTAINTY [in^3]"\n"20","1.5","1"\n30,2,1', "utf-8"),
        ('"# sand, 60 m/s",,\n' + HEAD + '20,1.5,1\n  # a spare, not used\n"# nor, this",,\n30,2,1\n', "utf-8"),
    ],
    ids=["plain", "byte order mark", "CRLF", "comments", "decimal commas", "tabs", "quotes", "quoted comments"],
)
def test_what_spreadsheets_write(table, text, encoding):
    measured = read_measurements(table(text, encoding), "inch-pound")
    np.testing.assert_allclose([np.rad2deg(measured.angle), measured.erosion], [[20, 30], [1.5 * INCH3, 2 * INCH3]])
    np.testing.assert_allclose(np.asarray(measured.uncertainty), [INCH3, INCH3])
    assert (measured.dimension, measured.source) == ("volume", "data.csv")


@pytest.mark.parametrize(
    ("column", "dimension", "factor"),
    [
        ("volume [mm^3/impact]", "volume", 1e-9),
        ("volume [1e-4 in^3/impact]", "volume", 1e-4 * INCH3),
        ("volume [mm^3/g]", "volume per mass", 1e-6),
        ("mass_loss [mg/impact]", "mass", 1e-6),
        ("volume [mm^3 per impact]", "volume", 1e-9),
        ("volume [1/impact*mm^3]", "volume", 1e-9),
        ("mass_loss [mg impact^-1]", "mass", 1e-6),
        ("mass_loss [-]", "mass per mass", 1.0),
        ("erosion [mg/g]", "mass per mass", 1e-3),
        ("erosion [in^3/impact]", "volume", INCH3),
    ],
)
def test_units_say_what_was_measured(table, column, dimension, factor):
    measured = read_measurements(table(f"angle [rad],{column},speed [m/s],mass [g]\n0.5,3,100,2\n"), "inch-pound")
    assert (measured.dimension, measured.erosion) == (dimension, pytest.approx(3 * factor, rel=1e-9))
    conditions = {name: float(values[0]) for name, values in measured.conditions.items()}
    assert conditions == pytest.approx({"alpha": 0.5, "v0": 100.0, "m": 2e-3})


def test_an_amount_needs_to_be_told_what_removes_it(table):
    head, cells = "angle [deg],mass loss [mg],uncertainty [mg]", "30,5,1"
    with pytest.raises(MeasurementError, match=r"Argument `per` must be \"impact\" or .* as \[mg/impact\]"):
        read(table, head, cells)
    measured = read(table, head, cells, per="100 g")
    assert (measured.dimension, measured.in_words(5e-5)) == ("mass per mass", "50 mg/kg")
    assert measured.erosion == pytest.approx(5e-5)
    assert measured.uncertainty == pytest.approx(1e-5)
    volume = read_measurements(table("angle [deg],volume [mm^3]\n30,5\n"), "inch-pound", per="100 g")
    assert volume.erosion == pytest.approx(5e-9 / 0.1, rel=1e-9)
    assert read(table, head, cells, per="impact").erosion == pytest.approx(5e-6)
    alike = read(table, "angle [deg],mass loss [mg/impact],uncertainty [mg/impact]", cells, error="5 % of each speed")
    assert (alike.erosion, alike.uncertainty) == (pytest.approx(5e-6), pytest.approx(1e-6))
    below = read(table, "angle,mass loss,speed\ndeg,mg/impact,m/s", "30,5,80")
    assert (below.dimension, below.unit, below.erosion) == ("mass", "mg", pytest.approx(5e-6))


@pytest.mark.parametrize(
    ("column", "per", "said"),
    [
        ("mass_loss [mg/kg]", "100 g", "says what removes it, so Argument `per` must be left out"),
        ("mass_loss [mg/impact]", "100 g", "says what removes it"),
        ("mass_loss [mg]", "100", 'must be "impact" or a mass of abrasive such as "100 g", but is \'100\''),
        ("mass_loss [mg]", "100 m", "Argument `per` must be a mass"),
        ("mass_loss [mg]", "0 g", "must be positive and finite"),
        ("mass_loss [mg]", 100, 'must be "impact" or a mass of abrasive such as "100 g", but is 100.'),
        ("volume [mm^3 impact^-1]", "100 g", "says what removes it"),
        ("mass_loss [mg],uncertainty [mg/impact]", "100 g", "so 'mass_loss [mg]' must be, too"),
        ("mass_loss [mg/impact/impact]", None, "that of a mass or mass per mass, but is 'mg/impact/impact'"),
        ("mass_loss [mg/kg/impact]", None, "that of a mass or mass per mass, but is 'mg/kg/impact'"),
        ("mass_loss [mg],speed [m/s/impact]", "100 g", "that of a speed, but is 'm/s/impact'"),
        ("mass_loss [mg],mass [ug/impact]", "100 g", "that of a mass, but is 'ug/impact'"),
    ],
)
def test_what_removes_an_amount_is_said_once_and_well(table, column, per, said):
    with pytest.raises(MeasurementError) as caught:
        read(table, f"angle [deg],{column}", "30,5" + ",7" * column.count(","), per=per)
    assert said in str(caught.value)


def test_a_problem_is_told_what_removes_its_amounts():
    rows, p = {"angle [deg]": [20, 30, 40], "volume [mm^3]": [1.0, 2.0, 2.0]}, SI
    of_each = [
        FitProblem("linearized", p, rows, per="impact"),
        *FitProblem.of_models(["linearized", "finnie"], p, rows, ["k"], per="100 g"),
    ]
    assert [problem.data.dimension for problem in of_each] == ["volume", "volume per mass", "volume per mass"]
    with pytest.raises(MeasurementError, match="Argument `per` must be left out for `Measurements`"):
        FitProblem("linearized", p, of_each[0].data, per="impact")


def test_measurements_say_how_they_were_read():
    rows = {"alpha": [20, 30, 40], "loss": [1.0, 2.0, 2.0], "n": [1, 2, 3]}
    columns = {"alpha": "angle [deg]", "loss": "mass_loss [mg]"}
    measured = read_measurements(rows, "si", per="1 kg", columns=columns, ignore=["n"], error=ErrorModel(1e-7, 0.05))
    told = {"per": "1 kg", "columns": "alpha=angle [deg], loss=mass_loss [mg]", "ignore": "n"}
    assert measured.reading == {**told, "error": "100 µg/kg + 5 %"}
    again = read_measurements(rows, "si", **{**measured.reading, "ignore": measured.reading["ignore"].split(",")})
    assert again.erosion.tolist() == measured.erosion.tolist()
    assert again.deviation == pytest.approx(measured.deviation)


_OF_SPEED = "5 % of each speed"


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        (["8 %", _OF_SPEED], f"8 % + {_OF_SPEED}"),
        ([_OF_SPEED, "8 %"], f"8 % + {_OF_SPEED}"),
        (["8 %", "3 % of each speed", ErrorModel(common=0.05)], f"8 % + {_OF_SPEED}"),
        ([f"{_OF_SPEED} + 8 %"], f"{_OF_SPEED} + 8 %"),
        ([None, _OF_SPEED], _OF_SPEED),
    ],
)
def test_rows_with_two_errors_are_read_again_with_both(errors, said):
    rows = {"angle [deg]": [20, 30, 20, 30], "mass_loss [mg/kg]": [1.0, 2.0, 4.0, 9.0], "speed [m/s]": [50, 50, 99, 99]}
    if errors[0] is None:
        rows["uncertainty [mg/kg]"] = [0.1, 0.1, 0.2, 0.3]
    measured = read_measurements(rows, "si", error=errors[0])
    for error in errors[1:]:
        measured = FitProblem("linearized", SI, measured, ["k"], error=error, density=2700.0).data
    assert measured.reading["error"] == said
    again = read_measurements(rows, "si", error=said)
    assert again.error == measured.error
    assert again.uncertainty == pytest.approx(measured.uncertainty)


@pytest.mark.parametrize(("unit", "is_right"), [("0.3 mg/impact", True), ("0.3 mg", True), ("0.3 mg/kg", False)])
def test_an_error_may_be_per_impact_where_the_erosion_is(unit, is_right):
    rows = {"angle [deg]": [20, 30], "mass_loss [mg/impact]": [1.0, 2.0]}
    if is_right:
        assert read_measurements(rows, "si", error=unit).uncertainty == pytest.approx(3e-7)
    else:
        with pytest.raises(MeasurementError, match="Argument `error` must be a mass"):
            read_measurements(rows, "si", error=unit)


def test_columns_of_other_names_are_not_read(table):
    text = "run,angle [deg],volume [in^3/impact],time [s]\nA1,20,1.5,\nA2,30,2,7\n"
    np.testing.assert_allclose(read_measurements(table(text), "inch-pound").erosion, [1.5 * INCH3, 2 * INCH3])
    with pytest.raises(
        MeasurementError, match=r"line 2: column `volume \[in\^3/impact\]` must be a number, but is 'x'"
    ):
        read_measurements(table(text.replace("1.5", "x")), "inch-pound")


def test_columns_in_memory():
    columns = {"run": ["A1", "A2"], "angle [deg]": [20, 30], "erosion [-]": np.array([1, 2])}
    measured = read_measurements(columns, "si")
    np.testing.assert_allclose(np.rad2deg(measured.angle), [20, 30])
    assert measured.unused == ("run",)
    assert read_measurements(measured, "si") is measured
    assert read_measurements(measured, "inch-pound").shown_in == "inch-pound"


def test_thinning_draws_rows():
    n = 1001
    whole = Measurements(
        np.linspace(0.1, 1, n), np.arange(n) * 1.0, "volume", np.ones(n), None, None, shown_in="si", source="x"
    )
    thin = whole.thinned(500)
    assert len(thin) == len(set(thin.erosion)) == 500
    np.testing.assert_allclose(thin.angle, whole.angle[thin.erosion.astype(int)])
    np.testing.assert_array_equal(thin.erosion, whole.thinned(500).erosion)
    assert whole.thinned(n) is whole


@pytest.mark.parametrize(
    ("content", "system"),
    [
        (HEAD + "20,1,1\n", "inch-pound"),
        ("# a laboratory\nangle [deg]; volume [1e-4 in3]\n20;1\n", "inch-pound"),
        ("angle [deg], volume [mm^3/impact], speed [ft/s]\n20,1,1\n", "si"),
        ("angle [deg], mass_loss [mg/kg]\n20,1\n", "si"),
        ("angle [deg], mass_loss [oz/lb]\n20,1\n", "inch-pound"),
        ("angle [deg], erosion [-], speed [ft/s]\n20,1,1\n", "inch-pound"),
        ("angle [deg], erosion [-]\n20,1\n", None),
        ("angle [deg], " + "x" * 200_000 + "\n", None),
        ("", None),
        ("\udcff", None),
    ],
)
def test_the_units_of_the_erosion_tell_the_system(tmp_path, content, system):
    (tmp_path / "data.csv").write_bytes(content.encode(errors="surrogateescape"))
    assert unit_system(tmp_path / "data.csv") == system
    assert unit_system(tmp_path / "nowhere.csv") is None


SPEEDS = {
    "speed [m/s]": 80, "v [m/s]": 80, "V [m/s]": 80, "velocity [m/s]": 80, "speed (m/s)": 80, "v0 [m/s]": 80,
    "v₀ [m/s]": 80, "Impact Velocity [m s^-1]": 80, "impact speed [km/h]": 288, "impact_velocity [m·s⁻¹]": 80,
    "v_impact [m/s]": 80, "V_impact (m s-1)": 80, "vel [m/s]": 80, "speed_mps": 80, "velocity_m_s": 80, "speed m/s": 80,
    "v / (m/s)": 80, "particle velocity [mm/s]": 8e4, "Speed[m/s]": 80, "|v| [m/s]": 80, "v in m/s": 80,
}  # fmt: skip
ANGLES = {
    "angle [deg]": 30, "angle (deg)": 30, "Angle [°]": 30, "alpha [rad]": math.pi / 6, "α [°]": 30, "angle_deg": 30,
    "impact angle [deg]": 30, "Impact Angle (degrees)": 30, "impactAngle [deg]": 30, "angle of attack [deg]": 30,
    "impingement angle [deg]": 30, "angle in deg": 30, "attack_angle [deg]": 30, "angle / °": 30,
}  # fmt: skip
AMOUNTS = {
    # one amount of each kind in SI
    "volume [mm^3]": ("volume", 1e9), "Volume loss (mm³)": ("volume", 1e9), "wear volume [m3]": ("volume", 1),
    "eroded volume [mm^3/g]": ("volume per mass", 1e6), "volume_mm3": ("volume", 1e9), "mass loss [mg]": ("mass", 1e6),
    "Mass Loss (mg/g)": ("mass per mass", 1e3), "weight loss [mg]": ("mass", 1e6), "mass_loss_mg": ("mass", 1e6),
    "massLoss [mg/kg]": ("mass per mass", 1e6), "removed mass [g]": ("mass", 1e3), "erosion [-]": ("1", 1),
    "erosion rate [mg/kg]": ("mass per mass", 1e6), "Erosion Ratio [kg/kg]": ("mass per mass", 1), "erosion": ("1", 1),
    "wear [mg]": ("mass", 1e6), "wear rate [mm^3/kg]": ("volume per mass", 1e9),
    "specific erosion [mm3/g]": ("volume per mass", 1e6),
}  # fmt: skip
DOUBTFUL_AMOUNTS = [
    "V [mm^3]", "volume", "dm [mg]", "loss [mg]", "erosion ratio [-]", "erosion ratio", "wear",
    "erosion rate [mm/year]", "mass loss [%]", "penetration [mm]", "E [mg/g]",
    "Abtrag [mg]", "weight [g]", "specific wear rate [mm^3/N/m]",
]  # fmt: skip
DOUBTFUL = [
    "v", "speed", "u [m/s]", "w [m/s]", "jet velocity [m/s]", "gas speed [m/s]", "v_rel [m/s]", "v1 [m/s]", "rpm",
    "velocity_ms", "Geschwindigkeit [m/s]", "test speed", "feed rate [g/min]", "sand flow [kg/s]", "impacts [1/s]",
    "theta [deg]", "nozzle angle [deg]", "incidence angle [deg]", "angle std [deg]", "tilt [deg]",
    "size [um]", "d [um]", "diameter [um]", "d50 [um]", "particle size (um)", "size", "radius [mm]", "diameter_um",
    "density [kg/m^3]", "particle density [g/cm^3]", "spin [rad/s]",
    "m [mg]", "sand mass [kg]", "mass before [g]", "mass after [g]", "weight [g]", "weight", "mass",
    "depth [um]", "loss [mg/kg]", "error [mg/kg]", "error", "uncertainty", "sigma [mg/kg]", "std",
    "impact velocity [m/s], speed [m/s]", "volume [mm^3]", "wear [mg/g]", "mass loss [mg]",
]  # fmt: skip
FOREIGN = [
    "note", "run", "sample", "date", "erodent", "material", "repeat", "time [s]", "temperature [K]", "pressure [bar]",
    "humidity [%]", "hardness [GPa]", "test duration [min]", "operator",
]  # fmt: skip


def read(table, head, cells, **options):
    return read_measurements(table(f"{head}\n{cells}\n"), "si", **options)


REST = "angle [deg],mass_loss [mg/kg],{}"
MASSES = ["mass [mg]", "particle mass [mg]", "mass_mg", "mass of erodent (mg)", "grain mass [mg]"]
ERRORS = ["uncertainty [mg/g]", "std [mg/g]", "Standard deviation (mg/g)", "std_dev [mg/g]"]


@pytest.mark.parametrize(
    ("head", "cells", "field", "value"),
    [
        *((REST.format(name), f"30,5,{number}", "speed", 80.0) for name, number in SPEEDS.items()),
        *((f"{name},mass_loss [mg/kg]", f"{number},5", "angle", math.pi / 6) for name, number in ANGLES.items()),
        *((REST.format(name), "30,5,7", "mass", 7e-6) for name in MASSES),
        *((REST.format(name), "30,5,7", "uncertainty", 7e-3) for name in ERRORS),
        *((f"angle [deg],{name}", f"30,{number}", "erosion", 1.0) for name, (_, number) in AMOUNTS.items()),
        *((f"angle [deg],{name}", f"30,{number}", "dimension", kind) for name, (kind, number) in AMOUNTS.items()),
        *((f"angle [deg],{name},mass_loss [mg/kg]", "30,x,5", "unused", (name,)) for name in FOREIGN),
    ],
)
def test_columns_are_understood_or_left_out_and_named(table, head, cells, field, value):
    kind = AMOUNTS.get(head.removeprefix("angle [deg],"), ("",))[0]
    measured = read(table, head, cells, per="impact" if kind in ("volume", "mass") else None)
    assert getattr(measured, field) == (value if isinstance(value, (str, tuple)) else pytest.approx(value))
    assert field == "unused" or measured.unused == ()


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_condition_that_leaves_a_doubt_is_refused(table, name):
    rest = ",7" * (name.count(",") + 1)
    with pytest.raises(MeasurementError) as caught:
        read(table, REST.format(name), f"30,5{rest}")
    assert str(caught.value).startswith(str(table("")))
    if "," not in name:
        measured = read(table, REST.format(name), "30,5,7", ignore=(name,))
        assert (measured.speed, measured.mass, measured.uncertainty, measured.unused) == (None, None, None, ())
        data = {"angle [deg]": [30.0], "mass_loss [mg/kg]": [5.0], name: [7.0]}
        with pytest.raises(MeasurementError, match=r"`ignore`|`columns`|must have the unit|must have one column"):
            read_measurements(data, "si")
        np.testing.assert_array_equal(read_measurements(data, "si", ignore=name).erosion, measured.erosion)


@pytest.mark.parametrize(
    ("head", "cells", "options", "message"),
    [
        *((f"angle [deg],{name}", "30,5", {}, re.escape(repr(name))) for name in DOUBTFUL_AMOUNTS),
        (
            "angle [deg],mass_loss [mg/impact],mass [kg]",
            "30,5,0.5",
            {},
            r"`mass \[kg\]` must be the mass of one particle",
        ),
        ("angle [deg],mass_loss [0 mg/kg]", "30,5", {}, r"the unit must be .*'0 mg/kg'"),
        (
            "angle [deg],volume [mm^3/impact]",
            "30,5",
            {"ignore": ("v_gas",)},
            "has no column 'v_gas', which Argument `ignore`",
        ),
    ],
)
def test_what_leaves_a_doubt_is_refused(table, head, cells, options, message):
    with pytest.raises(MeasurementError, match=message):
        read(table, head, cells, **options)


MESSY = "Impact angle (°);v [m/s];mass loss [mg/kg];note\n15;60;10,5;\n30;60;n.a.;größer\n45;;9,5;\n90;60;7;\n"


def test_rows_without_a_number_are_left_out_and_named(table):
    measured = read_measurements(table(MESSY), "si")
    np.testing.assert_allclose([np.rad2deg(measured.angle), measured.erosion * 1e6], [[15, 90], [10.5, 7]])
    assert [measured.row_in_words(row) for row in range(2)] == ["line 2", "line 5"]
    assert len(measured.notes) == 1
    assert "line 3 (mass loss [mg/kg]), line 4 (v [m/s])" in measured.notes[0]
    in_memory = read_measurements({"angle [deg]": [20, 30, 40], "erosion [-]": [1, np.nan, 2]}, "si")
    assert (len(in_memory), "row 1 (erosion [-])" in in_memory.notes[0]) == (2, True)
    with pytest.raises(MeasurementError, match="line 5: column `Impact"):
        read_measurements(table(MESSY.replace("90;", "95;")), "si")
    with pytest.raises(MeasurementError, match="no row with all"):
        read_measurements(table("angle [deg],erosion [-]\n20,n.a.\n"), "si")


@pytest.mark.parametrize(("encoding", "notes"), [("utf-8", 1), ("utf-16", 1), ("cp1252", 2)])
def test_characters_of_other_programs_are_read_or_named(table, encoding, notes):
    measured = read_measurements(table(MESSY, encoding), "si")
    assert (len(measured), len(measured.notes)) == (2, notes)
    assert notes == 1 or "Windows-1252" in measured.notes[0]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("0.3 mg/kg + 8 %", (3e-7, 0.08)),
        ("8%+3e-1 mg/kg", (3e-7, 0.08)),
        ("5 percent", (0.0, 0.05)),
        ("3e+1 ug/kg", (3e-8, 0.0)),
        ("5 % of each speed + 0.3 mg/kg + 8 %", (3e-7, 0.08, 0.05)),
        ("5 percent of each speed", (0.0, 0.0, 0.05)),
    ],
)
def test_a_text_has_one_or_more_parts(text, parts):
    error, parts = ErrorModel.read(text, "mass per mass"), (*parts, 0.0)[:3]
    np.testing.assert_allclose(dataclasses.astuple(error), parts, rtol=1e-12)
    np.testing.assert_allclose(error.deviation(np.array([0.0, 1e-4])), np.hypot(parts[0], [0, parts[1] * 1e-4]))
    again = ErrorModel.read(error.in_words("mass per mass", "si"), "mass per mass")
    assert dataclasses.astuple(again) == pytest.approx(parts)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "8",
        "-8 %",
        "8 % + 3 %",
        "0.3 mg",
        "0 %",
        "nan %",
        "mg/kg + 8 %",
        "8 % of each day",
        "2 % of each speed + 3 % of each speed",
    ],
)
def test_other_texts_are_refused(text):
    with pytest.raises(UnitError, match="must be"):
        ErrorModel.read(text, "mass per mass")


PER_KG, ROWS = "angle [deg], mass_loss [mg/kg]", ("20, 99", "20, 101", "60, 40")


def test_the_relative_part_is_of_the_mean_of_repeats(table):
    measured = read_measurements(table("\n".join((PER_KG, *ROWS))), "si", error="3 mg/kg + 4 %")
    assert measured.uncertainty == pytest.approx([5e-6, 5e-6, np.hypot(3, 1.6) * 1e-6])
    assert measured.error == ErrorModel(3e-6, 0.04)
    with pytest.raises(MeasurementError, match="`error`"):
        measured.with_error(1e-6)
    with pytest.raises(MeasurementError, match="absolute part"):
        read_measurements(table(PER_KG + "\n20, 99\n60, 0\n"), "si", error="8 %")


def test_a_column_of_percents_is_one_of_shares(table):
    text = "\n".join((PER_KG + ", uncertainty [%]", "20, 100, 8", "60, 50, 4"))
    measured = read_measurements(table(text), "si")
    assert measured.uncertainty == pytest.approx([8e-6, 2e-6])
    with pytest.raises(MeasurementError, match="line 3"):
        read_measurements(table(text.replace("60, 50", "60, 0")), "si")


@pytest.mark.parametrize("error", [ErrorModel(3e-7, 0.08), ErrorModel(2e-7), ErrorModel(0.0, 0.05)])
def test_the_parts_of_a_column_are_found(error):
    erosion = np.geomspace(1e-7, 1e-4, 20)
    found = ErrorModel.nearest(erosion, error.deviation(erosion))
    np.testing.assert_allclose([found.absolute, found.relative], [error.absolute, error.relative], atol=1e-12)


DEGREES = np.array([10.0, 10.0, 20.0, 40.0, 60.0, 75.0])
TRUE = impact("linearized", SI.replace(alpha=np.deg2rad(DEGREES))).volume
SHARES = 1 + 0.2 * np.array([1.5, -0.5, -1.2, 0.3, 1.0, -1.6])
"""Measured over true erosion; with ψ free alone, the fit with relative errors is the mean of them."""


@pytest.mark.parametrize("column", [True, False])
def test_a_relative_error_is_of_the_fit(column):
    """Of the measured erosion, the fit would be low by 2 b²: 9 % here."""
    columns = {"angle [deg]": DEGREES, "volume [m^3/impact]": TRUE * SHARES}
    more = {"uncertainty [%]": np.full(6, 20.0)} if column else {}
    fit = calibrate(
        FitProblem("linearized", SI, columns | more, ["psi"], error=None if column else ErrorModel(0.0, 0.2))
    )
    assert fit.estimates["psi"] == pytest.approx(SI.psi / SHARES.mean(), rel=1e-5)
    assert fit.chi2 == pytest.approx(np.sum((SHARES / SHARES.mean() - 1) ** 2) / 0.2**2, rel=1e-4)
    deviance = (
        fit.chi2 + 12 * np.log(SHARES.mean()) - 2 * np.log(np.prod(np.append(SHARES[2:], [SHARES[:2].mean()] * 2)))
    )
    assert fit.aicc == pytest.approx(deviance + 2 + 4 / 4, rel=1e-3)


@pytest.mark.parametrize("factor", [None, 1.7])
def test_the_likelihood_has_the_error_of_what_is_expected(factor):
    error = ErrorModel(2e-6 * INCH3, 0.1)
    columns = {"angle [deg]": DEGREES, "volume [m^3/impact]": TRUE * SHARES}
    priors = {} if factor is None else {"error_factor": stats.uniform(1.0, 1.0)}
    problem = FitProblem("linearized", SI, columns, ["psi"], priors=priors, error=error)
    likelihood = make_likelihood(problem)
    points = np.array([[0.02, 0.524][: 1 if factor is None else 2]])
    values = likelihood.values(points)
    expected = TRUE * float(SI.psi / values["psi"][0])
    squares, variance = likelihood.squares(points, 0)
    log = likelihood.constant - 0.5 * (squares / variance + 6 * np.log(variance))
    deviation = error.deviation(expected) * values.get("error_factor", np.ones(1))
    assert log[0] == pytest.approx(stats.norm.logpdf(TRUE * SHARES, expected, deviation).sum(), rel=1e-6)
    assert likelihood.chi2(points)[0] == pytest.approx(np.sum(((TRUE * SHARES - expected) / deviation) ** 2), rel=1e-5)


def test_a_model_without_erosion_at_a_row_has_an_error_there():
    parts = np.array([[0.0, 0.1], [3e-6, 0.1]])
    rows = read_measurements(
        {"angle [deg]": [20, 40], "volume [m^3/impact]": [8e-5, 8e-5]}, "si", error=ErrorModel(0, 0.1)
    )
    rows = dataclasses.replace(rows, parts=parts).weighed(np.zeros(2))
    np.testing.assert_allclose(rows.deviation, [4e-6, 5e-6])


@pytest.mark.parametrize("known", [True, False])
def test_repeats_show_what_a_model_misses(known):
    """The ratio is that of the analysis of variance, typed once more."""
    degrees, random = np.repeat([10.0, 20.0, 40.0, 60.0, 80.0], 3), np.random.default_rng(5)
    volume = INCH3 * (1e-4 * np.sin(np.deg2rad(degrees)) + 2e-6 * random.standard_normal(15))
    data = {"angle [deg]": degrees, "volume [m^3/impact]": volume}
    fit = calibrate(FitProblem("linearized", SI, data, ["k", "psi"], error=1e-6 * INCH3 if known else None))
    means = volume.reshape(5, 3).mean(axis=1)
    pure = np.sum((volume.reshape(5, 3) - means[:, None]) ** 2) / 10
    misses = 3 * np.sum((means - fit.fitted.reshape(5, 3)[:, 0]) ** 2) / 3
    lack = check(fit).lack_of_fit
    assert lack is not None
    assert lack.ratio == pytest.approx(misses / pure, rel=1e-9)
    assert lack.probability < 1e-3
    assert lack.scatter == pytest.approx(np.sqrt(pure) / (1e-6 * INCH3 if known else 1.0))
    assert "lack_of_fit" in str(fit)
    once = calibrate(FitProblem("linearized", SI, {n: v[::3] for n, v in data.items()}, ["psi"]))
    assert check(once).lack_of_fit is None


TWO_SPEEDS = float(SI.v0) * np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("column", [True, False])
def test_least_squares_know_what_rows_of_a_speed_share(column):
    """With ψ free alone the fit is generalized least squares of measured over true erosion, typed once more."""
    true = impact("linearized", SI.replace(alpha=np.deg2rad(DEGREES), v0=TWO_SPEEDS)).volume
    table = {"angle [deg]": DEGREES, "speed [m/s]": TWO_SPEEDS, "volume [m^3/impact]": true * SHARES}
    more = {"uncertainty [m^3]": 0.1 * true} if column else {}
    error = ErrorModel(common=0.3) if column else ErrorModel(relative=0.1, common=0.3)
    fit = calibrate(FitProblem("linearized", SI, table | more, ["psi"], error=error))
    factor = float(SI.psi / fit.estimates["psi"])
    shared = 0.3**2 * np.equal.outer(TWO_SPEEDS, TWO_SPEEDS)
    own = np.eye(6) * 0.1**2
    inverse = np.linalg.inv(own / factor**2 + shared) if column else np.linalg.inv(own + shared)
    weight = inverse.sum()
    # The common error is of the fit, as the relative one is.
    assert factor == pytest.approx(inverse.sum(axis=0) @ SHARES / weight, rel=1e-4)
    misses = SHARES / factor - 1
    assert fit.chi2 == pytest.approx(misses @ inverse @ misses, rel=1e-4)
    assert fit.standard_errors["psi"] / fit.estimates["psi"] == pytest.approx(weight**-0.5, rel=1e-3)


def test_a_common_error_needs_rows_of_one_speed_and_errors_of_their_own():
    table = {"angle [deg]": DEGREES, "speed [m/s]": TWO_SPEEDS, "volume [m^3/impact]": TRUE}
    apart = table | {"speed [m/s]": TWO_SPEEDS + 2.54 * np.arange(6)}
    with pytest.raises(MeasurementError, match="no two rows are of one speed"):
        read_measurements(apart, "inch-pound", error=ErrorModel(relative=0.1, common=0.05))
    with pytest.raises(MeasurementError, match="column of uncertainties"):
        read_measurements(dict(table) | {"uncertainty [%]": [8] * 6}, "inch-pound", error=ErrorModel(0, 0.1, 0.05))
    twice = {name: np.tile(values, 2) for name, values in dict(table).items()}
    with pytest.raises(MeasurementError, match="speeds are no groups"):
        read_measurements(
            twice | {"speed [m/s]": 76 * 1.018 ** np.arange(12)}, "inch-pound", error=ErrorModel(0, 0.1, 0.05)
        )
    with pytest.raises(ValueError, match="`loss` must be linear"):
        calibrate(FitProblem("linearized", SI, table, ["psi"], error=ErrorModel(0.0, 0.1, 0.05)), loss="soft_l1")
    few = {name: np.asarray(values)[[0, 1, 3]] for name, values in dict(table).items()}
    with pytest.raises(ValueError, match="1 free parameter and 2 errors of speeds"):
        calibrate(FitProblem("linearized", SI, few, ["psi"], error=ErrorModel(common=0.05)))


def test_speeds_that_were_measured_row_by_row_are_groups_and_an_error_of_them_stays():
    table = {
        "angle [deg]": DEGREES,
        "speed [m/s]": TWO_SPEEDS * [1, 1.01, 0.99, 1.005, 1, 0.99],
        "volume [m^3/impact]": TRUE,
    }
    rows = read_measurements(table, "inch-pound", error="5 % of each speed")
    assert rows.speeds is not None
    assert rows.speeds.tolist() == [0, 0, 0, 1, 1, 1]
    assert rows.with_error("8 %").error == ErrorModel(0.0, 0.08, 0.05)
    assert rows.with_error("8 %").of_rows(np.array([0, 4])).weighed(np.ones(2)).common == pytest.approx(0.05 / 0.08)


def of_two_speeds(count: int, own: float, *, factor: float = 1.0) -> dict[str, np.ndarray]:
    """Rows of ψ = 0.04 that are off by a share of each, and one more of them by a factor."""
    degrees, random = np.tile(np.linspace(12.0, 85.0, count), 2), np.random.default_rng(7)
    speeds = float(SI.v0) * np.repeat([0.5, 1.0], count)
    true = impact("linearized-deformation", SI.replace(alpha=np.deg2rad(degrees), v0=speeds)).volume
    volume = true * (1 + own * random.standard_normal(2 * count))
    volume[3] *= factor
    return {"angle [deg]": degrees, "speed [m/s]": speeds, "volume [m^3/impact]": volume}


@pytest.mark.parametrize("free", [["psi"], ["psi", "sigma"], ["psi", "sigma", "cutting_fraction"]])
def test_the_error_of_speeds_is_as_stated_however_many_parameters_are_tied(free):
    fit = calibrate(
        FitProblem("linearized-deformation", SI, of_two_speeds(3, 0.04), free, error="5 % of each speed"), starts=4
    )
    assert fit.data.common is not None
    share = fit.data.common * fit.data.deviation * np.sqrt(fit.variance) / fit.fitted
    np.testing.assert_allclose(share, 0.05, rtol=5e-3)


def test_a_part_that_matters_in_no_row_is_none():
    erosion = np.array([10e-6, 40e-6, 90e-6, 120e-6])
    assert ErrorModel.nearest(erosion, np.full(4, 0.2e-6) * (1 + 1e-12 * np.arange(4))).relative == 0
    assert ErrorModel.nearest(erosion, 0.08 * erosion).absolute == 0


@pytest.mark.parametrize(
    "row", ["20,98,1.5,new; dry", '20,98,1.5,"new; dry; a"', "20,98,1.5,A1\tnew", 'n.a.,98,n.a.,"a, b"']
)
@pytest.mark.parametrize(
    "heads", ["angle [deg],speed [m/s],mass_loss [mg/kg]", '"angle\n[deg]","speed\n[m/s]","mass_loss\n[mg/kg]"']
)
def test_a_row_with_words_is_no_header(table, heads, row):
    measured = read_measurements(table(f"{heads},remark\n{row}\n30,98,1.5,\n"), "si", ignore=["remark"])
    assert measured.angle[-1] == np.deg2rad(30)
