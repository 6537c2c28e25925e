"""Additional question 3: the force opposes the motion throughout."""

import numpy as np
from matplotlib.figure import Figure

from erosion.output.tables import Record
from erosion.plotting.curves import plot_differences, plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase

_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Pairs of models that differ only in the force: of additional question 2 and of this question."""

NEEDS = tuple((kind, model) for pair in _PAIRS.values() for model in pair for kind in ("optimum", "hits"))


def answer(case: ReportCase) -> Answer:
    """The direction never changes, so this is additional question 2 again."""
    pairs = _pairs(case)
    fields = {
        "largest_difference": max(pair["largest_difference"] for pair in pairs.values()),
        "greatest_volume": max(pair["volume_max"] for pair in pairs.values()),
    }
    return Answer({"pairs": pairs}, _figures(case), fields)


def _differences(case: ReportCase, pair: tuple[str, str]) -> np.ndarray:
    fixed, aligned = (case.hits(model).volume[:-1] for model in pair)
    return np.abs(fixed - aligned) / float(case.p.volume_scale)


def _pairs(case: ReportCase) -> dict[str, Record]:
    pairs = {}
    for label, pair in _PAIRS.items():
        fixed, aligned = (case.optimum(model) for model in pair)
        pairs[label] = {
            "largest_difference": float(np.nanmax(_differences(case, pair))),
            "kind": str(aligned.kind),
            "alpha_max": float(aligned.alpha),
            "alpha_max_of_tan_alpha": float(fixed.alpha),
            "volume_max": float(aligned.volume),
            "volume_max_of_tan_alpha": float(fixed.volume),
            "ended_by": str(aligned.ended_by),
        }
    return pairs


def _figures(case: ReportCase) -> dict[str, Figure]:
    curves, ax = new_axes(5.4, 4.1)
    plot_family(ax, [case.curve(pair[1], label) for label, pair in _PAIRS.items()], units=case.units, columns=2)
    rounding, below = new_axes(5.4, 4.0)
    plot_differences(below, case.looks, {label: _differences(case, pair) for label, pair in _PAIRS.items()})
    return {"velocity-aligned": curves, "velocity-aligned-difference": rounding}
