"""The views: computed answers as options of ECharts, as data of the cut, and as HTML."""

import html
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from erosion.explorer.computed import SPINS, Computed, Turned
from erosion.explorer.controls import (
    DEGREES,
    STAR,
    Option,
    angle_axis,
    axis,
    frame,
    gaps,
    handle,
    line,
    points,
    styles,
)
from erosion.impacts import BEYOND_LABEL, Optimum
from erosion.models import State as Body
from erosion.parameters import (
    BEYOND_TESTS,
    PER_MASS_SCALES,
    QUANTITIES,
    RESULTS,
    Scale,
    models_far_from_tests,
    readable_scale,
)
from erosion.plotting.dynamics import SHARES, Dynamics, dynamics
from erosion.plotting.labels import (
    AT_CONTACT,
    DIM,
    ENDS,
    EVENT_LABELS,
    HISTORIES,
    NOTHING,
    PALETTE,
    describe,
    leaps,
    parted,
    round_length,
    with_gaps,
)
from erosion.results import Finding

_SHALLOW = 5.0  # degrees
_DOTS = [2, 3]
_APART = 0.05  # of the longest cut; neighbouring times that differ by more belong to different crossings
Drawing = tuple[Option, list[Option], str]
"""An option of ECharts, its handles, and a description in words."""
_NOT_YET: Drawing = ({"series": []}, [], "not computed yet")


def volumes(computed: Computed, models: Collection[str]) -> Drawing:
    """V(α) of the checked models, with their maxima."""
    curves, best, shown = computed.of_all("curve"), computed.of_all("best"), computed.state.shown
    largest = [float(np.nanmax(curve.volume, initial=0.0)) for curve in curves.values()]
    scale = readable_scale("volume", computed.state.case.units, max(largest, default=0.0))
    series = []
    for model, curve in curves.items():
        color = styles(models)[model][0]
        marks = _marks(best[model], scale.size, color, shown=model == shown) if model in best else {}
        series += _over_angle(computed, model, "volume", scale, models, **marks)
        if model == shown and np.any(curve.t_c > 0) and curve.volume_at_contact.any():
            at_contact, area = curve.volume_at_contact / scale.size, {"opacity": 0.2, "color": color}
            thin = {"color": color, "width": 0}
            series.append(line(AT_CONTACT, DEGREES, at_contact, color, areaStyle=area, lineStyle=thin, z=1))
    maxima = [f"{model} removes most {describe(optimum)}" for model, optimum in best.items()]
    return _over_angles(computed, "volume", scale, series, "; ".join(["", *maxima]))


def end_times(computed: Computed, models: Collection[str]) -> Drawing:
    """t_c(α) of the checked models, and both candidates of the model shown."""
    curves = computed.of_all("curve")
    # Near 0° the cuts of some models last longer and longer; their times would flatten all other curves.
    longest = [float(np.nanmax(curve.t_c[DEGREES > _SHALLOW], initial=0.0)) for curve in curves.values()]
    largest = max(longest, default=0.0)
    scale = readable_scale("time", computed.state.case.units, largest)
    series = [one for model in curves for one in _over_angle(computed, model, "t_c", scale, models)]
    for event, times in (computed.of_shown("ends") or {}).items():
        color = ENDS.get(event, DIM)
        thin = {"color": color, "type": [4, 4], "width": 1.8}
        # No line is drawn across the jump of a candidate.
        before = np.flatnonzero(np.abs(np.diff(times)) > _APART * largest) + 1
        degrees, times = with_gaps(before, DEGREES, times / scale.size)
        series.append(line(EVENT_LABELS.get(event) or event, degrees, times, color, lineStyle=thin, z=1))
    top = {"max": float(f"{1.5 * largest / scale.size:.1g}")} if largest else {}
    more = f"; dashed, when each event alone would end the cut of {computed.state.shown}"
    return _over_angles(computed, "t_c", scale, series, more, **top)


def _over_angle(
    computed: Computed, model: str, result: str, scale: Scale, models: Collection[str], **marks: Any
) -> list[Option]:
    """A result of a model, with gaps where V(α) jumps, and dotted where its body turns by more than 90°."""
    curve, turned = computed.of_all("curve")[model], computed.of_all("turned").get(model)
    beyond = np.zeros(DEGREES.size, bool) if turned is None else turned.beyond[:-1]
    parts = parted(getattr(curve, result) / scale.size, beyond)
    degrees, valid, dotted = with_gaps(gaps(curve), DEGREES, *parts)
    color, dashes = styles(models)[model]
    drawn = [line(model, degrees, valid, color, dashes, **marks)]
    if beyond.any():
        drawn.append(line(f"{model}, {BEYOND_LABEL}", degrees, dotted, color, _DOTS, legend=BEYOND_LABEL))
    return drawn


