"""Bad case files: one sentence that names the file and the field.

Quantities as people type them: endless powers, endless digits, and units in the spelling of spreadsheets.
"""

import itertools
import math
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import erosion
import erosion.parameters.case_files
from erosion.explorer.state import PageCase, PageState
from erosion.laws import read_law
from erosion.parameters.quantities import Dimension, UnitError, check_system, has_unit, read_axis, read_quantity
from tests.bad_input.conftest import ALL_BYTES, CASE, unchecked_types
from tests.documents import Shell, Written
from tests.parameters.test_parameters import case_text

FIELDS = [
    (
        {"v0": '"4400 kg"'},
        "field `v0` must be a speed such as \"4400 in/s\", but is '4400 kg', of dimension [mass]",
    ),
    ({"sigma": '"200e3 lb/in^2"'}, "field `sigma` must be a stress"),
    ({"v0": '"fast"'}, "field `v0` must be a speed such as \"4400 in/s\", but 'fast' cannot be read"),
    ({"v0": '"44 00 in/s"'}, "field `v0` must be a speed"),
    ({"v0": '"4400 in/s²²"'}, "field `v0` must be"),
    ({"v0": '""'}, "field `v0` must be"),
    ({"k": '"2 deg"'}, "field `k` must be a pure number such as 2, but is '2 deg'"),
    ({"alpha": '"20 %"'}, "field `alpha` must be an angle"),
    ({"phidot0": '"500 Hz"'}, "field `phidot0` must be an angular speed such as \"1000 rad/s\", but is '500 Hz'"),
    ({"units": None, "v0": '"1e2"'}, "field `v0` is the bare number 1e2, but the file names no `units`"),
    ({"k": '"2 in"'}, "field `k` must be a pure number such as 2, but is '2 in', of dimension [length]"),
    ({"speed": "3"}, "field `speed` is unknown; the fields are"),
    ({"v0": None}, "field `v0` (impact speed) is missing"),
    ({"alpha": '"95 deg"'}, "field `alpha` must be in (0, 90°], but is 95°"),
    ({"alpha": "20"}, 'degrees are written "20 deg"'),
    ({"m": "-1.0"}, "field `m` must be positive and finite, but is -1"),
    ({"m": "nan"}, "field `m` must be positive and finite, but is nan"),
    ({"m": "inf"}, "field `m` must be positive and finite, but is inf"),
    ({"k": "[1, 2]"}, "field `k` must be a number or a quantity in quotes, but is [1, 2]"),
    ({"k": "true"}, "field `k` must be a number or a quantity in quotes, but is True"),
    ({"units": '"cgs"'}, "field `units` must be one of"),
    ({"units": "3"}, "field `units` must be text in quotes, but is 3"),
    ({"units": None, "v0": "4400"}, "field `v0` is the bare number 4400, but the file names no `units`"),
    ({"k": "2\nk = 3"}, "is not valid TOML"),
    ({"k": ""}, "is not valid TOML"),
    ({"k": "2\nk = 3\nk = 4"}, "is not valid TOML"),
    ({"k": "2,"}, "is not valid TOML"),
    ({"k": "0x"}, "is not valid TOML"),
    ({"k": "1979-05-27"}, "field `k` must be a number or a quantity in quotes, but is datetime.date(1979, 5, 27)"),
    ({"k": "{a = 1}"}, "field `k` must be a number or a quantity in quotes, but is {'a': 1}"),
    ({"k": "1" + 400 * "0"}, "field `k` must be positive and finite, but is inf"),
    ({"k": "0"}, "field `k` must be positive and finite, but is 0"),
    ({"r": '"0.04 in in"'}, "field `r` must be a length"),
    ({"r": '"0.04 furlongs per fortnight"'}, "field `r` must be a length"),
    ({"r": '"in"'}, "field `r` must be a length such as \"0.04 in\", but 'in' cannot be read"),
    ({"r": '"0.04 __class__"'}, "field `r` must be a length"),
    ({"r": '"1e999 in"'}, "field `r` must be positive and finite, but is inf"),
    ({"r": '"1e-999 in"'}, "field `r` must be positive and finite, but is 0"),
    ({"r": '"0.04 in**1e9"'}, "field `r` must be a length"),
    ({"v0": '"4400 in/s" # \x00'}, "is not valid TOML"),
    ({"alpha": '"0 deg"'}, "field `alpha` must be in (0, 90°], but is 0°"),
    ({"alpha": '"-20 deg"'}, "field `alpha` must be in (0, 90°], but is -20°"),
    ({"title": "3"}, "field `title` must be text in quotes, but is 3"),
    ({"Alpha": "1"}, "field `Alpha` is unknown; the fields are"),
    ({"sweep": "3"}, "field `sweep` is unknown"),
    ({"[k]\nk": "1"}, "is not valid TOML"),
]


