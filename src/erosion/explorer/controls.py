"""The page's sliders, fields and plots by which the reader changes parameters and models."""

import dataclasses
import html
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from erosion.explorer.computed import ANGLES
from erosion.explorer.state import PageCase, PageState, sentence, with_point
from erosion.impacts import Impact
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    SYSTEMS,
    TABLE_1,
    Particle,
    PerMass,
    Quantity,
    System,
    Target,
    known_particles,
    known_targets,
    particle,
    read_quantity,
    target,
)
from erosion.plotting.labels import STYLES, broken

_FACTOR = 20.0  # a slider reaches from 1/20 to 20 times the first value, if this value is positive
_DIGITS = 4  # of the numbers that a slider sets


class SliderRange(NamedTuple):
    """Ends and step of a slider, in units of its position."""

    low: float
    high: float
    step: float


ANGLE_SLIDER = SliderRange(0.25, 90.0, 0.25)  # degrees
SPINS = SliderRange(-1.0, 1.0, 0.01)  # s = r φ̇₀/v₀
# Exponents of `_FACTOR`, which multiplies the first value. If the first value of an own parameter is not positive:
# distances from the first value, as shares of its size; of a value of 0, as shares of the case's parameter of the
# same dimension: a speed reaches from -v₀ to v₀.
FACTORS = SliderRange(-1.0, 1.0, 0.005)
SPIN_PRESETS = (-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5)


def range_of(name: str) -> SliderRange:
    """The positions of a parameter's slider."""
    return {"alpha": ANGLE_SLIDER, "phidot0": SPINS}.get(name, FACTORS)


def position(name: str, case: PageCase, first: PageCase) -> float:
    """The position of a parameter's slider; a number out of range puts the slider at its end.

    Args:
        name: the parameter.
        case: the case that is shown.
        first: the case at the middle of all sliders.
    """
    ends = range_of(name)
    return float(np.clip(_place(name, case, first), ends.low, ends.high))


def _place(name: str, case: PageCase, first: PageCase) -> float:
    numbers, middle = case.numbers(), first.numbers()[name]
    if name == "alpha":
        return float(np.rad2deg(numbers["alpha"]))
    if name == "phidot0":
        return numbers["phidot0"] * numbers["r"] / numbers["v0"]
    if middle <= 0:
        return (numbers[name] - middle) / _size(name, first)
    return np.log(numbers[name] / middle) / np.log(_FACTOR) if numbers[name] > 0 else -np.inf


def at_position(name: str, at: float, case: PageCase, first: PageCase) -> PageCase:
    """Set a parameter to the number at its slider's position, rounded to few digits."""
    if name == "alpha":
        return case.replace(alpha=float(np.deg2rad(_rounded(at))))
    if name == "phidot0":
        return with_spin(at, case)
    middle = first.numbers()[name]
    moved = middle * _FACTOR**at if middle > 0 else middle + at * _size(name, first)
    least = next((number.least for number in case.own if number.key == name), 0.0)
    size = first.quantities()[name].size(case.units)
    return case.replace(**{name: middle if at == 0 else max(_rounded(moved / size) * size, least)})


def with_spin(s: float, case: PageCase) -> PageCase:
    """Set the spin to s = r φ̇₀/v₀."""
    numbers = case.numbers()
    return case.replace(phidot0=_rounded(s * numbers["v0"] / numbers["r"]))


def entry_of(name: str, case: PageCase, first: PageCase) -> tuple[str, str]:
    """The text of a parameter's entry and the unit beside it, which is that of the first number and stays."""
    scale = first.scale(name)
    text = f"{case.numbers()[name] / scale.size:.6g}"
    return re.sub(r"e([+-])0*", lambda sign: "e" + sign[1].strip("+"), text), scale.unit


def _size(name: str, first: PageCase) -> float:
    numbers, dimension = first.numbers(), first.quantities()[name].dimension
    alike = (numbers[other] for other, quantity in QUANTITIES.items() if quantity.dimension == dimension != "1")
    return abs(numbers[name]) or next(alike, 1.0)


