"""The parts that all plots share: axes, lines, handles."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from erosion.explorer.answers import ANGLES
from erosion.explorer.sliders import ANGLES as ANGLE_SLIDER
from erosion.explorer.state import State
from erosion.impacts.impact import Impact
from erosion.parameters.parameters import QUANTITIES
from erosion.plotting.colors import STYLES
from erosion.plotting.curves import broken

Option = dict[str, Any]

STAR = "path://M0,-10L2.9,-3.1L10,-3.1L4.3,1.5L6.2,8.6L0,4.4L-6.2,8.6L-4.3,1.5L-10,-3.1L-2.9,-3.1Z"
LEGEND = {"top": 0, "type": "scroll", "selectedMode": False}  # only the state decides what is drawn
DEGREES = np.rad2deg(ANGLES)


def styles(models: Collection[str]) -> Mapping[str, tuple[str, Any]]:
    """Colour and dashes of every model; they do not depend on which models are checked."""
    return {
        model: (color, "solid" if dashes == "-" else [3 * length for length in dashes[1]])
        for model, (color, dashes) in zip(models, (STYLES[i % len(STYLES)] for i in range(len(models))), strict=True)
    }


def axis(name: str, **more: Any) -> Option:
    """An axis of numbers with its name beside it."""
    return {"type": "value", "name": name, "nameLocation": "middle", "nameGap": 30, "axisLine": {"show": True},
            "nameTextStyle": {"fontSize": 14}} | more  # fmt: skip


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
        "grid": {"left": 62, "right": 18, "top": 52, "bottom": 50},
        "legend": LEGEND,
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


def angle_handle(state: State) -> Option:
    """The handle at the state's angle, which the reader can drag."""
    quantity, degrees = QUANTITIES["alpha"], float(np.rad2deg(state.case.numbers()["alpha"]))
    return {
        "x": degrees,
        "movable": True,
        "low": ANGLE_SLIDER.low,
        "high": ANGLE_SLIDER.high,
        "step": ANGLE_SLIDER.step,
        "label": f"{quantity.meaning}, in the plot",
        "text": f"{degrees:.4g}°",
    }
