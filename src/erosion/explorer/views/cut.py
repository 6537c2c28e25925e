"""The cut as a picture to scale, and the tip's histories (Laverty, Figures 7 and 8)."""

from collections.abc import Collection

import numpy as np

from erosion.explorer.computed import Computed
from erosion.explorer.views.look import LEGEND, Option, axis, line
from erosion.models.base import State as Body
from erosion.parameters.scales import Scale, readable_scale
from erosion.parameters.units import System, unit_name
from erosion.plotting.colors import PALETTE
from erosion.plotting.labels import HISTORIES, NOTHING
from erosion.trajectory.trajectory import Trajectory

_PANELS = ((0, 0), (1, 0), (0, 1), (1, 1))
_NOTHING: Option = {"t": [], "x": [], "depth": [], "phi": [], "bar": None, "label": "not computed yet"}


def cut(computed: Computed, models: Collection[str]) -> tuple[Option]:
    """The data that the cut's element draws, in lengths that read well."""
    motion = computed.cut
    if motion is None:
        return (_NOTHING,)
    p = motion.p
    time = readable_scale("time", p.units, motion.t_c)
    length = readable_scale("length", p.units, float(np.max(np.abs(motion.x_tip))) or float(p.r))
    phi = motion.phi if isinstance(motion.states, Body) else np.full(motion.t.shape, np.pi / 2)
    bar = _round_length(float(p.r) / length.size)
    content = {
        "t": motion.t.tolist(),
        "x": (motion.x_tip / length.size).tolist(),
        "depth": (motion.depth / length.size).tolist(),
        "phi": phi.tolist(),
        "size": float(p.r) / length.size,
        "unit": time.size,
        "units": time.unit,
        "bar": {"size": bar, "text": _length(bar, length, p.units)},
        "label": f"{computed.state.shown}: {_sentence(motion)}",
    }
    return (content,)


def histories(computed: Computed, models: Collection[str]) -> tuple[Option, list[Option], str]:
    """x, y, ẋ and ẏ of the tip over time in four panels, each with a handle at the time that is shown."""
    motion = computed.cut
    if motion is None:
        return {"series": []}, [], "not computed yet"
    time = readable_scale("time", motion.p.units, motion.t_c)
    body = motion.states if isinstance(motion.states, Body) else None
    turns = body is not None and not np.allclose(body.x, motion.x_tip, rtol=1e-9, atol=0)
    t = motion.t / time.size
    series, x_axes, y_axes, grids = [], [], [], []
    for i, ((of_body, of_tip, quantity), (column, row)) in enumerate(zip(HISTORIES, _PANELS, strict=True)):
        tip = getattr(motion, of_tip)
        scale = readable_scale(quantity.dimension, motion.p.units, float(np.max(np.abs(tip))))
        grids.append({"left": f"{column * 50 + 13}%", "width": "34%", "top": f"{row * 47 + 12}%", "height": "31%"})
        x_axes.append(axis(f"t [{time.unit}]" if row else "", gridIndex=i, min=0, max=float(t[-1]) or 1, nameGap=24,
                           axisLabel={"showMaxLabel": False}, splitNumber=4))  # fmt: skip
        y_axes.append(axis(f"{quantity.symbol}  [{scale.unit}]", gridIndex=i, nameLocation="end", nameGap=10,
                           splitNumber=3, nameTextStyle={"align": "left", "fontSize": 14}))  # fmt: skip
        where = {"xAxisIndex": i, "yAxisIndex": i}
        if body is not None and turns:
            y = np.asarray(getattr(body, of_body)) / scale.size
            series.append(line("centre of mass", t, y, PALETTE["orange"], "dashed", **where))
        series.append(line("tip", t, tip / scale.size, PALETTE["blue"], **where))
    handles = [{"grid": i, "x": float(t[-1]), "unit": time.size, "movable": False, "label": ""} for i in range(4)]
    tooltip = {"trigger": "axis", "confine": True, "transitionDuration": 0}
    option = {"animation": False, "grid": grids, "xAxis": x_axes, "yAxis": y_axes, "series": series}
    return option | {"legend": LEGEND, "tooltip": tooltip}, handles, "position and speed of the tip over time"


def _sentence(cut: Trajectory) -> str:
    if not cut.t_c:
        return NOTHING
    time = readable_scale("time", cut.p.units, cut.t_c)
    turned = f", the body turned by {np.rad2deg(cut.turn):.0f}°" if np.isfinite(cut.turn) and cut.turn else ""
    return f"{cut.ended_by} after {cut.t_c / time.size:.4g} {time.unit}{turned}"


def _length(number: float, scale: Scale, units: System) -> str:
    """A length in its unit; in the base unit if the unit is a power of ten of the base unit."""
    base = unit_name("length", units)
    return f"{number * scale.size:.6g} {base}" if scale.unit.startswith("10") else f"{number:g} {scale.unit}"


def _round_length(length: float) -> float:
    """1, 2 or 5 times a power of ten, at most `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(factor for factor in (1, 2, 5) if factor * power <= length * (1 + 1e-9)) * power)
