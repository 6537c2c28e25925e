"""V(α) with its maxima, jumps and regimes; and t_c(α) with its candidates (Laverty, Figure 9)."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from erosion.explorer.computed import Computed
from erosion.explorer.views.look import (
    DEGREES,
    STAR,
    Option,
    angle_axis,
    angle_handle,
    axis,
    frame,
    gaps,
    line,
    styles,
)
from erosion.optimum.alpha_max import Optimum
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.plotting.colors import DIM, ENDS
from erosion.plotting.curves import describe, with_gaps
from erosion.plotting.labels import AT_CONTACT, EVENT_LABELS

_SHALLOW = 5.0  # degrees
_APART = 0.05  # of the longest cut; neighbouring times that differ by more belong to different crossings


def volumes(computed: Computed, models: Collection[str]) -> tuple[Option, list[Option], str]:
    """V(α) of the checked models, the angle's handle, and a description in words."""
    largest = [float(np.nanmax(curve.volume, initial=0.0)) for curve in computed.curves.values()]
    scale = readable_scale("volume", computed.state.case.units, max(largest, default=0.0))
    series = []
    for model, curve in computed.in_order(computed.curves):
        color, dashes = styles(models)[model]
        best = computed.best.get(model)
        marks = {} if best is None else _marks(best, scale.size, color, shown=model == computed.state.shown)
        degrees, volume = with_gaps(gaps(curve), DEGREES, curve.volume / scale.size)
        series.append(line(model, degrees, volume, color, dashes, **marks))
        cuts = np.any(curve.t_c > 0)
        if model == computed.state.shown and cuts and curve.volume_at_contact.any():
            at_contact, area = curve.volume_at_contact / scale.size, {"opacity": 0.2, "color": color}
            thin = {"color": color, "width": 0}
            series.append(line(AT_CONTACT, DEGREES, at_contact, color, areaStyle=area, lineStyle=thin, z=1))
    quantity = RESULTS["volume"]
    y_axis = axis(f"{quantity.symbol}  {quantity.meaning}  [{scale.unit}]", min=0, nameGap=38)
    maxima = [f"{model} removes most {describe(best)}" for model, best in computed.in_order(computed.best)]
    label = "; ".join([f"{quantity.meaning} over the angle of attack", *maxima])
    return frame(angle_axis(), y_axis, series), [angle_handle(computed.state)], label


def end_times(computed: Computed, models: Collection[str]) -> tuple[Option, list[Option], str]:
    """t_c(α) of the checked models, and both candidates of the model shown."""
    curves = computed.curves
    # Near 0° the cuts of some models last longer and longer; their times would flatten all other curves.
    longest = [float(np.nanmax(curve.t_c[DEGREES > _SHALLOW], initial=0.0)) for curve in curves.values()]
    largest = max(longest, default=0.0)
    scale = readable_scale("time", computed.state.case.units, largest)
    series = []
    for model, curve in computed.in_order(curves):
        color, dashes = styles(models)[model]
        degrees, t_c = with_gaps(gaps(curve), DEGREES, curve.t_c / scale.size)
        series.append(line(model, degrees, t_c, color, dashes))
    for event, times in (computed.ends or {}).items():
        color = ENDS.get(event, DIM)
        label = EVENT_LABELS.get(event, event)
        thin = {"color": color, "type": [4, 4], "width": 1.8}
        # No line is drawn across the jump of a candidate.
        before = np.flatnonzero(np.abs(np.diff(times)) > _APART * largest) + 1
        degrees, times = with_gaps(before, DEGREES, times / scale.size)
        series.append(line(label, degrees, times, color, lineStyle=thin, z=1))
    quantity = RESULTS["t_c"]
    top = {"max": float(f"{1.5 * largest / scale.size:.1g}")} if largest else {}
    y_axis = axis(f"{quantity.symbol}  {quantity.meaning}  [{scale.unit}]", min=0, nameGap=38, **top)
    shown = computed.state.shown
    label = f"{quantity.meaning} over the angle of attack; dashed, when each event alone would end the cut of {shown}"
    return frame(angle_axis(), y_axis, series), [angle_handle(computed.state)], label


def _marks(best: Optimum, size: float, color: str, *, shown: bool) -> Mapping[str, Any]:
    """A star at the maximum, hollow if the maximum is only approached; the jumps; the regimes of the model shown."""
    jumps = [
        [{"coord": [float(np.rad2deg(jump.alpha)), end / size]} for end in (jump.below, jump.above)]
        for jump in best.jumps
    ]
    dashes = {"color": color, "type": [2, 3], "width": 1.4}
    marks: dict[str, Any] = {"markLine": {"silent": True, "symbol": "none", "lineStyle": dashes, "data": jumps}}
    if best.kind != "none" and np.isfinite(best.value):
        fill = {"color": color if best.attained else "transparent", "borderColor": color, "borderWidth": 2}
        at = {"coord": [float(np.rad2deg(best.alpha)), float(best.value) / size], "itemStyle": fill}
        marks["markPoint"] = {"silent": True, "symbol": STAR, "symbolSize": 18, "label": {"show": False}, "data": [at]}
    if shown:
        areas = [
            [
                {"xAxis": float(np.rad2deg(regime.low)), "name": regime.ended_by,
                 "itemStyle": {"color": ENDS.get(regime.ended_by, DIM), "opacity": 0.09}},
                {"xAxis": float(np.rad2deg(regime.high))},
            ]
            for regime in best.regimes
        ]  # fmt: skip
        label = {"position": "top", "color": "inherit", "fontSize": 13}
        marks["markArea"] = {"silent": True, "label": label, "data": areas}
    return marks
