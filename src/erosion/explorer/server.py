"""The page's server, on this machine alone."""

import socket
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from fastapi import Request
from nicegui import app, ui

from erosion.explorer.answers import Answers
from erosion.explorer.found import all_ready
from erosion.explorer.preparation import Preparation
from erosion.explorer.state import Case, State
from erosion.explorer.tab import Service, Tab
from erosion.models import available_models, load_model
from erosion.parameters import Parameters
from erosion.trajectory import TurnWarning

HOST = "127.0.0.1"
_PORT = 8080
_CHECKED = ("linearized", "finnie", "rotating")
_SHOWN = "rotating"
_STYLE = (Path(__file__).parent / "web" / "page.css").read_text(encoding="utf-8")


def explore(p: Parameters, plug_ins: Sequence[str] = (), *, port: int | None = None, show: bool = True) -> None:
    """Serve the explorer until it is interrupted.

    Args:
        p: the case to begin with, all scalars.
        plug_ins: paths of models to offer besides those known by name.
        port: to listen on; any free one for 0; 8080, or a free one where it is taken, without it.
        show: open a browser.

    Raises:
        ModelError: for a plug-in that cannot be loaded.
        OSError: where the port cannot be had.
    """
    port = _free(port)
    service = _service(p, plug_ins)
    # The page says it in words.
    warnings.simplefilter("ignore", TurnWarning)

    @ui.page("/", title="erosion explorer", dark=None)
    async def page(request: Request) -> None:
        ui.add_css(_STYLE)
        complaint, state = "", service.start
        try:
            state = state.reading(request.query_params, list(service.summaries))
        except ValueError as error:
            complaint = f"The link cannot be used: {error}"
        tab = Tab(service, state)
        await ui.context.client.connected()
        tab.begin()
        if complaint:
            tab.say(complaint)

    def started() -> None:
        print(f"http://{HOST}:{port}/", flush=True)
        all_ready(service.answers, service.start, service.preparation.ready)

    app.on_startup(started)
    app.on_shutdown(service.preparation.close)
    ui.run(host=HOST, port=port, show=show, reload=False, show_welcome_message=False, language="en-US")


def _service(p: Parameters, plug_ins: Sequence[str]) -> Service:
    known: Mapping[str, tuple[str, str]] = {
        name: (name, info.summary) for name, info in available_models().items() if info.error is None
    }
    extra = {Path(path).stem: (path, next(iter(available_models(path).values())).summary) for path in plug_ins}
    offered = {**known, **extra}
    answers = Answers({name: load_model(source) for name, (source, _) in offered.items()})
    case = Case.of(p)
    start = State(case, tuple(name for name in offered if name in (*_CHECKED, *extra)), next(iter(extra), _SHOWN))
    return Service(
        answers=answers,
        preparation=Preparation(case),
        start=start,
        summaries={name: summary for name, (_, summary) in offered.items()},
        sources={name: source for name, (source, _) in offered.items()},
    )


def _free(port: int | None) -> int:
    """The port if it can be had."""
    if port is None:
        try:
            return _free(_PORT)
        except OSError:
            return _free(0)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise OSError(f"Argument `port` must be free, but {port} cannot be had ({error.strerror}).") from error
        return probe.getsockname()[1]
