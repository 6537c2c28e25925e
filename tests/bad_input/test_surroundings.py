"""What surrounds a command goes wrong: full disks, readers that leave, Ctrl-C, single precision.

Processes that lack something: float64, a device, their threads, letters, a cache of their own; and masked arrays.
"""

import contextlib
import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pint
import pytest
import xarray as xr
from matplotlib.figure import Figure

import erosion
from erosion import erosion_map, read_measurements
from erosion.cfd.map_files import MAP_FORMATS, write_map
from erosion.impacts.dataset_files import write_netcdf
from erosion.laws import JointSamples, Samples
from erosion.output.files import write_whole
from erosion.plotting.style import save_plot
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import ZarrStore
from tests.cfd.tables import hump, sand
from tests.documents import Shell


def write_a_map(path):
    pytest.importorskip("pyvista")
    surface = hump()
    write_map(erosion_map("linearized", erosion.TABLE_1.to("si"), sand(surface, 20), surface), path)


CONTENT = np.random.default_rng(1).random(10_000)


@contextlib.contextmanager
def full_disk():
    """Writing stops after a hundred bytes of a file, here by the system's limit, in earnest by a full disk."""
    usual, writes_bytecode = resource.getrlimit(resource.RLIMIT_FSIZE), not sys.dont_write_bytecode
    # Python keeps what it could write of a module's bytecode, and no later process could import the module.
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        sys.dont_write_bytecode = not writes_bytecode


WRITERS = {
    "text": lambda path: write_whole(path, CONTENT.tobytes()),
    "fit.svg": lambda path: save_plot(Figure(), path),
    "fit.png": lambda path: save_plot(Figure(), path),
    "fit.pdf": lambda path: save_plot(Figure(), path),
    **{f"map{ending}": write_a_map for ending in MAP_FORMATS},
    "out.nc": lambda path: write_netcdf(xr.Dataset({"v": ("n", CONTENT)}), path, {}),
}


@pytest.mark.parametrize("there", [True, False], ids=["over an older file", "new"])
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_what_was_there(tmp_path, name, there, capfd, caplog):
    path = tmp_path / name
    if there:
        path.write_text("old")
    with full_disk(), pytest.raises(OSError, match="File too large") as caught:
        WRITERS[name](path)
    assert caught.value.filename == str(path)
    assert [one.read_text() for one in tmp_path.iterdir()] == (["old"] if there else [])
    assert (capfd.readouterr().err, caplog.text) == ("", "")


def test_a_block_that_could_not_be_written_is_computed_again(tmp_path):
    grid = make_grid("linearized", erosion.TABLE_1, {"alpha": np.linspace(0.1, 1, len(CONTENT))})
    store = ZarrStore(grid, grid.shape, tmp_path / "out.zarr")
    codes = np.ones(len(CONTENT), np.int8)
    (region,) = store.missing()
    with full_disk(), pytest.raises(OSError, match="File too large") as caught:
        store.write(region, {"volume": CONTENT, "t_c": CONTENT, "ended_by": codes})
    assert caught.value.filename == str(tmp_path / "out.zarr")
    assert store.missing() == [region]
    store.write(region, {"volume": CONTENT, "t_c": CONTENT, "ended_by": codes})
    assert store.missing() == []
    np.testing.assert_array_equal(store.dataset().volume, CONTENT)


COMMAND = [sys.executable, "-m", "erosion"]


@pytest.mark.parametrize(
    ("line", "status", "errors"),
    [
        # A reader that leaves is no error.
        ("set -o pipefail; {} models | true", 0, ""),
        ("{} models >/dev/full", 1, "erosion: The output cannot be written: No space left on device.\n"),
        # Where nothing can be said, the status still tells.
        ("{} run --alpha 0 2>/dev/full", 2, ""),
        # Progress and warnings need no place, nor does the output.
        ("{} sweep --alpha 10deg:80deg:3 -o out.csv 2>&- >&-", 0, ""),
        # A shell's own pipe.
        ("{} run <(cat case.toml)", 0, ""),
    ],
)  # fmt: skip
def test_streams_that_a_shell_connects(tmp_path, line, status, errors):
    (tmp_path / "case.toml").write_text(erosion.dump_case(erosion.TABLE_1))
    command = ["bash", "-c", line.format(shlex.join(COMMAND))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False)
    assert (done.returncode, done.stderr) == (status, errors)


