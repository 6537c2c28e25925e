"""Who may speak with the explorer: its own page in the browser of this machine or of an invited device."""

from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from erosion.explorer.address import Address, without_token

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
    try:
        cookies = SimpleCookie("; ".join(headers.getlist("cookie")))
    except CookieError:
        return ""
    return cookies[name].value if name in cookies else ""


def _refuse(sentence: str, names: Iterable[str]) -> PlainTextResponse:
    return PlainTextResponse(f"{sentence} {', '.join(names)[:200] or 'no host'}.\n", 403)
