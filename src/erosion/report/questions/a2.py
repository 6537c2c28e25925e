"""Additional question 2: k = tan α."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.models.closed_forms import StraightCut
from erosion.plotting.families import plot_family
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import degrees, formula, join, math, note, paragraph, quantity, quantity_tex
from erosion.report.varied import said_part

_MODEL, _TURNING = "tan-alpha", "rotating-tan-alpha"
NEEDS = tuple((what, model) for model in (_MODEL, _TURNING, "linearized") for what in ("optimum", "hits"))


def answer(case: Case) -> Answer:
    """V = (V*/2) cos²α only falls: no interior maximum, a supremum that is not reached."""
    numbers = _numbers(case)
    return Answer(
        key="a2",
        title="What if k = tan α?",
        sentence=Markup("<strong>Then there is no best angle</strong>: the volume only falls with the angle, and its "
                        "supremum {} is approached as {} but never reached.").format(
            quantity(numbers["supremum"], "volume", case.units), math(r"\alpha\to0")
        ),
        figures=(_figure(case),),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )  # fmt: skip


def _numbers(case: Case) -> dict[str, Any]:
    optimum, turning, hits = case.optimum(_MODEL), case.optimum(_TURNING), case.hits(_MODEL)
    exact = np.asarray(StraightCut().volume(hits.p))
    return {
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


def _figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.4, 4.1)
    plot_family(
        ax,
        [
            case.curve("linearized", "k constant"),
            case.curve(_MODEL, "k = tan α"),
            case.curve(_TURNING, "k = tan α, the body turns"),
        ],
        units=case.units,
        columns=2,
    )
    return Illustration(
        "tan-alpha",
        fig,
        Markup("The volume removed over the angle of attack for constant {} and for {}. The open circle is a supremum "
               "that no angle reaches; rotation brings a maximum back.").format(math("k"), math(r"k=\tan\alpha")),
        "Removed volume over the angle of attack; for k = tan α it only falls.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    turning = numbers["rotating"]
    return join(
        paragraph("With ", math(r"F_y=F_x\tan\alpha"), " the force points along the line of impact at every instant, "
                  "so the tip moves along this line, slowed as by a spring:"),
        formula(r"x=\ell\cos\alpha,\quad y=\ell\sin\alpha:\qquad m\ddot{\ell}=-c\tan\alpha\cdot\ell"
                r"\quad\Rightarrow\quad \ell=\frac{v_0}{\omega}\sin\omega t,\qquad \omega^2=\frac{c\tan\alpha}{m}"),
        paragraph("Both velocities vanish together at ", math(r"\omega t=\pi/2"), ", deep in the target: the cut "
                  "always ends by a stop. All the energy of the forward motion is used, and by the answer to "
                  "question 3"),
        formula(r"V=\frac{m}{2\sigma\psi}\dot{x}(0)^2=\frac{V^{*}}{2}\cos^2\alpha,\qquad "
                r"\frac{dV}{d\alpha}=-\frac{V^{*}}{2}\sin2\alpha<0"),
        paragraph("The derivative vanishes nowhere inside ", math(r"(0,\pi/2)"), ". The shallower the impact, the more "
                  "is removed, along an ever longer and shallower groove; at ", math(r"\alpha=0"), " itself the tip "
                  "never enters the surface. So there is a supremum and no maximum:"),
        formula(rf"\sup V=\frac{{V^{{*}}}}{{2}}"
                rf"={quantity_tex(numbers['supremum_closed_form'], 'volume', case.units, 7)}"),
        paragraph("The solver, which does not know this, agrees at every angle of the figure to within ",
                  said_part(numbers["largest_difference"]).replace("of itself", "of V*"),
                  ", and the search of the best angle answers: at the boundary, ",
                  quantity(numbers["supremum"], "volume", case.units, 7), ", ",
                  "reached" if numbers["attained"] else "approached and not reached", "."),
        note("The question expects that the answer for ", math(r"\alpha_\text{max}"), " changes; it is lost. A large "
             "tangent throws a steep impact back, as it should, but a small one lets a shallow impact cut without end. "
             "With rotation (", Markup("<code>rotating-tan-alpha</code>"), ") ",
             _turning(case, turning)),
    )  # fmt: skip


def _turning(case: Case, turning: dict[str, Any]) -> str:
    if turning["kind"] == "none":
        return "nothing is cut at all with this spin."
    if turning["kind"] == "boundary":
        return "there is no maximum either."
    where, much = degrees(turning["alpha_max"]), quantity(turning["volume_max"], "volume", case.units)
    at = "a jump" if turning["kind"] == "jump" else "a maximum"
    return f"there is {at} again, at {where} with {much}."