# Ctrl-C, or a batch system's signal, comes in whatever the command is doing then; the work would take hours. Sweeps and
# streams keep what they have.
INTERRUPTED = {
    "sweep": ["--alpha", "1deg:90deg:10000", "--v0", "10 m/s:900 m/s:3000", "-o", "out.nc"],
    "stream": ["--v0", "normal(110 m/s, 1 m/s)", "--n", "1e11", "-o", "out.nc"],
    "calibrate": ["sand.csv", "--model", "all", "--starts", "1000000"],
    "report": ["--output", "page"],
}
PRESS = """
import os, signal, sys, threading
from erosion.__main__ import main
timer = threading.Timer(3, os.kill, (os.getpid(), getattr(signal, sys.argv[1])))
timer.daemon = True
timer.start()
sys.argv[1:] = sys.argv[2:]
main()
"""


@pytest.fixture
def heeds_ctrl_c():
    """What a shell starts in the background ignores it, and so does all that it starts."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.usefixtures("heeds_ctrl_c")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_ctrl_c_leaves_nothing_half_written(tmp_path, name):
    with contextlib.ExitStack() as stack:
        running = {}
        for verb, arguments in INTERRUPTED.items():
            folder = tmp_path / verb
            folder.mkdir()
            (folder / "sand.csv").write_text("angle [deg], erosion [-]\n" + "".join(f"{i},{i}\n" for i in range(1, 90)))
            command = [sys.executable, "-c", PRESS, name, verb, *arguments]
            process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True)
            running[verb] = stack.enter_context(process)
            stack.callback(process.kill)
        for verb, process in running.items():
            _, said = process.communicate(timeout=240)
            goes_on = process.returncode == 130 and "out.nc" in INTERRUPTED[verb]
            assert goes_on or process.returncode == -getattr(signal, name), (verb, said)
            assert said.count("erosion: stops after this block") == said.count("erosion: interrupted") == goes_on, said
            assert not list((tmp_path / verb).rglob("*.part"))
            assert not (tmp_path / verb / "page" / "index.html").exists()
            if (tmp_path / verb / "out.nc").exists():
                xr.load_dataset(tmp_path / verb / "out.nc", engine="h5netcdf")


def test_bad_settings_of_libraries_are_named(tmp_path, shell, monkeypatch):
    (tmp_path / "matplotlibrc").write_bytes(b"\xff\xfe")
    command = [*COMMAND, "optimum", "--plot", "x.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 2
    assert "matplotlibrc" in done.stderr
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "noon")
    assert "SOURCE_DATE_EPOCH must be whole seconds, but is 'noon'" in shell("run", 2).err


def test_messages_hold_nothing_that_a_terminal_obeys_and_no_endless_word(tmp_path, shell):
    (tmp_path / "case.toml").write_text('"\\u001b[31mred\\u202e" = 3\n')
    assert r"field `\x1b[31mred\u202e` is unknown" in shell(f"run {tmp_path / 'case.toml'}", 2).err
    (tmp_path / "case.toml").write_text("a" * 100_000 + " = 3\n")
    assert len(shell(f"run {tmp_path / 'case.toml'}", 2).err) < 1000


P = erosion.TABLE_1


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, which ends even if it waits for ever."""
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(code), *arguments],
        env={**os.environ, **environment}, capture_output=True, text=True, encoding="utf-8", errors="replace",
        timeout=120, check=False,
    )  # fmt: skip


def test_every_way_to_a_number_refuses_single_precision() -> None:
    done = python(
        """
        import erosion
        p, closed = erosion.TABLE_1, erosion.models.Linearized().closed_form()
        for compute in (lambda: erosion.alpha_max("linearized", p), lambda: erosion.alpha_min("linearized", p),
                        lambda: erosion.impact("linearized", p), lambda: erosion.simulate("linearized", p),
                        lambda: erosion.sweep("linearized", p, alpha=[0.2]), lambda: closed.volume(p),
                        lambda: closed.alpha_max(p), lambda: erosion.correlations.CORRELATIONS["oka"](0.3),
                        lambda: erosion.volume("linearized", p), lambda: erosion.verify("linearized")):
            try:
                print(compute())
            except RuntimeError as error:
                assert "erosion needs float64" in str(error), error
                print("refused")
        """,
        JAX_ENABLE_X64="0",
    )
    assert done.stdout == "refused\n" * 10, done.stdout + done.stderr


FORKED = """
import os, signal
import numpy as np
import erosion
p = erosion.TABLE_1.replace(alpha=np.linspace(0.1, 1, 200_000))
def status_of_a_fork(then):
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # it would wait for ever
        try:
            then()
            os._exit(0)
        except RuntimeError as error:
            os._exit(7 if 'get_context("spawn")' in str(error) else 8)
    status = os.waitpid(child, 0)[1]
    return os.WTERMSIG(status), os.WEXITSTATUS(status)
ways = {
    "impact": lambda: erosion.impact("rotating", p).volume,
    "closed form": lambda: erosion.models.Linearized().closed_form().volume(p),
    "simulate": lambda: erosion.simulate("finnie", erosion.TABLE_1),
}
"""