@pytest.mark.parametrize(("changes", "message"), FIELDS)
def test_a_bad_case_gets_one_sentence_with_file_and_field(written, changes, message):
    file = written("mine.toml", case_text(**changes))
    with pytest.raises(erosion.CaseError) as caught:
        erosion.load_case(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "field `k` (force ratio) is missing."),
        (ALL_BYTES, "is not a text file in UTF-8."),
        (CASE.encode("utf-16"), "is not a text file in UTF-8."),
        (b"k = " + 5000 * b"[", "is nested too deeply."),
        (b"k = " + 5000 * b"1", "is not valid TOML: Exceeds the limit"),
        (b"%PDF-1.7", "is not valid TOML"),
    ],
)
def test_files_that_are_no_case(tmp_path, content, message):
    (tmp_path / "file.toml").write_bytes(content)
    with pytest.raises(erosion.CaseError) as caught:
        erosion.load_case(tmp_path / "file.toml")
    assert message in str(caught.value)


SECTIONS = [
    ("sweep", "speed = 3", ": field `speed` of [sweep] is unknown; they are model, paired"),
    ("sweep", "alpha = []", ": field `alpha` of [sweep] must hold values, but is empty."),
    ("sweep", "alpha = [0.1, [1]]", ": field `alpha` of [sweep] must be numbers or quantities in quotes"),
    ("sweep", "alpha = {a = 1}", ": field `alpha` of [sweep] must be numbers or quantities in quotes"),
    ("sweep", "alpha = true", ": field `alpha` of [sweep] must be numbers or quantities in quotes"),
    ("sweep", 'alpha = "1deg : 9 kg : 3"', ": field `alpha` of [sweep] must be an angle"),
    ("sweep", 'alpha = [0.1]\noptimum = "no"', ": field `optimum` of [sweep] must be true or false, but is 'no'."),
    ("sweep", 'alpha = [0.1]\nderivatives = "1"', ": field `derivatives` of [sweep] must be 0, 1 or 2, but is '1'."),
    (
        "sweep",
        'alpha = [0.1]\npaired = "alpha,k"',
        ": field `paired` of [sweep] must name two or more of the axes, but is ['alpha', 'k'].",
    ),
    ("sweep", "alpha = [0.1]\npaired = 3", ": field `paired` of [sweep] must be a list of axes, but is 3."),
    ("sweep", "alpha = [0.1]\nmodel = 3", "`--model` must be a model, its name or a path, but is 3."),
    ("sweep", 'alpha = [0.1]\nmodel = ["finnie", 3]', "`--model` must be a model, its name or a path, but is 3."),
    ("sweep", 'alpha = [0.1]\nwrt = ["k"]', ": field `wrt` of [sweep] must name a parameter"),
    ("sweep", "alpha = [0.1]\nset = 3", ": `set` of [sweep] must be a table such as {friction = 0.3}, but is 3."),
    ("sweep", "alpha = [0.1]\nset.f = 3", ": `set` of [sweep], field `f`, must name an own parameter of linearized"),
    ("stream", "speed = 3", ": field `speed` of [stream] is unknown; they are model, n"),
    ("stream", 'n = "x"', ": field `n` of [stream] must be a whole number such as 1e6, but is 'x'."),
    ("stream", "n = 1.5", ": field `n` of [stream] must be a whole number such as 1e6, but is 1.5."),
    ("stream", "n = true", ": field `n` of [stream] must be a whole number such as 1e6, but is True."),
    ("stream", "v0 = [1, 2]", ": field `v0` of [stream] must be a speed"),
    (
        "stream",
        'v0 = "normal(4400, 40)"\nseed = "x"',
        ": field `seed` of [stream] must be a whole number of at least 0, but is 'x'.",
    ),
    (
        "stream",
        'v0 = "normal(4400, 40)"\npoints = 3',
        ': field `points` of [stream] must be "sobol" or "random", but is 3.',
    ),
    ("stream", 'v0 = "normal(4400, 40)"\nset = 3', ": `set` of [stream] must be a table such as {friction = 0.3}"),
    (
        "stream",
        'v0 = "normal(4400, 40)"\nset.f = 3',
        ": `set` of [stream], field `f`, must name an own parameter of lin",
    ),
    ("stream", 'v0 = "normal(4400, 40)"\nmodel = 3', "`--model` must be a model, its name or a path, but is 3."),
]


