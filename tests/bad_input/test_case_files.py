"""Bad case files: one sentence that names the file and the field."""

import pytest

import erosion
import erosion.parameters.case_files
from tests.bad_input.conftest import ALL_BYTES, CASE
from tests.bad_input.unchecked import without_type_checks
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
def test_a_bad_case_gets_one_sentence_with_file_and_field(tmp_path, changes, message):
    file = tmp_path / "mine.toml"
    file.write_text(case_text(**changes), encoding="utf-8")
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


def test_cases_that_cannot_be_opened(tmp_path):
    with pytest.raises(erosion.CaseError, match=r"nowhere.toml: cannot be read \(No such file"):
        erosion.load_case(tmp_path / "nowhere.toml")
    with pytest.raises(erosion.CaseError, match=r"cannot be read \(Is a directory"):
        erosion.load_case(tmp_path)


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


@pytest.fixture(scope="module")
def sections(tmp_path_factory):
    """What the command says of each section."""
    folder = tmp_path_factory.mktemp("sections")
    commands = []
    for i, (verb, lines, _) in enumerate(SECTIONS):
        (folder / f"case-{i}.toml").write_text(f"{CASE}\n[{verb}]\n{lines}\n")
        commands.append([verb, f"case-{i}.toml", "-o", "out.nc"])
    yield dict(zip(SECTIONS, without_type_checks("command", commands, folder), strict=True))
    assert not (folder / "out.nc").exists()


@pytest.mark.slow
@pytest.mark.parametrize("row", SECTIONS)
def test_bad_sections_are_one_line_and_exit_2(sections, row):
    status, out, err = sections[row]
    assert (status, out) == (2, "")
    assert row[2] in err
    assert err.count("\n") == 1


def test_a_section_that_is_no_table(tmp_path):
    (tmp_path / "case.toml").write_text(f"sweep = 3\n{CASE}")
    with pytest.raises(erosion.CaseError, match="`sweep` must be a table, but is 3"):
        erosion.parameters.case_files.CaseFile.read(tmp_path / "case.toml").section("sweep")


@pytest.mark.parametrize("title", [r"a\u0000b", r"\u001b[31mred", r"a\u0085b\u009b31m"])
def test_a_title_that_a_terminal_would_obey_is_refused(tmp_path, title):
    file = tmp_path / "mine.toml"
    file.write_text(case_text(title=f'"{title}"'), encoding="utf-8")
    with pytest.raises(erosion.CaseError, match="field `title` must have no control characters, but is "):
        erosion.parameters.case_files.CaseFile.read(file).title()


@pytest.mark.parametrize(
    ("title", "words"),
    [(r"a\n\tb", "a b"), ("   ", "mine"), ("", "mine"), ("😀 🏳️‍🌈 שלום $x_$", "😀 🏳️‍🌈 שלום $x_$")],
)
def test_a_title_is_one_line_and_never_blank(tmp_path, title, words):
    file = tmp_path / "mine.toml"
    file.write_text(case_text(title=f'"{title}"'), encoding="utf-8")
    assert erosion.parameters.case_files.CaseFile.read(file).title() == words