@pytest.mark.parametrize(
    ("first", "then", "statuses"),
    [
        # The package's own compiler needs no thread that a fork lacks.
        (["impact"], ["impact", "simulate"], [0, 0]),
        (["closed form"], ["closed form", "simulate"], [7, 7]),
    ],
)
def test_a_forked_process_computes_or_says_why_not(first: list[str], then: list[str], statuses: list[int]) -> None:
    done = python(f"{FORKED}\nfor way in {first}: ways[way]()\nfor way in {then}: print(*status_of_a_fork(ways[way]))")
    assert done.stdout == "".join(f"0 {status}\n" for status in statuses), done.stderr


# One process obeys several command lines: to import JAX for each takes a second.
COMMANDS = """
import json, sys
from erosion.cli import main
from tests.documents import Shell
for arguments in json.loads(sys.argv[1]):
    try:
        main(arguments)
    except SystemExit as ended:
        print("status", ended.code, file=sys.stderr)
"""


def commands(*lines: list[str], **environment: str) -> tuple[list[tuple[int, str]], str]:
    """Status and errors of each command line, and all that they print."""
    done = python(COMMANDS, json.dumps(lines), **environment)
    ended = re.findall(r"(.*?)status (\d+)\n", done.stderr, flags=re.DOTALL)
    return [(int(status), errors) for errors, status in ended], done.stdout


@pytest.mark.parametrize("platform", ["cuda,nonsense"])
def test_a_device_that_is_not_there_is_a_sentence(platform: str, tmp_path: Path) -> None:
    ended, _ = commands(
        ["verify", "--model", "linearized"],
        ["run"],  # the engine's own compiler needs none
        JAX_PLATFORMS=platform,
    )  # fmt: skip
    sentence = (
        f"erosion: JAX has no device to compute on, as JAX_PLATFORMS={platform} asks for one that is not here; "
        "unset it.\n"
    )
    assert ended == [(1, sentence), (0, "")]


def test_a_home_that_cannot_be_written_is_no_warning(tmp_path: Path) -> None:
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), "/dev/null")
    ended, _ = commands(
        ["run", "--plot", str(tmp_path / "cut.svg")], ["verify", "--model", "linearized"],
        MPLCONFIGDIR="", **nowhere,
    )  # fmt: skip
    assert ended == [(0, ""), (0, "")]