@unchecked_types
@pytest.mark.parametrize(("verb", "lines", "message"), SECTIONS)
def test_bad_sections_are_one_line_and_exit_2(tmp_path, monkeypatch, shell, verb, lines, message):
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(f"{CASE}\n[{verb}]\n{lines}\n")
    said = shell([verb, "case.toml", "-o", "out.nc"], 2).err
    assert message in said
    assert said.count("\n") == 1
    assert not Path("out.nc").exists()


@pytest.mark.parametrize("title", [r"a\u0000b", r"\u001b[31mred", r"a\u0085b\u009b31m"])
def test_a_title_that_a_terminal_would_obey_is_refused(written, title):
    file = written("mine.toml", case_text(title=f'"{title}"'))
    with pytest.raises(erosion.CaseError, match="field `title` must have no control characters, but is "):
        erosion.parameters.case_files.CaseFile.read(file).title()


@pytest.mark.parametrize(
    ("title", "words"),
    [(r"a\n\tb", "a b"), ("   ", "mine"), ("", "mine"), ("😀 🏳️‍🌈 שלום $x_$", "😀 🏳️‍🌈 שלום $x_$")],
)
def test_a_title_is_one_line_and_never_blank(written, title, words):
    file = written("mine.toml", case_text(title=f'"{title}"'))
    assert erosion.parameters.case_files.CaseFile.read(file).title() == words


@pytest.fixture(autouse=True)
def soon() -> Iterator[None]:
    """Each of these is answered within a moment, not in hours."""

    def late(*_: Any) -> None:
        raise TimeoutError

    usual = signal.signal(signal.SIGALRM, late)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, usual)


POWERS = [
    "9**9**9**9", "9^9^9^9", "9²²²²", "9.0**9**9**9", "9**-9**9**9**9", "((((((9**9)**9)**9)**9)**9)**9)",
    "9**(9**9**9)", "9**((9))**9**9", "9**9e9", "9**(99*99*99*99)", "9**(9 9 9 9)", "9**(9)(9)(9)(9)", "9**(9+9e9)",
    "9**0x99999999", "9**999_999_999", "9**(9/(1/99999999))", "9**(1//(1/9e99))", "2**(8/3/.000000001)",
    "((s/s)**99)**99", "m**1000/m**1000", "9 squared**9**9**9",
]  # fmt: skip


@pytest.mark.parametrize("power", POWERS)
def test_a_power_that_would_never_end_is_refused(power: str) -> None:
    with pytest.raises(UnitError, match=r"^must be a speed such as \"110 m/s\", but .* cannot be read$"):
        read_quantity(f"1 m/s*{power}", "speed", "si")


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("1 kg*(m/s)^2/m^3", "stress", 1.0),
        ("1 m**(1/2)*m**(1/2)/s", "speed", 1.0),
        ("1 m**2.5/m**1.5", "length", 1.0),
        ("1 m*(m**2)**2/m^2", "volume", 1.0),
        ("3 m ** -1 * m ** 2", "length", 3.0),
        ("1 s^(-1)", "rate", 1.0),
        ("2 kg m²/s²/m³", "stress", 2.0),
    ],
)
def test_powers_that_people_write_are_read(text: str, dimension: Dimension, value: float) -> None:
    assert read_quantity(text, dimension, "si") == pytest.approx(value, rel=1e-14)


