"""Where the explorer listens, and who is let in.

Who may speak with the explorer, and what strangers leave behind.

The explorer's threads, and the memory that they share.
"""

import contextlib
import http.client
import os
import platform
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest

from erosion.explorer.state import Address, without_token
from tests.explorer.conftest import served

OWN = Address("127.0.0.1", 8080)
SHARED = Address("0.0.0.0", 8080, "a-token")


def test_only_other_hosts_than_the_own_machine_need_a_token() -> None:
    own, shared = Address.free("127.0.0.1", 0), Address.free("0.0.0.0", 0)
    assert own.token == ""
    assert own.admits("")
    assert own.link == f"http://127.0.0.1:{own.port}/"
    assert len(shared.token) == 22
    assert shared.token != Address.free("0.0.0.0", 0).token
    assert shared.link.endswith(f":{shared.port}/?token={shared.token}")
    assert "0.0.0.0" not in shared.link
    assert shared.token not in repr(shared)


@pytest.mark.parametrize("token", ["", "a-toke", "a-token ", "A-TOKEN", "ä-token", "\x00"])
def test_another_token_is_not_admitted(token: str) -> None:
    assert SHARED.admits("a-token")
    assert not SHARED.admits(token)


def test_the_link_names_an_ipv6_address_in_brackets() -> None:
    assert Address("fe80::1", 8080, "t").link == "http://[fe80::1]:8080/?token=t"


@pytest.mark.parametrize(
    ("address", "host", "at", "is_own"),
    [
        *(
            (SHARED, host, "192.168.1.20", True)
            for host in ("127.0.0.1", "localhost:8080", "192.168.1.20:8080", "192.168.1.20")
        ),
        *(
            (SHARED, host, at, False)
            for host in ("evil.example:8080", "192.168.1.20.evil.example", "0.0.0.0:8080", "none", "[::]", "a@b")
            for at in ("192.168.1.20", None)
        ),
        (OWN, "127.0.0.1:1", "127.0.0.1", True),
        (OWN, "192.168.1.20:8080", "192.168.1.20", False),
        (Address("fe80::1", 8080, "t"), "[fe80::1]:8080", "fe80::1", True),
    ],
)
def test_names_of_this_machine_are_its_own(address: Address, host: str, at: str | None, is_own: bool) -> None:
    assert address.is_own(host, at) == is_own


@pytest.mark.parametrize(
    ("query", "token", "rest"),
    [
        ("token=t", "t", ""),
        ("k=3&token=t&alpha=20+deg", "t", "k=3&alpha=20+deg"),
        ("k=3", None, "k=3"),
        ("token=", "", ""),
        ("", None, ""),
    ],
)
def test_the_token_is_taken_out_of_a_link(query: str, token: str | None, rest: str) -> None:
    assert without_token(query) == (token, rest)


SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport="
UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "ZXJvc2lvbiBleHBsb3Jlcg==",
}

# NiceGUI looks every ten seconds for clients that are a minute old; here every second, and they are old after one.
HASTY = """
import sys
from nicegui.app.app import App
from nicegui.client import Client
timer = App.timer
App.timer = staticmethod(lambda interval, *given: timer(interval / 10, *given))
prune = Client.prune_instances
Client.prune_instances = lambda: prune(client_age_threshold=1.0)
from erosion.cli import main
sys.argv[0] = "erosion"
main()
"""


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """Host and port of a running explorer."""
    with served() as (_, address):
        yield urlsplit(address).netloc


class Answer(NamedTuple):
    """Status, headers and text of an answer."""

    status: int
    headers: http.client.HTTPMessage
    text: str


def ask(place: str, path: str = "/", headers: Mapping[str, str] | None = None) -> Answer:
    """The answer to a request; a host named here replaces the usual one."""
    with contextlib.closing(http.client.HTTPConnection(place, timeout=30)) as connection:
        connection.putrequest("GET", path, skip_host="Host" in (headers or {}))
        for name, value in (headers or {}).items():
            connection.putheader(name, value)
        connection.endheaders()
        with connection.getresponse() as response:
            text = "" if response.status == 101 else response.read().decode()
            return Answer(response.status, response.headers, text)


