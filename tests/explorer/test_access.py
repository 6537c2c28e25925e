"""Whom the explorer answers: its own page on this machine, and no other."""

import contextlib
import http.client
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests.explorer.conftest import served

SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "ZXJvc2lvbiBleHBsb3Jlcg==",
}
STRANGERS = {
    "rebound name": {"Host": "evil.example:8080"},
    "name that begins like ours": {"Host": "127.0.0.1.evil.example"},
    "name that ends like ours": {"Host": "evil-localhost:8080"},
    "name with a user": {"Host": "127.0.0.1:80@evil.example"},
    "foreign page": {"Origin": "http://evil.example"},
    "page without a name": {"Origin": "null"},
    "page of another port": {"Origin": "http://127.0.0.1:1"},
}


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """Host and port of a running explorer."""
    with served() as (_, address):
        yield urlsplit(address).netloc


def ask(place: str, path: str, headers: dict[str, str]) -> http.client.HTTPResponse:
    """The answer to a request; a host named here replaces the usual one."""
    with contextlib.closing(http.client.HTTPConnection(place, timeout=30)) as connection:
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in (headers | UPGRADE if path == SOCKET else headers).items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse()


@pytest.mark.parametrize("headers", STRANGERS.values(), ids=STRANGERS)
@pytest.mark.parametrize("path", ["/", SOCKET], ids=["page", "websocket"])
def test_another_page_is_refused(place: str, path: str, headers: dict[str, str]) -> None:
    assert ask(place, path, headers).status == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "LOCALHOST", "localhost:9"])
def test_the_own_page_is_answered(place: str, host: str) -> None:
    own = {"Host": host, "Origin": f"http://{host.lower()}"}
    page = ask(place, "/?alpha=30deg", own)
    assert (page.status, page.headers["Content-Security-Policy"]) == (200, "frame-ancestors 'none'")
    assert ask(place, SOCKET, own).status == 101