def _over_angles(
    computed: Computed, result: str, scale: Scale, series: list[Option], more: str, **axis_options: Any
) -> Drawing:
    """Curves of a result, with the handle at the angle of the case."""
    quantity = RESULTS[result]
    y_axis = axis(f"{quantity.symbol}  {quantity.meaning}  [{scale.unit}]", min=0, **axis_options)
    label = f"{quantity.meaning} over the angle of attack" + more
    return frame(angle_axis(), y_axis, series), [handle("alpha", computed.state.case)], label


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


_PANELS = ((0, 0), (1, 0), (0, 1), (1, 1))
_NOTHING: Option = {"t": [], "x": [], "depth": [], "phi": [], "bar": None, "label": "", **Dynamics()._asdict()}


def cut(computed: Computed, models: Collection[str]) -> tuple[Option]:
    """The data that the cut's element draws, in lengths that read well."""
    motion = computed.of_shown("cut")
    if motion is None:
        return (_NOTHING,)
    p = motion.p
    time = readable_scale("time", p.shown_in, motion.t_c)
    length = readable_scale("length", p.shown_in, float(np.max(np.abs(motion.x_tip))) or float(p.r))
    phi = motion.phi if isinstance(motion.states, Body) else np.full(motion.t.shape, np.pi / 2)
    longest = float(p.r) / length.size
    bar = round_length(longest)
    end = NOTHING
    if motion.t_c:
        after = f"{motion.t_c / time.size:.4g} {time.unit}"
        end = f"{motion.ended_by} after {after}"
    if motion.turn > 0:
        end += f", the body turned by {np.rad2deg(motion.turn):.4g}°"
    content = {
        "t": motion.t.tolist(),
        "x": (motion.x_tip / length.size).tolist(),
        "depth": (motion.depth / length.size).tolist(),
        "phi": phi.tolist(),
        "size": longest,
        "unit": time.size,
        "units": time.unit,
        "bar": {"size": bar, "text": f"{bar:g} {length.unit}"},
        "label": f"{computed.state.shown}: {end}",
        **dynamics(motion)._asdict(),
        "names": SHARES,
    }
    return (content,)


def histories(computed: Computed, models: Collection[str]) -> Drawing:
    """x, y, ẋ and ẏ of the tip over time in four panels, each with a handle at the time that is shown."""
    motion = computed.of_shown("cut")
    if motion is None:
        return _NOT_YET
    time = readable_scale("time", motion.p.shown_in, motion.t_c)
    body = motion.states if isinstance(motion.states, Body) else None
    turns = body is not None and not np.allclose(body.x, motion.x_tip, rtol=1e-9, atol=0)
    t = motion.t / time.size
    series, x_axes, y_axes, grids = [], [], [], []
    for i, ((of_body, of_tip, quantity), (column, row)) in enumerate(zip(HISTORIES, _PANELS, strict=True)):
        tip = getattr(motion, of_tip)
        scale = readable_scale(quantity.dimension, motion.p.shown_in, float(np.max(np.abs(tip))))
        grids.append({"left": f"{column * 50 + 13}%", "width": "34%", "top": f"{row * 47 + 12}%", "height": "31%"})
        x_axes.append(axis(f"t [{time.unit}]" if row else "", gridIndex=i, min=0, max=float(t[-1]) or 1, nameGap=24,
                           nameLocation="middle", axisLabel={"showMaxLabel": False}, splitNumber=4))  # fmt: skip
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
    return (
        option | {"tooltip": tooltip},
        handles,
        "position and speed of the tip over time",
    )


_HEADINGS = ("t_c", "ended_by", "volume", "dvolume", "turn", "alpha_max", "volume_max")


