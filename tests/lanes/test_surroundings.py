"""What counts as a user's own code."""

import subprocess
import sys
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
