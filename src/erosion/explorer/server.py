"""The page's server, and who may speak with it."""

import asyncio
import atexit
import contextlib
import errno
import gc
import logging
import os
import signal
import socket
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from http.cookies import CookieError, SimpleCookie
from pathlib import Path

import segno
from fastapi import Request
from nicegui import app, background_tasks, ui
from nicegui.server import Server
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from erosion.explorer.computed import Answers, Preparation, all_ready, share_memory
from erosion.explorer.controls import read_materials
from erosion.explorer.state import Address, PageCase, PageState, own_numbers, sentence, without_token
from erosion.explorer.tab import Service, Tab
from erosion.impacts import TurnWarning
from erosion.interrupts import ENDING, INTERRUPTED
from erosion.models import CuttingModel, available_models, load_model
from erosion.output import briefly
from erosion.parameters import CaseFile, Parameters, PerMass, SizeWarning

_LONGEST = 16_000  # characters of an address; a case, all models and hundreds of own parameters take far fewer
# No other page may show this one, read it, or hold its window.
_CLOSED = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class OnlyOwnPage:
    """Refuses requests and websockets that other pages send, whatever name they give this machine.

    A page of the internet may let its own host name point to 127.0.0.1 (DNS rebinding); the browser
    then takes the explorer for a part of that page. Its `Host` header betrays it.

    A device that opens the link with the token is given a cookie, and led to the same address without the token.

    Args:
        app: the application behind.
        address: where the explorer listens.
    """

    def __init__(self, app: ASGIApp, address: Address) -> None:
        self._app, self._address = app, address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request or a websocket, or refuse it with one sentence."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def send_closed(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(_CLOSED)
            await send(message)

        headers = Headers(scope=scope)
        refusal = (
            _too_long(scope) or _foreign(headers, self._address, scope) or _uninvited(headers, self._address, scope)
        )
        if refusal is None:
            await self._app(scope, receive, send_closed)
        elif scope["type"] == "websocket":
            await WebSocket(scope, receive, send_closed).send_denial_response(refusal)
        else:
            await refusal(scope, receive, send_closed)


def _too_long(scope: Scope) -> PlainTextResponse | None:
    length = len(scope["raw_path"]) + len(scope["query_string"])
    if length <= _LONGEST:
        return None
    sentence = f"The address must have at most {_LONGEST} characters, but has {length}.\n"
    return PlainTextResponse(sentence, 414)


def _foreign(headers: Headers, address: Address, scope: Scope) -> PlainTextResponse | None:
    hosts = [host.lower() for host in headers.getlist("host")]
    reached, _ = scope.get("server") or (None, None)
    if len(hosts) != 1 or not address.is_own(hosts[0], reached):
        names = "127.0.0.1, localhost and names of this machine" if address.token else "127.0.0.1 and localhost"
        return _refuse(f"The explorer answers to {names} only, but was asked for", hosts)
    origins = [origin.lower() for origin in headers.getlist("origin")]
    if not set(origins) <= {f"http://{hosts[0]}", f"https://{hosts[0]}"}:
        return _refuse("The explorer answers to its own page only, but was asked by", origins)
    # A link on another page may lead here; images, scripts and forms there may not.
    if headers.get("sec-fetch-site") in ("cross-site", "same-site") and headers.get("sec-fetch-mode") != "navigate":
        return _refuse("The explorer answers to its own page only, but was asked by", ["another page"])
    return None


def _uninvited(headers: Headers, address: Address, scope: Scope) -> Response | None:
    """A refusal of a device without the token; one that brings it in a link is led on, with a cookie."""
    token, rest = without_token(scope["query_string"].decode("latin-1"))
    if scope["type"] == "http" and address.token and token is not None and address.admits(token):
        # "//name/" would lead to another machine.
        path = "/" + scope["path"].lstrip("/") + (f"?{rest}" if rest else "")
        response = RedirectResponse(path, 303)
        # "Lax": a link or a code in another program may lead here; requests by other pages come without the cookie.
        response.set_cookie(address.cookie, address.token, httponly=True, samesite="lax")
        return response
    if address.admits(_cookie(headers, address.cookie)):
        return None
    sentence = "Scan the code or open the link that `erosion explore` shows: the address alone is not enough."
    return PlainTextResponse(f"{sentence}\n", 403)


def _cookie(headers: Headers, name: str) -> str:
    with contextlib.suppress(CookieError, KeyError):
        return SimpleCookie("; ".join(headers.getlist("cookie")))[name].value
    return ""


def _refuse(sentence: str, names: Iterable[str]) -> PlainTextResponse:
    return PlainTextResponse(f"{sentence} {', '.join(names)[:200] or 'no host'}.\n", 403)


_MOST = 100  # connections of one address; a tab of a browser holds at most seven
_PATIENCE = 10.0  # s


