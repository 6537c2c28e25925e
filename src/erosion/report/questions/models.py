"""The closing part: a comparison of all models."""

from matplotlib.figure import Figure

from erosion.correlations import CORRELATIONS
from erosion.models import NoDeformation, RigidErodent
from erosion.models.registry import BUILT_IN
from erosion.output.tables import Record
from erosion.plotting.curves import plot_family, plot_shapes
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase

_BESIDE = ("linearized", "finnie", "rotating", "linearized-deformation")
NEEDS = tuple((kind, model) for model in BUILT_IN for kind in ("optimum", "hits"))


def answer(case: ReportCase) -> Answer:
    """For every model: V at the case's angle, α_max, V_max, the kind of the maximum, and how its cut ends."""
    numbers = {model: _numbers(case, model) for model in BUILT_IN}
    fields = {
        "models": BUILT_IN,
        # At 90°, too; not the limit as α → 0, and not the NaN where nothing is removed.
        "best_angles": [row["alpha_max"] for row in numbers.values() if row["alpha_max"] > 0],
        "left_at_90_degrees": {model: _left_at_90_degrees(case, model) for model in BUILT_IN if deforms(model)},
        "greatest_volume": max(row["volume_max"] for row in numbers.values()),
    }
    return Answer(numbers, {"models": _figure(case), "correlations": _beside_correlations(case)}, fields)


def _numbers(case: ReportCase, model: str) -> Record:
    optimum = case.optimum(model)
    return {
        **case.impact_and_optimum(model),
        "side": str(optimum.side),
        "attained": bool(optimum.attained),
        "ended_by_at_max": str(optimum.ended_by),
        "certified": bool(optimum.certified),
    }


def deforms(model: str) -> bool:
    """Whether a registered model has wear by deformation."""
    built_in = BUILT_IN[model].make()
    return isinstance(built_in, RigidErodent) and not isinstance(built_in.deformation, NoDeformation)


def _left_at_90_degrees(case: ReportCase, model: str) -> float:
    """V at 90° over the greatest V."""
    return float(case.hits(model).volume[-2] / case.optimum(model).volume)


def _figure(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.8, 5.2)
    plot_family(ax, [case.curve(model) for model in BUILT_IN], units=case.units, columns=2)
    return fig


def _beside_correlations(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.8, 5.0)
    plot_shapes(ax, [case.curve(model) for model in _BESIDE], tuple(CORRELATIONS))
    return fig
