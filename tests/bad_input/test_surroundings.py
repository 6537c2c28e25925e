"""What surrounds a command goes wrong: full disks, readers that leave, Ctrl-C, single precision."""

import contextlib
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import write_map
from erosion.impacts.dataset_files import write_netcdf
from erosion.output.files import write_whole
from erosion.plotting.style import save_plot
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import ZarrStore
from tests.cfd.tables import hump, sand


def write_vtp(path):
    pytest.importorskip("pyvista")
    surface = hump()
    write_map(erosion_map("linearized", erosion.TABLE_1.to("si"), sand(surface, 20), surface), path)


CONTENT = np.random.default_rng(1).random(10_000)


@contextlib.contextmanager
def full_disk():
    """Writing stops after a hundred bytes of a file, here by the system's limit, in earnest by a full disk."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, usual[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


WRITERS = {
    "text": lambda path: write_whole(path, CONTENT.tobytes()),
    "fit.svg": lambda path: save_plot(Figure(), path),
    "fit.png": lambda path: save_plot(Figure(), path),
    "fit.pdf": lambda path: save_plot(Figure(), path),
    "map.vtp": write_vtp,
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


@pytest.mark.slow
def test_a_reader_that_leaves_is_no_error():
    for arguments in (["models"], ["models", "--json"], ["run", "--help"], ["--help"]):
        reader, writer = os.pipe()
        os.close(reader)
        found = subprocess.run([*COMMAND, *arguments], stdout=writer, stderr=subprocess.PIPE, timeout=120, check=False)
        os.close(writer)
        assert (found.returncode, found.stderr) == (0, b"")


@pytest.mark.slow
def test_an_output_that_is_full_is_one_line():
    with open("/dev/full", "w") as full:  # noqa: PTH123 (a device)
        found = subprocess.run([*COMMAND, "models"], stdout=full, stderr=subprocess.PIPE, timeout=120, check=False)
        assert found.returncode == 1
        assert found.stderr == b"erosion: The output cannot be written: No space left on device.\n"
        # Where nothing can be said, the status still tells.
        found = subprocess.run([*COMMAND, "run", "--alpha", "0"], stderr=full, timeout=120, check=False)
        assert found.returncode == 2


@pytest.mark.slow
def test_progress_and_warnings_need_no_place(tmp_path):
    command = f"{shlex.join(COMMAND)} report --only q7 -o {shlex.quote(str(tmp_path / 'report'))} 2>&-"
    assert subprocess.run(["sh", "-c", command], stdout=subprocess.PIPE, timeout=120, check=False).returncode == 0


@pytest.mark.slow
def test_a_closed_output_is_no_error():
    command = f"{shlex.join(COMMAND)} models >&-"
    found = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, timeout=120, check=False)
    assert (found.returncode, found.stderr) == (0, b"")


# Ctrl-C, or a batch system's signal, comes in whatever the command is doing then; the work would take hours.
INTERRUPTED = {
    "sweep": ["--alpha", "1deg:90deg:10000", "--v0", "10 m/s:900 m/s:3000", "-o", "out.nc"],
    "stream": ["--v0", "normal(4400, 40)", "--n", "1e11", "-o", "out.nc"],
    "calibrate": ["sand.csv", "--model", "all", "--starts", "1000000"],
    "report": ["--output", "page"],
}
PRESS = """
import os, signal, sys, threading
from erosion.cli import main
timer = threading.Timer(3, os.kill, (os.getpid(), getattr(signal, sys.argv[1])))
timer.daemon = True
timer.start()
main(sys.argv[2:])
"""


@pytest.fixture
def heeds_ctrl_c():
    """What a shell starts in the background ignores it, and so does all that it starts."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.slow
@pytest.mark.usefixtures("heeds_ctrl_c")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_ctrl_c_is_one_line_and_leaves_nothing_half_written(tmp_path, name):
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
            assert process.returncode == 130, (verb, said)
            assert said.startswith("erosion: interrupted"), (verb, said)
            assert said.count("\n") == 1, (verb, said)
            assert not list((tmp_path / verb).rglob("*.part"))
            assert not (tmp_path / verb / "page" / "index.html").exists()
            if (tmp_path / verb / "out.nc").exists():
                xr.load_dataset(tmp_path / verb / "out.nc", engine="h5netcdf")


def in_a_destructor(_):
    """JAX collects garbage in a callback of Python's, which swallows what is raised in it."""

    class Swallows:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    thing = Swallows()
    del thing


def in_a_bare_except(monkeypatch):
    """JAX has one that every trace runs through."""
    from jax import lax

    def press(*_):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("jax._src.lax.lax._broadcast_shapes_cached", press)
    assert lax.broadcast_shapes((2, 1), (3,)) == (2, 3)


@pytest.mark.usefixtures("heeds_ctrl_c")
@pytest.mark.parametrize("lose", [in_a_destructor, in_a_bare_except])
def test_an_interrupt_that_a_library_swallows_comes_again(monkeypatch, shell, lose):
    def path(*_):
        lose(monkeypatch)
        for _ in range(100):  # an interrupt of Python's own does not end a sleep
            time.sleep(0.1)
        return "never comes here"

    monkeypatch.setattr("erosion.impacts.simulate.path", path)
    assert shell("run", 130).err == "erosion: interrupted\n"


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_one_ctrl_c_does_not_interrupt_what_it_ends(monkeypatch, shell):
    cleaned = []

    def path(*_):
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            with contextlib.suppress(ValueError):
                for _ in range(10):
                    time.sleep(0.05)
                raise ValueError
            cleaned.append(True)

    monkeypatch.setattr("erosion.impacts.simulate.path", path)
    assert shell("run", 130).err == "erosion: interrupted\n"
    assert cleaned


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


def test_a_shells_own_pipe_is_read(tmp_path):
    case = Path(__file__).parents[2] / "cases" / "table-1.toml"
    command = f"{shlex.join(COMMAND)} run <(cat {shlex.quote(str(case))})"
    assert subprocess.run(["bash", "-c", command], capture_output=True, timeout=240, check=False).returncode == 0


def test_too_little_memory_is_one_sentence(monkeypatch, shell):
    def too_large(*_, **__):
        raise MemoryError("Unable to allocate 58.2 TiB")

    monkeypatch.setattr("erosion.cli.app", too_large)
    assert shell("run", 1).err == "erosion: There is not enough memory for this.\n"
