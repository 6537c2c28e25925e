"""The slips of the source, and the results of its equations exactly as printed."""

from matplotlib.figure import Figure

from erosion.output.tables import Record
from erosion.plotting.curves import plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, ReportCase

_MODELS = {"as-printed": "as printed", "rotating": "as corrected", "linearized": "linearized"}
NEEDS = tuple((kind, model) for model in _MODELS for kind in ("optimum", "hits"))


def answer(case: ReportCase) -> Answer:
    """The slips; the printed equations compared with the corrected ones."""
    readings = {model: _reading(case, model) for model in _MODELS}
    fields = {
        "readings": {label: readings[model] for model, label in _MODELS.items()},
        "greatest_volume": max(reading["volume_max"] for reading in readings.values()),
    }
    force = float(case.p.stiffness * case.p.r)
    return Answer({"force_at_contact": force, **readings}, {"as-printed": _figure(case)}, fields)


def _reading(case: ReportCase, model: str) -> Record:
    hits = case.hits(model)
    falls = hits.dvolume[:-1][hits.ended_by[:-1] != "no-cut"] < 0
    return {**case.impact_and_optimum(model), "only_falls": bool(falls.all())}


def _figure(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.4, 4.0)
    plot_family(ax, [case.curve(model, label) for model, label in _MODELS.items()], units=case.units, columns=3)
    return fig
