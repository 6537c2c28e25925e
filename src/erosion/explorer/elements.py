"""The page's own elements: the methods that change them, and the events that they send."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from erosion.explorer.sliders import Range

_SHARES = Range(0.0, 1.0, 0.005)  # of the cut's time


def warn(sentence: str) -> None:
    """Show the reader a message, long enough to read it."""
    ui.notify(sentence, type="warning", multi_line=True, timeout=8000, close_button="Close")


class Field(ui.element, component="web/field.js"):
    """A parameter's entry and slider.

    Args:
        name: the parameter.
        symbol, meaning: the parameter's label.
        range_: the range of the slider's positions.
        on_slide: is called with the position.
        on_entry: is called with the text.
    """

    def __init__(
        self,
        name: str,
        symbol: str,
        meaning: str,
        range_: Range,
        on_slide: Callable[[float], None],
        on_entry: Callable[[str], None],
    ) -> None:
        super().__init__()
        labels = {"id": name, "symbol": symbol, "meaning": meaning}
        self.props.update(labels | {"low": range_.low, "high": range_.high, "step": range_.step})
        self.on("slide", partial(_tell, on_slide, range_))
        self.on("entry", lambda event: on_entry(str(event.args)))

    def show(self, text: str, unit: str, position: float) -> None:
        """Show a number, and remove the mark of a wrong entry."""
        self.run_method("show", text, unit, position)

    def complain(self, why: str) -> None:
        """Mark the entry as wrong and say why."""
        self.run_method("complain", why)


class Prose(ui.element, component="web/prose.js"):
    """HTML that changes often."""

    def draw(self, content: str, key: str) -> None:
        """Show the HTML; then the element's attribute `data-drawn` is `key`."""
        self.run_method("draw", content, key)


class Cut(ui.element, component="web/cut.js"):
    """The cut drawn to scale, as an animation.

    Args:
        instant: the time that is shown first, as a share of the cut's time.
        on_instant: is called with the time, as a share, at which the reader or the animation stops.
    """

    def __init__(self, instant: float, on_instant: Callable[[float], None]) -> None:
        super().__init__()
        self.props.update({"instant": instant})
        self.on("instant", partial(_tell, on_instant, _SHARES))

    def draw(self, content: Mapping[str, Any], key: str) -> None:
        """Draw a cut; then the element's attribute `data-drawn` is `key`."""
        self.run_method("draw", content, key)


class Plot(ui.element, component="web/plot.js"):
    """An ECharts plot with vertical handles.

    Args:
        height: the height of the plot, in CSS.
        follows: whether the fixed handles follow the time of the cut.
        range_: the range of the positions of a handle that the reader moves.
        on_pick: is called with the position to which the reader moves a handle.
    """

    def __init__(
        self,
        height: str,
        *,
        follows: bool = False,
        range_: Range | None = None,
        on_pick: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__()
        self.props.update({"height": height, "follows": follows})
        if range_ is not None and on_pick is not None:
            self.on("pick", partial(_tell, on_pick, range_))

    def draw(
        self, option: Mapping[str, Any] | None, handles: Sequence[Mapping[str, Any]], label: str, key: str
    ) -> None:
        """Draw an option of ECharts, or only move the handles if there is none; `key` is as of `Cut.draw`."""
        self.run_method("draw", option, handles, label, key)


def _tell(listener: Callable[[float], None], range_: Range, event: GenericEventArguments) -> None:
    """Tell the position that an event carries, moved into its range; the page sends nothing but numbers."""
    position = event.args
    if isinstance(position, int | float) and math.isfinite(position):
        listener(min(max(float(position), range_.low), range_.high))
