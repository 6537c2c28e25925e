"""What counts as a user's own code."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

_ASK = """
import json, sys
import numpy
from erosion.lanes.surroundings import is_own
print([is_own(file) for file in (json.__file__, numpy.__file__, sys.argv[1])])
"""


def test_libraries_are_not_the_users_where_python_is_reached_by_a_symbolic_link(tmp_path: Path) -> None:
    """All that they read would be looked at before each call: seconds at the first, and 60 ms at each later one."""
    link = tmp_path / "environment"
    link.symlink_to(sys.prefix, target_is_directory=True)
    python = link / Path(sys.executable).relative_to(sys.prefix)
    done = subprocess.run([python, "-c", _ASK, tmp_path / "mine.py"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[False,", "False,", "True]"]


def _with_libraries_at(folder: Path, *words: str | Path) -> str:
    folder.symlink_to(sysconfig.get_path("purelib"), target_is_directory=True)
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    return subprocess.run(
        [sys.executable, "-c", *words], capture_output=True, text=True, check=True, env=environment
    ).stdout


def test_libraries_are_not_the_users_in_a_second_folder_of_packages(tmp_path: Path) -> None:
    """As of `pip install --user`, of Debian's packages, and of a cluster's modules."""
    answers = _with_libraries_at(tmp_path / "site-packages", _ASK, tmp_path / "mine.py")
    assert answers.split() == ["[False,", "False,", "True]"]


_READ = """
import jax.numpy as jnp
from erosion.lanes.surroundings import Surroundings
Surroundings([jnp.zeros(3)])
"""


def test_arrays_are_read_where_libraries_are_taken_for_the_users(tmp_path: Path) -> None:
    """In a folder of another name they are; JAX's arrays have a slot that cannot be read."""
    _with_libraries_at(tmp_path / "libraries", _READ)