def _rounded(number: float) -> float:
    return float(f"{number:.{_DIGITS}g}")


_SHARES = SliderRange(0.0, 1.0, 0.005)  # of the cut's time


def warn(sentence: str) -> None:
    """Show the reader a message, long enough to read it."""
    ui.notify(sentence, type="warning", multi_line=True, timeout=8000, close_button="Close")


class Field(ui.element, component="web/field.js"):
    """A parameter's entry and slider.

    Args:
        name: the parameter.
        quantity: its symbol and its meaning.
        on_slide: is called with the position.
        on_entry: is called with the text.
    """

    def __init__(
        self, name: str, quantity: Quantity, on_slide: Callable[[float], None], on_entry: Callable[[str], None]
    ) -> None:
        super().__init__()
        labels = {"id": name, "symbol": quantity.symbol, "meaning": quantity.meaning}
        self.props.update(labels | range_of(name)._asdict())
        self.on("slide", partial(_tell, on_slide, range_of(name)))
        self.on("entry", lambda event: on_entry(str(event.args)))

    def show(self, text: str, unit: str, position: float) -> None:
        """Show a number, and remove the mark of a wrong entry."""
        self.run_method("show", text, unit, position)

    def complain(self, why: str) -> None:
        """Mark the entry as wrong and say why."""
        self.run_method("complain", why)


class Drawn(ui.element):
    """An element that the browser draws."""

    def draw(self, *content: Any, key: str) -> None:
        """Draw what a view gives; then the element's attribute `data-drawn` is `key`."""
        self.run_method("draw", *content, key)


class Prose(Drawn, component="web/prose.js"):
    """HTML that changes often."""


class CutDrawing(Drawn, component="web/cut.js"):
    """The cut drawn to scale, as an animation.

    Args:
        instant: the time that is shown first, as a share of the cut's time.
        on_instant: is called with the time, as a share, at which the reader or the animation stops.
    """

    def __init__(self, instant: float, on_instant: Callable[[float], None]) -> None:
        super().__init__()
        self.props["instant"] = instant
        self.on("instant", partial(_tell, on_instant, _SHARES))


class Plot(Drawn, component="web/plot.js"):
    """An ECharts plot with vertical handles; without an option to draw, only the handles move.

    Args:
        height: the least height of the plot, in CSS; a legend of many lines adds to it.
        follows: whether the fixed handles follow the time of the cut.
        moved: the parameter that a handle moves, if the reader can drag one.
        on_pick: is called with this parameter and the position to which the reader drags the handle.
    """

    def __init__(self, height: str, *, follows: bool, moved: str | None, on_pick: Callable[[str, float], None]) -> None:
        super().__init__()
        self.props.update({"height": height, "follows": follows})
        if moved is not None:
            self.on("pick", partial(_tell, partial(on_pick, moved), range_of(moved)))


def _tell(listener: Callable[[float], None], range_: SliderRange, event: GenericEventArguments) -> None:
    """Tell the position that an event carries, moved into its range; the page sends nothing but numbers."""
    position = event.args
    if isinstance(position, int | float) and math.isfinite(position):
        listener(min(max(float(position), range_.low), range_.high))


@dataclasses.dataclass(frozen=True)
class Materials:
    """What the menus list.

    Args:
        particles: by name; their size is chosen on the page.
        targets: by name.
    """

    particles: Mapping[str, Particle]
    targets: Mapping[str, Target]

    def sized(self, name: str, size: str, bare: System) -> Particle:
        """A particle by its name, of a size as text; a bare number has the unit of the system `bare`.

        Raises:
            ValueError: for a size that cannot be read or is not positive.
        """
        try:
            metres = read_quantity(with_point("size", size), "length", bare)
        except ValueError as error:
            raise ValueError(f"The size {str(error).rstrip('.')}.") from error
        if not 0 < metres < math.inf:
            raise ValueError(f"The size must be positive and finite, but is {briefly(size)}.")
        return dataclasses.replace(self.particles[name], size=metres)


