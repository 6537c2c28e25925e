"""The angle of greatest removal over the spin, and how far it moves with each parameter."""

from collections.abc import Collection

import numpy as np

from erosion.explorer.answers import SPINS
from erosion.explorer.computed import Computed
from erosion.explorer.sliders import SPINS as SPIN_SLIDER
from erosion.explorer.views.look import Option, axis, frame, line, points, styles
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.plotting.colors import PALETTE
from erosion.plotting.curves import leaps, with_gaps


def spins(computed: Computed, models: Collection[str]) -> tuple[Option, list[Option], str]:
    """α_max over s = r φ̇₀/v₀ of the checked models; hollow markers where α_max is at a jump of V(α)."""
    series = []
    for model, best in computed.in_order(computed.spins):
        color, dashes = styles(models)[model]
        degrees = np.rad2deg(best.alpha)
        at_jump = best.kind == "jump"
        s, best_angle = with_gaps(leaps(degrees), SPINS, degrees)
        series.append(line(model, s, best_angle, color, dashes))
        hollow = {"color": "transparent", "borderColor": color, "borderWidth": 1.6}
        marks = {"type": "scatter", "name": f"{model}, at a jump", "itemStyle": hollow, "symbolSize": 8}
        if at_jump.any():
            series.append(marks | {"data": points(SPINS[at_jump], degrees[at_jump]), "animation": False})
    quantity = QUANTITIES["phidot0"]
    x_axis = axis("s = r φ̇₀/v₀  initial spin", min=float(SPINS[0]), max=float(SPINS[-1]), interval=0.3,
                  axisLabel={"formatter": "{value}"})  # fmt: skip
    result = RESULTS["alpha_max"]
    y_axis = axis(f"{result.symbol}  {result.meaning}", min=0, max=90, interval=15, nameGap=38,
                  axisLabel={"formatter": "{value}°"})  # fmt: skip
    numbers = computed.state.case.numbers()
    s = numbers["phidot0"] * numbers["r"] / numbers["v0"]
    handle = {"x": s, "movable": True, "low": SPIN_SLIDER.low, "high": SPIN_SLIDER.high, "step": SPIN_SLIDER.step,
              "label": f"{quantity.meaning}, in the plot", "text": f"s = {s:.3g}"}  # fmt: skip
    return frame(x_axis, y_axis, series), [handle], f"{result.meaning} over the {quantity.meaning}"


def sensitivities(computed: Computed, models: Collection[str]) -> tuple[Option, list[Option], str]:
    """How far α_max moves [°] when a parameter grows by 1 % of its size, or the spin s by 0.01."""
    if computed.sensitivities is None:
        return {"series": []}, [], "not computed yet"
    model, case = computed.state.shown, computed.state.case
    own = {number.name: number for number in case.own if number.model == model}
    numbers = case.numbers()
    sizes = numbers | {"phidot0": numbers["v0"] / numbers["r"]}
    sizes |= {name: abs(number.value) or 1.0 for name, number in own.items()}
    symbols = {name: quantity.symbol for name, quantity in QUANTITIES.items() if name != "alpha"}
    symbols |= {name: number.quantity.symbol for name, number in own.items()}
    names = list(reversed(symbols))
    moves = [float(np.rad2deg(0.01 * sizes[name] * computed.sensitivities[name])) for name in names]
    bars = [round(move, 6) if np.isfinite(move) else None for move in moves]
    widest = max([abs(bar) for bar in bars if bar is not None], default=0.0)
    x_axis = axis("move of α_max for + 1 %  (spin: s + 0.01)", axisLabel={"formatter": "{value}°"}, splitNumber=3,
                  **({} if widest else {"min": -1, "max": 1}))  # fmt: skip
    labels = [symbols[name] for name in names]
    y_axis = {"type": "category", "data": labels, "axisTick": {"show": False}, "axisLabel": {"interval": 0}}
    series = [{"type": "bar", "name": "α_max", "data": bars, "itemStyle": {"color": PALETTE["green"]},
               "animation": False, "barCategoryGap": "35%"}]  # fmt: skip
    grid = {"left": 40, "right": 24, "top": 16, "bottom": 46}
    moved = ", ".join(f"{label} {bar:+.3g}°" for label, bar in zip(labels, bars, strict=True) if bar)
    nothing = "not known" if all(bar is None for bar in bars) else "none"
    option = frame(x_axis, y_axis, series, grid=grid, legend={"show": False})
    return option, [], f"move of the angle of greatest removal for one per cent more: {moved or nothing}"
