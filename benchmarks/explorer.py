"""The explorer in a browser: how soon it is ready, and how soon a slider's move is drawn.

    python -m benchmarks.explorer [--moves 60]

Needs the `explorer` extra, Playwright and Chromium. The first start finds no compiled program
kept, the second those of the first.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from tests.explorer.driving import SLIDE_AND_TIME

_VIEWS = ["cut", "volumes", "histories", "end_times"]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="The explorer in a browser.")
    parser.add_argument("--moves", type=int, default=60, help="of each slider")
    moves = parser.parse_args().moves
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as kept, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for start in ("nothing kept", "programs kept"):
            _measure(browser, start, kept, moves if start == "programs kept" else 0)
        browser.close()


def _measure(browser: Browser, start: str, kept: str, moves: int) -> None:
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    env["XDG_CACHE_HOME"] = kept
    begun = time.perf_counter()
    command = [sys.executable, "-m", "erosion", "explore", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
    assert process.stdout is not None
    try:
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.set_default_timeout(120_000)
        page.goto(process.stdout.readline().strip())
        visible = time.perf_counter() - begun
        page.wait_for_function("document.querySelector('.view-volumes .plot')?.dataset.drawn")
        first = time.perf_counter() - begun
        page.wait_for_selector("main[data-ready=true]")
        ready = time.perf_counter() - begun
        print(f"{start}: page after {visible:.1f} s, first plots {first:.1f} s, three models ready {ready:.1f} s")
        if moves:
            page.wait_for_function("!document.querySelector('.status .q-linear-progress')?.offsetParent")
            for name in ("alpha", "k", "v0"):
                _slide(page, name, moves)
        page.close()
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def _slide(page: Page, name: str, moves: int) -> None:
    low, high = (20, 70) if name == "alpha" else (-0.3, 0.3)
    times: list[Any] = []
    for n in range(moves):
        times.append(page.evaluate(SLIDE_AND_TIME, [name, low + (high - low) * n / moves, _VIEWS]))
        time.sleep(0.05)
    tenths = statistics.quantiles(times, n=10)
    print(f"{name}: slider to plots, median {statistics.median(times):.0f} ms, nine of ten within {tenths[-1]:.0f} ms")


if __name__ == "__main__":
    main()
