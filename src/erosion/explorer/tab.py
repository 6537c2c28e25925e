"""One browser tab: its state, controls, views and buttons, the work between them, and the files that it gives."""

import asyncio
import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any

from nicegui import background_tasks, ui

from erosion.explorer.computed import AT_ONCE, LATER, SPINS, Answers, Computed, Stage, Work, in_thread
from erosion.explorer.controls import Controls, CutDrawing, Materials, Plot, Prose, at_position, warn
from erosion.explorer.prompts import prompts
from erosion.explorer.state import PageState, sentence
from erosion.explorer.views import VIEWS
from erosion.models import State as Body, model_source, quantities
from erosion.output import to_json
from erosion.parameters import CaseFile, Dimension, dump_case, dump_model, dump_per_mass, exact_text, unit_size

_REST = 0.2  # s; the slower answers begin after this time without a change
_PATIENCE = 0.4  # s; a stage is drawn after this time, without the models that still compute
_OUTLINE = "dense no-caps outline"

_TITLES: Mapping[str, str] = {
    "cut": "The cut, to scale",
    "volumes": "Removed volume over the angle of attack",
    "numbers": "Numbers",
    "histories": "The tip over time",
    "end_times": "End of the cut over the angle of attack",
    "spins": "Best angle over the spin",
    "sensitivities": "What moves the best angle",
}
_NOTES = {"cut": "Only the tip cuts: what else of the grain would be in the metal is not drawn."}


_MOTION: Mapping[str, Dimension] = {
    "t": "time",
    "removed": "volume",
    "phi": "angle",
    "omega": "angular speed",
    **dict.fromkeys(("x", "y", "x_tip", "depth"), "length"),
    **dict.fromkeys(("vx", "vy", "vx_tip", "vdepth"), "speed"),
}


def results_json(answers: Answers, state: PageState) -> bytes:
    """The results of each checked model as `to_dict` has them, with its case, and those of the model drawn alone."""
    models = {}
    for name in state.models:
        point, best, curve, spins, turned = (
            answers(kind, name, state.case) for kind in ("point", "best", "curve", "spins", "turned")
        )
        models[name] = {
            "impact": point.to_dict()
            | state.per_mass.to_dict(point.volume, state.case.parameters())
            | {"turn": turned.turn[-1], "turned_beyond": turned.beyond[-1]},
            "best": best.to_dict(),
            "curve": curve.to_dict() | {"turn": turned.turn[:-1], "turned_beyond": turned.beyond[:-1]},
            "spins": {"s": SPINS, "alpha_max": spins.alpha},
        }
    cut, rates = (answers(kind, state.shown, state.case) for kind in ("cut", "sensitivities"))
    body = ("x", "y", "phi", "vx", "vy", "omega") if isinstance(cut.states, Body) else ()
    units = state.case.units
    motion = {name: getattr(cut, name) / unit_size(_MOTION[name], units)
              for name in ("t", "x_tip", "depth", "vx_tip", "vdepth", "removed", *body)}  # fmt: skip
    known = quantities(answers.model(state.shown, state.case))
    rates = {name: rate * known[name].size(units) for name, rate in rates.items()}
    shown = {"model": state.shown, "cut": cut.to_dict(), "motion": motion, "sensitivities": rates}
    return to_json({"models": models, "shown": shown}).encode()


def case_toml(answers: Answers, state: PageState) -> bytes:
    """The case with the model drawn and its own parameters, as a file for all verbs."""
    case = dump_case(state.case.parameters(), "From the explorer") + dump_per_mass(state.per_mass)
    source = model_source(answers.models[state.shown])
    own = {number.name: exact_text(number.value, number.quantity.dimension, state.case.units)
           for number in state.case.own if number.model == state.shown}  # fmt: skip
    return (case + dump_model(source or state.shown, own)).encode()


def python_lines(state: PageState, sources: Mapping[str, str]) -> str:
    """Lines of Python that compute the numbers of the page.

    Args:
        state: the state of the tab.
        sources: the argument of `erosion.load_model` for each model, by its name on the page.
    """
    models = {name: _python_model(sources[name], state.case.own_values(name)) for name in state.models}
    return f"""import numpy as np
import erosion

p = erosion.{state.case.parameters()!r}
for model in ({", ".join(models.values())},):
    hit = erosion.impact(model, p, derivatives=2)
    best = erosion.alpha_max(model, p)
    print(model, hit.volume, hit.dvolume, hit.t_c, hit.ended_by, np.rad2deg(best.alpha), best.kind)

cut = erosion.simulate({models[state.shown]}, p)
print(cut)
"""


