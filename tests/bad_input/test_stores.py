"""Stores that are damaged, moved, replaced or watched while they are written: no wrong number, and nothing is lost."""

import functools
import itertools
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
import erosion.streams.stream
from erosion.impacts.dataset_files import StoreError
from erosion.output.files import claimed
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import SweepInterrupted, ZarrStore, sweep
from tests.sweeps.test_sweep import assert_same_bits

P = erosion.TABLE_1
AXES: dict[str, Any] = {"alpha": np.linspace(0.1, 1.0, 6), "phidot0": [0.0, 100.0]}
CHUNKS = {"alpha": 3}


@functools.cache
def whole() -> xr.Dataset:
    """The grid, computed at once."""
    return sweep("linearized", P, **AXES)


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the grid is a block."""
    monkeypatch.setattr("erosion.sweeps.sweep._MEMORY_BLOCK", 6)
    monkeypatch.setattr("erosion.sweeps.sweep._LEAST_BLOCK", 6)


def zarr(path: Path, **more: Any) -> xr.Dataset:
    return sweep("linearized", P, store=path, chunks=CHUNKS, **AXES, **more)


def flip(file: Path, at: int = 20) -> None:
    content = bytearray(file.read_bytes())
    content[at % len(content)] ^= 4
    file.write_bytes(bytes(content))


DAMAGES: dict[str, Callable[[Path], object]] = {
    "deleted": lambda file: file.unlink(),
    "empty": lambda file: file.write_bytes(b""),
    "cut short": lambda file: file.write_bytes(file.read_bytes()[:-5]),
    "longer": lambda file: file.write_bytes(file.read_bytes() + b"\0"),
    "flipped": flip,
    "flipped at the end": lambda file: flip(file, -1),
    "zeros": lambda file: file.write_bytes(bytes(file.stat().st_size)),
    "a folder": lambda file: (file.unlink(), file.mkdir()),
}


@pytest.mark.parametrize("array", ["volume", "ended_by"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_chunk_that_is_lost_or_damaged_is_computed_again(tmp_path: Path, damage: str, array: str) -> None:
    path = tmp_path / "out.zarr"
    zarr(path)
    file = path / array / "c" / "1" / "0"
    DAMAGES[damage](file)
    if file.is_dir():
        with pytest.raises(OSError, match="c/1/0"):
            zarr(path)
        return
    done = []
    again = zarr(path, progress=lambda work, count, total: done.append(count))
    assert done == [6, 12]
    assert_same_bits(again.compute(), whole())


def test_a_block_of_nan_is_not_computed_for_ever(tmp_path: Path) -> None:
    grid = make_grid("linearized", P, AXES)
    store = ZarrStore(grid, (3, 2), tmp_path / "out.zarr")
    first, second = store.missing()
    nan, codes = np.full((3, 2), np.nan), np.full((3, 2), 4, np.int8)
    store.write(first, {"volume": nan, "t_c": nan, "ended_by": codes})
    assert store.missing() == [second]


def test_the_best_angles_are_watched_too(tmp_path: Path) -> None:
    path = tmp_path / "out.zarr"
    whole = sweep("linearized", P, optimum=True, **AXES)
    zarr(path, optimum=True)
    (path / "alpha_max" / "c" / "0").unlink()
    again = zarr(path, optimum=True)
    assert_same_bits(again.compute(), whole)


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("alpha/c/0", "deleted", "its array `alpha` is damaged"),
        ("alpha/c/0", "flipped", "its array `alpha` is damaged"),
        ("phidot0/c/0", "empty", "its array `phidot0` is damaged"),
        ("volume/zarr.json", "deleted", "its array `volume` cannot be read"),
        ("volume/zarr.json", "empty", "its array `volume` cannot be read"),
        ("volume/zarr.json", "zeros", "its array `volume` cannot be read"),
        ("ended_by/zarr.json", "cut short", "its array `ended_by` cannot be read"),
        ("zarr.json", "deleted", "no Zarr group"),
        ("zarr.json", "empty", "no Zarr group"),
        ("zarr.json", "zeros", "no Zarr group"),
    ],
)
def test_a_store_without_its_frame_is_refused_by_name(tmp_path: Path, file: str, damage: str, message: str) -> None:
    path = tmp_path / "out.zarr"
    zarr(path)
    DAMAGES[damage](path / file)
    before = sorted(path.rglob("*"))
    with pytest.raises(StoreError, match=r"^.*/out\.zarr: .* left as it is\.$") as caught:
        zarr(path)
    assert message in str(caught.value)
    assert sorted(path.rglob("*")) == before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"float64"', '"float32"'),
        ("[\n    6,\n    2\n  ]", "[\n    4,\n    2\n  ]"),
        ("3,\n        2", "2,\n        2"),
        ('"alpha"', '"blpha"'),
    ],
)
def test_an_array_of_another_kind_is_refused(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "out.zarr"
    zarr(path)
    file = path / "volume" / "zarr.json"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(StoreError, match="its array `volume` is damaged"):
        zarr(path)


def netcdf(path: Path, **more: Any) -> xr.Dataset:
    return sweep("linearized", P, store=path, **AXES, **more)


def test_half_of_the_grid_under_the_right_identity_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "out.nc"
    netcdf(path)
    whole = xr.load_dataset(path, engine="h5netcdf")
    for changed in (whole.isel(alpha=slice(0, 3)), whole.drop_vars("t_c"), whole.transpose("phidot0", "alpha"),
                    whole.assign(volume=whole.volume * 2), whole.assign_coords(alpha=whole.alpha + 1e-9)):  # fmt: skip
        changed.to_netcdf(path, engine="h5netcdf")
        with pytest.raises(StoreError, match=r"out\.nc: is damaged, or was changed after it was written; it is left"):
            netcdf(path)


def test_no_flipped_byte_of_a_netcdf_file_is_a_wrong_number(tmp_path: Path) -> None:
    """Of its numbers; HDF5 never returns from some that are flipped in what it keeps beside them."""
    path = tmp_path / "out.nc"
    netcdf(path)
    content = path.read_bytes()
    with h5py.File(path) as file:
        arrays = [each.id for each in file.values() if isinstance(each, h5py.Dataset) and each.chunks]
        chunks = [array.get_chunk_info(i) for array in arrays for i in range(array.get_num_chunks())]
    assert len(chunks) >= len(whole().data_vars)
    for chunk in chunks:
        for at in range(chunk.byte_offset, chunk.byte_offset + chunk.size, 41):
            path.write_bytes(content)
            flip(path, at)
            with pytest.raises(StoreError) as caught:
                netcdf(path)
            assert str(caught.value).startswith(f"{path}: ")


def test_a_stream_of_a_changed_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "jet.nc"

    def run() -> Any:
        return erosion.stream("linearized", P, n=64, best_angle=False, alpha=stats.norm(0.3, 0.02), store=path)

    run()
    run()
    dataset = xr.load_dataset(path, engine="h5netcdf")
    dataset.attrs["drawn"] = dataset.attrs["drawn"] * 2
    dataset.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(StoreError, match="was changed after it was written"):
        run()


def stop(error: type[BaseException], after: int) -> Callable[[str, int, int], None]:
    calls = itertools.count()

    def progress(work: str, done: int, total: int) -> None:
        if next(calls) == after:
            raise error("stopped")

    return progress


@pytest.mark.parametrize("error", [ValueError, MemoryError, SystemExit, GeneratorExit])
def test_an_error_of_any_kind_leaves_what_was_computed(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "out.nc"
    with pytest.raises(error, match="stopped"):
        netcdf(path, progress=stop(error, 1))
    done = []
    assert_same_bits(netcdf(path, progress=lambda work, count, total: done.append(count)), whole())
    assert done == [6, 12]


@pytest.fixture
def pressed_while_written(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Ctrl-C comes when half of the file is written."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    write = Path.write_bytes

    def half_way(path: Path, content: Any) -> int:
        write(path, bytes(content)[: len(content) // 2])
        if not pressed:
            pressed.append(path)
            os.kill(os.getpid(), signal.SIGINT)
        return write(path, content)

    pressed: list[Path] = []
    monkeypatch.setattr(Path, "write_bytes", half_way)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.usefixtures("pressed_while_written")
def test_ctrl_c_waits_until_a_finished_sweep_is_written(tmp_path: Path) -> None:
    path = tmp_path / "out.nc"
    with pytest.raises(SweepInterrupted, match="holds 12 of 12 impacts"):
        netcdf(path)
    done = []
    assert_same_bits(netcdf(path, progress=lambda work, count, total: done.append(count)), whole())
    assert done == [12]


def test_an_error_after_its_particles_leaves_a_streams_tally(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise ArithmeticError("no angle")

    monkeypatch.setattr(erosion.streams.stream, "best_nozzle_angle", fails)
    path = tmp_path / "jet.nc"
    with pytest.raises(ArithmeticError, match="no angle"):
        erosion.stream("linearized", P, n=64, alpha=stats.norm(0.3, 0.02), store=path)
    assert int(xr.load_dataset(path, engine="h5netcdf").attrs["drawn"]) == 4


def test_a_result_that_comes_meanwhile_is_left(tmp_path: Path) -> None:
    path = tmp_path / "out.nc"
    (tmp_path / "out-2.nc").write_text("taken as well")

    def arrive(work: str, done: int, total: int) -> None:
        path.write_text("another result")

    with pytest.raises(
        RuntimeError, match=r"out\.nc: another result has come there meanwhile, .* is in .*/out-3\.nc\."
    ):
        netcdf(path, progress=arrive)
    assert path.read_text() == "another result"
    (tmp_path / "out-3.nc").rename(path)
    assert_same_bits(netcdf(path), whole())


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_whether_a_partial_store_can_be_written_is_known_before(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"out.{suffix}"
    make = netcdf if suffix == "nc" else zarr
    with pytest.raises(SweepInterrupted):
        make(path, progress=stop(KeyboardInterrupt, 1))

    def refuse(self: Path, **_: Any) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    with monkeypatch.context() as patch:
        # As in a folder that may only be read; the tests may run as root, who may write anywhere.
        patch.setattr(Path, "touch", refuse)
        patch.setattr("erosion.sweeps.grid.impact", lambda *_, **__: pytest.fail("computed before"))
        with pytest.raises(PermissionError, match="Permission denied"):
            make(path)
    assert_same_bits(make(path).compute(), whole())
    with monkeypatch.context() as patch:
        patch.setattr(Path, "touch", refuse)
        assert_same_bits(make(path).compute(), whole())  # nothing to write


def test_a_pipe_or_a_device_is_no_store(tmp_path: Path) -> None:
    for suffix in ("nc", "zarr"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
        (tmp_path / f"full.{suffix}").symlink_to("/dev/full")
        (tmp_path / f"ring.{suffix}").symlink_to(f"ring.{suffix}")
        for name in ("pipe", "full"):
            with pytest.raises(StoreError, match=r"is there already and is no (netCDF file|Zarr group)"):
                sweep("linearized", P, store=tmp_path / f"{name}.{suffix}", **AXES)
        with pytest.raises(OSError, match="Too many levels of symbolic links"):
            sweep("linearized", P, store=tmp_path / f"ring.{suffix}", **AXES)
    with pytest.raises(StoreError, match="is no netCDF file"):
        erosion.stream("linearized", P, n=64, alpha=stats.norm(0.3, 0.02), store=tmp_path / "pipe.nc")


def test_a_zarr_store_behind_a_link_is_written_there(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "out.zarr").symlink_to(tmp_path / "far" / "real.zarr")
    assert_same_bits(zarr(tmp_path / "out.zarr").compute(), whole())
    assert_same_bits(zarr(tmp_path / "out.zarr").compute(), whole())
    assert (tmp_path / "out.zarr").is_symlink()
    assert [file.name for file in (tmp_path / "far").iterdir()] == ["real.zarr"]


@pytest.mark.parametrize("theirs", ["linearized", "finnie"])
def test_a_zarr_store_that_another_process_makes_at_the_same_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, theirs: str
) -> None:
    path = tmp_path / "out.zarr"

    def checked(_: Path) -> None:
        monkeypatch.undo()
        monkeypatch.setattr("erosion.sweeps.sweep._LEAST_BLOCK", 6)
        ZarrStore(make_grid(theirs, P, AXES), (3, 2), path)

    monkeypatch.setattr("erosion.sweeps.sweep.require_writable", checked)
    if theirs == "linearized":
        assert_same_bits(zarr(path).compute(), whole())
    else:
        with pytest.raises(StoreError, match="holds another result"):
            zarr(path)
    assert [file.name for file in tmp_path.iterdir()] == ["out.zarr"]


# The program ends where a file is to get its name, for the third time in a folder of that kind.
KILLED = """
import os, signal, sys
from pathlib import Path
import erosion
from erosion.sweeps import sweep
from tests.bad_input.test_stores import KEPT
from tests.documents import Shell
sweep._MEMORY_BLOCK = sweep._LEAST_BLOCK = 6
usual, kind, count = Path.replace, sys.argv[2], 0
def replace(draft, target):
    global count
    count += kind in str(draft)
    if count == (3 if kind == "/c/" else 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return usual(draft, target)
Path.replace = replace
KEPT[sys.argv[3]](Path(sys.argv[1]))
"""
KEPT: dict[str, Callable[[Path], xr.Dataset]] = {
    "zarr": zarr,
    "stream": lambda path: erosion.stream(
        "linearized", P, n=256, best_angle=False, store=path, alpha=stats.norm(0.3, 0.1)
    ).to_dataset(),
}


@pytest.mark.parametrize(
    ("name", "kind", "draft"),
    [
        ("zarr", "/c/", "out.zarr/*/c/*/*.partial"),
        ("stream", ".part/out.nc", ".out.nc.*.part/out.nc"),
    ],
)
def test_a_killed_program_leaves_nothing_that_the_next_one_takes(
    tmp_path: Path, name: str, kind: str, draft: str
) -> None:
    path = tmp_path / ("out.zarr" if name == "zarr" else "out.nc")
    whole = KEPT[name](tmp_path / f"whole{path.suffix}").compute()
    killed = subprocess.run([sys.executable, "-c", KILLED, path, kind, name], timeout=120, check=False)
    assert killed.returncode == -signal.SIGKILL
    (left,) = tmp_path.glob(draft)
    if kind == "/c/":
        with claimed(path):  # as while another process writes
            KEPT[name](path)
        assert left.is_file()
    xr.testing.assert_equal(KEPT[name](path).compute(), whole)
    assert left.exists() == (kind != "/c/")
    assert sorted(tmp_path.glob("[!.]*")) == [path, tmp_path / f"whole{path.suffix}"]


@pytest.mark.filterwarnings("ignore:Object at .* is not recognized")  # zarr's, of the files beside the arrays
def test_files_that_someone_keeps_in_a_store_stay(tmp_path: Path) -> None:
    path = tmp_path / "out.zarr"
    whole = zarr(path).compute()
    drafts = [
        path / "volume" / "c" / "0" / f"0.{uuid.uuid4().hex}.partial",
        path / "ended_by" / f"c.{uuid.uuid4().hex}.partial",
    ]
    own = [
        path / "notes.partial",
        path / f"0.{uuid.uuid4().hex}.partial",
        path / "mine" / f"0.{uuid.uuid4().hex}.partial",
        path / "volume" / "sheet.partial",
        path / "volume" / "c" / f"0.{'0' * 32}.partial",
        path / "volume" / "c" / f"first.{uuid.uuid4().hex}.partial",
    ]
    for file in drafts + own:
        file.parent.mkdir(exist_ok=True)
        file.write_text("text")
    xr.testing.assert_equal(zarr(path).compute(), whole)
    assert [file for file in drafts + own if file.exists()] == own
