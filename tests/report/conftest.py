"""A browser, to print pages with."""

from tests.explorer.conftest import browser as browser
