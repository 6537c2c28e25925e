"""In closing: all models beside each other."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.correlations import CORRELATIONS
from erosion.models.registry import BUILT_IN
from erosion.plotting.families import plot_family
from erosion.plotting.shapes import plot_shapes
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import degrees, join, number, paragraph, table, wordy_table

_BESIDE = ("linearized", "finnie", "rotating")
NEEDS = tuple((what, model) for model in BUILT_IN for what in ("optimum", "hits"))


def answer(case: Case) -> Answer:
    """V at the case's angle, α_max, V_max, what kind it is and how the cut ends there, of every model."""
    numbers = _numbers(case)
    return Answer(
        key="models",
        title="How do all models compare?",
        sentence=_sentence(numbers),
        figures=(_figure(case), _beside_correlations(case)),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )


def _numbers(case: Case) -> dict[str, Any]:
    found = {}
    for model in BUILT_IN:
        hits, optimum = case.hits(model), case.optimum(model)
        found[model] = {
            "volume": float(hits.volume[-1]),
            "t_c": float(hits.t_c[-1]),
            "ended_by": str(hits.ended_by[-1]),
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "kind": str(optimum.kind),
            "side": str(optimum.side),
            "attained": bool(optimum.attained),
            "ended_by_at_max": str(optimum.ended_by),
            "certified": bool(optimum.certified),
        }
    return found


def _sentence(numbers: dict[str, Any]) -> Markup:
    inside = [found for found in numbers.values() if found["kind"] in ("interior", "jump")]
    if not inside:
        return Markup("In this case no model has a maximum inside the range of angles.")
    angles = [found["alpha_max"] for found in inside]
    return Markup("{} of {} models have a best angle, <strong>from {} to {}</strong>; the others remove the more, the "
                  "shallower the impact.").format(
        len(inside), len(numbers), degrees(min(angles), 4), degrees(max(angles), 4)
    )  # fmt: skip


def _figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.8, 5.2)
    plot_family(ax, [case.curve(model) for model in BUILT_IN], units=case.units, columns=2)
    return Illustration(
        "models",
        fig,
        Markup("The volume removed over the angle of attack for every model. Those with a force along the motion "
               "(dashed where colours repeat) lie on those with {}.").format("K = tan α"),
        "Removed volume over the angle of attack for eleven models.",
    )  # fmt: skip


def _beside_correlations(case: Case) -> Illustration:
    fig, ax = new_axes(5.8, 5.0)
    plot_shapes(ax, [case.curve(model) for model in _BESIDE], tuple(CORRELATIONS))
    return Illustration(
        "correlations",
        fig,
        Markup("Three models in colour beside angle functions that engineers fitted to tests (grey), each over its own "
               "greatest value; the legend says where that is. No model of a rigid grain cutting removes anything at "
               "90°, where tests find half the greatest erosion and more."),
        "Removed volume over the angle of attack for three models and six engineering correlations, normalised.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    scale = readable_scale("volume", case.units, max(found["volume_max"] for found in numbers.values()))
    rows = [
        (
            model,
            number(found["volume"] / scale.size, 5),
            "–" if found["kind"] == "none" else "→ 0" if found["alpha_max"] == 0 else f"{_degrees(found):.5f}",
            number(found["volume_max"] / scale.size, 5),
            f"{found['kind']} {found['side']}".strip(),
            found["ended_by_at_max"],
        )
        for model, found in numbers.items()
    ]
    head = ("model", f"V at {degrees(case.alpha)} [{scale.unit}]", "α_max [°]", f"V_max [{scale.unit}]", "maximum",
            "ends by")  # fmt: skip
    return join(
        paragraph("A model is a choice of where the tip is, of the ratio ", "K", " of the force's components, and of "
                  "the torque:"),
        wordy_table("Models", ("model", "what it assumes", "equations"),
              [(info.name, info.summary, info.equations) for info in BUILT_IN.values()]),
        table("All models in this case", head, rows),
    )  # fmt: skip


def _degrees(found: dict[str, Any]) -> float:
    return float(np.rad2deg(found["alpha_max"]))
