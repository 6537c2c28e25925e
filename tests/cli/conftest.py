"""Help in the width of each test, and a folder for its files."""

import pytest
from rich.console import Console

from erosion.cli import app


@pytest.fixture(scope="package", autouse=True)
def _a_console_that_asks_for_its_width_each_time():
    """Else the width of a process's first test with help is that of all that follow."""
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("COLUMNS", raising=False)
        app.console = Console()


@pytest.fixture(autouse=True)
def in_folder(tmp_path, monkeypatch):
    """Each test works in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
