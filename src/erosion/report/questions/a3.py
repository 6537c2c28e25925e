"""Additional question 3: the force opposes the motion throughout."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.plotting.families import plot_differences, plot_family
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import degrees, formula, join, math, note, number, paragraph, table

_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Models of additional question 2 and of this one that differ in nothing else."""

NEEDS = tuple((what, model) for pair in _PAIRS.values() for model in pair for what in ("optimum", "hits"))


def answer(case: Case) -> Answer:
    """The direction never changes, so this is additional question 2 again."""
    numbers = _numbers(case)
    largest = max(pair["largest_difference"] for pair in numbers["pairs"].values())
    return Answer(
        key="a3",
        title="What if the force opposes the motion throughout?",
        sentence=Markup("<strong>Nothing new</strong>: a force against the motion never turns the motion, so {} stays "
                        "{}. The two models agree to {} of the volume scale at every angle, with rotation too.").format(
            math(r"\dot{y}/\dot{x}"), math(r"\tan\alpha"), number(largest, 1)
        ),
        figures=_figures(case),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _differences(case: Case, pair: tuple[str, str]) -> np.ndarray:
    one, other = (case.hits(model).volume[:-1] for model in pair)
    return np.abs(one - other) / float(case.p.volume_scale)


def _numbers(case: Case) -> dict[str, Any]:
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
    return {"pairs": pairs}


def _figures(case: Case) -> tuple[Illustration, ...]:
    curves, ax = new_axes(5.4, 4.1)
    plot_family(ax, [case.curve(pair[1], label) for label, pair in _PAIRS.items()], units=case.units, columns=2)
    rounding, below = new_axes(5.4, 4.0)
    plot_differences(below, case.looks, {label: _differences(case, pair) for label, pair in _PAIRS.items()})
    return (
        Illustration("velocity-aligned", curves,
                     Markup("The volume removed over the angle of attack where the force opposes the motion of the "
                            "centre of mass, without rotation and with it."),
                     "Removed volume over the angle of attack for a force along the motion."),
        Illustration("velocity-aligned-difference", rounding,
                     Markup("The difference of volume between {} and {}, integrated as the different systems that "
                            "they are: what the solver's tolerance leaves.")
                     .format(math(r"k=\dot{y}/\dot{x}"), math(r"k=\tan\alpha")),
                     "Difference of the volumes of both models over the angle, at rounding."),
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        paragraph("By equation (29) ", math(r"F_y\dot{x}=F_x\dot{y}"), ". With ", math(r"F_x=m\ddot{x}"), " and ",
                  math(r"F_y=m\ddot{y}"), " the direction of motion obeys"),
        formula(r"\frac{d}{dt}\left(\frac{\dot{y}}{\dot{x}}\right)=\frac{\ddot{y}\dot{x}-\dot{y}\ddot{x}}{\dot{x}^2}"
                r"=\frac{F_y\dot{x}-F_x\dot{y}}{m\dot{x}^2}=0\quad\Rightarrow\quad"
                r"\frac{\dot{y}}{\dot{x}}=\frac{\dot{y}(0)}{\dot{x}(0)}=\tan\alpha"),
        paragraph("The system is nonlinear, but its solution is that of additional question 2. Nothing in the proof "
                  "asks where the tip is, so it holds for a body that turns just as well, for both torques: then "
                  "both models have the same maximum."),
        _table(case, numbers),
        note("At the end of the cut ", math(r"\dot{x}"), " and ", math(r"\dot{y}"), " vanish together and their "
             "quotient is 0/0. The solver adds to numerator and denominator a little of their values at contact, in "
             "the ratio ", math(r"\tan\alpha"), ": on the solution that changes no digit, and off it rounding is "
             "damped instead of amplified."),
    )  # fmt: skip


def _table(case: Case, numbers: dict[str, Any]) -> Markup:
    scale = readable_scale("volume", case.units, max(pair["volume_max"] for pair in numbers["pairs"].values()))
    head = ("", "maximum, end", "α_max, k = tan α", "α_max, k = ẏ/ẋ", f"V_max [{scale.unit}]",
            "largest difference over V*")  # fmt: skip
    rows = [
        (label, f"{pair['kind']}, {pair['ended_by']}", *(_angle(pair[key], pair["kind"]) for key in (
            "alpha_max_of_tan_alpha", "alpha_max")), number(pair["volume_max"] / scale.size, 6),
         number(pair["largest_difference"], 2))
        for label, pair in numbers["pairs"].items()
    ]  # fmt: skip
    return table("The same answers twice", head, rows)


def _angle(alpha: float, kind: str) -> str:
    return "–" if kind == "none" else "→ 0°" if kind == "boundary" and alpha == 0 else degrees(alpha, 8)