def read_materials(files: Sequence[Path] = ()) -> Materials:
    """The package's table, and those of the user's own files before it.

    Raises:
        ValueError: for a file that cannot be used.
    """
    particles: dict[str, Particle] = {}
    targets: dict[str, Target] = {}
    for file in (*files, None):
        where = "" if file is None else f"{file}: "
        for name in known_particles(file):
            particles.setdefault(name, particle(f"{where}{name} 1 mm"))
        for name in known_targets(file):
            targets.setdefault(name, target(f"{where}{name}"))
    return Materials(particles, targets)


Option = dict[str, Any]

STAR = "path://M0,-10L2.9,-3.1L10,-3.1L4.3,1.5L6.2,8.6L0,4.4L-6.2,8.6L-4.3,1.5L-10,-3.1L-2.9,-3.1Z"
DEGREES = np.rad2deg(ANGLES)


def styles(models: Collection[str]) -> Mapping[str, tuple[str, Any]]:
    """Colour and dashes of every model; they do not depend on which models are checked."""
    return {
        model: (color, "solid" if dashes == "-" else [3 * length for length in dashes[1]])
        for model, (color, dashes) in zip(models, (STYLES[i % len(STYLES)] for i in range(len(models))), strict=True)
    }


def axis(name: str, **more: Any) -> Option:
    """An axis of numbers with its name."""
    return {"type": "value", "name": name, "axisLine": {"show": True}} | more


def angle_axis() -> Option:
    """α from 0° to 90°."""
    quantity = QUANTITIES["alpha"]
    ticks = {"interval": 15, "axisLabel": {"formatter": "{value}°"}}
    return axis(f"{quantity.symbol}  {quantity.meaning}", min=0, max=90, **ticks)


def line(name: str, x: np.ndarray, y: np.ndarray, color: str, dashes: Any = "solid", **more: Any) -> Option:
    """A curve with a gap at every NaN."""
    style = {"color": color, "type": dashes, "width": 2.4}
    look = {"lineStyle": style, "itemStyle": {"color": color}, "symbol": "none", "animation": False}
    return {"type": "line", "name": name, "data": points(x, y)} | look | more


def points(x: np.ndarray, y: np.ndarray) -> list[list[float | None]]:
    """Pairs of numbers, rounded to the digits that a plot shows; None stands for NaN and infinity."""
    pairs = np.column_stack([x, y]).astype(float).round(5)
    drawn = pairs.astype(object)
    drawn[~np.isfinite(pairs)] = None
    return drawn.tolist()


def frame(x_axis: Any, y_axis: Any, series: list[Option], **more: Any) -> Option:
    """A plot of one panel."""
    return {
        "animation": False,
        "grid": {"left": 50, "right": 18, "top": 24, "bottom": 26},
        "tooltip": {"trigger": "axis", "confine": True, "transitionDuration": 0},
        "xAxis": x_axis,
        "yAxis": y_axis,
        "series": series,
    } | more


def gaps(curve: Impact) -> np.ndarray:
    """The indices in `ANGLES` just before which the curve jumps."""
    degrees, _ = broken(DEGREES, curve.volume, np.deg2rad(1) * curve.dvolume)
    at = np.flatnonzero(np.isnan(degrees))
    return at - np.arange(at.size)


def handle(name: str, case: PageCase) -> Option:
    """The handle at a parameter's number, which the reader can drag along the axis of its slider's positions."""
    at, text = _place(name, case, case), "{:.4g}°" if name == "alpha" else "s = {:.3g}"
    return {
        "x": at,
        "movable": True,
        **range_of(name)._asdict(),
        "label": f"{QUANTITIES[name].meaning}, in the plot",
        "text": text.format(at),
    }