LONG = ["1" * 50_000 + "x", "1" * 50_000 + " m/s", "1." + "1" * 50_000 + "e", "1 " + "m" * 50_000, " " * 50_000 + "x",
        "1 " + "(" * 50_000, "1" + "e1" * 50_000, "1 m" + "/s*s" * 50_000, "+" * 50_000]  # fmt: skip


@pytest.mark.parametrize("text", LONG, ids=range(len(LONG)))
def test_a_long_text_is_refused_at_once_and_shown_in_short(text: str) -> None:
    assert not has_unit(text)
    with pytest.raises(UnitError, match=r"characters\) cannot be read$") as caught:
        read_quantity(text, "speed", "si")
    assert len(str(caught.value)) < 200


ENDLESS = ["1 m/s*9**9**9**9", "1" * 50_000 + "x"]


@pytest.mark.parametrize("text", ENDLESS, ids=("power", "digits"))
def test_every_door_refuses_them(text: str, written: Written, shell: Shell) -> None:
    file = written("case.toml", f'v0 = "{text}"\n')
    with pytest.raises(erosion.CaseError, match="v0"):
        erosion.load_case(file)
    with pytest.raises(erosion.MeasurementError):
        erosion.read_measurements({"angle [deg]": [1.0], f"volume [{text}]": [1.0]}, "si")
    with pytest.raises(ValueError, match="must be"):
        read_law(f"normal({text}, 2)", "v0", "speed", "si")
    state = PageState(PageCase.of(erosion.TABLE_1), ("linearized",), "linearized")
    with pytest.raises(ValueError, match="Field `v0`"):
        state.reading({"v0": text}, ["linearized"])
    for option in ("--v0", "--alpha-range"):
        verb = "run" if option == "--v0" else "optimum"
        said = shell([verb, option, text, *([text] if verb == "optimum" else [])], 2).err
        assert said.count("\n") == 1
        assert len(said) < 400


@pytest.mark.parametrize("head", [" " * 20_000 + "[", "angle" + " " * 20_000 + "]", "[" * 20_000])
def test_a_long_head_of_a_column_is_refused_at_once(head: str, written: Written) -> None:
    with pytest.raises(erosion.MeasurementError, match="has no column `angle") as caught:
        erosion.read_measurements({head: [1.0], "volume [mm^3/impact]": [1.0]}, "si")
    assert len(str(caught.value)) < 300
    file = written("jet.csv", f"{head}\n1\n")
    with pytest.raises(ValueError, match="must name a table with a column `v0`") as said:
        read_law(f"samples({file})", "v0", "speed", "si")
    assert len(str(said.value)) < 400


@pytest.mark.parametrize(
    ("text", "same", "dimension"),
    [
        ("3 m3", "3 m^3", "volume"),
        ("20 mm3/kg", "20 mm^3/kg", "volume per mass"),
        ("20 mm3/g", "20 mm^3/g", "volume per mass"),
        ("2700 kg/m3", "2.7 g/cm^3", "density"),
        ("1 lb/in3", "1 lb/in^3", "density"),
        ("1 N/mm2", "1 MPa", "stress"),
        ("1 lbf/in2", "1 psi", "stress"),
        ("3 in3", "3 inch**3", "volume"),
        ("1 µm3", "1 um^3", "volume"),
    ],
)
def test_powers_without_a_sign_are_understood(text: str, same: str, dimension: Dimension) -> None:
    for system in ("si", "inch-pound"):
        assert read_quantity(text, dimension, system) == pytest.approx(
            read_quantity(same, dimension, system), rel=1e-15
        )


@pytest.mark.parametrize(
    ("text", "dimension"),
    [
        ("1 rad3", "angle"), ("20 deg^2", "angle"), ("20 deg*rad", "angle"), ("1 1/rad", "angle"),
        ("1 deg/deg", "angle"),
        ("1 rad^2/s", "angular speed"), ("1 1/s/rad", "angular speed"), ("1 rpm*rad", "angular speed"),
        ("1 dB", "1"), ("50 percent", "1"), ("20 degC", "length"), ("1 mm", "angle"), ("1 m/s;import os", "speed"),
        ("1 __class__", "length"), ("1 m.__class__", "length"), ("1 lambda: 0", "length"), ("0x10 m/s", "speed"),
        ("1_000 m/s", "speed"), ("1,000 m/s", "speed"), ("1 000 m/s", "speed"), ("--5 m/s", "speed"),
        ("5 M/S", "speed"), ("1 \udcff", "speed"), ("1 m\0s", "speed"), ("1 m/s*nan", "speed"), ("1 m/s/0", "speed"),
        ("1 kg/m3 3", "density"),
        ("1 m/s + 1 m/s", "speed"), ("2 2", "angle"),
    ],
)  # fmt: skip
def test_what_another_program_might_take_for_a_quantity_is_refused(text: str, dimension: Dimension) -> None:
    with pytest.raises(UnitError, match=r"^must be a"):
        read_quantity(text, dimension, "si")


