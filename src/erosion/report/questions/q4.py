"""Question 4: the angle at which most is removed."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.parameters.units import unit_name
from erosion.plotting.motion import plot_volume
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, Case, Illustration
from erosion.report.newton import Iterate, greatest, volume_jet
from erosion.report.text import (
    degrees,
    degrees_tex,
    formula,
    join,
    math,
    note,
    number,
    paragraph,
    quantity,
    quantity_tex,
    table,
)


def answer(case: Case) -> Answer:
    """α_max by Newton's method on the derivative of the solver, checked against ½ arctan k."""
    steps = greatest(volume_jet(case.model, case.p))
    numbers = _numbers(case, steps)
    return Answer(
        key="q4",
        title="Which angle removes most?",
        sentence=_sentence(case, numbers),
        figures=(_figure(case, numbers),),
        derivation=_derivation(case, numbers, steps),
        numbers=numbers,
    )


def _numbers(case: Case, steps: list[Iterate]) -> dict[str, Any]:
    exact = float(case.closed.alpha_max(case.p))
    return {
        "alpha_max": steps[-1].alpha,
        "volume_max": steps[-1].volume,
        "d2volume": steps[-1].d2volume,
        "alpha_max_closed_form": exact,
        "volume_max_closed_form": float(case.closed.volume(case.p.replace(alpha=exact))),
        "iterates": [step._asdict() for step in steps],
    }


def _sentence(case: Case, numbers: dict[str, Any]) -> Markup:
    more = (
        f", {number(numbers['volume_max'] / case.volume, 4)} times as much as at {degrees(case.alpha)}"
        if case.volume
        else ""
    )
    return Markup("Most is removed at <strong>α = {}</strong>: {} an impact{}.").format(
        degrees(numbers["alpha_max"]), quantity(numbers["volume_max"], "volume", case.units), more
    )


def _figure(case: Case, numbers: dict[str, Any]) -> Illustration:
    p = case.over_angles()
    at_cusp = float(case.closed.volume(p.replace(alpha=case.cusp)))
    fig, ax = new_axes(5.4, 4.0)
    plot_volume(
        ax,
        case.angles,
        np.asarray(case.closed.volume(p)),
        case.closed.ended_by(p),
        units=case.units,
        marks={
            "branch": (case.cusp, at_cusp),
            "case": (case.alpha, case.volume),
            "best": (numbers["alpha_max"], numbers["volume_max"]),
        },
    )
    return Illustration(
        "volume-over-angle",
        fig,
        Markup("The volume removed over the angle of attack. Curve and slope are continuous where rebound gives way to "
               "stop at {}, but the curvature jumps.").format(degrees(case.cusp)),
        f"Volume over angle of attack with its maximum at {degrees(numbers['alpha_max'])}.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any], steps: list[Iterate]) -> Markup:
    return join(
        paragraph("At the greatest volume the derivative vanishes, equation (28). From the answer to question 3,"),
        formula(r"\begin{align*} \frac{dV}{d\alpha}&=\frac{2V^{*}}{k}\left(\cos2\alpha-\frac{1}{k}\sin2\alpha\right) & "
                r"&\text{(rebound, }\tan\alpha\le\tfrac{k}{2}\text{)}\\ "
                r"\frac{dV}{d\alpha}&=-\frac{V^{*}}{2}\sin2\alpha & "
                r"&\text{(stop, }\tan\alpha\ge\tfrac{k}{2}\text{)}\end{align*}"),
        paragraph("Where the cut ends by a stop the volume only falls with the angle, so the maximum is on the "
                  "branch of the rebound:"),
        formula(r"\tan2\alpha_\text{max}=k\quad\Rightarrow\quad\alpha_\text{max}=\frac{1}{2}\arctan k,\qquad "
                r"V_\text{max}=\frac{V^{*}}{k^2}\left(\sqrt{1+k^2}-1\right)"),
        formula(rf"\alpha_\text{{max}}={degrees_tex(numbers['alpha_max_closed_form'], 11)},\qquad "
                rf"V_\text{{max}}={quantity_tex(numbers['volume_max_closed_form'], 'volume', case.units, 8)}"),
        paragraph("Only ", math("k"), " enters: not the speed, not the erodent, not the target."),
        paragraph("The same angle without any formula: the solver follows the impact together with its derivatives in ",
                  math(r"\alpha"), ", and Newton's method looks for the zero of ", math("V'"), ". A scan of the angles "
                  "gives the start and a bracket, and a step that would leave the bracket is replaced by bisection:"),
        formula(r"\alpha_{n+1}=\alpha_n-\frac{V'(\alpha_n)}{V''(\alpha_n)}"),
        _iterates(case, steps),
        _check(numbers),
        note("The source recommends trying many angles instead. That is safe too, and here it finds the start, but its "
             "accuracy is the distance between angles. At ", math(r"\alpha=0"), " itself the erodent never meets the "
             "surface, hence ", math(r"\alpha>0"), "."),
    )  # fmt: skip


def _iterates(case: Case, steps: list[Iterate]) -> Markup:
    slope, bend = (unit_name(d, case.units) for d in ("volume per angle", "volume per angle²"))
    rows = [
        (
            str(n),
            f"{np.rad2deg(step.alpha):.10f}",
            number(step.dvolume, 4),
            number(step.d2volume, 6),
            number(float(np.rad2deg(step.step)), 3),
            step.kind,
        )
        for n, step in enumerate(steps)
    ]
    return table("Newton's method on V′", ("n", "α [°]", f"V′ [{slope}]", f"V″ [{bend}]", "step [°]", "by"), rows)


def _check(numbers: dict[str, Any]) -> Markup:
    angle = abs(numbers["alpha_max"] - numbers["alpha_max_closed_form"])
    volume = abs(numbers["volume_max"] / numbers["volume_max_closed_form"] - 1)
    return paragraph(
        "Against the closed form the angle is off by ",
        degrees(angle, 2),
        " and the volume by ",
        number(volume, 2),
        " of itself.",
    )
