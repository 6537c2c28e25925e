"""The numbers of the checked models as an HTML table."""

import html
from collections.abc import Collection, Iterable

import numpy as np

from erosion.explorer.computed import Computed
from erosion.explorer.views.look import styles
from erosion.optimum.alpha_max import Optimum
from erosion.parameters.per_mass import BEYOND_TESTS, PER_MASS_SCALES, models_far_from_tests
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import readable_scale
from erosion.parameters.units import Dimension, System, unit_name
from erosion.plotting.curves import describe

_HEADINGS = ("t_c", "ended_by", "volume", "dvolume", "alpha_max", "volume_max")


def numbers(computed: Computed, models: Collection[str]) -> tuple[str]:
    """For each checked model t_c, how the cut ended, V, dV/dα, and α_max with its kind."""
    units = computed.state.case.units
    heads = "".join(f"<th scope='col' title='{html.escape(_meaning(name))}'>{_symbol(name)}</th>" for name in _HEADINGS)
    rows = []
    for model in computed.state.models:
        point, best = computed.points.get(model), computed.best.get(model)
        at_angle = ["…"] * 4 if point is None else [
            _read("time", float(point.t_c), units), html.escape(str(point.ended_by)),
            _volume(computed, float(point.volume)), _read("volume per angle", float(point.dvolume), units),
        ]  # fmt: skip
        at_best = ["…"] * 2 if best is None else [_where(best), _volume(computed, float(best.volume))]
        mark = "shown" if model == computed.state.shown else ""
        swatch = f"<i style='background:{styles(models)[model][0]}'></i>"
        cells = "".join(f"<td>{cell}</td>" for cell in (*at_angle, *at_best))
        rows.append(f"<tr class='{mark}'><th scope='row'>{swatch}{html.escape(model)}</th>{cells}</tr>")
    table = f"<thead><tr><th scope='col'>model</th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody>"
    caption = "<caption>Numbers of the checked models</caption>"
    below = _of_the_cut(computed) + _far_from_tests(computed)
    return (f"<div class='scroll'><table class='numbers'>{caption}{table}</table></div>{below}",)


def _of_the_cut(computed: Computed) -> str:
    cut = computed.cut
    if cut is None:
        return ""
    depth = _read("length", cut.max_depth, computed.state.case.units)
    facts = [f"{RESULTS['max_depth'].meaning}: {depth}"]
    if cut.volume_at_contact:
        at_contact = _read("volume", cut.volume_at_contact, computed.state.case.units)
        facts.append(f"{RESULTS['volume_at_contact'].meaning}: {at_contact}")
    if np.isfinite(cut.turn):
        facts.append(f"{RESULTS['turn'].meaning}: {np.rad2deg(cut.turn):.4g}°".replace("-", "−"))
    return f"<p>{html.escape(computed.state.shown)}, {'; '.join(facts)}.</p>{_warnings(cut.warnings)}"


def _far_from_tests(computed: Computed) -> str:
    """At their best angles, the models whose erosion is far from what tests find."""
    state, best = computed.state, dict(computed.in_order(computed.best))
    volumes = {model: float(optimum.volume) for model, optimum in best.items()}
    weights = dict.fromkeys(volumes, state.per_mass)
    return _warnings(models_far_from_tests(weights, volumes, state.case.parameters()))


def _warnings(lines: Iterable[str]) -> str:
    return "".join(f"<p class='warning' role='status'>{html.escape(line)}</p>" for line in lines)


def _volume(computed: Computed, volume: float) -> str:
    """V, and below it the erosion per mass of abrasive, in g/kg where the target's density is known.

    An amount that is asked for and beyond all tests is none to show.
    """
    state = computed.state
    text = _read("volume", volume, state.case.units)
    if not np.isfinite(volume):
        return text
    p = state.case.parameters()
    if state.per_mass.is_given and state.per_mass.is_beyond_tests(volume, p):
        return f"{text}<br><small>{BEYOND_TESTS}</small>".replace("-", "−")
    for name, value in state.per_mass.to_dict(volume, p).items():
        scale = PER_MASS_SCALES[name]
        text += f"<br><small>{float(f'{float(value) / scale.size:.4g}'):,.12g} {scale.unit}</small>"
    return text.replace("-", "−")


def _where(best: Optimum) -> str:
    kind = str(best.kind) if best.certified else f"{best.kind}, not certified"
    return f"{describe(best)} <small>{html.escape(kind)}</small>"


def _symbol(name: str) -> str:
    if name not in RESULTS:
        return "ends by"
    symbol, _, below = RESULTS[name].symbol.partition("_")
    return f"{symbol}<sub>{below}</sub>" if below else symbol


def _meaning(name: str) -> str:
    return RESULTS[name].meaning if name in RESULTS else "how the cut ends"


def _read(dimension: Dimension, value: float, units: System) -> str:
    if not np.isfinite(value):
        return "–"
    scale = readable_scale(dimension, units, abs(value))
    unit = scale.unit if value else unit_name(dimension, units)
    return f"{value / scale.size:.5g} {unit}".strip().replace(" 10", "·10").replace("-", "−")