@pytest.mark.parametrize("text", ["1:inf:3", "nan:1:3", "1e999:2:3", "1:-inf:3:log"])
def test_ends_of_a_range_are_finite(text: str) -> None:
    with pytest.raises(UnitError, match="must have finite ends, but is"):
        read_axis(text, "speed", "si")


def test_unit_systems_are_understood_in_capitals(written: Written, shell: Shell) -> None:
    assert check_system("SI") == "si"
    assert check_system("Inch-Pound") == "inch-pound"
    assert erosion.TABLE_1.to("SI").shown_in == "si"
    file = written("case.toml", erosion.dump_case(erosion.TABLE_1.to("si")).replace('"si"', '"SI"'))
    assert erosion.load_case(file).shown_in == "si"
    assert shell("run --units SI --v0 '100 m/s' --json").document["units"] == "si"
    for name in ("metric", "s i", "", "SI" * 5000):
        with pytest.raises(ValueError, match="must be one of 'inch-pound', 'si'") as caught:
            check_system(name)
        assert len(str(caught.value)) < 200


@pytest.mark.parametrize("density", ["2700", "2.7", " 2700 ", "1e3"])
def test_a_bare_density_is_refused_with_the_right_spelling(density: str) -> None:
    data = {"angle [deg]": [10, 20, 30], "mass_loss [mg/impact]": [1.0, 2.0, 3.0]}
    with pytest.raises(ValueError, match=r"`density` must carry its unit, such as \"2.7 g/cm\^3\", but is"):
        erosion.calibrate(erosion.FitProblem("linearized", erosion.TABLE_1.to("si"), data, density=density, free=["k"]))


def test_a_section_that_is_no_table(written: Written, shell: Shell) -> None:
    file = written("case.toml", f"sweep = 3\n{CASE}")
    assert "`sweep` must be a table, but is 3" in shell(f"sweep {file} -o out.nc", 2).err


JETS = {
    "v0 [m/s],alpha [deg]\n100,20\n100,5,20\n": "line 3: has 3 cells",
    "v0 [m/s],alpha [deg]\n\n100,20\n100\n": "line 4: has 1 cells",
    "v0 [m/s]\n1_000\n": "line 2: column `v0 [m/s]` must be a number",
    "v0 [m/s]\n100 ft/s\n": "",
    "v0 [m/s]\n": "has no rows",
    "v0 [m/s],v0 [m/s]\n1,2\n": "gives `v0`, but so does",
    "v0\n1\n": "'v0' must have a unit",
    "v0 [kg]\n1\n": "must be that of a speed",
    'v0 [m/s]\n"100\n': "",
}


@pytest.mark.parametrize("text", JETS, ids=range(len(JETS)))
def test_a_table_of_samples_that_may_be_misread_is_refused(written: Written, text: str) -> None:
    file = written("jet.csv", text)
    with pytest.raises(ValueError, match="must ") as caught:
        read_law(f"samples({file})", "v0", "speed", "si")
    assert JETS[text] in str(caught.value)


def test_samples_of_angles_need_a_unit(tmp_path: Path) -> None:
    file = tmp_path / "jet.csv"
    for head, cell in itertools.product(("alpha", "alpha []"), ("30", "0.3")):
        file.write_text(f"{head}\n{cell}\n")
        with pytest.raises(ValueError, match=r"must have a unit, as `alpha \[deg\]`"):
            read_law(f"samples({file})", "alpha", "angle", "si")
    file.write_text("alpha [deg]\n180\n")
    law = read_law(f"samples({file})", "alpha", "angle", "si")
    assert law is not None
    assert law.cdf(math.pi) == 1
