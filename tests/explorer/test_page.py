"""The explorer in a real browser."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import erosion
from erosion.cli import exit_status
from erosion.explorer.prompts import PROMPTS
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from tests.explorer.conftest import free_of_pytest, served
from tests.explorer.driving import curve, enter, opened, parameters, settle, slide, star

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

# Numbers are drawn with 5 digits behind the point of readable units.
ATOL = 1e-5
PLUG_IN = str(Path(__file__).parent.parent.parent / "models" / "coulomb_tip.py")


@pytest.mark.browser
def test_sliders_change_the_plots_to_the_numbers_of_impact(page: Page, expect: Any) -> None:
    # Of two hundred rapid events the last one is shown.
    slide(page, "k", *np.random.default_rng(1).uniform(-0.5, 0.5, 199), -0.25)
    settle(page, "k", "0.9457")
    p = parameters(page)
    assert float(p.k) == 0.9457
    for model in ("rotating", "linearized"):
        # At the last angle, a hair short of 90°, t_c is steep.
        degrees, volume = curve(page, "volumes", model)[:-1].T
        hits = erosion.impact(model, p.replace(alpha=np.deg2rad(degrees)), derivatives=2)
        np.testing.assert_allclose(volume, hits.volume / 1e-4, atol=ATOL)
        np.testing.assert_allclose(curve(page, "end_times", model)[:-1, 1], hits.t_c / 1e-6, atol=ATOL)
        best = erosion.alpha_max(model, p)
        assert star(page, model) == pytest.approx([np.rad2deg(best.alpha), best.volume / 1e-4], rel=1e-9)
    row = page.locator(".numbers tr.shown")
    here = erosion.impact("linearized", p, derivatives=2)
    expect(row).to_contain_text(f"{here.t_c / 1e-6:.5g} µs")
    expect(row).to_contain_text(str(here.ended_by))
    expect(row).to_contain_text(str(best.kind))


@pytest.mark.browser
def test_the_cut_plays_and_is_scrubbed(page: Page, expect: Any) -> None:
    time = page.locator(".cut-time output")
    end = time.inner_text()
    page.get_by_role("button", name="Play").click()
    page.wait_for_function(f"() => document.querySelector('.cut-time output').innerText !== '{end}'")
    page.get_by_role("button", name="Pause").click()
    grain = page.locator(".cut .grain").get_attribute("points")
    page.get_by_label("Time in the cut").fill("0")
    expect(time).to_have_text("t = 0.00 µs")
    assert page.locator(".view-histories .plot-handle").first.get_attribute("aria-valuenow") == "0"
    assert page.locator(".cut .grain").get_attribute("points") != grain


@pytest.mark.browser
def test_the_angle_is_dragged_in_the_plot(page: Page) -> None:
    handle = page.get_by_role("slider", name="angle of attack, in the plot").first
    box = handle.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 40, steps=5)
    page.wait_for_function("() => Number(document.getElementById('alpha-entry').value) > 25")
    # What is drawn meanwhile leaves it in the hand.
    page.mouse.move(box["x"] + 120, box["y"] + 40, steps=5)
    page.mouse.up()
    # Asked in one look: two questions may find two states of a page that still follows the hand.
    page.wait_for_function(
        """() => {
          const [entry, slider] = ['entry', 'slider'].map((part) => document.getElementById('alpha-' + part).value);
          const handle = document.querySelector('.view-volumes .plot-handle').ariaValueNow;
          return Number(entry) > 30 && entry === slider && entry === handle;
        }"""
    )


@pytest.mark.browser
def test_everything_works_by_keyboard(page: Page) -> None:
    page.focus("#alpha-slider")
    page.keyboard.press("ArrowRight")
    settle(page, "alpha", "20.25")
    page.get_by_role("slider", name="angle of attack, in the plot").first.focus()
    page.keyboard.press("ArrowLeft")
    settle(page, "alpha", "20")
    page.focus("#alpha-entry")
    page.keyboard.press("ControlOrMeta+A")
    page.keyboard.type("30\n")
    settle(page, "alpha", "30")
    unnamed = page.evaluate(
        """() => [...document.querySelectorAll('input, button, [role=slider], [role=checkbox], [role=img]')]
        .filter((e) => e.offsetParent && !e.labels?.length && !e.ariaLabel && !e.innerText.trim())
        .map((e) => e.outerHTML)"""
    )
    assert unnamed == []


@pytest.mark.browser
def test_a_link_carries_the_whole_state(page: Page, expect: Any) -> None:
    page.get_by_role("checkbox", name="as-printed", exact=True).click()
    page.get_by_role("checkbox", name="finnie", exact=True).click()
    page.get_by_role("button", name="si", exact=True).click()
    enter(page, "v0", "0.12345678901234567 km/s")
    page.get_by_label("Time in the cut").fill("0.5")
    page.wait_for_url("**&instant=0.5&predict=false")
    settle(page, "v0", "123.457")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy link").click()
    expect(page.get_by_text("Link copied.")).to_be_visible()
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == page.url
    other = opened(page.context, link)
    settle(other, "v0", "123.457")
    assert other.url == page.url
    for control in ("output", ".numbers tr.shown th", ".models input", ".models [aria-checked]", ".cut .grain"):
        said = "all => all.map(one => one.ariaChecked ?? one.value ?? one.getAttribute('points') ?? one.innerText)"
        assert other.locator(control).evaluate_all(said) == page.locator(control).evaluate_all(said)
    assert float(parameters(other).v0) == 123.45678901234567
    assert parameters(other).shown_in == "si"
    np.testing.assert_array_equal(curve(other, "volumes", "as-printed"), curve(page, "volumes", "as-printed"))


CLOSED = LinearizedCut()
BAD_INPUT = [
    ("v0", "fast", "must be a speed"),
    ("v0", "-3", "must be positive and finite, but is -3"),
    ("alpha", "95", "must be in degrees, above 0 and up to 90"),
    ("k", "2 kg", "must be a pure number"),
    ("phidot0", "nan", "must be a finite number"),
    ("sigma", "", "must be a stress"),
]


@pytest.mark.browser
def test_the_energy_of_the_cut_is_shared_out(page: Page, expect: Any) -> None:
    """At the end of a cut without rotation the lost energy is that of the closed form."""
    settle(page, "alpha", "20")
    end = CLOSED.state(CLOSED.t_c(TABLE_1), TABLE_1)
    left = float(end.vx**2 + end.vy**2) / TABLE_1.v0**2
    expect(page.locator(".cut-energy")).to_contain_text(f"motion of the centre {100 * left:.0f} %")
    expect(page.locator(".cut-energy")).to_contain_text(f"lost by the body {100 * (1 - left):.0f} %")
    expect(page.locator(".cut .velocity polygon")).to_have_count(1)


@pytest.mark.browser
def test_the_best_angles_are_shown_when_all_are_predicted(context: BrowserContext, address: str, expect: Any) -> None:
    page = opened(context, address)
    best = page.locator(".numbers tr.shown td").nth(5)
    expect(best).to_contain_text("?")
    asked = [page.locator(".prompt", has_text=prompt.question) for prompt in PROMPTS]
    for prompt, element in zip(PROMPTS, asked, strict=True):
        expect(page.locator(".view-sensitivities")).to_be_hidden()
        page.get_by_role("tab", name=f"Question {prompt.number}").click()
        expect(element.locator(".prompt-answer")).to_have_text("")
        element.locator(".q-radio").nth(1).click()
        expect(element.locator(".prompt-answer")).to_contain_text(
            "Yes." if prompt.right == 1 else f"No: {prompt.choices[prompt.right]}"
        )
    asked[-1].locator(".q-radio").nth(2).click()
    expect(asked[-1].locator(".prompt-answer")).to_contain_text("from 31.72° to 37.98°")
    page.get_by_role("tab", name="Question 4").click()
    expect(asked[0].locator(".half-angle")).to_contain_text("α = 31.72°")
    expect(best).to_contain_text("at 31.72°")
    expect(page.locator(".view-sensitivities")).to_be_visible()
    assert star(page, "linearized")[0] == pytest.approx(31.717474411, abs=1e-6)
    page.wait_for_url("**predict=false")


@pytest.mark.browser
def test_bad_input_marks_the_field_and_changes_nothing(page: Page, expect: Any) -> None:
    settle(page, "alpha", "20")
    before = page.url
    for name, text, why in BAD_INPUT:
        good = page.input_value(f"#{name}-entry")
        enter(page, name, text)
        expect(page.locator(f"#{name}-why")).to_contain_text(why)
        assert page.get_attribute(f"#{name}-entry", "aria-invalid") == "true"
        slide(page, "b", 0.1)
        # Or the slides may come after what is entered next.
        page.wait_for_function("document.querySelector('#b-entry').value !== '0.04'")
        slide(page, "b", 0)
        settle(page, "b", "0.04")
        assert page.url == before
        page.press(f"#{name}-entry", "Escape")
        assert page.input_value(f"#{name}-entry") == good
        expect(page.locator(f"#{name}-why")).to_be_empty()


@pytest.mark.browser
def test_two_tabs_have_separate_states(page: Page, address: str) -> None:
    other = opened(page.context, address)
    slide(page, "k", 0.5)
    slide(other, "alpha", 60)
    settle(page, "k", "8.944")
    settle(other, "alpha", "60")
    assert page.input_value("#alpha-entry") == "20"
    assert other.input_value("#k-entry") == "2"
    assert curve(page, "volumes", "linearized")[:, 1].max() != curve(other, "volumes", "linearized")[:, 1].max()


@pytest.mark.browser
def test_presets_and_reset(page: Page, expect: Any) -> None:
    far = page.locator(".view-numbers").get_by_text("g/kg is far from what tests on ductile metals find at 112 m/s")
    expect(far).to_have_count(0)  # nobody asks for amounts of the scenario's case
    page.get_by_role("button", name="Metal").click()
    page.get_by_text("copper", exact=True).click()
    settle(page, "sigma", "10000")
    page.get_by_role("button", name="Metal").click()
    page.get_by_text("aluminium 6061", exact=True).click()
    settle(page, "sigma", "152190")
    assert page.input_value("#psi-entry") == "2"
    expect(far).to_be_visible()
    page.get_by_role("button", name="Spin").click()
    page.get_by_text("s = −0.25").click()
    settle(page, "phidot0", "-27500")
    page.get_by_role("button", name="Reset").click()
    settle(page, "sigma", "200000")
    # r, b, m and β follow from a named particle's size; a decimal comma is understood.
    page.get_by_role("button", name="Particle").click()
    page.get_by_label("material").click()
    page.get_by_role("option", name="garnet").click()
    page.get_by_label("diameter").fill("0,3 mm")
    page.get_by_role("button", name="Use").click()
    settle(page, "r", "0.00590551")
    assert page.input_value("#b-entry") == "0.00590551"
    assert page.input_value("#inertia-entry") == "0.4"
    assert float(page.input_value("#m-entry")) == pytest.approx(4190 * np.pi / 6 * 3e-4**3 / 175.1268, rel=1e-5)
    # What was entered badly stays in view to be mended. A menu that still closes would take no click.
    expect(page.get_by_label("diameter")).to_have_count(0)
    page.get_by_role("button", name="Particle").click()
    page.get_by_label("diameter").fill("-1 mm")
    page.get_by_role("button", name="Use").click()
    expect(page.get_by_text("The size must be positive and finite")).to_be_visible()
    expect(page.get_by_label("diameter")).to_have_value("-1 mm")
    page.get_by_label("diameter").press("Escape")
    expect(page.get_by_label("diameter")).to_have_count(0)
    page.get_by_role("button", name="Reset").click()
    settle(page, "r", "0.04")
    assert page.input_value("#phidot0-entry") == "0"


@pytest.mark.browser
def test_exports_say_what_the_page_says(page: Page, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    enter(page, "alpha", "33.3")
    settle(page, "alpha", "33.3")

    def download(title: str) -> Path:
        page.get_by_role("button", name="Export").click()
        with page.expect_download() as download:
            page.get_by_text(title, exact=True).click()
        path = tmp_path / download.value.suggested_filename
        download.value.save_as(path)
        return path

    exported = json.loads(download("All numbers (JSON)").read_text())
    case = download("The case and its model (TOML)")
    capsys.readouterr()
    assert exit_status(["run", str(case), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    numbers = {name: quantity["value"] for name, quantity in printed["case"]["parameters"].items()}
    drawn = exported["models"]["linearized"]
    assert drawn["impact"]["parameters"] == {"units": printed["units"], **numbers}
    assert drawn["impact"]["volume"] == pytest.approx(printed["result"]["volume"]["value"], rel=1e-9)
    assert exported["shown"]["motion"]["removed"][-1] == pytest.approx(drawn["impact"]["volume"], rel=1e-9)
    assert download("The cut as an animation (GIF)").read_bytes().startswith(b"GIF89a")


@pytest.mark.browser
def test_a_plug_in_has_sliders_of_its_own_parameters(context: BrowserContext, expect: Any) -> None:
    with served("--model", PLUG_IN) as (_, address):
        page = opened(context, address)
        group = page.get_by_role("group", name="Parameters of coulomb_tip")
        expect(group.get_by_label("coefficient of friction").first).to_have_value("0.2")
        slide(page, "coulomb_tip.friction", 0.3)
        settle(page, "coulomb_tip.friction", "0.4913")  # 0.2 · 20^0.3
        model = erosion.load_model(PLUG_IN).replace(friction=0.4913)
        degrees, volume = curve(page, "volumes", "coulomb_tip")[:-1].T
        hits = erosion.impact(model, parameters(page).replace(alpha=np.deg2rad(degrees)), derivatives=2)
        np.testing.assert_allclose(volume, hits.volume / 1e-4, atol=ATOL)
        page.get_by_role("button", name="Reset").click()
        settle(page, "coulomb_tip.friction", "0.2")
        page.get_by_role("checkbox", name="coulomb_tip").click()
        expect(group).to_be_hidden()
        page.wait_for_url(lambda url: "coulomb_tip" not in url)
        page.close()


@pytest.mark.browser
def test_all_parts_of_the_page_come_from_this_machine(page: Page, address: str) -> None:
    asked = []
    other = page.context.new_page()
    other.on("request", lambda request: asked.append(request.url))
    other.goto(address)
    other.wait_for_selector("main[data-ready=true]")
    own = (address, address.replace("http", "ws"), "data:", "blob:")
    assert len(asked) > 10
    assert [url for url in asked if not url.startswith(own)] == []


@pytest.mark.browser
def test_a_link_with_a_script_is_text(page: Page, address: str, expect: Any) -> None:
    page.goto(f"{address}?models=<img src=x onerror=window.bad=1>")
    expect(page.get_by_text("Field `models` names '<img src=x onerror=window.bad=1>'")).to_be_visible()
    assert page.evaluate("[window.bad, document.querySelectorAll('img').length]") == [None, 0]
    page.goto(f"{address}?v0=1 m/s*9**9**9**9")
    expect(page.get_by_text("The link cannot be used: Field `v0` must be a speed")).to_be_visible()
    page.goto(f"{address}?alpha={'9' * 50_000}")
    expect(page.get_by_text("The link cannot be used: Field `alpha`")).to_be_visible()


HANGUP = pytest.mark.skipif(
    not hasattr(signal, "SIGHUP") or signal.getsignal(signal.SIGHUP) == signal.SIG_IGN, reason="POSIX, without nohup"
)


@pytest.mark.browser
@pytest.mark.parametrize("name", ["SIGINT", pytest.param("SIGHUP", marks=HANGUP)])
def test_stopping_it_while_it_compiles_says_one_line(browser: Browser, tmp_path: Path, name: str) -> None:
    # Nothing kept, so that there is something to compile.
    env = free_of_pytest() | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "erosion", "explore", "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as process:
        assert process.stdout is not None
        page = browser.new_page()
        try:
            # It compiles from now on, for seconds; its progress may be shown too shortly to be waited for.
            page.goto(process.stdout.readline().strip(), wait_until="commit")
            process.send_signal(getattr(signal, name))
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
            page.close()
    assert said == "erosion: interrupted\n"
    assert process.returncode == 130