_MENU = "dense no-caps outline icon-right=arrow_drop_down"
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
        self,
        start: PageState,
        summaries: Mapping[str, str],
        materials: Materials,
        go: Callable[[PageState], None],
    ) -> None:
        self._start, self._go, self._state = start, go, start
        self._showing = False
        self._shown_fields: dict[str, tuple[str, str, float]] = {}
        with ui.element("div").classes("presets"):
            ui.button("Reset", on_click=self._reset).props("dense no-caps outline")
            ui.button("Table 1", on_click=self._table_1).props("dense no-caps outline")
            self._particle_menu(materials)
            with ui.button("Metal").props(_MENU), ui.menu():
                for name, metal in materials.targets.items():
                    item = ui.menu_item(name, partial(self._take_metal, name, metal))
                    item.tooltip(metal.source)
            with ui.button("Spin").props(_MENU), ui.menu():
                for s in SPIN_PRESETS:
                    ui.menu_item(f"s = {s:g}".replace("-", "−"), partial(self.change, partial(with_spin, s)))
            self._units = ui.toggle(list(SYSTEMS), value=start.case.units, on_change=self._convert)
            self._units.props('dense no-caps unelevated aria-label="Units"')
        self._fields = {name: self._field(name) for name in _ORDER}
        self._groups = {model: self._group(model) for model in dict.fromkeys(number.model for number in start.case.own)}
        with ui.element("div").classes("models").props('role=group aria-label="Models"'):
            ui.html("Models", tag="h2", sanitize=False)
            self._shown = ui.select(list(start.models), label="model drawn", value=start.shown)
            self._shown.props("dense options-dense").on_value_change(self._draw_other)
            self._boxes = {name: self._box(name, summaries) for name in summaries}

    def show(self, state: PageState) -> None:
        """Show a state. The changed elements send events, which are ignored meanwhile."""
        self._showing, self._state = True, state
        first = self._start.case.to(state.case.units)
        for name, field in self._fields.items():
            text, unit = entry_of(name, state.case, first)
            shown = text, unit, position(name, state.case, first)
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

    def change(self, change: Callable[[PageCase], PageCase], complain: Callable[[str], None] | None = None) -> bool:
        """Show what a function makes of the case; if this is no valid case, say why.

        Returns:
            Whether it is a valid case.
        """
        try:
            state = dataclasses.replace(self._state, case=change(self._state.case))
        except ValueError as error:
            (complain or self._warn)(sentence(error))
            return False
        self._go(state)
        return True

    def _warn(self, why: str) -> None:
        warn(why)
        self._go(self._state)

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

        def ask(change: Callable[[PageCase], PageCase]) -> None:
            self._shown_fields.pop(name, None)
            self.change(change, lambda why: self._fields[name].complain(why.removeprefix(f"Field `{name}` ")))

        def slide(at: float) -> None:
            ask(lambda case: at_position(name, at, case, self._start.case.to(case.units)))

        def entry(text: str) -> None:
            ask(lambda case: case.read(name, text, self._start.case.to(case.units)))

        return Field(name, quantity, slide, entry)

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
        self._go(dataclasses.replace(self._start, instant=self._state.instant, predict=self._state.predict))

    def _table_1(self) -> None:
        state = self._state
        case = state.case.with_parameters(TABLE_1.to(state.case.units))
        self._go(dataclasses.replace(state, case=case, per_mass=PerMass()))

    def _take_metal(self, name: str, metal: Target) -> None:
        state = self._state.of_metal(metal)
        ui.notify(f"{name}: {state.changes(self._state) or 'no number changed'}")
        self._go(state)

    def _particle_menu(self, materials: Materials) -> None:
        """A material and a size, from which r, b, m and β follow."""

        def use() -> None:
            def of(case: PageCase) -> PageCase:
                grit = materials.sized(str(material.value), str(size.value), case.units)
                return case.with_parameters(case.parameters().with_particle(grit))

            if self.change(of):
                menu.close()

        with (
            ui.button("Particle").props(_MENU),
            ui.menu() as menu,
            ui.element("div").classes("particle"),
        ):
            names = list(materials.particles)
            material = ui.select(names, value=names[0], label="material").props("dense options-dense")
            size = ui.input("diameter", value="0.3 mm").props("dense").on("keydown.enter", use)
            ui.button("Use", on_click=use).props("dense no-caps unelevated")
