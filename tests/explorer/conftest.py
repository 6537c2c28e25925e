"""The explorer as a user starts it, and a browser to look at it."""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import IO, TYPE_CHECKING, Any

import pytest

from tests.explorer.driving import opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="session")
def expect() -> Any:
    """Playwright's assertions; busy machines compile for minutes."""
    playwright = importlib.import_module("playwright.sync_api")
    playwright.expect.set_options(timeout=60_000)
    return playwright.expect


# Playwright keeps an event loop at work in the thread, in which no test could run one of its own.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser_path = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser_path is None:
        (pytest.fail if "CI" in os.environ else pytest.skip)("there is no Chromium: apt-get install chromium")
    with importlib.import_module("playwright.sync_api").sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        yield browser
        browser.close()


def free_of_pytest() -> dict[str, str]:
    """The environment of a command: NiceGUI behaves differently where it believes that pytest runs it."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "NICEGUI"))}


COMMAND = (sys.executable, "-m", "erosion")


@contextlib.contextmanager
def served(
    *options: str, port: int = 0, command: Sequence[str] = COMMAND, errors: IO[str] | None = None
) -> Iterator[tuple[subprocess.Popen, str]]:
    """The running command, and the address that it prints; `errors` is a file for what it writes to stderr."""
    arguments = [*command, "explore", "--no-browser", "--port", str(port), *options]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=errors, text=True, env=free_of_pytest())
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(timeout=30)
        process.stdout.close()


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[subprocess.Popen, str]]:
    """The command without plug-ins."""
    with served() as running:
        yield running


@pytest.fixture
def address(server: tuple[subprocess.Popen, str]) -> str:
    return server[1]


@pytest.fixture(scope="module")
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, accept_downloads=True)
    context.set_default_timeout(180_000)
    yield context
    context.close()


@pytest.fixture
def page(context: BrowserContext, address: str) -> Iterator[Page]:
    """A page with the best angles, and with everything compiled that a slider moves."""
    yield opened(context, f"{address}?predict=false")
    for page in context.pages:
        page.close()
