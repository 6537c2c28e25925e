"""`erosion explore` before it serves: what it offers, and what it refuses."""

import importlib
import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from erosion.cli import exit_status
from erosion.explorer.computed import Computed
from erosion.explorer.server import offer
from erosion.explorer.tab import Service
from erosion.explorer.views import VIEWS
from erosion.parameters.parameters import TABLE_1
from tests.documents import Shell

PLUG_IN = str(Path(__file__).parent.parent.parent / "models" / "saturating_lip.py")


def test_plug_ins_are_offered_and_shown() -> None:
    service = offer(TABLE_1, [PLUG_IN])
    assert service.start.shown == "saturating_lip"
    assert service.start.models == ("linearized", "finnie", "rotating", "saturating_lip")
    assert service.sources["saturating_lip"] == PLUG_IN
    assert "Rotating" in str(service.answers.models["rotating"])
    assert service.start.case.numbers()["saturating_lip.reach"] == 0.5


FITTED = """units = "si"
particle = "garnet 80 mesh"
target = "mild steel"
v0 = 160
alpha = "20 deg"
k = 2
model = "rotating-deformation"
set = { energy_ratio = 10.5, threshold = 3.0 }
[advise]
warning = "Measure more, or free fewer parameters."
tested = { v0 = ["80 m/s", "100 m/s"] }
"""


@pytest.fixture
def explored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Service]:
    """What `erosion explore` serves for the text of a case file, and options."""

    def explore(text: str, *options: str) -> Service:
        services: list[Service] = []
        # Another test of this process may have imported the module anew.
        server = importlib.import_module("erosion.explorer.server")
        monkeypatch.setattr(server, "serve", lambda service, *_, **__: services.append(service))
        (tmp_path / "fitted.toml").write_text(text)
        assert exit_status(["explore", str(tmp_path / "fitted.toml"), "--no-browser", "--port", "0", *options]) == 0
        (service,) = services
        return service

    return explore


def test_a_fit_is_drawn_as_its_case_file_has_it_with_its_doubts(explored: Callable[..., Service]) -> None:
    service = explored(FITTED)
    assert service.start.shown == "rotating-deformation"
    assert service.start.shown in service.start.models
    assert service.start.case.own_values("rotating-deformation") == {"energy_ratio": 10.5, "threshold": 3.0}
    (said,) = VIEWS["numbers"](Computed(service.start, file=service.file), [*service.summaries])
    assert "fitted.toml: 160 m/s is 1.6 × " in said


UNFITTED = FITTED[: FITTED.index("model =")]


@pytest.mark.parametrize("name", ["dnv", "dnv:carbon-steel"])
def test_a_correlation_of_a_case_file_is_not_drawn(
    name: str, explored: Callable[..., Service], capsys: pytest.CaptureFixture
) -> None:
    service = explored(f'{UNFITTED}model = "{name}"')
    assert (service.start.shown, name in service.summaries) == ("linearized", False)
    assert f"fitted.toml: {name} is a correlation" in capsys.readouterr().err


def test_a_plug_in_of_a_case_file_and_an_option_is_offered_once(
    explored: Callable[..., Service], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(Path(PLUG_IN).parent)
    text = f"{UNFITTED}model = {json.dumps(PLUG_IN)}\nset = {{ reach = 0.7 }}"
    service = explored(text, "--model", "saturating_lip.py")
    assert [name for name in service.summaries if "lip" in name] == ["saturating_lip"]
    assert service.start.shown == "saturating_lip"
    assert service.start.case.own_values("saturating_lip") == {"reach": 0.7}


def test_a_taken_port_is_one_line(shell: Shell) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        said = shell(["explore", "--no-browser", "--port", port], 2).err
    assert f"Option `--port` must be a free port that you may use, but {port} is not (Addr" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--model rotating", "Option `--model` must be the path of a Python file here, but is 'rotating'."),
        ("--model missing.py", "missing.py: there is no such file or folder of models."),
        ("--port 70000", "Option `--port` must be in 0 … 65535, but is 70000."),
        ("--alpha 95deg", "Option `--alpha` must be in (0, 90°]"),
    ],
)
def test_bad_options_are_one_line(options: str, message: str, shell: Shell) -> None:
    assert shell(f"explore --no-browser {options}", 2).err.startswith(f"erosion: {message}")