def numbers(computed: Computed, models: Collection[str]) -> tuple[str]:
    """For each checked model t_c, how the cut ended, V, dV/dα, the turn, and α_max with its kind."""
    heads, symbols = ["<th scope='col'>model</th>"], []
    for name in _HEADINGS:
        meaning, symbol = "how the cut ends", "ends by"
        if name in RESULTS:
            meaning, (symbol, _, below) = RESULTS[name].meaning, RESULTS[name].symbol.partition("_")
            symbol += f"<sub>{below}</sub>" if below else ""
        heads.append(f"<th scope='col' title='{html.escape(meaning)}'>{symbol}</th>")
        symbols.append(symbol)
    points, turned, optima = (computed.of_all(kind) for kind in ("point", "turned", "best"))
    unknown = "?" if computed.state.predict else "…"
    rows = []
    for model in computed.state.models:
        point, best = points.get(model), optima.get(model)
        at_angle = ["…"] * 4 if point is None else [
            _read("t_c", float(point.t_c), computed), html.escape(str(point.ended_by)),
            _volume(computed, float(point.volume)), _read("dvolume", float(point.dvolume), computed),
        ]  # fmt: skip
        turn = _turn(turned[model]) if model in turned else "…"
        at_best = [unknown] * 2
        if best is not None:
            kind = str(best.kind) + ("" if best.certified else ", not certified")
            where = describe(best) if best.kind == "limit" else f"{describe(best)} <small>{html.escape(kind)}</small>"
            at_best = [where, _volume(computed, float(best.volume))]
        mark = "shown" if model == computed.state.shown else ""
        swatch = f"<i style='background:{styles(models)[model][0]}'></i>"
        # On a narrow screen each number has its heading beside it.
        named = zip(symbols, (*at_angle, turn, *at_best), strict=True)
        cells = "".join(f"<td><span class='head'>{symbol}</span>{cell}</td>" for symbol, cell in named)
        rows.append(f"<tr class='{mark}'><th scope='row'>{swatch}{html.escape(model)}</th>{cells}</tr>")
    table = f"<thead><tr>{''.join(heads)}</tr></thead><tbody>{''.join(rows)}</tbody>"
    caption = "<caption>Numbers of the checked models</caption>"
    below = _of_the_cut(computed) + _far_from_tests(computed) + _of_the_fit(computed)
    return (f"<div class='scroll'><table class='numbers'>{caption}{table}</table></div>{below}",)


def _turn(turned: Turned) -> str:
    """How far the body of a model turns at the angle of the case, with the finding."""
    if not np.isfinite(turned.turn[-1]):
        return "–"
    finding = f"<br><small class='beyond'>{html.escape(BEYOND_LABEL)}</small>" if turned.beyond[-1] else ""
    return f"{np.rad2deg(turned.turn[-1]):.4g}°{finding}"


def _of_the_cut(computed: Computed) -> str:
    cut = computed.of_shown("cut")
    if cut is None:
        return ""
    depth = _read("max_depth", cut.max_depth, computed)
    facts = [f"{RESULTS['max_depth'].meaning}: {depth}"]
    if cut.volume_at_contact:
        at_contact = _read("volume", cut.volume_at_contact, computed)
        facts.append(f"{RESULTS['volume_at_contact'].meaning}: {at_contact}")
    return f"<p>{html.escape(computed.state.shown)}, {'; '.join(facts)}.</p>{_warnings(cut.findings)}"


def _far_from_tests(computed: Computed) -> str:
    """At their best angles, the models whose erosion is far from what tests find."""
    state = computed.state
    volumes = {model: float(optimum.volume) for model, optimum in computed.of_all("best").items()}
    weights = dict.fromkeys(volumes, state.per_mass)
    return _warnings(models_far_from_tests(weights, volumes, state.case.parameters()))


def _of_the_fit(computed: Computed) -> str:
    """What is doubtful in the fit that wrote the case file, and how far the case lies outside of its tests."""
    file = computed.file
    if file is None:
        return ""
    outside = file.outside(computed.state.case.parameters(), angle=True)
    return _warnings([*filter(None, [file.doubt]), *outside])


def _warnings(findings: Iterable[Finding]) -> str:
    return "".join(f"<p class='warning' role='status'>{html.escape(finding.text)}</p>" for finding in findings)


def _volume(computed: Computed, volume: float) -> str:
    """V, and below it the erosion per mass of particles, in g/kg where the target's density is known.

    An amount that is asked for and beyond all tests is none to show.
    """
    state = computed.state
    text = _read("volume", volume, computed)
    if not np.isfinite(volume):
        return text
    p = state.case.parameters()
    if state.per_mass.is_given and state.per_mass.is_beyond_tests(volume, p):
        return f"{text}<br><small>{BEYOND_TESTS}</small>".replace("-", "−")
    for name, value in state.per_mass.to_dict(volume, p).items():
        scale = PER_MASS_SCALES[name]
        number = f"{float(f'{float(value) / scale.size:.4g}'):,.12g}"
        text += f"<br><small>{number} {scale.unit}</small>"
    return text.replace("-", "−")


