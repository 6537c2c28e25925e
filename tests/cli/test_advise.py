"""`erosion advise` as a shell runs it."""

import math
import re
import shlex

import pytest
import xarray as xr

import erosion
from erosion.advice.result import FIT
from erosion.cli import exit_status
from erosion.parameters.case_files import dump_case
from tests.cli.test_document import check

LINE = ["advise", "--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s", "--model", "finnie"]


def test_advise_reads_a_case_file_and_prints_a_document(shell, written):
    case = written(
        "case.toml", 'particle = "garnet 0.3 mm"\ntarget = "copper"\nk = 2\npsi = 2\nv0 = "80 m/s"\nalpha = "20 deg"\n'
    )
    document = shell(["advise", str(case), "--model", "finnie", "--target", "aluminium 6061", "--json"]).document
    check(document)
    result = document["result"]
    assert (result["particle"], result["target"], result["cutting_fraction"]) == (
        "garnet 0.3 mm",
        "aluminium 6061",
        0.5,
    )
    assert result["density"] == {"value": 2700.0, "unit": "kg/m^3"}
    assert result["curves"][0]["erosion_ratio"]["unit"] == "kg/kg"
    assert result["low"]["value"] < result["alpha"]["value"] < result["high"]["value"]


def test_the_speed_of_table_1_is_told_in_the_units_of_the_title(shell):
    printed = shell(["advise", "--model", "finnie"])
    assert " at 111.8 m/s: " in printed.out.splitlines()[0]
    assert "111.8 m/s of Table 1" in printed.err


ROWS = """angle [deg], speed [m/s], erosion [g/kg]
15,100,0.33
30,100,0.47
45,100,0.43
60,100,0.33
75,100,0.25
90,100,0.23
"""


def test_a_fit_goes_from_its_case_file_to_the_advice(shell, tmp_path):
    (tmp_path / "rows.csv").write_text(ROWS)
    materials = LINE[1:7]
    fit = ["calibrate", "rows.csv", *materials, "--model", "linearized-deformation", "--free", "k,psi,energy_ratio"]
    assert (
        "a nozzle's angle by this fit: erosion advise fitted.toml"
        in shell([*fit, "--write-case", "fitted.toml"]).out.splitlines()
    )
    printed = shell("advise fitted.toml --json")
    assert printed.err == ""
    result = printed.document["result"]
    assert (result["particle"], result["target"], result["uncertain"]) == (
        "garnet 0.3 mm", "aluminium 6061", "fitted.toml",
    )  # fmt: skip
    # The fit's amount at its angle is that of the rows, though Finnie's half is usual without a fit.
    assert result["cutting_fraction"] == 1
    assert result["curves"][0]["name"] == "linearized-deformation"
    assert result["curves"][0]["erosion_ratio"]["value"] == pytest.approx(0.47e-3, rel=0.1)
    assert result["worst_share"] > 0.9
    assert result["high"]["value"] - result["low"]["value"] < 0.3
    assert exit_status(["run", "fitted.toml"]) == 0


FITTED = """
units = "si"
particle = "garnet 0.3 mm"
target = "aluminium 6061"
v0 = 100
k = 1.3
psi = 20
alpha = "20 deg"

[advise]
model = "linearized-deformation"
set = { threshold = 5.0 }
uncertain = { k = "lognormal(1.3, 0.1)", sigma = "normal(1.0e9, 0.1e9)", energy_ratio = "normal(2, 0.2)" }
correlation = { "k,sigma" = -0.5 }
"""


