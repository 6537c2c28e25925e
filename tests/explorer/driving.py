"""What a hand does on the page, and what an eye sees there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

import erosion
from erosion.parameters.parameters import QUANTITIES

if TYPE_CHECKING:
    from playwright.sync_api import BrowserContext, Page

SLIDE = """([name, positions]) => {
  const slider = document.getElementById(name + '-slider');
  for (const position of positions) {
    slider.value = position;
    slider.dispatchEvent(new Event('input', { bubbles: true }));
  }
}"""

SERIES = """(view) => document.querySelector('.view-' + view + ' .plot').chart.getOption().series.map(
  (one) => ({ name: one.name, data: one.data, best: one.markPoint?.data?.[0]?.coord }))"""


SETTLED = """([name, shown]) => {
  if (document.getElementById(name + '-entry')?.value !== shown) return false;
  const keys = ['.view-cut .cut', '.view-volumes .plot', '.view-histories .plot']
    .map((view) => document.querySelector(view)?.dataset.drawn);
  const number = Number(new URLSearchParams(keys[0]).get(name)) * (name === 'alpha' ? 180 / Math.PI : 1);
  return keys.every((key) => key === keys[0]) && location.search.slice(1) === keys[0]
    && Math.abs(number - Number(shown)) <= 1e-5 * Math.abs(number);
}"""


# What is wider than its place, and is cut or scrolled there.
CUT = """() => [...document.querySelectorAll('.field-name, .plot-name, .plot-legend, .scroll, h2, .numbers td')]
  .filter((one) => one.scrollWidth > one.clientWidth + 1 && one.checkVisibility()).map((one) => one.innerText)"""


def opened(context: BrowserContext, address: str) -> Page:
    """A new page with everything compiled that a slider moves."""
    page = context.new_page()
    page.goto(address)
    page.wait_for_selector("main[data-ready=true]")
    return page


def slide(page: Page, name: str, *positions: float) -> None:
    """Move a parameter's slider, as fast as the browser can."""
    page.evaluate(SLIDE, [name, list(positions)])


def enter(page: Page, name: str, text: str) -> None:
    """Type a parameter's number."""
    page.fill(f"[id='{name}-entry']", text)
    page.press(f"[id='{name}-entry']", "Enter")


def settle(page: Page, name: str, shown: str) -> None:
    """Wait until a parameter shows this, and everything that moves with a slider and the link say so too."""
    page.wait_for_function(SETTLED, arg=[name, shown])


def parameters(page: Page) -> erosion.Parameters:
    """The parameters in the page's link."""
    query = {name: values[0] for name, values in parse_qs(urlsplit(page.url).query).items()}
    return erosion.Parameters(**{name: float(query[name]) for name in QUANTITIES}, shown_in=query["units"])


def curve(page: Page, view: str, model: str) -> np.ndarray:
    """What is drawn of a model, shape (points, 2), without the gaps."""
    # On a busy machine a model may be late, and left out until it answers.
    page.wait_for_function(f"([view, model]) => ({SERIES})(view).some((one) => one.name === model)", arg=[view, model])
    series = [one for one in page.evaluate(SERIES, view) if one["name"] == model]
    assert len(series) == 1
    return np.array([point for point in series[0]["data"] if None not in point], dtype=float)


def star(page: Page, model: str) -> Any:
    """Where a model's angle of greatest removal is drawn."""
    handle = page.wait_for_function(
        f"(model) => ({SERIES})('volumes').find((one) => one.name === model)?.best", arg=model
    )
    return handle.json_value()