def _read(result: str, value: float, computed: Computed) -> str:
    """One of `RESULTS` with its unit."""
    text = RESULTS[result].in_words(value, computed.state.case.units, 5) if np.isfinite(value) else "–"
    return text.replace("-", "−")


def spins(computed: Computed, models: Collection[str]) -> Drawing:
    """α_max over s = r φ̇₀/v₀ of the checked models; hollow markers where α_max is at a jump of V(α)."""
    series = []
    for model, best in computed.of_all("spins").items():
        color, dashes = styles(models)[model]
        degrees = np.rad2deg(best.alpha)
        at_jump = best.kind == "jump"
        s, best_angle = with_gaps(leaps(degrees), SPINS, degrees)
        series.append(line(model, s, best_angle, color, dashes))
        hollow = {"color": "transparent", "borderColor": color, "borderWidth": 1.6}
        marks = {
            "type": "scatter",
            "name": f"{model}, at a jump",
            "itemStyle": hollow,
            "symbolSize": 8,
        }
        if at_jump.any():
            series.append(marks | {"data": points(SPINS[at_jump], degrees[at_jump]), "animation": False})
    x_axis = axis("s = r φ̇₀/v₀  initial spin", min=float(SPINS[0]), max=float(SPINS[-1]), interval=0.3,
                  axisLabel={"formatter": "{value}"})  # fmt: skip
    result = RESULTS["alpha_max"]
    y_axis = axis(f"{result.symbol}  {result.meaning}", min=0, max=90, interval=15,
                  axisLabel={"formatter": "{value}°"})  # fmt: skip
    label = f"{result.meaning} over the {QUANTITIES['phidot0'].meaning}"  # fmt: skip
    return frame(x_axis, y_axis, series), [handle("phidot0", computed.state.case)], label


def sensitivities(computed: Computed, models: Collection[str]) -> Drawing:
    """How far α_max moves [°] when a parameter grows by 1 % of its size, or the spin s by 0.01."""
    rates = computed.of_shown("sensitivities")
    if rates is None:
        return _NOT_YET
    model, case = computed.state.shown, computed.state.case
    own = {number.name: number for number in case.own if number.model == model}
    numbers = case.numbers()
    sizes = numbers | {"phidot0": numbers["v0"] / numbers["r"]}
    sizes |= {name: abs(number.value) or 1.0 for name, number in own.items()}
    symbols = {name: quantity.symbol for name, quantity in QUANTITIES.items() if name != "alpha"}
    symbols |= {name: number.quantity.symbol for name, number in own.items()}
    names = list(reversed(symbols))
    moves = [float(np.rad2deg(0.01 * sizes[name] * rates[name])) for name in names]
    bars = [round(move, 6) if np.isfinite(move) else None for move in moves]
    widest = max([abs(bar) for bar in bars if bar is not None], default=0.0)
    x_axis = axis("move of α_max for + 1 %  (spin: s + 0.01)", axisLabel={"formatter": "{value}°"}, splitNumber=3,
                  **({} if widest else {"min": -1, "max": 1}))  # fmt: skip
    labels = [symbols[name] for name in names]
    y_axis = {"type": "category", "data": labels, "axisTick": {"show": False}, "axisLabel": {"interval": 0}}
    series = [{"type": "bar", "name": "α_max", "data": bars, "itemStyle": {"color": PALETTE["green"]},
               "animation": False, "barCategoryGap": "35%"}]  # fmt: skip
    grid = {"left": 40, "right": 24, "top": 6, "bottom": 26}
    moved = ", ".join(f"{label} {bar:+.3g}°" for label, bar in zip(labels, bars, strict=True) if bar)
    option = frame(x_axis, y_axis, series, grid=grid)
    missing = ""
    if all(bar is None for bar in bars):
        best = computed.of_all("best").get(model)
        missing = "not known" if best is None else f"not known: {best.without_sensitivities}"
    # Without a reason the title is empty: the page merges options, and would keep an earlier one.
    text = {"width": 180, "overflow": "break", "fontSize": 14, "fontWeight": "normal"}
    option["title"] = {"text": missing, "left": "center", "top": "middle", "textStyle": text}
    return option, [], f"move of the angle of greatest removal for one per cent more: {moved or missing or 'nothing'}"


VIEWS: Mapping[str, Callable[[Computed, Collection[str]], Any]] = {
    view.__name__: view for view in (cut, volumes, histories, numbers, end_times, spins, sensitivities)
}
"""A view's function by its name: from computed answers and the names of all models to the data of its element."""
