"""The page's server on 127.0.0.1, which answers to its own page only."""

import asyncio
import atexit
import gc
import logging
import os
import re
import signal
import socket
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from fastapi import Request
from nicegui import app, background_tasks, ui
from nicegui.server import Server
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from erosion.explorer.computed import Answers
from erosion.explorer.controls import read_materials
from erosion.explorer.state import PageCase, PageState, own_numbers, sentence
from erosion.explorer.tab import Service, Tab
from erosion.impacts import TurnWarning
from erosion.interrupts import ENDING, INTERRUPTED
from erosion.models import CuttingModel, available_models, load_model
from erosion.parameters import CaseFile, Parameters, PerMass, SizeWarning

_HOST = "127.0.0.1"
_OWN = re.compile(r"(127\.0\.0\.1|localhost)(:\d+)?")


class OnlyOwnPage:
    """Refuses requests and websockets that other pages send.

    A page of the internet may let its own host name point to 127.0.0.1 (DNS rebinding); the browser
    then takes the explorer for a part of that page. Its `Host` header betrays it. Any other page betrays itself by
    its `Origin`, which browsers send with every websocket.

    Args:
        app: the application behind.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request or a websocket, or refuse it with one sentence."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def send_unframed(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Content-Security-Policy"] = "frame-ancestors 'none'"
            await send(message)

        headers = Headers(scope=scope)
        hosts = [host.lower() for host in headers.getlist("host")]
        # Whoever forwards a port of another machine (ssh -L) names that port.
        own = len(hosts) == 1 and _OWN.fullmatch(hosts[0]) is not None
        if own and {origin.lower() for origin in headers.getlist("origin")} <= {f"http://{hosts[0]}"}:
            await self._app(scope, receive, send_unframed)
            return
        refusal = PlainTextResponse("The explorer answers to its own page on 127.0.0.1 and localhost only.\n", 403)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(refusal)
        else:
            await refusal(scope, receive, send)


_PORT = 8080
_SWITCH = 0.0005  # s
# s; a browser that is silent for longer has left. NiceGUI's default of 3 s lets go of tabs on a busy machine.
_SILENCE = 15.0
_ALLOCATIONS = 2_000  # between two looks for garbage
_CHECKED = ("linearized", "finnie", "rotating")
_SHOWN = "linearized"
_STYLE = (Path(__file__).parent / "web" / "page.css").read_text(encoding="utf-8")


def serve(service: Service, port: int, *, show: bool = True) -> None:
    """Serve the explorer until Ctrl+C.

    Args:
        service: the models and the first state.
        port: on which it listens.
        show: whether to open a browser.

    Raises:
        ValueError: if another program took the port meanwhile.
    """
    _prepare_process()

    @ui.page("/", title="erosion explorer", dark=None)
    async def page(request: Request) -> None:
        ui.add_css(_STYLE)
        ui.add_body_html("<noscript><p>The explorer needs JavaScript.</p></noscript>")
        client = ui.context.client
        # A crawler never connects. After a minute NiceGUI deletes its client; until then it costs next to nothing.
        await client.connected()
        if not client.is_deleted:
            _open_tab(service, request.query_params)

    async def announce() -> None:
        while not Server.instance.started:
            await asyncio.sleep(0.02)
        print(f"http://{_HOST}:{port}/", flush=True)
        # The command line looks for garbage seldom, since a verb ends before there is any. A server does not end, and
        # the parts of a closed tab refer to one another; what is there at its start, half a million objects of
        # modules, need not be looked at again.
        gc.freeze()
        gc.set_threshold(_ALLOCATIONS)
        # Not earlier: compiling would slow the start of the server.
        service.prepare()

    app.add_middleware(OnlyOwnPage)
    app.on_startup(lambda: background_tasks.create(announce()))
    # Of the signals that ask for an end the server knows all but that of a closed terminal, which `nohup` ignores.
    for number in ENDING:
        if number not in (signal.SIGINT, signal.SIGTERM) and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: signal.raise_signal(signal.SIGINT))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # so that it may end in order
    try:
        ui.run(
            host=_HOST,
            port=port,
            show=show,
            reload=False,
            show_welcome_message=False,
            reconnect_timeout=_SILENCE,
        )
    except SystemExit as error:
        sentence = f"must be free, but another program took {port} meanwhile."
        raise ValueError(f"Argument `port` {sentence}") from error
    except KeyboardInterrupt:
        pass  # The server ends by Ctrl+C only. The exception is lost if it comes while Python collects garbage.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # When the interpreter ends, a thread that is still inside XLA would abort the process.
    atexit.register(os._exit, INTERRUPTED)
    raise KeyboardInterrupt


def _prepare_process() -> None:
    """Settings for all threads, and no warnings on the terminal about what the page says."""
    # A thread that returns from compiled code waits this long for the thread that holds the interpreter.
    # Python's default is 5 ms.
    sys.setswitchinterval(_SWITCH)
    # If a model still computes at the end, NiceGUI and Python would warn about the dropped work. And numbers beyond
    # all floats are on the page, not on the terminal.
    for shown in (TurnWarning, SizeWarning, RuntimeWarning):
        warnings.simplefilter("ignore", shown)
    logging.getLogger("nicegui").addFilter(lambda record: not str(record.msg).startswith("Could not cancel"))
    logging.getLogger("uvicorn.error").addFilter(lambda record: not isinstance(record.msg, OSError))


def _open_tab(service: Service, link: Mapping[str, str]) -> None:
    """Fill the page with what its link asks for."""
    complaint, state = "", service.start
    try:
        state = state.reading(link, list(service.summaries))
    except ValueError as error:
        complaint = f"The link cannot be used: {sentence(error)}"
    tab = Tab(service, state)
    tab.begin()
    if complaint:
        tab.say(complaint)


def offer(
    p: Parameters,
    plug_ins: Sequence[str] = (),
    tables: Sequence[Path] = (),
    per_mass: PerMass | None = None,
    *,
    fitted: tuple[str, CuttingModel] | None = None,
    file: CaseFile | None = None,
) -> Service:
    """Offer every model, particle and target that is known by name, and the user's own.

    Args:
        p: the first case, all scalars.
        plug_ins: paths of further models; the cut of the first of them is drawn.
        tables: TOML files of further particles and targets.
        per_mass: how volumes become erosion per mass of particles, at first.
        fitted: the model that the case file names, by name or path, with what the file sets of it; its cut is drawn.
        file: the case file, for what is doubtful in the fit that wrote it, and its tests.

    Raises:
        ValueError: for a plug-in or a table that cannot be loaded.
    """
    materials = read_materials(tables)
    offered = {name: (name, info.summary) for name, info in available_models().items() if info.error is None}
    plugged = []
    named = [] if fitted is None or fitted[0] in offered else [fitted[0]]
    # One file may be spelled in several ways; the case file's is kept, by which its model is found below.
    for path in {Path(path).resolve(): path for path in [*plug_ins, *named]}.values():
        info = next(iter(available_models(path).values()))
        plugged.append(path if Path(path).stem in offered else Path(path).stem)
        offered[plugged[-1]] = (path, info.summary)
    models = {name: load_model(source) for name, (source, _) in offered.items()}
    shown = next(iter(plugged), _SHOWN)
    if fitted is not None:
        shown = next(name for name, (source, _) in offered.items() if source == fitted[0])
        models[shown] = fitted[1]
    answers = Answers(models)
    case = PageCase.of(p, own_numbers(models))
    checked = tuple(name for name in offered if name in (*_CHECKED, *plugged, shown))
    start = PageState(case, checked, shown, per_mass or PerMass(), predict=file is None and not plug_ins)
    return Service(
        answers=answers,
        start=start,
        summaries={name: summary for name, (_, summary) in offered.items()},
        sources={name: source for name, (source, _) in offered.items()},
        materials=materials,
        file=file,
    )


def free_port(port: int | None) -> int:
    """The port if it is free; any free port for 0; for None 8080, or any if 8080 is in use.

    Raises:
        ValueError: if the port is not free, or not for this user.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_HOST, _PORT if port is None else port))
        except OSError as error:
            if port is None:
                return free_port(0)
            sentence = f"must be a free port that you may use, but {port} is not ({error.strerror})."
            raise ValueError(f"Argument `port` {sentence}") from error
        return probe.getsockname()[1]
