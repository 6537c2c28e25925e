"""Machine code on disk: found again, and never anyone else's."""

import errno
import os
import stat
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from erosion.lanes import machine
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.machine import llvm


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache" / "lanes"
    monkeypatch.setattr(machine, "_place", lambda: place)
    return place


def _compiled(factor):
    return Lanewise(lambda x: factor * x + 1.0, (number,))


def test_code_is_made_once(folder, monkeypatch):
    assert _compiled(3.0)(np.arange(3.0)).tolist() == [1.0, 4.0, 7.0]
    assert len(list(folder.iterdir())) == 1
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(llvm, "parse_assembly", _only_the_empty_module(llvm.parse_assembly))
    assert _compiled(3.0)(np.arange(3.0)).tolist() == [1.0, 4.0, 7.0]
    with pytest.raises(AssertionError):
        _compiled(5.0)


def test_code_made_with_care_is_found_first(folder):
    one = _compiled(3.0)
    one._code._cost = 0.0
    assert [one(np.arange(3.0)).tolist() for _ in range(2)] == [[1.0, 4.0, 7.0]] * 2
    assert [each._code._code.level for each in (one, _compiled(3.0))] == [machine._CAREFUL] * 2


def _only_the_empty_module(parse):
    def parse_empty(text):
        assert text == ""
        return parse(text)

    return parse_empty


@pytest.mark.parametrize("damage", [lambda code: code[:-1] + b"x", lambda code: b"", lambda code: code[:20]])
def test_a_damaged_file_is_replaced(folder, damage):
    _compiled(3.0)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert _compiled(3.0)(np.arange(3.0)).tolist() == [1.0, 4.0, 7.0]
    assert file.read_bytes() == whole


def test_a_file_under_another_name_does_not_count(folder):
    _compiled(3.0)
    (file,) = folder.iterdir()
    other = machine.key_of("other")
    file.rename(folder / other)
    assert machine.read_kept(other) is None


def test_a_folder_that_others_may_write_is_not_used(folder):
    folder.mkdir(parents=True)
    folder.chmod(0o770)
    assert _compiled(3.0)(np.arange(3.0)).tolist() == [1.0, 4.0, 7.0]
    assert list(folder.iterdir()) == []


def test_a_link_is_not_followed(folder, tmp_path):
    target = tmp_path / "elsewhere"
    target.mkdir(mode=0o700)
    folder.parent.mkdir()
    folder.symlink_to(target)
    _compiled(3.0)
    assert list(target.iterdir()) == []


def test_where_nothing_can_be_written_code_is_made(folder):
    folder.parent.write_text("a file where the folder would be")
    assert _compiled(3.0)(np.arange(3.0)).tolist() == [1.0, 4.0, 7.0]


def test_the_longest_unused_go_first(folder, monkeypatch):
    monkeypatch.setattr(machine, "_KEPT_FILES", 2)
    for age, name in ((30, "a"), (20, "b")):
        machine.write_kept(machine.key_of(name), b"code")
        os.utime(folder / machine.key_of(name), (1e9 - age, 1e9 - age))
    assert machine.read_kept(machine.key_of("a")) == b"code"
    (folder / "note").touch()
    os.utime(folder / "note", (0, 0))
    machine.write_kept(machine.key_of("c"), b"code")
    assert (folder / "note").exists()
    assert [machine.read_kept(machine.key_of(name)) for name in "abc"] == [b"code", None, b"code"]


@pytest.mark.parametrize("mode", [0o640, 0o620, 0o606])
def test_a_file_that_others_may_have_written_does_not_count(folder, mode):
    """As one that was put there while the folder was open to all."""
    machine.write_kept(machine.key_of("a"), b"code")
    (folder / machine.key_of("a")).chmod(mode)
    assert machine.read_kept(machine.key_of("a")) is None


def test_a_file_of_another_owner_does_not_count(folder, monkeypatch):
    machine.write_kept(machine.key_of("a"), b"code")
    usual = os.fstat

    def of_another(handle):
        status = list(usual(handle))
        if not stat.S_ISDIR(int(status[stat.ST_MODE])):
            status[stat.ST_UID] += 1
        return os.stat_result(status)

    monkeypatch.setattr(os, "fstat", of_another)
    assert machine.read_kept(machine.key_of("a")) is None


def test_a_folder_that_is_exchanged_meanwhile_does_not_count(folder, monkeypatch):
    machine.write_kept(machine.key_of("a"), b"code")
    usual = machine._own_folder

    def exchanged():
        place = usual()
        folder.chmod(0o777)  # as a folder of another owner would be
        return place

    monkeypatch.setattr(machine, "_own_folder", exchanged)
    assert machine.read_kept(machine.key_of("a")) is None


def test_a_pipe_is_not_waited_for(folder):
    machine.write_kept(machine.key_of("b"), b"code")
    os.mkfifo(folder / machine.key_of("a"), 0o600)
    assert machine.read_kept(machine.key_of("a")) is None


def test_code_is_found_where_no_time_can_be_set(folder, monkeypatch):
    machine.write_kept(machine.key_of("a"), b"code")
    monkeypatch.setattr(os, "utime", _refused)
    assert machine.read_kept(machine.key_of("a")) == b"code"


def _refused(*_):
    raise OSError(errno.EROFS, "Read-only file system")


def test_what_cannot_be_removed_stays_alone(folder, monkeypatch):
    monkeypatch.setattr(machine, "_KEPT_FILES", 1)
    machine.write_kept(machine.key_of("a"), b"code")
    (folder / "a folder").mkdir()
    os.utime(folder / "a folder", (1e9 - 2, 1e9 - 2))
    os.utime(folder / machine.key_of("a"), (1e9 - 1, 1e9 - 1))
    machine.write_kept(machine.key_of("b"), b"code")
    assert machine.read_kept(machine.key_of("a")) is None


def test_an_interrupt_leaves_no_draft(folder, monkeypatch):
    machine.write_kept(machine.key_of("a"), b"code")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(machine.Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        machine.write_kept(machine.key_of("b"), b"code")
    assert [file.name for file in folder.iterdir()] == [machine.key_of("a")]


def test_a_user_without_a_home_keeps_nothing(tmp_path, monkeypatch):
    import platformdirs

    machine._place.cache_clear()
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *_, **__: machine.Path("~/.cache/erosion"))
    monkeypatch.chdir(tmp_path)
    try:
        machine.write_kept(machine.key_of("a"), b"code")
    finally:
        machine._place.cache_clear()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_processes_that_write_one_file_at_once(folder):
    """And one that is killed while it does."""
    program = """
        import os, sys
        from pathlib import Path
        from erosion.lanes import machine
        machine._place = lambda: Path(sys.argv[1])
        key, code = machine.key_of("a"), bytes(range(256)) * 2000
        for i in range(200):
            machine.write_kept(key, code)
            assert machine.read_kept(key) == code
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(folder)]
    processes = [subprocess.Popen(command) for _ in range(3)]
    assert [process.wait(60) for process in processes] == [0, 0, 0]
    assert [file.name for file in folder.iterdir()] == [machine.key_of("a")]


@pytest.mark.slow
def test_a_script_finds_the_code_of_the_last_one(tmp_path):
    script = "import erosion; print(erosion.impact('rotating', erosion.TABLE_1).volume)"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    )
    assert first.stdout == second.stdout
    # The same program has the same text in every process, or the second one would add a file.
    assert len(list(tmp_path.rglob("lanes/*"))) == 1
