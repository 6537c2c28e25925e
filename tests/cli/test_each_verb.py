"""What every verb keeps, and each once with the kinds of files that it reads and writes.

`make test-lowest` runs it on old libraries.
"""

import json
import re
import shlex
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from erosion.cli import app
from tests.cli.test_document import check
from tests.documents import Shell
from tests.explorer.conftest import served

ROOT = Path(__file__).parents[2]
CHANNEL = shlex.quote(str(ROOT / "tests" / "cfd" / "openfoam" / "serial"))
JET = "--particle 'garnet 0.3 mm' --target 'aluminium 6061' --v0 '100 m/s'"
FIT = "sand.csv --model linearized --density '2700 kg/m^3'"
DRAWN = f"posterior {FIT} --draws 125 -o draws.nc --plot-pairs pairs.svg"
PREDICTED = "predict draws.nc --alpha 20deg,40deg -o wear.csv --plot wear.svg"

COMMANDS = {
    "run --model rotating --plot run.png": "run.png",
    "optimum --model rotating --sensitivities --plot best.svg": "best.svg",
    "compare --model linearized,rotating -o a.nc --plot 'a.pdf@84mm,a.png'": "a.nc a.pdf a.png",
    "sweep --alpha 10deg:80deg:8 --k 1:3:3 -o sweep.csv": "sweep.csv",
    "sweep --alpha 10deg:80deg:8 --k 1:3:3 -o sweep.nc --plot sweep.svg": "sweep.nc sweep.svg",
    "sweep --alpha 10deg:80deg:8 --k 1:3:3 -o sweep.zarr": "sweep.zarr",
    "sweep --alpha 10deg:80deg:8 --workers 2 -o workers.zarr": "workers.zarr",
    "stream --n 512 --v0 'normal(9 m/s,1 m/s)' --alpha 'normal(20deg,2deg)' -o jet.nc --plot jet.svg": "jet.nc jet.svg",
    f"calibrate {FIT} --plot fit.svg --write-case fit.toml": "fit.svg fit.toml fit.nc",
    f"{DRAWN}; {PREDICTED}": "draws.nc pairs.svg wear.csv wear.svg",
    "map impacts.csv --surface plate.stl --surface-unit m -o map.vtp --plot map.png": "map.vtp map.png",
    "map impacts.parquet --surface plate.stl --surface-unit m -o map.nc": "map.nc",
    f"map {CHANNEL} --surface {CHANNEL} -o channel.csv": "channel.csv",
    f"export {JET} --openfoam e.of --fluent e.fl --table V.csv --restitution e.csv": "e.of e.fl V.csv e.csv",
    f"advise {JET} -o advice.html --plot advice.svg": "advice.html advice.svg",
    "report --only q2 -o report": "report/index.html",
    "exercise -o tasks.ipynb --solved solved.ipynb": "tasks.ipynb solved.ipynb",
    "models": "",
    "materials": "",
    "verify --model tan-alpha": "",
}
WITHOUT_DOCUMENT = ("report", "exercise")
NEEDS = {"map": ["impacts.csv"], "calibrate": ["sand.csv"], "posterior": ["sand.csv"], "predict": ["draws.nc"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measurements, impacts as CSV and Parquet, and a plate below them."""
    import pyarrow as pa
    import pyarrow.csv as pa_csv
    import pyarrow.parquet as pa_parquet

    place = tmp_path_factory.mktemp("verbs")
    angle = np.arange(5, 90, 5)
    rows = "".join(f"{a},{5 * np.sin(a / 30) ** 2 + 1:.4f},0.2\n" for a in angle)
    (place / "sand.csv").write_text("angle [deg],erosion [mm^3/kg],uncertainty [mm^3/kg]\n" + rows)
    rng = np.random.default_rng(0)
    steepness = rng.uniform(0.1, 1.4, 50)
    columns = {
        "x [m]": rng.uniform(size=50),
        "y [m]": rng.uniform(size=50),
        "z [m]": np.zeros(50),
        "u [m/s]": 30 * np.cos(steepness),
        "v [m/s]": np.zeros(50),
        "w [m/s]": -30 * np.sin(steepness),
        "diameter [um]": rng.uniform(100, 300, 50),
        "density [kg/m^3]": np.full(50, 2650.0),
        "count": np.full(50, 10.0),
    }
    table = pa.table(columns)
    pa_csv.write_csv(table, place / "impacts.csv")
    pa_parquet.write_table(table, place / "impacts.parquet")
    corners = ((0, 0), (1, 1), (1, 0)), ((0, 0), (0, 1), (1, 1))
    facets = ("".join(f"vertex {x} {y} 0\n" for x, y in three) for three in corners)
    text = "".join(f"facet normal 0 0 -1\nouter loop\n{three}endloop\nendfacet\n" for three in facets)
    (place / "plate.stl").write_text(f"solid plate\n{text}endsolid plate\n")
    return place


@pytest.mark.parametrize("command", COMMANDS)
def test_a_verb_runs(folder: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, command: str) -> None:
    monkeypatch.chdir(folder)
    for line in command.split("; "):
        verb, *words = shlex.split(line)
        printed = shell([verb, *words, *([] if verb in WITHOUT_DOCUMENT else ["--json"])])
        if verb not in WITHOUT_DOCUMENT:
            check(json.loads(printed.out))
    for name in COMMANDS[command].split():
        assert (folder / name).exists(), name
    assert not [*folder.rglob("*.part"), *folder.rglob("*.partial")]


@pytest.mark.parametrize("verb", [name for name in app if not name.startswith("-")])
def test_a_verb_describes_itself_and_names_an_unknown_option(verb: str, shell: Shell) -> None:
    assert f"erosion {verb}" in shell([verb, "--help"]).out
    assert "--no-such-option" in shell([verb, *NEEDS.get(verb, []), "--no-such-option"], 2).err


FILES = [
    (line, name)
    for command, names in COMMANDS.items()
    for line in command.split("; ")
    for name in names.split()
    if name in line and not line.startswith("predict")  # whose draws another command writes
]


@pytest.mark.usefixtures("no_computing")
@pytest.mark.parametrize(("line", "name"), FILES)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_computed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, line: str, name: str
) -> None:
    monkeypatch.chdir(folder)
    words = shlex.split(line.replace(name, f"nowhere/{name}"))
    assert f"nowhere/{name}: No such file or directory." in shell(words, 2).err


BARE = {
    "run": "--alpha 20",
    "optimum": "--alpha-range 10 60",
    "compare": "--v0 100",
    "sweep": "--sigma 1e3:2e3:4:log -o x.nc",
    "stream": "--v0 normal(100,5)",
    "calibrate": "sand.csv --free k,sigma --bounds sigma=1:3",
    "posterior": "sand.csv --free k,sigma --prior sigma=normal(1,0.1)",
    "map": "impacts.csv --limit 1",
    "export": "--table x.csv --speeds 30",
    "advise": "--uncertain sigma=normal(250,10)",
    "report": "--phidot0 1000",
    "exercise": "--r 1",
    "explore": "--m 1e-7",
}
"""By verb, a number without its unit; `predict` takes the units of its draws, the others no number with a unit."""


@pytest.mark.usefixtures("no_computing")
@pytest.mark.parametrize("verb", BARE)
def test_a_bare_number_is_refused_with_what_to_type(
    folder: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, verb: str
) -> None:
    monkeypatch.chdir(folder)
    said = shell([verb, *shlex.split(BARE[verb].replace("(", "'(").replace(")", ")'"))], 2).err
    option = next(word for word in BARE[verb].split() if word.startswith("--") and word not in ("--free", "--table"))
    assert re.search(rf"Option `{option}\b.*` must have a unit, such as {option} .*, or come with --units si", said)


@pytest.mark.usefixtures("no_computing")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["stream", "--v0", "normal(110 m/s, 10)"], "but has 10 in 'normal(110 m/s, 10)'."),
        (["stream", "--v0", "uniform(50, 100 m/s)"], "but has 50 in 'uniform(50, 100 m/s)'."),
        (["stream", "--v0", "lognormal(100, 0.1)"], "but has 100 in 'lognormal(100, 0.1)'."),
        (["stream", "--uncertain", "sigma=normal(1 GPa, 0.1)"], "but has 0.1 in 'normal(1 GPa, 0.1)'."),
        (
            ["posterior", "sand.csv", "--free", "k,sigma", "--prior", "sigma=uniform(1, 2 GPa)"],
            "but has 1 in 'uniform(",
        ),
    ],
)
def test_each_number_of_a_law_needs_a_unit(
    folder: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, words: list[str], said: str
) -> None:
    monkeypatch.chdir(folder)
    assert said in shell(words, 2).err


@pytest.mark.parametrize(
    ("command", "numbers"),
    [
        ("run", lambda result: [result["volume"], result["t_c"]]),
        ("optimum", lambda result: [result["volume"]]),
        ("compare --model linearized,finnie", lambda result: [one["volume"] for one in result["models"]]),
        ("sweep --alpha 10deg,20deg -o sweep.csv", lambda result: [result["volume_greatest"]]),
        ("stream --n 64 --no-best-angle --alpha 'normal(20deg,2deg)'", lambda result: [result["deviation"]]),
        ("map impacts.csv --surface plate.stl --surface-unit m", lambda result: [result["total_erosion_ratio"]]),
        (f"calibrate {FIT} --free k", lambda result: [result["chi2"]]),
    ],
)
def test_the_table_has_the_numbers_of_the_document(
    folder: Path, monkeypatch: pytest.MonkeyPatch, command: str, numbers: Any, shell: Shell
) -> None:
    monkeypatch.chdir(folder)
    table = shell(command).out.replace(".", "")
    for number in numbers(shell(f"{command} --json").result):
        assert f"{number:.4e}"[:5].replace(".", "") in table


def test_the_explorer_answers() -> None:
    with served() as (_, address), urllib.request.urlopen(address) as page:
        assert page.status == 200


def test_every_verb_is_here_and_on_the_page_of_documents() -> None:
    verbs = {name for name in app if not name.startswith("-")}
    assert {line.split()[0] for command in COMMANDS for line in command.split("; ")} | {"explore"} == verbs
    page = (ROOT / "docs" / "json.md").read_text("utf-8")
    rows = {verb for row in re.findall(r"^\| (`.*?) \|", page, re.M) for verb in re.findall(r"`([\w-]+)`", row)}
    assert verbs - {"explore", *WITHOUT_DOCUMENT} <= rows
