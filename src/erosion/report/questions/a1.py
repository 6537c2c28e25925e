"""Additional question 1: the body may turn."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.models import load_model
from erosion.plotting.families import plot_best_angles, plot_family, plot_turn
from erosion.plotting.studies import plot_regimes
from erosion.plotting.style import new_axes, readable_scale
from erosion.report.case import Answer, Case, Illustration
from erosion.report.rotation import derivation_again, figures_again, numbers_again
from erosion.report.spins import TORQUES, Spins
from erosion.report.text import degrees, formula, join, math, note, number, paragraph, table
from erosion.trajectory.path import path
from erosion.trajectory.trajectory import SimulationError

_MODEL = "rotating"
NEEDS = (
    *((what, model) for model in TORQUES for what in ("optimum", "hits", "spins")),
    ("families", _MODEL),
    ("optimum", "linearized"),
    ("hits", "linearized"),
    ("sensitivities", _MODEL),
    ("sensitivities", "linearized"),
)
_TURN_ANGLES = np.deg2rad(np.arange(3.0, 90.0, 4.0))
_MUCH = np.deg2rad(20)  # sin φ has fallen by 6 %


def answer(case: Case) -> Answer:
    """α_max for both torques, over the spin; the turn; questions 5 to 8 again."""
    numbers = _numbers(case)
    return Answer(
        key="a1",
        title="What if the body turns as it cuts?",
        sentence=_sentence(case, numbers),
        figures=(
            _curves_figure(case),
            _spins_figure(case),
            _map_figure(case),
            _turn_figure(case, numbers),
            *figures_again(case, numbers["again"]),
        ),
        derivation=_derivation(case, numbers),
        numbers=numbers,
    )


def _numbers(case: Case) -> dict[str, Any]:
    found = {}
    for model in TORQUES:
        optimum = case.optimum(model)
        found[model] = {
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "kind": str(optimum.kind),
            "ended_by": str(optimum.ended_by),
            "volume_at_case": float(case.hits(model).volume[-1]),
            "jumps": [jump.alpha for jump in optimum.jumps],
            "over_spin": case.spins(model).numbers(),
        }
    return {**found, "turn": _turns(case), "again": numbers_again(case)}


def _turns(case: Case) -> dict[str, Any]:
    """How far the body turns, over the angle of attack and at the case's own [rad]."""
    best = float(case.optimum(_MODEL).alpha)
    turned: list[tuple[float, float, str]] = []
    for alpha in [*_TURN_ANGLES, case.alpha, *([best] if best > 0 else [])]:
        try:
            cut = path(load_model(_MODEL), case.p.replace(alpha=alpha))
        except SimulationError:
            continue
        turned.append((float(alpha), float(cut.turn), cut.ended_by))
    turned.sort()
    alpha, turn, ended_by = zip(*turned, strict=True)
    own = dict(zip(alpha, turn, strict=True))
    return {
        "alpha": list(alpha),
        "turn": list(turn),
        "ended_by": list(ended_by),
        "at_case": own.get(case.alpha),
        "at_best": own.get(best),
    }


def _sentence(case: Case, numbers: dict[str, Any]) -> Markup:
    before = case.optimum("linearized")
    simple, full = (numbers[model] for model in TORQUES)
    less = simple["volume_max"] / float(before.volume)
    if not simple["volume_max"] or not full["volume_max"]:
        return Markup("With this spin the tip moves backward at contact at every angle: <strong>nothing is cut</strong>"
                      ".")  # fmt: skip
    return Markup("<strong>Yes, the best angle changes</strong>: from {} to {}, or {} where both components of the "
                  "force turn the body; {} times as much is removed there, and now speed, erodent, material and above "
                  "all the spin move it.").format(
        degrees(float(before.alpha)), degrees(simple["alpha_max"]), degrees(full["alpha_max"]), number(less, 3)
    )  # fmt: skip


def _curves_figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.4, 4.1)
    curves = [case.curve("linearized", "no rotation"), *(case.curve(model, label) for model, label in TORQUES.items())]
    plot_family(ax, curves, units=case.units, columns=2)
    return Illustration(
        "rotation",
        fig,
        Markup("The volume removed over the angle of attack without rotation and with it. Where the tip grazes the "
               "surface, or its forward speed grazes zero, the cut ends much earlier or later, and the curve jumps."),
        "Removed volume over the angle of attack for three models; with rotation the curves jump.",
    )  # fmt: skip


def _spins_figure(case: Case) -> Illustration:
    fig, ax = new_axes(5.4, 4.2)
    found = [case.spins(model).best_angles(label) for model, label in TORQUES.items()]
    plot_best_angles(ax, found, xlabel="s = r φ̇₀/v₀  initial spin", columns=2)
    return Illustration(
        "best-angle-over-spin",
        fig,
        Markup("The angle of greatest removal over the spin {}, positive where it moves the tip forward. Open markers: "
               "the greatest volume is one side of a jump of {}, where no derivative vanishes. Lines break where "
               "another maximum takes over.").format(math(r"s=r\dot{\varphi}_0/v_0"), math(r"V(\alpha)")),
        "Angle of greatest removal over the initial spin for two torques, with maxima at jumps marked.",
    )  # fmt: skip


def _map_figure(case: Case) -> Illustration:
    return Illustration(
        "regimes",
        plot_regimes(case.spins(_MODEL).map),
        Markup("How the cut ends and what it removes, over the angle of attack and the spin, with the torque {}. The "
               "angle of greatest removal jumps from one region to another.").format(math("rF_x")),
        "Two maps over angle of attack and initial spin: how the cut ends, and the removed volume.",
    )  # fmt: skip


