"""Files that are there completely or not at all; full disks are in `bad_input/test_surroundings.py`."""

import os
from pathlib import Path

import pytest

from erosion.files import require_writable, write_whole, written_whole


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_file_comes_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with written_whole(path) as draft:
        draft.write_bytes(b"half")
        assert not path.exists()
        assert draft.parent == tmp_path
        draft.write_bytes(b"whole")
    assert contents(tmp_path) == {"out.txt": b"whole"}
    write_whole(path, memoryview(b"newer"))
    assert contents(tmp_path) == {"out.txt": b"newer"}


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_what_stops_halfway_leaves_the_older_file(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "out.txt"
    path.write_bytes(b"old")

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
