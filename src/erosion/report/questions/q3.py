"""Question 3: the volume removed."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.parameters.units import conversion_factor, unit_name
from erosion.plotting.motion import plot_removal_rate
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import degrees, formula, join, math, number, paragraph, quantity, quantity_tex, table

_PANELS = (10, 100, 1000)


def answer(case: Case) -> Answer:
    """V by closed form, by diffrax, by the midpoint rule and from the speeds at both ends."""
    numbers = _numbers(case)
    return Answer(
        key="q3",
        title="How much is removed?",
        sentence=_sentence(case),
        figures=() if case.ended_by == "no-cut" else (_figure(case),),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )


def midpoint_rule(case: Case, panels: int) -> float:
    """B ∫ y ẋ dt by the midpoint rule on the closed forms of question 1."""
    width = case.t_c / panels
    state = case.closed.state((np.arange(panels) + 0.5) * width, case.p)
    return float(case.p.b) * float(np.sum(np.asarray(state.y * state.vx))) * width


def _numbers(case: Case) -> dict[str, Any]:
    p, motion = case.p, case.trajectory
    lost = float(motion.vx[0] ** 2 - motion.vx[-1] ** 2)
    return {
        "volume": case.volume,
        "volume_si": case.volume * conversion_factor("volume", case.units, "si"),
        "volume_numerical": motion.volume,
        "volume_from_speeds": float(p.m / (2 * p.sigma * p.psi)) * lost,
        "volume_midpoint": {str(panels): midpoint_rule(case, panels) for panels in _PANELS},
        "volume_scale": float(p.volume_scale),
    }


def _sentence(case: Case) -> Markup:
    if case.ended_by == "no-cut":
        return Markup("Nothing: at α = {} the tip has no forward speed.").format(degrees(case.alpha))
    in_si = case.volume * conversion_factor("volume", case.units, "si")
    own, handy = quantity(case.volume, "volume", case.units), quantity(in_si, "volume", "si", like=in_si)
    both = Markup(" ({})").format(handy) if handy != own else ""
    return Markup("One impact removes <strong>{}</strong>{}.").format(own, both)


def _figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.4, 3.5)
    plot_removal_rate(ax, case.trajectory, bars=_PANELS[0])
    return Illustration(
        "rate-of-removal",
        fig,
        Markup("The rate of removal {} over time. The area below it is the volume; the bars are the midpoint rule with "
               "{} panels.").format(math(r"\dot{V}=b\,y\,\dot{x}"), _PANELS[0]),
        "Rate of removal over time with the bars of the midpoint rule.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        paragraph("The volume is the width times the area between the path and the surface, equations (26) and (27):"),
        formula(r"V=b\int y\,dx=b\int_0^{t_c}y\,\dot{x}\,dt"),
        paragraph("The integral need not be worked out term by term. By the equation of motion ",
                  math(r"y=-m\ddot{x}/c"), " with ", math(r"c=\sigma b\psi"), ", and ",
                  math(r"\ddot{x}\,\dot{x}"), " is the derivative of ", math(r"\dot{x}^2/2"), ":"),
        formula(r"V=-\frac{bm}{c}\int_0^{t_c}\ddot{x}\,\dot{x}\,dt"
                r"=\frac{m}{2\sigma\psi}\left(\dot{x}(0)^2-\dot{x}(t_c)^2\right)"),
        paragraph("So the volume is the energy of the forward motion that was lost, over ", math(r"\sigma\psi"),
                  ". A rebound at ", math(r"\omega t_c=\pi"), " leaves the forward speed ",
                  math(r"v_0\cos\alpha-2v_0\sin\alpha/k"), "; a stop leaves none. With the scale ",
                  math(r"V^{*}=m v_0^2/(\sigma\psi)"), ","),
        formula(r"\begin{align*} V&=\frac{V^{*}}{k}\left(\sin2\alpha-\frac{2}{k}\sin^2\alpha\right) & "
                r"&\text{(rebound, }\tan\alpha\le\tfrac{k}{2}\text{)}\\ "
                r"V&=\frac{V^{*}}{2}\cos^2\alpha & &\text{(stop, }\tan\alpha\ge\tfrac{k}{2}\text{)}\end{align*}"),
        paragraph("In this case"),
        formula(rf"V^{{*}}={quantity_tex(numbers['volume_scale'], 'volume', case.units)},\qquad "
                rf"V={quantity_tex(case.volume, 'volume', case.units)}"),
        *(() if case.ended_by == "no-cut" else _four_ways(case, numbers)),
    )  # fmt: skip


def _four_ways(case: Case, numbers: dict[str, Any]) -> tuple[Markup, Markup]:
    return (
        paragraph("Four ways to the same number. The midpoint rule is the one that the scenario suggests; its error "
                  "falls with the square of the number of panels."),
        _comparison(case, numbers),
    )  # fmt: skip


def _comparison(case: Case, numbers: dict[str, Any]) -> Markup:
    ways = [
        ("closed form", case.volume),
        ("diffrax", numbers["volume_numerical"]),
        ("speeds at both ends", numbers["volume_from_speeds"]),
        *((f"midpoint, {n} panels", value) for n, value in numbers["volume_midpoint"].items()),
    ]
    si = readable_scale("volume", "si", case.volume * conversion_factor("volume", case.units, "si"))
    to_si = conversion_factor("volume", case.units, "si") / si.size
    head = ("method", f"V [{unit_name('volume', case.units)}]", f"V [{si.unit}]", "relative error")
    rows = [
        (
            way,
            number(value, 9),
            number(value * to_si, 7),
            "–" if way == "closed form" else number(abs(value / case.volume - 1), 2),
        )
        for way, value in ways
    ]
    return table("The volume by four methods", head, rows)
