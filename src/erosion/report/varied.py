"""A family of impacts as figure, table and numbers: what questions 5 to 8 have in common."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.units import unit_name
from erosion.plotting.families import plot_family
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Case, Illustration
from erosion.report.families import Family
from erosion.report.text import degrees, number, quantity, table

_NOTHING = "less than rounding"


def family_figure(case: Case, family: Family, name: str, caption: Markup) -> Illustration:
    """V(α) of every value, the maxima joined."""
    fig, ax = new_axes(5.4, 4.2)
    plot_family(ax, family.curves(), units=case.units, joined=True)
    meaning = QUANTITIES[family.name].meaning
    return Illustration(
        name, fig, caption, f"Removed volume over the angle of attack for several values of: {meaning}."
    )


def family_table(case: Case, family: Family, caption: str) -> Markup:
    """Value, Ω, α_max, V_max and what kind of maximum."""
    quantity_ = QUANTITIES[family.name]
    unit = unit_name(quantity_.dimension, case.units)
    scale = readable_scale("volume", case.units, float(family.volume.max()))
    head = ("", f"{quantity_.symbol} [{unit}]" if unit else quantity_.symbol, "α_max [°]",
            f"V_max [{scale.unit}]", "maximum", "ends by")  # fmt: skip
    rows = [
        (label, number(value, 4, strip=True), f"{np.rad2deg(alpha):.9f}", number(volume / scale.size, 6), kind, end)
        for label, value, alpha, volume, kind, end in zip(
            family.labels, family.values, family.alpha, family.volume, family.kind, family.ended_by, strict=True
        )
    ]
    named = any("=" not in label for label in family.labels)
    first = 0 if named else 1
    return table(caption, head[first:], [row[first:] for row in rows])


def family_numbers(case: Case, family: Family, model: str) -> dict[str, Any]:
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


def said_angle(angle: float) -> str:
    """A difference of computed angles [rad]."""
    return degrees(abs(angle), 1) if angle else _NOTHING


def said_part(part: float) -> str:
    """A relative difference of computed numbers."""
    return f"{number(abs(part), 1)} of itself" if part else _NOTHING


def said_rates(*rates: float) -> str:
    """Sensitivities of an angle [rad]."""
    return " and ".join(degrees(rate, 4) for rate in rates) if any(rates) else "zero, as far as the arithmetic can tell"


def volume_range(case: Case, family: Family) -> tuple[str, str]:
    """The least and the greatest V_max."""
    return (
        quantity(float(family.volume.min()), "volume", case.units, 4),
        quantity(float(family.volume.max()), "volume", case.units, 4),
    )