class _Connection(HttpToolsProtocol):
    """A connection that must ask soon for something, one of a few of its address: idle ones keep nobody out."""

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Take it, unless its address holds too many."""
        super().connection_made(transport)
        devices = [getattr(connection, "client", None) or ("",) for connection in self.connections]
        if [address for address, *_ in devices].count((self.client or ("",))[0]) > _MOST:
            transport.abort()
        else:
            self.loop.call_later(_PATIENCE, self._end_if_silent)

    def _end_if_silent(self) -> None:
        # A websocket's connection has another protocol by now.
        if self.cycle is None and self in self.connections:
            self.transport.abort()


_PORT = 8080
_SWITCH = 0.0005  # s
# s; a browser that is silent for longer has left. NiceGUI's default of 3 s lets go of tabs on a busy machine.
_SILENCE = 15.0
_ALLOCATIONS = 2_000  # between two looks for garbage
_CHECKED = ("linearized", "finnie", "rotating")
_SHOWN = "rotating"
_STYLE = (Path(__file__).parent / "web" / "page.css").read_text(encoding="utf-8")


def serve(service: Service, address: Address, *, show: bool = True) -> None:
    """Serve the explorer until Ctrl+C.

    Args:
        service: the models and the first state.
        address: where to listen.
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
            _open_tab(service, address, request.query_params)

    async def announce() -> None:
        while not Server.instance.started:
            await asyncio.sleep(0.02)
        print(address.link, flush=True)
        # For other devices also as a code, where people read it.
        if address.token and sys.stdout.isatty():
            segno.make_qr(address.link).terminal(compact=True)
        # The command line looks for garbage seldom, since a verb ends before there is any. A server does not end, and
        # the parts of a closed tab refer to one another; what is there at its start, half a million objects of
        # modules, need not be looked at again.
        gc.freeze()
        gc.set_threshold(_ALLOCATIONS)
        # Not earlier: compiling would slow the start of the server.
        all_ready(service.start, service.preparation)

    app.add_middleware(OnlyOwnPage, address=address)
    app.on_startup(lambda: background_tasks.create(announce()))
    # Of the signals that ask for an end the server knows all but that of a closed terminal, which `nohup` ignores.
    for number in ENDING:
        if number not in (signal.SIGINT, signal.SIGTERM) and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        ui.run(
            host=address.host,
            port=address.port,
            show=address.path if show else False,
            reload=False,
            show_welcome_message=False,
            reconnect_timeout=_SILENCE,
            http=_Connection,
        )
    except SystemExit as error:
        sentence = f"must be free, but another program took {address.port} meanwhile."
        raise ValueError(f"Argument `port` {sentence}") from error
    except KeyboardInterrupt:
        pass  # The server ends by Ctrl+C only. The exception is lost if it comes while Python collects garbage.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # When the interpreter ends, a thread that is still inside XLA would abort the process.
    atexit.register(os._exit, INTERRUPTED)
    raise KeyboardInterrupt


def _prepare_process() -> None:
    """Settings for all threads, and no warnings on the terminal about what the page says."""
    share_memory()
    # A thread that returns from compiled code waits this long for the thread that holds the interpreter.
    # Python's default is 5 ms.
    sys.setswitchinterval(_SWITCH)
    # If a model still computes at the end, NiceGUI and Python would warn about the dropped work. And numbers beyond
    # all floats are on the page, not on the terminal.
    for shown in (TurnWarning, SizeWarning, RuntimeWarning):
        warnings.simplefilter("ignore", shown)
    logging.getLogger("nicegui").addFilter(lambda record: not str(record.msg).startswith("Could not cancel"))
    logging.getLogger("uvicorn.error").addFilter(lambda record: not isinstance(record.msg, OSError))


def _open_tab(service: Service, address: Address, link: Mapping[str, str]) -> None:
    """Fill the page with what its link asks for."""
    complaint, state = "", service.start
    try:
        state = state.reading(link, list(service.summaries))
    except ValueError as error:
        complaint = f"The link cannot be used: {sentence(error)}"
    tab = Tab(service, state, address.link if address.token else None)
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
        per_mass: how volumes become erosion per mass of abrasive, at first.
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
    start = PageState(case, checked, shown, per_mass or PerMass())
    return Service(
        answers=answers,
        preparation=Preparation(answers, case),
        start=start,
        summaries={name: summary for name, (_, summary) in offered.items()},
        sources={name: source for name, (source, _) in offered.items()},
        materials=materials,
        file=file,
    )


def free_address(host: str, port: int | None) -> Address:
    """The address of the port if it is free; of any free port for 0; for None of 8080, or any if 8080 is in use.

    Raises:
        ValueError: if the port is not free, or not for this user; if the host is no address of this machine.
    """
    try:
        return Address.free(host, _PORT if port is None else port)
    except socket.gaierror as error:
        raise ValueError(f"Argument `host` must be an address of this machine, but is {briefly(host)}.") from error
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise ValueError(f"Argument `host` must be an address of this machine, but is {briefly(host)}.") from error
        if port is None:
            return free_address(host, 0)
        sentence = f"must be a free port that you may use, but {port} is not ({error.strerror})."
        raise ValueError(f"Argument `port` {sentence}") from error
