"""`erosion explore` before it serves: what it offers, and what it refuses."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from erosion.cli import _status
from erosion.explorer.server import offer
from erosion.parameters.parameters import TABLE_1

PLUG_IN = str(Path(__file__).parent.parent.parent / "models" / "saturating_lip.py")


def test_plug_ins_are_offered_and_shown() -> None:
    service = offer(TABLE_1, [PLUG_IN])
    assert service.start.shown == "saturating_lip"
    assert service.start.models == ("linearized", "finnie", "rotating", "saturating_lip")
    assert service.sources["saturating_lip"] == PLUG_IN
    assert "Rotating" in str(service.answers.models["rotating"])
    assert service.start.case.numbers()["saturating_lip.reach"] == 0.5


def test_a_taken_port_is_one_line(capsys: pytest.CaptureFixture) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert _status(["explore", "--no-browser", "--port", port]) == 2
    assert f"Option `--port` must be free, but {port} is not" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--model", "rotating"], "Option `--model` must be the path of a Python file here, but is 'rotating'."),
        (["--model", "missing.py"], "missing.py: there is no such file or folder of models."),
        (["--port", "70000"], "Option `--port` must be in 0 … 65535, but is 70000."),
        (["--alpha", "95deg"], "Option `--alpha` must be in (0, 90°]"),
    ],
)
def test_bad_options_are_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture) -> None:
    assert _status(["explore", "--no-browser", *arguments]) == 2
    assert capsys.readouterr().err.startswith(f"erosion: {message}")


def test_without_nicegui_it_says_what_to_install(capsys: pytest.CaptureFixture, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "nicegui", None)
    for name in [name for name in sys.modules if name.startswith("erosion.explorer")]:
        monkeypatch.delitem(sys.modules, name)
    assert _status(["explore", "--no-browser"]) == 2
    assert "pip install 'erosion[explorer]'" in capsys.readouterr().err


def test_the_first_page_does_not_wait_for_the_figures_libraries() -> None:
    code = "import sys, erosion.explorer.server; sys.exit(bool({'matplotlib', 'scipy', 'xarray'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