STRANGERS = {
    "rebound name": {"Host": "evil.example:8080"},
    "name that begins like ours": {"Host": "127.0.0.1.evil.example:8080"},
    "name that ends like ours": {"Host": "evil-localhost:8080"},
    "name with a user": {"Host": "127.0.0.1:80@evil.example"},
    "every address": {"Host": "0.0.0.0:8080"},
    "empty name": {"Host": ""},
    "foreign page": {"Origin": "http://evil.example"},
    "page without a name": {"Origin": "null"},
    "page of another port": {"Origin": "http://127.0.0.1:1"},
    "other scheme": {"Origin": "chrome-extension://127.0.0.1"},
    "script of another page": {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    "script of another port": {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "cors"},
}


@pytest.mark.parametrize("headers", STRANGERS.values(), ids=STRANGERS)
@pytest.mark.parametrize("path", ["/", SOCKET + "polling", SOCKET + "websocket"])
def test_a_stranger_is_refused(place: str, path: str, headers: Mapping[str, str]) -> None:
    upgrade = UPGRADE if path.endswith("websocket") else {}
    answer = ask(place, path, {**upgrade, **headers})
    assert answer.status == 403
    assert answer.text.startswith("The explorer answers to ")
    assert answer.text.count("\n") == 1
    assert answer.headers["Content-Type"] == "text/plain; charset=utf-8"
    assert "Access-Control-Allow-Origin" not in answer.headers


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST", "127.0.0.1:{port}", "localhost:9"])
def test_the_own_page_is_answered(place: str, name: str) -> None:
    host = name.format(port=place.rsplit(":", 1)[1])
    own = {"Host": host, "Origin": f"http://{host.lower()}"}
    assert ask(place, headers={"Host": host}).status == 200
    assert ask(place, headers=own).status == 200
    assert ask(place, SOCKET + "websocket", {**UPGRADE, **own}).status == 101
    assert ask(place, SOCKET + "websocket", {**UPGRADE, "Host": host}).status == 101


def test_a_link_on_another_page_may_lead_here(place: str) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert ask(place, "/?alpha=30deg", headers).status == 200


def test_two_hosts_are_no_host(place: str) -> None:
    with contextlib.closing(http.client.HTTPConnection(place, timeout=30)) as connection:
        connection.putrequest("GET", "/")
        connection.putheader("Host", "evil.example")
        connection.endheaders()
        with connection.getresponse() as response:
            assert response.status == 403


@pytest.mark.parametrize("path", ["/", "/nothing", SOCKET + "polling"])
def test_no_other_page_may_show_or_read_it(place: str, path: str) -> None:
    answer = ask(place, path)
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert answer.headers["X-Frame-Options"] == "DENY"
    assert answer.headers["Cross-Origin-Opener-Policy"] == "same-origin"
    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


CLIMBS = ["/..%2f", "/../../etc/passwd", "/_nicegui/../../../etc/passwd", "/..%5c..%5cetc", "/%2e%2e/%2e%2e/etc/passwd"]


@pytest.mark.parametrize("path", [*CLIMBS, "/%00", "/docs", "/openapi.json"])
def test_no_path_leads_out(place: str, path: str) -> None:
    answer = ask(place, path)
    assert answer.status in (400, 404)
    assert "root:" not in answer.text


@pytest.mark.parametrize("part", ["resources", "libraries", "components", "esm", "static", "dynamic_resources"])
def test_no_folder_of_the_server_leads_out(place: str, part: str) -> None:
    import nicegui

    for climb in ("../" * 12, "..%2f" * 12, "%2e%2e%2f" * 12, "x/" + "../" * 12):
        answer = ask(place, f"/_nicegui/{nicegui.__version__}/{part}/{climb}etc/passwd")
        assert answer.status in (400, 403, 404)
        assert "root:" not in answer.text


@pytest.mark.parametrize("characters", [20_000, 60_000])
def test_a_link_of_absurd_length_is_refused(place: str, characters: int) -> None:
    answer = ask(place, "/?alpha=" + "9" * characters)
    assert answer.status == 414
    assert answer.text == f"The address must have at most 16000 characters, but has {characters + 7}.\n"


def test_megabytes_of_address_end_no_more_than_the_connection(place: str) -> None:
    with contextlib.suppress(OSError):
        assert ask(place, "/?alpha=" + "9" * 2_000_000).status in (400, 414)
    assert ask(place).status == 200


def test_idle_connections_of_one_device_keep_nobody_out(place: str) -> None:
    host, port = place.split(":")
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection((host, int(port)), timeout=60)) for _ in range(1100)]
        another = http.client.HTTPConnection(place, timeout=60, source_address=("127.0.0.2", 0))
        with contextlib.closing(another) as connection:
            connection.request("GET", "/")
            assert connection.getresponse().status == 200
        for connection in idle:
            with contextlib.suppress(ConnectionError):
                assert connection.recv(1) == b""
    assert ask(place).status == 200


def test_a_page_without_javascript_says_so(place: str) -> None:
    assert "<noscript><p>The explorer needs JavaScript.</p></noscript>" in ask(place).text


def test_requests_without_a_browser_leave_nothing(tmp_path: Path) -> None:
    errors = tmp_path / "errors"
    with errors.open("w") as file, served(command=(sys.executable, "-c", HASTY), errors=file) as (process, address):
        place = urlsplit(address).netloc
        wait_until_idle(process.pid)
        for _ in range(20):
            ask(place, "/?k=3")
        before = memory(process.pid)
        for _ in range(300):
            ask(place, "/?k=3")
        after = memory(process.pid)
        time.sleep(3)
        assert errors.read_text() == ""
    # A tab takes nearly 1 MB: all of them took 270.
    assert after - before < 30


def memory(pid: int) -> float:
    """Resident memory of a process [MB], from Linux's own tables."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def wait_until_idle(pid: int) -> None:
    """Wait until everything is compiled: until a process computes nothing for a second."""
    computed = -1
    while True:
        # The fields after the name in brackets; the 12th and 13th are the times computed [1/100 s].
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        now = int(fields[11]) + int(fields[12])
        if now - computed < 10:
            return
        computed = now
        time.sleep(1)


COUNT = """
import ctypes, sys, tempfile, threading
from erosion.explorer.computed import in_thread, share_memory
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.fopen.restype = ctypes.c_void_p
if sys.argv[1] == "shared":
    share_memory()
together = threading.Barrier(8)
def work():
    libc.malloc(1000)
    together.wait()
    libc.malloc(1000)
for future in [in_thread(work) for _ in range(8)]:
    future.result()
with tempfile.NamedTemporaryFile() as file:
    stream = ctypes.c_void_p(libc.fopen(file.name.encode(), b"w"))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    print(open(file.name).read().count("<heap nr="))
"""


def arenas(how: str) -> int:
    """How many arenas glibc has after eight threads at once."""
    usual = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    done = subprocess.run(
        [sys.executable, "-c", COUNT, how], env=usual, capture_output=True, text=True, timeout=60, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's way to give memory to threads")
def test_threads_share_their_memory() -> None:
    assert arenas("own") > 2
    assert arenas("shared") <= 2