def _python_model(source: str, own: Mapping[str, float]) -> str:
    """The Python expression of a model; without own parameters it is the model's name."""
    if not own:
        return repr(source)
    arguments = ", ".join(f"{name}={value!r}" for name, value in own.items())
    if not all(name.isidentifier() for name in own):  # "force.rate" cannot be a keyword argument in Python
        arguments = f"**{dict(own)!r}"
    return f"erosion.load_model({source!r}).replace({arguments})"


def cut_gif(answers: Answers, state: PageState) -> bytes:
    """The cut of the model drawn, as an animation."""
    from erosion.plotting.motion import animate_cut  # matplotlib, 0.7 s that the first page does without

    return animate_cut(answers("cut", state.shown, state.case))


Export = tuple[str, Callable[[Answers, PageState], bytes]]
FILES: Mapping[str, Export] = {
    "explorer.json": ("All numbers (JSON)", results_json),
    "case.toml": ("The case and its model (TOML)", case_toml),
    "cut.gif": ("The cut as an animation (GIF)", cut_gif),
}
"""What a tab exports, by the name of the file: its title, and the function that makes it."""


@dataclasses.dataclass(frozen=True)
class Service:
    """The data that all tabs share.

    Args:
        answers: the answers about all models.
        start: the state of a tab that is opened without a link.
        summaries: one line on each model, by name.
        sources: the argument of `erosion.load_model` for each model, by name.
        materials: the particles and targets that the page offers.
        file: the case file; where a fit wrote it, its doubts are on the page.
    """

    answers: Answers
    start: PageState
    summaries: Mapping[str, str]
    sources: Mapping[str, str]
    materials: Materials
    file: CaseFile | None = None

    def prepare(self) -> None:
        """Compute what a tab without a link shows first; this compiles the models."""
        for stage in AT_ONCE:
            self.answers.start(stage, self.start)