HEAD, OF_FIT = FITTED[: FITTED.index("[advise]")], FITTED[: FITTED.index("set =")]
OF_DRAWS = f'model = "linearized"\n{FITTED[: FITTED.index("model =")]}[advise.uncertain]\npsi = [19, 20, 21]\n'
REFUSED = [
    # What would be left aside beside a fit.
    (FITTED, "--units inch-pound", "Option `--units` cannot convert the table [advise] of fitted.toml, which is in si"),
    (FITTED, "--k 3", "Option `--k` cannot set k, which has a law in fitted.toml."),
    (FITTED, "--target copper", "Option `--target` cannot set the metal, of which energy_ratio, k, sigma have laws in"),
    (FITTED, "--model rotating", "Option `--model` must be linearized-deformation, whose parameters have laws in"),
    (FITTED, "--set energy_ratio=3", "Option `--set` cannot set energy_ratio, which has a law in fitted.toml."),
    (FITTED, "--uncertain cutting_fraction=lognormal(0.99,0.2)", "must be positive and at most 1, but 48.0% of lognor"),
    (FITTED, "--cutting-fraction 0.5 --uncertain cutting_fraction=normal(0.3,0.03)", "cannot set cutting_fraction"),
    (OF_DRAWS, "--target copper", "of which psi have laws in fitted.toml."),
    (OF_DRAWS, "--model rotating", "--model` must be linearized, whose"),
    (OF_DRAWS, "--model all", "--model` must be linearized, whose"),
    # What was edited badly.
    *(
        (FITTED.replace("set =", f"{edit}\nset ="), "", f"fitted.toml: field {message}")
        for edit, message in [
            ("k = 3", "`k` of [advise] is unknown; they are model, set"),
            ("warning = 3", "`warning` of [advise] must be a sentence, but is 3."),
            (
                "reading = { prior = { k = 3 } }",
                "`reading` of [advise] must be a table of texts, but is {'prior': {'k': 3}}.",
            ),
            (
                'reading = { error = { k = "3 %" } }',
                "`reading` of [advise] must be a table of texts, but is {'error': {'k': '3 %'}}.",
            ),
            (
                'reading = { prior = "k=normal(2, 0.2)" }',
                "`reading` of [advise] must be a table of texts, but is {'prior': 'k=normal(2, 0.2)'}.",
            ),
            ('warning = " "', "`warning` of [advise] must be a sentence, but is ' '."),
            ('warning = "\\u001b[31mred"', "`warning` of [advise] must be a sentence, but is '\\x1b[31mred'."),
            ('warning = ["a", "b"]', "`warning` of [advise] must be a sentence, but is ['a', 'b']."),
        ]
    ),
    (FITTED.replace("linearized-deformation", 50_000 * "x"), "", "There is no model 'xxxxxxxxxxxxxxxxxxxx"),
    *(
        (f"{HEAD}[advise]\nuncertain = {laws}\n", "", f"fitted.toml: field `uncertain` of [advise]{message}")
        for laws, message in [
            ("{}", " must name a file or be a table of laws, but is {}."),
            ('{ alpha = "normal(20 deg, 2 deg)" }', " must name parameters of the metal"),
            ('{ k = "normal(-5, 0.1)" }', ": k must be positive, but 100.0% of"),
        ]
    ),
    *(
        (f"{OF_FIT}[advise.uncertain]\n{draws}\n", "", f"fitted.toml: field `uncertain` of [advise]{message}")
        for draws, message in [
            ("k = [1.3, 1.2]\npsi = [20]", " must be of one length, but lengths are k 2, psi 1."),
            ("k = [1.3, inf]", " must give k finite numbers, one or more, but does not."),
            ("k = []", " must give k finite numbers, one or more, but does not."),
            ("kk = [1, 2]", ": kk is not a parameter; they are k, psi"),
            ('k = [1.3, "2 m"]', " must be a table of laws, or of lists of numbers, but has k = [1.3, '2 m']."),
            ("k = [1.3, {}]", " must be a table of laws, or of lists of numbers, but has k = [1.3, {}]."),
            ("k = [true, false]", " must be a table of laws, or of lists of numbers, but has k = [True, False]."),
            ("k = [[1.3, 1.2]]", " must be a table of laws, or of lists of numbers, but has k = [[1.3, 1.2]]."),
            ("k = [-1.3, 2]", ": k must be positive, but 50.0% of"),
        ]
    ),
]


