"""The elements by which the reader changes parameters and models."""

import dataclasses
import html
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from nicegui import ui

from erosion.explorer.elements import Field, warn
from erosion.explorer.materials import Materials
from erosion.explorer.sliders import SPIN_PRESETS, at_position, position, range_of, text_of, unit_of, with_spin
from erosion.explorer.state import Case, State
from erosion.explorer.views.look import styles
from erosion.explorer.wording import sentence
from erosion.parameters.materials import Target
from erosion.parameters.parameters import QUANTITIES, TABLE_1
from erosion.parameters.per_mass import PerMass
from erosion.parameters.units import SYSTEMS

_ORDER = ("alpha", *(name for name in QUANTITIES if name != "alpha"))


class Controls:
    """Presets, the parameters of the case and of the checked models, and the list of models.

    Args:
        start: the state that "Reset" shows; its case is at the middle of the sliders.
        summaries: one line on each model, by name.
        materials: the particles and targets of the menus.
        go: is called with the state that the reader asks for.
    """

    def __init__(
        self, start: State, summaries: Mapping[str, str], materials: Materials, go: Callable[[State], None]
    ) -> None:
        self._start, self._go, self._state = start, go, start
        self._showing = False
        self._shown_fields: dict[str, tuple[str, str, float]] = {}
        with ui.element("div").classes("presets"):
            ui.button("Reset", on_click=self._reset).props("dense no-caps outline")
            ui.button("Table 1", on_click=self._table_1).props("dense no-caps outline")
            self._particle_menu(materials)
            with ui.button("Metal").props("dense no-caps outline icon-right=arrow_drop_down"), ui.menu():
                for name, metal in materials.targets.items():
                    ui.menu_item(name, on_click=lambda _, metal=metal: self._metal(metal)).tooltip(metal.source)
            with ui.button("Spin").props("dense no-caps outline icon-right=arrow_drop_down"), ui.menu():
                for s in SPIN_PRESETS:
                    ui.menu_item(
                        f"s = {s:g}".replace("-", "−"), on_click=lambda _, s=s: self.change(partial(with_spin, s))
                    )
            self._units = ui.toggle(list(SYSTEMS), value=start.case.units, on_change=self._convert)
            self._units.props('dense no-caps unelevated aria-label="Units"')
        self._fields = {name: self._field(name) for name in _ORDER}
        self._groups = {model: self._group(model) for model in dict.fromkeys(number.model for number in start.case.own)}
        with ui.element("div").classes("models").props('role=group aria-label="Models"'):
            ui.html("Models", tag="h2", sanitize=False)
            self._shown = ui.select(list(start.models), label="model drawn", value=start.shown)
            self._shown.props("dense options-dense").on_value_change(self._draw_other)
            self._boxes = {name: self._box(name, summaries) for name in summaries}

    def show(self, state: State) -> None:
        """Show a state. The changed elements send events, which are ignored meanwhile."""
        self._showing, self._state = True, state
        first = self._start.case.to(state.case.units)
        for name, field in self._fields.items():
            shown = text_of(name, state.case), unit_of(name, state.case), position(name, state.case, first)
            if self._shown_fields.get(name) != shown:
                field.show(*shown)
                self._shown_fields[name] = shown
        for model, group in self._groups.items():
            group.set_visibility(model in state.models)
        self._units.set_value(state.case.units)
        for name, box in self._boxes.items():
            box.set_value(name in state.models)
        # New options make the browser lay out the whole page again.
        if self._shown.options != list(state.models):
            self._shown.set_options(list(state.models), value=state.shown)
        self._shown.set_value(state.shown)
        self._showing = False

    def change(self, change: Callable[[Case], Case]) -> bool:
        """Show what a function makes of the case; if this is no valid case, say why and show the case again.

        Returns:
            Whether it is a valid case.
        """
        try:
            case = change(self._state.case)
        except ValueError as error:
            warn(sentence(error))
            self._go(self._state)
            return False
        self._go(dataclasses.replace(self._state, case=case))
        return True

    def _group(self, model: str) -> ui.element:
        """The fields of a model's own parameters."""
        with ui.element("div").props("role=group") as group:
            # The name of a plug-in's file may hold quotes and ends of lines, which a text of properties cannot.
            group.props["aria-label"] = f"Parameters of {model}"
            ui.html(html.escape(model), tag="h2", sanitize=False)
            keys = [number.key for number in self._start.case.own if number.model == model]
            self._fields |= {key: self._field(key) for key in keys}
        return group

    def _field(self, name: str) -> Field:
        quantity = self._start.case.quantities()[name]

        def slide(at: float) -> None:
            first = self._start.case.to(self._state.case.units)
            self._ask(name, lambda: at_position(name, at, self._state.case, first))

        def entry(text: str) -> None:
            self._ask(name, lambda: self._state.case.read(name, text))

        return Field(name, quantity.symbol, quantity.meaning, range_of(name), slide, entry)

    def _ask(self, name: str, case: Callable[[], Case]) -> None:
        """Show a case; if it is not valid, say why at the parameter."""
        self._shown_fields.pop(name, None)
        try:
            state = dataclasses.replace(self._state, case=case())
        except ValueError as error:
            self._fields[name].complain(sentence(error).removeprefix(f"Field `{name}` "))
            return
        self._go(state)

    def _box(self, name: str, summaries: Mapping[str, str]) -> ui.checkbox:
        with ui.element("div").classes("model"):
            ui.html(f"<i style='background:{styles(summaries)[name][0]}'></i>", sanitize=False)
            box = ui.checkbox(name, on_change=lambda event: self._check(name, bool(event.value))).props("dense")
            box.tooltip(summaries[name])
        return box

    def _check(self, name: str, checked: bool) -> None:
        if self._showing:
            return
        states = {model: model in self._state.models for model in self._boxes} | {name: checked}
        models = tuple(model for model, is_checked in states.items() if is_checked)
        if not models:
            ui.notify("At least one model must stay checked.")
            self.show(self._state)
            return
        self._go(self._state.checking(models))

    def _draw_other(self, event: Any) -> None:
        if not self._showing and event.value in self._state.models:
            self._go(dataclasses.replace(self._state, shown=event.value))

    def _convert(self, event: Any) -> None:
        if not self._showing:
            self.change(lambda case: case.to(event.value))

    def _reset(self) -> None:
        self._go(dataclasses.replace(self._start, instant=self._state.instant, dark=self._state.dark))

    def _table_1(self) -> None:
        state = self._state
        case = state.case.with_parameters(TABLE_1.to(state.case.units))
        self._go(dataclasses.replace(state, case=case, per_mass=PerMass()))

    def _metal(self, metal: Target) -> None:
        self._go(self._state.of_metal(metal))

    def _particle_menu(self, materials: Materials) -> None:
        """A material and a size, from which r, b, m and β follow."""

        def use() -> None:
            def of(case: Case) -> Case:
                grit = materials.sized(str(material.value), str(size.value), case.units)
                return case.with_parameters(case.parameters().with_particle(grit))

            if self.change(of):
                menu.close()

        with (
            ui.button("Particle").props("dense no-caps outline icon-right=arrow_drop_down"),
            ui.menu() as menu,
            ui.element("div").classes("particle"),
        ):
            names = list(materials.particles)
            material = ui.select(names, value=names[0], label="material").props("dense options-dense")
            size = ui.input("diameter", value="0.3 mm").props("dense").on("keydown.enter", use)
            ui.button("Use", on_click=use).props("dense no-caps unelevated")
