"""The buttons that copy the link and export figures, data, the case and Python lines."""

import asyncio
import dataclasses
import json
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from erosion.explorer import exports
from erosion.explorer.answers import Answers
from erosion.explorer.state import State
from erosion.explorer.threads import in_thread
from erosion.explorer.wording import sentence

_OUTLINE = "dense no-caps outline"


class Sharing:
    """The buttons for the link, for exports, and for the dark page.

    Args:
        answers: the answers about all models.
        sources: the argument of `erosion.load_model` for each model, by name.
        state: returns the tab's present state.
        go: is called with the state that the reader asks for.
    """

    def __init__(
        self, answers: Answers, sources: Mapping[str, str], state: Callable[[], State], go: Callable[[State], None]
    ) -> None:
        self._answers, self._sources, self._state, self._go = answers, sources, state, go
        ui.button("Copy link", icon="link", on_click=self._copy_link).props(_OUTLINE)
        with ui.button("Export", icon="download").props(_OUTLINE), ui.menu().props("max-height=95vh"):
            for name, title in exports.FIGURES.items():
                for suffix in ("svg", "png"):
                    self._item(f"{title} ({suffix.upper()})", f"{name}.{suffix}", exports.figure, name, suffix)
            ui.separator()
            self._item("Curves over α (CSV)", "curves.csv", exports.curves_csv)
            self._item("Motion of the model drawn (CSV)", "motion.csv", exports.motion_csv)
            self._item("All numbers (JSON)", "explorer.json", exports.results_json)
            ui.separator()
            self._item("The case (TOML)", "case.toml", lambda _, state: exports.case_toml(state))
            ui.menu_item("Python lines…", self._show_python)
        ui.button("Dark", icon="contrast", on_click=self._toggle_dark).props(_OUTLINE)
        with ui.dialog() as self._python, ui.card().classes("panel"):
            self._lines = ui.code("", language="python").classes("w-full")
            with ui.row():
                ui.button("Close", on_click=self._python.close).props("dense no-caps flat")

    def _item(self, title: str, file: str, make: Callable[..., bytes], *arguments: Any) -> None:
        async def download() -> None:
            state = self._state()
            try:
                content = await asyncio.wrap_future(in_thread(lambda: make(*arguments, self._answers, state)))
            # A plug-in's own code may raise any error; the page shows the error and goes on.
            except Exception as error:  # noqa: BLE001
                ui.notify(f"{file}: {sentence(error)}", type="negative")
                return
            ui.download.content(content, file)

        ui.menu_item(title, download)

    async def _copy_link(self) -> None:
        query = json.dumps(f"/?{self._state().query()}")
        try:
            await ui.run_javascript(f"navigator.clipboard.writeText(location.origin + {query}).then(() => true)")
        except TimeoutError:
            ui.notify("The browser refused to copy the link; you find it in the address line.", type="negative")
            return
        ui.notify("Link copied.")

    async def _toggle_dark(self) -> None:
        # Only the browser knows whether it prefers a dark page.
        dark = bool(await ui.run_javascript("Quasar.Dark.isActive"))
        self._go(dataclasses.replace(self._state(), dark=not dark))

    def _show_python(self) -> None:
        self._lines.set_content(exports.python_lines(self._state(), self._sources))
        self._python.open()