@pytest.mark.parametrize(("case", "options", "message"), REFUSED, ids=[f"{o} {m[:60]}" for _, o, m in REFUSED])
def test_a_fit_that_was_edited_badly_or_is_contradicted_is_refused(shell, written, case, options, message):
    written("fitted.toml", case)
    said = shell(f"advise fitted.toml {options}", 2).err.splitlines()[-1]
    assert message in said
    assert len(said) < 1000


def test_laws_need_a_model_that_takes_them(shell):
    words = ["--model", "oka:aluminium", "--uncertain", "cutting_fraction=normal(0.3, 0.03)"]
    assert "must have one that takes what is uncertain; a correlation does not." in shell([*LINE[:-2], *words], 2).err


def test_the_law_of_a_parameter_near_its_least_value_is_cut(shell, tmp_path):
    case, law = tmp_path / "fitted.toml", 'energy_ratio = "normal(2, 0.2)"'
    text = FITTED.replace("set = { threshold = 5.0 }", "")
    case.write_text(text.replace(law, 'threshold = "normal(5, 2.2)"'))
    assert "must be at least 0, but 1.2% of normal(5, 2.2) is not" in shell(["advise", str(case)], 2).err
    case.write_text(text.replace(law, 'threshold = "normal(5, 2.1)"'))
    assert shell(["advise", str(case), "--json"]).document["result"]["alpha"]["value"] > 0


# By E/CRC's correlation for angular grains with 8 % scatter: the best angle is 50°, and 94 % is removed at 35°.
FLAT = """angle [deg], mass_loss [mg/kg]
15, 1271
30, 1550
45, 1952
60, 2080
75, 1454
90, 1399
"""


def test_weighings_that_leave_parameters_open_still_decide_the_angle(shell, tmp_path, monkeypatch):
    rows = FLAT.replace("mass_loss [mg/kg]", 'Abtrag, sigma "x"').replace(", ", "\t").replace("\n", "\t1\t3\n")
    (tmp_path / "rows.csv").write_text(rows.replace('"x"\t1\t3', '"x"\tof, 3'))
    (tmp_path / "columns.toml").write_text('"angle [deg]" = "angle [deg]"\nAbtrag = "mass_loss [mg]"\n')
    metal = ["--particle", "garnet 80 mesh", "--target", "mild steel", "--v0", "160 m/s"]
    read = ["--columns", "columns.toml", "--ignore", '"of, 3",sigma "x"', "--sep", "tab"]
    of_tests = ["--per", "1 kg", *read, "--error", "9 mg/kg + 5 %"]
    bounds = ["--bounds", "psi=0.01:100"]
    shell(["calibrate", "rows.csv", *of_tests, *metal, *bounds, *FIT.split()[3:-1], "fitted.toml"])
    prior = ["--prior", "psi=loguniform(0.01, 100)"]
    result = shell("advise fitted.toml --json").result
    angle = math.degrees(result["alpha"])
    assert 38 < angle < 65
    assert result["uncertain"] == "fitted.toml"
    assert f"{angle:.0f}°" in result["statements"][0]
    assert printed_command(result["statements"])[:14] == ["rows.csv", "fitted.toml", *of_tests, *prior]
    # The draws know it, too, from wherever they are read.
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    by_draws = shell(["advise", *metal, "--uncertain", "../fitted.nc", "--json"]).result["statements"]
    command = printed_command(by_draws)
    assert command[0].endswith("rows.csv")
    assert command[command.index("--per") :][:12] == [
        word.replace("columns.t", "../columns.t") for word in (*of_tests, *prior)
    ]


