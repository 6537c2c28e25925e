"""Additional question 3: the force opposes the motion throughout."""

import numpy as np
from matplotlib.figure import Figure

from erosion.plotting.families import plot_differences, plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, Case
from erosion.tables import Record

_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Models of additional question 2 and of this one that differ in nothing else."""

NEEDS = tuple((what, model) for pair in _PAIRS.values() for model in pair for what in ("optimum", "hits"))


def answer(case: Case) -> Answer:
    """The direction never changes, so this is additional question 2 again."""
    pairs = _pairs(case)
    fields = {
        "largest_difference": max(pair["largest_difference"] for pair in pairs.values()),
        "greatest_volume": max(pair["volume_max"] for pair in pairs.values()),
    }
    return Answer({"pairs": pairs}, _figures(case), fields)


def _differences(case: Case, pair: tuple[str, str]) -> np.ndarray:
    one, other = (case.hits(model).volume[:-1] for model in pair)
    return np.abs(one - other) / float(case.p.volume_scale)


def _pairs(case: Case) -> dict[str, Record]:
    pairs = {}
    for label, pair in _PAIRS.items():
        one, other = (case.optimum(model) for model in pair)
        pairs[label] = {
            "largest_difference": float(np.nanmax(_differences(case, pair))),
            "kind": str(other.kind),
            "alpha_max": float(other.alpha),
            "alpha_max_of_tan_alpha": float(one.alpha),
            "volume_max": float(other.volume),
            "volume_max_of_tan_alpha": float(one.volume),
            "ended_by": str(other.ended_by),
        }
    return pairs


def _figures(case: Case) -> dict[str, Figure]:
    curves, ax = new_axes(5.4, 4.1)
    plot_family(ax, [case.curve(pair[1], label) for label, pair in _PAIRS.items()], units=case.units, columns=2)
    rounding, below = new_axes(5.4, 4.0)
    plot_differences(below, case.looks, {label: _differences(case, pair) for label, pair in _PAIRS.items()})
    return {"velocity-aligned": curves, "velocity-aligned-difference": rounding}
