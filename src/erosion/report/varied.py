"""A family of impacts as a figure and as numbers, for questions 5 to 8."""

from matplotlib.figure import Figure

from erosion.plotting.families import plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Case
from erosion.report.families import Family
from erosion.tables import Record


def family_figure(case: Case, family: Family) -> Figure:
    """V(α) for every value, with a line that joins the maxima."""
    fig, ax = new_axes(5.4, 4.2)
    plot_family(ax, family.curves(), units=case.units, joined=True)
    return fig


def family_numbers(case: Case, family: Family, model: str) -> Record:
    """For numbers.json."""
    return {
        "values": [float(value) for value in family.values],
        "labels": [label.strip() for label in family.labels],
        "alpha_max": [float(alpha) for alpha in family.alpha],
        "volume_max": [float(volume) for volume in family.volume],
        "kind": [str(kind) for kind in family.kind],
        "ended_by": [str(end) for end in family.ended_by],
        "spread": family.spread,
        "sensitivity": case.sensitivity(model, family.name),
    }
