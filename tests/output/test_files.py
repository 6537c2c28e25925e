"""Files that are there completely or not at all; full disks are in `bad_input/test_surroundings.py`.

Results as tables: of one impact, of a batch, of nothing, and of what JAX is tracing.
"""

import dataclasses
import json
import math
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.output.files import require_writable, write_whole, written_whole
from erosion.output.tables import to_json, to_plain, with_error
from erosion.results import Result, Value
from tests.documents import Written


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_file_comes_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with written_whole(path) as draft:
        draft.write_bytes(b"half")
        assert not path.exists()
        assert draft.parent.parent == tmp_path
        draft.write_bytes(b"whole")
    assert contents(tmp_path) == {"out.txt": b"whole"}
    write_whole(path, memoryview(b"newer"))
    assert contents(tmp_path) == {"out.txt": b"newer"}


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_what_stops_halfway_leaves_the_older_file(tmp_path: Path, written: Written, error: type[BaseException]) -> None:
    path = written("out.txt", b"old")

    def stop() -> None:
        with written_whole(path) as draft:
            draft.write_bytes(b"half")
            raise error

    with pytest.raises(error):
        stop()
    assert contents(tmp_path) == {"out.txt": b"old"}


def test_a_folder_comes_whole_or_not_at_all(tmp_path: Path) -> None:
    def write(name: str, error: Exception | None = None) -> None:
        with written_whole(tmp_path / name) as draft:
            draft.mkdir()
            (draft / "index.html").touch()
            if error:
                raise error

    write("page")
    with pytest.raises(ValueError, match="stopped"):
        write("other", ValueError("stopped"))
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == ["page", "page/index.html"]


def test_whether_a_file_can_be_written_is_known_before(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    require_writable(path)
    assert contents(tmp_path) == {}
    path.write_bytes(b"old")
    require_writable(path)
    assert contents(tmp_path) == {"out.txt": b"old"}


@pytest.mark.parametrize("check", [require_writable, lambda path: write_whole(path, b"new")])
def test_what_is_no_file_is_not_replaced(tmp_path: Path, check) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name, error, message in (
        ("pipe", OSError, "Not a regular file"),
        ("folder", IsADirectoryError, "Is a directory"),
        ("missing/out.txt", FileNotFoundError, "No such file or directory"),
        ("n" * 300, OSError, "File name too long"),
    ):
        path = tmp_path / name
        with pytest.raises(error, match=message) as caught:
            check(path)
        assert caught.value.filename == str(path)
    assert (tmp_path / "pipe").is_fifo()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]


def test_a_link_is_written_through(tmp_path: Path) -> None:
    folder = tmp_path / "far"
    folder.mkdir()
    (folder / "real.txt").write_bytes(b"old")
    for link, target in (("one", folder / "real.txt"), ("two", tmp_path / "one"), ("dangling", folder / "new.txt")):
        (tmp_path / link).symlink_to(target)
    require_writable(tmp_path / "two")
    write_whole(tmp_path / "two", b"newer")
    write_whole(tmp_path / "dangling", b"new")
    assert contents(folder) == {"real.txt": b"newer", "new.txt": b"new"}
    assert all((tmp_path / link).is_symlink() for link in ("one", "two", "dangling"))


@pytest.mark.parametrize("check", [require_writable, lambda path: write_whole(path, b"new")])
def test_a_link_that_leads_nowhere_is_refused_by_its_name(tmp_path: Path, check) -> None:
    (tmp_path / "ring").symlink_to(tmp_path / "ring")
    (tmp_path / "lost").symlink_to(tmp_path / "missing" / "out.txt")
    (tmp_path / "folder").symlink_to(tmp_path)
    for name, message in (
        ("ring", "Too many levels of symbolic links"),
        ("lost", "No such file or directory"),
        ("folder", "Is a directory"),
    ):
        with pytest.raises(OSError, match=message) as caught:
            check(tmp_path / name)
        assert caught.value.filename == str(tmp_path / name)
        assert (tmp_path / name).is_symlink()


def test_a_file_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "private.txt"
    path.touch(mode=0o600)
    write_whole(path, b"secret")
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_file_that_may_not_be_written_is_not_replaced(written: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written("kept.txt", b"kept")
    # The tests may run as root, who may write everything.
    monkeypatch.setattr(os, "access", lambda file, mode: not (file == path and mode == os.W_OK))
    for check in (require_writable, lambda path: write_whole(path, b"new")):
        with pytest.raises(PermissionError) as caught:
            check(path)
        assert caught.value.filename == str(path)
    assert path.read_bytes() == b"kept"


def test_what_a_killed_writer_left_is_in_nobodys_way(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    left = tmp_path / ".out.txt.0123abcd.part"
    left.mkdir()
    (left / "out.txt").write_bytes(b"half")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert (left / "out.txt").read_bytes() == b"half"


def test_writers_of_one_file_do_not_disturb_each_other(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda i: write_whole(path, b"%d" % i), range(400)))
    assert [each.name for each in tmp_path.iterdir()] == ["out.txt"]


P = erosion.TABLE_1


def test_a_batch_of_impacts_is_a_table_of_ranges():
    hit = erosion.impact("linearized", P.replace(alpha=np.deg2rad([20.0, 60.0])), derivatives=2)
    lines = {line.split()[0]: line for line in str(hit).splitlines() if line}
    assert "[2] 0.863638 … 1.81644   10⁻⁴ in³" in lines["volume"]
    assert "1 rebound, 1 stop" in lines["ended_by"]
    assert "in³/°²" in lines["d2volume"]
    html = hit._repr_html_()
    assert html.count("<tr>") == 6
    assert "1 rebound, 1 stop" in html


@dataclasses.dataclass(frozen=True)
class Measured(Result):
    values: np.ndarray
    count: np.int64
    pairs: tuple[tuple[str, float], ...]

    @property
    def title(self) -> str:
        return "three <numbers>"

    @property
    def warnings(self) -> tuple[str, ...]:
        return ("1 < 2.",)

    def declare(self) -> list[Value]:
        return [
            Value("values", self.values),
            Value("count", self.count),
            Value("pairs", self.pairs, only="data"),
        ]


MEASURED = Measured(np.array([1.0, np.nan]), np.int64(3), (("a", np.float64(0.1)),))


def test_a_result_is_numbers_by_name():
    numbers = MEASURED.to_dict()
    assert numbers["pairs"] == [["a", 0.1]]
    assert (type(numbers["count"]), type(numbers["values"])) == (int, list)
    assert np.isnan(numbers["values"][1])
    # JSON has no NaN.
    assert json.loads(to_json(numbers))["values"] == [1.0, None]
    with pytest.raises(TypeError, match="object is not made of numbers and texts"):
        to_plain({"a": object()})


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (31.71746, 0.00011, "31.71746 ± 0.00011"),
        (31.71746, 0.4, "31.72 ± 0.40"),
        (1.7970592e-4, 8.4e-9, "0.0001797059 ± 0.0000000084"),
        (629.4428, 0.0, "629.443"),
        (1234.5, 110.0, "1230 ± 110"),
        (0.5, math.inf, "0.5 ± inf"),
        (2e9, 3.0, "2e+09 ± 3"),
    ],
)
def test_a_number_shows_the_digits_that_its_error_leaves(value, error, text) -> None:
    assert with_error(value, error) == text
