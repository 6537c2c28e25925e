"""An explorer that other devices reach: the link, the code, and who lacks them."""

import http.client
import re
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, expect

from erosion.explorer.state import Address
from tests.explorer.conftest import served
from tests.explorer.driving import enter, opened, settle, slide
from tests.explorer.test_access import SOCKET, UPGRADE, Answer, ask


@pytest.fixture(scope="module")
def link() -> Iterator[str]:
    """The link of an explorer on all addresses of this machine; it names the one that is always there."""
    with served("--host", "0.0.0.0") as (_, link):
        yield re.sub(r"//[^/]+:", "//127.0.0.1:", link)


@pytest.fixture(scope="module")
def place(link: str) -> str:
    return urlsplit(link).netloc


@pytest.fixture(scope="module")
def cookie(link: str, place: str) -> str:
    """What a device that opened the link sends along."""
    path = link.partition(place)[2]
    return str(ask(place, path).headers["Set-Cookie"]).partition(";")[0]


def refused(answer: Answer) -> bool:
    return answer.status == 403 and answer.text.startswith(
        "Scan the code or open the link that `erosion explore` shows"
    )


def test_the_link_lets_a_device_in_and_leaves_the_address_line(link: str, place: str) -> None:
    answer = ask(place, link.partition(place)[2] + "&k=3")
    assert answer.status == 303
    assert answer.headers["Location"] == "/?k=3"
    given = str(answer.headers["Set-Cookie"])
    assert "HttpOnly" in given
    assert "SameSite=lax" in given
    other = ask(place, "//evil.example/" + link.partition(place)[2].removeprefix("/"))
    assert other.headers["Location"] == "/evil.example/"
    cookie = given.partition(";")[0]
    assert ask(place, "/?k=3", {"Cookie": cookie}).status == 200
    assert ask(place, SOCKET + "websocket", {**UPGRADE, "Cookie": cookie}).status == 101


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=AAAAAAAAAAAAAAAAAAAAAA", "/_nicegui/", SOCKET + "polling"])
def test_a_device_without_the_link_is_refused(place: str, path: str) -> None:
    assert refused(ask(place, path))
    assert refused(ask(place, path, {"Cookie": f"erosion-{urlsplit('//' + place).port}=wrong"}))
    assert refused(ask(place, path, {"Cookie": '\\"=;;='}))


def test_a_websocket_without_the_cookie_is_refused(place: str, link: str) -> None:
    assert refused(ask(place, SOCKET + "websocket", UPGRADE))
    # A link's token is for pages: another site cannot put it into the address of a websocket.
    token = urlsplit(link).query
    assert refused(ask(place, f"{SOCKET}websocket&{token}", UPGRADE))


def test_an_invited_device_is_refused_to_another_page(place: str, cookie: str) -> None:
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
        assert ask(place, "/", {"Cookie": cookie, **headers}).status == 403


def test_the_address_of_the_network_is_answered(place: str, cookie: str) -> None:
    printed = Address("0.0.0.0", int(place.rpartition(":")[2]), "t").link
    host = urlsplit(printed).netloc
    try:
        answer = ask(host, "/", {"Cookie": cookie})
    except (OSError, http.client.HTTPException):
        pytest.skip("this machine has no network")
    assert answer.status == 200


@pytest.mark.browser
def test_a_phone_and_a_tablet_at_once(browser: Browser, link: str) -> None:
    phone = browser.new_context(viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    tablet = browser.new_context(viewport={"width": 1024, "height": 768}, has_touch=True)
    pages = [opened(context, link) for context in (phone, tablet)]
    assert not any("token" in page.url for page in pages)
    slide(pages[0], "k", -0.25)
    enter(pages[1], "k", "3,5")
    settle(pages[0], "k", "0.9457")
    settle(pages[1], "k", "3.5")
    # The curve that a slider moves is in view beside the last of the sliders.
    pages[0].evaluate("document.getElementById('phidot0-slider').scrollIntoView({ block: 'end' })")
    box = pages[0].locator(".view-volumes .plot").bounding_box()
    assert box is not None
    assert box["y"] >= 0
    assert box["y"] + box["height"] < 422
    for page in pages:
        # Nothing is wider than the screen.
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        page.get_by_role("button", name="Invite").tap()
        expect(page.get_by_role("img", name="QR code of the link")).to_be_visible()
        expect(page.locator(".invitation-link")).to_have_text(re.compile(r"http://.+/\?token=[\w-]{22}"))
    expect(pages[0].get_by_role("button", name="Full screen")).to_be_hidden()
    pages[1].get_by_role("button", name="Close").tap()
    pages[1].get_by_role("button", name="Full screen").tap()
    pages[1].wait_for_function("!!document.fullscreenElement")
    for context in (phone, tablet):
        context.close()


@pytest.mark.browser
def test_an_explorer_of_this_machine_invites_nobody(browser: Browser) -> None:
    with served() as (_, address):
        page = browser.new_page()
        page.goto(address)
        expect(page.get_by_role("button", name="Full screen")).to_be_visible()
        assert page.get_by_role("button", name="Invite").count() == 0
        page.close()
