"""Question 2: when the cut stops."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.plotting.motion import plot_end_times
from erosion.plotting.style import new_axes
from erosion.report.case import Answer, Case, Illustration
from erosion.report.text import (
    degrees,
    degrees_tex,
    formula,
    join,
    math,
    note,
    number_tex,
    paragraph,
    quantity,
    quantity_tex,
)


def answer(case: Case) -> Answer:
    """t_c as the lesser of two candidates; Figure 9."""
    numbers = _numbers(case)
    return Answer(
        key="q2",
        title="When does the cutting stop?",
        sentence=_sentence(case),
        figures=(_figure(case),),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )


def _numbers(case: Case) -> dict[str, Any]:
    times = {name: float(time) for name, time in case.closed.end_times(case.p).items()}
    return {
        "t_c": case.t_c,
        "ended_by": case.ended_by,
        "candidates": {name: time if np.isfinite(time) else None for name, time in times.items()},
        "cusp": case.cusp,
        "t_c_numerical": case.trajectory.t_c,
        "ended_by_numerical": case.trajectory.ended_by,
    }


def _sentence(case: Case) -> Markup:
    end = case.closed.state(case.t_c, case.p)
    if case.ended_by == "no-cut":
        return Markup("At α = {} the cut stops before it begins: the tip has no forward speed.").format(
            degrees(case.alpha)
        )
    when = Markup("The cut stops after <strong>{}</strong>, ").format(
        quantity(case.t_c, "time", case.units, like=case.t_c)
    )
    if case.ended_by == "rebound":
        return when + Markup(
            "when the erodent rebounds: its tip is back at the surface, still moving forward at {}."
        ).format(quantity(float(end.vx), "speed", case.units))
    return when + Markup(
        "when the erodent has lost its forward speed, with its tip still {} below the surface."
    ).format(quantity(float(end.y), "length", case.units))


def _figure(case: Case) -> Illustration:
    angles, p = case.angles, case.over_angles()
    candidates = {name: np.asarray(times) for name, times in case.closed.end_times(p).items()}
    # The real part of the complex root of cos ωt = 1 - k cot α is π/ω wherever 1 - k cot α < -1.
    real_part = np.where(angles <= case.cusp, np.pi / case.omega, np.nan)
    fig, ax = new_axes(5.4, 4.1)
    plot_end_times(
        ax,
        angles,
        candidates,
        np.asarray(case.closed.t_c(p)),
        units=case.units,
        real_part=real_part,
        marks={"cusp": (case.cusp, np.pi / case.omega), "case": (case.alpha, case.t_c)},
    )
    return Illustration(
        "figure-9-end-of-cut",
        fig,
        Markup("Figure 9 of the scenario: both candidates for the end over the angle of attack. The broad band is the "
               "actual end, the earlier of the two. Up to the cusp at {} the condition {} has no real solution; the "
               "real part of its complex one (dashed) coincides with the rebound.")
        .format(degrees(case.cusp), math(r"\dot{x}=0")),
        f"End of the cut over the angle of attack, with a cusp at {degrees(case.cusp)}.",
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        paragraph("A cut can end in two ways, and the earlier ends it. One is the ", Markup("<b>rebound</b>"),
                  ": the tip returns to the surface. From ", math(r"y\propto\sin\omega t"), ","),
        formula(r"y(t)=0\quad\Rightarrow\quad t_\text{rebound}=\frac{\pi}{\omega}"),
        paragraph("It depends neither on the angle nor on the speed. The other is the ", Markup("<b>stop</b>"),
                  ": the forward speed is used up. Setting ", math(r"\dot{x}=0"), " in the answer to question 1 gives"),
        formula(r"\cos\omega t=1-k\cot\alpha\quad\Rightarrow\quad "
                r"t_\text{stop}=\frac{1}{\omega}\arccos\left(1-k\cot\alpha\right)"
                r"=\frac{2}{\omega}\arcsin\sqrt{\frac{k}{2}\cot\alpha}"),
        paragraph("A cosine is at least −1, so this is real only where ", math(r"k\cot\alpha\le2"), ", that is, for"),
        formula(rf"\tan\alpha\ge\frac{{k}}{{2}}\quad\Leftrightarrow\quad\alpha\ge\alpha_\text{{cusp}}="
                rf"\arctan\frac{{k}}{{2}}={degrees_tex(case.cusp)}"),
        paragraph("At smaller angles the solution is complex,"),
        formula(r"\omega t=\pi\pm i\,\mathrm{arcosh}\left(k\cot\alpha-1\right),"),
        paragraph("and has no physical meaning; its real part is ", math(r"\pi/\omega"), ", the time of the rebound. "
                  "So the two curves meet at the cusp, where the stop's falls away vertically. Wherever the stop is "
                  "real it is the earlier, for an arccosine is at most ", math(r"\pi"), ":"),
        formula(r"\begin{align*} t_c&=\frac{\pi}{\omega} & &\text{(rebound, }\tan\alpha\le\tfrac{k}{2}\text{)}\\"
                r"t_c&=\frac{1}{\omega}\arccos(1-k\cot\alpha) & "
                r"&\text{(stop, }\tan\alpha\ge\tfrac{k}{2}\text{)}\end{align*}"),
        _with_numbers(case, numbers),
        note("Where we differ from the source: it asks for ", math("y<0"), " when the forward speed vanishes. Its own ",
             math("y"), " is a depth and is positive during the cut, so the condition is ",
             math(r"\dot{x}=0"), " while ", math("y>0"), "."),
    )  # fmt: skip


def _with_numbers(case: Case, numbers: dict[str, Any]) -> Markup:
    if case.ended_by == "no-cut":
        return paragraph("In this case ", math(r"\dot{x}(0)=0"), ": the cut is over as it begins.")
    rebound, stop = numbers["candidates"]["rebound"], numbers["candidates"]["stop"]
    ratio = float(case.p.k) / np.tan(case.alpha)
    side = r"\le" if case.alpha <= case.cusp else ">"
    real = (
        rf"t_\text{{stop}}={quantity_tex(stop, 'time', case.units)}"
        if stop is not None
        else rf"k\cot\alpha={number_tex(ratio)}>2,\ \text{{so there is no real stop}}"
    )
    found = rf"t_c={quantity_tex(numbers['t_c_numerical'], 'time', case.units, 10)}"
    return join(
        paragraph("In this case ", math(rf"\alpha={degrees_tex(case.alpha)}{side}\alpha_\text{{cusp}}"), " and"),
        formula(rf"t_\text{{rebound}}={quantity_tex(rebound, 'time', case.units)},\qquad {real}"),
        paragraph("The numerical solution, which looks for both events while it steps, finds ", math(found),
                  f" ({numbers['ended_by_numerical']})."),
    )  # fmt: skip