ASCII = {
    "PYTHONIOENCODING": {"PYTHONIOENCODING": "ascii"},
    "LANG": {"LANG": "C", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
}


@pytest.mark.parametrize("environment", ASCII)
def test_a_terminal_without_greek_letters_gets_words(environment: str) -> None:
    (*shown, refused), said = commands(["run"], ["run", "--help"], ["run", "--alpha", "100 deg"], **ASCII[environment])
    assert shown == [(0, "")] * 2
    assert refused[0] == 2
    assert refused[1].startswith("erosion: Option `--alpha`")
    if environment == "PYTHONIOENCODING":
        assert said.isascii()
        assert "alpha = 20deg" in said
        assert "in^3" in said
        assert "10^-4 in^3" in said
        assert "\\" not in said


@pytest.mark.parametrize(
    "words",
    [
        "run {}",
        "run --plot {}",
        "run --plot={}",
        "run --model {}",
        "optimum --model {}",
        "compare -o {}",
        "sweep --alpha 1deg:80deg:3 -o {}",
        "stream --alpha samples({}) -o {}",
        "calibrate {} --write-case fit.toml",
        "calibrate sand.csv --write-case {}",
        "map {} --surface plate.stl",
        "map impacts.csv --surface {}",
        "export --table {}",
        "advise -o {}",
        "report -o {}",
        "exercise {} -o tasks.ipynb",
        "models --path {}",
        "materials {}",
        "explore --materials {}",
    ],
)
def test_a_name_that_is_no_text_is_refused_by_every_verb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"caf\xe9.csv")
    Path(name).write_text("angle [deg], erosion [-]\n20,1\n")
    printed = shell([word.format(name) for word in words.split()], 2)
    assert printed.out == ""
    assert "caf\\xe9.csv" in printed.err
    assert "UTF-8" in printed.err
    assert printed.err.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_folder_whose_name_is_no_text_is_a_place_to_work_in(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    command = [sys.executable, "-m", "erosion", "run", "--json", "--plot", "cut.svg"]
    done = subprocess.run(command, cwd=folder, capture_output=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (folder / "cut.svg").is_file()


def test_any_width_of_a_terminal_shows_every_word() -> None:
    def letters(columns: str) -> list[str]:
        command, environment = [sys.executable, "-m", "erosion", "run", "--help"], {**os.environ, "COLUMNS": columns}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True)
        return sorted(letter for letter in done.stdout if letter.isalnum())

    assert letters("1") == letters("²") == letters("120")


MASKED = np.ma.masked_array([0.1, 0.2, 0.3], mask=[False, True, False])
DATA = {"angle [deg]": [10.0, 20.0, 30.0], "volume [in^3/impact]": [1e-4, 2e-4, 2e-4]}
FRICTION = Path(__file__).parents[2] / "models" / "coulomb_tip.py"
IGNORES: dict[str, Callable[[], Any]] = {
    "a parameter": lambda: P.replace(alpha=MASKED),
    "an axis": lambda: erosion.sweep("linearized", P, alpha=MASKED),
    "samples": lambda: Samples(MASKED),
    "measurements": lambda: erosion.calibrate(
        erosion.FitProblem("linearized", P, {**DATA, "angle [deg]": MASKED}, ["k"])
    ),
    "an own parameter": lambda: erosion.load_model(FRICTION).replace(friction=MASKED),
    "an angle of a comparison": lambda: erosion.compare(["linearized"], P, alpha=MASKED),
}


@pytest.mark.parametrize("name", IGNORES)
def test_a_masked_value_is_no_value(name: str) -> None:
    with pytest.raises(ValueError, match="must have no masked values; leave them out, or fill them with NaN"):
        IGNORES[name]()


QUANTITY: Any = pint.UnitRegistry().Quantity
NO_NUMBERS = [
    np.array([0.1 + 1j, 0.2]), np.array([1, 2], "m8[s]"), ["0.1", "0_2"], [True, False], QUANTITY([1.0, 2.0], "km"),
    [QUANTITY(1.0, "km"), QUANTITY(2.0, "km")], xr.DataArray(QUANTITY([1.0, 2.0], "km"), dims="x"),
]  # fmt: skip
TAKES: dict[str, Callable[[Any], Any]] = {
    "an axis": lambda values: erosion.sweep("linearized", P, alpha=values),
    "samples": Samples,
    "rows": lambda values: JointSamples({"alpha": values}),
    "measurements": lambda values: read_measurements(
        {"angle [deg]": [10.0, 20.0], "volume [in^3/impact]": values}, "si"
    ),
}


@pytest.mark.parametrize("name", TAKES)
def test_nothing_is_made_a_number_by_leaving_a_part_of_it_away(name: str) -> None:
    for values in NO_NUMBERS:
        with pytest.raises(ValueError, match=r"must (hold real numbers without|have a) units?"):
            TAKES[name](values)


def _in_degrees(*values: float) -> xr.DataArray:
    return xr.DataArray([*values], dims="x", attrs={"units": "deg"})


def test_the_unit_that_labels_say_counts_or_is_refused() -> None:
    bare = erosion.sweep("linearized", P, alpha=np.deg2rad([1.0, 1.2]))
    np.testing.assert_array_equal(erosion.sweep("linearized", P, alpha=_in_degrees(1.0, 1.2)).volume, bare.volume)
    np.testing.assert_array_equal(erosion.sweep("linearized", P, alpha=bare.alpha).volume, bare.volume)
    with pytest.raises(ValueError, match="`alpha` must be an angle such as"):
        erosion.sweep("linearized", P, alpha=_in_degrees(1.0).assign_attrs(units="m"))
    for make in (Samples, lambda values: JointSamples({"alpha": values}), lambda values: Samples([*values])):
        with pytest.raises(ValueError, match="must hold numbers without units, but is in 'deg'"):
            make(_in_degrees(1.0, 1.2))


def test_the_unit_of_labelled_measurements_is_that_of_their_head() -> None:
    rows = {"angle": _in_degrees(10.0, 20.0), "volume [in^3/impact]": [1e-5, 2e-5]}
    np.testing.assert_array_equal(read_measurements(rows, "si").angle, np.deg2rad([10.0, 20.0]))
    rows = {"angle [deg]": rows["angle"], "volume [in^3/impact]": rows["angle"]}
    with pytest.raises(ValueError, match=r"'volume \[in\^3/impact\]': the unit must be .*'deg'"):
        read_measurements(rows, "si")


def test_a_masked_array_without_masked_values_is_an_array() -> None:
    values = np.ma.masked_array([0.1, 0.2])
    np.testing.assert_array_equal(
        erosion.impact("linearized", P.replace(alpha=values)).volume,
        erosion.impact("linearized", P.replace(alpha=[0.1, 0.2])).volume,
    )
