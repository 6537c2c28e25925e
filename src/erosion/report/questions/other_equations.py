"""Additional questions 2 and 3, the slips of the source, and a comparison of all models."""

import numpy as np

from erosion.correlations import CORRELATIONS
from erosion.models import NoDeformation, RigidErodent
from erosion.models.closed_forms import StraightCut
from erosion.models.registry import BUILT_IN
from erosion.output.tables import Record
from erosion.plotting.curves import plot_differences, plot_family, plot_shapes
from erosion.report.case import Answer, Need, ReportCase, panel

_ALONG, _TURNING = "tan-alpha", "rotating-tan-alpha"
_RATIOS = {"linearized": "k constant", _ALONG: "k = tan α", _TURNING: "k = tan α, the body turns"}
_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Pairs of models that differ only in the force: of additional question 2 and of additional question 3."""
_READINGS = {"as-printed": "as printed", "rotating": "as corrected", "linearized": "linearized"}
_BESIDE = ("linearized", "finnie", "rotating", "linearized-deformation")


def _needs(*models: str) -> tuple[Need, ...]:
    return tuple((kind, model) for model in models for kind in ("optimum", "hits"))


NEEDS_OF_TAN_ALPHA = _needs(_ALONG, _TURNING, "linearized")
NEEDS_OF_PAIRS = _needs(*(model for pair in _PAIRS.values() for model in pair))
NEEDS_OF_READINGS = _needs(*_READINGS)
NEEDS_OF_MODELS = _needs(*BUILT_IN)


def ratio_is_tan_alpha(case: ReportCase) -> Answer:
    """V = (V*/2) cos²α only falls: no interior maximum, a supremum that is not reached."""
    optimum, turning, hits = case.optimum(_ALONG), case.optimum(_TURNING), case.hits(_ALONG)
    exact = np.asarray(StraightCut().volume(hits.p))
    numbers = {
        "supremum": float(optimum.volume),
        "supremum_closed_form": float(case.p.volume_scale) / 2,
        "alpha_of_supremum": float(optimum.alpha),
        "attained": bool(optimum.attained),
        "kind": str(optimum.kind),
        "largest_difference": float(np.abs(hits.volume - exact).max() / float(case.p.volume_scale)),
        "largest_slope": float(hits.dvolume.max()),
        "volume_at_case": float(hits.volume[-1]),
        "rotating": {
            "alpha_max": float(turning.alpha),
            "volume_max": float(turning.volume),
            "kind": str(turning.kind),
            "ended_by": str(turning.ended_by),
        },
    }
    curves = [case.curve(model, label) for model, label in _RATIOS.items()]
    return Answer(numbers, {"tan-alpha": panel(plot_family, curves, units=case.units, columns=2)})


def force_opposes_motion(case: ReportCase) -> Answer:
    """The direction of a force that opposes the motion never changes, so this is additional question 2 again."""
    differences, pairs = {}, {}
    for label, (fixed, aligned) in _PAIRS.items():
        volumes = [case.hits(model).volume[:-1] for model in (fixed, aligned)]
        differences[label] = np.abs(volumes[0] - volumes[1]) / float(case.p.volume_scale)
        best, best_of_tan_alpha = case.optimum(aligned), case.optimum(fixed)
        pairs[label] = {
            "largest_difference": float(np.nanmax(differences[label])),
            "kind": str(best.kind),
            "alpha_max": float(best.alpha),
            "alpha_max_of_tan_alpha": float(best_of_tan_alpha.alpha),
            "volume_max": float(best.volume),
            "volume_max_of_tan_alpha": float(best_of_tan_alpha.volume),
            "ended_by": str(best.ended_by),
        }
    curves = [case.curve(aligned, label) for label, (_, aligned) in _PAIRS.items()]
    figures = {
        "velocity-aligned": panel(plot_family, curves, units=case.units, columns=2),
        "velocity-aligned-difference": panel(plot_differences, case.looks, differences, height=4.0),
    }
    fields = {
        "largest_difference": max(pair["largest_difference"] for pair in pairs.values()),
        "greatest_volume": max(pair["volume_max"] for pair in pairs.values()),
    }
    return Answer({"pairs": pairs}, figures, fields)


def slips(case: ReportCase) -> Answer:
    """The slips; the source's equations exactly as printed compared with the corrected ones."""
    readings: dict[str, Record] = {}
    for model in _READINGS:
        hits = case.hits(model)
        slopes = hits.dvolume[:-1][hits.ended_by[:-1] != "no-cut"]
        readings[model] = case.impact_and_optimum(model) | {"only_falls": bool((slopes < 0).all())}
    fields = {
        "readings": {label: readings[model] for model, label in _READINGS.items()},
        "greatest_volume": max(reading["volume_max"] for reading in readings.values()),
    }
    curves = [case.curve(model, label) for model, label in _READINGS.items()]
    figure = panel(plot_family, curves, height=4.0, units=case.units)
    return Answer({"force_at_contact": float(case.p.stiffness * case.p.r), **readings}, {"as-printed": figure}, fields)


def all_models(case: ReportCase) -> Answer:
    """For every model: V at the case's angle, α_max, V_max, the kind of the maximum, and how its cut ends."""
    numbers = {}
    for model in BUILT_IN:
        optimum = case.optimum(model)
        numbers[model] = case.impact_and_optimum(model) | {
            "side": str(optimum.side),
            "attained": bool(optimum.attained),
            "ended_by_at_max": str(optimum.ended_by),
            "certified": bool(optimum.certified),
        }
    fields = {
        "models": BUILT_IN,
        # At 90°, too; not the limit as α → 0, and not the NaN where nothing is removed.
        "best_angles": [row["alpha_max"] for row in numbers.values() if row["alpha_max"] > 0],
        # V at 90° over the greatest V.
        "left_at_90_degrees": {
            model: float(case.hits(model).volume[-2] / case.optimum(model).volume)
            for model in BUILT_IN
            if deforms(model)
        },
        "greatest_volume": max(row["volume_max"] for row in numbers.values()),
    }
    curves = [case.curve(model) for model in BUILT_IN]
    beside = [case.curve(model) for model in _BESIDE]
    figures = {
        "models": panel(plot_family, curves, width=5.8, height=5.2, units=case.units, columns=2),
        "correlations": panel(plot_shapes, beside, tuple(CORRELATIONS), width=5.8, height=5.0),
    }
    return Answer(numbers, figures, fields)


def deforms(model: str) -> bool:
    """Whether a registered model has wear by deformation."""
    built_in = BUILT_IN[model].make()
    return isinstance(built_in, RigidErodent) and not isinstance(built_in.deformation, NoDeformation)