def printed_command(statements):
    """The words after `erosion posterior` of the command that an advice prints."""
    return shlex.split(re.findall("“erosion posterior (.*?)”", " ".join(statements))[0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("fitted.toml --v0 160m/s",
         ["tests.csv", "fitted.toml", "--per", "100 g", "--columns", "a=deg", "--free", "k,psi"]),
        ("--v0 160m/s --model linearized --uncertain cutting_fraction=uniform(0.3,0.5)",
         ["rows.csv", "--v0", "160m/s", "--model", "linearized", "--free", "cutting_fraction"]),
        ("--v0 9m/s --model linearized-deformation --set energy_ratio=1.6 --cutting-fraction 0.4 "
         "--uncertain k=normal(2,0.1)",
         ["rows.csv", "--v0", "9m/s", "--cutting-fraction", "0.4", "--model", "linearized-deformation",
          "--set", "energy_ratio=1.6", "--free", "k"]),
    ],
)  # fmt: skip
def test_the_printed_command_is_of_the_tests(shell, tmp_path, options, words):
    text = FITTED[: FITTED.index("[advise]")] + 'model = "linearized"\n[advise]\ndata = "tests.csv"\n'
    text += 'reading = { per = "100 g", columns = "a=deg" }\n'
    (tmp_path / "fitted.toml").write_text(f"{text}[advise.uncertain]\nk = [1.3, 1.4]\npsi = [20, 19]\n")
    result = shell(["advise", *options.split(), "--json"]).result
    command = printed_command(result["statements"])
    assert [word.replace(str(tmp_path) + "/", "") for word in command] == [*words, "--next-test"]


def test_no_command_leaves_a_prior_aside(shell, tmp_path):
    text = FITTED[: FITTED.index("[advise]")] + '[advise]\nmodel = "linearized"\nreading = { prior = { psi = "" } }\n'
    (tmp_path / "fitted.toml").write_text(f"{text}[advise.uncertain]\nk = [1.3, 1.4]\npsi = [20, 19]\n")
    (narrowing,) = re.findall(
        "What would narrow it: more.*", "\n".join(shell("advise fitted.toml --json").result["statements"])
    )
    assert "`erosion.next_test`" in narrowing
    assert "erosion posterior" not in narrowing


def test_an_advice_by_draws_prints_the_tests_and_their_doubts(shell, tmp_path):
    case = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("copper").replace(v0=100.0, alpha=0.3)
    tested = 'tested = { v0 = ["100 m/s", "100 m/s"] }\n'
    (tmp_path / "fitted.toml").write_text(
        dump_case(case.replace(v0=160.0)) + f'particle = "garnet 0.3 mm"\ntarget = "copper"\n[advise]\n{tested}'
    )
    attributes = {"inference_library": "erosion", "unit_system": "si", "case": dump_case(case), "model": "linearized",
                  "cutting_fraction": 0.8, "data_file": "tests/my rows.csv",
                  "tested": '{"v0": [100.0, 100.0]}'}  # fmt: skip
    columns = {name: ("draw", values, {"units": "1"}) for name, values in {"k": [1.9, 2.1], "psi": [2.1, 1.9]}.items()}
    xr.Dataset(columns, attrs=attributes).to_netcdf("post.nc", group="posterior", engine="h5netcdf")
    names = ["--particle", "garnet 0.3 mm", "--target", "copper"]
    printed = shell(["advise", *names, "--v0", "160 m/s", "--uncertain", "post.nc", "-o", "a.html", "--json"])
    assert printed_command(printed.result["statements"]) == [
        "tests/my rows.csv", *names, "--v0", "100 m/s", "--cutting-fraction", "0.8", "--model", "linearized",
        "--free", "k,psi", "--next-test",
    ]  # fmt: skip
    doubt = "160 m/s is 1.6 × the fastest test."
    assert (tmp_path / "a.html").read_text().count(f"post.nc: {doubt}") == printed.err.count(doubt) == 1
    both = shell("advise fitted.toml --uncertain post.nc -o a.html")
    assert (tmp_path / "a.html").read_text().count(doubt) == both.err.count(doubt) == 1
