"""The versions of llvmlite that are taken, and the text that their LLVMs read."""

import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest

from erosion.lanes.machine import LLVMLITE, require_llvmlite


@pytest.mark.parametrize("version", ["0.45.0", "0.45.1", "0.46.0", "0.47.0", "0.48.0", "0.50.0", "0.50.0rc1"])
def test_versions_that_work_are_taken(version: str) -> None:
    require_llvmlite(version)


@pytest.mark.parametrize("version", ["0.44.0", "0.51.0", "0.51.0dev0+1.gabc", "1.0.0", "0+unknown", ""])
def test_other_versions_are_refused_at_once(version: str) -> None:
    with pytest.raises(ImportError, match=r"llvmlite>=0\.45,<0\.51") as caught:
        require_llvmlite(version)
    assert f"llvmlite {version} " in str(caught.value)


def test_the_bounds_are_those_of_the_package() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    least, beyond = (".".join(map(str, bound)) for bound in LLVMLITE)
    assert f"llvmlite>={least},<{beyond}" in project["project"]["dependencies"]


def test_a_verb_says_it_in_one_line() -> None:
    code = """
        import llvmlite
        llvmlite.__version__ = "0.44.0"
        from erosion.cli import main
        main(["run"])
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("erosion: erosion needs llvmlite 0.45 or newer, below 0.51, but llvmlite 0.44.0 ")
    assert done.stderr.count("\n") == 1
