"""The German page: no English word is left on it, and its numbers have decimal commas."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from erosion.models import available_models
from tests.explorer.conftest import served
from tests.explorer.driving import CUT, enter

pytestmark = pytest.mark.slow

# Texts, names and titles of all elements, also of closed menus and of what a canvas draws.
WORDS = """() => {
  const texts = [...document.querySelectorAll('body *:not(script):not(style)')].flatMap((one) => [
    ...[...one.childNodes].filter((node) => node.nodeType === 3).map((node) => node.textContent),
    one.ariaLabel, one.title, one.getAttribute('aria-valuetext')]);
  const drawn = [...document.querySelectorAll('.plot')].flatMap((plot) => {
    const option = plot.chart.getOption();
    const named = [...option.xAxis, ...option.yAxis, ...option.series].map((part) => part.name);
    return [...named, ...option.series.flatMap((one) => (one.markArea?.data ?? []).map((area) => area[0].name))];
  });
  return [...new Set([...texts, ...drawn].filter(Boolean).map((text) => text.trim()))];
}"""
SAME = {"erosion explorer", "inch-pound", "slinch", "mil", "lbf", "in²", "rad", "max",
        "fullscreen", "download", "link", "contrast", "arrow_drop_down"}  # fmt: skip


def words(page: Page) -> set[str]:
    """What the page says with letters, after its menus were opened."""
    for menu in page.locator(".presets button, .bar button").all():
        if menu.locator("i").filter(has_text=re.compile("arrow_drop_down|download")).count():
            menu.click()
            page.wait_for_selector(".q-menu")
            yet = set(page.evaluate(WORDS))
            page.keyboard.press("Escape")
            page.wait_for_selector(".q-menu", state="detached")
            menu.evaluate("(one, texts) => { one.dataset.texts = texts.join('\\n'); }", list(yet))
    opened = page.evaluate(
        "() => [...document.querySelectorAll('[data-texts]')].flatMap((m) => m.dataset.texts.split('\\n'))"
    )
    texts = {*page.evaluate(WORDS), *opened}
    return {text for text in texts if re.search(r"[^\W\d_]{3}", text)}


@pytest.fixture(scope="module")
def pages(browser: Browser) -> Iterator[dict[str, Page]]:
    with served("--lang", "de") as (_, german), served() as (_, english):
        context = browser.new_context(viewport={"width": 1366, "height": 768})
        context.set_default_timeout(180_000)
        pages = {}
        for lang, address in (("de", german), ("en", english)):
            pages[lang] = context.new_page()
            pages[lang].goto(address)
            pages[lang].wait_for_selector("main[data-ready=true]")
            pages[lang].wait_for_function(
                "() => [...document.querySelectorAll('.plot')].every((plot) => plot.chart.getOption()?.series?.length)"
            )
        yield pages
        context.close()


def test_no_english_is_left_on_the_german_page(pages: dict[str, Page]) -> None:
    in_both = words(pages["de"]) & words(pages["en"])
    same = re.compile("|".join(map(re.escape, sorted({*available_models(), *SAME}, key=len, reverse=True))))
    assert [text for text in sorted(in_both) if re.search(r"[^\W\d_]{3}", same.sub("", text))] == []


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1366, 768), (390, 844)])
def test_long_german_words_are_not_cut(pages: dict[str, Page], width: int, height: int) -> None:
    page = pages["de"]
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_timeout(300)
    assert page.evaluate(CUT) == []


def test_numbers_have_decimal_commas_and_are_read_so(pages: dict[str, Page]) -> None:
    page = pages["de"]
    said = page.locator("main.explorer").inner_text()
    assert re.findall(r"\d\.(?!\d{3}\b)\d", said) == []
    assert page.input_value("#m-entry") == pages["en"].input_value("#m-entry").replace(".", ",")
    enter(page, "alpha", "20,125")
    page.wait_for_url("**&alpha=0.3512*")
    assert page.input_value("#alpha-entry") == "20,125"
    enter(page, "alpha", "200")
    page.wait_for_selector("#alpha-why:text('muss in Grad angegeben sein, größer als 0 und höchstens 90; es ist 200.')")
