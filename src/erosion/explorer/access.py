"""Who may speak with the explorer: this machine's browser about the explorer's own page, and nobody else."""

import re
from collections.abc import Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

# Any port: whoever works on a distant machine reaches its explorer through another port of their own (ssh -L).
_OWN_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?")
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

        async def send_closed(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(_CLOSED)
            await send(message)

        refusal = _too_long(scope) or _foreign(Headers(scope=scope))
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


def _foreign(headers: Headers) -> PlainTextResponse | None:
    hosts = [host.lower() for host in headers.getlist("host")]
    if len(hosts) != 1 or not _OWN_HOST.fullmatch(hosts[0]):
        return _refuse("The explorer answers to 127.0.0.1 and localhost only, but was asked for", hosts)
    origins = [origin.lower() for origin in headers.getlist("origin")]
    if not set(origins) <= {f"http://{hosts[0]}", f"https://{hosts[0]}"}:
        return _refuse("The explorer answers to its own page only, but was asked by", origins)
    # A link on another page may lead here; images, scripts and forms there may not.
    if headers.get("sec-fetch-site") in ("cross-site", "same-site") and headers.get("sec-fetch-mode") != "navigate":
        return _refuse("The explorer answers to its own page only, but was asked by", ["another page"])
    return None


def _refuse(sentence: str, names: Iterable[str]) -> PlainTextResponse:
    return PlainTextResponse(f"{sentence} {', '.join(names)[:200] or 'no host'}.\n", 403)
