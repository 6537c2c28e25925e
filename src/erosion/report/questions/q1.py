"""Question 1: the solutions x(t) and y(t)."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.models import load_model
from erosion.parameters.units import Dimension
from erosion.plotting.motion import plot_histories, plot_path
from erosion.plotting.style import new_axes, new_figure
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
    table,
    with_unit_tex,
)
from erosion.trajectory.path import path
from erosion.trajectory.trajectory import SimulationError

_MUCH = np.deg2rad(20)  # sin φ has fallen by 6 %
_STATE: tuple[tuple[str, str, Dimension], ...] = (
    ("x", "x", "length"),
    ("y", "y", "length"),
    ("vx", "ẋ", "speed"),
    ("vy", "ẏ", "speed"),
)


def answer(case: Case) -> Answer:
    """x(t) and y(t) as formulas and with numbers; Figures 7 and 8."""
    numbers = _numbers(case)
    return Answer(
        key="q1",
        title="How does the tip move?",
        sentence=_sentence(case, numbers),
        figures=_figures(case),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )


def _numbers(case: Case) -> dict[str, Any]:
    p, motion = case.p, case.trajectory
    along, down = float(p.v0 * np.cos(p.alpha)), float(p.v0 * np.sin(p.alpha))
    exact = case.closed.state(motion.t, p)
    differences = {}
    for name, _, _ in _STATE:
        closed = np.asarray(getattr(exact, name))
        differences[name] = float(np.abs(getattr(motion, name) - closed).max())
    return {
        "omega": case.omega,
        "stiffness": float(p.stiffness),
        "vx_0": along,
        "vy_0": down,
        "x_slope": along - down / float(p.k),
        "x_amplitude": down / (float(p.k) * case.omega),
        "y_amplitude": down / case.omega,
        "vx_amplitude": down / float(p.k),
        "x_end": float(motion.x[-1]),
        "y_end": float(motion.y[-1]),
        "vx_end": float(motion.vx[-1]),
        "vy_end": float(motion.vy[-1]),
        "largest_difference": differences,
        "turn_if_free": _turn_if_free(case),
    }


def _turn_if_free(case: Case) -> float | None:
    """How far the body would turn if the force were allowed to turn it [rad]."""
    try:
        return path(load_model("rotating"), case.p).turn
    except SimulationError:
        return None


def _sentence(case: Case, numbers: dict[str, Any]) -> Markup:
    if case.ended_by == "no-cut":
        return Markup(
            "At α = {} the tip has no forward speed, so it cuts nothing and there is no path to follow."
        ).format(degrees(case.alpha))
    x, y = _solutions(case, numbers)
    return Markup("Until the cut ends, the tip follows {} and {} with {}.").format(
        math(x), math(y), math(rf"\omega={_omega_tex(case)}")
    )


def _solutions(case: Case, numbers: dict[str, Any]) -> tuple[str, str]:
    units = case.units
    slope = quantity_tex(numbers["x_slope"], "speed", units)
    deepest = numbers["y_amplitude"]
    swing = quantity_tex(numbers["x_amplitude"], "length", units, like=deepest)
    depth = quantity_tex(deepest, "length", units, like=deepest)
    return rf"x(t)={slope}\cdot t+{swing}\cdot\sin\omega t", rf"y(t)={depth}\cdot\sin\omega t"


def _omega_tex(case: Case) -> str:
    return with_unit_tex(number_tex(case.omega), "s⁻¹")


def _figures(case: Case) -> tuple[Illustration, ...]:
    if case.ended_by == "no-cut":
        return ()
    histories = new_figure(5.6, 4.5)
    plot_histories(histories, case.trajectory, case.closed)
    path, ax = new_axes(5.6, 3.4)
    plot_path(ax, case.trajectory)
    end = f"the cut ends by {case.ended_by}"
    return (
        Illustration(
            "figure-7-histories",
            histories,
            Markup("Figure 7 of the scenario: position and velocity of the tip from contact to the end of the cut. The "
                   "numerical solution lies on the closed form. Depth {} is positive into the target.")
            .format(math("y")),
            "Four panels over time: x, y and their rates, numerical solution over closed form.",
        ),
        Illustration(
            "figure-8-path",
            path,
            Markup("Figure 8 of the scenario: the path of the tip, with the depth drawn downward, from the point of "
                   "contact to where {}. The filled area times the width {} is the volume removed. The two axes have "
                   "different scales.").format(end, math("b")),
            f"Path of the tip below the surface, the removed area filled; {end}.",
        ),
    )  # fmt: skip


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        paragraph("Without rotation every point of the erodent moves alike, so the tip moves as the centre of mass. "
                  "Write ", math(r"c=\sigma b\psi"), " for the stiffness of the contact. Equations (22) to (25) are"),
        formula(r"\begin{align*} m\ddot{x} &= -c\,y, & x(0)&=0, & \dot{x}(0)&=v_0\cos\alpha \\ "
                r"m\ddot{y} &= -k\,c\,y, & y(0)&=0, & \dot{y}(0)&=v_0\sin\alpha \end{align*}"),
        paragraph("The second equation does not contain ", math("x"), ". It is that of a swing:"),
        formula(r"\ddot{y}+\omega^2y=0,\qquad \omega=\sqrt{\frac{k\,c}{m}}"
                r"\quad\Rightarrow\quad y(t)=A\cos\omega t+B\sin\omega t"),
        paragraph("The start ", math("y(0)=0"), " gives ", math("A=0"), ", and ",
                  math(r"\dot{y}(0)=\omega B=v_0\sin\alpha"), " gives ", math("B"), ":"),
        formula(r"y(t)=\frac{v_0\sin\alpha}{\omega}\sin\omega t,\qquad \dot{y}(t)=v_0\sin\alpha\cos\omega t"),
        paragraph("The two forces differ by the factor ", math("k"), " only, so ", math(r"\ddot{x}=\ddot{y}/k"),
                  ". Integrating this once, and once more, with the values at the start:"),
        formula(r"\dot{x}-v_0\cos\alpha=\frac{\dot{y}-v_0\sin\alpha}{k}\quad\Rightarrow\quad "
                r"\dot{x}(t)=v_0\cos\alpha-\frac{v_0\sin\alpha}{k}\left(1-\cos\omega t\right)"),
        formula(r"x(t)=v_0\cos\alpha\; t-\frac{v_0\sin\alpha}{k}\left(t-\frac{\sin\omega t}{\omega}\right)"),
        _with_numbers(case, numbers),
        _check(case, numbers),
        _caveat(case, numbers),
    )  # fmt: skip


def _with_numbers(case: Case, numbers: dict[str, Any]) -> Markup:
    if case.ended_by == "no-cut":
        return Markup("")
    units = case.units
    x, y = _solutions(case, numbers)
    vx, fall = quantity_tex(numbers["vx_0"], "speed", units), quantity_tex(numbers["vx_amplitude"], "speed", units)
    vy = quantity_tex(numbers["vy_0"], "speed", units)
    return join(
        paragraph("With the numbers of this case, ", math(rf"\alpha={degrees_tex(case.alpha)}"), " and ",
                  math(rf"\omega=\sqrt{{kc/m}}={_omega_tex(case)}"), ":"),
        formula(x),
        formula(y),
        formula(rf"\dot{{x}}(t)={vx}-{fall}\cdot(1-\cos\omega t)"),
        formula(rf"\dot{{y}}(t)={vy}\cdot\cos\omega t"),
    )  # fmt: skip


def _check(case: Case, numbers: dict[str, Any]) -> Markup:
    if case.ended_by == "no-cut":
        return Markup("")
    rows = []
    for name, symbol, dimension in _STATE:
        largest = float(np.abs(getattr(case.trajectory, name)).max())
        rows.append((symbol, quantity(largest, dimension, case.units),
                     quantity(numbers["largest_difference"][name], dimension, case.units, 2)))  # fmt: skip
    return join(
        *(note(warning) for warning in case.trajectory.warnings),
        paragraph("As a check, diffrax integrates the same equations step by step, without knowing the solution."),
        table("Numerical against exact", ("", "largest value", "largest difference"), rows),
    )


def _caveat(case: Case, numbers: dict[str, Any]) -> Markup:
    turn = abs(numbers["turn_if_free"] or 0.0)
    how_far = Markup("")
    if turn:
        how_far = Markup(" Where the force on the tip may turn the body (the model <code>rotating</code>), it turns by "
                         "{} during this cut").format(degrees(turn, 3))  # fmt: skip
        how_far += ", far more than the assumption allows: the model is simple, not exact." if turn > _MUCH else "."
    return note(
        "Where we differ from the source: it calls ", math(r"\varphi"), " small and sets ",
        math(r"\sin\varphi\approx0"), ", yet ", math(r"\varphi(0)=\pi/2"), ". What must stay small is the turn ",
        math(r"\varphi-\pi/2"), "; the depth of the tip is then ", math("y"), ", and equations (22) to (25) stand.",
        how_far,
    )  # fmt: skip
