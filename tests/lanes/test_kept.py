"""Machine code on disk: found again, and never anyone else's."""

import os
import subprocess
import sys

import numpy as np
import pytest

from erosion.lanes import kept
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.machine import llvm


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache" / "lanes"
    monkeypatch.setattr(kept, "_place", lambda: place)
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
    other = kept.key_of("other")
    file.rename(folder / other)
    assert kept.read(other) is None


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
    monkeypatch.setattr(kept, "_MANY", 2)
    for age, name in ((30, "a"), (20, "b")):
        kept.write(kept.key_of(name), b"code")
        os.utime(folder / kept.key_of(name), (1e9 - age, 1e9 - age))
    assert kept.read(kept.key_of("a")) == b"code"
    kept.write(kept.key_of("c"), b"code")
    assert [kept.read(kept.key_of(name)) for name in "abc"] == [b"code", None, b"code"]


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
