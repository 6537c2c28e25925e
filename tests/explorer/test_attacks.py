"""The explorer in a browser, against pages, links, files and accidents that mean it no good."""

import functools
import http.server
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.documents import Written
from tests.explorer.conftest import served
from tests.explorer.driving import enter, opened, settle
from tests.explorer.test_page import PLUG_IN

pytestmark = pytest.mark.browser

FOREIGN = """<!doctype html><iframe src="{address}"></iframe><script>
const tried = {{}};
const attempt = async (name, way) => {{
  try {{ tried[name] = await way(); }} catch (error) {{ tried[name] = "refused"; }}
}};
const open = (url) => new Promise((done) => {{
  const socket = new WebSocket(url);
  socket.onmessage = () => done("read");
  socket.onerror = () => done("refused");
}});
(async () => {{
  const socket = "{place}/_nicegui_ws/socket.io/?EIO=4&transport=";
  await attempt("page", async () => (await fetch("{address}")).text());
  await attempt("polling", async () => (await fetch("http://" + socket + "polling")).text());
  await attempt("credentials", async () => (await fetch("{address}", {{ credentials: "include" }})).text());
  await attempt("websocket", () => open("ws://" + socket + "websocket"));
  window.tried = tried;
}})();
</script>"""


@pytest.fixture
def foreign(address: str, tmp_path: Path) -> Iterator[str]:
    """The address of another page of this machine, which tries to read and to drive the explorer."""
    (tmp_path / "index.html").write_text(FOREIGN.format(address=address, place=urlsplit(address).netloc))
    handler = functools.partial(Silent, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


class Silent(http.server.SimpleHTTPRequestHandler):
    """Serves files without a word."""

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Say nothing."""


def test_another_page_can_neither_show_nor_read_nor_drive_it(context: BrowserContext, foreign: str) -> None:
    page = context.new_page()
    page.goto(foreign)
    page.wait_for_function("() => window.tried")
    assert page.evaluate("window.tried") == dict.fromkeys(["page", "polling", "credentials", "websocket"], "refused")
    assert page.frames[1].locator(".explorer").count() == 0
    assert page.frames[1].url.startswith("chrome-error:")
    page.close()


def test_the_name_of_a_plug_in_is_text(context: BrowserContext, written: Written) -> None:
    name = '<img src=x onerror=window.bad=1>, "it\'s" 100%\n{{ 7*7 }}'
    path = written(f"{name}.py", Path(PLUG_IN).read_text())
    with served("--model", str(path)) as (_, address):
        page = opened(context, address)
        enter(page, f"{name}.friction".replace("'", "\\'").replace("\n", "\\a "), "0.3")
        page.wait_for_url("**friction=0.3**")
        other = opened(context, page.url)
        for each in (page, other):
            expect(each.get_by_role("group", name="Parameters of <img src=x onerror=window.bad=1>")).to_be_visible()
            expect(each.locator(".numbers tr.shown th")).to_contain_text("<img src=x")
            expect(each.locator(".q-notification")).to_have_count(0)
            assert each.evaluate("[window.bad, document.querySelectorAll('img').length]") == [None, 0]
        assert other.url == page.url
        for each in (page, other):
            each.close()


def test_a_link_with_a_script_is_text(page: Page, address: str) -> None:
    page.goto(f"{address}?models=<img src=x onerror=window.bad=1>")
    expect(page.get_by_text("Field `models` names '<img src=x onerror=window.bad=1>', but the page")).to_be_visible()
    page.goto(f"{address}?<img src=x onerror=window.bad=1>=1")
    expect(page.get_by_text("Field `<img src` is unknown")).to_be_visible()
    assert page.evaluate("[window.bad, document.querySelectorAll('img').length]") == [None, 0]


def test_a_link_that_could_never_be_read_stops_nobody(page: Page, address: str) -> None:
    page.goto(f"{address}?v0=1 m/s*9**9**9**9")
    expect(page.get_by_text("The link cannot be used: Field `v0` must be a speed")).to_be_visible()
    page.goto(f"{address}?alpha={'9' * 50_000}")
    expect(page.get_by_text("The address must have at most 16000 characters, but has 50007.")).to_be_visible()
    page.goto(f"{address}?alpha=30deg")
    settle(page, "alpha", "30")


def test_a_page_outlives_its_server(context: BrowserContext) -> None:
    with served() as (process, address):
        page = opened(context, f"{address}?k=3")
        enter(page, "alpha", "30")
        settle(page, "alpha", "30")
        process.send_signal(signal.SIGKILL)
        expect(page.locator("#popup")).to_be_visible()
        expect(page.locator("#popup")).to_contain_text("Connection lost")
    with served(port=urlsplit(address).port or 0):
        expect(page.locator("#popup")).to_be_hidden()
        page.wait_for_selector("main[data-ready=true]")
        settle(page, "alpha", "30")
        assert page.input_value("#k-entry") == "3"
    page.close()