def _turn_figure(case: Case, numbers: dict[str, Any]) -> Illustration:
    fig, ax = new_axes(5.4, 3.6)
    turn = numbers["turn"]
    plot_turn(ax, np.array(turn["alpha"]), np.array(turn["turn"]), np.array(turn["ended_by"]))
    return Illustration(
        "turn",
        fig,
        Markup("How far the body turns during the cut, over the angle of attack, with the torque {}.").format(
            math("rF_x")
        ),
        "Turn of the body during the cut over the angle of attack.",
    )


def _derivation(case: Case, numbers: dict[str, Any]) -> Markup:
    return join(
        paragraph("The tip now circles the centre of mass. With ", math(r"d"), " for its depth and ",
                  math(r"c=\sigma b\psi"), ","),
        formula(r"x_\text{tip}=x-r\cos\varphi,\qquad d=y-r\left(1-\sin\varphi\right)"),
        formula(r"\begin{align*} m\ddot{x}&=-c\,d, & \dot{x}(0)&=v_0\cos\alpha \\ "
                r"m\ddot{y}&=-k\,c\,d, & \dot{y}(0)&=v_0\sin\alpha \\ "
                r"\beta mr^2\,\ddot{\varphi}&=-r\,c\,d, & \varphi(0)&=\tfrac{\pi}{2},\quad "
                r"\dot{\varphi}(0)=\dot{\varphi}_0 \end{align*}"),
        formula(r"V=b\int_0^{t_c}d\;\dot{x}_\text{tip}\,dt"),
        paragraph("The cut ends when ", math("d"), " returns to 0, or when ", math(r"\dot{x}_\text{tip}"), " falls to "
                  "0. The torque ", math("rF_x"), " is the source's; that of both components is ",
                  math(r"r\sin\varphi\,F_x+r\cos\varphi\,F_y"), ". As first integrals"),
        formula(r"\dot{y}-\dot{y}(0)=k\left(\dot{x}-\dot{x}(0)\right),\qquad "
                r"\dot{\varphi}-\dot{\varphi}_0=\frac{\dot{x}-\dot{x}(0)}{\beta r}"),
        paragraph("but the system has no solution in closed form. It is integrated with its derivatives in ",
                  math(r"\alpha"), ", the whole range of angles is resolved, jumps included, and the best of all local "
                  "maxima and of both sides of every jump is the answer."),
        _jumps(case, numbers),
        _turn_text(case, numbers),
        _spin_text(case),
        derivation_again(case),
    )  # fmt: skip


def _jumps(case: Case, numbers: dict[str, Any]) -> Markup:
    scale = readable_scale("volume", case.units, max(numbers[model]["volume_max"] for model in TORQUES))
    said = [
        (label, degrees(jump.alpha, 9), number(jump.below / scale.size, 5), jump.ended_below,
         number(jump.above / scale.size, 5), jump.ended_above)
        for model, label in TORQUES.items() for jump in case.optimum(model).jumps
    ]  # fmt: skip
    if not said:
        return paragraph("In this case ", math(r"V(\alpha)"), " has no jump.")
    head = ("", "jump at", f"V below [{scale.unit}]", "ends by", f"V above [{scale.unit}]", "ends by")
    return table("Where V(α) jumps in this case", head, said)


def _turn_text(case: Case, numbers: dict[str, Any]) -> Markup:
    turns = [(turn, where) for turn, where in ((numbers["turn"]["at_case"], case.alpha),
             (numbers["turn"]["at_best"], numbers[_MODEL]["alpha_max"])) if turn is not None]  # fmt: skip
    told = " and ".join(f"{degrees(abs(turn), 4)} at {degrees(where)}" for turn, where in turns)
    if not any(abs(turn) > _MUCH for turn, _ in turns):
        return paragraph(f"The body turns by {told}: so little that the linearization is fair.")
    lowest = min(float(np.cos(turn)) for turn, _ in turns)
    return note(
        f"How far it turns: {told}. The linearization takes ", math(r"\sin\varphi"), " to stay 1; it falls to ",
        number(lowest, 3), ". The assumption of questions 1 to 8 does not hold here, and what they find is right of "
        "their equations, not of a body that is free to turn.",
    )  # fmt: skip


def _spin_text(case: Case) -> Markup:
    simple, full = (case.spins(model) for model in TORQUES)
    rows = [
        (
            number(float(simple.s[i]), 3, strip=True),
            *(cell for spins in (simple, full) for cell in _best(spins, int(i))),
        )
        for i in simple.told
    ]
    return join(
        paragraph("Spin is the additional assumption that the source asks for. A tip that runs ahead (",
                  math("s>0"), ") cuts longer; one that lags (", math("s<0"), ") cuts less, and where ",
                  math(r"\cos\alpha+s\le0"), " it cuts nothing. Of the spins in the figure, "
                  f"{simple.jumps} of {simple.s.size} have their greatest volume at a jump with the torque ",
                  math("rF_x"), f", and {full.jumps} with that of both components: looking for a zero of the "
                  "derivative would miss them."),
        table("The angle of greatest removal over the spin",
              ("s", *(cell for label in TORQUES.values() for cell in (f"α_max, {label}", "maximum, end"))), rows),
    )  # fmt: skip


def _best(spins: Spins, i: int) -> tuple[str, str]:
    if spins.kind[i] == "none":
        return "–", "nothing is cut"
    return f"{np.rad2deg(spins.alpha[i]):.6f}°", f"{spins.kind[i]}, {spins.ended_by[i]}"