class Tab:
    """The page's elements, and the work that their events start.

    Args:
        service: the data that all tabs share.
        state: the first state.
    """

    def __init__(self, service: Service, state: PageState) -> None:
        self.service, self.state = service, state
        self._models = list(service.summaries)
        self._drawn: dict[str, Any] = {}
        self._following: asyncio.Task | None = None
        self._resting = self._changed = False
        self._late: set[Work] = set()
        with ui.element("header").classes("bar"):
            ui.html("erosion explorer", tag="h1", sanitize=False)
            self._status = ui.label().classes("status").props("role=status")
            self._sharing_buttons()
        with ui.element("main").classes("explorer") as self._main:
            with ui.element("section").classes("panel controls").props('aria-label="Parameters and models"'):
                self._controls = Controls(service.start, service.summaries, service.materials, self._go)
            with ui.element("div").classes("views"):
                with ui.element("section").classes("panel view-prompts").props('aria-label="Predictions"'):
                    prompts(lambda: self.state.case, self._reveal, opened=state.predict)
                self._elements = {name: self._view(name) for name in VIEWS}

    def begin(self) -> None:
        """Show the first state."""
        self._go(self.state)

    def say(self, sentence: str) -> None:
        """Show the reader a message."""
        with self._main:
            warn(sentence)

    def _sharing_buttons(self) -> None:
        """The buttons for the link and for exports."""
        ui.button("Copy link", icon="link", on_click=self._copy_link).props(_OUTLINE)
        with ui.button("Export", icon="download").props(_OUTLINE), ui.menu().props("max-height=95vh"):
            for file, (title, make) in FILES.items():
                ui.menu_item(title, partial(self._download, file, make))
            ui.menu_item("Python lines…", self._show_python)
        with ui.dialog() as self._python, ui.card().classes("panel"):
            self._lines = ui.code("", language="python").classes("w-full")
            with ui.row():
                ui.button("Close", on_click=self._python.close).props("dense no-caps flat")

    async def _download(self, file: str, make: Callable[..., bytes]) -> None:
        state = self.state
        try:
            content = await asyncio.wrap_future(in_thread(lambda: make(self.service.answers, state)))
        # A plug-in's own code may raise any error; the page shows the error and goes on.
        except Exception as error:  # noqa: BLE001
            ui.notify(f"{file}: {sentence(error)}", type="negative")
            return
        ui.download.content(content, file)

    async def _copy_link(self) -> None:
        query = json.dumps(f"/?{self.state.query()}")
        try:
            await ui.run_javascript(f"navigator.clipboard.writeText(location.origin + {query}).then(() => true)")
        except TimeoutError:
            ui.notify("The browser refused to copy the link; you find it in the address line.", type="negative")
            return
        ui.notify("Link copied.")

    def _show_python(self) -> None:
        self._lines.set_content(python_lines(self.state, self.service.sources))
        self._python.open()

    def _reveal(self) -> None:
        """Show the best angles."""
        self._go(dataclasses.replace(self.state, predict=False))

    def _view(self, name: str) -> Any:
        title = _TITLES[name]
        with ui.element("section").classes(f"panel view-{name}").props(f'aria-label="{title}"'):
            note = f" <small>{_NOTES[name]}</small>" if name in _NOTES else ""
            ui.html(title + note, tag="h2", sanitize=False)
            if name == "cut":
                return CutDrawing(
                    self.state.instant,
                    lambda instant: self._go(dataclasses.replace(self.state, instant=instant)),
                )
            if name == "numbers":
                return Prose()
            moved = {"volumes": "alpha", "end_times": "alpha", "spins": "phidot0"}.get(name)
            follows = name == "histories"
            return Plot("400px", follows=follows, moved=moved, on_pick=self._pick)

    def _pick(self, parameter: str, at: float) -> None:
        self._controls.change(lambda case: at_position(parameter, at, case, self.service.start.case))

    def _go(self, state: PageState) -> None:
        """Change to another state and show it."""
        self.state = state
        self._controls.show(state)
        self._main.props(f"data-predict={'true' if state.predict else 'false'}")
        self._follow_newest()

    def _follow_newest(self) -> None:
        """Show the state, or tell the task that shows an earlier one; slower answers give way to it."""
        if self._main.is_deleted:
            return
        self._changed = True
        if self._following is not None and self._resting:
            self._following.cancel()
        if self._following is None or self._following.done() or self._resting:
            self._resting = False
            self._following = background_tasks.create(self._follow(), context=self._main)

    async def _follow(self) -> None:
        """Draw the newest state until no newer one comes; at rest, write its link and compute the slower answers."""
        late: set[str] = set()
        try:
            while self._changed:
                self._changed = False
                late = await self._show(AT_ONCE)
                self._main.props(f"data-ready={'false' if late else 'true'}")
            self._resting = True
            await asyncio.sleep(_REST)
            ui.navigate.history.replace(f"/?{self.state.query()}")
            await self._show(LATER, late)
        except RuntimeError:
            # A tab that was closed meanwhile shows nothing.
            if not self._main.is_deleted:
                raise

    async def _show(self, stages: Iterable[Stage], late: Iterable[str] = ()) -> set[str]:
        """Compute and draw stages of the state without the models that are late; returns these."""
        state, late = self.state, set(late)
        for stage in stages:
            in_time = dataclasses.replace(state, models=tuple(model for model in state.models if model not in late))
            work = self.service.answers.start(stage, in_time)
            awaited = [asyncio.wrap_future(one.future) for one in work.values() if one not in self._late]
            if awaited:
                await asyncio.wait(awaited, timeout=_PATIENCE)
            late |= {model for model, one in work.items() if one.case != state.case or not one.future.done()}
            for one in {work[model] for model in late & work.keys()} - self._late:
                self._late.add(one)
                one.future.add_done_callback(partial(self._come, asyncio.get_running_loop(), one))
            computed = Computed.of(self.service.answers, state, self.service.file)
            self._draw(await asyncio.wrap_future(in_thread(partial(self._contents, computed, stage.views))), computed)
            computing = f"Computing {', '.join(sorted(late))} …"
            self._status.set_text(" · ".join([*computed.errors, *([computing] if late else [])]))
        return late

    def _come(self, loop: asyncio.AbstractEventLoop, work: Work, _: Future[None]) -> None:
        """Draw the answers of a model that was late, or compute the newest case now."""
        self._late.discard(work)
        with contextlib.suppress(RuntimeError):  # the server was stopped meanwhile
            loop.call_soon_threadsafe(self._follow_newest)

    def _contents(self, computed: Computed, views: Iterable[str]) -> dict[str, Any]:
        return {name: VIEWS[name](computed, self._models) for name in views}

    def _draw(self, contents: Mapping[str, Any], computed: Computed) -> None:
        if self._main.is_deleted:
            return
        key = computed.state.query()
        for name, content in contents.items():
            element = self._elements[name]
            if isinstance(element, Plot):
                option, handles, label = content
                unchanged = self._drawn.get(name) == option
                element.draw(None if unchanged else option, handles, label, key=key)
                self._drawn[name] = option
            else:
                element.draw(*content, key=key)
